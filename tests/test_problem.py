"""ContactProblem: changes in place, warm starts, observers, fields, equilibrium."""

from __future__ import annotations

import dataclasses
import gc
import logging

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from logged import logged

from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactStatus,
    ConvergenceError,
    InputError,
    NormalForce,
    SolverOptions,
    StiffnessError,
    Tresca,
)
from dolfinx_tresca.output.report import figures
from scenes.elasticity import elasticity
from scenes.scene import EPS
from scenes.two_bricks import YOUNG, bricks_problem, two_bricks

RTOL = 1e-7


def agree(first, second, rtol: float = RTOL) -> None:
    """Check that two solutions are the same to solver tolerance."""
    assert first.status is second.status is ContactStatus.CONVERGED
    assert first.q[-1] == pytest.approx(second.q[-1], rel=10 * rtol)
    assert first.counts == second.counts
    assert first.normal_force == pytest.approx(second.normal_force, rel=1e3 * rtol)
    assert first.tangential_force == pytest.approx(second.tangential_force, rel=1e3 * rtol)


OUTDATED = "coefficients of the form a have changed"


def warnings(caplog) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["constant", "function"])
def test_until_update_stiffness_all_is_as_K_was_factored(comm, caplog, kind):
    """The log warns once for each K that coefficients of the form have changed since."""
    scene = two_bricks(comm, 4)
    if kind == "constant":
        young = fem.Constant(scene.mesh, YOUNG)
    else:
        young = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
        young.x.array[:] = YOUNG
    bcs = [scene.fixed("upper_fixed", (0.0, 0.0, -1e-4)), scene.fixed("lower_fixed")]

    def set_young(value: float) -> None:
        if kind == "constant":
            young.value = value
        elif comm.rank == 0:  # on one rank is enough to warn
            young.x.array[:] = value

    with (
        caplog.at_level(logging.WARNING, logger="dolfinx_tresca"),
        scene.problem(a=elasticity(scene.V, young), bcs=bcs) as problem,
    ):
        before = problem.solve(rtol=RTOL)
        scene.data.load.value[2] *= 2.0
        problem.solve(rtol=RTOL)
        scene.data.load.value[2] /= 2.0
        set_young(YOUNG)
        agree(problem.solve(rtol=RTOL), before)
        problem.forget()
        before = problem.solve(rtol=RTOL)  # as the solves below: on other partitions errors differ
        assert warnings(caplog) == []
        set_young(2.0 * YOUNG)
        for _ in range(2):
            problem.forget()
            same = problem.solve(rtol=RTOL)
            agree(same, before)
            assert same.energy_error_bound == pytest.approx(before.energy_error_bound, rel=0.1)
        assert len(warnings(caplog)) == 2 * (comm.rank == 0)
        assert all(OUTDATED in message for message in warnings(caplog))
        problem.update_stiffness()
        after = problem.solve(rtol=RTOL)
        assert len(warnings(caplog)) == 2 * (comm.rank == 0)
    assert after.normal_force > 1.01 * before.normal_force
    if kind == "constant":
        with scene.problem(a=elasticity(scene.V, 2.0 * YOUNG), bcs=bcs) as problem:
            agree(after, problem.solve(rtol=RTOL))


@pytest.mark.parallel
def test_a_second_solve_costs_less(comm):
    scene = two_bricks(comm, 5)
    with scene.problem() as problem:
        first = problem.solve(rtol=1e-6)
        again = problem.solve(rtol=1e-6)
        assert again.iterations == 0
        assert again.products <= 1
        scene.data.load.value[:] *= 1.1
        next_step = problem.solve(rtol=1e-6)
        assert next_step.status is ContactStatus.CONVERGED
        assert next_step.products < first.products
        scene.data.load.value[:] /= 1.1
        problem.forget()
        forgotten = problem.solve(rtol=1e-6)
        assert forgotten.products == first.products
        assert forgotten.iterations == first.iterations
        assert np.allclose(forgotten.multipliers, first.multipliers, rtol=1e-9, atol=1e-12)


