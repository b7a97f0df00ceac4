"""Nonlinear bodies against analysis, quadratic convergence, and what happens where it fails."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactStatus,
    ConvergenceError,
    Coulomb,
    InputError,
    NewtonOptions,
    NonlinearContactProblem,
    NormalForce,
    RigidPlane,
    RigidSphere,
    SolverOptions,
    Tresca,
)
from dolfinx_tresca.problem import newton
from scenes.blocks import ABOVE, RIGHT, block
from scenes.elasticity import fixed
from scenes.rubber_block import neo_hookean, rubber_block, uniaxial_stress

#: Accuracy of Newton's method, and of contact.
TIGHT = NewtonOptions(accuracy=1e-10)
CONTACT = SolverOptions(rtol=1e-10)


def compressed(push, strain, height=1.0):
    """Set the displacement of the top."""
    if push.value.ndim:
        push.value[-1] = -strain * height
    else:
        push.value = -strain * height


@pytest.mark.parallel(n=[(2, 3)], strain=[0.4])
@pytest.mark.parametrize(("n", "strain"), [((2, 3), 0.2), ((2, 3), 0.4), ((2, 2, 2), 0.4)])
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_uniaxial_compression(comm, n, strain, sliding):
    """The closed form, also where the tangent is indefinite without contact."""
    scene = rubber_block(comm, n).but(sliding=sliding)
    with scene.problem(options=CONTACT, newton=TIGHT) as problem:
        compressed(scene.push, strain)
        solution = problem.solve()
    solution.raise_if_failed()
    wanted = -uniaxial_stress(1.0 - strain, len(n))
    assert solution.normal_force == pytest.approx(wanted, rel=1e-9)
    if sliding == "small":  # else pressures refer to the area of the wider face
        assert solution.peak_pressure == pytest.approx(wanted, rel=1e-7)
    assert np.array_equal(solution.u.x.array, scene.u.x.array)


def test_shows_the_options_of_the_user(comm):
    """Newton's method requests other accuracies for its contact problems, which nobody set."""
    scene = rubber_block(comm, (3, 3))
    with scene.problem() as problem:
        problem.options = SolverOptions(rtol=1e-3)
        compressed(scene.push, 0.02)
        assert "residual 1e-03" in str(problem)
        assert "residual 1e-03" in str(problem.solve())
        assert "residual 1e-03" in str(problem)


def test_quadratic_convergence(comm):
    """Each residual is about the square of the one before; contact is exact in every step."""
    scene = rubber_block(comm, (4, 4), clamped=True, friction=Tresca(0.1))
    with scene.problem(options=CONTACT, newton=TIGHT) as problem:
        scene.push.value[:] = 0.02, -0.1
        solution = problem.solve()
    solution.raise_if_failed()
    residuals = [step.residual for step in solution.newton.steps]
    assert len(residuals) <= 4
    assert all(b < 2.0 * a**2 for a, b in pairwise(residuals))
    assert 0 < solution.counts.contact_stick < solution.counts.contact
    assert str(solution.newton).count("\n") == len(residuals)


def test_linear_bodies_take_one_step(comm):
    """A linear residual form gives what `ContactProblem` gives."""
    scene = block(comm, (4, 3), boxes=True, held=(2,), moved=lambda x: 0.0 * x[:2] - 0.01)
    u = fem.Function(scene.V)
    F = ufl.action(scene.a, u) - scene.L
    with scene.problem() as problem:
        wanted = problem.solve(rtol=1e-10)
    with NonlinearContactProblem(F, u, scene.pairs, scene.bcs, options=CONTACT) as problem:
        found = problem.solve()
    assert len(found.newton.steps) == 1
    assert np.allclose(found.u.x.array, wanted.u.x.array, atol=1e-8 * 0.01)
    assert found.normal_force == pytest.approx(wanted.normal_force, rel=1e-7)


def test_indefinite_tangents_get_springs_that_do_not_count(comm):
    """Compressed by 40 % a block buckles unless the plate holds it; in one part or in four."""
    forces = []
    for parts in (1, 4):
        scene, added = rubber_block(comm, (4, 4), clamped=True, friction=Tresca(0.2)), set()
        with scene.problem(options=CONTACT, newton=TIGHT) as problem:
            for strain in np.arange(1, parts + 1) * 0.4 / parts:
                compressed(scene.push, strain)
                solution = problem.solve()
                solution.raise_if_failed()
                added |= {step.added for step in solution.newton.steps}
        assert "contact 10" in added
        forces.append(solution.normal_force)
    assert forces[0] == pytest.approx(forces[1], rel=1e-8)


