"""A steel cylinder on an aluminium block, without friction: NAFEMS R0094, benchmark 1.

    tools/fenicsx python3 benchmarks/published_cases/roller.py 0.2

A. Konter, Advanced finite element contact benchmarks, NAFEMS R0094, 2006. Plane strain; the
published values are those of Hertz for half-planes. The argument is the cell size at the contact
[mm].
"""

from __future__ import annotations

import math
from pathlib import Path

from mpi4py import MPI

import numpy as np
from case import Case, Result

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Frictionless, read_gmsh
from scenes.elasticity import by_body, elasticity, fixed
from scenes.hertz_theory import HertzLine
from scenes.nodal import surface_nodes_of

FORCE, RADIUS = 35_000.0, 50.0  # N per mm of thickness, mm
YOUNG, POISSON = {"cylinder": 210_000.0, "block": 70_000.0}, 0.3  # MPa

HERTZ = HertzLine(FORCE, RADIUS, 1 / sum((1 - POISSON**2) / young for young in YOUNG.values()))


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the contact. Collective."""
    roller = read_gmsh(Path(__file__).with_name("roller.geo"), comm, R=RADIUS, h=h)
    facets, tags = roller.facet_tags, roller.tags
    V = fem.functionspace(roller.mesh, ("Lagrange", 1, (2,)))
    top = ufl.Measure("ds", roller.mesh, subdomain_data=facets, subdomain_id=tags["top"])
    length = RADIUS * math.asin(0.2)  # of the loaded arc of half the cylinder
    load = fem.Constant(roller.mesh, (0.0, -0.5 * FORCE / length))
    pair = ContactPair(
        facets,
        secondary=tags["cylinder_contact"],
        primary=tags["block_contact"],
        friction=Frictionless(),
        geometry=roller.geometry,
    )
    a = elasticity(V, by_body(roller, YOUNG), POISSON)
    L = ufl.inner(load, ufl.TestFunction(V)) * top
    bcs = [fixed(V, facets.find(tags["bottom"])), fixed(V, facets.find(tags["symmetry"]), 0.0, 0)]
    with ContactProblem(a, L, [pair], bcs) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
        x, fields = surface_nodes_of(solution)
        x, p, weights = (
            np.concatenate(comm.allgather(one))
            for one in (x[:, 0], fields["pressure"], fields["weights"])
        )
    order = np.argsort(x)
    x, p, weights = x[order], p[order], weights[order]
    # a half ellipse has the second moment a^2 / 4
    half_width = 2 * math.sqrt(float(weights @ (p * x**2)) / float(weights @ p))
    return Result({"peak pressure [MPa]": float(p.max()), "half width [mm]": half_width}, x, p)


R = np.linspace(0.0, 8.0, 200)
CASE = Case(
    name="roller",
    title="Roller on a block",
    published={
        "peak pressure [MPa]": (HERTZ.peak, HERTZ.peak),
        "half width [mm]": (HERTZ.contact_radius, HERTZ.contact_radius),
    },
    sizes=(0.8, 0.4, 0.2),
    solve=solve,
    axes=("distance from the middle [mm]", "pressure [MPa]"),
    curve=(R, HERTZ.pressure(R)),
)

if __name__ == "__main__":
    CASE.main()
