"""A as a matrix, by columns or from the compliance of the surfaces."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx.fem.petsc
from dolfinx import fem

from dolfinx_tresca import Coulomb
from scenes.hertz import cylinder_on_plane
from scenes.large_sliding import hemisphere
from scenes.patches import patch
from scenes.wall import HEIGHT, wall


@pytest.fixture
def refused(monkeypatch):
    """Do without the compliance of the surfaces from this call on."""
    name = "dolfinx_tresca.dual.products.SurfaceCompliance.rows"
    return lambda: monkeypatch.setattr(name, lambda *arguments: None)


def pushed(comm) -> tuple[np.ndarray, int]:
    """Displacements of the wall's top at the end of accepted load steps, and products."""
    scene, products = wall(comm, 3, 5), 0
    course = scene.data.weights.sum() / 5
    with scene.problem() as problem:
        for part in (0.0, 0.1):
            scene.data.push.value = part * course / HEIGHT
            solution = problem.solve(rtol=1e-9)
            solution.raise_if_failed()
            products += solution.products
            problem.accept()
        u = solution.u.x.petsc_vec
        return np.array([u.norm(), u.sum()]), products


@pytest.mark.parallel
@pytest.mark.parametrize(("h", "most"), [(0.02, 93), (0.01, 30)])
def test_it_is_computed_at_once_only_where_that_is_cheap(comm, h, most):
    """93 columns with 12,719 unknowns are; 175 with 46,564 take longer than a few products."""
    with cylinder_on_plane(comm, h).problem(stiffness="cholesky") as problem:
        assert most // 3 < problem.solve().products <= most


@pytest.mark.parallel
def test_it_is_not_completed_where_only_the_near_field_is_slow(comm, monkeypatch):
    """A hemisphere pressed into a block: fewer products than A has columns (39, before 952)."""
    monkeypatch.setattr("dolfinx_tresca.dual.products.ENTRIES_AT_ONCE", 0.0)
    body = hemisphere(comm, 6)
    with body.problem:
        assert [body.move(0.0, 0.0, -z) for z in (0.1, 0.2, 0.3)][-1].products < 160


@pytest.mark.parallel
def test_solutions_are_those_without_the_matrix(comm, refused):
    """The wall under its weight and pushed: the same displacement; a push takes no product."""
    with_matrix, products = pushed(comm)
    refused()
    without, _ = pushed(comm)
    # relative residuals of 1e-9; displacements of the wall as a whole magnify them
    assert np.allclose(with_matrix, without, rtol=1e-6)
    assert products <= 32


@pytest.mark.parallel
@pytest.mark.parametrize("springs", [0.0, 100.0])
@pytest.mark.parametrize(("kind", "degree"), [("triangle", 2), ("tetrahedron", 1)])
def test_pairings_share_the_compliance(comm, refused, kind, degree, springs):
    """A block that moves to and fro on another one: the same forces, at last without products.

    With springs between the blocks, in a matrix of the user, no block responds to its loads alone.
    """
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(6, 2), friction=Coulomb(0.3))
    upper = scene.V.tabulate_dof_coordinates()[:, scene.mesh.geometry.dim - 1] > 1.0
    moved, K = fem.Function(scene.V), dolfinx.fem.petsc.assemble_matrix(fem.form(scene.a))
    K.assemble()
    with scene.problem() as problem:
        N = problem.operators[0].N
        K.axpy(springs, N.transposeMatMult(N), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)

    def forces() -> tuple[list[np.ndarray], int]:
        """Contact forces of each pairing, and the products of the last one."""
        result = []
        with scene.problem(**({"a": K, "V": scene.V} if springs else {})) as problem:
            for shift in (0.0, 0.1, 0.2, -0.1, 0.1, 0.2, 0.1):
                moved.x.array.reshape(len(upper), -1)[upper, 0] = shift
                problem.update_geometry(moved)
                solution = problem.solve(rtol=1e-10)
                result.append(solution.pair_resultants[0].force)
        return result, solution.products

    shared, products = forces()
    refused()
    assert np.allclose(shared, forces()[0], rtol=1e-8, atol=1e-8)
    assert springs or products == 0
