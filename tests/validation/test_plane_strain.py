"""2D: one tangential multiplier per node, whose set is an interval; a quadratic programme."""

from __future__ import annotations

from mpi4py import MPI

import pytest
from dense import clarabel_minimum

from dolfinx_tresca import ContactStatus
from scenes.assembled import dense_matrix, dual_program
from scenes.rubbing import rubbing

KINDS = ("triangle", "quadrilateral")

SHAPE = {"upper": (8, 4), "lower": (12, 6)}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_sizes(comm, kind, degree):
    """Only corners of facets carry multipliers."""
    with rubbing(comm, kind, degree, **SHAPE).problem() as problem:
        assert problem.contact_nodes == SHAPE["upper"][0] + 1
        nodes = [(degree * n + 1) * (degree * m - 1) for n, m in (SHAPE["upper"], SHAPE["lower"])]
        ends = sum(degree * n + 1 for n, _ in (SHAPE["upper"], SHAPE["lower"]))
        # clamped at one end each
        assert problem.free_dofs == 2 * (sum(nodes) + ends)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_clarabel_confirms_the_minimum(kind, degree):
    """An interior-point method with A from unit vectors; each rank solves its own copy."""
    scene = rubbing(MPI.COMM_SELF, kind, degree, **SHAPE)
    with dual_program(scene) as dual:
        A, b, scale = dense_matrix(dual), dual.b, dual.jump.stress_scale
        # an interval is a cone of two numbers: the same constraint as two inequalities
        x = clarabel_minimum(A, b, dual.admissible, tolerance=1e-12)
    q = 0.5 * x @ A @ x - x @ b
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-11)
    assert solution.status is ContactStatus.CONVERGED
    counts = solution.counts
    assert 0 < counts.contact < counts.nodes
    assert 0 < counts.stick < counts.nodes
    # q is stationary: its error is that of Clarabel's gap
    assert solution.q[-1] == pytest.approx(q, rel=1e-9)
    # energy norm of the difference: sqrt of the relative error of q
    difference = solution.multipliers / scale - x
    assert difference @ A @ difference <= 1e-8 * abs(q)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", ["projected_newton", "ssn", "imssn", "mssn"])
def test_it_ends_after_few_iterations(method, kind, degree):
    """A quadratic programme is a linear system once the sets are right: the end comes at once.

    Inner systems are solved to rounding (r_tol), so a step on the right sets is exact: it takes the
    residual from a size that sets decide to rounding. The default finds sets and products together:
    it is exact when it has a product for each direction of the face, as conjugate gradients are, so
    after as many iterations as there are unknowns at most.
    """
    scene = rubbing(MPI.COMM_SELF, kind, degree, **SHAPE)
    recycles = method == "projected_newton"
    with scene.problem() as problem:
        solution = problem.solve(
            method=method, rtol=1e-13 if recycles else 1e-10, r_tol=1e-12, max_iterations=60
        )
        unknowns = 2 * problem.contact_nodes
    assert solution.status is ContactStatus.CONVERGED
    assert solution.iterations <= (unknowns if recycles else 8)
    if not recycles:
        *_, before, last = solution.residuals
        assert last <= 1e-12
        assert last <= 1e-8 * before
