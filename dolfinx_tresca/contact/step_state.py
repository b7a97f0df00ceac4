"""The state of a process of load steps, as immutable records."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.load_steps import Carry, SlipHistory
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, ConvergenceError
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solvers.feasible_set import CurveAtNodes
from dolfinx_tresca.status import ContactStatus


@dataclass(frozen=True)
class AcceptedStep:
    """The last accepted load step, or the slip origin that the user has set.

    Attributes:
        multipliers: (size,) multipliers to which solves return if their result may depend on them.
        unknowns: `StepState.unknowns` that belong to these multipliers.
        displacement: u of the step [length], from which slip counts with finite sliding; None: 0.
        motions: (pairs, 3, 4) `Obstacles.motions` of the step, from which slip counts.
        configuration: displacement [length] at which pairs with finite sliding were paired; None:
            solves begin with the present pairing.
        before: u of the step before [length]; None: there is none, or it is not known.
    """

    multipliers: Array
    unknowns: Array | None
    displacement: fem.Function | None
    motions: Array
    configuration: fem.Function | None
    before: fem.Function | None = None


@dataclass(frozen=True)
class StepSolution:
    """A solution, which `StepState.after_solution` can make an accepted step.

    Attributes:
        multipliers: (size,) solution of the dual problem `dual`.
        history: slip and dissipation of the accepted steps and of this solution.
        curves: each friction curve with the pressures [stress] and slips [length] of its nodes.
        load, laws: f and `ContactSystem.law_values` in this solve, to detect later changes.
        obstacle_moves: (pairs,) whether the pair's obstacle moves in this load step.
        motions: (pairs, 3, 4) `Obstacles.motions` in the solution, where forces have moved tools.
    """

    status: ContactStatus
    dual: DualProgram
    multipliers: Array
    fields: Evaluation
    history: SlipHistory
    curves: list[CurveAtNodes]
    load: Array
    laws: list[Array]
    obstacle_moves: Mask
    motions: Array


@dataclass(frozen=True)
class StepState:
    """The state of a process of load steps: what the next solve depends on, beside its inputs.

    Loads, prescribed values and places of obstacles are inputs. Methods return another state.

    If friction depends on the pressure, the solution of a load step may depend on the tractions at
    which its solve starts: these must be tractions of the last accepted step, not of a trial solve.
    Otherwise the solution is unique, and the end of the last solve is the better start.

    Attributes:
        jump: B, to whose rows the arrays of this state belong. If the surfaces were paired anew
            since, its PETSc objects are destroyed.
        history: slip and dissipation of the accepted steps, and the origin of friction.
        multipliers: (size,) multipliers of the last solve; the next starts there or at `accepted`.
        motions: (pairs, 3, 4) `Obstacles.motions` when a solve last looked whether they changed.
        configuration: displacement [length] at which pairs with finite sliding are paired.
        geometry: displacement [length] at which the other pairs are paired.
        unknowns: values of the displacement of nonlinear bodies, or of all unknowns of a mixed
            space, with ghosts; None for linear bodies.
        end: `unknowns` at which the last solve ended; None: it has not ended. If the user has
            changed them since, the next solve starts at the user's values.
        continues: whether the load step goes on from the last solve in another configuration, so
            that the next solve starts from the tractions of this last solve.
        solution: the last solution, for goals and derivatives; None as soon as another solve has
            begun, or surfaces were paired anew.
        pending: whether the last solution can be accepted: there is one, and it is no step yet.
        dissipation: work of friction from the accepted step to the last solve's end [energy].
    """

    jump: JumpOperator
    history: SlipHistory
    multipliers: Array
    motions: Array
    configuration: fem.Function
    geometry: fem.Function
    accepted: AcceptedStep
    unknowns: Array | None = None
    end: Array | None = None
    continues: bool = False
    solution: StepSolution | None = None
    pending: bool = False
    dissipation: float = 0.0

    @classmethod
    def undeformed(cls, jump: JumpOperator, motions: Array) -> StepState:
        """Return the state of undeformed bodies without load. Collective."""
        zeros, at_rest = np.zeros(len(jump.gap)), fem.Function(jump.system.V)
        accepted = AcceptedStep(zeros, None, None, motions, None)
        return cls(jump, SlipHistory.none(jump), zeros, motions, at_rest, at_rest, accepted)

    def started_at(self, multipliers: Array) -> StepState:
        """Return the state in which solves start at given multipliers, until the next step."""
        accepted = replace(self.accepted, multipliers=multipliers, unknowns=self.unknowns)
        return replace(self, multipliers=multipliers, accepted=accepted, end=None, continues=False)

    def after_step(
        self, history: SlipHistory, displacement: fem.Function | None, **accepted: Any
    ) -> StepState:
        """Return the state after an accepted step; `accepted` are attributes of `AcceptedStep`."""
        accepted.setdefault("before", self.accepted.displacement)
        accepted.setdefault("motions", self.motions)
        step = replace(self.accepted, displacement=displacement, **accepted)
        after = replace(self, history=history, accepted=step, pending=False, dissipation=0.0)
        return after.started_at(self.multipliers)

    def after_solution(self, solution: StepSolution) -> StepState:
        """Return the state in which a solution is an accepted step. Not collective."""
        u = self.jump.system.displacement(solution.fields.w.copy(), solution.fields.w.name)
        return self.after_step(
            solution.history, u, configuration=self.configuration, motions=solution.motions
        )

    def acceptable(self, unconverged: bool) -> StepSolution:
        """Return the last solution, or raise an error if it cannot be accepted. Not collective."""
        if self.solution is None or not self.pending:
            raise ContactError(
                "there is no solution to accept: after each change of loads, call solve() first."
            )
        status = self.solution.status
        if status is not ContactStatus.CONVERGED and not unconverged:
            raise ConvergenceError(
                f"the last solve ended with {status.name}, and its errors would stay in all steps "
                "that follow: raise_if_failed() of its solution says what to do. accept("
                "unconverged=True) accepts the solution as it is."
            )
        return self.solution

    def with_status(self, status: ContactStatus) -> StepState:
        """Return the state in which the last solve, if any, ended with a status. Not collective."""
        solution = None if self.solution is None else replace(self.solution, status=status)
        return replace(self, solution=solution)

    def at_start(self, depends_on_start: bool) -> StepState:
        """Return the state from which the next solve of the user begins. Collective.

        If solutions depend on where their solve starts, it starts at the last accepted step;
        unknowns that the user has changed since the last solve stay. Otherwise, before the first
        step, or if a step goes on in another configuration, it starts where the last solve ended.
        """
        if not depends_on_start or not self.history.begun or self.continues:
            return replace(self, continues=False)
        end, unknowns = self.end, self.unknowns
        unchanged = end is not None and unknowns is not None and np.array_equal(end, unknowns)
        if self.jump.comm.allreduce(unchanged, op=MPI.LAND):
            unknowns = self.accepted.unknowns
        return replace(self, multipliers=self.accepted.multipliers, unknowns=unknowns)

    def with_tangents_of(self, jump: JumpOperator) -> StepState:
        """Return the state on a B with other tangents at the same nodes. Not collective."""
        carry = Carry(self.jump, jump)
        return self._on(jump, carry, origin=carry.jumps(self.history.origin))

    def paired_at(self, jump: JumpOperator, u: fem.Function, since_accepted: Mask) -> StepState:
        """Return the state on the B of surfaces displaced by u [length]. Collective.

        Of pairs in the mask `since_accepted` (pairs,), the slip origin becomes the tangential jump
        of the accepted displacement, between nodes and their present partners. Nodes of other pairs
        keep their slip T u - s of the former B, which determines the new origin s.
        """
        carry = Carry(self.jump, jump)
        kept_slip = carry.jumps(self.jump.of_displacement(u) - self.history.origin)
        origin_with_kept_slip = jump.of_displacement(u) - kept_slip
        origin = np.zeros(len(jump.gap))
        rows = jump.discs.tangential  # without those of bonded surfaces, where the origin is zero
        origin[rows] = origin_with_kept_slip[rows]
        u_0 = self.accepted.displacement
        accepted_jump = np.zeros_like(origin) if u_0 is None else jump.of_displacement(u_0)
        for counts_anew, own in zip(since_accepted, jump.own_rows, strict=True):
            if counts_anew and not own.operators.bonded:
                origin[own.tangential] = accepted_jump[own.tangential]
        return self._on(jump, carry, origin)

    def _on(self, jump: JumpOperator, carry: Carry, origin: Array) -> StepState:
        """Return the state on another B, with its slip origin, the same tractions, no solution."""
        accepted = carry.multipliers(self.accepted.multipliers)
        return replace(
            self,
            jump=jump,
            history=replace(self.history, origin=origin),
            multipliers=carry.multipliers(self.multipliers),
            accepted=replace(self.accepted, multipliers=accepted),
            continues=False,
            solution=None,
            pending=False,
        )
