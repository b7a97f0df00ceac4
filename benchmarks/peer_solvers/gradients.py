"""First-order methods for the dual problem, with one or two products with A in each iteration."""

from __future__ import annotations

from typing import Any

import numpy as np

from peer_solvers.discrete import Answer, residual_norm
from scenes.assembled import dual_program


def fista(scene: Any, rtol: float) -> Answer:
    """Solve by accelerated projected gradients, with a restart if a step leads uphill.

    Method: Beck, Teboulle (2009); restart by the gradient scheme of O'Donoghue and Candes (2015).
    """
    with dual_program(scene) as dual:
        project = dual.admissible.project
        rho, residual = residual_norm(dual)
        x = before = np.zeros_like(dual.b)
        product = product_before = np.zeros_like(dual.b)
        t, iterations = 1.0, 0
        while residual(x, product - dual.b) > rtol:
            iterations += 1
            t_next = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
            beta = (t - 1.0) / t_next
            y = x + beta * (x - before)
            gradient = product + beta * (product - product_before) - dual.b
            before, product_before = x, product
            x = project(y - rho * gradient)
            product = dual.compliance.apply(x)
            t = 1.0 if (y - x) @ (x - before) > 0.0 else t_next
        _displacement(dual, x)
        return Answer(x, _work(dual, iterations))


def mpgp(scene: Any, rtol: float) -> Answer:
    """Solve by MPGP: modified proportioning with gradient projections.

    Dostal, Kozubek: "An optimal algorithm and superrelaxation for minimization of a quadratic
    function subject to separable convex constraints with applications" (2012); proportioning
    constant 1. Conjugate gradients hold all multipliers that are on a bound or on their circle;
    gradient projections move and free these multipliers.
    """
    with dual_program(scene) as dual:
        bounds = dual.admissible
        rho, residual = residual_norm(dual)
        alpha = 1.9 * rho
        x, r = np.zeros_like(dual.b), -dual.b
        free = _inside(bounds, x)
        p = np.where(free, r, 0.0)
        iterations = 0
        while residual(x, r) > rtol:
            iterations += 1
            reduced = (x - bounds.project(x - alpha * r)) / alpha
            inner, boundary = np.where(free, reduced, 0.0), np.where(free, 0.0, reduced)
            end = None
            if boundary @ boundary > inner @ r:  # not proportional
                end = bounds.project(x - alpha * r)
            else:
                image = dual.compliance.apply(p)
                step = (r @ p) / (p @ image)
                longest = _longest_step(bounds, x, p)
                x, r = x - min(step, longest) * p, r - min(step, longest) * image
                if step > longest:  # to the boundary, and along it
                    end = bounds.project(x - alpha * np.where(free, r, 0.0))
                else:
                    gradient = np.where(free, r, 0.0)
                    p = gradient - (gradient @ image) / (p @ image) * p
            if end is not None:
                x, r = end, r + dual.compliance.apply(end - x)
                free = _inside(bounds, x)
                p = np.where(free, r, 0.0)
        _displacement(dual, x)
        return Answer(x, _work(dual, iterations))


def _inside(bounds: Any, x: np.ndarray) -> np.ndarray:
    """Return which multipliers are off the bounds of Lambda."""
    free = np.ones(bounds.size, dtype=np.bool_)
    free[bounds.normal] = x[bounds.normal] > 0.0
    inside = bounds.norms(x) < bounds.radius * (1.0 - 1e-14)
    free[bounds.tangential] = inside[bounds.node]
    return free


def _longest_step(bounds: Any, x: np.ndarray, p: np.ndarray) -> float:
    """Return the largest t with x - t p in Lambda."""
    longest = np.inf
    normal, p_normal = x[bounds.normal], p[bounds.normal]
    towards = p_normal > 0.0
    if towards.any():
        longest = float(np.min(normal[towards] / p_normal[towards]))
    count = len(bounds.radius)
    x_t, p_t = x[bounds.tangential], p[bounds.tangential]
    square = np.bincount(bounds.node, p_t * p_t, minlength=count)
    mixed = np.bincount(bounds.node, x_t * p_t, minlength=count)
    rest = bounds.radius**2 - np.bincount(bounds.node, x_t * x_t, minlength=count)
    moving = square > 0.0
    square, mixed, rest = square[moving], mixed[moving], np.maximum(rest[moving], 0.0)
    if len(square):
        longest = min(longest, float(np.min((mixed + np.sqrt(mixed**2 + square * rest)) / square)))
    return longest


def _work(dual: Any, iterations: int) -> dict[str, int]:
    return {"iterations": iterations, "products": dual.compliance.products, "factorisations": 1}


def _displacement(dual: Any, x: np.ndarray) -> None:
    """Compute the displacement, which belongs to the answer that a user wants."""
    u = dual.jump.system.f.x.petsc_vec.duplicate()
    dual.compute_displacement(x, u)
    u.destroy()
