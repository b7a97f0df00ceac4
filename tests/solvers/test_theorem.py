"""Theorem 38.1 as a property of computed sequences."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from dense import problems
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.dense import DenseProblem, brute_projection, random_problem, run
from scenes.scene import EPS

#: rounding in q: multiples of eps |q|
ROUNDING = 1000 * EPS


def minimum(problem: DenseProblem) -> float:
    """Return q at the minimiser, to rounding: the error of q is the square of the residual's."""
    tight = run(problem, rtol=1e-11, max_iterations=1000)
    assert problem.natural_residual(tight.multipliers, tight.rho) <= 1e-7
    return problem.q(tight.multipliers)


def eta(rho: float, smallest: float, largest: float) -> float:
    """The rate of Theorem 38.1."""
    if rho <= 1.0 / largest:
        return 1.0 - rho * smallest
    return 1.0 - (2.0 / largest - rho) * smallest


def start_of(problem: DenseProblem, seed: int) -> np.ndarray:
    """A random point of Lambda, or zero."""
    rng = np.random.default_rng(seed)
    scale = np.linalg.norm(problem.b) * (seed % 3)
    return brute_projection(problem.feasible_set, scale * rng.standard_normal(len(problem.b)))


def check_rate(problem: DenseProblem, q: tuple[float, ...], rate: float) -> None:
    """Check (i) and that q decreases, up to rounding."""
    least = minimum(problem)
    rounding = ROUNDING * (max(np.abs(q)) + abs(least))
    for before, after in pairwise(q):
        assert after <= before + rounding
        assert after - least <= rate * (before - least) + rounding
    assert min(q) >= least - rounding


@settings(max_examples=40)
@given(problems(most_decades=2.0), st.sampled_from([0.3, 1.0, 1.6, 1.99]), st.integers(0, 10**6))
def test_gimssn_decreases_q_at_the_rate_of_the_theorem(problem, rho_sigma, seed):
    found = run(problem, "gimssn", start_of(problem, seed), rho_sigma=rho_sigma, max_iterations=60)
    values = np.linalg.eigvalsh(problem.A)
    # where the estimate of sigma_max was too low the theorem does not apply, but q must fall
    applies = found.rho < 2.0 / values[-1]
    check_rate(problem, found.q, eta(found.rho, values[0], values[-1]) if applies else 1.0)
    assert applies or rho_sigma > 1.9


@pytest.mark.parametrize("method", ["gimssn", "projected_newton"])
@pytest.mark.parametrize("top", [2.0, 5.0])
def test_q_falls_even_where_the_load_hides_the_largest_eigenvalue(method, top):
    """The eigenvalue estimate starts from b: an eigenvector orthogonal to b must not do harm."""
    for seed in range(10):
        problem = random_problem(seed, 10, 1.0)
        v = np.random.default_rng(seed).standard_normal(len(problem.b))
        v /= np.linalg.norm(v)
        # make v an eigenvector, the others stay orthogonal to it, and take it out of b
        P = np.eye(len(v)) - np.outer(v, v)
        problem.A = P @ problem.A @ P + top * np.outer(v, v)
        problem.b = P @ problem.b
        found = run(problem, method, max_iterations=300)
        rounding = ROUNDING * max(np.abs(found.q))
        assert max(np.diff(found.q)) <= rounding, (seed, found.rho * top, found.status)
