"""A crane on clay, held by contact alone. Lengths in m, forces in kN, stresses in kPa."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import MESHES, ContactPair, TaggedMesh, Tresca, read_gmsh
from scenes.elasticity import by_body, elasticity, fixed
from scenes.scene import Scene

SIDE, FOOT = 2.0, 0.5  # m, width and height of the foot
THICK, POST, ARM = 0.5, 1.5, 2.25  # m, of post and arm; height of the post, length of the arm
YOUNG = {"clay": 100e3, "crane": 30e6}  # kPa
POISSON = {"clay": 0.4, "crane": 0.2}
UNIT_WEIGHT = 24.0  # kN/m^3, concrete
ADHESION = 25.0  # kPa, the slip bound


def crane_on_clay(comm: MPI.Comm, N: int = 16, **parameters: float) -> Scene:
    """Return the scene with N cells along the foot, a multiple of 8. Collective.

    `parameters` are further parameters of the .geo file. `data` has the `load` [kN] on two cells of
    the arm, the coordinate `x` [m] of their middle, the `pull` at the foot along y [kN], and the
    slip bound `adhesion` [kPa].
    """
    M = 9 * N // 4  # cells along the clay
    if parameters.get("Hex") == 0:
        M += 1 - M % 2  # odd, lest Gmsh glues tetrahedra of foot and clay
    sizes = {"N": N, "M": M, "Side": SIDE, "Foot": FOOT, "Thick": THICK, "Post": POST, "Arm": ARM}
    crane = read_gmsh(MESHES / "floating_block.geo", comm, **{**sizes, **parameters})
    trolley = 2 * SIDE / N  # m, whole cells: the load is integrated exactly
    return on_crane(crane, trolley)


def on_crane(crane: TaggedMesh, trolley: float, *, degree: int = 1) -> Scene:
    """Return the scene on any mesh of crane and clay, such as a refined one. Collective.

    Args:
        crane: mesh with the names of the .geo file.
        trolley: length of the loaded part of the arm [m].
        degree: degree of the displacement.
    """
    mesh, facet_tags, tags = crane.mesh, crane.facet_tags, crane.tags
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    load, place, pull, adhesion = (
        fem.Constant(mesh, default_scalar_type(value)) for value in (50.0, 1.0, 30.0, ADHESION)
    )
    v = ufl.TestFunction(V)
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=crane.cell_tags)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facet_tags)
    on_trolley = ufl.lt(abs(ufl.SpatialCoordinate(mesh)[0] - place), trolley / 2)
    on_arm = ufl.conditional(on_trolley, load / (trolley * THICK), 0.0)
    L = -UNIT_WEIGHT * v[2] * dx(tags["crane"])
    L += -on_arm * v[2] * ds(tags["arm_top"])
    L += pull / (SIDE * FOOT) * v[1] * ds(tags["foot_pulled"])
    bcs = [fixed(V, facet_tags.find(tags["clay_fixed"]), np.zeros(3))]
    pair = ContactPair(
        facet_tags,
        secondary=tags["foot_contact"],
        primary=tags["clay_contact"],
        friction=Tresca(adhesion),
    )
    young, poisson = by_body(crane, YOUNG), by_body(crane, POISSON)
    a = elasticity(V, young, poisson)
    data = SimpleNamespace(load=load, x=place, pull=pull, adhesion=adhesion)
    data.young, data.poisson, data.bodies = young, poisson, tuple(YOUNG)
    return Scene(V, a, L, bcs, [pair], facet_tags, crane.cell_tags, tags, data)
