"""A = B K^-1 B' and b, against dense algebra."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from scenes.assembled import dense_matrix, dual_program, points_of
from scenes.scene import EPS
from scenes.two_bricks import two_bricks

#: rounding of a solve with K, whose condition number is about 1e4 on these meshes
SOLVE = 1e6 * EPS


def local_random(comm, size: int, seed: int) -> np.ndarray:
    return np.random.default_rng([seed, comm.rank]).standard_normal(size)


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
