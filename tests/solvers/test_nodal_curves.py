"""Bounds that depend on pressure and slip: random solutions against a conic solver."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from dense import clarabel_minimum

from dolfinx_tresca import ContactStatus
from dolfinx_tresca.scene.friction import FrictionCurve
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.solvers.friction_cones import NodalCurves
from scenes.dense import DenseProblem, random_cone_problem, run

RTOL = 1e-8

CURVES = {
    "falls with p": lambda p, v: 0.5 / (1 + p),
    "grows with p": lambda p, v: 0.2 + 0.3 * p / (1 + p),
    "grows with v": lambda p, v: 0.1 + 0.5 * v,
    "grows steeply": lambda p, v: 0.1 + 50 * v,
    "falls with v": lambda p, v: 0.2 + 0.1 * np.exp(-0.5 * v),
    "Stribeck": lambda p, v: 0.1 + 0.1 * np.exp(-0.5 * v) + 0.1 * v,
    "infinite at no pressure": lambda p, v: 0.3 * p ** (-1 / 3),
}


def random_curve_problem(seed: int, curve: str, decades: float = 1.0) -> DenseProblem:
    """A problem in which half of the nodes have a curve, with adhesion and limits at some."""
    problem = random_cone_problem(seed, 8, decades, 0.5)
    assert problem.cones is not None
    root = np.random.default_rng(seed + 3).uniform(0.5, 2.0, 8)
    curves = NodalCurves([(slice(0, 6), FrictionCurve(CURVES[curve]))], root)
    coefficient = np.where(np.arange(8) < 6, 100.0, problem.cones.coefficient)
    cones = dataclasses.replace(problem.cones, coefficient=coefficient, curves=curves)
    problem.cones, problem.feasible_set = cones, cones.section(np.zeros(cones.size))
    return problem


def own_section(problem: DenseProblem, curve: str, x: np.ndarray) -> FeasibleSet:
    """Lambda with the bounds at the pressures and slips of x, from their formula."""
    cones = problem.cones
    assert cones is not None and cones.curves is not None
    r, radius = problem.A @ x - problem.b, cones.radius.copy()
    for disc, normal in enumerate(cones.normal_of):
        p = max(float(x[normal]), 0.0) if normal >= 0 else 0.0
        rows = cones.tangential[cones.node == disc]
        root, F = cones.curves.root[disc], float(cones.coefficient[disc])
        if disc < 6 and p > 0.0:
            F = float(CURVES[curve](p / root, np.linalg.norm(r[rows]) / root))
        radius[disc] += min(F * p, cones.limit[disc])
    return FeasibleSet(cones.size, cones.normal, cones.tangential, cones.node, radius)


@pytest.mark.parametrize("curve", CURVES)
def test_solutions_solve_their_own_tresca_problem(curve):
    """A conic solver finds the same multipliers for the bounds at their own pressures and slips."""
    slipping = 0
    for seed in range(3):
        problem = random_curve_problem(seed, curve)
        found = run(problem, rtol=RTOL)
        assert found.status is ContactStatus.CONVERGED, seed
        x = found.multipliers
        section = own_section(problem, curve, x)
        wanted = clarabel_minimum(problem.A, problem.b, section)
        least = np.linalg.eigvalsh(problem.A)[0]
        # a residual of RTOL, and the reference's accuracy, 1e-10 in q; steep slopes magnify both
        tolerance = 1e-4 * np.linalg.norm(problem.b) / least
        assert np.linalg.norm(x - wanted) <= tolerance, seed
        slipping += np.count_nonzero(section.norms(x)[:6] > 0.99 * section.radius[:6])
    assert slipping > 3
