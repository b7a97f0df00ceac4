"""Goals: numbers computed from a solution, as functions of jumps and multipliers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import ufl

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc
from dolfinx_tresca.scene.goal import (
    ContactForce,
    Goal,
    MeanPressure,
    MeanSlip,
    NormalForce,
    PressureNorm,
    checked_goal,
)

#: Goals of a solution, each with its factor in a sum; a goal may be a form of rank 0.
WeightedGoals: TypeAlias = "Sequence[tuple[float, Goal | ufl.Form]]"


def checked_form_or_goal(goal: Any, pairs: int, V: Any) -> Goal | ufl.Form:
    """Check a goal that is to be differentiated, and return it. Not collective.

    Args:
        goal: the user's argument, which may have any type.
        pairs: number of pairs of the problem.
        V: the space of the displacement.

    Raises:
        InputError: the argument is neither a goal of this problem nor a form of rank 0.
    """
    if not isinstance(goal, ufl.Form):
        return checked_goal(goal, pairs, V.mesh.geometry.dim)
    if goal.arguments():
        raise InputError("the goal is a form with arguments: a number is a form of rank 0.")
    return goal


def value_of(goal: Goal, jump: JumpOperator, x: Array, jump_of_u: Array) -> float:
    """Return the value of a goal for multipliers x (size,) and a jump B u (size,). Collective.

    Raises:
        InputError: the patch of the goal has no node of the pair.
    """
    on_jump, on_x = weights_of(goal, jump, x)
    inner = jump.reductions.inner
    return float(inner(on_jump, jump_of_u) + inner(on_x, x))


def weights_of(goal: Goal, jump: JumpOperator, x: Array) -> tuple[Array, Array]:
    """Return the derivatives (size,) of a goal with respect to B u and to x. Collective.

    Since all goals are homogeneous of degree 1 in the jumps B u and the multipliers x, a goal is
    the sum of its derivatives times B u and x.

    Raises:
        InputError: see `value_of`.
    """
    rows = jump.by_pair[goal.pair]
    pair, n, t = rows.operators, rows.normal, rows.tangential
    i, j = pair.normal_node, pair.tangent_node
    on_jump, on_x = np.zeros(len(jump.gap)), np.zeros(len(jump.gap))
    if isinstance(goal, NormalForce):
        on_x[n] = pair.weights[i]
    elif isinstance(goal, ContactForce):
        along = _unit(goal.direction)
        on_x[n] = -pair.weights[i] * (pair.normals[i] @ along)
        on_x[t] = -pair.weights[j] * (pair.tangents @ along)
    elif isinstance(goal, PressureNorm):
        pressure = (x * jump.stress_scale)[n]
        size = np.abs(pressure)
        largest = float(reduce_array(jump.comm, size.max(initial=0.0), MPI.MAX))
        size /= largest or 1.0  # so that its powers do not overflow
        weights, m = pair.weights[i], goal.exponent
        whole = float(reduce_array(jump.comm, weights @ size**m))
        if whole > 0.0:
            on_x[n] = weights * np.sign(pressure) * size ** (m - 1.0) * whole ** (1.0 / m - 1.0)
    else:
        share = pair.weights * (
            _means_of_bump(goal, jump.system.V, pair)
            if isinstance(goal, MeanPressure)
            else _bump(goal, pair.places)
        )
        whole = float(reduce_array(jump.comm, share.sum()))
        if whole == 0.0:
            raise InputError(
                f"the patch of the goal has no contact node: none of pair {goal.pair} is within "
                f"{goal.radius:.3g} of its point. Take a larger radius, or a finer mesh there."
            )
        share /= whole
        if isinstance(goal, MeanPressure):
            on_x[n] = share[i]
        if isinstance(goal, MeanSlip):
            on_jump[t] = share[j] * (pair.tangents @ _unit(goal.direction))
    return on_jump * jump.length_scale, on_x * jump.stress_scale


def _bump(goal: MeanPressure | MeanSlip, points: Array) -> Array:
    """Return the weight (n,) of a goal's patch at points (n, d): 1 at its centre, 0 outside."""
    away = np.linalg.norm(points - np.asarray(goal.point), axis=1) / goal.radius
    return np.asarray(np.maximum(1.0 - away**2, 0.0) ** 2)


def _means_of_bump(goal: MeanPressure, V: Any, pair: PairOperators) -> Array:
    """Return the mean (nodes,) of a patch's weight round each node of a pair. Collective.

    A multiplier is the mean of the pressure under its node's hat function. If the goal used the
    values of the weight at the nodes, the weight would be linear between nodes, and the error of
    this interpolation would exceed the discretisation error of elements of degree 2. With means by
    the multiplier basis, the difference between the linear weight and the patch's weight has a zero
    mean round each node.
    """
    index_map = V.dofmap.index_map
    matrix = as_petsc(index_map, 1, [pair.secondary], V.mesh.comm)
    values, means = matrix.createVecs()
    owned = V.tabulate_dof_coordinates()[: index_map.size_local, : V.mesh.geometry.dim]
    values.array = _bump(goal, owned)
    matrix.mult(values, means)
    result = np.array(means.array)
    for owned_object in (matrix, values, means):
        owned_object.destroy()
    return result


def _unit(direction: object) -> Array:
    """Return a vector of length 1."""
    vector = np.asarray(direction, dtype=np.float64)
    return np.asarray(vector / np.linalg.norm(vector))
