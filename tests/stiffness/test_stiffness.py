"""K and f: elimination, both solvers, and what is said where K is not positive definite."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus, InputError, StiffnessError
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca.stiffness.choice import SolverRequest
from scenes.elasticity import elasticity
from scenes.scene import EPS
from scenes.two_bricks import YOUNG, bricks_problem, two_bricks


@pytest.mark.parallel
def test_prescribed_values_are_exact(comm):
    """Inhomogeneous values, also of single components, and their work on the other rows."""
    scene = two_bricks(comm, 3)
    value = np.array([1e-5, -2e-5, -3e-5])
    scene = dataclasses.replace(
        scene, bcs=[scene.fixed("upper_fixed", value), scene.fixed("lower_fixed")]
    )
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
    facets = scene.facet_tags.find(scene.tags["upper_fixed"])
    nodes = fem.locate_dofs_topological(scene.V, 2, facets)
    assert (solution.u.x.array.reshape(-1, 3)[nodes] == value).all()


def raises_stiffness(scene, message: str, **changes) -> str:
    with pytest.raises(StiffnessError, match=message) as caught:
        scene.problem(**changes)
    return str(caught.value)


@pytest.mark.parallel
def test_a_slightly_unsymmetric_form_is_refused(comm):
    """A relative defect of 1e-6 is no rounding."""
    scene = two_bricks(comm, 3)
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    wind = ufl.as_vector([0.0, 1e-4 * YOUNG, 0.0])
    raises_stiffness(
        scene, "not symmetric", a=scene.a + ufl.inner(ufl.dot(ufl.grad(u), wind), v) * ufl.dx
    )


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_a_negative_modulus_is_refused(comm, stiffness):
    """By the set-up, or by the first solve with K that meets it."""
    scene = two_bricks(comm, 3)
    with (
        pytest.raises(StiffnessError, match="not positive definite") as caught,
        scene.problem(a=elasticity(scene.V, -YOUNG), stiffness=stiffness) as problem,
    ):
        problem.solve(rtol=1e-6)
    assert "nothing holds" not in str(caught.value)


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_a_body_without_stiffness_is_named(comm, stiffness):
    """Young's modulus is zero in all cells of a brick: all its nodes but the prescribed ones."""
    scene = two_bricks(comm, 3)
    young = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
    young.x.array[:] = YOUNG
    young.x.array[scene.cell_tags.find(scene.tags["upper"])] = 0.0
    with (
        pytest.raises(StiffnessError, match=r"the stiffness is zero at \d+ of \d+ nodes of body"),
        scene.problem(a=elasticity(scene.V, young), stiffness=stiffness) as problem,
    ):
        problem.solve(rtol=1e-6)


@pytest.mark.parallel(value=[np.inf])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coefficients_that_are_no_numbers_are_found(comm, value):
    scene = two_bricks(comm, 3)
    young = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
    young.x.array[:] = YOUNG
    if comm.rank == comm.size - 1:
        young.x.array[0] = value
    young.x.scatter_forward()
    raises_stiffness(scene, "NaN or infinite", a=elasticity(scene.V, young))


@pytest.mark.parallel(value=[np.inf])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_loads_that_are_no_numbers_are_found(comm, value):
    scene = two_bricks(comm, 3)
    with scene.problem() as problem:
        scene.data.load.value[2] = value
        with pytest.raises(InputError, match=r"load vector .*NaN or infinite"):
            problem.solve(rtol=1e-6)
        scene.data.load.value[2] = -1.0
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


@pytest.mark.parallel
def test_prescribed_values_that_are_no_numbers_are_found(comm):
    scene = two_bricks(comm, 3)
    bcs = [scene.fixed("upper_fixed", [0.0, np.nan, 0.0]), scene.fixed("lower_fixed")]
    with (
        dataclasses.replace(scene, bcs=bcs).problem() as problem,
        pytest.raises(InputError, match=r"NaN or infinite.*\n?.*Dirichlet"),
    ):
        problem.solve(rtol=1e-6)


@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_petsc_options_are_removed_again(comm, stiffness):
    before = PETSc.Options().getAll()
    with bricks_problem(
        comm,
        3,
        options={"stiffness": stiffness, "petsc_options": {"ksp_rtol": 1e-9, "ksp_max_it": 77}},
    ) as problem:
        assert PETSc.Options().getAll() == before
        problem.update_stiffness()
        assert PETSc.Options().getAll() == before
    with pytest.raises(StiffnessError):
        two_bricks(comm, 3).problem(stiffness=stiffness, petsc_options={"pc_type": "nonsense"})
    assert PETSc.Options().getAll() == before


