"""What load steps that were accepted leave to the next one: where its slip counts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.jump import JumpOperator


@dataclass(frozen=True)
class SlipHistory:
    """The slip at the end of the last load step, and what has been dissipated until then.

    Friction dissipates: in a quasi-static process it resists the slip of each step, T u - s with
    the slip s of the last one (NUMERICS section 6). Implicit in time, as backward Euler.

    Attributes:
        origin: (size,) s over `JumpOperator.scale`; zero in normal rows, and where surfaces are
            bonded.
        dissipation: of all steps [energy].
        begun: whether there was one; else slips are total, the law of a single static solve.
    """

    origin: Array
    dissipation: float = 0.0
    begun: bool = False

    @classmethod
    def none(cls, jump: JumpOperator) -> SlipHistory:
        """Return that of bodies at rest. Not collective."""
        return cls(np.zeros(len(jump.scale)))

    @classmethod
    def from_displacement(cls, jump: JumpOperator, u: fem.Function) -> SlipHistory:
        """Return one that begins with the tangential jump of a displacement. Collective."""
        slip, rubs = jump.of(u.x.petsc_vec), jump.unbounded.tangential
        origin = np.zeros_like(slip)
        origin[rubs] = slip[rubs]
        return cls(origin, begun=True)

    def after(self, slip: Array, dissipation: float) -> SlipHistory:
        """Return what it is after another step. Not collective.

        Args:
            slip: (size,) of the step over `JumpOperator.scale`, exactly zero where nodes stick:
                what the iteration has left there would add up from step to step.
            dissipation: of the step [energy].
        """
        return SlipHistory(self.origin + slip, self.dissipation + dissipation, begun=True)
