"""Slip and dissipation of the accepted load steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.jump import JumpOperator


@dataclass(frozen=True)
class SlipHistory:
    """The slip and the dissipation of the accepted load steps.

    In a quasi-static process, friction resists the slip T u - s of each step, where s is the slip
    origin, and dissipates energy (docs/theory/problem.md). This formulation is implicit in time,
    like the backward Euler method.

    Attributes:
        origin: (size,) s, the tangential jump at which the slip of the step is zero, divided by
            `JumpOperator.length_scale`; zero in normal rows, and where surfaces are bonded.
        slipped: for each pair an array (owned nodes of V, d + 1) with the sum of the slip vectors
            of all steps, and the sum of their lengths [length]. Nodes that have no partner at
            present keep their values.
        dissipation: dissipation of all steps [energy].
        begun: whether a step was accepted; if not, slips count from the undeformed bodies, as in a
            static problem.
    """

    origin: Array
    slipped: tuple[Array, ...]
    dissipation: float = 0.0
    begun: bool = False

    @classmethod
    def none(cls, jump: JumpOperator) -> SlipHistory:
        """Return the history of undeformed bodies. Not collective."""
        V = jump.system.V
        shape = V.dofmap.index_map.size_local, V.mesh.geometry.dim + 1
        return cls(np.zeros(len(jump.gap)), tuple(np.zeros(shape) for _ in jump.pairs))

    @classmethod
    def from_displacement(cls, jump: JumpOperator, u: fem.Function) -> SlipHistory:
        """Return the history whose slip is the tangential jump of a displacement. Collective."""
        slip = jump.of_displacement(u) * jump.length_scale
        steps = []
        for pair, (_, t) in zip(jump.pairs, jump.slices, strict=True):
            vectors = pair.tangential_vectors(np.zeros_like(slip[t]) if pair.bonded else slip[t])
            steps.append(np.column_stack([vectors, np.linalg.norm(vectors, axis=1)]))
        return cls.from_slip(jump, steps, 0.0)

    @classmethod
    def from_slip(
        cls, jump: JumpOperator, slips: Sequence[Array], dissipation: float
    ) -> SlipHistory:
        """Return the history of a single accepted step with given slips. Not collective.

        Args:
            jump: B.
            slips: for each pair (n, d + 1) the slip vectors at its nodes and the lengths of their
                paths [length].
            dissipation: dissipation so far [energy].
        """
        origin = np.zeros(len(jump.gap))
        for pair, slip, (_, t) in zip(jump.pairs, slips, jump.slices, strict=True):
            vectors = slip[pair.tangent_node, :-1]
            origin[t] = np.einsum("ri,ri->r", vectors, pair.tangents) / jump.length_scale[t]
        return cls.none(jump).after(jump, origin, slips, dissipation)

    def after(
        self, jump: JumpOperator, slip: Array, steps: Sequence[Array], dissipation: float
    ) -> SlipHistory:
        """Return the history after a further load step. Not collective.

        Args:
            jump: B.
            slip: (size,) slip of the step, divided by `JumpOperator.length_scale`; exactly zero at
                sticking nodes, since residuals of the iteration would add up over the steps.
            steps: for each pair (n, d + 1) the slip vectors of the step at its nodes, and the
                increments of their slip paths [length].
            dissipation: dissipation of the step [energy].
        """
        slipped = []
        for before, step, pair in zip(self.slipped, steps, jump.pairs, strict=True):
            after = before.copy()
            after[pair.nodes] = before[pair.nodes] + step
            slipped.append(after)
        return replace(
            self,
            origin=self.origin + slip,
            slipped=tuple(slipped),
            dissipation=self.dissipation + dissipation,
            begun=True,
        )
