"""Penalty method and augmented Lagrangians, as in tutorials of finite element codes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import diags_array, vstack

from peer_solvers.discrete import Answer, primal_problem
from peer_solvers.monolithic import lu_solve, projection

#: Number of Newton steps after which a solve counts as failed, and the residual, divided by the
#: load, at which it ends.
MOST, EQUILIBRIUM = 200, 1e-8

#: Shortest part of a Newton step: steps are halved until the energy falls.
SHORTEST = 1e-3

#: The penalty of augmented Lagrangians, divided by E / h.
AUGMENTED = 10.0


def penalty(scene: Any, tolerance: float) -> Answer:
    """Solve K u + B'P(c (B u - d)) = f with c = E / (h tolerance), by damped Newton steps.

    Method: Kikuchi, Oden (1988). The errors of penetration and stick are proportional to 1 / c.
    """
    return _solve(scene, 1.0 / tolerance, np.inf)


def augmented(scene: Any, tolerance: float) -> Answer:
    """Solve by Uzawa's method: penalty solves with multipliers lambda, updated after each solve.

    The update is lambda = P(lambda + c (B u - d)) (Alart, Curnier 1991; Simo, Laursen 1992). The
    iteration ends when lambda changes by at most a part of its norm.
    """
    return _solve(scene, AUGMENTED, tolerance)


def _solve(scene: Any, factor: float, tolerance: float) -> Answer:
    data = primal_problem(scene)
    B = vstack([data.N, data.T], format="csr")
    gap = np.concatenate([data.gap, data.slip])
    c = factor * scene.data.modulus / np.concatenate([data.size, data.size[data.node]])
    multipliers = np.zeros(len(c))
    normal = np.where(np.arange(len(c)) < len(data.gap), 1.0, 0.0)
    _, D = projection(data, normal, None)  # at first all nodes touch and stick
    u = lu_solve((data.K + B.T @ D @ diags_array(c) @ B).tocsr(), data.f + B.T @ (D @ (c * gap)))
    steps, updates = 1, 0

    def stress(u: np.ndarray) -> tuple[np.ndarray, Any, float]:
        """Return P(y), its derivative and the energy, which is convex."""
        y = multipliers + c * (B @ u - gap)
        x, D = projection(data, y, None)
        spring = float(np.sum((y**2 - (y - x) ** 2) / (2.0 * c)))
        return x, D, float(u @ (0.5 * (data.K @ u) - data.f)) + spring

    while True:
        x, D, energy = stress(u)
        residual = data.K @ u + B.T @ x - data.f
        if np.linalg.norm(residual) <= EQUILIBRIUM * np.linalg.norm(data.f):
            change, multipliers, updates = np.linalg.norm(x - multipliers), x, updates + 1
            if change <= tolerance * np.linalg.norm(x):
                break
            continue
        if steps == MOST:
            break
        step = lu_solve((data.K + B.T @ D @ diags_array(c) @ B).tocsr(), residual)
        length = 1.0
        while length > SHORTEST and stress(u - length * step)[2] > energy:
            length *= 0.5
        u, steps = u - length * step, steps + 1
    work = {"iterations": updates, "factorisations": steps}
    return Answer(x, work, "converged" if steps < MOST else "no convergence")
