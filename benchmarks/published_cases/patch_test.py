"""Solve the patch test: kinds of cells, degrees 1 and 2, meshes that match or not."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface

from scenes.patches import KINDS, patch

#: Relative residual at which solves end: the error of multipliers is about this times the condition
#: number of A.
RTOL = 1e-12

PAIRINGS = (("nodes", 1), ("mortar", 1), ("mortar", 2))


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the contact of the upper block. Collective."""
    values = []
    curve = {}
    for pairing, degree in PAIRINGS:
        ratios = []
        for kind in KINDS:
            across = int(n) + (pairing == "mortar")
            shape = {"upper": (int(n), 1), "lower": (across, 2)}
            scene = patch(
                comm, kind, degree, pairing=pairing, distort=0.3 * (pairing == "mortar"), **shape
            )
            with scene.problem() as problem:
                solution = problem.solve(rtol=RTOL)
                solution.raise_if_failed()
            x, pressure = along_surface(comm, solution, "pressure")
            ratios.append(pressure / scene.data.pressure)
            curve[kind] = x, ratios[-1]
        off = max(float(np.abs(one - 1.0).max()) for one in ratios)
        values.append(1.0 + off)
    x, ratio = curve["quadrilateral"]  # the picture shows the last pairing
    return Result(CASE.named(*values), scene.V, x, ratio)


CASE = Case.read(__file__, solve, curve=(np.array([0.0, 1.0]), np.ones(2)))
