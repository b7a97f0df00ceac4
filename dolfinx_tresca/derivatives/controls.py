"""Controls: what users may give, and their values as one array for optimisers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.derivatives.change_of_data import owned_size
from dolfinx_tresca.errors import InputError, shown


def checked_controls(controls: Any) -> list[fem.Constant | fem.Function]:
    """Check that controls are a list of Constants and Functions, and return the list.

    Not collective.

    Args:
        controls: the user's argument, which may have any type.

    Raises:
        InputError: controls are not such a list.
    """
    if not isinstance(controls, Sequence):
        raise InputError(
            "controls must be a list of fem.Constant and fem.Function, such as [coefficient], "
            f"found {shown(controls)}."
        )
    for control in controls:
        if not isinstance(control, fem.Constant | fem.Function):
            raise InputError(
                f"a control must be a fem.Constant or a fem.Function, found {shown(control)}."
            )
    return list(controls)


def checked_directions(
    controls: Sequence[fem.Constant | fem.Function], directions: Any
) -> list[Any]:
    """Check changes of controls, and return them: arrays for Constants, or Functions.

    Not collective.

    Raises:
        InputError: there is not one direction of the right type for each control.
    """
    directions = list(directions) if isinstance(directions, Sequence) else [directions]
    if len(directions) != len(controls):
        raise InputError(
            f"directions must be a list with one for each control, found {len(directions)} for "
            f"{len(controls)} control(s)."
        )
    result = []
    for control, given in zip(controls, directions, strict=True):
        direction = given
        if isinstance(control, fem.Function):
            if (
                not isinstance(direction, fem.Function)
                or direction.function_space != control.function_space
            ):
                raise InputError(
                    f"the direction of the Function {control.name} must be a Function on its space,"
                    f" found {shown(direction)}."
                )
            values = direction.x.array
        else:
            direction = values = np.asarray(given, dtype=np.float64)
            if values.shape != control.ufl_shape:
                raise InputError(
                    f"the direction of a Constant must have its shape {control.ufl_shape}, found "
                    f"{shown(given)}."
                )
        if not np.isfinite(values).all():
            raise InputError(f"the direction of {shown(control)} is NaN or infinite.")
        result.append(direction)
    return result


class ControlVector:
    """The values of Constants and Functions as one array, the same on all ranks.

    Optimisers such as `scipy.optimize.minimize` take one array of numbers of similar size. The
    values of all controls follow each other, each divided by the scale of its control; values of a
    Function are in the global order of its degrees of freedom.

    Attributes:
        controls: the Constants and Functions.

    Example:
        A coefficient of friction as the only control, with values in units of 0.1:

        >>> from mpi4py import MPI
        >>> from dolfinx import fem, mesh
        >>> from dolfinx_tresca import ControlVector
        >>> square = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
        >>> coefficient = fem.Constant(square, 0.3)
        >>> vector = ControlVector([coefficient], scales=[0.1])
        >>> vector.values
        array([3.])
        >>> vector.values = [2.0]
        >>> float(coefficient.value)
        0.2
    """

    def __init__(
        self, controls: Sequence[fem.Constant | fem.Function], scales: Sequence[float] | None = None
    ) -> None:
        """Keep the controls. Not collective.

        Args:
            controls: Constants and Functions whose values the array holds.
            scales: a typical size of the values of each control [its unit]; None: 1 for all.

        Raises:
            InputError: controls are of another type, or scales are not one positive number for
                each control.
        """
        self.controls = checked_controls(controls)
        self._scales = np.ones(len(self.controls)) if scales is None else np.asarray(scales, float)
        if self._scales.shape != (len(self.controls),) or not (self._scales > 0.0).all():
            raise InputError(
                f"scales must be {len(self.controls)} positive numbers, one for each control, "
                f"found {shown(scales)}."
            )

    def __repr__(self) -> str:
        number = sum(_size(control) for control in self.controls)
        return f"<ControlVector: {len(self.controls)} control(s) with {number} values>"

    @property
    def values(self) -> Array:
        """(n,) the present values divided by their scales; can be assigned. Collective.

        Raises:
            InputError: an array of another shape is assigned.
        """
        values = [
            _gathered(control) / scale
            for control, scale in zip(self.controls, self._scales, strict=True)
        ]
        return np.concatenate([*values, np.zeros(0)])

    @values.setter
    def values(self, values: Any) -> None:
        values = np.asarray(values, dtype=np.float64)
        ends = np.cumsum([_size(control) for control in self.controls])
        if values.shape != (ends[-1],):
            raise InputError(f"the controls have {ends[-1]} values, found shape {values.shape}.")
        pieces = np.split(values, ends[:-1])
        for control, piece, scale in zip(self.controls, pieces, self._scales, strict=True):
            if isinstance(control, fem.Constant):
                control.value[...] = (scale * piece).reshape(control.ufl_shape)
            else:
                owned = owned_size(control)
                start = control.x.index_map.local_range[0] * control.x.block_size
                control.x.array[:owned] = scale * piece[start : start + owned]
                control.x.scatter_forward()

    @collective(comm_of("derivatives"))
    def packed(self, derivatives: Sequence[Any]) -> Array:
        """Return derivatives with respect to `values`, (n,): each times its control's scale.

        Collective.

        Args:
            derivatives: derivatives with respect to the controls, as `gradient` returns them.

        Raises:
            InputError: there is not one derivative for each control.
        """
        if len(derivatives) != len(self.controls):
            raise InputError(
                f"derivatives must be one for each of {len(self.controls)} control(s), found "
                f"{len(derivatives)}."
            )
        arrays = [
            scale * _gathered(derivative)
            for derivative, scale in zip(derivatives, self._scales, strict=True)
        ]
        return np.concatenate([*arrays, np.zeros(0)])


def _size(control: Any) -> int:
    """Return the number of values of a control on all ranks. Not collective."""
    if isinstance(control, fem.Constant):
        return int(control.value.size)
    return int(control.x.index_map.size_global * control.x.block_size)


def _gathered(values: Any) -> Array:
    """Return the values of a control or of a derivative, gathered from all ranks. Collective."""
    if isinstance(values, fem.Function):
        comm = values.function_space.mesh.comm
        return np.concatenate(comm.allgather(values.x.array[: owned_size(values)]))
    return np.ravel(values.value if isinstance(values, fem.Constant) else values).astype(np.float64)
