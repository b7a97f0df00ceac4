"""Solve the shrink fit."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import Case, Result, bodies, next_step, pair_of

from dolfinx_tresca import MESHES, Frictionless
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
    cells = {"N": int(n), "M": 3 * int(n) // 4 + 1}
    shape = {"Bore": BORE, "Radius": RADIUS, "Rim": RIM, "Interference": INTERFERENCE}
    fit = bodies(comm, MESHES / "shrink_fit.geo", YOUNG, POISSON, 1, **cells, **shape)
    bcs = [
        fit.fixed(f"{body}_{axis}", 0.0, component)
        for body in ("ring", "shaft")
        for component, axis in enumerate("xy")
    ]
    pair = pair_of(fit, "ring_contact", "shaft_contact", Frictionless())
    with replace(fit, bcs=bcs, pairs=[pair]).problem() as problem:
        solution = next_step(problem)
        x, fields = surface_nodes_of(solution)
    angle = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
    angle, p, weights = gathered(comm, angle, fields["pressure"], fields["weights"])
    order = np.argsort(angle)
    mean = float(weights @ p) / float(weights.sum())
    return Result(CASE.named(mean), fit.V, angle[order], p[order])


LAME = lame_pressure()
CASE = Case.read(__file__, solve, LAME, curve=(np.array([0.0, 90.0]), np.array([LAME, LAME])))
