"""Find the force that pushes a block up an incline, by bisection."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np
from case import GROUND, RTOL, Case, Result, tags_of_sides

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, InputError
from scenes.elasticity import elasticity

SLOPE, COEFFICIENT = 0.1, 0.3
YOUNG, POISSON = 1e4, 0.3  # MPa
LENGTH, HEIGHT = 4.0, 1.0  # mm
WEIGHT = 1.0  # N per mm of thickness
LIMIT = (SLOPE + COEFFICIENT) / (1 - COEFFICIENT * SLOPE)

#: Width of the interval at which the bisection ends, divided by the limit force.
WIDTH = 1e-5


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the block. Collective."""
    block = mesh.create_rectangle(comm, [[0.0, 0.0], [LENGTH, HEIGHT]], [int(n), int(n) // 2])
    tags = tags_of_sides(block, {1: lambda x: np.isclose(x[1], 0.0)})
    V = fem.functionspace(block, ("Lagrange", 1, (2,)))
    v = ufl.TestFunction(V)
    along = np.array([1.0, SLOPE]) / math.hypot(1.0, SLOPE)  # direction along the slope
    weight = WEIGHT / (LENGTH * HEIGHT) * np.array([-along[1], -along[0]])
    push = WEIGHT / (LENGTH * HEIGHT) * np.array([along[0], -along[1]])
    factor = fem.Constant(block, 0.0)
    L = sum(
        (fem.Constant(block, w) + factor * fem.Constant(block, p)) * v[i] * ufl.dx
        for i, (w, p) in enumerate(zip(weight, push, strict=True))
    )
    pair = ContactPair(tags, 1, GROUND, Coulomb(COEFFICIENT))
    loads, friction = [], []
    with ContactProblem(elasticity(V, YOUNG, POISSON), L, [pair], []) as problem:
        low, high = 0.0, 1.0
        while high - low > WIDTH * LIMIT:
            factor.value = 0.5 * (low + high)
            try:
                solution = problem.solve(rtol=RTOL)
            except InputError as error:
                assert "no contact forces balance the loads" in str(error)
                high = float(factor.value)
            else:
                solution.raise_if_failed()
                low = float(factor.value)
                loads.append(low)
                friction.append(abs(float(solution.pair_resultants[0].force[0])))
    order = np.argsort(loads)
    return Result(CASE.named(low), V, np.array(loads)[order], np.array(friction)[order])


F = np.linspace(0.0, LIMIT, 200)
CASE = Case.read(
    __file__, solve, LIMIT, resolution=WIDTH, curve=(F, np.abs(F - SLOPE) / math.hypot(1.0, SLOPE))
)
