"""The discretised contact problem: K, the contact operators, and accepted load steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.owner import PetscOwner, destroyed_on_error, free_unused
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca._base.timing import largest_over_ranks, timed
from dolfinx_tresca.dual.history.load_steps import LoadSteps
from dolfinx_tresca.dual.history.slip_history import SlipHistory
from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import moved_jump
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import NodalBounds, SlipBounds
from dolfinx_tresca.errors import ContactError, InputError, MechanismError
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.fixing import fixing_springs
from dolfinx_tresca.floating.weak_modes import weakly_resisted_modes
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output.summary import ProblemSummary
from dolfinx_tresca.output.table import Row
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.problem.friction_checks import (
    check_curves,
    check_curves_of_floating_bodies,
    depends_on_pressure,
)
from dolfinx_tresca.problem.obstacles import Obstacles
from dolfinx_tresca.problem.solve_to_bound import solve_to_bound
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.fields import Surface
from dolfinx_tresca.solution.hints import (
    hint_at_displacement,
    hint_at_scene,
)
from dolfinx_tresca.solution.sliding import Sliding
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.choice import (
    ChosenMethod,
    StiffnessMethod,
    check_choice,
    choose,
    solver_for,
)
from dolfinx_tresca.stiffness.nested import is_nested
from dolfinx_tresca.stiffness.solver import check_options
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.units import Units


class ContactSystem(PetscOwner):
    """A discretised contact problem: K, B, the laws of friction, and the accepted load steps.

    A linear problem uses one such system for all solves. Newton's method for nonlinear bodies also
    uses one; its K is the present tangent.

    Attributes:
        linear: the system K u = f with its Dirichlet conditions.
        pairs: the surfaces that may touch.
        jump: the operator B, which maps displacements to jumps across the contact surfaces.
        compliance: A = B K^-1 B', with K factored.
        steps: the multipliers at which the next solve starts, and the accepted load steps.
        surfaces: the secondary side of each pair.
        sliding: the displacement at which surfaces were last paired, and a check of the slip since
            this pairing.
        geometry: displacement at which pairs without finite sliding were paired.
        obstacles: the rigid obstacles and their positions.
        summary: the sizes of the problem.
        slides_far: whether a pair has finite sliding.
        stiffness: the chosen solver for K.
        solved: the last solve's dual problem, its multipliers and its fields; None if there was no
            solve since the last change.
        options_of_solve: options of the last solve.
        moved_in_solve: (pairs,) whether the pair's obstacle moves in the load step of the last
            solve.
    """

    def __init__(
        self,
        linear: LinearSystem,
        pairs: list[ContactPair],
        stiffness: StiffnessMethod,
        expected_solves: int = 1,
        petsc_options: Mapping[str, Any] | None = None,
        petsc_options_prefix: str | None = None,
    ) -> None:
        """Pair the surfaces, and assemble and factor K. Collective.

        Args:
            linear: the system K u = f. The problem owns it, and destroys it if this call fails.
            pairs: the surfaces that may touch.
            stiffness: how to solve with K: "cholesky", "multigrid" or "auto".
            expected_solves: number of solves with the same K, approximately.
            petsc_options: PETSc options of the solver for K, with precedence over the defaults.
            petsc_options_prefix: prefix of the options that the command line gives to this solver.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite.
        """
        self.linear, self.pairs = linear, pairs
        self._finite_sliding = np.array(
            [pair.sliding == "finite" for pair in pairs], dtype=np.bool_
        )
        self.slides_far = bool(self._finite_sliding.any())
        self._accepted_configuration: fem.Function | None = None
        self.obstacles = Obstacles(linear.V, pairs)
        self._petsc_options = {} if petsc_options is None else petsc_options
        self._petsc_options_prefix = petsc_options_prefix
        self._setup_timings: dict[str, float] = {}
        self._destroyed = self._has_hinted_at_displacement = False
        self._operators: tuple[ContactOperators, ...] | None = None
        self.solved: tuple[DualProgram, Array, Evaluation] | None = None
        self._inputs_of_solve: list[Array] = []
        self.options_of_solve = SolverOptions()
        self.moved_in_solve = np.zeros(len(pairs), dtype=np.bool_)
        try:
            check_options(self._petsc_options, petsc_options_prefix)
            check_choice(stiffness, expected_solves, saddle=linear.component is not None)
            self._requested_stiffness = stiffness, int(expected_solves)
            free_unused(self.comm)  # objects of earlier problems that were not destroyed
            if self.comm.rank == 0:
                warn_of_slow_blas()
            self._set_up()
        except ContactError:
            linear.destroy()
            raise

    def _set_up(self) -> None:
        """Pair the surfaces, and assemble and factor K. Collective."""
        V, pairs = self.linear.V, self.pairs
        with timed("pairing", self._setup_timings):
            prescribed = self.linear.prescribed_displacements
            operators = [
                pair_surfaces(V, prescribed, pair, axisymmetric=self.linear.axisymmetric)
                for pair in pairs
            ]
            self.surfaces = [Surface.of(V, pair) for pair in pairs]
            self._slip_bounds = SlipBounds(V)
            for pair, on_nodes in zip(pairs, operators, strict=True):
                self._slip_bounds.check(pair.friction, on_nodes.nodes)
        self.jump = JumpOperator(self.linear, operators)
        with destroyed_on_error(self.jump):
            self._update_gaps()
        operators = self.jump.pairs
        cell_tags = [pair.cell_tags for pair in pairs if pair.cell_tags is not None]
        self._bodies = Bodies.of(V, cell_tags[0] if cell_tags else None)
        self.summary = ProblemSummary.of(self.linear, pairs, operators)
        self._guess = InitialGuess(self.jump)
        self.sliding = Sliding(V)
        self.geometry = fem.Function(V)
        self.obstacles.note_pairing(self.jump)
        self.steps = LoadSteps(
            self.jump,
            self.obstacles.motions,
            depends_on_start=any(map(depends_on_pressure, pairs)),
        )
        with destroyed_on_error(self._guess), destroyed_on_error(self.jump):
            self.compliance = self._factored()
            with destroyed_on_error(self.compliance):
                rounding = self.compliance.stress_rounding
                for pair, on_nodes in zip(pairs, operators, strict=True):
                    self._slip_bounds.check_numbers(pair.friction, on_nodes.nodes, rounding)
        hint_at_scene(V, pairs, operators, self._bodies)

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self.linear.comm

    def rows(self, units: Units | None) -> list[Row]:
        """Return the rows of the table that `print(problem)` shows. Not collective."""
        return [
            ("bodies", f"{self._bodies.number}{self._modes.summary}"),
            *self.summary.rows(units),
            ("solver for K", str(self.compliance.operator.solver)),
            ("chosen", self._stiffness_reason),
        ]

    def __repr__(self) -> str:
        return (
            f"{self.summary.dofs} displacements, {self.summary.contact_nodes} contact nodes in "
            f"{len(self.pairs)} pair(s), {self.stiffness}"
        )

    @property
    def operators(self) -> tuple[ContactOperators, ...]:
        """N, T, gaps and areas of each pair, along the tangents of the last solve. Collective.

        Raises:
            ContactError: the problem was destroyed.
            InputError: a gap has values that are NaN or infinite.
        """
        self.check_not_destroyed()
        self._update_gaps()
        if self._operators is None:
            component = self.linear.component
            columns = () if component is None else (component.columns,)
            self._operators = tuple(
                ContactOperators(self.linear.V, operators, pair, *columns)
                for operators, pair in zip(self.jump.pairs, self.pairs, strict=True)
            )
        return self._operators

    def check_not_destroyed(self) -> None:
        """Check that the PETSc objects exist. Not collective.

        Raises:
            ContactError: the problem was destroyed.
        """
        if self._destroyed:
            raise ContactError("the problem was destroyed: create a new one.")

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._destroyed = True
        self._drop_operators()
        for owner in (self.nodal_values, self.compliance, self._guess, self.jump, self.linear):
            owner.destroy()

    def _drop_operators(self) -> None:
        """Free the operators that users have received. Collective."""
        for owner in self._operators or ():
            owner.destroy()
        self._operators = None

    def forget(self) -> None:
        """Drop multipliers and products: the next solve starts from zero. Not collective."""
        self.steps.forget()
        self.solved = None
        self.compliance.forget()

    def slip_bounds(self) -> list[NodalBounds]:
        """Return the present slip bounds at each pair's nodes. Collective.

        Raises:
            InputError: a bound is wrong.
        """
        rounding = self.compliance.stress_rounding
        return [
            self._slip_bounds.at(pair.friction, operators.nodes, rounding)
            for pair, operators in zip(self.pairs, self.jump.pairs, strict=True)
        ]

    @property
    def nodal_values(self) -> NodalValues:
        """The object that evaluates users' fields at the nodes of the displacement."""
        return self._slip_bounds.values

    def _inputs(self, bounds: Sequence[NodalBounds]) -> list[Array]:
        """Return load, slip bounds and added gaps, to compare two solves. Not collective."""
        result = [self.linear.f.x.array.copy()]
        for one in bounds:
            result += [one.constant, one.coefficient, one.limit]
            if one.ellipses is not None:
                result += [one.ellipses.shape, one.ellipses.direction]
        return result + [on_nodes.added_gap for on_nodes in self.jump.pairs]

    def check_inputs(self, purpose: str) -> None:
        """Check that loads, prescribed values, slip bounds and gaps are those of the last solve.

        Collective.

        Args:
            purpose: name of the result that needs the solution, for the error.

        Raises:
            ContactError: the last solve did not converge, or the data have changed since.
            InputError: a gap, a slip bound or a coefficient of friction has a value that is not
                allowed.
        """
        status = ContactStatus.CONVERGED if self.steps.last is None else self.steps.last[0]
        if status is not ContactStatus.CONVERGED:
            raise ContactError(
                f"{purpose} needs a solution, and the last solve ended with {status.name}."
            )
        self.linear.assemble_load()
        self._update_gaps()
        now = self._inputs(self.slip_bounds())
        same = all(map(np.array_equal, now, self._inputs_of_solve))
        same &= not self.obstacles.changed(self.jump).any()
        if not self.comm.allreduce(same, op=MPI.LAND):
            raise ContactError(
                "loads, prescribed values, slip bounds or gaps have changed since the solution "
                f"that {purpose} is for: call solve()."
            )

    def _update_gaps(self) -> None:
        """Evaluate the gaps that users add to the distances, and update B's gap. Collective.

        Raises:
            InputError: a gap is on another mesh, or is NaN or infinite.
        """
        gaps = [
            np.zeros(len(on.nodes))
            if pair.gap is None
            else self.nodal_values.at(pair.gap, on.nodes, f"the gap of contact pair {pair}")
            for pair, on in zip(self.pairs, self.jump.pairs, strict=True)
        ]
        changed = [
            not np.array_equal(gap, on.added_gap)
            for gap, on in zip(gaps, self.jump.pairs, strict=True)
        ]
        with errors_on_all_ranks(self.comm):
            for pair, gap in zip(self.pairs, gaps, strict=True):
                if not np.isfinite(gap).all():
                    raise InputError(
                        f"the gap of contact pair {pair} has values that are NaN or infinite. For "
                        "surfaces that cannot touch give no pair."
                    )
        if self.comm.allreduce(any(changed), op=MPI.LOR):
            self.jump.add_gaps(gaps)
            self._drop_operators()

    def align_tangents(self, bounds: Sequence[NodalBounds]) -> None:
        """Rotate the tangential rows of B to the principal axes of the slip bounds. Collective.

        If the axes differ from the axes of the last solve, A becomes another matrix, and only the
        far field of the known products is kept.

        Raises:
            InputError: the direction of orthotropic friction is normal to the surface.
        """
        jump = self.jump.along_axes(bounds)
        if jump is not self.jump:
            self.steps.rotate_tangents(jump)
            self._replace_jump(jump)

    def update_geometry(self, u: fem.Function) -> None:
        """Pair the surfaces in the configuration displaced by u. Collective.

        Args:
            u: displacement [length] in the problem's space.

        Raises:
            InputError: u is no Function of that space, or has values that are NaN or infinite.
            PairingError: the displaced surfaces cannot be paired; the problem stays as it was.
            StiffnessError: a solve with K failed.
            ContactError: the problem was destroyed.
        """
        self.check_not_destroyed()
        self.linear.check_displacement("the displacement u of the surfaces", u)
        self.note_obstacles()
        jump = moved_jump(self.jump, self.pairs, u)
        self.steps.move(jump, u, continues=self._ended_at(u))
        self._replace_jump(jump)
        self.geometry = u.copy()
        self.summary = ProblemSummary.of(self.linear, self.pairs, jump.pairs)
        self.sliding.begin(u)

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Restore the accepted steps and the last solve at the end of the block. Collective.

        Inside the block, solves may start from other steps and with other inputs, but the pairing
        must not change. If K changes inside the block, the last solve is dropped.
        """
        steps, compliance = self.steps, self.compliance
        start, multipliers, last = steps.start, steps.multipliers, steps.last
        solve = self.solved, self._inputs_of_solve, self.options_of_solve, self.moved_in_solve
        try:
            yield
        finally:
            steps.return_to(start)
            steps.multipliers, steps.last = multipliers, last
            self.solved, self._inputs_of_solve, self.options_of_solve, self.moved_in_solve = solve
            if self.compliance is not compliance:
                self.solved = None
            self.linear.assemble_load()
            self._update_gaps()

    def accept(self, unconverged: bool) -> None:
        """Make the last solution a load step. Not collective.

        See `LoadSteps.accept`.
        """
        self.steps.accept(unconverged)
        if self.slides_far:
            self._accepted_configuration = self.sliding.origin.copy()

    def begin_solve(self) -> None:
        """Let the next solve start at the last accepted step if its result may depend on the start.

        Pairs whose obstacle has moved since they were paired are paired anew. Collective.

        Raises:
            InputError: the signed distance of an obstacle is wrong.
            PairingError: the surfaces cannot be paired.
            StiffnessError: a solve with K failed.
        """
        accepted = self._accepted_configuration
        self.pair_where_changed(self.sliding.origin.copy() if accepted is None else accepted)
        self.steps.begin_solve()

    def pair_where_changed(self, u: fem.Function) -> None:
        """Pair surfaces anew where the geometry has changed. Collective.

        These are pairs whose obstacle has moved, and pairs with finite sliding not yet paired at u.

        Args:
            u: displacement [length] at which pairs with finite sliding are paired.

        Raises:
            InputError: the signed distance of an obstacle is wrong.
            PairingError: the surfaces cannot be paired.
            StiffnessError: a solve with K failed.
        """
        moved = self.note_obstacles()
        elsewhere = self._finite_sliding & (not self.sliding.began_at(u))
        self._pair_anew(self.geometry, moved & ~self._finite_sliding)
        self._pair_anew(u, (moved & self._finite_sliding) | elsewhere)
        if elsewhere.any():
            self.sliding.begin(u)

    def note_obstacles(self) -> Mask:
        """Record the present positions of the obstacles. Collective.

        Returns:
            (pairs,) whether the distance from the obstacle has changed since the pairing.
        """
        changed = self.obstacles.changed(self.jump)
        before, self.steps.motions = self.steps.motions, self.obstacles.motions
        same_place = (before == self.steps.motions).all(axis=(1, 2))
        self.obstacles.warn_of_unknown_motions(changed, same_place)
        return changed

    def update_configuration(self, u: fem.Function) -> None:
        """Pair surfaces with finite sliding in the configuration displaced by u. Collective.

        Args:
            u: displacement [length] in the problem's space.

        Raises:
            PairingError: the displaced surfaces cannot be paired.
            StiffnessError: a solve with K failed.
        """
        self._pair_anew(u, self._finite_sliding)
        self.sliding.begin(u)

    def _pair_anew(self, u: fem.Function, anew: Mask) -> None:
        """Pair some surfaces in the configuration displaced by u. Collective.

        With finite sliding the slip counts from the last accepted step. It is the displacement of a
        node since this step, relative to the node's present partner and projected onto the node's
        tangent plane in the configuration.

        Args:
            u: displacement [length] in the problem's space.
            anew: (pairs,) True for pairs that are paired anew.

        Raises:
            PairingError: the displaced surfaces cannot be paired.
            StiffnessError: a solve with K failed.
        """
        if not anew.any():
            return
        with timed("pairing", self._setup_timings):
            jump = moved_jump(self.jump, self.pairs, u, anew)
            self.steps.move(jump, u, since_accepted=self._finite_sliding & anew)
            self._replace_jump(jump)

    def _history_of_solve(self) -> SlipHistory:
        """Return the slip history whose origin moves with the obstacles in this step. Collective.

        The slip on an obstacle then counts relative to the obstacle.
        """
        steps, jump = self.steps, self.jump
        displacement = np.zeros(len(jump.gap))
        for before, now, slides_far, (_, t) in zip(
            steps.accepted_motions, steps.motions, self._finite_sliding, jump.slices, strict=True
        ):
            if not np.array_equal(before, now):
                u = self.sliding.origin if slides_far else self.geometry
                moved = self.obstacles.displacement(before, now, u)
                displacement[t] = jump.of_displacement(moved)[t]
        return steps.history.with_moved_obstacles(displacement)

    def check_displacement(self, u: fem.Function) -> None:
        """Log a warning, once, if a body is deformed by more than the extent of all bodies.

        Collective.

        With finite sliding only the final solution is checked, since in the first configurations
        surfaces that come from afar may lie deep inside other bodies.

        Args:
            u: displacement of a solution [length].
        """
        if not self._has_hinted_at_displacement:
            self._has_hinted_at_displacement = hint_at_displacement(u, self._bodies)

    def gaps_at_nodes(self, u: fem.Function) -> Array:
        """Return the gaps (pairs, owned nodes) [length] at a displacement. Collective.

        They are NaN at nodes without a normal multiplier.
        """
        jump, V = self.jump, self.linear.V
        gaps = (jump.gap - jump.of_displacement(u)) * jump.length_scale
        result = np.full((len(self.pairs), V.dofmap.index_map.size_local), np.nan)
        for at_nodes, pair, (n, _) in zip(result, jump.pairs, jump.slices, strict=True):
            at_nodes[pair.nodes[pair.normal_node]] = gaps[n]
        return result

    def contact_forces(self) -> Array:
        """Return B'lambda [force] of owned unknowns, zero where prescribed. Collective."""
        return np.array(self.jump.contact_force(self.steps.multipliers).array)

    def _ended_at(self, u: fem.Function) -> bool:
        """Return whether u is the displacement of the last solve. Collective."""
        same = self.solved is not None and np.array_equal(self.solved[2].u.x.array, u.x.array)
        return bool(self.comm.allreduce(same, op=MPI.LAND))

    def _replace_jump(self, jump: JumpOperator) -> None:
        """Replace B after a new pairing, and drop what depends on the old B. Collective."""
        before, self.jump = self.jump, jump
        self._guess.forget()
        self.compliance = self.compliance.on(jump)
        self._drop_operators()
        self.obstacles.note_pairing(jump)
        self.solved = None
        before.destroy()

    def update_stiffness(self) -> None:
        """Assemble and factor K again. Collective.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
            ContactError: the problem was destroyed.
        """
        self.check_not_destroyed()
        self.solved = None
        self.compliance.destroy()
        self.compliance = self._factored(self.compliance)

    def _factored(self, before: ContactCompliance | None = None) -> ContactCompliance:
        """Assemble K, find the rigid modes it resists weakly, and return A. Collective.

        Args:
            before: A with the former K, whose far field the new A keeps; None: there is none.
        """
        linear, timings = self.linear, self._setup_timings
        with timed("stiffness", timings):
            linear.assemble_stiffness()
            if before is None or linear.component is None:
                # in later steps pressures make the block of the displacements indefinite even for
                # a stable body; then the signs of pivots tell whether bodies are held
                self._modes = weakly_resisted_modes(linear, self._bodies)
        if before is None:
            self.stiffness, self._stiffness_reason = self._chosen_stiffness()
        springs = fixing_springs(self._modes, linear)
        K = springs.added_to(linear.K) if springs else linear.K
        try:
            with timed(self.stiffness, timings):
                solver = solver_for(
                    self.stiffness, K, linear, self._petsc_options, self._petsc_options_prefix
                )
        finally:
            if springs:
                K.destroy()  # the solver has a reference of its own
        with timed(self.stiffness, timings):  # for a saddle point this factors another matrix
            return ContactCompliance(self.jump, solver, springs, before)

    def _chosen_stiffness(self) -> tuple[ChosenMethod, str]:
        """Return the solver for K that suits these bodies, and the reason. Not collective."""
        method, expected_solves = self._requested_stiffness
        V = self.linear.V
        dim = V.dofmap.index_map_bs
        return choose(
            method,
            dim * self._bodies.mean_nodes,
            dim,
            V.element.basix_element.degree,
            expected_solves,
            self.comm,
            saddle=self.linear.component is not None,
            refined=is_nested(V),
        )

    def _check_solvable(self, options: SolverOptions) -> None:
        """Check that K is factored, and that the options suit the bodies and the form.

        Not collective.

        Raises:
            ContactError: the problem was destroyed, or its last `update_stiffness` failed.
            InputError: the options need a form of UFL, or bodies without rigid motions.
        """
        linear = self.linear
        if options.balanced and not linear.form_of_displacement:
            found = "a is none" if linear.form is None else "a is on a mixed space"
            raise InputError(
                'accuracy="balanced", the default, takes the error of the mesh as a measure, which '
                f"is estimated with a form of UFL of the displacement, and {found}. Give "
                "solve(accuracy=1e-3), or a rtol."
            )
        if options.method != "projected_newton" and self._modes:
            raise InputError(
                f"method={options.method!r} needs bodies that are held by supports, but found "
                f"{self._bodies.number}{self._modes.summary}. Take method='projected_newton'."
            )
        self.compliance.operator.solver.check_ready()

    def _largest_of_one(self, values: Array) -> fem.Function:
        """Return a motion with given owned values, scaled to a greatest nodal length of 1.

        Collective.
        """
        motion = fem.Function(self.linear.V, name="motion")
        lengths = np.linalg.norm(values.reshape(-1, motion.function_space.dofmap.bs), axis=1)
        greatest = reduce_array(self.comm, lengths.max(initial=0.0), MPI.MAX)
        motion.x.array[: len(values)] = values / greatest
        motion.x.scatter_forward()
        return motion

    def solve(
        self,
        options: SolverOptions,
        units: Units | None,
        observe: Callable[[Iteration], bool],
    ) -> ContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        Args:
            options: options of the contact algorithm.
            units: names of units, for tables and pictures of the solution.
            observe: function that is called before each iteration, on all ranks; the solve stops
                if it returns True.

        Raises:
            ContactError: the problem was destroyed, or its last `update_stiffness` failed.
            InputError: an option, a load, a prescribed value or a slip bound is wrong.
            MechanismError: nothing holds a body against its loads.
            StiffnessError: a solve with K failed.
        """
        self._check_solvable(options)
        timings, self._setup_timings = self._setup_timings, {}
        self.steps.last = self.solved = None
        self.options_of_solve = options
        with timed("load", timings):
            self.linear.assemble_load()
            bounds = self.slip_bounds()
            self.align_tangents(bounds)
            self._update_gaps()
            self._inputs_of_solve = self._inputs(bounds)
            operator = self.compliance.operator
            products, krylov = operator.products, operator.solver.krylov_iterations
            history = self._history_of_solve()
            places = self.steps.accepted_motions, self.steps.motions
            self.moved_in_solve = (places[0] != places[1]).any(axis=(1, 2))
            try:
                dual = DualProgram.of(self.compliance, self._guess, bounds, history)
            except MechanismError as error:
                error.motion = self._largest_of_one(error.motion)
                raise
            if dual.equilibrium is not None:
                check_curves_of_floating_bodies(self.pairs)
            dual.response.solve_load()
        found, evaluation, history = solve_to_bound(
            dual, self.steps.multipliers, self.surfaces, self._bodies, options, observe, timings
        )
        self.steps.multipliers = found.multipliers
        status = found.status
        check_curves(dual, found, self._slip_bounds)
        sliding = ""
        if found.deficit is not None and dual.equilibrium is not None:
            sliding = dual.equilibrium.explain(found.deficit)
        self.steps.last = status, history, evaluation.w
        if not self.slides_far:
            self.check_displacement(evaluation.u)
        if status is ContactStatus.CONVERGED:
            self.sliding.warn(self.jump, self.pairs, evaluation.u, found.multipliers)
        self.solved = dual, found.multipliers, evaluation
        log(
            self.comm,
            "%s: %s after %d iterations, %d products, residual %.2e",
            *(options.method, status.value, found.iterations, operator.products - products),
            found.residuals[-1],
        )
        return ContactSolution(
            status=status,
            options=options,
            units=units,
            iterations=found.iterations,
            sweeps=found.sweeps,
            products=operator.products - products,
            krylov_iterations=operator.solver.krylov_iterations - krylov,
            residuals=found.residuals,
            q=found.q,
            timings=largest_over_ranks(self.comm, timings),
            sliding=sliding,
            **vars(evaluation),
        )
