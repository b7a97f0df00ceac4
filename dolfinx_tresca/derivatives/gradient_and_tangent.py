"""Derivatives of a solution: of a goal by all controls, or of all fields in one direction.

The gradient is one adjoint solve, multiplied with the changes of the data by each control; the
tangent is one solve with the change of the data in the given direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.functions import with_owned_values
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.derivatives.change_of_data import (
    Control,
    DataOfSolution,
    DataVector,
    flat,
    owned_size,
)
from dolfinx_tresca.derivatives.goals import WeightedGoals, weights_of
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.pair import Goal
from dolfinx_tresca.solution.fields import Surface


def checked_directions(controls: Sequence[Control], directions: Any) -> list[Any]:
    """Check changes of controls, and return them: arrays for Constants, or Functions.

    Not collective.

    Raises:
        InputError: there is not one direction of the right type for each control.
    """
    result = list(directions) if isinstance(directions, Sequence) else [directions]
    if len(result) != len(controls):
        raise InputError(
            f"directions must be a list with one for each control, found {len(result)} for "
            f"{len(controls)} control(s)."
        )
    for k, (control, direction) in enumerate(zip(controls, result, strict=True)):
        if isinstance(control, fem.Function):
            kind = f"the Function {control.name} must be a Function on its space"
            fits = getattr(direction, "function_space", None) == control.function_space
        else:
            result[k] = np.asarray(direction, dtype=np.float64)
            kind = f"a Constant must have its shape {control.ufl_shape}"
            fits = result[k].shape == control.ufl_shape
        if not fits:
            raise InputError(f"the direction of {kind}, found {shown(direction)}.")
        if not np.isfinite(flat(result[k])).all():
            raise InputError(f"the direction of {shown(control)} is NaN or infinite.")
    return result


def gradient(
    data: DataOfSolution,
    goals: WeightedGoals,
    controls: Sequence[Control],
    on_origin: Array | None = None,
) -> tuple[list[Array], Array]:
    """Return the derivatives of a sum of goals, by one adjoint solve. Collective.

    The sum may contain further terms, of which only the derivatives `on_origin` are given. With the
    derivatives q_u and q_x of the sum with respect to u and to the multipliers, the derivatives
    with respect to the prescribed values are q_u - B'y - K z, and those with respect to the radii
    of slipping nodes are t'(q_x - B z), with the directions t of the tractions.

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

    Returns:
        for each control the derivatives with respect to its values (for a Function, those that this
        rank owns); and (size,) the derivatives with respect to the slip origin of this step.

    Raises:
        InputError: the patch of a goal has no node, or a form does not depend on u; or the
            derivative with respect to a control is not known.
        ConvergenceError: the adjoint has no solution.
    """
    contact, jump, u = data.contact, data.contact.dual.jump, data.contact.u
    discs, sticks, inner = contact.face.discs, contact.face.stick, contact.dual.inner
    on_origin = np.zeros(discs.size) if on_origin is None else on_origin
    by_next_step = on_origin.copy()  # of nodes that do not stick
    by_next_step[discs.tangential[sticks[discs.node]]] = 0.0
    on_jump, on_x, on_u = by_next_step.copy(), np.zeros(discs.size), np.zeros(owned_size(u))
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
    linear = jump.system
    z, y = contact.adjoint(on_jump, on_x, np.where(linear.prescribed, 0.0, on_u))
    on_u += jump.whole_force(on_jump - y).array
    load = z.x.array[: len(on_u)].copy()
    load[linear.prescribed] = on_u[linear.prescribed] - linear.reactions_of(z.x.petsc_vec)
    on_radius = contact.face.radial_parts(on_x - jump.of_displacement(z))
    derivatives = DataVector(load, np.append(y, on_radius))
    by_controls = []
    for control in controls:
        if isinstance(control, fem.Function):
            values = data.pulled_back(control, derivatives)
            for weight, goal in goals:
                if isinstance(goal, ufl.Form):
                    values += weight * data.derivative(goal, control)
            by_controls.append(values)
            continue
        values = np.zeros(control.value.size)
        for k, unit in enumerate(np.eye(len(values))):
            direction = unit.reshape(control.ufl_shape)
            change = data.change([control], [direction])
            values[k] = inner(derivatives.load, change.load) + inner(derivatives.laws, change.laws)
            for weight, goal in goals:
                values[k] += weight * data.explicit_rate(goal, [control], [direction], change)
            for rows in change.moved:  # jumps of this step, from which the next step's slip counts
                values[k] += float(inner(by_next_step, rows.rate(lambda _, jump_of_u: jump_of_u)))
        by_controls.append(values.reshape(control.ufl_shape))
    on_slip = np.zeros(discs.size)
    on_slip[discs.tangential] = y[discs.tangential]
    return by_controls, on_slip + on_origin - by_next_step


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


@dataclass(frozen=True)
class SurfaceTangent:
    """Changes of fields on the secondary surface of a pair; see `SurfaceFields` for the fields.

    The units are those of the fields, since a direction is a change of the controls in their units.

    Attributes:
        name: name of the pair.
        mesh: the mesh of the surface.
        pressure: change of the contact pressure [stress].
        gap: change of the gap [length], zero at pressed nodes.
        traction: change of the tangential traction [stress]; None without friction.
        slip: change of the slip [length], zero where friction holds the surfaces; None without
            friction.
    """

    name: str
    mesh: Any
    pressure: fem.Function
    gap: fem.Function
    traction: fem.Function | None = None
    slip: fem.Function | None = None

    def __repr__(self) -> str:
        return f"<SurfaceTangent of {self.name}>"


@dataclass(frozen=True)
class ContactTangent:
    """The change of a solution along a direction of the controls, to first order.

    `ContactProblem.tangent` returns this object.

    Attributes:
        u: change of the displacement [length].
        surfaces: changes of the fields on each pair's secondary surface.
    """

    u: fem.Function
    surfaces: tuple[SurfaceTangent, ...]
    _of: Callable[[Goal | ufl.Form], float] = field(repr=False)

    def __repr__(self) -> str:
        return f"<ContactTangent of {len(self.surfaces)} pair(s)>"

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self.u.function_space.mesh.comm

    @collective(comm_of_self)
    def of(self, goal: Goal | ufl.Form) -> float:
        """Return the directional derivative of a goal. Collective.

        The result equals the derivatives of `ContactProblem.gradient` times the direction.

        Args:
            goal: see `ContactProblem.gradient`.

        Raises:
            InputError: the goal does not suit this problem.
        """
        return self._of(goal)


def tangent_of(
    data: DataOfSolution,
    surfaces: Sequence[Surface],
    controls: Sequence[Control],
    directions: Sequence[Any],
) -> ContactTangent:
    """Return the change of a solution: two solves with K and some products with A. Collective.

    Each node keeps its contact state; see `linearised` for the equations.

    Args:
        data: the data of the solution.
        surfaces: secondary surfaces of the pairs.
        controls: Constants and Functions that change.
        directions: changes of the controls, see `checked_directions`.

    Raises:
        InputError: the derivative with respect to a control is not known.
        ConvergenceError: the tangent has no solution.
    """
    contact, dual, jump = data.contact, data.contact.dual, data.contact.dual.jump
    x, linear = contact.multipliers, jump.system
    change = data.change(controls, directions)
    offset, radius = np.split(change.laws, [len(x)])
    pull = linear.forces_of(change.load[linear.prescribed]).array
    force = change.load - np.where(linear.prescribed, 0.0, pull)
    du, dx = contact.tangent(force, offset, radius)
    jump_change = jump.of_displacement(du)
    # gap and slip count from the offsets
    slip = (jump_change - offset) * jump.length_scale
    stress = dx * jump.stress_scale

    def change_of(goal: Any) -> float:
        goal = data.checked_goal(goal)
        explicit = data.explicit_rate(goal, controls, directions, change)
        if isinstance(goal, ufl.Form):
            return explicit + float(data.derivative(goal, contact.u, du))
        on_jump, on_x = weights_of(goal, jump, x)
        return explicit + float(dual.inner(on_jump, jump_change) + dual.inner(on_x, dx))

    def vectors(side: JumpOperator, stress: Array, slip: Array) -> Array:
        """Return tractions and slips (2, n, d) at the nodes of all pairs, pair by pair."""
        columns = [
            [rows.operators.tangential_vectors(values[rows.tangential]) for rows in side.by_pair]
            for values in (stress, slip)
        ]
        return np.stack([np.concatenate(column) for column in columns])

    def present(side: JumpOperator, _: Array) -> Array:
        return vectors(side, x * side.stress_scale, -contact.gradient * side.length_scale)

    changes = vectors(jump, stress, slip)
    for moved in change.moved:
        changes += moved.rate(present)
    by_pair, result = jump.by_pair, []
    ends = np.cumsum([len(rows.operators.nodes) for rows in by_pair])[:-1]
    of_pairs = np.split(changes, ends, axis=1)
    for rows, surface, tangential in zip(by_pair, surfaces, of_pairs, strict=True):
        pair = rows.operators
        pressure, gap = np.zeros((2, len(pair.nodes)))
        pressure[pair.normal_node], gap[pair.normal_node] = stress[rows.normal], -slip[rows.normal]
        values = {"pressure": pressure, "gap": gap}
        if data.comm.allreduce(len(pair.tangent_node) > 0, op=MPI.LOR):
            values |= dict(zip(("traction", "slip"), tangential, strict=True))
        fields = {name: surface.function(name, pair.nodes, v) for name, v in values.items()}
        result.append(SurfaceTangent(str(surface.pair), surface.mesh, **fields))
    return ContactTangent(du, tuple(result), change_of)
