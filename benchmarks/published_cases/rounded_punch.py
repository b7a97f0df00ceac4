"""A steel punch with a rounded edge on an aluminium foundation: NAFEMS R0094, benchmark 2.

    tools/fenicsx python3 benchmarks/published_cases/rounded_punch.py 0.5

A. Konter, Advanced finite element contact benchmarks, NAFEMS R0094, 2006; solved as bodies of
revolution, without friction and with F = 0.1. Published values are those of Code_Aster's tests
`ssna122a` (cells of degree 1) and `ssna122b` (degree 2), in the manual V6.01.122 (SSNA122): the
displacement of the middle of the foundation, and the axial stress there. Our displacement is the
value at the node where the axis meets the surface; our pressure is the value, in the middle, of an
even function that is fitted to the inner half of the flat face. The argument is the cell size [mm]
at the end of the flat face.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, Frictionless, read_gmsh
from scenes.elasticity import by_body, fixed
from scenes.nodal import gathered, nodal, surface_nodes_of
from scenes.revolution import ring_elasticity

YOUNG, POISSON, COEFFICIENT = {"punch": 210_000.0, "foundation": 70_000.0}, 0.3, 0.1  # MPa, -, -
LOAD, STEPS = 100.0, 2  # MPa, number of load steps as in Code_Aster

#: Case -> displacements [mm] of the middle, and pressures [MPa] there, for degrees 1 and 2.
PUBLISHED = {
    "": {"degree 1": (0.130734, 91.1006), "degree 2": (0.132941, 94.1221)},
    ", F = 0.1": {"degree 1": (0.128580, 88.6656), "degree 2": (0.130794, 95.4740)},
}
QUANTITIES = ("displacement of the middle [mm]", "pressure in the middle [MPa]")


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the end of the flat face. Collective."""
    bodies = read_gmsh(Path(__file__).with_name("rounded_punch.geo"), comm, h=h, Growth=0.4 * h)
    facets, tags = bodies.facet_tags, bodies.tags
    V = fem.functionspace(bodies.mesh, ("Lagrange", 2, (2,)))
    r = ufl.SpatialCoordinate(bodies.mesh)[0]
    top = ufl.Measure("ds", bodies.mesh, subdomain_data=facets, subdomain_id=tags["top"])
    load = fem.Constant(bodies.mesh, 0.0)
    L = -load * ufl.TestFunction(V)[1] * 2 * np.pi * r * top
    a = ring_elasticity(V, by_body(bodies, YOUNG), POISSON)
    bcs = [fixed(V, facets.find(tags["bottom"])), fixed(V, facets.find(tags["axis"]), 0.0, 0)]
    values = {}
    for name, friction in zip(PUBLISHED, (Frictionless(), Coulomb(COEFFICIENT)), strict=True):
        pair = ContactPair(
            facets,
            tags["punch_contact"],
            tags["foundation_contact"],
            friction,
            geometry=bodies.geometry,
        )
        with ContactProblem(a, L, [pair], bcs, axisymmetric=True) as problem:
            for step in range(STEPS):
                load.value = LOAD * (step + 1) / STEPS
                solution = problem.solve(rtol=RTOL)
                solution.raise_if_failed()
                problem.accept()
        points, fields = surface_nodes_of(solution)
        x, p = gathered(comm, points[:, 0], fields["pressure"])
        order = np.argsort(x)
        x, p = x[order], p[order]
        inside = x < 20.0
        found = (middle(comm, V, solution.u), float(np.polyfit(x[inside] ** 2, p[inside], 2)[-1]))
        values |= {f"{one}{name}": value for one, value in zip(QUANTITIES, found, strict=True)}
    return Result(values, V, x, p)


def middle(comm: MPI.Comm, V: fem.FunctionSpace, u: fem.Function) -> float:
    """Return the downward displacement of the middle of the foundation's surface. Collective."""
    x = V.tabulate_dof_coordinates()[: len(nodal(u))]
    at = np.flatnonzero(np.hypot(x[:, 0], x[:, 1]) < 1e-9)
    (found,) = gathered(comm, nodal(u)[at, 1])  # equal in both bodies
    return float(-found.mean())


CASE = Case(
    name="rounded_punch",
    title="Punch with a rounded edge",
    published={
        f"{one}{name}": by_group({f"Code_Aster, {key}": pair[i] for key, pair in both.items()})
        for name, both in PUBLISHED.items()
        for i, one in enumerate(QUANTITIES)
    },
    source="programs",
    argument="cells at the end of the flat face [mm]",
    sizes=(1.0, 0.5, 0.25),
    solve=solve,
    order=1.0,
    axes=("radius [mm]", "pressure with F = 0.1 [MPa]"),
    marks=([0.0, 0.0], [88.6656, 95.4740]),
)

if __name__ == "__main__":
    CASE.main()
