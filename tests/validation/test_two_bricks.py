"""The two bricks of the paper: known answers, other solvers and algorithms, any number of ranks."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dense import clarabel_minimum

from dolfinx_tresca import Bonded, ContactStatus, Frictionless, Tresca
from dolfinx_tresca._base.parallel import reduce_array
from scenes.assembled import dense_matrix, dual_program
from scenes.dense import METHODS
from scenes.nodal import global_vector, surface_nodes_of
from scenes.rubbing import BOUND, YOUNG, rubbing
from scenes.two_bricks import bricks_problem, two_bricks

#: Known answers at N = 16 on trilinear hexahedra, as printed: q [MN m], nodes in contact, sticking
#: nodes, forces [MN]; with half a unit of the last digit.
KNOWN = {
    "free_end_1": (-1.14798515e-3, 128, 62, 2.054666, 0.120360),
    "free_end_2": (-2.38738417e-4, 50, 0, 0.814743, 0.173350),
}
Q_DIGITS = {"free_end_1": 0.5e-11, "free_end_2": 0.5e-12}
FORCE_DIGITS = 0.5e-6


@pytest.mark.parametrize("end", KNOWN)
def test_known_answers(comm, end):
    q, contact, stick, normal, tangential = KNOWN[end]
    with bricks_problem(comm, 16, end=end, hexahedra=True) as problem:
        assert (problem.free_dofs, problem.contact_nodes) == (6 * 16**3, 16**2)
        solution = problem.solve(rtol=1e-8)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.q[-1] == pytest.approx(q, abs=Q_DIGITS[end])
    assert (solution.counts.nodes, solution.counts.contact) == (256, contact)
    assert solution.counts.stick == stick
    assert solution.normal_force == pytest.approx(normal, abs=FORCE_DIGITS)
    assert solution.tangential_force == pytest.approx(tangential, abs=FORCE_DIGITS)


#: Scenes of one rank: bricks, and blocks in the plane, where an interval is a cone of two numbers.
SMALL = {
    **{end: lambda end=end: two_bricks(MPI.COMM_SELF, 4, end=end) for end in KNOWN},
    "triangles of degree 2": lambda: rubbing(MPI.COMM_SELF, "triangle", 2, upper=(8, 4)),
    "quadrilaterals": lambda: rubbing(MPI.COMM_SELF, "quadrilateral", upper=(8, 4)),
}


@pytest.mark.parametrize("name", SMALL)
def test_clarabel_confirms_the_minimum(name):
    """An interior-point method with A from unit vectors and second-order cones agrees."""
    scene = SMALL[name]()
    with dual_program(scene) as dual:
        A, b, scale = dense_matrix(dual), dual.b, dual.jump.stress_scale
        x = clarabel_minimum(A, b, dual.admissible, tolerance=1e-12)
    q = 0.5 * x @ A @ x - x @ b
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
    assert solution.status is ContactStatus.CONVERGED
    assert 0 < solution.counts.contact < solution.counts.nodes
    # q is stationary: its error is that of Clarabel's gap
    assert solution.q[-1] == pytest.approx(q, rel=1e-7)
    # energy norm of the difference: sqrt of the relative error of q
    difference = solution.multipliers / scale - x
    assert difference @ A @ difference <= 1e-6 * abs(q)


@pytest.mark.parallel
@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("end", KNOWN)
def test_any_number_of_ranks_gives_the_same(comm, end, hexahedra):
    """The distributed problem has the answer of the serial one."""
    rtol = 1e-7
    results = []
    for where in (MPI.COMM_SELF, comm):
        with bricks_problem(where, 5, end=end, hexahedra=hexahedra) as problem:
            results.append(problem.solve(rtol=rtol))
            assert (problem.free_dofs, problem.contact_nodes) == (6 * 5**3, 25)
    alone, together = results
    assert alone.status is together.status is ContactStatus.CONVERGED
    # energies err by the square of the residual at most times the condition number: rtol is ample
    assert together.q[-1] == pytest.approx(alone.q[-1], rel=rtol)
    assert together.counts == alone.counts
    assert together.primal_energy == pytest.approx(alone.primal_energy, rel=10 * rtol)
    assert together.normal_force == pytest.approx(alone.normal_force, rel=1e3 * rtol)
    assert together.tangential_force == pytest.approx(alone.tangential_force, rel=1e3 * rtol)
    points, fields = surface_nodes_of(alone)
    order = np.lexsort(np.round(points, 9).T)
    distributed_points, distributed = surface_nodes_of(together)
    for name, values in fields.items():
        gathered = global_vector(comm, distributed_points, distributed[name])
        size = np.abs(values).max()
        assert np.allclose(gathered, values[order], atol=1e4 * rtol * size), name


@pytest.mark.parallel
@pytest.mark.parametrize("method", METHODS)
def test_each_method_takes_the_same_steps_on_any_number_of_ranks(comm, method):
    """The first three iterations have the same products and values on any number of ranks."""
    results = []
    for where in (MPI.COMM_SELF, comm):
        with bricks_problem(where, 3, end="free_end_2") as problem:
            results.append(problem.solve(method=method, max_iterations=3, rtol=1e-9))
    alone, together = results
    assert together.iterations == alone.iterations
    assert together.products == alone.products
    # rounding of products, over the condition number of A on this mesh
    assert np.allclose(together.q, alone.q, rtol=1e-8, atol=0.0)
    assert np.allclose(together.residuals, alone.residuals, rtol=1e-6, atol=1e-9)


def test_products_do_not_grow_much_with_the_mesh(comm):
    """Eight times the cells take at most twice the products, where A is not computed whole."""
    counts = []
    for N in (4, 8):
        with bricks_problem(comm, N, options={"stiffness": "multigrid"}) as problem:
            counts.append(problem.solve(rtol=1e-6).products)
    assert counts[1] <= 2 * counts[0]
    assert counts[1] <= 100


RTOL = 1e-8

#: How an algorithm ends that does not converge.
FAILURES = (ContactStatus.MAX_ITERATIONS, ContactStatus.STAGNATED)


@pytest.mark.parametrize(("kind", "degree"), [("triangle", 2), ("hexahedron", 1)])
@pytest.mark.parametrize(
    "friction", [Frictionless(), Bonded(), Tresca(BOUND * YOUNG)], ids=lambda f: type(f).__name__
)
def test_all_find_the_same_or_say_that_they_do_not(comm, kind, degree, friction):
    """All algorithms find the same tractions and energies, with both solvers for K.

    IMSSN and MSSN are not proved to converge, and cycle in some scenes with friction.
    """
    reference, energy = None, None
    for stiffness in ("cholesky", "multigrid"):
        scene = rubbing(comm, kind, degree, friction=friction)
        with scene.problem(stiffness=stiffness) as problem:
            for method in METHODS:
                may_cycle = method in ("imssn", "mssn") and isinstance(friction, Tresca)
                problem.forget()
                limit = 60 if may_cycle else 2000
                solution = problem.solve(method=method, rtol=RTOL, max_iterations=limit)
                if may_cycle and solution.status is not ContactStatus.CONVERGED:
                    assert solution.status in FAILURES and solution.residuals[-1] > RTOL
                    continue
                assert solution.status is ContactStatus.CONVERGED, (stiffness, method)
                assert solution.residuals[-1] <= RTOL
                if reference is None:
                    reference, energy = solution.multipliers, solution.dual_energy
                assert energy is not None
                squares = [((solution.multipliers - reference) ** 2).sum(), (reference**2).sum()]
                difference, size = reduce_array(comm, squares)
                assert np.sqrt(difference / size) <= 1e3 * RTOL, (stiffness, method)
                assert solution.dual_energy == pytest.approx(energy, rel=1e3 * RTOL)
