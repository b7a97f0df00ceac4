"""2D: one tangential multiplier per node, whose set is an interval; a quadratic programme."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dense import clarabel_minimum

from dolfinx_tresca import Bonded, ContactStatus, Frictionless, Tresca
from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import SlipBounds
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.rubbing import BOUND, YOUNG, rubbing
from scenes.scene import Scene

KINDS = ("triangle", "quadrilateral")

SHAPE = {"upper": (8, 4), "lower": (12, 6)}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "friction, per_node", [(Tresca(BOUND * YOUNG), 2), (Bonded(), 2), (Frictionless(), 1)]
)
def test_sizes(comm, kind, degree, friction, per_node):
    """Only corners of facets carry multipliers, one or two each."""
    scene = rubbing(comm, kind, degree, friction=friction, **SHAPE)
    with scene.problem() as problem:
        assert problem.contact_nodes == SHAPE["upper"][0] + 1
        nodes = [(degree * n + 1) * (degree * m - 1) for n, m in (SHAPE["upper"], SHAPE["lower"])]
        ends = sum(degree * n + 1 for n, _ in (SHAPE["upper"], SHAPE["lower"]))
        # clamped at one end each
        assert problem.free_dofs == 2 * (sum(nodes) + ends)
        solution = problem.solve(rtol=1e-6)
    assert solution.status is ContactStatus.CONVERGED
    assert comm.allreduce(len(solution.multipliers)) == per_node * problem.contact_nodes
    if per_node == 2:
        assert solution.traction.function_space.dofmap.index_map_bs == 2
    else:
        assert solution.traction is solution.slip is None


def dense(scene: Scene):
    """A, b, Lambda and the scale of multipliers, of a scene on one rank."""
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        solver = cholesky(system.K, {}, None)
        operators = scene.operators()
        bounds = [SlipBounds(scene.V).at(scene.pair.friction, operators.nodes)]
        with (
            JumpOperator(system, [operators]) as jump,
            InitialGuess(jump) as guess,
            ContactCompliance(jump, solver, None) as compliance,
        ):
            dual = DualProgram.of(compliance, guess, bounds)
            dual.response.solve_load()
            A = np.column_stack([dual.apply(e) for e in np.eye(len(dual.b))])
            return 0.5 * (A + A.T), dual.b, dual.feasible_set, jump.stress_scale


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_clarabel_confirms_the_minimum(kind, degree):
    """An interior-point method with A from unit vectors; each rank solves its own copy."""
    scene = rubbing(MPI.COMM_SELF, kind, degree, **SHAPE)
    A, b, lam, scale = dense(scene)
    # an interval is a cone of two numbers: the same constraint as two inequalities
    x = clarabel_minimum(A, b, lam, tolerance=1e-12)
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
