"""Derivatives of goals with respect to controls, by one adjoint solve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.derivatives.change_of_data import (
    Control,
    DataOfSolution,
    DataVector,
    owned_size,
)
from dolfinx_tresca.derivatives.goals import WeightedGoals, weights_of
from dolfinx_tresca.errors import InputError


def derivatives_by_data(
    data: DataOfSolution,
    goals: WeightedGoals,
    on_jump: Array,
    on_displacement: Array | None = None,
) -> DataVector:
    """Return the derivatives of a sum of goals with respect to the data. Collective.

    The sum may contain further terms, of which only the derivatives `on_jump` and `on_displacement`
    are given. With the derivatives q_u and q_x of the sum with respect to u and to the multipliers,
    the derivatives with respect to the prescribed values are q_u - B'y - K z, and those with
    respect to the radii of slipping nodes are t'(q_x - B z), with the directions t of the
    tractions.

    Args:
        data: the data of the solution.
        goals: pairs of a factor and a goal; a goal may be a form of rank 0 that depends on u.
        on_jump: (size,) derivatives of further terms with respect to B u.
        on_displacement: derivatives of further terms with respect to the values of u that this rank
            owns; None: zeros.

    Raises:
        InputError: the patch of a goal has no node, or a form does not depend on u.
        ConvergenceError: the adjoint has no solution.
    """
    contact, jump, u = data.contact, data.contact.dual.jump, data.contact.u
    owned, by_u = owned_size(u), fem.Function(u.function_space)
    on_jump, on_x = on_jump.copy(), np.zeros_like(on_jump)
    if on_displacement is not None:
        by_u.x.array[:owned] = on_displacement[:owned]
    for weight, goal in goals:
        if isinstance(goal, ufl.Form):
            by_values = data.by_values(goal, u)
            if by_values is None:
                raise InputError(
                    "the goal is a form that does not depend on the displacement of its solution: "
                    "write it in terms of solution.u."
                )
            by_u.x.array[:owned] += weight * by_values
        else:
            by_jump, by_x = weights_of(goal, jump, contact.multipliers)
            on_jump += weight * by_jump
            on_x += weight * by_x
    prescribed = by_u.copy()
    by_u.x.petsc_vec.array[jump.system.prescribed] = 0.0
    z, y = contact.adjoint(on_jump, on_x, by_u.x.petsc_vec)
    prescribed.x.array[:owned] += jump.whole_force(on_jump - y).array - data.reaction_of(z)
    radius = contact.face.radial_parts(on_x - jump.of_displacement(z))
    return DataVector(z, prescribed, y, radius)


def gradient(
    data: DataOfSolution,
    goals: WeightedGoals,
    controls: Sequence[Control],
    on_origin: Array | None = None,
    on_displacement: Array | None = None,
) -> tuple[list[Any], Array]:
    """Return the derivatives of a sum of goals, by one adjoint solve. Collective.

    The derivative with respect to the slip origin s is y, like the derivative with respect to the
    gap. A node that stuck in the previous load step keeps the s of this previous step; for any
    other node s is its tangential jump T u in the previous step. So y carries the derivatives of a
    step's goals back to the previous step.

    Args:
        data: the data of the solution.
        goals: see `derivatives_by_data`.
        controls: the Constants and Functions.
        on_origin: (size,) derivatives of further terms with respect to the slip origin of the next
            step; None: zeros.
        on_displacement: see `derivatives_by_data`.

    Returns:
        for each control the derivatives with respect to its values (for a Function, those that this
        rank owns), or None if nothing depends on the control; and (size,) the derivatives with
        respect to the slip origin of this step.

    Raises:
        InputError: the patch of a goal has no node, or a form does not depend on u; or the
            derivative with respect to a control is not known.
        ConvergenceError: the adjoint has no solution.
    """
    discs, sticks = data.contact.face.discs, data.contact.face.stick
    sticking, other_rows = np.zeros((2, discs.size), dtype=np.bool_)
    sticking[discs.tangential] = sticks[discs.node]
    other_rows[discs.tangential] = ~sticks[discs.node]
    if on_origin is None:
        on_origin = np.zeros(discs.size)
    on_jump = np.where(other_rows, on_origin, 0.0)
    derivatives = derivatives_by_data(data, goals, on_jump, on_displacement)
    y = derivatives.offset
    by_controls = [
        _by_function(data, derivatives, goals, control)
        if isinstance(control, fem.Function)
        else _by_constant(data, derivatives, goals, on_jump, control)
        for control in controls
    ]
    return by_controls, np.where(sticking, y + on_origin, np.where(other_rows, y, 0.0))


def _by_function(
    data: DataOfSolution, derivatives: DataVector, goals: WeightedGoals, control: fem.Function
) -> Array | None:
    result = data.pulled_back(control, derivatives)
    for weight, goal in goals:
        explicit = data.by_values(goal, control) if isinstance(goal, ufl.Form) else None
        if explicit is not None:
            result = weight * explicit + (0.0 if result is None else result)
    return result


def _by_constant(
    data: DataOfSolution,
    derivatives: DataVector,
    goals: WeightedGoals,
    on_jump: Array,
    control: fem.Constant,
) -> Array | None:
    inner, depends = data.contact.dual.inner, False
    result = np.zeros(control.value.size)
    for k, unit in enumerate(np.eye(result.size)):
        direction = unit.reshape(control.ufl_shape)
        change, (data_depend,) = data.change([control], [direction])
        rates = [data.explicit_rate(goal, [control], [direction], change) for _, goal in goals]
        depends |= data_depend or any(rate is not None for rate in rates)
        result[k] = derivatives.inner(change, inner)
        for rows in change.moved:  # the jumps of this step, from which the next step's slip counts
            result[k] += float(inner(on_jump, rows.rate(lambda _, jump_of_u: jump_of_u)))
        result[k] += sum(
            weight * (rate or 0.0) for (weight, _), rate in zip(goals, rates, strict=True)
        )
    return result.reshape(control.ufl_shape) if depends else None


def as_derivatives(values: Sequence[Any], controls: Sequence[Control], comm: Any) -> list[Any]:
    """Return derivatives of `gradient` as arrays and Functions. Collective.

    Args:
        values: for each control the derivatives with respect to its values; None: nothing depends
            on the control, and the log says so.
        controls: the Constants and Functions to which the derivatives belong.
        comm: communicator.

    Returns:
        for each Constant an array of its shape, for each Function a Function on its space.
    """
    result: list[Any] = []
    for control, derivatives in zip(controls, values, strict=True):
        if derivatives is None:
            name = getattr(control, "name", control)
            log(comm, "gradient: nothing depends on the control %s: its derivative is zero", name)
        by_values = 0.0 if derivatives is None else derivatives
        if isinstance(control, fem.Constant):
            result.append(np.array(np.broadcast_to(by_values, control.ufl_shape)))
            continue
        function = fem.Function(control.function_space, name=f"derivative by {control.name}")
        function.x.array[: owned_size(control)] = by_values
        function.x.scatter_forward()
        result.append(function)
    return result
