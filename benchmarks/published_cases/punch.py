"""Solve the flat punch that sticks."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface, bodies, next_step, pair_of

from dolfinx_tresca import Bonded, ContactProblem, RigidPlane

YOUNG, POISSON = 1.0, 0.0
DEPTH = 1e-3  # motion of the far end towards the punch, divided by the half width


def under_punch(comm: MPI.Comm, h: float, friction: Any) -> ContactProblem:
    """Return a half-plane under the punch with a law of friction. Collective.

    Args:
        comm: communicator of the mesh.
        h: size of the cells at the edge of the punch, divided by the punch's half width.
        friction: the law.
    """
    half = bodies(comm, "punch.geo", YOUNG, POISSON, 1, h=h)
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, -1.0))
    bcs = [half.fixed("bottom", (0.0, DEPTH)), half.fixed("symmetry", 0.0, 0)]
    return replace(half, bcs=bcs, pairs=[pair_of(half, "contact", plane, friction)]).problem()


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the edge of the punch. Collective."""
    with under_punch(comm, h, Bonded()) as problem:
        solution = next_step(problem)
        x, p, weights = along_surface(comm, solution, "pressure", "weights")
    p = p * math.pi / (2 * float(weights @ p))  # over P / (pi a)
    # fit an even function of x, since single nodes differ from their neighbours
    inside = x < 0.3
    middle = float(np.polyfit(x[inside] ** 2, p[inside], 2)[-1])
    return Result(CASE.named(middle), solution.u.function_space, x, p)


def theory(x: np.ndarray) -> np.ndarray:
    """Return pressures divided by P / (pi a), at distances x from the middle, divided by a."""
    phase = math.log(3 - 4 * POISSON) / (2 * math.pi) * np.log((1 + x) / (1 - x))
    factor = 2 * (1 - POISSON) / math.sqrt(3 - 4 * POISSON)
    pressure: np.ndarray = factor * np.cos(phase) / np.sqrt(1 - x**2)
    return pressure


X = np.linspace(0.0, 0.98, 200)
CENTRE = float(theory(np.zeros(1))[0])
CASE = Case.read(__file__, solve, CENTRE, curve=(X, theory(X)))
