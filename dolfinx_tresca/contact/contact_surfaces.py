"""The contact surfaces as they are paired now, with their operators and their load steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask, real
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import errors_on_all_ranks, timed, warn
from dolfinx_tresca._base.petsc import PetscOwner, destroyed_on_error, free_unused
from dolfinx_tresca.contact.obstacles import Obstacles
from dolfinx_tresca.contact.step_state import StepSolution, StepState
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.load_steps import SlipHistory, moved_jump
from dolfinx_tresca.dual.products import ContactCompliance
from dolfinx_tresca.dual.program import InitialGuess
from dolfinx_tresca.dual.slip_bounds import NodalBounds, SlipBounds
from dolfinx_tresca.errors import ContactError, InputError, PairingError, StiffnessError
from dolfinx_tresca.floating.rigid_modes import (
    RigidBodyModes,
    fixing_springs,
    weakly_resisted_modes,
)
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output.report import ProblemSummary
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pair_surfaces import pair_group
from dolfinx_tresca.pairing.undeformed import groups_of
from dolfinx_tresca.scene.friction import Bonded, Frictionless, Preload
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair, check_tags
from dolfinx_tresca.solution.fields import Surface
from dolfinx_tresca.solution.forces import BoltForce, Resultant
from dolfinx_tresca.solution.scene_checks import Limit, hint_at_scene
from dolfinx_tresca.stiffness.choice import SolverRequest, warn_of_slow_blas
from dolfinx_tresca.stiffness.frames import BodyFrames
from dolfinx_tresca.stiffness.solver import cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem


class ContactSurfaces(PetscOwner):
    """The contact surfaces as they are paired now, B and A on them, and their load steps.

    Springs are added to K that fix the bodies that K holds only weakly, and the sum is factored.
    Surfaces are paired again on request, with finite sliding, or if an obstacle moves: then B and A
    are replaced, and tractions and slip are carried over.

    Attributes:
        linear: the system K u = f.
        pairs: the surfaces that may touch.
        secondary: the secondary side of each pair.
        bodies: the bodies of the mesh.
        method: name of the chosen solver for K.
        reason: why this solver was chosen, as text.
        slides_far: whether at least one pair has finite sliding.
        friction: object that evaluates the slip bounds, and users' fields (its `values`), at the
            nodes of the displacement.
        jump: the operator B, which maps displacements to jumps across the contact surfaces.
        compliance: A = B K^-1 B', with K factored.
        guess: displacements of earlier solves with the present B, for first guesses of iterative
            solves with K.
        unknowns: the displacement of nonlinear bodies, or all unknowns of a mixed space, at which
            solves start and end, owned by the user; None for linear bodies.
        obstacles: the rigid obstacles and their positions.
        frames_at_rest: frames of undeformed linear bodies, which move in configurations of finite
            sliding; None: no body has a frame.
        summary: the sizes of the problem, for tables.
        timings: phase -> seconds of pairing and factoring since the last solve.
    """

    def __init__(
        self, linear: LinearSystem, pairs: list[ContactPair], request: SolverRequest
    ) -> None:
        """Pair the surfaces, choose the solver for K, and assemble and factor K. Collective.

        The tags of cells in the pairs have the names of bodies.

        Raises:
            InputError: an option of the solver, a gap or a law of friction is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite.
        """
        free_unused(linear.comm)  # objects of earlier problems that were not destroyed
        self.linear, self.pairs, self.comm, self._destroyed = linear, pairs, linear.comm, False
        self._noticed: set[Limit] = set()  # limits of linear theory near which solutions have come
        self._petsc_options, self._prefix = request.petsc_options or {}, request.prefix
        if linear.comm.rank == 0:
            warn_of_slow_blas()
        check_tags(pairs, linear.V.mesh)
        cell_tags = (pair.cell_tags for pair in pairs if pair.cell_tags is not None)
        self.bodies = Bodies.from_space(linear.V, next(cell_tags, None))
        dim, is_saddle = linear.V.dofmap.index_map_bs, linear.component is not None
        size = dim * self.bodies.mean_nodes
        self.method, self.reason = request.choose(size, dim, linear.comm, saddle=is_saddle)
        self._modes: RigidBodyModes | None = None
        self._finite_sliding = np.array([pair.sliding == "finite" for pair in pairs], np.bool_)
        self.slides_far = bool(self._finite_sliding.any())
        # the slip bound of a pair depends on the pressure, unless its coefficient is zero
        coefficients = [real(pair.friction.terms.coefficient) for pair in pairs]
        self._depends_on_start = any(coefficient != 0.0 for coefficient in coefficients)
        self.unknowns: fem.Function | None = None
        self.obstacles = Obstacles(linear.V, pairs)
        self.timings: dict[str, float] = {}
        V, prescribed = linear.V, linear.prescribed_displacements
        with timed("pairing", self.timings):
            operators_of_number: dict[int, PairOperators] = {}
            for group in groups_of(V, pairs):
                paired = pair_group(V, prescribed, group, axisymmetric=linear.axisymmetric)
                operators_of_number.update(zip(group.numbers, paired, strict=True))
            operators = [operators_of_number[k] for k in range(len(pairs))]
            self.secondary = Surface.of_pairs(fem.Function(V), pairs)
            self.friction = SlipBounds(V)
        self.jump = JumpOperator(linear, operators)
        with destroyed_on_error(self.jump):
            self.update_gaps()
            self.summary = ProblemSummary.from_system(linear, pairs, self.jump)
            self.guess = InitialGuess(np.zeros(len(linear.prescribed)))
            self.obstacles.note_pairing(self.jump)
            self._state = StepState.undeformed(self.jump, self.obstacles.motions)
            self.compliance = self._factored()
            with destroyed_on_error(self.compliance):
                rounding = self.compliance.stress_rounding
                for pair, on_nodes in zip(pairs, operators, strict=True):
                    self.friction.check(pair.friction, on_nodes.nodes, rounding)
        self.frames_at_rest = self._frames_at_rest()
        hint_at_scene(linear.V, pairs, self.jump.pairs, self.bodies)

    def _factored(self) -> ContactCompliance:
        """Assemble K, find the rigid modes that it resists weakly, and return A. Collective.

        With a mixed space, the modes are found in the first call only: in later steps, pressures
        make the block of the displacements indefinite even for a stable body, and the signs of
        pivots tell whether bodies are held.
        """
        linear = self.linear
        with timed("stiffness", self.timings):
            linear.assemble_stiffness()
            if self._modes is None or linear.component is None:
                self._modes = weakly_resisted_modes(linear, self.bodies)
        springs = fixing_springs(self._modes, linear)
        with timed(self.method, self.timings):
            K = springs.added_to(linear.K) if springs else linear.K
            if self.method == "cholesky":
                solver = cholesky(K, self._petsc_options, self._prefix, linear.saddle_size)
            else:
                prescribed = linear.prescribed
                solver = multigrid(K, linear.V, prescribed, self._petsc_options, self._prefix)
            # for a saddle point, this factors another matrix
            return ContactCompliance(self.jump, solver, springs)

    @property
    def bodies_found(self) -> str:
        """The number of bodies and of the rigid motions that K resists weakly, as text."""
        return f"{self.bodies.number}{'' if self._modes is None else self._modes.summary}"

    def check_suits(self, options: SolverOptions) -> None:
        """Check that options suit the bodies and the form. Not collective."""
        linear = self.linear
        if options.balanced and not linear.form_of_displacement:
            reason = "a is none" if linear.form is None else "a is on a mixed space"
            raise InputError(
                'accuracy="balanced", the default, takes the error of the mesh as a measure, which '
                f"is estimated with a form of UFL of the displacement, and {reason}. Give "
                "solve(accuracy=1e-3), or a rtol."
            )
        if options.method != "projected_newton" and self._modes:
            raise InputError(
                f"method={options.method!r} needs bodies that are held by supports, but found "
                f"{self.bodies_found}. Take method='projected_newton'."
            )

    def _frames_at_rest(self) -> BodyFrames | None:
        """Return the frames of undeformed linear bodies with finite sliding. Collective."""
        if not self.slides_far or self.linear.is_tangent:
            return None
        V, dim = self.linear.V, self.linear.V.mesh.topology.dim - 1
        facets = [
            pair.facet_tags.find(side)
            for pair in self.pairs
            for side in (pair.secondary, pair.primary)
            if pair.sliding != "finite"
            and not isinstance(side, RigidObstacle)
            and not isinstance(pair.friction, Bonded)
        ]
        surfaces = [fem.locate_dofs_topological(V, dim, numbers) for numbers in facets]
        return BodyFrames.at_rest(self.linear, self.bodies, surfaces)

    def frames_at(self, u: fem.Function) -> BodyFrames | None:
        """Return the frames that move with a displacement; None if all are at rest. Collective."""
        return None if self.frames_at_rest is None else self.frames_at_rest.moved_with(u)

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
        """Return the present gaps (n,) [length] that users add at each pair's nodes. Collective."""
        gaps = []
        for number, (pair, on_nodes) in enumerate(zip(self.pairs, self.jump.pairs, strict=True)):
            gap, name = pair.gap, f"the gap of contact pair {pair}"
            gaps.append(
                self.friction.values.scalars_at(0.0 if gap is None else gap, on_nodes.nodes, name)
            )
            if isinstance(pair.friction, Preload):
                axis = self.obstacles.axis(number, on_nodes)
                gaps[number] += float(axis @ self.obstacles.motions[number][:, 3])
        return gaps

    def bolt_forces(self, resultants: Sequence[Resultant]) -> dict[str, BoltForce]:
        """Return the force in each bolt, by the name of its pair, from all pairs' resultants."""
        result = {}
        for number, (pair, resultant) in enumerate(zip(self.pairs, resultants, strict=True)):
            if isinstance(pair.friction, Preload):
                axis = self.obstacles.axis(number, self.jump.pairs[number])
                force = float(resultant.force @ axis[: len(resultant.force)])
                result[str(pair)] = BoltForce(force, force - pair.friction.value)
        return result

    def update_gaps(self) -> None:
        """Evaluate the gaps that users add to the distances, and update B's gap. Collective."""
        gaps = self.added_gaps()
        with errors_on_all_ranks(self.comm):
            for pair, gap in zip(self.pairs, gaps, strict=True):
                if not np.isfinite(gap).all():
                    raise InputError(
                        f"the gap of contact pair {pair} has values that are NaN or infinite. For "
                        "surfaces that cannot touch give no pair."
                    )
        operators = zip(self.jump.pairs, gaps, strict=True)
        self.jump.set_gaps([replace(on, added_gap=gap) for on, gap in operators])

    def align_tangents(self, bounds: Sequence[NodalBounds]) -> None:
        """Rotate the tangential rows of B to the principal axes of the slip bounds. Collective.

        If the axes have changed, so has A, and the known products are dropped.
        """
        jump = self.jump.along_axes(bounds)
        if jump is not self.jump:
            self._state = self._state.along_tangents(jump)
            self._replace_jump(jump)

    @property
    def solved(self) -> StepSolution | None:
        """The last solution; None if there was none since K or the pairing changed."""
        solution = self._state.solution
        valid = solution is not None and solution.dual.compliance is self.compliance
        return solution if valid else None

    @property
    def state(self) -> StepState:
        """The present state of the process. Not collective."""
        if self.unknowns is None:
            return self._state
        return replace(self._state, unknowns=self.unknowns.x.array.copy())

    @state.setter
    def state(self, state: StepState) -> None:
        """Continue from a state on the present B. Not collective."""
        self._state = state
        if self.unknowns is not None and state.unknowns is not None:
            self.unknowns.x.array[:] = state.unknowns

    def return_to(self, state: StepState) -> None:
        """Return to a former state, with its displacement and pairing. Collective.

        K stays as it is, and need not be factored. The user's obstacles stay where they are.
        """
        self.state = state
        if state.jump is not self.jump:
            moved_to = self.obstacles.motions
            self.obstacles.place(state.motions)
            jump = JumpOperator(self.linear, state.jump.pairs, state.jump.frames)
            self._state = replace(state, jump=jump)
            self._replace_jump(jump)
            self.obstacles.place(moved_to)

    def begin_solve(self) -> None:
        """Pair again where obstacles have moved, then go back to where the next solve starts.

        For nonlinear bodies the user's u is set to the start, too. Collective.
        """
        self.pair_where_changed(self._state.accepted.configuration)
        self.state = self.start

    @property
    def start(self) -> StepState:
        """The state from which the next solve begins with the present pairing. Collective."""
        return self.state.at_start(self._depends_on_start)

    def pair_where_changed(
        self, configuration: fem.Function | None = None, geometry: fem.Function | None = None
    ) -> None:
        """Pair surfaces again where obstacles have moved, or at other displacements. Collective.

        Args:
            configuration: displacement [length] for pairs with finite sliding; None: the present
                one.
            geometry: displacement [length] for the other pairs; None: the present one.

        Raises:
            InputError: the signed distance of an obstacle is wrong.
            PairingError: the surfaces cannot be paired; they stay as they were.
            StiffnessError: a solve with K failed.
        """
        state, moved, finite = self.state, self.note_obstacles(), self._finite_sliding
        configuration = state.configuration if configuration is None else configuration
        geometry = state.geometry if geometry is None else geometry
        try:
            for before, u, pairs in (
                (state.geometry, geometry, ~finite),
                (state.configuration, configuration, finite),
            ):
                differs = not (u is before or np.array_equal(u.x.array, before.x.array))
                on_some_rank = self.comm.allreduce(differs, op=MPI.LOR)
                self._pair_anew(u, pairs & (moved | on_some_rank))
        except PairingError:
            self.return_to(state)
            raise
        self._state = replace(self._state, configuration=configuration, geometry=geometry)

    def note_obstacles(self) -> Mask:
        """Record the present positions of the obstacles. Collective.

        A warning is logged for obstacles with friction that have changed without `move_to`, since
        the slip does not contain such a change. Obstacles that depend on Constants may change
        without a warning.

        Returns:
            (pairs,) whether the distance from the obstacle has changed since the pairing.
        """
        changed, motions = self.obstacles.changed(self.jump), self.obstacles.motions
        same_place = (self._state.motions == motions).all(axis=(1, 2))
        self._state = replace(self._state, motions=motions)
        for pair in compress(self.pairs, changed & same_place):
            fixed = pair.obstacle is not None and not pair.obstacle.constants
            if fixed and not isinstance(pair.friction, Frictionless):
                warn(
                    self.comm,
                    "contact pair %s: the distance from the obstacle has changed in a way that is "
                    "not part of the slip. With friction move the obstacle by its move_to().",
                    pair,
                )
        return changed

    def _pair_anew(self, u: fem.Function, anew: Mask) -> None:
        """Pair some surfaces in the configuration displaced by u. Collective.

        The mask (pairs,) `anew` has True for the pairs to be paired again. With finite sliding,
        the slip of a node is its displacement since the last accepted step, relative to its present
        partner and projected onto its tangent plane in the configuration.
        """
        if not anew.any():
            return
        for pair in self.jump.pairs:  # pairs of a group are paired together
            numbers = list(pair.undeformed.group.numbers)
            anew[numbers] = anew[numbers].any()
        with timed("pairing", self.timings):
            since_accepted = self._finite_sliding & anew
            frames = self.frames_at(u) if since_accepted.any() else self.jump.frames
            jump = moved_jump(self.jump, self.pairs, u, anew, frames)
            self._state = self._state.paired_at(jump, u, since_accepted)
            self._replace_jump(jump)

    def _replace_jump(self, jump: JumpOperator) -> None:
        """Replace B after a new pairing, and drop what depends on the old B. Collective."""
        before, self.jump = self.jump, jump
        self.linear.frames = jump.frames
        self.guess.newest = None
        self.compliance = self.compliance.on(jump)
        self.obstacles.note_pairing(jump)
        self.summary = ProblemSummary.from_system(self.linear, self.pairs, jump)
        before.destroy()

    def history_of_solve(self) -> SlipHistory:
        """Return the slip history whose origin moves with the obstacles in this step. Collective.

        The slip on an obstacle then counts relative to the obstacle.
        """
        state = self._state
        jumps, _ = self.obstacle_jumps(state.accepted.motions, state.motions)
        for normal, _ in self.jump.slices:
            jumps[normal] = 0.0
        return replace(state.history, origin=state.history.origin + jumps)

    def obstacle_jumps(self, before: Array, after: Array) -> tuple[Array, float]:
        """Return the jumps (size,) that motions of obstacles cause, and the largest displacement.

        The motions are (pairs, 3, 4), see `RigidMotion.matrix`. The jumps are divided by
        `JumpOperator.length_scale`, and are zero where no obstacle moves. Collective.
        """
        state, jump = self._state, self.jump
        jumps, largest = np.zeros(len(jump.gap)), 0.0
        for start, end, slides_far, (normal, tangential) in zip(
            before, after, self._finite_sliding, jump.slices, strict=True
        ):
            if not np.array_equal(start, end):
                u = state.configuration if slides_far else state.geometry
                moved = self.obstacles.displacement(start, end, u)
                largest = max(largest, float(np.abs(moved.x.array).max(initial=0.0)))
                rows = slice(normal.start, tangential.stop)
                jumps[rows] = jump.of_displacement(moved)[rows]
        return jumps, largest

    def gaps_at_nodes(self, u: fem.Function) -> Array:
        """Return the gaps (pairs, owned nodes) [length], NaN without multipliers. Collective."""
        jump = self.jump
        return self._at_nodes((jump.gap - jump.of_displacement(u)) * jump.length_scale, np.nan)

    def normal_forces_at_nodes(self) -> Array:
        """Return the normal contact forces (pairs, owned nodes), 0 at open nodes. Not collective.

        They are in the units of the multipliers times areas, which suits comparisons.
        """
        return self._at_nodes(self._state.multipliers / self.jump.stress_scale**2, 0.0)

    def _at_nodes(self, values: Array, default: float) -> Array:
        """Return the values (pairs, owned nodes) of normal rows, from those (size,) of B's rows."""
        nodes = self.linear.V.dofmap.index_map.size_local
        result = np.full((len(self.pairs), nodes), default)
        for of_pair, pair, (n, _) in zip(result, self.jump.pairs, self.jump.slices, strict=True):
            of_pair[pair.nodes[pair.normal_node]] = values[n]
        return result

    def contact_forces(self, multipliers: Array | None = None) -> Array:
        """Return B'lambda [force] of owned unknowns, zero where prescribed. Collective.

        None stands for the multipliers of the present state.
        """
        multipliers = self._state.multipliers if multipliers is None else multipliers
        return np.array(self.jump.contact_force(multipliers).array)

    def update_stiffness(self) -> None:
        """Assemble and factor K again. Collective."""
        self.compliance.destroy()
        self.compliance = self._factored()
        frames = self._frames_at_rest()
        if self.jump.frames is not None and (
            frames is None or (frames.has_frame != self.jump.frames.has_frame).any()
        ):
            raise StiffnessError(
                "bodies have turned in their frames, and the new K resists the rigid motions of "
                "one of them, as springs do that refer to a place in space. Have such springs in a "
                "from the start: the body then has no frame."
            )
        self.frames_at_rest = frames
