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
from dolfinx_tresca.derivatives.adjoint import tangent
from dolfinx_tresca.derivatives.goal_error import weights_of
from dolfinx_tresca.derivatives.gradient import Control, assembled
from dolfinx_tresca.derivatives.nodal_fields import nodal_fields
from dolfinx_tresca.derivatives.obstacle_differences import FindDifferences, ObstacleDifferences
from dolfinx_tresca.derivatives.prescribed import sources_of_prescribed
from dolfinx_tresca.derivatives.solved_step import SolvedStep
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.fields import Surface
from dolfinx_tresca.solution.forms import Forms


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


def checked_directions(controls: Sequence[Control], directions: Any) -> list[Any]:
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


def tangent_of(
    step: SolvedStep,
    pairs: Sequence[ContactPair],
    surfaces: Sequence[Surface],
    forms: Forms,
    values: NodalValues,
    controls: Sequence[Control],
    directions: Sequence[Any],
    find_differences: FindDifferences,
    checked_goal: Callable[[Any], Goal | ufl.Form],
) -> ContactTangent:
    """Return the change of a solution: two solves with K and some products with A. Collective.

    Each node keeps its contact state; see `derivatives/adjoint.py` for the equations.

    Args:
        step: the solution.
        pairs: the pairs of the problem.
        surfaces: secondary surfaces of the pairs.
        forms: forms and conditions of the bodies at the solution.
        values: object that evaluates fields of friction and gaps at the nodes of u.
        controls: Constants and Functions that change.
        directions: changes of the controls, see `checked_directions`.
        find_differences: function (Constant, direction) -> central differences of B for obstacles
            that the Constant moves.
        checked_goal: function (goal) -> the checked goal, for goals that users give to
            `ContactTangent.of`.

    Raises:
        InputError: the derivative with respect to a control is not known.
        ConvergenceError: the tangent has no solution.
    """
    dual, jump, u = step.dual, step.dual.jump, step.u
    V = u.function_space
    comm, prescribed = V.mesh.comm, jump.system.prescribed
    owned, test = len(prescribed), ufl.TestFunction(V)
    residual, force, moved = forms.residual(test), fem.Function(V), fem.Function(V)
    fields = nodal_fields(step, pairs)
    offset, radius = np.zeros(len(jump.gap)), np.zeros(len(step.state.face.discs.radius))
    apart = np.zeros(len(jump.gap))  # the part of `offset` by which gap and slip change
    turned: list[tuple[ObstacleDifferences, tuple[Array, Array]]] = []
    for control, direction in zip(controls, directions, strict=True):
        found = False
        jumps = None
        if isinstance(control, fem.Constant):
            jumps = find_differences(control, direction)
        if jumps is not None:
            found = True
            turned.append((jumps, jumps.of(u)))
            force.x.array[:owned] += jumps.force(step.multipliers)
            apart += jumps.offset(u)
            radius += jumps.radius(step.multipliers)
        change = _directional(residual, control, direction, V.mesh)
        if change is not None:
            found = True
            force.x.array[:owned] -= assembled(forms.compiled(change))[:owned]
        for one in fields:
            on_nodes = values.pushed_forward(one.field, control, direction, one.nodes, one.name)
            if on_nodes is not None:
                found = True
                offset += one.offset @ on_nodes
                radius += one.radius @ on_nodes
        source = sources_of_prescribed(forms.bcs, control, len(u.x.array))
        given = direction.x.array if isinstance(direction, fem.Function) else np.ravel(direction)
        moved.x.array[source >= 0] += given[source[source >= 0]]
        found |= bool(comm.allreduce(bool((source >= 0).any()), op=MPI.LOR))
        if not found:
            name = getattr(control, "name", control)
            log(comm, "tangent: nothing depends on the control %s", name)
    moved.x.scatter_forward()
    if comm.allreduce(bool(moved.x.array.any()), op=MPI.LOR):
        pulled = forms.compiled(ufl.action(forms.tangent, moved))
        force.x.array[:owned] -= assembled(pulled)[:owned]
    force.x.petsc_vec.array[prescribed] = moved.x.array[:owned][prescribed]

    for jumps, _ in turned:
        jumps.destroy()

    offset += apart
    normal = np.concatenate([np.arange(n.start, n.stop) for n, _ in jump.slices])
    apart[normal] = offset[normal]  # tangential offsets also contain the stretch by ellipses
    du, dx = tangent(dual, step.state, force.x.petsc_vec, offset, radius, step.accuracy)
    by_jump = jump.of_displacement(du)
    slip, stress = (by_jump - apart) * jump.length_scale, dx * jump.stress_scale

    def change_of(goal: Any) -> float:
        goal = checked_goal(goal)
        if not isinstance(goal, ufl.Form):
            on_jump, on_x = weights_of(goal, jump, step.multipliers)
            explicit = sum(jumps.goal(goal, step.multipliers, of_u) for jumps, of_u in turned)
            return float(dual.inner(on_jump, by_jump) + dual.inner(on_x, dx)) + explicit
        known = zip([u, *controls], [du, *directions], strict=True)
        changes = [_directional(goal, one, direction, V.mesh) for one, direction in known]
        return float(
            sum(
                comm.allreduce(fem.assemble_scalar(forms.compiled(one)), op=MPI.SUM)
                for one in changes
                if one is not None
            )
        )

    on_surfaces = []
    for k, (rows, surface) in enumerate(zip(jump.by_pair, surfaces, strict=True)):
        pair, n, t = rows.operators, rows.normal, rows.tangential
        pressure, gap = np.zeros((2, len(pair.nodes)))
        pressure[pair.normal_node], gap[pair.normal_node] = stress[n], -slip[n]
        has_friction = comm.allreduce(len(pair.tangent_node) > 0, op=MPI.LOR)
        vectors = [pair.tangential_vectors(parts[t]) for parts in (stress, slip)]
        for jumps, _ in turned:  # the tangents, along which components are measured, turn as well
            vectors[0] += jumps.traction(k, step.multipliers)
            vectors[1] += jumps.slip(k, -step.gradient)
        traction, slipped = (
            surface.function(name, pair.nodes, vector) if has_friction else None
            for name, vector in zip(("traction", "slip"), vectors, strict=True)
        )
        on_surfaces.append(
            SurfaceTangent(
                name=str(surface.pair),
                mesh=surface.mesh,
                pressure=surface.function("pressure", pair.nodes, pressure),
                traction=traction,
                slip=slipped,
                gap=surface.function("gap", pair.nodes, gap),
            )
        )
    return ContactTangent(du, tuple(on_surfaces), change_of)


def _directional(form: Any, control: Control, direction: Any, mesh: Any) -> Any:
    """Return the derivative of a form along a direction of a control. Collective.

    Args:
        form: a form of any rank.
        control: a Constant or a Function.
        direction: change of the control: values of a Constant, or a Function.
        mesh: the mesh of the form.

    Returns:
        a form of the same rank; None if the form does not depend on the control.
    """
    if control not in (*form.constants(), *form.coefficients()):
        return None
    if isinstance(control, fem.Function):
        return ufl.derivative(form, control, direction)
    # UFL differentiates with respect to Functions: take a Function with the control's value in all
    # cells
    space = fem.functionspace(mesh, ("DG", 0, control.ufl_shape))
    m, change = fem.Function(space), fem.Function(space)
    for one, values in ((m, control.value), (change, direction)):
        one.x.array[:] = np.tile(np.ravel(values), len(m.x.array) // np.size(values))
    return ufl.derivative(ufl.replace(form, {control: m}), m, change)
