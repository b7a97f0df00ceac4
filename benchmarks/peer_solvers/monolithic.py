"""A monolithic semismooth Newton method for (u, lambda), as in most finite element codes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array, eye_array, vstack

from peer_solvers.discrete import Answer, Primal, load_steps

#: Number of Newton steps after which the method counts as failed, since it cycles.
MOST = 100

#: c divided by E / h: of 0.01, 0.1, 1, 10 and 100 the best value for the classical derivative.
STEP = 0.1

#: Sparse matrix and right side -> solution.
LinearSolve = Callable[[Any, np.ndarray], np.ndarray]

OPTIONS = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_7": 5,  # as in the package
    "mat_mumps_icntl_14": 100,
}


def solve(scene: Any, tolerance: float, *, classical: bool = False) -> Answer:
    """Solve by the semismooth Newton method with MUMPS."""
    return newton(load_steps(scene), scene.data.modulus, tolerance, lu_solve, classical=classical)


def newton(
    load_steps: Sequence[Primal],
    modulus: float,
    tolerance: float,
    linear_solve: LinearSolve,
    *,
    classical: bool = False,
) -> Answer:
    """Solve by Newton steps on K u + B'lambda = f, lambda = P(lambda + c (B u - d)).

    Without friction this is the primal-dual active set strategy (Hintermueller, Ito, Kunisch 2002).
    With friction the classical derivative of P is Alart and Curnier's (1991). The default is a
    derivative that Hueeber, Stadler and Wohlmuth (2008) have modified so that the method converges
    from remote starting points. Each step factors one sparse unsymmetric matrix. The iteration ends
    when |lambda - P(...)| is at most `tolerance` times |lambda|; the first equation, which is
    linear, holds after each step.

    A load step starts from the lambda of the last one. With the modified derivative, nodes first
    have the states of the last step; with the classical one, those at the last u and lambda. For
    each this is the better start (press fit, N = 16: 19 factorisations in place of 31, and 30 in
    place of 60). Slip counts from the last step.
    """
    K, N, T = load_steps[0].K, load_steps[0].N, load_steps[0].T
    size, node = load_steps[0].size, load_steps[0].node
    n, m = K.shape[0], N.shape[0]
    B = vstack([N, T], format="csr")
    c = STEP * modulus / np.concatenate([size, size[node]])
    scale, unscale, identity = diags_array(c), diags_array(1.0 / c), eye_array(len(c))
    u, x, slipped = np.zeros(n), np.zeros(len(c)), np.zeros(len(c) - m)
    y = np.where(np.arange(len(c)) < m, 1.0, 0.0)  # at first all nodes touch and stick
    found: list[np.ndarray] = []
    total, converged = 0, True
    for data in load_steps:
        gap = np.concatenate([data.gap, data.slip + slipped])
        if classical and found:
            y = x + c * (B @ u - gap)
        steps, error, projected = 0, np.inf, x
        while error > tolerance * np.linalg.norm(projected) and steps < MOST:
            steps += 1
            projected, D = projection(data, y, None if classical else x)
            # x = P(y) + D (x + c (B u - d) - y), divided by c
            matrix = block_array(
                [[K, B.T], [-unscale @ D @ scale @ B, unscale @ (identity - D)]], format="csr"
            )
            right = np.concatenate([data.f, (projected - D @ (y + c * gap)) / c])
            solution = linear_solve(matrix, right)
            u, x = solution[:n], solution[n:]
            y = x + c * (B @ u - gap)
            projected, _ = projection(data, y, None)
            error = np.linalg.norm(x - projected)
        slipped += (y - projected)[m:] / c[m:]
        found.append(projected)
        total += steps
        converged = converged and bool(error <= tolerance * np.linalg.norm(projected))
    note = "converged" if converged else "no convergence"
    return Answer(np.squeeze(found), {"iterations": total, "factorisations": total}, note)


def projection(data: Primal, y: np.ndarray, x: np.ndarray | None) -> tuple[np.ndarray, Any]:
    """Return P(y) and its derivative, a sparse matrix.

    On a circle the derivative is g / |y| (I - v y'/|y|). The classical derivative has v = y / |y|;
    if x is given, the derivative is modified, with v = x / max(g, |x|).
    """
    m, nodes = len(data.gap), len(data.bound)

    def lengths(v: np.ndarray) -> np.ndarray:
        return np.sqrt(np.bincount(data.node, v[m:] ** 2, minlength=nodes))

    length = lengths(y)
    slips = length > data.bound
    shrink = np.where(slips, data.bound / np.maximum(length, data.bound), 1.0)[data.node]
    projected = np.concatenate([np.maximum(y[:m], 0.0), shrink * y[m:]])
    kept = np.concatenate([y[:m] > 0.0, shrink])

    slipping = np.flatnonzero(slips[data.node])
    rows, columns = data.node[slipping], m + slipping

    def by_node(v: np.ndarray, size: np.ndarray) -> Any:
        """Return one row for each slipping node: its part of v, divided by its entry in `size`."""
        return csr_array((v[columns] / size[rows], (rows, columns)), shape=(nodes, len(y)))

    outward = by_node(y, length)
    left = outward if x is None else by_node(x, np.maximum(lengths(x), data.bound))
    return projected, diags_array(kept) @ (eye_array(len(y)) - left.T @ outward)


def lu_solve(matrix: Any, right: np.ndarray) -> np.ndarray:
    """Solve a linear system by one sparse LU factorisation."""
    pointers, columns = (a.astype(PETSc.IntType) for a in (matrix.indptr, matrix.indices))
    A = PETSc.Mat().createAIJ(
        matrix.shape, csr=(pointers, columns, matrix.data), comm=PETSc.COMM_SELF
    )
    prefix = "monolithic_"
    options = PETSc.Options(prefix)
    for key, value in OPTIONS.items():
        options[key] = value
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(A)
    ksp.setFromOptions()
    b, x = A.createVecLeft(), A.createVecRight()
    b.array = right
    ksp.solve(b, x)
    result = x.array.copy()
    for owned in (ksp, A, b, x):
        owned.destroy()
    return result
