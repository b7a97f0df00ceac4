"""What may stand in for forms of UFL, and forms with Functions on surfaces."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution, Coulomb, InputError, SurfaceFields, Tresca
from scenes.patches import BOTTOM, TOP, UPPER, patch
from scenes.scene import EPS, Scene

pytestmark = pytest.mark.parallel


@pytest.fixture
def scene(comm):
    return patch(comm, "quadrilateral", upper=(3, 1), lower=(2, 1), friction=Tresca(0.1))


def test_compiled_forms_and_matrices(scene):
    """The same contact as with forms of UFL; a matrix may be changed in place."""
    with scene.problem() as problem:
        expected = problem.solve(rtol=1e-10).u.x.array.copy()
    size = np.abs(expected).max()
    a, L = fem.form(scene.a), fem.form(scene.L)
    K = dolfinx.fem.petsc.assemble_matrix(a)
    K.assemble()
    for given in ({"a": a, "L": L}, {"a": a}, {"a": K, "L": None}, {"L": None}):
        with scene.problem(**given, V=scene.V) as problem:
            found = problem.solve(rtol=1e-10)
            assert np.abs(found.u.x.array - expected).max() <= 1e4 * EPS * size + 1e-9 * size
            if given.get("a") is K:
                K.scale(2.0)
                problem.update_stiffness()
                assert problem.solve(rtol=1e-10).normal_force == pytest.approx(
                    2.0 * found.normal_force, rel=1e-6
                )
                with pytest.raises(InputError, match=r"accuracy=\"balanced\", the default, .*1e-3"):
                    problem.solve()
    K.destroy()


def test_matrices_of_other_types(scene):
    """What PETSc converts is taken; entries may come where there were none."""
    with scene.problem() as problem:
        expected = problem.solve(rtol=1e-10).normal_force
    K = dolfinx.fem.petsc.assemble_matrix(fem.form(scene.a))
    K.assemble()
    for kind in ("dense", "baij"):
        other = K.convert(kind, PETSc.Mat())
        with scene.problem(a=other, V=scene.V) as problem:
            assert problem.solve(rtol=1e-10).normal_force == pytest.approx(expected, rel=1e-9)
        other.destroy()
    more = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
    with scene.problem(a=K, V=scene.V) as problem:
        N = problem.operators[0].N
        springs = N.transposeMatMult(N)
        K.axpy(100.0, springs, structure=more)
        problem.update_stiffness()
        after = problem.solve(rtol=1e-10).normal_force
    with scene.problem(a=K, V=scene.V) as problem:
        assert problem.solve(rtol=1e-10).normal_force == pytest.approx(after, rel=1e-9)
    for owned in (K, springs):
        owned.destroy()


def test_springs_between_bodies_on_springs(comm):
    """No body is held by itself: contact carries the load of the upper block, which floats."""
    scene = patch(comm, "quadrilateral", friction=Coulomb(0.5))
    (u, v), ds = scene.a.arguments()[::-1], ufl.Measure("ds", subdomain_data=scene.facet_tags)
    K = dolfinx.fem.petsc.assemble_matrix(fem.form(scene.a + ufl.inner(u, v) * ds(BOTTOM)))
    K.assemble()
    with scene.problem() as problem:
        N = problem.operators[0].N
        more = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        K.axpy(1.0, N.transposeMatMult(N), structure=more)
    with scene.problem(a=K, V=scene.V, L=-v[1] * ds(TOP), bcs=[]) as problem:
        assert problem.solve(rtol=1e-10).normal_force == pytest.approx(1.0, rel=1e-9)


def test_matrices_that_are_not_ready(scene):
    """Conditions in them, entries that are on their way, destroyed: each is said."""
    K = dolfinx.fem.petsc.assemble_matrix(fem.form(scene.a), scene.bcs)
    K.assemble()
    with scene.problem(a=K, V=scene.V) as problem:
        with pytest.raises(InputError, match=r"nothing but a diagonal .* Assemble it without bcs"):
            problem.solve(rtol=1e-6)
        scene.data.exact.x.array[:] = 0.0
        assert problem.solve(rtol=1e-6).normal_force == 0.0  # nothing of it is asked for
        K.destroy()
        with pytest.raises(InputError, match="the matrix a was destroyed"):
            problem.update_stiffness()
    sizes = (scene.V.dofmap.index_map.size_local * 2, scene.V.dofmap.index_map.size_global * 2)
    K = PETSc.Mat().createAIJ((sizes, sizes), nnz=1, comm=scene.mesh.comm)
    with pytest.raises(InputError, match=r"not assembled: call a.assemble\(\)"):
        scene.problem(a=K, V=scene.V)
    K.destroy()


def test_what_does_not_fit(scene, comm):
    other = patch(comm, "quadrilateral", upper=(2, 1), lower=(2, 1))
    K = dolfinx.fem.petsc.assemble_matrix(fem.form(other.a))
    K.assemble()
    for given, message in (
        ({"a": K, "V": scene.V}, "the matrix a must have the size of V"),
        ({"a": fem.form(scene.a), "L": None}, "is not known: .* so give V="),
        ({"a": fem.form(other.a), "V": scene.V}, "different function spaces, or not from V"),
        ({"a": fem.form(scene.L), "V": scene.V}, "a needs a trial and a test function"),
        ({"V": other.V}, "from different function spaces"),
        ({"V": 3}, "V must be the function space of the displacement, found 3"),
    ):
        with pytest.raises(InputError, match=message):
            scene.problem(**given)
    K.destroy()


def test_tags_on_another_mesh(scene, comm):
    """DOLFINx integrates over what has their numbers, without a word."""
    other = patch(comm, "quadrilateral", upper=(2, 1), lower=(2, 1))
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    dx = ufl.Measure("dx", domain=scene.mesh, subdomain_data=other.cell_tags)
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=other.facet_tags)
    for given, name in (
        ({"a": scene.a + ufl.inner(u, v) * dx(1)}, "a"),
        ({"L": scene.L + v[0] * ds(1)}, "L"),
    ):
        with pytest.raises(InputError, match=f"{name} has an integral over tags on another mesh"):
            scene.problem(**given)


@pytest.fixture(scope="module")
def solved() -> tuple[Scene, ContactSolution]:
    scene = patch(MPI.COMM_WORLD, "quadrilateral", upper=(3, 2), lower=(4, 1))
    with scene.problem() as problem:
        return scene, problem.solve(rtol=1e-10)


def pushed(scene: Scene, fields: SurfaceFields) -> Any:
    """Return the load of the pressure on the upper body's contact surface."""
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    (v,) = scene.L.arguments()
    return fields.pressure * ufl.inner(scene.data.push, v) * ds(UPPER)


def test_a_surface_function_in_a_form(comm, solved):
    """With the map of its surface a form integrates it, as one and as the load of a problem."""
    scene, solution = solved
    fields = solution.surface
    scene.data.push = ufl.as_vector(np.eye(2)[1])
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    form = fem.form(fields.pressure * ds(UPPER), entity_maps=fields.entity_maps)
    total = comm.allreduce(fem.assemble_scalar(form))
    assert total == pytest.approx(solution.normal_force, rel=64 * EPS)
    L = scene.L + pushed(scene, fields)
    with scene.problem(L=L, entity_maps=fields.entity_maps) as problem:
        moved = problem.solve(rtol=1e-10)
    # the ends are held: what lifts the upper body off comes off the contact force
    assert 0.0 < moved.normal_force < solution.normal_force


def test_without_a_map_the_problem_says_so(solved):
    scene, solution = solved
    scene.data.push = ufl.as_vector(np.eye(2)[1])
    with pytest.raises(InputError, match=r"the form L holds the Function 'pressure'.*on_mesh"):
        scene.problem(L=scene.L + pushed(scene, solution.surface))
