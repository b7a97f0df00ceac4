"""Friction laws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.slip_bound import (
    NodalValues,
    ScalarField,
    check_slip_bound,
    slip_bound_text,
)

#: Negative part of the largest finite slip bound of a pair that is rounding, and means zero.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Tresca:
    """Tresca friction: the norm of the tangential traction is at most `slip_bound`.

    The bound does not depend on the contact pressure. In particular nodes that are out of contact
    are dragged too, as (38.3) has it for every node: set the bound to zero where nothing should
    rub.

    Attributes:
        slip_bound: g >= 0 [stress], on the mesh of the problem: a number; a scalar `fem.Constant`,
            `fem.Function` or UFL expression of those (or `fem.Expression`), all continuous, whose
            values at the nodes count; or a function of points, x of shape (3, n) -> a number or
            (n,), called with the contact nodes. What these depend on may be changed in place
            before each solve. Where g is infinite nothing slips; where it is negative by less than
            1e-12 of the largest finite one of the pair, by rounding, it is zero.
    """

    slip_bound: ScalarField

    def __post_init__(self) -> None:
        """Check the kind of bound.

        Raises:
            InputError: it is no real scalar, has no value at nodes, or is a number that is negative
                or NaN.
        """
        check_slip_bound(self.slip_bound)

    def __str__(self) -> str:
        return f"slip bound {slip_bound_text(self.slip_bound)}"


@dataclass(frozen=True)
class Frictionless:
    """No friction: a multiplier for the pressure, none for tangential traction."""

    def __str__(self) -> str:
        return "no friction"


@dataclass(frozen=True)
class Bonded:
    """Surfaces that are tied to each other: no jump in any direction, and no inequality.

    An initial gap stays as it is. The pressure may be negative: tension.
    """

    def __str__(self) -> str:
        return "bonded"


#: What may happen between two surfaces.
Friction: TypeAlias = "Tresca | Frictionless | Bonded"


class SlipBounds:
    """Takes slip bounds at nodes of a vector space."""

    def __init__(self, V: Any) -> None:
        """Keep the space of the displacements."""
        self._comm = V.mesh.comm
        self._values = NodalValues(V)

    def check(self, friction: Friction, nodes: npt.NDArray[np.int32]) -> None:
        """Check that there are values at nodes of this rank, whatever they are now. Collective.

        Raises:
            InputError: the bound lives on another mesh, or a function returns something else than
                a number, or one number for each point.
        """
        if isinstance(friction, Tresca):
            self._values.at(friction.slip_bound, nodes)

    def at(self, friction: Friction, nodes: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return the bound [stress] at nodes of this rank, as it is now; 0 without. Collective.

        Raises:
            InputError: a value is negative by more than rounding, or NaN; or see `check`.
        """
        if not isinstance(friction, Tresca):
            return np.zeros(len(nodes))
        values = self._values.at(friction.slip_bound, nodes)
        largest = values[np.isfinite(values)].max(initial=0.0)
        zero = -ROUNDING * self._comm.allreduce(float(largest), op=MPI.MAX)
        with errors_on_all_ranks(self._comm):
            bad = ~(values >= zero)
            if bad.any():
                raise InputError(
                    f"the slip bound must not be negative, found {values[bad][0]:g} "
                    f"at {bad.sum()} of the {len(nodes)} contact nodes of rank {self._comm.rank}."
                )
        result: npt.NDArray[np.float64] = np.maximum(values, 0.0)
        return result