def test_goes_on_while_it_falls(comm):
    """With the undeformed stiffness added residuals fall by a factor: no reason for smaller parts.

    Of degree 2, squeezed by 40 % in one go; ten steps that each halve it or better.
    """
    scene = rubber_block(comm, (4, 4), degree=2, clamped=True)
    compressed(scene.push, 0.4)
    with scene.problem(newton=NewtonOptions(max_iterations=5)) as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    steps = solution.newton.steps
    assert {step.fraction for step in steps} == {1.0}
    assert 5 < len(steps) <= 20
    assert "proximal" in steps[-1].added


def test_past_a_snap(comm):
    """Without the undeformed bodies' stiffness again, forces of degree 2 grow for one more step."""
    scene = rubber_block(comm, (8, 8), degree=2, clamped=True, friction=Coulomb(0.3))
    compressed(scene.push, 0.44)
    with scene.problem() as problem:
        problem.solve().raise_if_failed()


@pytest.mark.long
@pytest.mark.parametrize(("cells", "snap"), [(8, 0.431), (16, 0.349)])
def test_a_snap_is_the_models_and_not_the_methods(comm, cells, snap):
    """Small load steps and one solve snap at the same strain, and end at the same displacement.

    The finer the mesh the sooner; there the undeformed bodies' stiffness is needed both times.
    """
    step, beyond = 0.0025, snap + 0.006
    paths = []
    for strains in (beyond - step * np.arange(5.0, -1.0, -1.0), [beyond]):
        scene = rubber_block(comm, (cells, cells), degree=2, clamped=True, friction=Coulomb(0.3))
        with scene.problem() as problem:
            path = []
            for strain in strains:
                compressed(scene.push, strain)
                solution = problem.solve()
                solution.raise_if_failed()
                added = any("proximal" in one.added for one in solution.newton.steps)
                path.append((strain, scene.u.x.array.copy(), added))
        paths.append(path)
    small, (last,) = paths
    moved = [np.abs(b[1] - a[1]).max() / step for a, b in pairwise(small)]
    jumps = [strain for (strain, *_), move in zip(small[1:], moved, strict=True) if move > 5.0]
    assert len(jumps) == 1 and snap <= jumps[0] <= snap + step
    assert next(strain for strain, _, added in small[1:] if added) == jumps[0]
    assert last[2]
    # ten times the accuracy of Newton's method, of displacements of the size of the block
    assert np.abs(last[1] - small[-1][1]).max() <= 10.0 * NewtonOptions().accuracy


def test_springs_do_not_magnify_what_contact_leaves(comm):
    """Springs of 1000 times what contact was off by: residuals stayed at its accuracy for ever."""
    scene = rubber_block(comm, (4, 4), degree=2, clamped=True, friction=Tresca(0.2))
    compressed(scene.push, 0.4)
    with scene.problem() as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    steps = solution.newton.steps
    assert "contact 1000" in {step.added for step in steps}
    assert {step.fraction for step in steps} == {1.0}
    assert steps[-1].contact_residual <= 1e-7 < NewtonOptions().accuracy


def test_halves_the_load_where_newton_fails(comm, monkeypatch):
    """A change that four steps do not stand is brought on in parts, with the same answer."""
    monkeypatch.setattr(newton, "MAX_ITERATIONS_FACTOR", 1)  # else it goes on, since residuals fall
    scene = rubber_block(comm, (2, 2))
    compressed(scene.push, 0.7)
    with scene.problem(options=CONTACT, newton=NewtonOptions(1e-10, 4)) as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    assert len({step.fraction for step in solution.newton.steps}) > 1
    assert solution.normal_force == pytest.approx(-uniaxial_stress(0.3, 2), rel=1e-8)


def test_failure_names_the_step_and_what_to_do(comm):
    """A top that is pushed through the bottom: no displacement does that."""
    scene, seen = rubber_block(comm, (2, 2)), np.zeros(18)
    changes = {"before_assembly": lambda: np.copyto(seen, scene.u.x.array)}
    with scene.problem(newton=NewtonOptions(max_halvings=2), **changes) as problem:
        compressed(scene.push, 0.3)
        problem.solve().raise_if_failed()
        problem.accept()
        compressed(scene.push, 1.2)
        solution = problem.solve()
        assert solution.status is ContactStatus.NO_EQUILIBRIUM
        assert np.array_equal(seen, scene.u.x.array)  # not where a part of the load has failed
        # forces on free nodes are what the failed step has left out of balance
        unbalanced = solution.newton.unbalanced
        assert unbalanced.function_space == scene.u.function_space
        assert np.abs(unbalanced.x.array).max() > 0.0 or np.isnan(unbalanced.x.array).any()
        assert (solution.newton.flips.x.array == 0).all()  # all nodes stay in contact
        with pytest.raises(ConvergenceError, match=r"number 2 .* step .*unbalanced.*smaller"):
            solution.raise_if_failed()
        with pytest.raises(ConvergenceError, match="raise_if_failed"):
            problem.accept()
        compressed(scene.push, 0.4)
        again = problem.solve()
    again.raise_if_failed()
    assert again.newton.unbalanced is again.newton.flips is None
    assert again.normal_force == pytest.approx(-uniaxial_stress(0.6, 2), rel=1e-5)


