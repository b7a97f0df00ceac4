"""An elastic half cylinder under a constant pressure, on a rigid plane: a test of Kratos.

    tools/fenicsx python3 benchmarks/published_cases/kratos_cylinder.py 0.04

The test `hertz_simple_test` of Kratos Multiphysics (ContactStructuralMechanicsApplication, folder
`tests/ALM_frictionless_contact_test_2D`): a half disc of radius 8 in plane strain, E = 200, whose
flat side is loaded by a pressure of 0.2. The values are displacements of nodes of the round side,
from `hertz_simple_test_results.json`; the coordinates of the nodes are in `hertz_simple_test.mdpa`.
Cells are of degree 1, eleven along the half width of the contact. The flat side is held sideways:
the parameters of the test do not say so, but with this condition the displacements downwards agree
to 0.1 %, and without it the displacements across would be 1.5 times as large. The argument is the
cell size at the contact.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Frictionless,
    RigidPlane,
    read_gmsh,
)
from scenes.elasticity import elasticity, fixed
from scenes.nodal import gathered, nodal

RADIUS, YOUNG, POISSON, PRESSURE = 8.0, 200.0, 0.3, 0.2

#: Distance of a node from the middle -> its displacement in Kratos, across and down.
KRATOS = {
    2.0: (0.002103428, 0.026132391),
    1.70406: (0.002420453, 0.024685001),
    1.40566: (0.002725812, 0.022905768),
}

#: Distance from the middle up to which the picture shows displacements.
SHOWN = 2.2


def quantity(direction: str, place: float) -> str:
    """Return the name of a displacement."""
    return f"displacement {direction} at {place:g}"


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the contact. Collective."""
    disc = read_gmsh(
        MESHES / "half_disc.geo", comm, R=RADIUS, h=h, Zone=0.6, Arc=2.05, Growth=2 * h
    )
    facets, tags = disc.facet_tags, disc.tags
    V = fem.functionspace(disc.mesh, ("Lagrange", 2, (2,)))
    cut = ufl.Measure("ds", disc.mesh, subdomain_data=facets, subdomain_id=tags["cut"])
    L = -fem.Constant(disc.mesh, PRESSURE) * ufl.TestFunction(V)[1] * cut
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    pair = ContactPair(facets, tags["contact"], plane, Frictionless(), geometry=disc.geometry)
    bcs = [fixed(V, facets.find(tags[name]), 0.0, 0) for name in ("symmetry", "cut")]
    with ContactProblem(elasticity(V, YOUNG, POISSON), L, [pair], bcs) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        u = nodal(solution.u)
        x = V.tabulate_dof_coordinates()[: len(u)]
        on_arc = np.flatnonzero((x[:, 1] < 1.0) & (np.hypot(x[:, 0], x[:, 1] - 8.0) > 8.0 - h**2))
        along, u = gathered(comm, x[on_arc, 0], u[on_arc])
    order = np.argsort(along)
    values = {}
    for where in KRATOS:
        across, down = (-np.interp(where, along[order], u[order, i]) for i in range(2))
        values |= {quantity("across", where): abs(across), quantity("down", where): down}
    near = order[np.abs(along[order]) < SHOWN]
    return Result(values, V, along[near], -u[near, 1])


CASE = Case(
    name="kratos_cylinder",
    title="Half cylinder, of Kratos",
    published={
        quantity(direction, place): by_group({"Kratos": value})
        for place, both in KRATOS.items()
        for direction, value in zip(("across", "down"), both, strict=True)
    },
    source="programs",
    argument="cells at the contact",
    sizes=(0.04, 0.02, 0.01),
    solve=solve,
    axes=("distance from the middle", "displacement down"),
    marks=(list(KRATOS), [down for _, down in KRATOS.values()]),
)

if __name__ == "__main__":
    CASE.main()
