"""A ring shrunk on a hollow shaft, with meshes that do not match: Lamé's solution.

    tools/fenicsx python3 benchmarks/published_cases/shrink_fit.py 32

S. Timoshenko and J. N. Goodier, Theory of Elasticity, section 28, in plane strain. The argument is
the number of cells round a quarter of the ring.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, exactly

from dolfinx import fem

from dolfinx_tresca import MESHES, ContactPair, ContactProblem, Frictionless, read_gmsh
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.nodal import gathered, surface_nodes_of

BORE, RADIUS, RIM, INTERFERENCE = 10.0, 20.0, 40.0, 0.02  # mm
YOUNG, POISSON = {"ring": 70_000.0, "shaft": 210_000.0}, 0.3  # MPa


def lame_pressure() -> float:
    """Return the contact pressure [MPa] of Lamé's solution."""
    rigidity = {body: young / (1 - POISSON**2) for body, young in YOUNG.items()}
    effective = POISSON / (1 - POISSON)  # Poisson's ratio of plane strain
    ring = ((RIM**2 + RADIUS**2) / (RIM**2 - RADIUS**2) + effective) / rigidity["ring"]
    shaft = ((RADIUS**2 + BORE**2) / (RADIUS**2 - BORE**2) - effective) / rigidity["shaft"]
    return INTERFERENCE / (RADIUS * (ring + shaft))


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells round a quarter of the ring. Collective."""
    fit = read_gmsh(
        MESHES / "shrink_fit.geo",
        comm,
        N=int(n),
        M=3 * int(n) // 4 + 1,
        Bore=BORE,
        Radius=RADIUS,
        Rim=RIM,
        Interference=INTERFERENCE,
    )
    facets, tags = fit.facet_tags, fit.tags
    V = fem.functionspace(fit.mesh, ("Lagrange", 1, (2,)))
    pair = ContactPair(
        facets,
        secondary=tags["ring_contact"],
        primary=tags["shaft_contact"],
        friction=Frictionless(),
        geometry=fit.geometry,
    )
    bcs = [
        fixed(V, facets.find(tags[f"{body}_{axis}"]), 0.0, component)
        for body in ("ring", "shaft")
        for component, axis in enumerate("xy")
    ]
    a = elasticity(V, by_body(fit, YOUNG), POISSON)
    with ContactProblem(a, no_load(V), [pair], bcs) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        x, fields = surface_nodes_of(solution)
        angle = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
        angle, p, weights = gathered(comm, angle, fields["pressure"], fields["weights"])
    order = np.argsort(angle)
    mean = float(weights @ p) / float(weights.sum())
    return Result({"mean pressure [MPa]": mean}, V, angle[order], p[order])


LAME = lame_pressure()
CASE = Case(
    name="shrink_fit",
    title="Shrink fit",
    published={"mean pressure [MPa]": exactly(LAME)},
    source="formula",
    argument="cells round a quarter",
    sizes=(16, 32, 64),
    solve=solve,
    axes=("angle [degrees]", "pressure [MPa]"),
    curve=(np.array([0.0, 90.0]), np.array([LAME, LAME])),
)

if __name__ == "__main__":
    CASE.main()
