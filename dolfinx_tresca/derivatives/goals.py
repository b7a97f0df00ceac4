"""Goals: numbers computed from a solution, their derivatives, and their discretisation errors.

The error of a goal is a(u - u_h, z - z_h) with the adjoint z (Becker and Rannacher, An optimal
control approach to a posteriori error estimation in finite element methods, 2001), plus a term from
nodes that change their state, which is not estimated. This term is of order h^2 for elements of any
degree: at the distance r from the edge of a contact zone, y grows like r^(-1/2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.derivatives.linearised import ADJOINT_ACCURACY, LinearisedContact
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc
from dolfinx_tresca.scene.pair import (
    ContactForce,
    Goal,
    MeanPressure,
    MeanSlip,
    NormalForce,
    PressureNorm,
)

#: Goals of a solution, each with its factor in a sum; a goal may be a form of rank 0.
WeightedGoals: TypeAlias = "Sequence[tuple[float, Goal | ufl.Form]]"

#: Degree of the elements -> assumed relative error of the estimates of cells' squared energy
#: errors. Let e be the error of the displacement, and e' the error of the adjoint. By the
#: parallelogram identity the sum of a(e, e') over the cells then has this uncertainty, relative to
#: the sum of the products of the energy norms of e and e' (Prudhomme and Oden, On goal-oriented
#: error estimation for elliptic problems, 1999). If the numbers are doubled, the estimate is above
#: 5 times the error on twice as many meshes, and below 0.7 times the error on a third fewer meshes;
#: see "Measured once" in benchmarks/README.md.
DOUBT = {1: 0.15, 2: 0.25}


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
    return np.array(means.array)


def _unit(direction: object) -> Array:
    """Return a vector of length 1."""
    vector = np.asarray(direction, dtype=np.float64)
    return np.asarray(vector / np.linalg.norm(vector))


@dataclass(frozen=True)
class GoalError:
    """The value of a goal in a solution, and an estimate of its discretisation error.

    Attributes:
        goal: the goal.
        value: value of the goal in the solution [unit of the goal].
        error: estimate of the discretisation error of the value [same unit]: the absolute value of
            `signed_error` and, as its uncertainty, `DOUBT` times the sum of the squares of
            `cell_errors`. The estimate is not a bound. It is zero if the goal does not depend on
            the displacement to first order, as for the mean pressure on a patch that nothing
            touches.
        signed_error: estimate of the exact value minus the value [same unit]: the sum over the
            cells of a(e, e') for the errors e of the displacement and e' of the adjoint.
        iteration_error: estimate, to first order, of the error of the value that the iteration's
            error causes [same unit]; the error of slip bounds that depend on the pressure,
            `ContactSolution.bound_error`, is not included.
        cell_errors: for each cell the root of the product of the energy norms of e and e' [root of
            the goal's unit], for `refine`. The sum of their squares has no cancellation of signs.
        adjoint: the adjoint displacement z; see `derivatives/linearised.py`.
        products: number of applications of A for this estimate.

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

        The correction has the sign of `signed_error`. Its size is |signed_error| minus the
        uncertainty of `signed_error`, or zero if the uncertainty is larger. Where the
        corrected value differed from `value` it was more accurate on 198 of 204 meshes
        (benchmarks/README.md, "Measured once"). `error` refers to `value`.
        """
        least = max(2.0 * abs(self.signed_error) - self.error, 0.0)
        return self.value + math.copysign(least, self.signed_error)

    @property
    def relative_error(self) -> float:
        """The error relative to the absolute value; infinite if the value is zero."""
        return self.error / abs(self.value) if self.value else float("inf")

    def __repr__(self) -> str:
        return (
            f"<GoalError: {type(self.goal).__name__} {self.value:.6g}, error about "
            f"{self.error:.1e}>"
        )


def goal_error(
    goal: Goal,
    contact: LinearisedContact,
    u: fem.Function,
    energy_error: float,
) -> GoalError:
    """Return the value and the estimated error of a goal, for some 10 products with A. Collective.

    Args:
        goal: the goal.
        contact: the solution.
        u: displacement of the solution, with the rigid motions of bodies that have turned.
        energy_error: error of the iteration in the energy norm [energy^(1/2)].

    Raises:
        InputError: the patch of the goal has no node of the pair.
        ConvergenceError: the adjoint has no solution.
    """
    dual, jump, x = contact.dual, contact.dual.jump, contact.multipliers
    products_before = dual.operator.products
    on_jump, on_x = weights_of(goal, jump, x)
    z, _ = contact.adjoint(on_jump, on_x, accuracy=ADJOINT_ACCURACY)
    estimator = dual.compliance.estimator
    products = estimator.products(contact.u, z)
    cells, of_z = estimator.cell_errors(contact.u), estimator.cell_errors(z)
    cells.x.array[:] = np.sqrt(cells.x.array * of_z.x.array)
    own = cells.x.array[: len(products)]
    unsigned, signed = reduce_array(jump.comm, [own @ own, products.sum()])
    degree = contact.u.function_space.element.basix_element.degree
    return GoalError(
        goal=goal,
        value=value_of(goal, jump, x, jump.of_displacement(u)),
        error=abs(float(signed)) + DOUBT[degree] * float(unsigned),
        signed_error=float(signed),
        iteration_error=energy_error * dual.norm_of(z),
        cell_errors=cells,
        adjoint=z,
        products=dual.operator.products - products_before,
    )
