"""Points of the interior-point method are near solutions, found in few steps."""

from __future__ import annotations

import numpy as np
import pytest
from dense import clarabel_minimum

from dolfinx_tresca.solvers import interior_point as page
from scenes.dense import DenseProblem, random_balanced_problem, random_cone_problem, random_problem


def point_of(problem: DenseProblem, monkeypatch) -> tuple[np.ndarray, np.ndarray]:
    problem.complete_products()
    steps, exact = [], page.Scaling
    monkeypatch.setattr(page, "Scaling", lambda y, z: steps.append(0) or exact(y, z))
    x, c = page.interior_point(problem, problem.store, problem.admissible, -problem.b, 1e-4)
    assert len(steps) <= 40
    return x, c


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("make", [random_problem, random_cone_problem, random_balanced_problem])
def test_points_are_near_solutions(make, seed, monkeypatch):
    """A conic solver with the same bounds finds the same energy, and the constraints hold."""
    further = {random_problem: (2.0,), random_cone_problem: (2.0, 0.5)}.get(make, (2, 2.0, 0.0))
    problem = make(seed, 8, *further)
    x, c = point_of(problem, monkeypatch)
    G, section = problem.constraints.columns, problem.section_at(x, np.zeros_like(x))
    assert np.linalg.norm(problem.constraints.residual(x, c)) <= 1e-5 * np.linalg.norm(problem.b)
    b, x = problem.b + G @ c, section.project(x)
    wanted = clarabel_minimum(problem.A, b, section)
    energies = [0.5 * lam @ problem.A @ lam - b @ lam for lam in (x, wanted)]
    assert energies[0] - energies[1] <= 1e-5 * abs(energies[1]) + 1e-10
