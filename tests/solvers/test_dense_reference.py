"""The default method in dense numpy, which the theory page shows, against the real one."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dolfinx_tresca.solvers.products import ProductStore
from scenes.dense import DenseProblem, random_problem, run

PAGES = Path(__file__).parents[2] / "docs" / "theory"

SPEC = importlib.util.spec_from_file_location("dense", PAGES / "projected_newton_dense.py")
dense = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(dense)

#: The requested relative residual; in the two methods its rho is a lower bound of 1 / sigma_max,
#: but not always the same one, which changes the residual by a factor near 1.
RTOL, OTHER_RHO = 1e-6, 1.5
#: Difference between the numbers of products. It is 0 for all 20 problems; rounding, which differs
#: between processors, may decide whether a last product is needed.
MARGIN = 1


class Counting(np.ndarray):
    """A matrix that counts its products."""

    products = 0

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        self.products += 1
        return np.asarray(self) @ x


def scaled_problem(seed: int) -> DenseProblem:
    """Random A, b and Lambda, with discs larger than a point, and a diagonal that varies."""
    load = (0.03, 0.3, 1.0, 10.0, 100.0)[seed % 5]
    problem = random_problem(seed, nodes=seed + 1, decades=1 + seed % 5, load=load)
    lam = problem.feasible_set
    problem.feasible_set = replace(lam, radius=np.where(lam.radius > 0.0, lam.radius, 1.0))
    scale = 10.0 ** np.random.default_rng(seed + 7).uniform(-1.0, 1.0, lam.size)
    problem.A = scale[:, None] * problem.A * scale
    return problem


def by_the_page(problem: DenseProblem, rtol: float) -> tuple[np.ndarray, int]:
    """Return the multipliers that the code of the page finds, and the number of products."""
    lam = problem.feasible_set
    normal = np.zeros(lam.size, dtype=bool)
    normal[lam.normal] = True
    discs = np.zeros((lam.size, len(lam.radius)))
    discs[lam.tangential, lam.node] = 1.0
    rubs = discs.any(axis=0)
    A = problem.A.view(Counting)
    x = dense.minimise(A, problem.b, dense.Lambda(normal, discs[:, rubs], lam.radius[rubs]), rtol)
    return x, A.products


@pytest.mark.parametrize("seed", range(1, 21))
def test_same_multipliers_with_as_many_products_as_the_real_method(seed):
    problem = scaled_problem(seed)
    x, products = by_the_page(problem, RTOL)
    problem.forget()
    problem.store = ProductStore(problem, problem.diagonal)  # without a near field
    problem.is_too_large = True  # the page does not compute A whole
    found = run(problem, keep=True, rtol=RTOL)
    residuals = [problem.natural_residual(y, found.rho) for y in (x, found.multipliers)]
    assert max(residuals) <= OTHER_RHO * RTOL
    # q is strongly convex, so that |y - P(y - rho r)| / rho bounds the error of y
    sigma = np.linalg.eigvalsh(problem.A)
    bound = (1.0 + found.rho * sigma[-1]) / sigma[0] * sum(residuals) * np.linalg.norm(problem.b)
    assert np.linalg.norm(x - found.multipliers) <= bound
    assert abs(products - problem.products) <= MARGIN
