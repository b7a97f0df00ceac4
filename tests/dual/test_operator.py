"""A = B K^-1 B', b and the energies, against dense algebra and on any number of ranks."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from scenes.assembled import dense_matrix, dual_program, points_of
from scenes.nodal import global_vector
from scenes.scene import EPS
from scenes.two_bricks import bricks_problem, two_bricks

#: rounding of a solve with K, whose condition number is about 1e4 on these meshes
SOLVE = 1e6 * EPS


def local_random(comm, size: int, seed: int) -> np.ndarray:
    return np.random.default_rng([seed, comm.rank]).standard_normal(size)


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_A_is_symmetric_and_positive_definite(comm, stiffness):
    with dual_program(two_bricks(comm, 4), stiffness) as dual:
        for seed in range(3):
            x = local_random(comm, len(dual.b), seed)
            y = local_random(comm, len(dual.b), seed + 10)
            Ax, Ay = dual.operator.apply(x), dual.operator.apply(y)
            xAx, yAy = dual.inner(x, Ax), dual.inner(y, Ay)
            assert xAx > 0.0 and yAy > 0.0
            # multigrid: |residual| <= 1e-12 |f|
            assert abs(dual.inner(x, Ay) - dual.inner(y, Ax)) <= 1e-8 * np.sqrt(xAx * yAy)


def dense_reference(scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, weights, A and b in node order by dense algebra, nothing of the package in it.

    Rows: all normal jumps, then all x jumps, then all y jumps; the normal of the upper brick's
    lower face is -z. Serial only.
    """
    V, tags = scene.V, scene.tags
    a, L = fem.form(scene.a), fem.form(scene.L)
    dense = fem.assemble_matrix(a).to_dense()
    f = fem.assemble_vector(L).array
    fixed = np.zeros(len(f), dtype=bool)
    for bc in scene.bcs:
        fixed[bc.dof_indices()[0]] = True
    x = V.tabulate_dof_coordinates()

    def nodes(name: str) -> np.ndarray:
        return fem.locate_dofs_topological(V, 2, scene.facet_tags.find(tags[name]))

    upper = np.array([i for i in nodes("upper_contact") if not fixed[3 * i]])
    lower = nodes("lower_contact")
    partner = [lower[np.linalg.norm(x[lower] - x[i], axis=1).argmin()] for i in upper]
    hx, hy = (np.diff(np.unique(np.round(x[upper, k], 9)))[0] for k in (0, 1))
    inner_x = (x[upper, 0] > 1e-9) & (x[upper, 0] < 2 - 1e-9)
    inner_y = (x[upper, 1] > 1e-9) & (x[upper, 1] < 1 - 1e-9)
    weights = hx * hy * np.where(inner_x, 1.0, 0.5) * np.where(inner_y, 1.0, 0.5)
    m = len(upper)
    B = np.zeros((3 * m, len(f)))
    for block, (component, sign) in enumerate([(2, -1.0), (0, 1.0), (1, 1.0)]):
        rows = block * m + np.arange(m)
        B[rows, 3 * upper + component] = sign * np.sqrt(weights)
        B[rows, 3 * np.array(partner) + component] = -sign * np.sqrt(weights)
    free = ~fixed
    inverse = np.linalg.inv(dense[np.ix_(free, free)])
    A = B[:, free] @ inverse @ B[:, free].T
    b = B[:, free] @ inverse @ f[free]
    return x[upper], weights, A, b


@pytest.mark.parametrize("end", ["free_end_1", "free_end_2"])
def test_A_and_b_are_those_of_dense_algebra(comm, end):
    """Hexahedra, whose nodal weights are known; tangents may be any orthonormal ones."""
    scene = two_bricks(MPI.COMM_SELF, 4, end=end, hexahedra=True)
    points, weights, A, b = dense_reference(scene)
    order = np.lexsort(np.round(points, 9).T)
    m = len(points)
    with dual_program(scene) as dual:
        mine = dense_matrix(dual)
        where = points_of(scene, dual.jump.pairs[0])
        own = np.lexsort(np.round(where, 9).T)
        assert np.allclose(where[own], points[order], atol=1e-12)
        assert np.allclose(dual.jump.pairs[0].weights[own], weights[order], rtol=1e-12)
        size = np.abs(A).max()
        normal = np.arange(m)[dual.jump.slices[0][0]][own]
        assert np.allclose(mine[np.ix_(normal, normal)], A[np.ix_(order, order)], atol=SOLVE * size)
        assert np.allclose(np.linalg.eigvalsh(mine), np.linalg.eigvalsh(A), atol=SOLVE * size)
        assert np.allclose(dual.b[normal], b[:m][order], atol=SOLVE * np.abs(b).max())
        assert np.linalg.norm(dual.b) == pytest.approx(np.linalg.norm(b), rel=SOLVE)
        assert dual.operator.products == 3 * m


def test_products_are_counted_and_each_is_one_solve(comm):
    with dual_program(two_bricks(comm, 3)) as dual:
        solves = dual.compliance.operator.solver.solves
        for number in range(1, 4):
            dual.operator.apply(local_random(comm, len(dual.b), number))
            assert dual.operator.products == number
            assert dual.compliance.operator.solver.solves == solves + number


