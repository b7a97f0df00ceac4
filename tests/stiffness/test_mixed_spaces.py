"""Displacements that are a component of a mixed space: which, what is refused, what is given."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import basix.ufl
import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactForce,
    ContactProblem,
    ContactStatus,
    InputError,
    StiffnessError,
    Tresca,
    solve_adaptively,
)
from scenes.blocks import LEFT, YOUNG, block
from scenes.pressures import with_pressure
from scenes.scene import EPS


@pytest.fixture
def plain(comm):
    """Pressed and pulled sideways."""
    return block(comm, (3, 2), degree=2, held=(LEFT,), friction=Tresca(0.2))


def elements(mesh, *names):
    """A mixed space of vectors and scalars: a family and a degree each, vectors if doubled."""
    cell, dim = mesh.basix_cell(), mesh.geometry.dim
    parts = [
        basix.ufl.element(family, cell, degree, shape=(dim,) if vector else ())
        for family, degree, vector in names
    ]
    return fem.functionspace(mesh, basix.ufl.mixed_element(parts))


def coupled(W, *, displacement):
    """A form of two vectors that do not feel each other; the other one is held by -1."""
    u, v = (function[:] for function in (ufl.TrialFunctions(W), ufl.TestFunctions(W)))
    one, other = displacement, 1 - displacement
    return (ufl.inner(ufl.grad(u[one]), ufl.grad(v[one])) - ufl.inner(u[other], v[other])) * ufl.dx


def test_which_component_touches(plain):
    """The only one that can; of several the one that V says, in any place."""
    vector = ("Lagrange", 1, True)
    W = elements(plain.mesh, vector, vector)
    left = plain.facet_tags.find(LEFT)
    for index in (0, 1):
        space = W.sub(index)
        held = fem.locate_dofs_topological((space, space.collapse()[0]), 1, left)
        bc = fem.dirichletbc(fem.Function(space.collapse()[0]), held, space)
        v = ufl.TestFunctions(W)[index]
        load = ufl.inner(fem.Constant(plain.mesh, (0.0, -1.0)), v) * ufl.dx
        given = (coupled(W, displacement=index), load, plain.pairs, [bc])
        with pytest.raises(InputError, match=r"sub-spaces \[0, 1\] .* such as V=W.sub\(0\)"):
            ContactProblem(*given)
        with ContactProblem(*given, V=space) as problem:
            solution = problem.solve(rtol=1e-8)
            parts = solution.w.split()
            assert np.abs(parts[index].collapse().x.array - solution.u.x.array).max() == 0.0
            assert np.abs(parts[1 - index].collapse().x.array).max() <= EPS
            assert solution.normal_force > 0.0


def test_spaces_without_displacements(plain):
    for names in (
        [("Lagrange", 1, False), ("Lagrange", 1, False)],
        [("Lagrange", 3, True), ("Lagrange", 1, False)],
        [("DG", 1, True), ("Lagrange", 1, False)],
    ):
        W = elements(plain.mesh, *names)
        u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
        with pytest.raises(InputError, match="or a mixed space with such a component, found"):
            ContactProblem(ufl.inner(u, v) * ufl.dx, None, plain.pairs)
    W = elements(plain.mesh, ("Lagrange", 2, True), ("Lagrange", 1, False))
    u, v = ufl.TrialFunction(W), ufl.TestFunction(W)
    with pytest.raises(InputError, match="or a mixed space with such a component, found"):
        ContactProblem(ufl.inner(u, v) * ufl.dx, None, plain.pairs, V=W.sub(1))
    with pytest.raises(InputError, match="from different function spaces"):
        plain.problem(V=plain.V.sub(0))


@pytest.mark.parallel
def test_what_is_given_for_the_whole_space(plain):
    """Forces balance in all rows, and another solver gets N and T with columns of K."""
    scene = with_pressure(plain, YOUNG, 0.5)
    with scene.problem() as problem:
        K, f = problem.stiffness, problem.load.copy()
        solution = problem.solve(rtol=1e-10)
        contact = problem.operators[0]
        p, t = contact.N.createVecLeft(), contact.T.createVecLeft()
        n = len(contact.gap)
        p.array = solution.multipliers[:n] * contact.weights[contact.normal_node]
        t.array = solution.multipliers[n:] * contact.weights[contact.tangent_node]
        force = f.duplicate()
        contact.N.multTranspose(p, force)
        contact.T.multTransposeAdd(t, force, force)
        residual = K * solution.w.x.petsc_vec - f + force
        free = ~problem.prescribed
        size = problem.comm.allreduce(np.abs(f.array).max(initial=0.0))
        assert np.abs(residual.array[free]).max(initial=0.0) <= 1e-9 * size
        assert solution.contact_force.function_space == solution.u.function_space
        lifted = solution.contact_force.x.petsc_vec.sum() - solution.pair_resultants[0].force.sum()
        assert abs(lifted) <= 1e-9 * solution.normal_force
        assert "beside" in str(problem)
        for owned in (p, t, force, residual, f):
            owned.destroy()
        before = solution.u.x.array.copy()
        for a in (
            fem.form(scene.a),
            matrix := dolfinx.fem.petsc.assemble_matrix(fem.form(scene.a)),
        ):
            if a is matrix:
                matrix.assemble()
            with scene.problem(a=a, L=fem.form(scene.L), V=scene.V) as other:
                again = other.solve(rtol=1e-10).u
                assert np.abs(again.x.array - before).max() <= 1e-8 * np.abs(before).max()
        matrix.destroy()


def test_what_is_refused(plain):
    scene = with_pressure(plain, YOUNG, 0.5)
    with pytest.raises(InputError, match="stiffness='multigrid' needs a positive definite K"):
        scene.problem(stiffness="multigrid")
    with scene.problem() as problem:
        with pytest.raises(InputError, match=r"and a is on a mixed space. Give solve\(accuracy"):
            problem.solve()
        problem.solve(accuracy=1e-3)
        with pytest.raises(InputError, match="needs a form of the displacement alone"):
            problem.goal_error(ContactForce((0.0, 1.0)))
        with pytest.raises(InputError, match=r"on the space of solution.u"):
            problem.update_geometry(fem.Function(scene.V))
    with pytest.raises(InputError, match=r"and nothing holds body 1 of 1.*springs"):
        scene.problem(bcs=[])


def test_pressures_that_are_prescribed(plain):
    """Zero, as where a part of the body has none; nothing else."""
    scene = with_pressure(plain, YOUNG, 0.5)
    part = scene.V.sub(1)
    value = fem.Constant(plain.mesh, 0.0)
    left = fem.locate_dofs_topological(part, 1, plain.facet_tags.find(LEFT))
    bcs = [*scene.bcs, fem.dirichletbc(value, left, part)]
    with scene.problem(bcs=bcs) as problem:
        solution = problem.solve(accuracy=1e-6)
        assert solution.status is ContactStatus.CONVERGED
        held = np.abs(solution.w.x.array[left])
        assert held.max(initial=0.0) == 0.0
        value.value = 2.0
        with pytest.raises(InputError, match=r"only displacements may be .* found 2 for"):
            problem.solve(accuracy=1e-6)


@pytest.mark.parallel
def test_saddle_points_that_are_none(plain):
    """Each leaves K symmetric: what it lacks is seen in the factors, and on the diagonal."""
    scene = with_pressure(plain, YOUNG, 0.5)
    (u, _), (v, q) = ufl.TrialFunctions(scene.V), ufl.TestFunctions(scene.V)
    with pytest.raises(
        StiffnessError, match=r"on the diagonal of an unknown .*ratio \(at most 0.5\)"
    ):
        with_pressure(plain, YOUNG, 0.6).problem()
    # pressures that no displacement feels
    with pytest.raises(StiffnessError, match=r"K is singular: .* stable pair"):
        with_pressure(plain, YOUNG, 0.5, ("DG", 2)).problem()
    with pytest.raises(StiffnessError, match="negative pivots, but"):  # one motion gives way
        soft = 2.0 * YOUNG * ufl.inner(u, v) * ufl.dx
        dataclasses.replace(scene, a=scene.a - soft).problem()
    with pytest.raises(StiffnessError, match="not symmetric"):
        dataclasses.replace(scene, a=scene.a - 2 * q * ufl.div(u) * ufl.dx).problem()


def test_forms_on_several_spaces(plain):
    Q = fem.functionspace(plain.mesh, ("Lagrange", 1))
    both = ufl.MixedFunctionSpace(plain.V, Q)
    (u, p), (v, q) = ufl.TrialFunctions(both), ufl.TestFunctions(both)
    a = (ufl.inner(ufl.grad(u), ufl.grad(v)) + p * ufl.div(v) + q * ufl.div(u)) * ufl.dx
    for given in (a, ufl.extract_blocks(a)):
        with pytest.raises(InputError, match=r"with basix.ufl.mixed_element"):
            plain.problem(a=given)


def test_adaptive_meshes_are_refused(plain):
    scene = with_pressure(plain, YOUNG, 0.5)
    with pytest.raises(InputError, match=r"a is on a mixed space"):
        solve_adaptively(lambda tagged: scene.problem(), plain.tagged_mesh, accuracy=0.1)
