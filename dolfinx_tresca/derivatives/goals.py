"""Goals, which are numbers computed from a solution, their errors, and derivatives.

The error of a goal is a(u - u_h, z - z_h) with the adjoint z (Becker and Rannacher, An optimal
control approach to a posteriori error estimation in finite element methods, 2001), plus a term from
nodes that change their state, which is not estimated. This term is of order h^2 for elements of any
degree: near the edge of a contact zone, y grows like r^(-1/2) with the distance r from the edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array, unit
from dolfinx_tresca._base.functions import owned_size, with_owned_values
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca._base.petsc import as_petsc
from dolfinx_tresca.derivatives.change_of_data import Control, DataOfSolution, DataVector, flat
from dolfinx_tresca.derivatives.linearised import ADJOINT_ACCURACY, LinearisedContact
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.pair import (
    ContactForce,
    Goal,
    MeanPressure,
    MeanSlip,
    NormalForce,
    PressureNorm,
)
from dolfinx_tresca.solution.fields import Surface

#: Goals of a solution, each with its factor in a sum; a goal may be a form of rank 0.
WeightedGoals: TypeAlias = "Sequence[tuple[float, Goal | ufl.Form]]"

#: Degree of the elements -> assumed relative error of the estimates of cells' squared energy
#: errors. With the errors e of the displacement and e' of the adjoint, the sum of a(e, e') over the
#: cells then has this uncertainty, relative to the sum of the products of their energy norms
#: (Prudhomme and Oden, On goal-oriented error estimation for elliptic problems, 1999). If doubled,
#: the estimate is above 5 times the error on twice as many meshes (benchmarks/README.md).
DOUBT = {1: 0.15, 2: 0.25}


def value_of(goal: Goal, x: Array, jump: JumpOperator, jump_of_u: Array) -> float:
    """Return the value of a goal for multipliers x (size,) and a jump B u (size,). Collective."""
    by_jump, by_x = derivatives_of(goal, jump, x)
    inner = jump.reductions.inner
    return float(inner(by_jump, jump_of_u) + inner(by_x, x))


def derivatives_of(goal: Goal, jump: JumpOperator, x: Array) -> tuple[Array, Array]:
    """Return the derivatives (size,) of a goal with respect to B u and to x. Collective.

    These are also the goal for `value_of`: all goals are homogeneous of degree 1 in B u and x
    together, so a goal is the sum of its derivatives times B u and x.
    """
    rows = jump.by_pair[goal.pair]
    # rows n and t of B, with the nodes i and j of the pair to which they belong
    pair, n, t = rows.operators, rows.normal, rows.tangential
    i, j = pair.normal_node, pair.tangent_node
    by_jump, by_x = np.zeros(len(jump.gap)), np.zeros(len(jump.gap))
    if isinstance(goal, NormalForce):
        by_x[n] = pair.weights[i]
    elif isinstance(goal, ContactForce):
        along = unit(np.array(goal.direction))
        # jumps are those of the secondary side, and B'x acts against them
        by_x[n] = -pair.weights[i] * (pair.normals[i] @ along)
        by_x[t] = -pair.weights[j] * (pair.tangents @ along)
    elif isinstance(goal, PressureNorm):
        # S^(1/m) with S = sum of w |p|^m has the derivatives w sign(p) |p|^(m-1) S^(1/m-1) by p
        pressure = (x * jump.stress_scale)[n]
        magnitude = np.abs(pressure)
        largest = float(reduce_array(jump.comm, magnitude.max(initial=0.0), MPI.MAX))
        # powers must not overflow; the derivative does not depend on the magnitude's unit
        magnitude /= largest or 1.0
        weights, m = pair.weights[i], goal.exponent
        whole = float(reduce_array(jump.comm, weights @ magnitude**m))  # S
        if whole > 0.0:
            by_pressure = np.sign(pressure) * magnitude ** (m - 1.0) * whole ** (1.0 / m - 1.0)
            by_x[n] = weights * by_pressure
    else:
        # the share of each node of the pair in the mean
        if isinstance(goal, MeanPressure):
            share = pair.weights * _means_of_bump(goal, jump.system.V, pair)
        else:
            share = pair.weights * _bump(goal, pair.places)
        whole = float(reduce_array(jump.comm, share.sum()))
        if whole == 0.0:
            raise InputError(
                f"the patch of the goal has no contact node: none of pair {goal.pair} is within "
                f"{goal.radius:.3g} of its point. Take a larger radius, or a finer mesh there."
            )
        share /= whole
        if isinstance(goal, MeanPressure):
            by_x[n] = share[i]
        if isinstance(goal, MeanSlip):
            by_jump[t] = share[j] * (pair.tangents @ unit(np.array(goal.direction)))
    return by_jump * jump.length_scale, by_x * jump.stress_scale


def _bump(goal: MeanPressure | MeanSlip, points: Array) -> Array:
    """Return the weight (n,) of a goal's patch at points (n, d): 1 at its centre, 0 outside."""
    away = np.linalg.norm(points - np.asarray(goal.point), axis=1) / goal.radius
    return np.asarray(np.maximum(1.0 - away**2, 0.0) ** 2)