def test_petsc_options_of_the_user_take_effect(comm):
    def krylov(**petsc_options) -> int:
        options = {"stiffness": "multigrid", "petsc_options": petsc_options}
        with bricks_problem(comm, 4, options=options) as problem:
            return problem.solve(rtol=1e-6).krylov_iterations

    usual = krylov()
    assert krylov(pc_type="jacobi") > 2 * usual


def test_cholmod_that_the_user_chose_is_not_replaced(comm):
    """It factors K, or an error says that this PETSc does not have it."""
    options = {"pc_factor_mat_solver_type": "cholmod"}
    scene = two_bricks(comm, 3)
    if any(map(PETSc.Sys.hasExternalPackage, ("cholmod", "suitesparse"))):
        with scene.problem(stiffness="cholesky", petsc_options=options) as problem:
            assert "CHOLMOD" in str(problem)
    else:
        with pytest.raises(StiffnessError, match="Could not locate solver type cholmod"):
            scene.problem(stiffness="cholesky", petsc_options=options)


@pytest.mark.parallel
def test_auto_takes_the_factorisation_for_small_models(comm):
    def chosen(size, dim=3, solves=1):
        return SolverRequest(expected_solves=solves).choose(size, dim, comm)[0]

    assert chosen(1000) == "cholesky"
    assert chosen(10**7) == "multigrid"
    assert SolverRequest("multigrid").choose(10, 3, comm)[0] == "multigrid"
    # what multigrid does better once, or in space, Cholesky does better often, or in the plane
    assert chosen(200_000) == "multigrid"
    assert chosen(200_000, solves=10) == "cholesky"
    assert chosen(200_000, dim=2) == "cholesky"
    with bricks_problem(comm, 3) as problem:
        dofs = problem.stiffness.getSize()[0]
        assert f"since {dofs // 2} unknowns of a body <= 50,000" in str(problem)
    # memory
    assert chosen(10**7, solves=10**6) == "multigrid"
    with pytest.raises(InputError, match=r"auto, cholesky, multigrid.*'lu'"):
        SolverRequest("lu")
    for wrong in (0, 2.5, "two"):
        with pytest.raises(InputError, match="expected_solves"):
            SolverRequest(expected_solves=wrong)


@pytest.mark.parallel
@pytest.mark.parametrize("towards", [0.0, -1.0, 1.0])
def test_numbers_of_bodies_depend_on_neither_rounding_nor_ranks(comm, towards):
    """Below and above x = 0: whose corner is the lower one by an ulp depends on the processor."""
    scene = two_bricks(comm, 2)
    x = scene.mesh.geometry.x
    upper = x[:, 2] > 1.0 + 1e-9
    x[upper & (x[:, 0] < 1e-9), 0] = towards * 2e-17
    x[upper & (x[:, 1] > 1.0 - 1e-9), 1] *= 1.0 + towards * EPS
    body, z = label_bodies(scene.V), scene.V.tabulate_dof_coordinates()[:, 2]
    assert (body[z > 1.0 + 1e-9] == 1).all() and (body[z < 1.0 - 1e-9] == 0).all()
    assert set(np.unique(body)) <= {0, 1}  # at the interface either


def test_numbers_of_bodies_do_not_hang_on_a_digit_that_is_rounded():
    """Coordinates halfway between two multiples of 1e-10 of the largest one differ by an ulp."""
    triangle = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    for right, left in ((1.0, 1.0 + EPS), (1.0 + EPS, 1.0), (1.0, 1.0)):
        upper = [[right, 3.0], [2.0, 3.0], [2.0, 2048.0]]
        lower = [[left, 0.0], [2.0, 0.0], [2.0, 1.0]]
        cells = np.array([[0, 1, 2], [3, 4, 5]])
        mesh = dolfinx.mesh.create_mesh(
            MPI.COMM_SELF, cells=cells, x=np.array(upper + lower), e=triangle
        )
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body, y = label_bodies(V), V.tabulate_dof_coordinates()[:, 1]
        assert (body == (y > 2.0)).all()


def test_bodies_in_one_place_are_numbered_as_the_mesh_file_has_them(comm):
    """The bounds are the same but for rounding; the cells are two triangles."""
    triangle = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    for towards in (-1.0, 1.0):
        ulp = towards * 2e-17
        points = np.array([[1.0, 1.0], [0.0, 1.0], [1.0, 0.0], [ulp, ulp], [1.0, ulp], [ulp, 1.0]])
        mesh = dolfinx.mesh.create_mesh(
            MPI.COMM_SELF, cells=np.array([[0, 1, 2], [3, 4, 5]]), x=points, e=triangle
        )
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        body, x = label_bodies(V), V.tabulate_dof_coordinates()
        low = body[np.abs(x[:, :2]).sum(axis=1) < 0.5]
        assert list(low) == [1]