def test_loads_in_the_form_are_halved_too(comm, monkeypatch):
    """What is a Constant of F is brought on as forces out of balance."""
    monkeypatch.setattr(newton, "MAX_ITERATIONS_FACTOR", 1)
    scene = rubber_block(comm, (2, 2))
    pull = fem.Constant(scene.scene.mesh, np.zeros(2))
    v = scene.F.arguments()[0]
    F = scene.F - ufl.inner(pull, v) * ufl.dx
    answers = []
    for limit in (15, 3):
        scene.u.x.array[:] = 0.0
        with scene.problem(F=F, newton=NewtonOptions(1e-10, limit), options=CONTACT) as problem:
            pull.value[:] = 2.0, 0.0
            solution = problem.solve()
        solution.raise_if_failed()
        answers.append(solution)
    parts = [{step.fraction for step in one.newton.steps} for one in answers]
    assert len(parts[0]) < len(parts[1])
    assert np.allclose(answers[0].u.x.array, answers[1].u.x.array, atol=1e-8)


def test_a_body_that_contact_alone_holds(comm):
    """Under pressure its tangent pushes rotations on: springs in the contact hold them."""
    scene = rubber_block(comm, (3, 3), clamped=True, friction=Coulomb(0.5))
    load = fem.Constant(scene.scene.mesh, np.array([0.02, -0.3]))
    ds = ufl.Measure("ds", scene.scene.mesh, subdomain_data=scene.scene.facet_tags)
    F = scene.F - ufl.inner(load, scene.F.arguments()[0]) * ds(ABOVE)
    with scene.problem(F=F, bcs=[]) as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    assert solution.newton.steps[-1].added == "contact 10"
    assert np.allclose(solution.pair_resultants[0].force, -load.value, atol=1e-5)


@pytest.mark.parametrize("asked", [{"rtol": 1e-2}, {"accuracy": 1e-2}])
def test_contact_is_as_accurate_as_newton(comm, asked):
    """Else forces of contact that are left as they are would leave something out of balance."""
    scene = rubber_block(comm, (3, 2), clamped=True, friction=Coulomb(0.3))
    scene.push.value[:] = 0.1, -0.2
    with scene.problem(options=SolverOptions(**asked)) as problem:
        rough = problem.solve()
    rough.raise_if_failed()
    scene.u.x.array[:] = 0.0
    with scene.problem(options=CONTACT, newton=TIGHT) as problem:
        exact = problem.solve()
    assert rough.tangential_force == pytest.approx(exact.tangential_force, rel=1e-4)


@pytest.mark.parametrize("friction", [Tresca(1e-3), Coulomb(0.3)])
@pytest.mark.parametrize("sliding", ["small", "finite"])
@pytest.mark.parametrize("asked", [{"rtol": 1e-3}, {"accuracy": 1e-3}])
def test_what_newton_asks_of_contact_decides_no_status(comm, friction, sliding, asked):
    """Newton's method asks for more than rounding leaves; the user asks for less than it leaves."""
    scene = rubber_block(comm, (4, 3), clamped=True, friction=friction).but(sliding=sliding)
    scene.push.value[:] = 0.01, -0.1
    newton = NewtonOptions(accuracy=1e-20)
    with scene.problem(options=SolverOptions(**asked), newton=newton) as problem:
        solution = problem.solve()
        assert solution.status is ContactStatus.CONVERGED
        assert solution.options == problem.options
        problem.accept()


def test_a_compiled_tangent(comm):
    """It is assembled again in each step, and derivatives need no more than its matrix."""
    steps, derivatives = [], []
    for kind in (lambda J: J, fem.form):
        scene = rubber_block(comm, (3, 2), clamped=True, friction=Coulomb(0.3))
        J = kind(ufl.derivative(scene.F, scene.u))
        with scene.problem(J=J, options=SolverOptions(rtol=1e-9)) as problem:
            scene.push.value[:] = (0.05, -0.1)
            steps.append(len(problem.solve().newton.steps))
            derivatives.append(problem.gradient(NormalForce(), [scene.push])[0])
    assert steps[0] == steps[1]
    np.testing.assert_allclose(*derivatives, rtol=1e-6)


