"""Derivatives of goals of a solution by all controls, with one adjoint solve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.functions import with_owned_values
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.derivatives.data_of_solution import (
    Control,
    DataDerivatives,
    DataOfSolution,
    owned_size,
)
from dolfinx_tresca.derivatives.goals import WeightedGoals, weights_of
from dolfinx_tresca.errors import InputError, shown


def checked_controls(controls: Any) -> list[Control]:
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


def gradient(
    data: DataOfSolution,
    goals: WeightedGoals,
    controls: Sequence[Control],
    on_origin: Array | None = None,
    on_displacement: Array | None = None,
) -> tuple[list[Array], Array]:
    """Return the derivatives of a sum of goals, by one adjoint solve. Collective.

    The sum may contain further terms, of which only the derivatives `on_origin` and
    `on_displacement` are given. With the derivatives q_u and q_x of the sum with respect to u and
    to the multipliers, the derivatives with respect to the prescribed values are q_u - B'y - K z,
    and those with respect to the radii of slipping nodes are t'(q_x - B z), with the directions t
    of the tractions.

    The derivative with respect to the slip origin s is y, like the derivative with respect to the
    gap. A node that stuck in the previous load step keeps the s of this previous step; for any
    other node s is its tangential jump T u in the previous step. So y carries the derivatives of a
    step's goals back to the previous step.

    Args:
        data: the data of the solution.
        goals: pairs of a factor and a goal; a goal may be a form of rank 0 that depends on u.
        controls: the Constants and Functions.
        on_origin: (size,) derivatives of further terms with respect to the slip origin of the next
            step; None: zeros.
        on_displacement: derivatives of further terms with respect to the values of u that this rank
            owns; None: zeros.

    Returns:
        for each control the derivatives with respect to its values (for a Function, those that this
        rank owns); and (size,) the derivatives with respect to the slip origin of this step.

    Raises:
        InputError: the patch of a goal has no node, or a form does not depend on u; or the
            derivative with respect to a control is not known.
        ConvergenceError: the adjoint has no solution.
    """
    data.check_controls(controls)
    contact, jump, u = data.contact, data.contact.dual.jump, data.contact.u
    discs, sticks = contact.face.discs, contact.face.stick
    sticking, moving = np.zeros((2, discs.size), dtype=np.bool_)
    sticking[discs.tangential] = sticks[discs.node]
    moving[discs.tangential] = ~sticks[discs.node]
    on_origin = np.zeros(discs.size) if on_origin is None else on_origin
    by_next_step = np.where(moving, on_origin, 0.0)
    on_jump, on_x, on_u = by_next_step.copy(), np.zeros(discs.size), np.zeros(owned_size(u))
    if on_displacement is not None:
        on_u += on_displacement[: len(on_u)]
    for weight, goal in goals:
        if not isinstance(goal, ufl.Form):
            by_jump, by_x = weights_of(goal, jump, contact.multipliers)
            on_jump += weight * by_jump
            on_x += weight * by_x
        elif u in goal.coefficients():
            on_u += weight * data.derivative(goal, u)
        else:
            raise InputError(
                "the goal is a form that does not depend on the displacement of its solution: "
                "write it in terms of solution.u."
            )
    z, y = contact.adjoint(on_jump, on_x, np.where(jump.system.prescribed, 0.0, on_u))
    on_u += jump.whole_force(on_jump - y).array - data.reaction_of(z)
    on_radius = contact.face.radial_parts(on_x - jump.of_displacement(z))
    derivatives = DataDerivatives(goals, by_next_step, z, on_u, y, on_radius)
    by_controls = [data.pulled_back(control, derivatives) for control in controls]
    return by_controls, np.where(sticking, y + on_origin, np.where(moving, y, 0.0))


def as_derivatives(values: Sequence[Any], controls: Sequence[Control], comm: Any) -> list[Any]:
    """Return derivatives of `gradient` as arrays and Functions. Collective.

    Args:
        values: for each control the derivatives with respect to its values, or the number 0. If
            they are all zero, the log says so.
        controls: the Constants and Functions to which the derivatives belong.
        comm: communicator.

    Returns:
        for each Constant an array of its shape, for each Function a Function on its space.
    """
    result: list[Any] = []
    for control, derivatives in zip(controls, values, strict=True):
        if not comm.allreduce(bool(np.any(derivatives)), op=MPI.LOR):
            name = getattr(control, "name", control)
            log(comm, "gradient: no goal depends on the control %s: its derivative is zero", name)
        if isinstance(control, fem.Constant):
            result.append(np.array(np.broadcast_to(derivatives, control.ufl_shape)))
            continue
        values_of_control = np.broadcast_to(derivatives, owned_size(control))
        name = f"derivative by {control.name}"
        result.append(with_owned_values(control.function_space, values_of_control, name))
    return result
