"""Conic solvers, Clarabel (interior points) and SCS (splitting), for two forms of the problem.

`primal`: a sparse problem in the displacement u and a bound t_i of each node's slip:

    min 1/2 u'K u - f'u + sum of g_i t_i   subject to   N u <= d,   |(T u - s)_i| <= t_i

`dual`: a problem in the multipliers; the dense matrix A takes one product for each multiplier:

    min 1/2 lambda'A lambda - b'lambda   subject to   lambda_nu >= 0,   |lambda_tau,i| <= g_i

Both are scaled so that all numbers have a moderate size: the unit of stress is 1 MPa, and the unit
of displacements is the scene's unit of length times 1 MPa / E.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, eye_array, hstack, triu, vstack

from peer_solvers.discrete import Answer, primal_problem, scipy_matrix
from scenes.assembled import dual_program

#: Number of columns of A that are computed at once.
BLOCK = 64


def primal(scene: Any, tolerance: float, solver: str) -> Answer:
    """Solve the sparse form; the answer has the multipliers of its constraints."""
    data = primal_problem(scene)
    n, m = len(data.f), len(data.gap)
    nodes = len(data.bound)
    zero = csr_array((m, nodes))
    constraints = [hstack([data.N, zero])]
    order, first = _cone_order(data.node, nodes)
    sides = hstack([csr_array((nodes, n)), -eye_array(nodes)])
    slips = hstack([-data.T, csr_array((len(data.node), nodes))])
    constraints.append(vstack([sides, slips], format="csr")[order])
    E = scene.data.modulus
    stiffness = hstack([data.K / E, csr_array((n, nodes))])
    energy = triu(vstack([stiffness, csr_array((nodes, n + nodes))]), format="csc")
    slips_at_zero = np.concatenate([np.zeros(nodes), -data.slip])[order]
    right = E * np.concatenate([data.gap, slips_at_zero])
    z, iterations, status = _minimise(
        solver,
        energy,
        np.concatenate([-data.f, data.bound]),
        vstack(constraints, format="csc"),
        right,
        m,
        np.diff(first),
        tolerance,
    )
    tangential = np.empty(len(order))
    tangential[order] = z[m:]
    return Answer(
        np.concatenate([z[:m], -tangential[nodes:]]),
        {
            "iterations": iterations,
            "factorisations": iterations if solver == "clarabel" else 1,
        },
        status,
    )


def dual(scene: Any, tolerance: float, solver: str) -> Answer:
    """Solve the dense form."""
    with dual_program(scene) as problem:
        A, E = _dense(problem), scene.data.modulus
        b, bounds = problem.b, problem.admissible
        nodes = len(bounds.radius)
        order, first = _cone_order(bounds.node, nodes)
        identity = eye_array(bounds.size, format="csr")
        discs = vstack([csr_array((nodes, bounds.size)), -identity[bounds.tangential]])
        radius = np.concatenate([bounds.radius, np.zeros(len(bounds.tangential))])
        x, iterations, status = _minimise(
            solver,
            csc_array(np.triu(A * E)),
            -b * E,
            vstack([-identity[bounds.normal], discs.tocsr()[order]], format="csc"),
            np.concatenate([np.zeros(len(bounds.normal)), radius[order]]),
            len(bounds.normal),
            np.diff(first),
            tolerance,
            primal_wanted=True,
        )
        u = problem.jump.system.f.x.petsc_vec.duplicate()
        problem.compute_displacement(x, u)
        u.destroy()
        work = {"iterations": iterations, "products": bounds.size, "factorisations": 1}
        return Answer(x, work, status)


def _dense(problem: Any) -> np.ndarray:
    """Return A, by solves with K for many right-hand sides at once."""
    jump = scipy_matrix(problem.jump.matrix)
    right = jump @ diags_array(np.where(problem.jump.system.prescribed, 0.0, 1.0))
    # not public: the package has no use for many right-hand sides
    factor = problem.compliance.solver._ksp.getPC().getFactorMatrix()
    A = np.empty((len(problem.b), len(problem.b)))
    for start in range(0, len(A), BLOCK):
        block = np.asfortranarray(right[start : start + BLOCK].toarray().T)
        forces = PETSc.Mat().createDense(block.shape, array=block, comm=PETSc.COMM_SELF)
        solutions = PETSc.Mat().createDense(block.shape, comm=PETSc.COMM_SELF)
        solutions.setUp()
        factor.matSolve(forces, solutions)
        A[:, start : start + BLOCK] = jump @ solutions.getDenseArray()
        forces.destroy()
        solutions.destroy()
    return 0.5 * (A + A.T)


def _cone_order(node: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an order, by node, of the rows of t and then of T; and the first row of each node."""
    owner = np.concatenate([np.arange(nodes), node])
    order = np.argsort(owner, kind="stable")
    return order, np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=nodes))])


def _minimise(
    solver: str,
    P: Any,
    q: np.ndarray,
    A: Any,
    b: np.ndarray,
    inequalities: int,
    cones: np.ndarray,
    tolerance: float,
    *,
    primal_wanted: bool = False,
) -> tuple[np.ndarray, int, str]:
    """Minimise 1/2 x'P x + q'x with b - A x in cones; return z (or x), iterations and status."""
    if solver == "clarabel":
        import clarabel

        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        settings.max_iter = 500
        kinds = [clarabel.NonnegativeConeT(inequalities)]
        kinds += [clarabel.SecondOrderConeT(int(size)) for size in cones]
        found = clarabel.DefaultSolver(P, q, A, b, kinds, settings).solve()
        return (
            np.array(found.x if primal_wanted else found.z),
            found.iterations,
            str(found.status),
        )
    import scs

    data = {"P": csc_array(P), "A": csc_array(A), "b": b, "c": q}
    cone = {"l": inequalities, "q": [int(size) for size in cones]}
    found = scs.SCS(
        data, cone, eps_abs=tolerance, eps_rel=tolerance, max_iters=1_000_000, verbose=False
    ).solve()
    info = found["info"]
    return found["x" if primal_wanted else "y"], info["iter"], info["status"]
