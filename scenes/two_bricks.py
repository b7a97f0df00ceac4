"""Two bricks, one on the other, under a pressure: the scene of the paper. Lengths in m, MPa."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import ufl
from dolfinx import fem

from dolfinx_tresca import MESHES, ContactPair, ContactProblem, TaggedMesh, Tresca, read_gmsh
from dolfinx_tresca.scene.friction import ScalarField
from scenes.elasticity import by_body, elasticity, fixed
from scenes.scene import Scene

YOUNG = 50_000.0  # MPa, both bricks
POISSON = {"upper": 0.277, "lower": 0.35}
SLIP_BOUND = 0.09  # MPa

#: The two readings of the paper's text on where the second load acts; the sticking nodes differ.
ENDS = {"free_end_1": "upper_free_end", "free_end_2": "lower_free_end"}


def two_bricks(
    comm: MPI.Comm,
    N: int = 16,
    *,
    end: str = "free_end_1",
    hexahedra: bool = False,
    degree: int = 1,
    slip_bound: ScalarField = SLIP_BOUND,
    **parameters: float,
) -> Scene:
    """Return the scene with N cells along each brick. Collective.

    Args:
        comm: communicator of the mesh.
        N: cells along each brick.
        end: see `on_bricks`.
        hexahedra: whether cells are hexahedra; otherwise tetrahedra.
        degree: degree of the displacement.
        slip_bound: slip bound of the pair [MPa].
        parameters: further parameters of the .geo file.
    """
    bricks = read_gmsh(MESHES / "two_bricks.geo", comm, N=N, Hex=int(hexahedra), **parameters)
    return on_bricks(bricks, end=end, degree=degree, slip_bound=slip_bound)


def on_bricks(
    bricks: TaggedMesh,
    *,
    end: str = "free_end_1",
    degree: int = 1,
    slip_bound: ScalarField = SLIP_BOUND,
) -> Scene:
    """Return the scene on any mesh of the bricks, such as a refined one. Collective.

    Args:
        bricks: mesh with the names of the .geo file.
        end: where the second load acts, see `ENDS`.
        degree: degree of the displacement.
        slip_bound: slip bound of the pair [MPa].

    Returns:
        The scene; `data` has the `load` [MPa], `young`, `poisson`, and the names of the `bodies`.
    """
    mesh, facet_tags, tags = bricks.mesh, bricks.facet_tags, bricks.tags
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    poisson = by_body(bricks, POISSON)
    load = fem.Constant(mesh, (0.0, 0.0, -1.0))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facet_tags)
    L = ufl.inner(load, ufl.TestFunction(V)) * ds((tags["upper_top"], tags[ENDS[end]]))
    bcs = [fixed(V, facet_tags.find(tags[name])) for name in ("upper_fixed", "lower_fixed")]
    pair = ContactPair(
        facet_tags,
        secondary=tags["upper_contact"],
        primary=tags["lower_contact"],
        friction=Tresca(slip_bound),
    )
    data = SimpleNamespace(load=load, young=YOUNG, poisson=poisson, bodies=tuple(POISSON))
    a = elasticity(V, YOUNG, poisson)
    return Scene(V, a, L, bcs, [pair], facet_tags, bricks.cell_tags, tags, data)


def bricks_problem(
    comm: MPI.Comm, N: int = 4, *, options: dict[str, Any] | None = None, **scene: Any
) -> ContactProblem:
    """Return the problem of the two bricks; `options` go to ContactProblem. Collective."""
    return two_bricks(comm, N, **scene).problem(**(options or {}))


def floating(comm: MPI.Comm, body: str, N: int = 3) -> Scene:
    """Return the scene with one brick, `body`, held by contact alone. Collective."""
    scene = two_bricks(comm, N)
    held = "lower_fixed" if body == "upper" else "upper_fixed"
    return replace(scene, bcs=[scene.fixed(held)])
