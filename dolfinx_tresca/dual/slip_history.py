"""Slip and dissipation of the accepted load steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import carried_over


@dataclass(frozen=True)
class SlipHistory:
    """The slip at the end of the last load step, and what has been dissipated until then.

    Friction dissipates: in a quasi-static process it resists the slip of each step, T u - s with
    the slip s of the last one (docs/theory/problem.md). Implicit in time, as backward Euler.

    Attributes:
        origin: (size,) s over `JumpOperator.length_scale`; zero in normal rows, and where surfaces
            are bonded.
        dissipation: dissipation of all steps [energy].
        obstacles: (size,) tangential displacement of rigid obstacles under the nodes over
            `JumpOperator.length_scale`, from the first step to the present one; zero in normal rows
            and between deformable bodies. The slip is T u minus it.
        begun: whether a step was accepted; if not, slips are total, as in a static problem.
    """

    origin: Array
    obstacles: Array
    dissipation: float = 0.0
    begun: bool = False

    @classmethod
    def none(cls, jump: JumpOperator) -> SlipHistory:
        """Return the history of undeformed bodies. Not collective."""
        return cls(np.zeros(len(jump.gap)), np.zeros(len(jump.gap)))

    @property
    def offset(self) -> Array:
        """(size,) tangential jump at which the slip of the step is zero, over the same scale."""
        return self.origin + self.obstacles

    @classmethod
    def from_displacement(cls, jump: JumpOperator, u: fem.Function) -> SlipHistory:
        """Return the history whose slip is the tangential jump of a displacement. Collective."""
        slip, rubs = jump.of_displacement(u), jump.unbounded.tangential
        origin = np.zeros_like(slip)
        origin[rubs] = slip[rubs]
        return cls(origin, np.zeros_like(origin), begun=True)

    def turned(self, jump: JumpOperator, before: JumpOperator) -> SlipHistory:
        """Return the history for a B with other tangents. Not collective."""
        origin, obstacles = (
            jump.turned(one * before.length_scale, before) / jump.length_scale
            for one in (self.origin, self.obstacles)
        )
        return replace(self, origin=origin, obstacles=obstacles)

    def carried_over(
        self, u: fem.Function, before: JumpOperator, jump: JumpOperator
    ) -> SlipHistory:
        """Return the history for displaced surfaces, with the same slip of the step. Collective.

        Args:
            u: displacement at which B changes [length].
            before: the previous B.
            jump: the new B.
        """
        since = (before.of_displacement(u) - self.offset) * before.length_scale
        kept, obstacles = (
            carried_over(one, before, jump) / jump.length_scale
            for one in (since, self.obstacles * before.length_scale)
        )
        rubs = jump.unbounded.tangential
        origin = np.zeros(len(jump.gap))
        origin[rubs] = (jump.of_displacement(u) - kept - obstacles)[rubs]
        return replace(self, origin=origin, obstacles=obstacles)

    def measured_from(
        self, u: fem.Function | None, jump: JumpOperator, finite: Sequence[bool] | Mask
    ) -> SlipHistory:
        """Return the history with the slip of some pairs measured from a displacement. Collective.

        Args:
            u: displacement of the last accepted step [length]; None: the undeformed state.
            jump: B.
            finite: for each pair whether its slip is measured from u.
        """
        at_start = np.zeros_like(self.origin) if u is None else jump.of_displacement(u)
        origin, obstacles = self.origin.copy(), self.obstacles.copy()
        rubs = jump.unbounded.tangential
        measured = np.zeros(len(origin), dtype=np.bool_)
        for far, (_, tangential) in zip(finite, jump.slices, strict=True):
            measured[tangential] = far
        rows = rubs[measured[rubs]]
        origin[rows], obstacles[rows] = at_start[rows], 0.0
        return replace(self, origin=origin, obstacles=obstacles)

    def with_moved_obstacles(self, displacement: Array) -> SlipHistory:
        """Return the history for obstacles that move in the step. Not collective.

        Args:
            displacement: (size,) tangential displacement of the obstacles under the nodes since the
                last accepted step, over `JumpOperator.length_scale`; zero in normal rows.
        """
        return replace(self, obstacles=self.obstacles + displacement)

    def after(self, slip: Array, dissipation: float) -> SlipHistory:
        """Return the history after a further load step. Not collective.

        Args:
            slip: (size,) slip of the step over `JumpOperator.length_scale`, exactly zero at
                sticking nodes: residuals of the iteration would add up over the steps.
            dissipation: dissipation of the step [energy].
        """
        return replace(
            self,
            origin=self.origin + slip,
            dissipation=self.dissipation + dissipation,
            begun=True,
        )
