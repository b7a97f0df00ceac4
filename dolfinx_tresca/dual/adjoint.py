"""The adjoint solution for a number that depends on the solution, at fixed contact states.

With the state of each node fixed (open nodes stay open, sticking nodes stick, slipping nodes move
along their circles, which grow with the pressure if the law says so) a solution obeys

    K u + B'x = f,    P (B u - C x) = constant,    dx = (I + Q) P dx,

with the projection P onto the face, the curvature C of the circles, and the slope of the bounds in
Q. For a number q_u'u + q_x'x the adjoint (z, y) obeys

    K z + B'y = q_u,    P (I + Q') (B z - C y) = P (I + Q') q_x,    y = P y.

Both systems are equal for Q = 0; bounds that follow the pressure make the equations unsymmetric.
The number changes by z'df with the load and by y'dd with the gaps d, and its error is
a(u - u_h, z - z_h) (Becker and Rannacher, An optimal control approach to a posteriori error
estimation in finite element methods, 2001), plus a term of order h^2, for any degree, from nodes
that change their state: y grows like r^(-1/2) towards the edge of a contact zone. If bodies float,
K z + B'y = q_u has a solution if y balances q_u as contact forces balance the load: the equations
of equilibrium (`floating/equilibrium.py`) with other values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ConvergenceError
from dolfinx_tresca.optimise.bfgs_model import NodalMaps
from dolfinx_tresca.optimise.feasible_set import Face
from dolfinx_tresca.optimise.reductions import norm

#: Relative error of y in the energy norm of the model of A; its square is the relative error of the
#: adjoint's energy. Relative residual that is rounding. Residual of equilibrium over the number's
#: weights above which no adjoint exists. Largest number of steps.
ADJOINT_ACCURACY, ROUNDING, UNMET, MOST_STEPS = 1e-3, 1e-10, 1e-6, 100

#: Error of each product by an iterative solver for K over the error that y may have, both in the
#: energy norm: some ten products may add up to it. (With the accuracy of the solver's options
#: derivatives of the two bricks, N = 16, took 2.6 s in place of 1.2 s; see
#: benchmarks/gradients.py.)
PRODUCT_SHARE = 0.03


@dataclass(frozen=True)
class LinearisedContact:
    """The contact state at which the problem is linearised.

    Attributes:
        face: states of the nodes.
        curvature: (size,) diagonal of C.
        with_bound_change_transpose: applies I + Q'.
    """

    face: Face
    curvature: Array
    with_bound_change_transpose: Callable[[Array], Array]

    @classmethod
    def of(cls, dual: DualProgram, x: Array, r: Array) -> LinearisedContact:
        """Return the state for multipliers x (size,) with gradient r (size,). Not collective."""
        lam = dual.admissible.section(x)
        face = lam.face(dual.decoupled_minimiser(x, r))
        return cls(
            face,
            lam.circle_stiffness(r, face),
            dual.admissible.with_bound_change_transpose(x, face),
        )

    def projected(self, v: Array) -> Array:
        """Return P (I + Q') v for (size,) or (size, columns). Not collective."""
        return self.face.project(self.with_bound_change_transpose(v))

    def maps(self, diagonal: Array) -> NodalMaps:
        """Return the maps with T = P (I + Q') and V = P. Not collective.

        Args:
            diagonal: (size,) D.
        """
        weight = 1.0 / (diagonal + self.curvature)
        return NodalMaps(
            test=self.projected,
            trial=self.face.project,
            stiffness=lambda v: np.asarray((self.curvature * v.T).T),
            projector=self.face.project,
            inverse=lambda v: np.asarray((weight * self.projected(v).T).T),
        )


def adjoint(
    dual: DualProgram,
    state: LinearisedContact,
    on_jump: Array,
    on_x: Array,
    accuracy: float = ADJOINT_ACCURACY,
    on_u: PETSc.Vec | None = None,
) -> tuple[fem.Function, Array]:
    """Return z and y (size,) for the number on_jump'B u + on_x'x + on_u'u. Collective.

    Products with A are kept for later solves.

    Args:
        dual: the problem.
        state: contact state at which the problem is linearised.
        on_jump: (size,) weights of B u.
        on_x: (size,) weights of x.
        accuracy: relative error of y in the energy norm.
        on_u: weights of the displacement, zero where it is prescribed; None: zeros.

    Raises:
        ConvergenceError: no adjoint exists.
    """
    size, constraints = norm(dual, on_jump), dual.constraints
    operator, rtol = dual.compliance.operator, PRODUCT_SHARE * accuracy
    product = operator.product(on_jump, rtol)[0] if size > 0.0 else np.zeros_like(on_jump)
    missing = dual.inner(constraints.columns, on_jump)
    solver, z = operator.solver, fem.Function(dual.jump.system.V, name="adjoint")
    u = z.x.petsc_vec
    if on_u is not None:
        solver.solve(on_u, u)
        product += dual.jump.of(u)
        if dual.equilibrium is not None:
            resultant, largest = dual.equilibrium.resultants(on_u)
            missing, size = missing + resultant, size + largest
    y, c = _solved(dual, state, state.projected(product - on_x), missing, accuracy)
    unmet = missing - dual.inner(constraints.columns, y) - constraints.softness @ c
    if size > 0.0 and np.linalg.norm(unmet) > UNMET * size:
        raise _none()
    force = dual.jump.contact_force(on_jump - y)
    if on_u is not None:
        force.axpy(1.0, on_u)
    solver.improve(force, u, rtol=rtol, accuracy=0.0)
    if dual.equilibrium is not None:
        dual.equilibrium.move(y, u, c)
    u.array[dual.jump.system.prescribed] = 0.0
    z.x.scatter_forward()
    return z, y


def _solved(
    dual: DualProgram,
    state: LinearisedContact,
    right: Array,
    missing: Array,
    accuracy: float,
) -> tuple[Array, Array]:
    """Return y = P y and c with P (I + Q') ((A + C) y - G c) = right, G'y + S c = missing.

    The method is GCR (minimal residuals), which needs no symmetry. Its preconditioner is the same
    system with the model of A from all known products, also from products of this call. The second
    equation therefore holds from the first step on. Products of small steps need less relative
    accuracy than products of large ones (inexact Krylov methods, Simoncini and Szyld 2003).
    Collective.

    Raises:
        ConvergenceError: no solution exists.
    """
    G, S = dual.constraints.columns, dual.constraints.softness
    model = dual.store.model()
    weight = 1.0 / (model.diagonal + state.curvature)
    found: Array = np.zeros(len(right) + len(missing))
    steps: Array = np.empty((len(found), 0))
    images: Array = np.empty((len(right), 0))
    residual = right
    root, wanted = np.sqrt(weight), 0.0
    whole = norm(dual, root * right)
    for count in range(MOST_STEPS):
        step_y, step_c = model.solve_between(state.maps(model.diagonal), residual, G, S, missing)
        step: Array = np.append(step_y, step_c)
        size = np.sqrt(max(float(dual.inner(step_y, model.apply(step_y))), 0.0))
        if count and (size <= wanted or norm(dual, root * residual) <= ROUNDING * whole):
            return step_y + found[: len(right)], step_c + found[len(right) :]
        rtol = PRODUCT_SHARE * (min(wanted / size, 1.0) if count else accuracy)
        product, error = dual.compliance.operator.product(step_y, rtol)
        dual.store.add(step_y, product, error)
        image = state.projected(product + state.curvature * step_y - G @ step_c)
        if count == 0:
            wanted, missing, length = accuracy * size, np.zeros_like(missing), 1.0
        else:
            before, known = norm(dual, root * image), dual.inner(images, weight * image)
            step, image = step - steps @ known, image - images @ known
            new = norm(dual, root * image)
            if new <= ROUNDING * before:  # the error of products, or there is no solution
                break
            step, image = 1.0 / new * step, 1.0 / new * image
            steps, images = np.column_stack([steps, step]), np.column_stack([images, image])
            length = float(dual.inner(image, weight * residual))
        found, residual = found + length * step, residual - length * image
        model = dual.store.model()
    if norm(dual, root * residual) > max(accuracy, ADJOINT_ACCURACY) * whole:
        raise _none()
    return found[: len(right)], found[len(right) :]


def _none() -> ConvergenceError:
    """Return the error to raise if no adjoint exists."""
    return ConvergenceError(
        "the number has no adjoint: with the contact state of each node fixed (open, sticking, "
        "slipping) nothing, or hardly anything, holds a body against the motion that the number "
        "depends on. Ask for another number, or refine for the energy error."
    )
