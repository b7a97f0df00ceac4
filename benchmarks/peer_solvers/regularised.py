"""Penalty method and augmented Lagrangians, as in tutorials of finite element codes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import diags_array, vstack

from peer_solvers.discrete import Answer, Primal, load_steps
from peer_solvers.monolithic import lu_solve, projection

#: Number of Newton steps after which a load step counts as failed, and the residual, divided by the
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
    """Solve each load step from multipliers and states of the one before."""
    steps = load_steps(scene)
    m, nodes = len(steps[0].gap), np.concatenate([steps[0].size, steps[0].size[steps[0].node]])
    c = factor * scene.data.modulus / nodes
    x, slipped = np.zeros(len(c)), np.zeros(len(c) - m)
    y = np.where(np.arange(len(c)) < m, 1.0, 0.0)  # at first all nodes touch and stick
    found, updates, factorisations, converged = [], 0, 0, True
    for data in steps:
        start = x if np.isfinite(tolerance) else np.zeros(len(c))  # the penalty method has none
        gap = np.concatenate([data.gap, data.slip + slipped])
        x, y, work = _load_step(data, gap, c, tolerance, start, y)
        slipped += (y - x)[m:] / c[m:]  # what is left of the jump is elastic
        found.append(x)
        updates, factorisations = updates + work[0], factorisations + work[1]
        converged = converged and work[1] < MOST
    note = "converged" if converged else "no convergence"
    work = {"iterations": updates, "factorisations": factorisations}
    return Answer(np.squeeze(found), work, note)


def _load_step(
    data: Primal,
    gap: np.ndarray,
    c: np.ndarray,
    tolerance: float,
    multipliers: np.ndarray,
    y: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Return x = P(y), y, and the numbers of updates of the multipliers and factorisations.

    The first Newton step is linear: contact and slip are those of the given y.
    """
    B = vstack([data.N, data.T], format="csr")
    x, D = projection(data, y, None)
    constant = x + D @ (multipliers - c * gap - y)
    u = lu_solve((data.K + B.T @ D @ diags_array(c) @ B).tocsr(), data.f - B.T @ constant)
    steps, updates = 1, 0

    def stress(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, Any, float]:
        """Return y, P(y), its derivative and the energy, which is convex."""
        y = multipliers + c * (B @ u - gap)
        x, D = projection(data, y, None)
        spring = float(np.sum((y**2 - (y - x) ** 2) / (2.0 * c)))
        return y, x, D, float(u @ (0.5 * (data.K @ u) - data.f)) + spring

    while True:
        y, x, D, energy = stress(u)
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
        while length > SHORTEST and stress(u - length * step)[3] > energy:
            length *= 0.5
        u, steps = u - length * step, steps + 1
    return x, y, (updates, steps)
