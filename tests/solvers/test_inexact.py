"""Products with errors: what the default method makes of gradients that are only so accurate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from dense import problems
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_tresca import ContactStatus
from scenes.dense import DenseProblem, random_problem, run


@dataclass
class NoisyProblem(DenseProblem):
    """Gradients with an error as large as is allowed, in a random direction."""

    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._rng = np.random.default_rng(self.seed)
        self._factor = np.linalg.cholesky(self.A)

    def gradient(self, x: np.ndarray, accuracy: float) -> tuple[np.ndarray, float]:
        """Return A x - b with an error e such that sqrt(e'A^-1 e) is `accuracy`."""
        error = self._rng.standard_normal(len(x))
        error *= accuracy / np.linalg.norm(error)
        return self.apply(x) - self.b + self._factor @ error, accuracy


def noisy(problem: DenseProblem, seed: int) -> NoisyProblem:
    return NoisyProblem(problem.A, problem.b, problem.feasible_set, seed=seed)


def check_residual(problem: DenseProblem, seed: int) -> None:
    """Compare the true residual with the one that was asked for."""
    rtol = 1e-5
    solution = run(noisy(problem, seed), rtol=rtol, max_iterations=1000)
    assert solution.status is ContactStatus.CONVERGED
    # the residual is Lipschitz in r with constant 1
    assert problem.natural_residual(solution.multipliers, solution.rho) <= 1.2 * rtol


@settings(max_examples=60)
@given(problems(), st.integers(0, 100))
def test_the_residual_is_reached_in_truth(problem, seed):
    """The exact residual is as small as requested, though the method sees gradients with errors."""
    check_residual(problem, seed)


@pytest.mark.long
def test_the_residual_is_reached_in_truth_by_many():
    for seed in range(1500):
        rng = np.random.default_rng(seed)
        problem = random_problem(
            seed, int(rng.integers(1, 13)), rng.uniform(0.0, 3.0), rng.choice([0.1, 1.0, 10.0])
        )
        check_residual(problem, seed)