def test_methods_can_follow_each_other(comm):
    """Each method starts from the last multipliers."""
    with bricks_problem(comm, 4) as problem:
        problem.solve(rtol=RTOL)
        for method in ("gimssn", "imssn", "mssn", "ssn", "projected_newton"):
            assert problem.solve(method=method, rtol=1e-5).iterations == 0


@pytest.mark.parallel
def test_an_observer_sees_the_iteration_and_stops_it(comm):
    seen = []

    def observer(iteration):
        seen.append(iteration)
        return iteration.number == 1

    with bricks_problem(comm, 4) as problem:
        solution = problem.solve(method="gimssn", observer=observer)
        assert solution.status is ContactStatus.STOPPED
        assert [at.number for at in seen] == [0, 1]
        assert tuple(at.residual for at in seen) == solution.residuals
        with pytest.raises(ConvergenceError, match="stopped by the observer"):
            solution.raise_if_failed()
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


@pytest.mark.parallel
def test_an_exception_that_only_one_rank_keeps_delays_no_later_problem(comm):
    """Its traceback keeps the problem, with PETSc's vectors, on that rank alone."""
    scene, kept = two_bricks(comm, 3), []
    bound = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)))
    pair = dataclasses.replace(scene.pair, friction=Tresca(bound))

    def solve_with_wrong_bound() -> None:
        problem = scene.problem(pairs=[pair])
        assert problem.load.norm() > 0.0
        bound.x.array[:] = -1.0
        problem.solve()

    for _ in range(2):
        bound.x.array[:] = 0.1
        try:
            solve_with_wrong_bound()
        except InputError as error:
            if comm.rank == 0:
                kept.append(error)
        gc.collect()
        bound.x.array[:] = 0.1
        with scene.problem(pairs=[pair]) as problem:
            assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED
    assert len(kept) == 2 * (comm.rank == 0)


@pytest.mark.parallel
@pytest.mark.parametrize("end", ["free_end_1", "free_end_2"])
def test_energy_of_the_solution_is_what_q_says(comm, end):
    """The dual energy is -D = q + 1/2 f'K^-1 f, the primal one J >= D, also with a gap."""
    with bricks_problem(comm, 6, end=end, Offset=1e-6) as problem:
        solution = problem.solve(rtol=RTOL)
    gap = solution.primal_energy - solution.dual_energy
    assert abs(gap) <= 1e4 * RTOL * abs(solution.dual_energy)
    assert np.all(np.diff(solution.q) <= 1e3 * EPS * np.abs(solution.q[-1]))
    assert solution.residuals[-1] <= RTOL
    assert len(solution.residuals) == len(solution.q) == solution.iterations + 1


def test_no_load_gives_nothing(comm):
    scene = two_bricks(comm, 3)
    scene.data.load.value[:] = 0.0
    with scene.problem() as problem:
        for method in ("projected_newton", "gimssn", "imssn", "mssn", "ssn"):
            solution = problem.solve(method=method)
            assert solution.status is ContactStatus.CONVERGED
            # the gap of touching faces is that of rounding in lengths of 1
            assert np.abs(solution.u.x.array).max(initial=0.0) <= 100 * EPS
            assert str(solution)


def test_only_digits_that_hold_are_printed():
    assert figures(13.4567, 3e-3) == "13.5"
    assert figures(13.4567, 1e-5) == "13.457"
    assert figures(-7.64564812e-05, 0.2) == "-8e-05"
    assert figures(0.0, 0.0) == "0"


