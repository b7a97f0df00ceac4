"""The derivative of a solution in a direction of controls, such as loads, moduli or gaps."""

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
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.derivatives.change_of_data import Control, DataOfSolution, owned_size
from dolfinx_tresca.derivatives.goals import weights_of
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.solution.fields import Surface


@dataclass(frozen=True)
class SurfaceTangent:
    """Changes of fields on the secondary surface of a pair; see `SurfaceFields` for the fields.

    The units are those of the fields, since a direction is a change of the controls in their units.

    Attributes:
        name: name of the pair.
        mesh: the mesh of the surface.
        pressure: change of the contact pressure [stress].
        traction: change of the tangential traction [stress]; None without friction.
        slip: change of the slip [length], zero where friction holds the surfaces; None without
            friction.
        gap: change of the gap [length], zero at pressed nodes.
    """

    name: str
    mesh: Any
    pressure: fem.Function
    traction: fem.Function | None
    slip: fem.Function | None
    gap: fem.Function

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
    checked_goal: Callable[[Any], Goal | ufl.Form],
) -> ContactTangent:
    """Return the change of a solution: two solves with K and some products with A. Collective.

    Each node keeps its contact state; see `linearised` for the equations.

    Args:
        data: the data of the solution.
        surfaces: secondary surfaces of the pairs.
        controls: Constants and Functions that change.
        directions: changes of the controls, see `checked_directions`.
        checked_goal: function (goal) -> the checked goal, for goals that users give to
            `ContactTangent.of`.

    Raises:
        InputError: the derivative with respect to a control is not known.
        ConvergenceError: the tangent has no solution.
    """
    contact, dual, jump = data.contact, data.contact.dual, data.contact.dual.jump
    x, comm, prescribed = contact.multipliers, data.comm, jump.system.prescribed
    change, depends = data.change(controls, directions)
    for control, is_input in zip(controls, depends, strict=True):
        if not is_input:
            log(
                comm,
                "tangent: nothing depends on the control %s",
                getattr(control, "name", control),
            )
    force, owned = change.force.x.petsc_vec, owned_size(contact.u)
    if comm.allreduce(bool(change.prescribed.x.array.any()), op=MPI.LOR):
        force.array -= data.pull_of(change.prescribed)
    force.array[prescribed] = change.prescribed.x.array[:owned][prescribed]
    du, dx = contact.tangent(force, change.offset, change.radius)
    jump_change = jump.of_displacement(du)
    # gap and slip count from offsets, but not from those that stretch the rows of ellipses
    apart = sum((rows.offset for rows in change.moved), np.zeros_like(dx))
    for normal, _ in jump.slices:
        apart[normal] = change.offset[normal]
    slip, stress = (jump_change - apart) * jump.length_scale, dx * jump.stress_scale

    def change_of(goal: Any) -> float:
        goal = checked_goal(goal)
        explicit = data.explicit_rate(goal, controls, directions, change) or 0.0
        if isinstance(goal, ufl.Form):
            return explicit + (data.explicit_rate(goal, [contact.u], [du], change) or 0.0)
        on_jump, on_x = weights_of(goal, jump, x)
        return explicit + float(dual.inner(on_jump, jump_change) + dual.inner(on_x, dx))

    def turned(k: int, values: Array, scale: str) -> Array:
        """Return the change of a pair's tangential vectors (n, d) with the tangents of its rows."""

        def vectors(operator: JumpOperator, _: Array) -> Array:
            rows = operator.by_pair[k]
            components = values * getattr(operator, scale)
            return rows.operators.tangential_vectors(components[rows.tangential])

        return np.asarray(sum(moved.rate(vectors) for moved in change.moved))

    result = []
    for k, (rows, surface) in enumerate(zip(jump.by_pair, surfaces, strict=True)):
        pair, friction = rows.operators, {}
        pressure, gap = np.zeros((2, len(pair.nodes)))
        pressure[pair.normal_node], gap[pair.normal_node] = stress[rows.normal], -slip[rows.normal]
        for name, components, values, scale in (
            ("traction", stress, x, "stress_scale"),
            ("slip", slip, -contact.gradient, "length_scale"),
        ):
            vectors = pair.tangential_vectors(components[rows.tangential])
            vectors = vectors + turned(k, values, scale)
            friction[name] = surface.function(name, pair.nodes, vectors)
        has_friction = comm.allreduce(len(pair.tangent_node) > 0, op=MPI.LOR)
        result.append(
            SurfaceTangent(
                name=str(surface.pair),
                mesh=surface.mesh,
                pressure=surface.function("pressure", pair.nodes, pressure),
                traction=friction["traction"] if has_friction else None,
                slip=friction["slip"] if has_friction else None,
                gap=surface.function("gap", pair.nodes, gap),
            )
        )
    return ContactTangent(du, tuple(result), change_of)