def _means_of_bump(goal: MeanPressure, V: Any, pair: PairOperators) -> Array:
    """Return the mean (nodes,) of a patch's weight round each node of a pair. Collective.

    A multiplier is the mean of the pressure under its node's hat function. If the goal used the
    weight's values at the nodes, the error of this linear interpolation would exceed the
    discretisation error of elements of degree 2. With means by the multiplier basis, the error has
    a zero mean round each node.
    """
    index_map = V.dofmap.index_map
    matrix = as_petsc(index_map, 1, [pair.secondary], V.mesh.comm)
    values, means = matrix.createVecs()
    owned = V.tabulate_dof_coordinates()[: index_map.size_local, : V.mesh.geometry.dim]
    values.array = _bump(goal, owned)
    matrix.mult(values, means)
    return np.array(means.array)


@dataclass(frozen=True)
class GoalError:
    """The value of a goal in a solution, and an estimate of its discretisation error.

    Attributes:
        goal: the goal.
        value: value of the goal in the solution [unit of the goal].
        error: estimate of the discretisation error of the value [same unit]: the absolute value of
            `signed_error` plus, as its uncertainty, `DOUBT` times the sum of the squares of
            `cell_errors`. The estimate is not a bound. It is zero if the goal does not depend on
            the displacement to first order, as for the mean pressure on a patch without contact.
        signed_error: estimate of the exact value minus the value [same unit]: the sum over the
            cells of a(e, e') for the errors e of the displacement and e' of the adjoint.
        iteration_error: estimate, to first order, of the error of the value that the iteration's
            error causes [same unit]; the error of slip bounds that depend on the pressure,
            `ContactSolution.bound_error`, is not included.
        cell_errors: for each cell the root of the product of the energy norms of e and e' [root of
            the goal's unit], for `refine`. The sum of their squares has no cancellation of signs.
        adjoint: the adjoint displacement z; see `derivatives/linearised.py`.
        products: number of products with A for this estimate.

    Example:
        With the cube in the example of `ContactProblem`, whose stress is uniform:

        >>> from dolfinx_tresca import NormalForce
        >>> solution = problem.solve()
        >>> number = problem.goal_error(NormalForce())
        >>> f"{number.value:.3f} N", number.relative_error < 1e-6
        ('1.000 N', True)
    """

    goal: Goal
    value: float
    error: float
    signed_error: float
    iteration_error: float
    cell_errors: fem.Function
    adjoint: fem.Function
    products: int

    @property
    def corrected_value(self) -> float:
        """The value, corrected by the smallest error that agrees with the estimate.

        The correction is `signed_error`, shortened by its uncertainty, at most to zero. Where the
        corrected value differed from `value`, it was more accurate on 198 of 204 meshes
        (benchmarks/README.md, "Measured once"). `error` refers to `value`.
        """
        least = max(2.0 * abs(self.signed_error) - self.error, 0.0)
        return self.value + math.copysign(least, self.signed_error)

    @property
    def relative_error(self) -> float:
        """The error relative to the absolute value; infinite if the value is zero."""
        return self.error / abs(self.value) if self.value else float("inf")

    def __repr__(self) -> str:
        name = type(self.goal).__name__
        return f"<GoalError: {name} {self.value:.6g}, error about {self.error:.1e}>"


