"""Solve partial slip of two cylinders: the scene of `tests/validation/test_cattaneo.py`."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, half_ellipse, next_step

from scenes.cattaneo import COEFFICIENT, Cattaneo, cattaneo
from scenes.cattaneo_cycle import AMPLITUDE, APPROACH, Found

#: Half width of the stick zone divided by that of the contact, for the shear force of this shift.
RATIO = 0.3554


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along a body; on one rank."""
    scene = cattaneo(comm, 2, int(n), approach=APPROACH[2])
    with scene.problem(stiffness="cholesky") as problem:
        for shift in (0.0, AMPLITUDE[2] * APPROACH[2]):
            scene.data.end.value[0] = shift
            found = Found.of(next_step(problem), 2)
    normal, tangential = found.force(found.pressure), found.force(found.traction)
    theory, sign = Cattaneo(2, normal, abs(tangential)), np.sign(tangential)
    short = COEFFICIENT * found.pressure - sign * found.traction
    values = CASE.named(
        found.dome_radius(found.pressure) / theory.radius,
        found.dome_radius(short) / theory.stick_radius(tangential),
    )
    order = np.argsort(found.r)
    order = order[found.r[order] < 1.2 * theory.radius]
    shear = sign * found.traction[order] / (COEFFICIENT * theory.peak)
    return Result(values, scene.V, found.r[order] / theory.radius, shear)


X = np.linspace(0.0, 1.2, 481)
CASE = Case.read(__file__, solve, curve=(X, half_ellipse(X) - RATIO * half_ellipse(X / RATIO)))
