"""A = B K^-1 B' and b, against dense algebra; and the near field, which is less than A."""

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

#: The same of energies, over the larger one.
SYMMETRIC = 1e-9


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
    free = np.ones(len(f), dtype=bool)
    for bc in scene.bcs:
        free[bc.dof_indices()[0]] = False
    x = V.tabulate_dof_coordinates()

    def nodes(name: str) -> np.ndarray:
        return fem.locate_dofs_topological(V, 2, scene.facet_tags.find(tags[name]))

    upper = np.array([i for i in nodes("upper_contact") if free[3 * i]])
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
    with dual_program(scene) as dual:
        mine = dense_matrix(dual)
        where = points_of(scene, dual.jump.pairs[0])
        own = np.lexsort(np.round(where, 9).T)
        assert np.allclose(where[own], points[order], atol=1e-12)
        assert np.allclose(dual.jump.pairs[0].weights[own], weights[order], rtol=1e-12)
        size = np.abs(A).max()
        normal = dual.jump.own_rows[0].normal[own]
        assert np.allclose(mine[np.ix_(normal, normal)], A[np.ix_(order, order)], atol=SOLVE * size)
        assert np.allclose(np.linalg.eigvalsh(mine), np.linalg.eigvalsh(A), atol=SOLVE * size)
        assert np.allclose(dual.b[normal], b[: len(points)][order], atol=SOLVE * np.abs(b).max())
        assert np.linalg.norm(dual.b) == pytest.approx(np.linalg.norm(b), rel=SOLVE)
        assert dual.compliance.products == len(b)


def test_products_are_counted_and_each_is_one_solve(comm):
    with dual_program(two_bricks(comm, 3)) as dual:
        solves = dual.compliance.solver.solves
        for number in range(1, 4):
            dual.compliance.apply(local_random(comm, len(dual.b), number))
            assert dual.compliance.products == dual.compliance.solver.solves - solves == number


@pytest.mark.parallel
def test_columns_by_an_iterative_solver_are_products(comm):
    """Their iterations are counted, and one that misses its tolerance is no exception."""
    with dual_program(two_bricks(comm, 3), "multigrid", ksp_max_it=2) as dual:
        assert np.isnan(dual.energy_resolution())  # no displacement counts as rounding
        solver = dual.compliance.solver
        before = solver.krylov_iterations
        assert dual.compliance.complete_products()
        assert solver.krylov_iterations == before + 2 * dual.jump.matrix.getSize()[0]


#: By solver of K: the least part of the energy of smooth tractions that the near field has.
LEAST = {"cholesky": 0.0, "multigrid": 0.4}


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", LEAST)
def test_it_is_less_than_A_and_symmetric(comm, stiffness, monkeypatch):
    """It has most of the energy of rough tractions, with multigrid of a pressure, too."""
    # a level of such a mesh, not K
    monkeypatch.setattr("dolfinx_tresca.dual.products.MOST_UNKNOWNS", 250)
    with dual_program(two_bricks(comm, 8), stiffness) as dual:
        pressure = np.zeros_like(dual.b)
        pressure[dual.admissible.normal] = 1.0
        for x, least in (
            (pressure, LEAST[stiffness]),
            (local_random(comm, len(dual.b), 1), max(0.2, LEAST[stiffness])),
        ):
            y = local_random(comm, len(dual.b), 2)
            of_x, of_y = (dual.compliance.near_field.apply(each) for each in (x, y))
            near, whole = dual.inner(x, of_x), dual.inner(x, dual.compliance.apply(x))
            assert least * whole <= near <= (1.0 + SYMMETRIC) * whole
            asymmetry = abs(dual.inner(y, of_x) - dual.inner(x, of_y))
            assert asymmetry <= SYMMETRIC * max(near, dual.inner(y, of_y))


def test_a_contact_solve_takes_few_times_the_iterations_of_a_linear_one():
    """Before there was a coarse level in it: 97 for 20. Products then had a tenth of the error."""
    scene = two_bricks(MPI.COMM_SELF, 8)
    with dual_program(scene, "multigrid") as dual:
        solver = dual.compliance.solver
        before = solver.krylov_iterations
        u = dual.jump.matrix.createVecRight()
        solver.improve(dual.jump.system.f.x.petsc_vec, u, rtol=1e-8, accuracy=0.0)
        linear = solver.krylov_iterations - before
        u.destroy()
    with scene.problem(stiffness="multigrid") as problem:
        assert problem.solve(accuracy=1e-3).krylov_iterations <= 3 * linear
