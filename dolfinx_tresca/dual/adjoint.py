"""What a number that depends on the solution asks of the bodies: the adjoint of the contact state.

With the state of each node fixed (what is open stays open, what sticks sticks, what slips moves
along its circle) a solution obeys K u + B'x = f and P B u = C x + constant, with P of the face and
the curvature C of the circles. For a number q_u'u + q_x'x the adjoint (z, y) obeys the same
equations,

    K z + B'y = q_u,    P B z - C y = P q_x,    y = P y,

since they are symmetric, and the error of the number is a(u - u_h, z - z_h), but for nodes that
change their state, which is of higher order (Becker and Rannacher, An optimal control approach to a
posteriori error estimation in finite element methods, 2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.optimise.feasible_set import Face, FeasibleSet

#: Residual of the conjugate gradients for y, in the norm of the preconditioner and relative, and
#: the most steps. Squares of it are what the adjoint's energy lacks.
ADJOINT_ACCURACY, MOST_STEPS = 1e-3, 200


@dataclass(frozen=True)
class LinearisedContact:
    """What is fixed where the problem is linearised.

    Attributes:
        feasible_set: Lambda.
        face: of the nodes.
        curvature: (size,) diagonal of C.
    """

    feasible_set: FeasibleSet
    face: Face
    curvature: Array

    @classmethod
    def of(cls, dual: DualProgram, x: Array, r: Array) -> LinearisedContact:
        """Return it for multipliers x (size,) with the gradient r (size,). Not collective."""
        lam = dual.feasible_set
        face = lam.face(dual.by_itself(x, r))
        return cls(lam, face, lam.circle_stiffness(r, face))


def adjoint(
    dual: DualProgram, state: LinearisedContact, on_jump: Array, on_x: Array
) -> fem.Function:
    """Return z for the number on_jump'B u + on_x'x. Collective.

    Products with A are kept for later solves.

    Args:
        dual: the problem, without floating bodies, and with slip bounds that stay.
        state: where to linearise.
        on_jump: (size,).
        on_x: (size,).
    """
    moves = float(dual.inner(on_jump, on_jump)) > 0.0
    product = dual.apply(on_jump) if moves else np.zeros_like(on_jump)
    y = _solved(dual, state, state.face.project(product - on_x))
    z = fem.Function(dual.jump.system.V, name="adjoint")
    solver = dual.compliance.operator.solver
    solver.solve(dual.jump.contact_force(on_jump - y), z.x.petsc_vec)
    z.x.petsc_vec.array[dual.jump.system.prescribed] = 0.0
    z.x.scatter_forward()
    return z


def _solved(dual: DualProgram, state: LinearisedContact, right: Array) -> Array:
    """Return y with P (A + C) y = right, y = P y, by preconditioned conjugate gradients.

    The preconditioner is the inverse of the same with the model of A from all known products.
    """
    project = state.face.project
    model, constraints = dual.store.model(), dual.constraints
    following = state.feasible_set.following(right, state.face)

    def preconditioned(v: Array) -> Array:
        step, _ = model.solve_on(
            state.face,
            state.curvature,
            v,
            constraints.columns,
            constraints.softness,
            constraints.values,
            following,
        )
        return project(step)

    y, residual = np.zeros_like(right), right
    ahead = preconditioned(residual)
    direction, square = ahead, float(dual.inner(residual, ahead))
    wanted = ADJOINT_ACCURACY**2 * square
    for _ in range(MOST_STEPS):
        if square <= wanted:
            break
        image = dual.apply(direction)
        energy = max(float(dual.inner(direction, image)), 0.0)
        dual.store.add(direction, image, dual.product_error * float(np.sqrt(energy)))
        image = project(image + state.curvature * direction)
        length = square / float(dual.inner(direction, image))
        y, residual = y + length * direction, residual - length * image
        ahead = preconditioned(residual)
        square, before = float(dual.inner(residual, ahead)), square
        direction = ahead + square / before * direction
    return y
