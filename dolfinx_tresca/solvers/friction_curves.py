"""Coefficients of friction that depend on the pressure and on the slip. Numpy only.

All functions are local to a rank.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from dolfinx_tresca._base.arrays import Array


class Curve(Protocol):
    """A coefficient of friction as a function of pressure and slip."""

    def values(self, pressure: Array, slip: Array) -> Array:
        """Return F (n,) at pressures (n,) [stress] and slips (n,) [length]."""

    def slopes(self, pressure: Array, slip: Array) -> tuple[Array, Array]:
        """Return dF/dp (n,) [1 / stress] and dF/dv (n,) [1 / length]."""


#: A curve with the pressures (n,) [stress] and slips (n,) [length] of its nodes.
CurveAtNodes: TypeAlias = tuple[Curve, Array, Array]


def pressed_values(
    curve: Curve, pressure: Array, slip: Array, points: Array | None = None
) -> Array:
    """Return F (n,) at nodes under pressure and 0 at open nodes, where F may be infinite.

    Args:
        curve: the coefficient of friction.
        pressure: (n,) pressures [stress].
        slip: (n,) slips [length].
        points: positions of the nodes, on which F does not depend.
    """
    with np.errstate(all="ignore"):
        return np.where(pressure > 0.0, curve.values(pressure, slip), 0.0)


@dataclass(frozen=True)
class NodalCurves:
    """The curves of all discs, as functions of multipliers and their gradient.

    A multiplier is a stress times the root of its node's area, and a component of the gradient is
    a length times the same root.

    Attributes:
        parts: for each curve the range of its discs, and the curve.
        root: (n_discs,) root of the node's area.
    """

    parts: Sequence[tuple[slice, Curve]]
    root: Array

    def coefficients(self, others: Array, pressure: Array, slip: Array) -> Array:
        """Return F (n_discs,): values of the curves, and `others` for discs without a curve.

        Values that are negative or not finite become zero: iterates may have pressures and slips
        far from those of the solution. The values at the solution are checked afterwards.

        Args:
            others: (n_discs,) coefficients of discs without a curve.
            pressure: (n_discs,) normal multiplier.
            slip: (n_discs,) norm of the tangential gradient.
        """
        (result,) = self._of(lambda curve, p, v: (curve.values(p, v),), (others,), pressure, slip)
        return np.maximum(result, 0.0)

    def slopes(self, pressure: Array, slip: Array) -> tuple[Array, Array]:
        """Return dF/dp and dF/dv (n_discs,), zero for discs without a curve."""
        none = np.zeros_like(self.root)
        by_pressure, by_slip = self._of(
            lambda curve, p, v: curve.slopes(p, v), (none, none), pressure, slip
        )
        return by_pressure / self.root, by_slip / self.root

    def arguments(self, pressure: Array, slip: Array) -> list[CurveAtNodes]:
        """Return each curve with pressures (n,) [stress] and slips (n,) [length] of its nodes."""
        p, v = np.maximum(pressure, 0.0) / self.root, slip / self.root
        return [(curve, p[part], v[part]) for part, curve in self.parts]

    def _of(
        self,
        evaluate: Callable[[Curve, Array, Array], tuple[Array, ...]],
        others: tuple[Array, ...],
        pressure: Array,
        slip: Array,
    ) -> list[Array]:
        """Evaluate the curves of discs; discs without a curve keep their values in `others`.

        `evaluate` is a function (curve, pressures, slips) -> arrays. Values that are not finite
        become zero.
        """
        result = [one.copy() for one in others]
        arguments = self.arguments(pressure, slip)
        with np.errstate(all="ignore"):
            for (part, _), (curve, p, v) in zip(self.parts, arguments, strict=True):
                found = evaluate(curve, p, v)
                for target, values in zip(result, found, strict=True):
                    target[part] = np.where(np.isfinite(values), values, 0.0)
        return result
