"""The largest eigenvalue of A, on which the step length rho depends."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh_tridiagonal

from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.reductions import norm


def largest_eigenvalue(problem: DualProblem, rtol: float = 0.02, most: int = 20) -> float:
    """Return an estimate of sigma_max by the Lanczos iteration started at b.

    The largest Ritz value is a lower bound; the norm of its residual is added. The sum is an upper
    bound as soon as the Ritz value has found the top of the spectrum, which b may hide: who needs a
    guarantee must check the curvature along the steps taken.

    Collective. The products count as any others.

    Args:
        problem: gives A.
        rtol: stop when the residual is below this part of the Ritz value.
        most: limit on the number of products.
    """
    v = problem.b
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
        w = problem.apply(basis[:, -1])
        alphas.append(float(problem.inner(basis[:, -1], w)))
        for _ in range(2):  # all vectors, twice: exact orthogonality costs nothing at this size
            w = w - basis @ problem.inner(basis, w)
        beta = norm(problem, w)
        values, vectors = (problem.from_first_rank(one) for one in eigh_tridiagonal(alphas, betas))
        error = beta * abs(float(vectors[-1, -1]))
        if error <= rtol * values[-1] or len(alphas) == most:
            return float(values[-1]) + error
        betas.append(beta)
        basis = np.column_stack([basis, w / beta])
