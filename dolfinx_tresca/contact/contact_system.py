"""The discretised contact problem: one solve, and the record of the last solve."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.functions import owned_values, with_owned_values
from dolfinx_tresca._base.parallel import (
    errors_on_all_ranks,
    largest_over_ranks,
    largest_sizes,
    log,
    timed,
    warn,
)
from dolfinx_tresca._base.petsc import free_unused
from dolfinx_tresca._base.tolerances import SLACK
from dolfinx_tresca.contact.contact_surfaces import ContactSurfaces
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError, MechanismError
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.friction import Preload
from dolfinx_tresca.scene.obstacle import RigidMotion
from dolfinx_tresca.solution import scene_checks
from dolfinx_tresca.solution.evaluation import Evaluation, evaluate
from dolfinx_tresca.solvers.convergence import BALANCED
from dolfinx_tresca.solvers.feasible_set import CurveAtNodes, FrictionCones, pressed_values
from dolfinx_tresca.solvers.iteration import solve
from dolfinx_tresca.solvers.problem import DualSolution
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.choice import one_thread
from dolfinx_tresca.table import Row, Units

#: Statuses with which a solution may have left linear theory. Where a body slides without end,
#: there is no fixed point of pressures and slip bounds, and the last iterate shows the motion.
CHECKED = (ContactStatus.CONVERGED, ContactStatus.NO_FIXED_POINT, ContactStatus.STAGNATED)
Solution = TypeVar("Solution", bound=ContactSolution)


class ContactSystem(ContactSurfaces):
    """A discretised contact problem: K, the contact surfaces, and their solves.

    A linear problem uses one such system for all solves. Newton's method for nonlinear bodies also
    uses one; its K is the present tangent.
    """

    def solution_for(self, purpose: str) -> StepSolution:
        """Return the last solution; errors name the purpose that needs it. Not collective."""
        self.check_not_destroyed()
        if self.solved is None:
            raise ContactError(f"there is no solution for {purpose}: call solve() first.")
        return self.solved

    @property
    def displacement(self) -> fem.Function:
        """The displacement [length] of the last solution, or of nonlinear bodies the present u."""
        return self.solution_for("update_geometry() without a displacement").fields.u

    def rows(self, units: Units | None) -> list[Row]:
        """Return the rows of the table that `print(problem)` shows. Not collective."""
        return [
            ("bodies", self.bodies_found),
            *self.summary.rows(units),
            ("solver for K", str(self.compliance.solver)),
            ("chosen", self.reason),
        ]

    def law_values(self, curves: Sequence[CurveAtNodes]) -> list[Array]:
        """Return the present gaps, slip bounds and friction curves at contact nodes. Collective."""
        result = self.added_gaps()
        for bounds in self.slip_bounds():
            result += [bounds.constant, bounds.coefficient, bounds.limit]
            if bounds.direction is not None:
                result += [bounds.shape, bounds.direction]
        with errors_on_all_ranks(self.comm):
            return result + [pressed_values(*curve) for curve in curves]

    def advance_material(self, solution: StepSolution) -> None:
        """Advance the history of the material, if it has one, to a solution. Collective.

        If that fails, the step is not accepted.
        """

    def check_no_tools(self, purpose: str) -> None:
        """Check that neither obstacles nor bolts have given forces. Not collective."""
        for pair in self.pairs:
            given = pair.obstacle is not None and pair.obstacle.given_forces
            if given or isinstance(pair.friction, Preload):
                raise InputError(
                    f"contact pair {pair}: {purpose} is not known with obstacles held by forces, "
                    "and with preloads."
                )

    def check_inputs(self, purpose: str) -> None:
        """Check that loads, prescribed values, slip bounds and gaps are those of the last solve.

        Collective; errors name the purpose that needs them.
        """
        solved = self.solution_for(purpose)
        if self.state.pending and solved.status is not ContactStatus.CONVERGED:
            raise ContactError(
                f"{purpose} needs a solution, and the last solve ended with {solved.status.name}."
            )
        self.linear.assemble_load()
        present_inputs = [self.linear.f.x.array, *self.law_values(solved.curves)]
        same = all(map(np.array_equal, present_inputs, solved.inputs))
        same &= not self.obstacles.changed(self.jump).any()
        if not self.comm.allreduce(same, op=MPI.LAND):
            raise inputs_changed(purpose)

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Restore the state of the process at the end of the block. Collective.

        If K or the pairing changes inside the block, derivatives of the last solution are lost.
        """
        state = self.state
        try:
            yield
        finally:
            self.return_to(state)
            self.linear.assemble_load()
            self.update_gaps()

    def checked(self, solution: Solution) -> Solution:
        """Return a final solution, with the status OUTSIDE_THEORY if it left theory. Collective.

        Prescribed overlaps and the reason of a failure are logged. A solve that found no solution
        since bodies slide away has this as its reason. With finite sliding, the first
        configurations are not checked, since surfaces that come from afar may lie deep inside other
        bodies there. Rotations and deformations have limits if the bodies are linear.
        """
        scene_checks.hint_at_overlap(solution.u, self.pairs, self.jump, solution.surfaces)
        status = solution.status
        if status in CHECKED and not solution.sliding:
            state, tractions, v = self.state, solution.multipliers, solution.deformation
            motions = self.obstacles.motions if state.solution is None else state.solution.motions
            departures = [
                *(() if self.linear.is_tangent else scene_checks.motions_of_bodies(v, self.bodies)),
                *scene_checks.motions_of_pairs(
                    self.jump, self.pairs, solution.u, state.geometry, tractions, motions
                ),
            ]
            reason = scene_checks.reason_outside(self.comm, departures, self._noticed)
            if reason:
                if status is ContactStatus.CONVERGED:
                    status = ContactStatus.OUTSIDE_THEORY
                    self.state = state.with_status(status)
                else:
                    reason = f"The last iterate has left linear theory: {reason}"
                solution = replace(solution, status=status, sliding=reason)
        if solution.failure:
            warn(self.comm, "%s", solution.failure)
        return solution

    @one_thread()
    def solve(
        self,
        options: SolverOptions,
        units: Units | None,
        observe: Callable[[Iteration], bool],
        requested: SolverOptions | None = None,
    ) -> ContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        Args:
            options: options of the contact algorithm.
            units: names of units, for tables and pictures of the solution.
            observe: function that is called before each iteration, on all ranks; the solve stops
                if it returns True.
            requested: the options that the user gave, if `options` have another accuracy: they
                decide whether the solve converged.

        Raises:
            ContactError: the problem was destroyed, or its last `update_stiffness` failed.
            InputError: an option, a load, a prescribed value or a slip bound is wrong.
            MechanismError: nothing holds a body against its loads.
            StiffnessError: a solve with K failed.
        """
        free_unused(self.comm)  # vectors of the solves before
        requested = requested or options
        self.check_suits(options)
        self.compliance.solver.check_ready()
        timings, self.timings = self.timings, {}
        self.state = replace(self.state, solution=None, pending=False)
        with timed("load", timings):
            self.linear.assemble_load()
            bounds = self.slip_bounds()
            self.align_tangents(bounds)
            self.update_gaps()
            compliance, jump, state = self.compliance, self.jump, self.state
            products_before, krylov = compliance.products, compliance.solver.krylov_iterations
            history = self.history_of_solve()
            moved = (state.accepted.motions != state.motions).any(axis=(1, 2))
            tools = self.obstacles.tools(jump, self.bodies, state.history.begun)
            if tools is not None and options.method != "projected_newton":
                raise InputError("forces on obstacles and bolts need method='projected_newton'.")
            try:
                dual = DualProgram(self.compliance, self.guess, bounds, history, tools)
            except MechanismError as error:
                motion = with_owned_values(self.linear.V, error.motion, "motion")
                lengths = np.linalg.norm(owned_values(motion), axis=1)
                (greatest,) = largest_sizes(self.comm, lengths)
                motion.x.array[:] /= greatest or 1.0  # zero where tools move
                error.motion = motion
                raise
            if dual.equilibrium is not None:
                self._check_no_slip_dependence()
        with timed("iteration", timings):
            dual_solution = solve(dual, state.multipliers, options, observe)
        with timed("fields", timings):
            sides = self.secondary, self.bodies
            evaluation, history = evaluate(dual, *sides, dual_solution, estimate=options.balanced)
        status = _status_of_fields(dual, dual_solution, evaluation, options, requested)
        curves = self._checked_curves(dual, dual_solution)
        inputs = [self.linear.f.x.array.copy(), *self.law_values(curves)]
        sliding = ""
        if dual_solution.deficit is not None and dual.equilibrium is not None:
            sliding = dual.equilibrium.explain(dual_solution.deficit)
        motions = self.obstacles.motions
        if tools is not None:
            motions = tools.places(dual.tool_motions(dual_solution.c), motions)
            for surface, motion in zip(evaluation.surfaces, motions, strict=True):
                if surface.obstacle is not None:
                    surface.obstacle.motion = RigidMotion.from_matrix(motion)
        multipliers, products = dual_solution.multipliers, compliance.products - products_before
        solution = StepSolution(
            status, dual, multipliers, evaluation, history, curves, inputs, moved, motions
        )
        self.state = replace(state, multipliers=multipliers, solution=solution, pending=True)
        log(
            self.comm,
            "%s: %s after %d iterations, %d products, residual %.2e",
            *(options.method, status.value, dual_solution.iterations, products),
            dual_solution.residuals[-1],
        )
        return ContactSolution(
            status=status,
            options=requested,
            units=units,
            iterations=dual_solution.iterations,
            products=products,
            krylov_iterations=compliance.solver.krylov_iterations - krylov,
            residuals=dual_solution.residuals,
            q=dual_solution.q,
            timings=largest_over_ranks(self.comm, timings),
            sliding=sliding,
            problem_rows=self.rows(units),
            bolts=self.bolt_forces(evaluation.pair_resultants),
            **vars(evaluation),
        )

    def _checked_curves(self, dual: DualProgram, solution: DualSolution) -> list[CurveAtNodes]:
        """Return the friction curves, checked at the pressures and slips of a solution. Collective.

        A hint is logged if F decreases so fast with the slip that there may be several solutions.
        """
        x = solution.multipliers
        cones = dual.admissible.at_point(x, solution.gradient)
        if not isinstance(cones, FrictionCones) or not cones.curves.of_discs:
            return []
        arguments = cones.curve_arguments(x)
        for curve in arguments:
            self.friction.check_curve(*curve)
        scene_checks.hint_at_weakening(
            self.comm, cones, x, dual.compliance.known_products().largest_ritz_value
        )
        return arguments

    def _check_no_slip_dependence(self) -> None:
        """Check for floating bodies that no coefficient of friction depends on the slip.

        For a block held by viscous friction alone, the solver found no multipliers within minutes.
        Not collective.
        """
        for pair in self.pairs:
            curve = pair.friction.terms.curve
            if curve is not None and curve.depends_on_slip:
                raise InputError(
                    f"contact pair {pair}: the coefficient of friction depends on the slip, and "
                    "contact or soft springs hold a body, whose slip is not known in the "
                    "iteration. Hold it by Dirichlet conditions, such as a prescribed motion."
                )


def inputs_changed(purpose: str) -> ContactError:
    """Return the error to raise if inputs have changed since a solution for some purpose."""
    return ContactError(
        "loads, prescribed values, slip bounds, gaps or coefficients have changed since the "
        f"solution that {purpose} is for: call solve()."
    )


def _status_of_fields(
    dual: DualProgram,
    solution: DualSolution,
    evaluation: Evaluation,
    options: SolverOptions,
    requested: SolverOptions,
) -> ContactStatus:
    """Return the status of a solve from its fields, which are what the user gets. Collective.

    The fields are computed anew from the last multipliers, and so is the bound of their error. It
    may be larger than the bound with which the iteration ended: then rounding prevents the accuracy
    that `options` ask for. It may also be small enough for what the user requested although the
    iteration ended early, since `options` may ask for more, or the iterates were less accurate.
    """
    if solution.status is ContactStatus.STOPPED:
        return ContactStatus.STOPPED
    error = evaluation.energy_error_bound
    ended_early = solution.status is not ContactStatus.CONVERGED
    if not ended_early and not error > SLACK * solution.wanted:
        return ContactStatus.CONVERGED

    # the bound of the error is that of multipliers in equilibrium
    balanced = dual.constraints.imbalance(solution.multipliers, solution.c) <= BALANCED
    if requested.rtol is not None:
        as_requested = solution.residuals[-1] <= requested.rtol and requested != options
    elif requested.balanced:  # by an estimate of the mesh's error, which the iteration knows
        as_requested = False
    else:
        as_requested = error <= SLACK * float(requested.accuracy)
    if balanced and as_requested:
        return ContactStatus.CONVERGED
    return solution.status if ended_early else ContactStatus.STAGNATED