@pytest.mark.parametrize(
    ("options", "status", "advice"),
    [
        (
            {"rtol": 1e-9, "max_iterations": 1, "method": "gimssn"},
            "iteration limit reached",
            "Allow more iterations",
        ),
        ({"rtol": 1e-18}, "no further progress in double precision", "request less accuracy"),
    ],
)
def test_a_solve_that_fails_is_logged(caplog, options, status, advice):
    """The log has one warning with advice, which is another one for rounding errors."""
    with bricks_problem(MPI.COMM_SELF, 3) as problem, caplog.at_level(logging.WARNING):
        problem.solve(rtol=1e-6)
        assert not caplog.records
        problem.forget()
        solution = problem.solve(**options)
    assert status in logged(caplog) and advice in logged(caplog)
    assert ("more iterations" in logged(caplog)) == (options["rtol"] == 1e-9)
    assert " ".join(solution.failure.split()) == logged(caplog)
    assert solution.status.name in str(solution)
    with pytest.raises(ConvergenceError, match=status):
        solution.raise_if_failed()


@pytest.mark.parallel
def test_logs_go_to_the_first_rank(comm, caplog, capfd):
    """Nothing is printed."""
    with caplog.at_level(logging.INFO, logger="dolfinx_tresca"), bricks_problem(comm, 3) as problem:
        problem.solve(rtol=1e-6)
    messages = logged(caplog)
    if comm.rank == 0:
        for text in (
            "stiffness: cholesky, since",
            "pairing: upper_contact on lower_contact: 9 of 12 secondary nodes carry multipliers",
            "projected_newton: conv",
        ):
            assert text in messages
    else:
        assert messages == ""
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_options_of_one_solve_do_not_stay(comm):
    options = SolverOptions(rtol=1e-3)
    with bricks_problem(comm, 3, options={"options": options}) as problem:
        assert problem.solve(rtol=1e-5).options.rtol == 1e-5
        assert problem.solve().options == options
        # whichever is asked for last decides
        assert problem.solve(accuracy=1e-2).options.rtol is None


@pytest.mark.parallel
def test_a_problem_is_described_by_one_rank_alone(comm):
    with bricks_problem(comm, 3) as problem:
        if comm.rank == 0:
            assert str(problem.free_dofs) in str(problem)


@pytest.mark.parallel
def test_after_destroy_and_a_failed_update_the_error_says_so(comm):
    scene = two_bricks(comm, 3)
    young = fem.Constant(scene.mesh, 1.0)
    problem = ContactProblem(young * scene.a, scene.L, [scene.pair], bcs=scene.bcs)
    q = problem.solve(rtol=1e-6).q[-1]
    young.value = -1.0
    with pytest.raises(StiffnessError, match="not positive definite"):
        problem.update_stiffness()
    with pytest.raises(ContactError, match=r"update_stiffness\(\) failed"):
        problem.solve(rtol=1e-6)
    young.value = 1.0
    problem.update_stiffness()
    assert problem.solve(rtol=1e-6).q[-1] == pytest.approx(q, rel=1e-6)
    u = problem.solve(rtol=1e-6).u
    problem.destroy()
    for use in (
        lambda: problem.solve(rtol=1e-6),
        lambda: problem.update_geometry(u),
        lambda: problem.set_slip_origin(u),
        lambda: problem.operators,
        lambda: problem.stiffness,
        lambda: problem.load,
        problem.update_stiffness,
        lambda: problem.goal_error(NormalForce()),
    ):
        with pytest.raises(ContactError, match="destroyed"):
            use()


def test_one_factorisation_for_any_number_of_solves(comm):
    """K is factored once, and the small matrix of the energy bound once.

    They are counted in a stage of PETSc's log of their own, since PETSc does not count further in
    a stage in which an error has occurred.
    """
    PETSc.Log.begin()  # no effect if PETSc counts already
    stage = PETSc.Log.Stage("factorisations")
    events = [PETSc.Log.Event(name) for name in ("MatCholFctrNum", "MatLUFactorNum")]

    def count() -> int:
        return sum(int(event.getPerfInfo()["count"]) for event in events)

    stage.push()
    try:
        with bricks_problem(comm, 4) as problem:
            assert count() == 1
            for asked in ({"rtol": 1e-6}, {"accuracy": 1e-3}, {}):
                problem.solve(**asked)
                assert count() == 2
            problem.update_stiffness()
            problem.solve()
            assert count() <= 4
    finally:
        stage.pop()