def test_a_solution_counts_every_product(comm, monkeypatch):
    """Set-up included: solution.products is the number of vectors that A was applied to."""
    from dolfinx_tresca.dual.products.operator import DualOperator

    calls = []
    product, apply_to_all = DualOperator.product, DualOperator.apply_to_all

    def counting(self, x, *options):
        calls.append(1)
        return product(self, x, *options)

    def counting_all(self, X, *options):
        calls.extend([1] * X.shape[1])
        return apply_to_all(self, X, *options)

    monkeypatch.setattr(DualOperator, "product", counting)
    monkeypatch.setattr(DualOperator, "apply_to_all", counting_all)
    for method in ("projected_newton", "gimssn", "imssn", "ssn", "mssn"):
        with bricks_problem(comm, 3) as problem:
            for _ in range(2):
                calls.clear()
                solution = problem.solve(method=method, max_iterations=20)
                assert solution.products == len(calls)


@pytest.mark.parallel
def test_A_is_linear_and_the_same_on_any_number_of_ranks(comm):
    """Product with a vector that depends on position only."""
    results = []
    for where in (MPI.COMM_SELF, comm):
        scene = two_bricks(where, 4)
        with dual_program(scene) as dual:
            pair = dual.jump.pairs[0]
            points = points_of(scene, pair)
            x = np.cos(3 * points[pair.row_node, 0] + 7 * points[pair.row_node, 1])
            normal = dual.jump.slices[0][0]
            results.append(
                (where, points[pair.normal_node], dual.operator.apply(x)[normal], dual.b[normal])
            )
    (_, points, product, b), (_, parts, product_parts, b_parts) = results
    order = np.lexsort(np.round(points, 9).T)
    gathered = global_vector(comm, parts, product_parts)
    assert np.allclose(gathered, product[order], atol=SOLVE * np.abs(product).max())
    assert np.allclose(global_vector(comm, parts, b_parts), b[order], atol=SOLVE * np.abs(b).max())


@pytest.mark.parallel(end=["free_end_1"])
@pytest.mark.parametrize("end", ["free_end_1", "free_end_2"])
def test_the_energies_bracket_and_meet(comm, end):
    """Weak duality for any multipliers, strong duality at the solution; J = -q - D's constant."""
    rtol = 1e-8
    with bricks_problem(comm, 5, end=end) as problem:
        solution = problem.solve(rtol=rtol)
    gap = solution.primal_energy - solution.dual_energy
    # first order in the residual: complementarity terms of a nearly feasible u
    assert abs(gap) <= 1e3 * rtol * abs(solution.dual_energy)

    scene = two_bricks(comm, 5, end=end)
    with dual_program(scene) as dual:
        lam = dual.admissible
        for seed in range(3):
            x = lam.project(1e-2 * local_random(comm, len(dual.b), seed))
            u = fem.Function(scene.V)
            dual.response.displacement(x, u.x.petsc_vec)
            _, below = dual.energies(x, u.x.petsc_vec, np.zeros(0))
            assert below <= solution.dual_energy + 1e3 * rtol * abs(solution.dual_energy)
            # D(x) = -q(x) - 1/2 f'K^-1 f: differences are those of q
            r = dual.operator.apply(x) - dual.b
            q = 0.5 * float(dual.inner(x, r - dual.b))
            assert solution.dual_energy - below == pytest.approx(
                q - solution.q[-1], rel=1e-6, abs=1e3 * rtol * abs(solution.dual_energy)
            )


@pytest.mark.parallel
def test_displacement_solves_the_first_equation(comm):
    """(38.1): B u(lambda) = b + c - A lambda, with c the gap."""
    scene = two_bricks(comm, 4, Offset=1e-5)
    with dual_program(scene) as dual:
        x = local_random(comm, len(dual.b), 3)
        u = fem.Function(scene.V)
        dual.response.displacement(x, u.x.petsc_vec)
        gap = np.zeros(len(dual.b))
        normal = dual.jump.slices[0][0]
        gap[normal] = 1e-5 / dual.jump.stress_scale[normal]
        expected = dual.b + gap - dual.operator.apply(x)
        size = np.sqrt(dual.inner(expected, expected))
        difference = dual.jump.of_unknowns(u.x.petsc_vec) - expected
        assert np.sqrt(dual.inner(difference, difference)) <= SOLVE * size


@pytest.mark.parallel
def test_rounding_of_gradients_is_in_their_errors(comm):
    """The product of a step of rounding size is nothing but error, and is told to be."""
    with dual_program(two_bricks(comm, 2), "multigrid") as dual:
        dual.response.offset[:] += 1.0
        x = local_random(comm, len(dual.b), 0)
        x *= 1e-15 / np.sqrt(dual.inner(x, dual.operator.apply(x)))
        product = dual.operator.apply(x)
        (before, e), (after, f) = (dual.response.gradient(y, 1e-18) for y in (0.0 * x, x))
        missing = after - before - product
        # |e| <= sqrt(e'A^-1 e) sqrt(sigma_max), and x tells sigma_max about
        largest = dual.inner(product, product) / dual.inner(x, product)
        assert np.sqrt(dual.inner(missing, missing)) <= (e + f) * np.sqrt(largest)


def test_products_claim_what_was_reached():
    """Where the solver for K ends at its largest number of steps, or by its options, too early."""
    scene = two_bricks(MPI.COMM_SELF, 2)
    with dual_program(scene) as dual:
        A = dense_matrix(dual)
    few = {"pc_type": "jacobi", "ksp_max_it": 20}
    with dual_program(scene, "multigrid", **few) as dual:
        operator = dual.compliance.operator
        for seed in range(3):
            x = local_random(MPI.COMM_SELF, len(dual.b), seed)
            product, claimed = operator.product(x)
            missing = product - A @ x
            error = np.sqrt(missing @ np.linalg.solve(A, missing))
            # the norm of A^-1 is the least energy of a displacement with that jump
            assert 0.0 < error <= claimed
            dual.operator.apply(x)
            assert error <= dual.operator.product_error * np.sqrt(x @ A @ x)
