"""The estimate of the mesh's error against the true one, and what "balanced" makes of it."""

from __future__ import annotations

import itertools

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus
from dolfinx_tresca.dual.accuracy import DiscretisationError, total
from scenes.assembled import linear_solution
from scenes.clamped_square import clamped_square
from scenes.manufactured import blocks_scene, norm
from scenes.patches import KINDS as CELLS
from scenes.patches import dim_of
from scenes.revolution import ring_elasticity, ring_energy
from scenes.two_bricks import two_bricks

#: Estimate over error where the solution is smooth, by degree.
EFFECTIVITY = {1: (0.95, 1.3), 2: (0.7, 1.0)}

#: What users are told, wherever edges are and bodies are of one material.
PROMISED = (0.7, 1.5)


@pytest.mark.parallel(cell=["triangle", "hexahedron"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_effectivity_on_a_known_solution(comm, cell, degree):
    dim = dim_of(cell)
    for k in (4, 8) if dim == 2 else (2,):
        scene = blocks_scene(comm, cell, degree, (2 * k, 3 * k))
        with scene.problem() as problem:
            solution = problem.solve(accuracy=1e-5)
        cells = DiscretisationError(scene.a, scene.V).cell_errors(solution.u)
        error = norm(comm, scene.data.energy(solution.u - scene.data.exact))
        low, high = EFFECTIVITY[degree]
        assert low <= total(cells) / error <= high


@pytest.mark.parametrize("poisson", [0.3, 0.49])
def test_effectivity_at_singular_corners(poisson):
    """At singular corners the estimate is 0.7 to 1.5 times the error, as promised."""
    comm = MPI.COMM_SELF
    a, u, exact = clamped_square(comm, "quadrilateral", 24, 2, poisson, grading=4.0)
    left = total(DiscretisationError(a, u.function_space).cell_errors(u))
    for cell in ("triangle", "quadrilateral"):
        for degree in (1, 2):
            a, u, found = clamped_square(comm, cell, 8, degree, poisson)
            estimate = total(DiscretisationError(a, u.function_space).cell_errors(u))
            assert left <= 0.25 * estimate
            low, high = PROMISED
            assert low <= estimate / np.sqrt(found**2 - exact**2) <= high


def rod(comm, cells, ratio, degree, kind="triangle"):
    """Solve a rod whose right half is stiffer by a ratio, under a load along it.

    Returns the form, the space, the displacement, and the energy norm of its error.
    """
    cell = getattr(dolfinx.mesh.CellType, kind)
    mesh = dolfinx.mesh.create_rectangle(comm, [(0, 0), (2, 2 / cells)], [cells, 1], cell)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    x = ufl.SpatialCoordinate(mesh)
    young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    young.interpolate(lambda x: np.where(x[0] < 1.0, 1.0, ratio))
    v, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = young * ufl.inner(ufl.grad(v), ufl.grad(w)) * ufl.dx
    fixed = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    load = x[0] ** 2 * w[0] * ufl.dx
    u = linear_solution(a, load, [fem.dirichletbc(np.zeros(2), fixed, V)])
    exact = (8.0 - x[0] ** 3) / (3.0 * young)
    error = young * ((u[0].dx(0) - exact) ** 2 + u[0].dx(1) ** 2) * ufl.dx
    return a, V, u, norm(comm, error)


@pytest.mark.parallel
def test_materials_inside_a_body_have_gradients_of_their_own(comm):
    """The estimate is right where the stiffness jumps by a thousand inside a body."""
    for degree in (1, 2):
        for cells in (8, 64):
            a, V, u, error = rod(comm, cells, 1e3, degree)
            assert 0.4 <= total(DiscretisationError(a, V).cell_errors(u)) / error <= 1.3


def test_degree_2_along_one_direction():
    """Gradients of a smooth solution hardly jump on a regular mesh, as the page says."""
    parts = []
    for cells in (8, 16, 32):
        a, V, u, error = rod(MPI.COMM_SELF, cells, 1.0, 2, "quadrilateral")
        parts.append(total(DiscretisationError(a, V).cell_errors(u)) / error)
    assert parts[0] < 0.7
    assert all(0.4 <= fine / coarse <= 0.75 for coarse, fine in itertools.pairwise(parts))


@pytest.mark.parametrize(
    ("hole", "degree", "promised"),
    [(0.0, 1, (0.9, 1.3)), (0.0, 2, (0.9, 1.3)), (0.05, 1, (0.5, 1.3))],
)
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_effectivity_in_bodies_of_revolution(kind, degree, hole, promised):
    """The estimate is right in a disc whose axis belongs to it, and at a thin hole.

    The cell at the hole is three times as long as the hole is wide, so that less is promised.
    """
    comm, cell = MPI.COMM_SELF, getattr(dolfinx.mesh.CellType, kind)
    mesh = dolfinx.mesh.create_rectangle(comm, [(hole, 0), (1, 1)], [8, 8], cell)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    (r, z), u = ufl.SpatialCoordinate(mesh), fem.Function(V)
    if hole > 0.0:
        exact = ufl.as_vector([1.0 / r + r**2, 0.0 * r])
        u.interpolate(lambda x: np.stack([1.0 / x[0] + x[0] ** 2, 0.0 * x[0]]))
    else:
        exact = ufl.as_vector([ufl.sin(2 * r) * (1 + z**2), r * z**2])
        u.interpolate(lambda x: np.stack([np.sin(2 * x[0]) * (1 + x[1] ** 2), x[0] * x[1] ** 2]))
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    bcs = [fem.dirichletbc(u, fem.locate_dofs_topological(V, 1, facets))]
    a = ring_elasticity(V, 1.0)
    L = ring_energy(exact, ufl.TestFunction(V), mesh, 1.0)
    found = linear_solution(a, L, bcs, axisymmetric=True)
    estimator, wrong = DiscretisationError(a, V, axisymmetric=True), found - exact
    assert estimator._count == 1
    low, high = promised
    error = norm(comm, ring_energy(wrong, wrong, mesh, 1.0))
    assert low <= total(estimator.cell_errors(found)) / error <= high


def test_springs_and_coefficients(comm):
    """Springs do not change the estimate, and coefficients of the form do."""
    mesh = dolfinx.mesh.create_unit_square(comm, 4, 4)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    u.interpolate(lambda x: np.stack([x[0] ** 2, x[0] * x[1]]))
    v, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    young.x.array[:] = 1.0
    stretch = young * ufl.inner(ufl.sym(ufl.grad(v)), ufl.sym(ufl.grad(w))) * ufl.dx
    spring = ufl.inner(v, w) * ufl.ds + 3.0 * ufl.inner(v, w) * ufl.dx
    plain = DiscretisationError(stretch, V).cell_errors(u).x.array.copy()
    assert plain.max() > 0.0
    assert np.allclose(
        DiscretisationError(stretch + spring, V).cell_errors(u).x.array, plain, rtol=1e-12
    )
    young.x.array[:] = 4.0
    assert np.allclose(
        DiscretisationError(stretch, V).cell_errors(u).x.array, 2.0 * plain, rtol=1e-12
    )


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_balanced(comm, stiffness):
    """The iteration ends soon after its error has become a tenth of that of the mesh."""
    scene = two_bricks(comm, 6)
    with scene.problem(stiffness=stiffness) as problem:
        solution = problem.solve()
        assert solution.options.balanced
        assert solution.status is ContactStatus.CONVERGED
        # the estimate at the end is that on the way, but for a few percent
        assert solution.energy_error_bound <= 0.11 * solution.discretisation_error
        assert total(solution.cell_errors) > 0.0
        assert "mesh error" in str(solution)
        problem.forget()
        tight = problem.solve(rtol=1e-6)
    assert tight.discretisation_error is None
    assert tight.cell_errors is None
    assert solution.products <= tight.products
    # what the iteration leaves is small beside the error of the mesh
    difference = fem.Function(scene.V)
    difference.x.array[:] = solution.u.x.array - tight.u.x.array
    form = ufl.action(ufl.action(scene.a, difference), difference)
    whole = ufl.action(ufl.action(scene.a, tight.u), tight.u)
    assert norm(comm, form) <= 0.2 * solution.discretisation_error * norm(comm, whole)
