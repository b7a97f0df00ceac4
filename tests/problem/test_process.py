"""Load steps of nonlinear bodies: cycles, files, other meshes, and what goes wrong on the way."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactStatus,
    Coulomb,
    InputError,
    NewtonOptions,
    SolverOptions,
    StiffnessError,
    Tresca,
)
from scenes.blocks import BELOW
from scenes.rubber_block import RubberBlock, rubber_block

#: Accuracy of Newton's method, and of contact.
RTOL = 1e-9
NEWTON, CONTACT = NewtonOptions(accuracy=RTOL), SolverOptions(rtol=RTOL)

#: Of forces and dissipation, over `RTOL`, with an iteration that began elsewhere.
SAME = 1e3

#: Displacements of the top: pressed until the tangent alone is indefinite, and rubbed to and fro.
PATH = ((0.0, -0.3), (0.2, -0.35), (-0.1, -0.35))


def rubbed(comm: MPI.Comm, n=(3, 2), friction=None, **arguments) -> RubberBlock:
    return rubber_block(comm, n, clamped=True, friction=friction or Coulomb(0.3), **arguments)


def problem_of(scene: RubberBlock, **changes):
    return scene.problem(newton=NEWTON, options=CONTACT, **changes)


def numbers(solution) -> np.ndarray:
    (force,) = (one.force for one in solution.resultants())
    return np.array([*force, solution.dissipation, solution.total_dissipation])


def walk(scene: RubberBlock, problem, path=PATH):
    """Take load steps, and return the last one's solution."""
    for place in path:
        scene.push.value[:] = place
        solution = problem.solve()
        solution.raise_if_failed()
        problem.accept()
    return solution


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_another_run_goes_on(comm, folder: Path, sliding: str) -> None:
    """As if it had not been interrupted, u included; on one rank, too."""
    path, given = folder / "state.npz", {"degree": 2, "friction": Coulomb(0.1)}
    scene = rubbed(comm, **given).but(sliding=sliding)
    with problem_of(scene) as problem:
        walk(scene, problem, PATH[:-1])
        problem.save_state(path, step=1)
        u = scene.u.copy()
        last = walk(scene, problem, PATH[-1:])
    expected = numbers(last)
    assert expected[-1] > expected[-2] > 0.0
    for ranks in (comm, MPI.COMM_SELF)[: comm.size]:
        scene = rubbed(ranks, **given).but(sliding=sliding)
        with problem_of(scene) as problem:
            assert problem.load_state(path) == 1
            if ranks is comm:
                assert np.array_equal(scene.u.x.array, u.x.array)
            found = walk(scene, problem, PATH[-1:])
        assert len(found.newton.steps) == len(last.newton.steps)
        np.testing.assert_allclose(numbers(found), expected, atol=SAME * RTOL)


@pytest.mark.parallel
def test_a_trial_that_is_not_accepted_leaves_no_trace(comm, folder: Path) -> None:
    """The next solve begins at the accepted u and tractions; a u that the user has set counts."""
    scene = rubbed(comm)
    with problem_of(scene) as problem:
        walk(scene, problem, PATH[:1])
        scene.push.value[:] = PATH[1]
        expected = problem.solve()
        answer = scene.u.x.array.copy()
        scene.push.value[:] = PATH[2]
        problem.solve().raise_if_failed()
        problem.save_state(folder / "state.npz")
        scene.push.value[:] = PATH[1]
        found = problem.solve()
        scene.push.value[:] = PATH[2]
        problem.solve().raise_if_failed()
        scene.push.value[:] = PATH[1]
        scene.u.x.array[:] = answer
        at_answer = problem.solve()
    scene = rubbed(comm)
    with problem_of(scene) as problem:
        problem.load_state(folder / "state.npz")
        scene.push.value[:] = PATH[1]
        read = problem.solve()
    first = expected.newton.steps[0].correction
    for solution in (found, read):
        np.testing.assert_allclose(numbers(solution), numbers(expected), atol=SAME * RTOL)
        assert solution.newton.steps[0].correction == pytest.approx(first, abs=SAME * RTOL)
    assert at_answer.newton.steps[0].correction < SAME * RTOL < first


def test_a_state_of_other_bodies(comm, folder: Path) -> None:
    """Those of linear bodies have no displacement, from which nonlinear ones would go on."""
    path, scene = folder / "state.npz", rubbed(comm)
    with scene.scene.problem() as problem:
        problem.save_state(path)
    with problem_of(scene) as problem:
        with pytest.raises(InputError, match="with 0 Function"):
            problem.load_state(path)
        problem.save_state(path, step=2)
    with scene.scene.problem() as problem, pytest.raises(InputError, match="with 1 Function"):
        problem.load_state(path)
    finer = rubbed(comm, degree=2)
    with problem_of(finer) as problem, pytest.raises(InputError, match="of another degree"):
        problem.load_state(path)


def test_cycles_repeat_themselves(comm) -> None:
    """The third time round is the second one; friction dissipates in each step."""
    scene = rubbed(comm, friction=Tresca(0.1))
    found = []
    with problem_of(scene) as problem:
        walk(scene, problem, [(0.0, -0.35)])
        for _ in range(3):
            found.append([])
            for x in (0.2, -0.2):
                found[-1].append(numbers(walk(scene, problem, [(x, -0.35)])))
    second, third = np.array(found[1:])
    np.testing.assert_allclose(third[:, :3], second[:, :3], atol=SAME * RTOL)
    assert (np.diff(np.concatenate(found)[:, -1]) > 0.0).all()


