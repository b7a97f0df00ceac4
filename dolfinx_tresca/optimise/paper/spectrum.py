"""The largest eigenvalue of A, on which the step length rho depends."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh_tridiagonal

from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.reductions import norm


def largest_eigenvalue(problem: DualProblem, rtol: float = 0.02, most: int = 20) -> float:
    """Return an estimate of sigma_max by the Lanczos iteration started at b.

    The largest Ritz value is a lower bound; the norm of its residual is added. The sum is an upper
    bound if the Ritz value approximates the largest eigenvalue. This fails if the eigenvector of
    the largest eigenvalue is almost orthogonal to b; algorithms therefore check the curvature along
    their steps.

    Collective. The products are counted.

    Args:
        problem: the dual problem (38.4), for A and b.
        rtol: residual of the Ritz vector, divided by the Ritz value, at which the iteration ends.
        most: limit on the number of products.
    """
    v, agreed = problem.b, problem.reductions.from_first_rank
    beta = norm(problem, v)
    if beta == 0.0:
        v = np.ones_like(v)
        beta = norm(problem, v)
    if beta == 0.0:
        return 1.0
    basis = np.asarray((v / beta)[:, None], dtype=np.float64)
    alphas: list[float] = []
    betas: list[float] = []
    while True:
        w = problem.operator.apply(basis[:, -1])
        alphas.append(float(problem.inner(basis[:, -1], w)))
        for _ in range(2):  # full orthogonalisation, twice: cheap for so few vectors
            w = w - basis @ problem.inner(basis, w)
        beta = norm(problem, w)
        values, vectors = (agreed(one) for one in eigh_tridiagonal(alphas, betas))
        error = beta * abs(float(vectors[-1, -1]))
        if error <= rtol * values[-1] or len(alphas) == most:
            return float(values[-1]) + error
        betas.append(beta)
        basis = np.column_stack([basis, w / beta])
