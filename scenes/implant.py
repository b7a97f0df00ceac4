"""A tapered stem in bone, moved by the joint. Lengths in mm, stresses in MPa."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import MESHES, ContactPair, TaggedMesh, Tresca, read_gmsh
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.scene import Scene

TITANIUM, CANCELLOUS, CORTICAL = 110_000.0, 1_000.0, 15_000.0  # MPa, Young's moduli
POISSON = 0.3  # of all
WIDTH, SHELL = 50.0, 5.0  # mm, of the block and of its cortical shell
INTERFERENCE = 0.04  # mm, at the top of the stem; none at its tip
MOTION = (-0.02, 0.0, -0.02)  # mm, of the head
PRESS_FIT = 3.0  # MPa, mean pressure
ROUGH, SMOOTH = 0.8 * PRESS_FIT, 0.1 * PRESS_FIT  # MPa, slip bounds
COATED = -25.0  # mm, the coating ends at this height


def slip_bound(x: np.ndarray) -> np.ndarray:
    """Return g [MPa] at points x (3, n): rough above, smooth below, changing over some mm."""
    bound: np.ndarray = SMOOTH + (ROUGH - SMOOTH) * 0.5 * (1 + np.tanh((x[2] - COATED) / 2.0))
    return bound


def bone_modulus(x: np.ndarray) -> np.ndarray:
    """Return Young's modulus [MPa] of the bone at points x (3, n): stiff at the outer walls."""
    depth = WIDTH / 2 - np.maximum(np.abs(x[0]), np.abs(x[1]))
    modulus: np.ndarray = CANCELLOUS + (CORTICAL - CANCELLOUS) * _shell(depth, np.tanh)
    return modulus


def _shell(depth: Any, tanh: Any) -> Any:
    """Return 1 in the cortical shell and 0 inside."""
    return 0.5 * (1 - tanh((depth - SHELL) / 1.5))


def implant(
    comm: MPI.Comm,
    N: int = 20,
    *,
    degree: int = 1,
    smooth: bool = False,
    **parameters: float,
) -> Scene:
    """Return the scene with N cells round the half hole. Collective.

    Args:
        comm: communicator of the mesh.
        N: cells round the half hole.
        degree: degree of the displacement.
        smooth: whether the modulus of bone varies inside a cell; otherwise it is constant there.
        parameters: further parameters of the .geo file.

    Returns:
        The scene; `data` has the `motion` of the head [mm], zero at first, `young`, `poisson`,
        and the names of the `bodies`.
    """
    M = round(0.8 * N)  # cells round the stem
    file = MESHES / "implant.geo"
    hip = read_gmsh(file, comm, N=N, M=M, Interference=INTERFERENCE, Width=WIDTH, **parameters)
    return on_implant(hip, degree=degree, smooth=smooth)


def on_implant(hip: TaggedMesh, *, degree: int = 1, smooth: bool = False) -> Scene:
    """Return the scene on any mesh of bone and stem, such as a refined one. Collective."""
    facet_tags, tags = hip.facet_tags, hip.tags
    V = fem.functionspace(hip.mesh, ("Lagrange", degree, (3,)))
    motion = fem.Constant(hip.mesh, np.zeros(3))
    held: list[tuple[str, Any, int | None]]
    held = [("bone_fixed", None, None), ("stem_joint", motion, None)]
    held += [("bone_symmetry", None, 1), ("stem_symmetry", None, 1)]
    bcs = [fixed(V, facet_tags.find(tags[name]), value, axis) for name, value, axis in held]
    pair = ContactPair(
        facet_tags,
        secondary=tags["bone_contact"],
        primary=tags["stem_contact"],
        friction=Tresca(slip_bound),
        geometry=hip.geometry,
    )
    young = _smooth_modulus(hip) if smooth else _modulus_of_cells(hip)
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree}) if smooth else ufl.dx
    a = elasticity(V, young, POISSON, dx)
    bodies = ("bone", "stem")
    data = SimpleNamespace(motion=motion, young=young, poisson=POISSON, bodies=bodies)
    L = no_load(V)
    return Scene(V, a, L, bcs, [pair], facet_tags, hip.cell_tags, tags, data, hip.geometry)


def _modulus_of_cells(hip: TaggedMesh) -> fem.Function:
    """Return Young's modulus [MPa], one value in each cell."""
    young = fem.Function(fem.functionspace(hip.mesh, ("DG", 0)))
    young.interpolate(bone_modulus)
    young.x.array[hip.cell_tags.find(hip.tags["stem"])] = TITANIUM
    return young


def _smooth_modulus(hip: TaggedMesh) -> Any:
    """Return Young's modulus [MPa] as an expression of the coordinates."""
    is_bone = by_body(hip, {"bone": 1.0})
    x, y, _ = ufl.SpatialCoordinate(hip.mesh)
    depth = WIDTH / 2 - ufl.max_value(abs(x), abs(y))
    bone = CANCELLOUS + (CORTICAL - CANCELLOUS) * _shell(depth, ufl.tanh)
    return is_bone * bone + (1 - is_bone) * TITANIUM
