"""The discretised contact problem: paired surfaces, their operators, and one solve."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask, real
from dolfinx_tresca._base.functions import owned_values, with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, largest_abs, log, timed, warn
from dolfinx_tresca._base.petsc import PetscOwner, destroyed_on_error, free_unused
from dolfinx_tresca.contact.obstacles import Obstacles
from dolfinx_tresca.contact.step_state import StepSolution, StepState
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.load_steps import SlipHistory, displaced_jump
from dolfinx_tresca.dual.products import ContactCompliance
from dolfinx_tresca.dual.program import DualProgram, InitialGuess
from dolfinx_tresca.dual.slip_bounds import NodalBounds, SlipBounds
from dolfinx_tresca.errors import ContactError, InputError, MechanismError, PairingError
from dolfinx_tresca.floating.equilibrium import Tools
from dolfinx_tresca.floating.held_stiffness import HeldStiffness
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output.report import ProblemSummary
from dolfinx_tresca.pairing.pair_surfaces import pair_all_surfaces
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.friction import Frictionless
from dolfinx_tresca.scene.obstacle import RigidMotion
from dolfinx_tresca.scene.pair import ContactPair, check_tags
from dolfinx_tresca.solution import scene_checks
from dolfinx_tresca.solution.evaluation import evaluate, status_of_fields
from dolfinx_tresca.solution.fields import Surface
from dolfinx_tresca.solvers.feasible_set import CurveAtNodes, FrictionCones, pressed_values
from dolfinx_tresca.solvers.iteration import solve
from dolfinx_tresca.solvers.problem import DualSolution
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.choice import SolverRequest, one_thread, warn_of_slow_blas
from dolfinx_tresca.stiffness.frames import BodyFrames
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.table import Row, Units

#: Statuses with which a solution may have left linear theory. Where a body slides without end,
#: there is no fixed point of pressures and slip bounds, and the last iterate shows the motion.
CHECKED = (ContactStatus.CONVERGED, ContactStatus.NO_FIXED_POINT, ContactStatus.STAGNATED)
Solution = TypeVar("Solution", bound=ContactSolution)


class ContactSystem(PetscOwner):
    """A discretised contact problem: K, B on the surfaces as they are paired, and their solves.

    A problem uses a single system for all its solves. For nonlinear bodies K is the present
    tangent. Where surfaces are paired again, B and A change, and tractions and slip are kept.

    Attributes:
        stiffness: K with the springs that fix bodies, which is factored for A (`compliance`).
        slides_far: whether at least one pair has finite sliding.
        depends_on_start: whether slip bounds depend on the pressure, and solutions on the start.
        secondary: for each pair the mesh of its secondary side, for the fields of solutions.
        friction: evaluates the user's slip bounds and gaps (by its `values`) at nodes of V.
        guess: displacements of earlier solves, from which iterative solves with K start.
        unknowns: the user's Function with the displacement of nonlinear bodies (or all unknowns of
            their mixed space), at which solves start and end; None for linear bodies.
        frames_at_rest: frames of undeformed bodies, which finite sliding moves; None: no frames.
        timings: phase -> seconds of pairing and factoring since the last solve.
    """

    def __init__(
        self, linear: LinearSystem, pairs: list[ContactPair], request: SolverRequest
    ) -> None:
        """Pair the surfaces, choose the solver for K, and assemble and factor K. Collective."""
        free_unused(linear.comm)  # objects of earlier problems that were not destroyed
        self.linear, self.pairs, self.comm, self._destroyed = linear, pairs, linear.comm, False
        self._noticed: set[scene_checks.Limit] = set()  # limits of theory that the log has named
        self._finite_sliding = np.array([pair.sliding == "finite" for pair in pairs], np.bool_)
        self.slides_far = bool(self._finite_sliding.any())
        self.depends_on_start = any(real(pair.friction.terms.coefficient) != 0.0 for pair in pairs)
        self.unknowns: fem.Function | None = None
        self.timings: dict[str, float] = {}
        V, prescribed = linear.V, linear.prescribed_displacements
        if linear.comm.rank == 0:
            warn_of_slow_blas()
        check_tags(pairs, V.mesh)
        # those of any pair: they name bodies in messages
        cell_tags = [pair.cell_tags for pair in pairs if pair.cell_tags is not None]
        self.stiffness = HeldStiffness(linear, cell_tags[0] if cell_tags else None, request)
        self.bodies = self.stiffness.bodies
        self.obstacles = Obstacles(V, pairs)
        with timed("pairing", self.timings):
            operators = pair_all_surfaces(V, prescribed, pairs, axisymmetric=linear.axisymmetric)
            self.secondary = Surface.of_pairs(fem.Function(V), pairs)
            self.friction = SlipBounds(V)
        self.jump = JumpOperator(linear, operators)
        with destroyed_on_error(self.jump):
            self.update_gaps()
            self.summary = ProblemSummary.from_system(linear, pairs, self.jump)
            self.guess = InitialGuess(np.zeros(len(linear.prescribed)))
            self.obstacles.note_pairing(self.jump)
            self._state = StepState.undeformed(self.jump, self.obstacles.motions)
            # K is factored before the laws are checked, since it tells the rounding of pressures
            self.compliance = self._factored()
            with destroyed_on_error(self.compliance):
                rounding = self.compliance.stress_rounding
                for pair, pair_operators in zip(pairs, operators, strict=True):
                    self.friction.check(pair.friction, pair_operators.nodes, rounding)
        self.frames_at_rest = BodyFrames.at_rest(linear, self.bodies, pairs)
        scene_checks.hint_at_scene(V, pairs, self.jump.pairs, self.bodies)

    def _factored(self) -> ContactCompliance:
        """Assemble and factor K, and return A. Collective."""
        solver, springs = self.stiffness.factored(self.timings)
        with timed(self.stiffness.method, self.timings):  # in a mixed space A prepares error bounds
            return ContactCompliance(self.jump, solver, springs)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._destroyed = True
        for owner in (self.compliance, self.jump, self.linear):
            owner.destroy()
        free_unused(self.comm)

    def check_not_destroyed(self) -> None:
        """Check that the PETSc objects exist. Not collective."""
        if self._destroyed:
            raise ContactError("the problem was destroyed: create a new one.")

    def slip_bounds(self) -> list[NodalBounds]:
        """Return the present slip bounds at each pair's nodes. Collective."""
        rounding = self.compliance.stress_rounding
        return [
            self.friction.nodal_bounds(pair.friction, operators.nodes, rounding)
            for pair, operators in zip(self.pairs, self.jump.pairs, strict=True)
        ]

    def added_gaps(self) -> list[Array]:
        """Return the gaps (n,) [length] of users and bolts at each pair's nodes. Collective."""
        gaps = []
        for pair, operators in zip(self.pairs, self.jump.pairs, strict=True):
            gap = 0.0 if pair.gap is None else pair.gap
            name = f"the gap of contact pair {pair}"
            gaps.append(self.friction.values.values_at(gap, operators.nodes, name)[:, 0])
        # the sides of a cut bolt may overlap by their relative motion along the cut's mean normal
        for number, (_, axis) in self.obstacles.bolts(self.jump).items():
            gaps[number] += float(axis @ self.obstacles.motions[number][:, 3])
        return gaps

    def update_gaps(self) -> None:
        """Set the present `added_gaps`, which must be finite, in B. Collective."""
        gaps = self.added_gaps()
        with errors_on_all_ranks(self.comm):
            for pair, gap in zip(self.pairs, gaps, strict=True):
                if not np.isfinite(gap).all():
                    raise InputError(
                        f"the gap of contact pair {pair} has values that are NaN or infinite. For "
                        "surfaces that cannot touch give no pair."
                    )
        pairs = zip(self.jump.pairs, gaps, strict=True)
        self.jump.set_gaps([replace(operators, added_gap=gap) for operators, gap in pairs])

    def align_tangents(self, bounds: Sequence[NodalBounds]) -> None:
        """Turn the tangents of B to the axes of the friction ellipses, if any. Collective."""
        jump = self.jump.along_axes(bounds)
        if jump is not self.jump:
            self._replace_jump(jump, self._state.with_tangents_of(jump))

    @property
    def solved(self) -> StepSolution | None:
        """The last solution; None if K or the pairing has changed since, or nothing was solved."""
        solution = self._state.solution
        valid = solution is not None and solution.dual.compliance is self.compliance
        return solution if valid else None

    @property
    def state(self) -> StepState:
        """The present state of the process, with the user's `unknowns`. Not collective."""
        if self.unknowns is None:
            return self._state
        return replace(self._state, unknowns=self.unknowns.x.array.copy())

    @state.setter
    def state(self, state: StepState) -> None:
        """Continue from a state on the present B, also in the user's `unknowns`. Not collective."""
        self._state = state
        if self.unknowns is not None and state.unknowns is not None:
            self.unknowns.x.array[:] = state.unknowns

    def return_to(self, state: StepState) -> None:
        """Return to a former state and its B; K and the user's obstacles stay. Collective."""
        self.state = state
        if state.jump is not self.jump:
            # the former B was destroyed, and is made again; obstacles are meanwhile where they were
            # in that state, since `_replace_jump` records their distances
            present_motions = self.obstacles.motions
            self.obstacles.place(state.motions)
            jump = JumpOperator(self.linear, state.jump.pairs, state.jump.frames)
            self._replace_jump(jump, replace(state, jump=jump))
            self.obstacles.place(present_motions)

    def begin_solve(self) -> None:
        """Begin a user's solve: pair as at the accepted step, and go to `at_start`. Collective."""
        self.pair_where_changed(self._state.accepted.configuration)
        self.state = self.state.at_start(self.depends_on_start)

    def pair_where_changed(
        self, configuration: fem.Function | None = None, geometry: fem.Function | None = None
    ) -> None:
        """Pair surfaces again where obstacles have moved, or at other displacements. Collective.

        Pairs with finite sliding are paired at `configuration` [length], others at `geometry`;
        None: where they are already. After a `PairingError` all are paired as before the call.
        With finite sliding, the slip of a node becomes its displacement since the last accepted
        step, relative to its present partner and projected onto its tangent plane.
        """
        state, finite = self.state, self._finite_sliding
        moves = self.record_motions()  # (pairs,)
        configuration = state.configuration if configuration is None else configuration
        geometry = state.geometry if geometry is None else geometry
        pairings = (state.geometry, geometry, ~finite), (state.configuration, configuration, finite)
        try:
            for before, u, candidates in pairings:
                differs = not (u is before or np.array_equal(u.x.array, before.x.array))
                differs_on_a_rank = self.comm.allreduce(differs, op=MPI.LOR)
                anew = candidates & (moves | differs_on_a_rank)  # (pairs,)
                if not anew.any():
                    continue
                for pair in self.jump.pairs:  # pairs of a group are paired together
                    numbers = list(pair.undeformed.group.numbers)
                    anew[numbers] = anew[numbers].any()
                since_accepted = finite & anew  # pairs whose slip counts from the accepted step
                with timed("pairing", self.timings):
                    frames = self.jump.frames
                    if since_accepted.any() and self.frames_at_rest is not None:
                        frames = self.frames_at_rest.moved_with(u)
                    jump = displaced_jump(self.jump, self.pairs, u, anew, frames)
                    self._replace_jump(jump, self._state.paired_at(jump, u, since_accepted))
        except PairingError:
            self.return_to(state)
            raise
        self._state = replace(self._state, configuration=configuration, geometry=geometry)

    def record_motions(self) -> Mask:
        """Record the motions of obstacles in the state; return which distances have changed.

        The mask (pairs,) tells for which pairs distances differ from those at the last pairing. If
        they do although the motion is the same, the user has changed the obstacle itself. With
        friction the log warns that this is no slip, unless it has Constants. Collective.
        """
        changed, motions = self.obstacles.changed(self.jump), self.obstacles.motions
        same_place = (self._state.motions == motions).all(axis=(1, 2))  # (pairs,)
        self._state = replace(self._state, motions=motions)
        for number in np.flatnonzero(changed & same_place):
            pair = self.pairs[number]
            has_no_constants = pair.obstacle is not None and not pair.obstacle.constants
            if has_no_constants and not isinstance(pair.friction, Frictionless):
                warn(
                    self.comm,
                    "contact pair %s: the distance from the obstacle has changed in a way that is "
                    "not part of the slip. With friction move the obstacle by its move_to().",
                    pair,
                )
        return changed

    def _replace_jump(self, jump: JumpOperator, state: StepState) -> None:
        """Replace B and the state; destroy the old B and what depends on it. Collective."""
        before, self.jump, self._state = self.jump, jump, state
        self.linear.frames = jump.frames
        self.guess.newest = None
        self.compliance = self.compliance.on(jump)
        self.obstacles.note_pairing(jump)
        self.summary = ProblemSummary.from_system(self.linear, self.pairs, jump)
        before.destroy()

    def history_of_solve(self) -> SlipHistory:
        """Return the slip history; this step's motion of obstacles moves its origin. Collective."""
        state = self._state
        jumps, _ = self.obstacles.jumps(state, state.accepted.motions, state.motions)
        shift = np.where(self.jump.is_tangential, jumps, 0.0)
        return replace(state.history, origin=state.history.origin + shift)

    def gaps_at_nodes(self, u: fem.Function) -> Array:
        """Return gaps (pairs, owned nodes) [length], NaN where N has no row. Collective."""
        gaps = (self.jump.gap - self.jump.of_displacement(u)) * self.jump.length_scale
        return self._at_nodes(gaps, np.nan)

    def normal_forces_at_nodes(self) -> Array:
        """Return normal forces [force] (pairs, owned nodes), 0 at open nodes. Not collective."""
        return self._at_nodes(self._state.multipliers / self.jump.stress_scale, 0.0)

    def _at_nodes(self, values: Array, default: float) -> Array:
        """Return (pairs, owned nodes) with the values (size,) of normal rows, else `default`."""
        result = np.full((len(self.pairs), self.linear.V.dofmap.index_map.size_local), default)
        for of_pair, rows in zip(result, self.jump.own_rows, strict=True):
            nodes = rows.operators.nodes[rows.operators.normal_node]  # of each normal row
            # on a sharp edge, where a node has several normal rows, the last of them counts
            of_pair[nodes] = values[rows.normal]
        return result

    def contact_forces(self, multipliers: Array | None = None) -> Array:
        """Return B'lambda [force], 0 where prescribed; by default of the state. Collective."""
        multipliers = self._state.multipliers if multipliers is None else multipliers
        return np.array(self.jump.contact_force(multipliers).array)

    def update_stiffness(self) -> None:
        """Factor K after coefficients have changed; turned bodies keep their frames. Collective."""
        self.compliance.destroy()
        self.compliance = self._factored()
        frames = BodyFrames.at_rest(self.linear, self.bodies, self.pairs)
        if self.jump.frames is not None:
            self.jump.frames.check_kept(frames)
        self.frames_at_rest = frames

    def solution_for(self, purpose: str) -> StepSolution:
        """Return the last solution; errors name the purpose that needs it. Not collective."""
        self.check_not_destroyed()
        if self.solved is None:
            raise ContactError(f"there is no solution for {purpose}: call solve() first.")
        return self.solved

    @property
    def displacement(self) -> fem.Function:
        """The displacement [length] of the last solution; `TangentProblem` takes the present u."""
        return self.solution_for("update_geometry() without a displacement").fields.u

    def rows(self, units: Units | None) -> list[Row]:
        """Return the rows of the table of bodies, surfaces and solver for K. Not collective."""
        return [
            ("bodies", str(self.stiffness)),
            *self.summary.rows(units),
            ("solver for K", str(self.compliance.solver)),
            ("chosen", self.stiffness.reason),
        ]

    def law_values(self, curves: Sequence[CurveAtNodes]) -> list[Array]:
        """Return present gaps, slip bounds and values of curves, to detect changes. Collective."""
        result = self.added_gaps()
        for bounds in self.slip_bounds():
            result += [bounds.constant, bounds.coefficient, bounds.limit]
            if bounds.direction is not None:
                result += [bounds.shape, bounds.direction]
        with errors_on_all_ranks(self.comm):
            return result + [pressed_values(*curve) for curve in curves]

    def advance_material(self, solution: StepSolution) -> None:
        """Advance the material's history to a solution; linear bodies have none. Collective."""

    def check_inputs(self, purpose: str) -> None:
        """Check that loads, laws, gaps and obstacles are those of the last solve. Collective.

        That solve must have converged, unless its result was accepted nevertheless.
        """
        solved = self.solution_for(purpose)
        if self.state.pending and solved.status is not ContactStatus.CONVERGED:
            raise ContactError(
                f"{purpose} needs a solution, and the last solve ended with {solved.status.name}."
            )
        self.linear.assemble_load()
        same_laws = all(map(np.array_equal, self.law_values(solved.curves), solved.laws))
        same_load = np.array_equal(self.linear.f.x.array, solved.load)
        same_obstacles = not self.obstacles.changed(self.jump).any()
        if not self.comm.allreduce(same_laws and same_load and same_obstacles, op=MPI.LAND):
            raise inputs_changed(purpose)

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Restore state, load and gaps after a block that changes them. Collective."""
        state = self.state
        try:
            yield
        finally:
            self.return_to(state)
            self.linear.assemble_load()
            self.update_gaps()

    def checked(self, solution: Solution) -> Solution:
        """Return the solution of a user's solve, OUTSIDE_THEORY if it left theory. Collective.

        Prescribed overlaps and the reason of a failure are logged. Solutions whose failure has a
        reason (`sliding`) already are not checked. Only the last configuration of finite sliding is
        checked: in earlier ones, surfaces from afar may lie deep inside other bodies.
        """
        scene_checks.hint_at_overlap(solution, self.pairs, self.jump)
        status = solution.status
        if status in CHECKED and not solution.sliding:
            state = self.state
            motions = self.obstacles.motions if state.solution is None else state.solution.motions
            departures: list[scene_checks.Departure] = []
            if not self.linear.is_tangent:
                departures += scene_checks.motions_of_bodies(solution.deformation, self.bodies)
            departures += scene_checks.motions_of_pairs(
                self.jump, self.pairs, solution, state.geometry, motions
            )
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

        The function `observe` is called before each iteration, on all ranks; True stops the solve.
        The options of the user, `requested`, decide whether the solve converged; None: `options`.
        The `units` are for tables and pictures of the solution.
        """
        free_unused(self.comm)  # vectors of the solves before
        requested = requested or options
        self.stiffness.check_suits(options)
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
            obstacle_moves = (state.accepted.motions != state.motions).any(axis=(1, 2))
            tools = self.obstacles.tools(jump, self.bodies, state.history.begun)
            if tools is not None and options.method != "projected_newton":
                raise InputError("forces on obstacles and bolts need method='projected_newton'.")
            dual = self._program(bounds, history, tools)
        with timed("iteration", timings):
            dual_solution = solve(dual, state.multipliers, options, observe)
        with timed("fields", timings):
            evaluation, history = evaluate(
                dual, self.secondary, self.bodies, dual_solution, estimate=options.balanced
            )
        x = dual_solution.multipliers
        status = status_of_fields(dual, dual_solution, evaluation, options, requested)
        curves = self._checked_curves(dual, dual_solution)
        load, laws = self.linear.f.x.array.copy(), self.law_values(curves)  # for `check_inputs`
        sliding = ""  # for messages: which body slides without end, and why
        if dual_solution.deficit is not None and dual.equilibrium is not None:
            sliding = dual.equilibrium.explain(dual_solution.deficit)
        motions = self.obstacles.motions
        if tools is not None and dual.equilibrium is not None:  # forces have moved tools by c
            c = (dual.equilibrium.factors * dual_solution.c)[dual.of_tools]
            motions = tools.places(c, motions)
            for surface, motion in zip(evaluation.surfaces, motions, strict=True):
                if surface.obstacle is not None:
                    surface.obstacle.motion = RigidMotion.from_matrix(motion)
        # what the state keeps of this solve, for `accept`, later checks and derivatives
        solution = StepSolution(
            status, dual, x, evaluation, history, curves, load, laws, obstacle_moves, motions
        )
        state = replace(state, multipliers=x, dissipation=evaluation.dissipation)
        self.state = replace(state, solution=solution, pending=True)
        products = compliance.products - products_before
        text = "%s: %s after %d iterations, %d products, residual %.2e"
        numbers = dual_solution.iterations, products, dual_solution.residuals[-1]
        log(self.comm, text, options.method, status.value, *numbers)
        slowest = largest_abs(self.comm, *timings.values())  # seconds of the slowest rank
        return ContactSolution(
            status=status,
            options=requested,
            units=units,
            iterations=dual_solution.iterations,
            products=products,
            krylov_iterations=compliance.solver.krylov_iterations - krylov,
            residuals=dual_solution.residuals,
            q=dual_solution.q,
            timings=dict(zip(timings, slowest, strict=True)),
            sliding=sliding,
            problem_rows=self.rows(units),
            bolts=self.obstacles.bolt_forces(jump, evaluation.pair_resultants),
            **vars(evaluation),
        )

    def _checked_curves(self, dual: DualProgram, solution: DualSolution) -> list[CurveAtNodes]:
        """Return friction curves with the pressures and slips of a solution. Collective.

        Curves are checked there, and the log warns if they decrease (`hint_at_weakening`).
        """
        x = solution.multipliers
        cones = dual.admissible.at_point(x, solution.gradient)
        if not isinstance(cones, FrictionCones) or not cones.curves.of_discs:
            return []
        arguments = cones.curve_arguments(x)
        for curve, pressures, slips in arguments:
            self.friction.check_curve(curve, pressures, slips)
        eigenvalue = dual.compliance.known_products().largest_eigenvalue_estimate
        scene_checks.hint_at_weakening(self.comm, cones, x, eigenvalue)
        return arguments

    def _program(
        self, bounds: Sequence[NodalBounds], history: SlipHistory, tools: Tools | None
    ) -> DualProgram:
        """Return the dual problem; a `MechanismError` gets its motion as a Function. Collective.

        Where contact or soft springs hold a body, no coefficient of friction may depend on the
        slip: for a block held by viscous friction, the solver finds no multipliers within minutes.
        """
        try:
            dual = DualProgram(self.compliance, self.guess, bounds, history, tools)
        except MechanismError as error:
            motion = with_owned_values(self.linear.V, error.motion, "motion")
            (greatest,) = largest_abs(self.comm, np.linalg.norm(owned_values(motion), axis=1))
            motion.x.array[:] /= greatest or 1.0  # it is zero if tools alone move
            error.motion = motion
            raise
        for pair in self.pairs:
            curve = pair.friction.terms.curve
            if dual.equilibrium is not None and curve is not None and curve.depends_on_slip:
                raise InputError(
                    f"contact pair {pair}: the coefficient of friction depends on the slip, and "
                    "contact or soft springs hold a body, whose slip is not known in the "
                    "iteration. Hold it by Dirichlet conditions, such as a prescribed motion."
                )
        return dual


def inputs_changed(purpose: str) -> ContactError:
    """Return the error to raise if inputs have changed since the solution that a purpose needs."""
    return ContactError(
        "loads, prescribed values, slip bounds, gaps, coefficients or places of obstacles have "
        f"changed since the solution that {purpose} is for: call solve()."
    )