@pytest.mark.parallel
def test_contact_force_balances_the_residual_form(comm) -> None:
    """F(u; v) is the power of the contact; the operators are those of the whole displacement."""
    scene = rubbed(comm)
    with problem_of(scene) as problem:
        solution = walk(scene, problem)
        residual = fem.Function(scene.scene.V)
        fem.assemble_vector(residual.x.array, fem.form(scene.F))
        residual.x.scatter_reverse(dolfinx.la.InsertMode.add)
        free = np.flatnonzero(~problem.prescribed)
        rest = (residual.x.array - solution.contact_force.x.array)[free]
        contact = problem.operators[0]
        jump = contact.N * scene.u.x.petsc_vec
        penetration = comm.allreduce((jump.array - contact.gap).max(initial=0.0), op=MPI.MAX)
    force = solution.normal_force
    assert np.abs(rest).max(initial=0.0) < SAME * RTOL * force
    assert penetration < SAME * RTOL
    p, ds = solution.on_mesh("pressure"), ufl.Measure("ds", subdomain_data=scene.scene.facet_tags)
    total = fem.assemble_scalar(fem.form(p * ds(BELOW, domain=scene.scene.mesh)))
    assert comm.allreduce(total) == pytest.approx(force, rel=SAME * RTOL)


def test_forms_with_functions_on_surfaces(comm) -> None:
    """They need the surface's map, and do what the same Function on the mesh does."""
    scene = rubbed(comm)
    with problem_of(scene) as problem:
        found = walk(scene, problem, PATH[:1])
    ds = ufl.Measure("ds", domain=scene.scene.mesh, subdomain_data=scene.scene.facet_tags)
    v = scene.F.arguments()[0]
    answers = []
    for p, maps in ((found.on_mesh("pressure"), None), (found.pressure, found.surface.entity_maps)):
        scene.u.x.array[:] = 0.0
        F = scene.F + 0.5 * p * v[0] * ds(BELOW)
        with problem_of(scene, F=F, entity_maps=maps) as problem:
            answers.append(numbers(walk(scene, problem, PATH[:1])))
    np.testing.assert_allclose(*answers, atol=SAME * RTOL)
    assert abs(answers[0][0]) > 0.1 * found.normal_force
    with pytest.raises(InputError, match="on another mesh than the problem's"):
        problem_of(scene, F=F)


def test_surfaces_move_where_the_tangent_is_indefinite(comm) -> None:
    """What contact holds is known without a solution."""
    scene = rubbed(comm, (4, 3))
    with problem_of(scene) as problem:
        walk(scene, problem, [(0.1, -0.2)])
        before = walk(scene, problem, [(0.1, -0.4)])
        problem.update_geometry()
        again = problem.solve()
    assert before.newton.steps[-1].added == again.newton.steps[0].added == "contact 10"
    assert again.normal_force == pytest.approx(before.normal_force, rel=SAME * RTOL)


def test_any_start_gives_the_same_answer(comm) -> None:
    """One where all is pressed flat, too, of which no contact forces are known."""
    answers = []
    for strain in (0.0, 0.3):
        scene = rubbed(comm, (4, 3))
        scene.u.interpolate(lambda x, strain=strain: np.stack([0.0 * x[0], -strain * x[1]]))
        with problem_of(scene) as problem:
            answers.append(numbers(walk(scene, problem, [(0.1, -0.2)])))
    np.testing.assert_allclose(*answers, atol=SAME * RTOL)


@pytest.mark.parallel
def test_starts_that_lead_nowhere(comm) -> None:
    """NaN is found on all ranks; cells inside out have no tangent, flat ones are unstable."""
    scene = rubbed(comm)
    scene.push.value[:] = PATH[0]
    with problem_of(scene) as problem:
        if comm.rank == comm.size - 1:
            scene.u.x.array[0] = np.nan
        with pytest.raises(InputError, match="u, which the solve starts from"):
            problem.solve()
        scene.u.interpolate(lambda x: np.stack([0.0 * x[0], -2.0 * x[1]]))
        with pytest.raises(StiffnessError, match=r"step 1 with 1 of the load.* begin at another"):
            problem.solve()
        scene.u.interpolate(lambda x: np.stack([0.0 * x[0], -0.95 * x[1]]))
        with pytest.raises(StiffnessError, match=r"are unstable, .*begin at") as unstable:
            problem.solve()
        assert "Young" not in str(unstable.value)
        scene.u.x.array[:] = 0.0
        assert problem.solve().status is ContactStatus.CONVERGED


def test_what_is_changed_in_place_counts(comm) -> None:
    """Bounds, loads and materials of the form; what was wrong for a while leaves no trace."""
    scene = rubbed(comm)
    F, law = fem.Constant(scene.scene.mesh, 0.3), Coulomb
    pairs = [dataclasses.replace(pair, friction=law(F)) for pair in scene.scene.pairs]
    stiffness = fem.Constant(scene.scene.mesh, 1.0)
    with problem_of(scene, F=stiffness * scene.F, pairs=pairs) as problem:
        scene.push.value[:] = PATH[1]
        soft = numbers(problem.solve())
        stiffness.value = 2.0
        stiff = problem.solve()
        assert len(stiff.newton.steps) == 1
        np.testing.assert_allclose(numbers(stiff), 2.0 * soft, atol=SAME * RTOL)
        for name, constant, wrong in (("friction", F, -0.1), ("load", scene.push, np.nan)):
            before = constant.value.copy()
            constant.value = wrong
            with pytest.raises(InputError, match=name):
                problem.solve()
            constant.value = before
        np.testing.assert_allclose(numbers(problem.solve()), 2.0 * soft, atol=SAME * RTOL)
        F.value = 0.0
        assert problem.solve().tangential_force == 0.0
