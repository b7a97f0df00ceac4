"""Friction laws."""

from __future__ import annotations

import numbers
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx import fem

from dolfinx_tresca._parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError

#: A scalar on the contact surface. A `fem.Constant` or `fem.Function` may be changed in place.
ScalarField: TypeAlias = "float | fem.Constant | fem.Function | Callable[[Any], Any]"


@dataclass(frozen=True)
class Tresca:
    """Tresca friction: the norm of the tangential traction is at most `slip_bound`.

    The bound does not depend on the contact pressure. In particular nodes that are out of contact
    are dragged too, as (38.3) has it for every node: set the bound to zero where nothing should
    rub.

    Attributes:
        slip_bound: g >= 0 [stress]: a number, a scalar `fem.Constant`, a scalar `fem.Function` on
            the mesh of the problem (taken at the nodes), or a function of points, x of shape
            (3, n) -> (n,), as in `fem.Function.interpolate`. Where it is infinite nothing slips.
    """

    slip_bound: ScalarField

    def __post_init__(self) -> None:
        """Check the kind of bound.

        Raises:
            InputError: it is no scalar, or a number that is negative or NaN.
        """
        shape: tuple[int, ...]
        if isinstance(self.slip_bound, fem.Function):
            shape = tuple(self.slip_bound.ufl_shape)
        elif isinstance(self.slip_bound, fem.Constant):
            shape = tuple(self.slip_bound.value.shape)
        elif callable(self.slip_bound):
            return
        else:
            shape = np.shape(self.slip_bound)
            if shape == () and not isinstance(self.slip_bound, numbers.Real):
                raise InputError(f"the slip bound must be a number, found {self.slip_bound!r}.")
            if shape == () and not float(self.slip_bound) >= 0.0:
                raise InputError(f"the slip bound must not be negative, found {self.slip_bound:g}.")
        if shape != ():
            raise InputError(
                f"the slip bound must be a scalar, found shape {shape}. For a bound that varies "
                "give a scalar fem.Function or a function of points."
            )

    def __str__(self) -> str:
        bound = self.slip_bound
        if isinstance(bound, fem.Function):
            text = f"Function '{bound.name}'"
        elif isinstance(bound, fem.Constant):
            text = f"Constant, now {float(bound.value):g}"
        else:
            text = "a function of points" if callable(bound) else f"{bound:g}"
        return f"slip bound {text}"


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
        """Make the scalar space that goes with V. Collective."""
        scalar, dofs = V.sub(0).collapse()
        self._field = fem.Function(scalar)
        # for each node of V its degree of freedom in the scalar space; 0.11 gives a list of arrays
        dofs = np.asarray(dofs, dtype=np.int64).ravel() // V.dofmap.index_map_bs
        self._position = np.empty(len(dofs), dtype=np.int32)
        self._position[dofs] = np.arange(len(dofs))

    def at(self, friction: Friction, nodes: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Return the bound [stress] at nodes of this rank, as it is now; 0 without. Collective.

        Raises:
            InputError: a value is negative or NaN, or the bound lives on another mesh.
        """
        if not isinstance(friction, Tresca):
            return np.zeros(len(nodes))
        mesh = self._field.function_space.mesh
        with errors_on_all_ranks(mesh.comm):
            values = self._evaluate(friction.slip_bound, nodes)
            bad = ~(values >= 0.0)
            if bad.any():
                raise InputError(
                    f"the slip bound must not be negative, found {values[bad][0]:g} "
                    f"at {bad.sum()} of the {len(nodes)} contact nodes of rank {mesh.comm.rank}."
                )
        return values

    def _evaluate(
        self, bound: ScalarField, nodes: npt.NDArray[np.int32]
    ) -> npt.NDArray[np.float64]:
        if isinstance(bound, fem.Function):
            if bound.function_space.mesh != self._field.function_space.mesh:
                raise InputError("the slip bound is a Function on another mesh than the problem's.")
            if bound.function_space.element.basix_element.discontinuous:
                raise InputError(
                    "the slip bound is a discontinuous Function, which has no value at a node "
                    "where it jumps: interpolate it into a continuous space first."
                )
        elif isinstance(bound, fem.Constant):
            return np.full(len(nodes), float(bound.value))
        elif not callable(bound):
            return np.full(len(nodes), float(bound))
        self._field.interpolate(bound)
        values: npt.NDArray[np.float64] = self._field.x.array[self._position[nodes]]
        return values