def goal_error(
    goal: Goal, linearised: LinearisedContact, u: fem.Function, energy_error: float
) -> GoalError:
    """Return the value and the estimated error of a goal, for some 10 products with A. Collective.

    The displacement u gives the value: unlike `linearised.u`, it contains the rigid motions of
    bodies that have turned. The `energy_error` [energy^(1/2)] is that of the iteration.
    """
    dual, jump, x = linearised.dual, linearised.dual.jump, linearised.multipliers
    products_before = dual.compliance.products
    by_jump, by_x = derivatives_of(goal, jump, x)
    z, _ = linearised.adjoint(by_jump, by_x, accuracy=ADJOINT_ACCURACY)
    estimator = dual.compliance.estimator
    error_products = estimator.products(linearised.u, z)
    # for each cell the root of the product of the errors of u and of z
    cells, errors_of_z = estimator.cell_errors(linearised.u), estimator.cell_errors(z)
    cells.x.array[:] = np.sqrt(cells.x.array * errors_of_z.x.array)
    own_cells = cells.x.array[: len(error_products)]
    unsigned, signed = reduce_array(jump.comm, [own_cells @ own_cells, error_products.sum()])
    degree = linearised.u.function_space.element.basix_element.degree
    return GoalError(
        goal=goal,
        value=value_of(goal, x, jump, jump.of_displacement(u)),
        error=abs(float(signed)) + DOUBT[degree] * float(unsigned),
        signed_error=float(signed),
        iteration_error=energy_error * dual.norm_of(z),
        cell_errors=cells,
        adjoint=z,
        products=dual.compliance.products - products_before,
    )


