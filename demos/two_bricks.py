"""The scene of the paper, section 38.5: two bricks, one on top of the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, TaggedMesh, Tresca, read_gmsh
from dolfinx_tresca.friction import ScalarField

GEOMETRY = Path(__file__).parents[1] / "meshes" / "two_bricks.geo"

#: Young's modulus of both bricks [MPa]
YOUNG = 50_000.0
#: Poisson's ratio of the bricks
POISSON = {"upper": 0.277, "lower": 0.35}
#: slip bound [MPa]
SLIP_BOUND = 0.09
#: which free end is loaded besides the top: the paper's text allows both readings
ENDS = {"free_end_1": "upper_free_end", "free_end_2": "lower_free_end"}


@dataclass(frozen=True)
class Scene:
    """Forms, supports and the pair of surfaces; lengths in m, stresses in MPa, energies in MN m.

    Attributes:
        bricks: mesh and tags.
        V: function space.
        a: bilinear form.
        L: linear form.
        bcs: the fixed ends.
        pair: the contact.
        load: surface traction on the loaded faces [MPa], `fem.Constant`.
    """

    bricks: TaggedMesh
    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    load: Any


def two_bricks(
    comm: MPI.Comm,
    N: int = 16,
    *,
    end: str = "free_end_1",
    hexahedra: bool = False,
    slip_bound: ScalarField = SLIP_BOUND,
    **parameters: float,
) -> Scene:
    """Return the scene on a mesh with N cells along each brick. Collective.

    Args:
        comm: communicator of the mesh.
        N: cells along each brick; N - 1 across.
        end: "free_end_1" or "free_end_2", see `ENDS`.
        hexahedra: trilinear hexahedra in place of tetrahedra.
        slip_bound: g [MPa].
        **parameters: others of `meshes/two_bricks.geo`.
    """
    bricks = read_gmsh(GEOMETRY, comm, N=N, Hex=int(hexahedra), **parameters)
    mesh, tags = bricks.mesh, bricks.tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

    poisson = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    for name, value in POISSON.items():
        poisson.x.array[bricks.cell_tags.find(tags[name])] = value
    mu = YOUNG / (2 * (1 + poisson))
    lame = YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
    load = fem.Constant(mesh, (0.0, 0.0, -1.0))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=bricks.facet_tags)
    L = ufl.inner(load, v) * ds((tags["upper_top"], tags[ENDS[end]]))
    bcs = [
        fem.dirichletbc(
            np.zeros(3),
            fem.locate_dofs_topological(V, 2, bricks.facet_tags.find(tags[name])),
            V,
        )
        for name in ("upper_fixed", "lower_fixed")
    ]
    pair = ContactPair(
        bricks.facet_tags,
        secondary=tags["upper_contact"],
        primary=tags["lower_contact"],
        friction=Tresca(slip_bound),
    )
    return Scene(bricks, V, a, L, bcs, pair, load)