def test_observer_stops(comm):
    scene = rubber_block(comm, (2, 2))
    compressed(scene.push, 0.1)
    with scene.problem() as problem:
        solution = problem.solve(observer=lambda iteration: True)
    assert solution.status is ContactStatus.STOPPED


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"F": 1.0}, "F must be a UFL form"),
        ({"u": None}, "u must be the Function"),
        ({"options": SolverOptions()}, "estimate of the mesh"),
        ({"options": 3}, "SolverOptions"),
        ({"newton": 3}, "NewtonOptions"),
    ],
)
def test_wrong_arguments(comm, changes, message):
    scene = rubber_block(comm, (1, 1))
    with pytest.raises(InputError, match=message):
        scene.problem(**changes)
    if changes.keys() & {"options", "newton"}:
        with scene.problem() as problem, pytest.raises(InputError, match=message):
            problem.solve(**changes)


@pytest.mark.parallel
def test_back_to_zero(comm):
    """Where the answer is zero the accuracy refers to the change; one cell leaves ranks empty."""
    scene = rubber_block(comm, (1, 1))
    with scene.problem() as problem:
        for squeeze in (0.3, 0.0):
            scene.push.value = -squeeze
            solution = problem.solve()
            solution.raise_if_failed()
    assert len(solution.newton.steps) < 10
    assert np.abs(scene.u.x.array).max(initial=0.0) <= 1e-6


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_a_body_that_nothing_touches_any_more(comm, sliding):
    """A ball bends a strip of rubber, and leaves it: forces and displacements are rounding."""
    ball = RigidSphere((1.0, -0.6), 0.5)
    scene = rubber_block(comm, (8, 2), size=(4.0, 0.5), degree=2, obstacle=ball)
    bcs = [fixed(scene.scene.V, scene.scene.facet_tags.find(RIGHT))]
    with scene.but(sliding=sliding).problem(bcs=bcs) as problem:
        for height in (0.2, 0.0, -0.1, -0.2, -0.3):
            ball.move_to((0.0, height))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            assert len(solution.newton.steps) <= 6
            assert (solution.counts.contact > 0) == (height == 0.2)
    assert np.abs(scene.u.x.array).max(initial=0.0) <= 1e-12


@pytest.mark.parallel
def test_an_unloaded_linear_body_is_at_rest(comm):
    """Rounding is no load: it would shrink from step to step until its squares underflow."""
    scene = rubber_block(comm, (3, 3), clamped=True)
    e, v = ufl.sym(ufl.grad(scene.u)), ufl.TestFunction(scene.u.function_space)
    F = ufl.inner(2.0 * e + ufl.tr(e) * ufl.Identity(2), ufl.grad(v)) * ufl.dx
    with scene.problem(F=F) as problem:
        for height in (-0.05, 2.0, 0.0, 0.0):
            scene.push.value[1] = height
            problem.solve().raise_if_failed()
    assert not scene.u.x.array.any()


def falling_block(comm, n, degree, sliding="small"):
    """Return a block of rubber far above its obstacle."""
    down = -np.eye(len(n))[-1]
    scene = rubber_block(comm, n, degree=degree, clamped=True, obstacle=RigidPlane(down, -down))
    return scene.but(sliding=sliding)


@pytest.mark.parallel
@pytest.mark.parametrize(("n", "degree"), [((16, 16), 2), ((4, 4, 4), 1)])
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_rigid_motion(comm, n, degree, sliding):
    """A body that touches nothing has no energy: the residual is nothing but rounding errors."""
    scene, dim = falling_block(comm, n, degree, sliding), len(n)
    with scene.problem(newton=NewtonOptions(accuracy=1e-12)) as problem:
        for step in range(1, 9):
            scene.push.value[:] = -0.1 * step * np.arange(1, dim + 1) / dim
            solution = problem.solve()
            solution.raise_if_failed()
            assert len(solution.newton.steps) < 10
            moved = scene.u.x.array.reshape(-1, dim) - scene.push.value
            assert np.abs(moved).max(initial=0.0) <= 1e4 * np.finfo(float).eps
            if sliding == "small":
                problem.tangent([scene.push], [scene.push.value])  # finds the solution up to date
            problem.accept()


def test_an_energy_is_no_residual(comm):
    scene = rubber_block(comm, (1, 1))
    with pytest.raises(InputError, match=r"F must be the residual form.* found 0: of an energy"):
        scene.problem(F=neo_hookean(scene.u) * ufl.dx)


@pytest.mark.parametrize(
    "changes", [{"accuracy": 2.0}, {"max_iterations": 0}, {"max_halvings": -1}]
)
def test_wrong_options(changes):
    with pytest.raises(InputError, match=next(iter(changes))):
        NewtonOptions(**changes)