def checked_directions(controls: Sequence[Control], directions: Any) -> list[Any]:
    """Return the user's directions as a list: arrays for Constants, Functions for Functions.

    There must be one for each control, finite, with its shape or on its space. Not collective.
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
    by_origin: Array | None = None,
) -> tuple[list[Array], Array]:
    """Return the derivatives of a sum of goals, by one adjoint solve. Collective.

    With the derivatives q_u and q_x of the sum with respect to u and to the multipliers, the
    derivatives with respect to the prescribed values are q_u - B'y - K z, and those with respect to
    the radii of slipping nodes are t'(q_x - B z), with the directions t of the tractions.

    The derivative with respect to the slip origin s is y, like the derivative with respect to the
    gap. The s of the next step is that of this step at nodes that stick, and the tangential jump
    T u of this step at all others. So the derivatives of goals of later steps by the next s, which
    `ProcessTape` gives as `by_origin` (size,), are added to y at nodes that stick, else to q_u.

    The result has for each control the derivatives with respect to its values (for a Function,
    those that this rank owns), and the derivatives (size,) with respect to the s of this step.
    """
    linearised, u = data.linearised, data.linearised.u
    jump, inner = linearised.dual.jump, linearised.dual.inner
    discs, sticks = linearised.face.discs, linearised.face.stick
    by_origin = np.zeros(discs.size) if by_origin is None else by_origin
    by_next_origin = by_origin.copy()  # derivatives by those T u that are the next s
    row_sticks = sticks[discs.node]
    by_next_origin[discs.tangential[row_sticks]] = 0.0
    by_jump = by_next_origin.copy()
    by_x, by_u = np.zeros(discs.size), np.zeros(owned_size(u))
    for weight, goal in goals:
        if not isinstance(goal, ufl.Form):
            goal_by_jump, goal_by_x = derivatives_of(goal, jump, linearised.multipliers)
            by_jump += weight * goal_by_jump
            by_x += weight * goal_by_x
        elif u in goal.coefficients():
            by_u += weight * data.derivative(goal, u)
        else:
            raise InputError(
                "the goal is a form that does not depend on the displacement of its solution: "
                "write it in terms of solution.u."
            )
    linear, prescribed = jump.system, jump.system.prescribed
    z, y = linearised.adjoint(by_jump, by_x, np.where(prescribed, 0.0, by_u))
    # derivatives by the load are z; those by prescribed values are q_u - B'y - K z
    by_u += jump.whole_force(by_jump - y).array
    load = z.x.array[: len(by_u)].copy()
    load[prescribed] = by_u[prescribed] - linear.reactions_of(z.x.petsc_vec)
    by_radius = linearised.face.radial_parts(by_x - jump.of_displacement(z))
    derivatives = DataVector(load, np.append(y, by_radius))
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
        for k, along in enumerate(np.eye(len(values))):
            direction = along.reshape(control.ufl_shape)
            change = data.change([control], [direction])
            values[k] = inner(derivatives.load, change.load) + inner(derivatives.laws, change.laws)
            for weight, goal in goals:
                values[k] += weight * explicit_rate(data, goal, [control], [direction], change)
            for moved in change.jump_differences:  # T u itself, the next s, changes with B
                values[k] += float(inner(by_next_origin, moved.rate(moved.jumps)))
        by_controls.append(values.reshape(control.ufl_shape))
    by_own_origin = np.zeros(discs.size)
    by_own_origin[discs.tangential] = y[discs.tangential]
    return by_controls, by_own_origin + by_origin - by_next_origin


def explicit_rate(
    data: DataOfSolution,
    goal: Goal | ufl.Form,
    controls: Sequence[Control],
    directions: Sequence[Any],
    change: DataVector,
) -> float:
    """Return the derivative of a goal along directions, with u and x fixed. Collective.

    A form of rank 0 may depend on controls, and a goal such as a force depends on the position of
    obstacles through normals and tangents. The `change` is that of the data along the directions.
    """
    if isinstance(goal, ufl.Form):
        pairs = zip(controls, directions, strict=True)
        return float(sum(data.derivative(goal, *pair) for pair in pairs))
    x, rate = data.linearised.multipliers, 0.0
    for moved in change.jump_differences:
        sides = zip(moved.sides, moved.jumps, strict=True)
        rate += moved.rate([value_of(goal, x, side, jump_of_u) for side, jump_of_u in sides])
    return rate


def as_derivatives(
    values: Sequence[Any], controls: Sequence[Control], comm: Any, when: str = ""
) -> list[Any]:
    """Return each control's derivatives as an array of its shape, or as a Function. Collective.

    The values, of `gradient`, are one array for each control, or the number 0. If all derivatives
    by a control are zero, the log says so, with the words `when`, such as " in step 2".
    """
    result: list[Any] = []
    for control, derivatives in zip(controls, values, strict=True):
        if not comm.allreduce(bool(np.any(derivatives)), op=MPI.LOR):
            name = getattr(control, "name", control)
            text = "gradient: no goal depends on the control %s%s: its derivative is zero"
            log(comm, text, name, when)
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
        gap: change of the gap [length], positive if it opens; zero at pressed nodes.
        traction: change of the tangential traction [stress]; None without friction.
        slip: change of the slip [length], zero where surfaces stick; None without friction.
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
    """Return the change of a solution along directions of controls, summed. Collective.

    Each node keeps its contact state; see `linearised` for the equations.
    """
    linearised, dual = data.linearised, data.linearised.dual
    jump, x, linear = dual.jump, linearised.multipliers, dual.jump.system
    change = data.change(controls, directions)
    offset, radius = np.split(change.laws, [len(x)])
    # prescribed values are eliminated: their change causes the forces -K du_D in other rows
    pull = linear.forces_of(change.load[linear.prescribed]).array
    free_load = change.load - np.where(linear.prescribed, 0.0, pull)
    du, dx = linearised.tangent(free_load, offset, radius)
    jump_change = jump.of_displacement(du)
    # the gap is d - N u, and the slip T u - s, with the offsets d and s
    slip, stress = (jump_change - offset) * jump.length_scale, dx * jump.stress_scale

    def change_of(goal: Any) -> float:
        goal = data.checked_goal(goal)
        explicit = explicit_rate(data, goal, controls, directions, change)
        if isinstance(goal, ufl.Form):
            return explicit + float(data.derivative(goal, linearised.u, du))
        by_jump, by_x = derivatives_of(goal, jump, x)
        return explicit + float(dual.inner(by_jump, jump_change) + dual.inner(by_x, dx))

    r, result = linearised.gradient, []
    # where a control moves obstacles: for each difference, and each of its sides, the rows by pair
    displaced = [[side.by_pair for side in moved.sides] for moved in change.jump_differences]
    for number, (rows, surface) in enumerate(zip(jump.by_pair, surfaces, strict=True)):
        pair = rows.operators
        stresses, slips = rows.nodal_vectors(stress), rows.nodal_vectors(slip)  # (n, 1 + d)
        traction_change, slip_change = stresses[:, 1:], slips[:, 1:]
        for moved, by_side in zip(change.jump_differences, displaced, strict=True):
            # vectors of the present components turn with the tangents of B
            tractions, tangential_slips = [], []
            for side, by_pair in zip(moved.sides, by_side, strict=True):
                tractions.append(by_pair[number].nodal_vectors(x * side.stress_scale))
                tangential_slips.append(by_pair[number].nodal_vectors(-r * side.length_scale))
            traction_change = traction_change + moved.rate(tractions)[:, 1:]
            slip_change = slip_change + moved.rate(tangential_slips)[:, 1:]
        values = {"pressure": stresses[:, 0], "gap": -slips[:, 0]}
        if data.comm.allreduce(len(pair.tangent_node) > 0, op=MPI.LOR):
            values |= {"traction": traction_change, "slip": slip_change}
        fields = {name: surface.function(name, pair.nodes, v) for name, v in values.items()}
        result.append(SurfaceTangent(str(surface.pair), surface.mesh, **fields))
    return ContactTangent(du, tuple(result), change_of)
