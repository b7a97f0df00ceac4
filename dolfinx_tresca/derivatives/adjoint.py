"""Tangent and adjoint of a solution at fixed contact states.

With the state of each node fixed (open nodes stay open, sticking nodes stick, slipping nodes move
along their circles, which grow with the pressure if the law says so), a solution with the
displacement u and the multipliers x obeys

    K u + B'x = f,    P (B u - C x) = constant,    dx = (I + Q) P dx,

where P projects onto the face, C is the curvature of the circles, and Q contains the slope of the
slip bounds. Let the load change by df, the offsets (d; s) (gaps and slip origins) by do, and the
radii of the circles by dg. With the unit vectors n along the multipliers on the circles, the
tangent (du, dx) obeys

    K du + B'dx = df,    P (B du - C dx) = P do,    dx = (I + Q) P dx + n dg.

For a goal q_u'u + q_x'x, the adjoint (z, y) obeys

    K z + B'y = q_u,    P (I + Q') (B z - C y) = P (I + Q') q_x,    y = P y.

For Q = 0, both systems have the same matrix; slip bounds that follow the pressure make it
unsymmetric. The goal changes by z'df + y'do + (q_x - B z)'n dg. Its discretisation error is
a(u - u_h, z - z_h) (Becker and Rannacher, An optimal control approach to a posteriori error
estimation in finite element methods, 2001), plus a term from nodes that change their state. This
term is of order h^2 for elements of any degree: at the distance r from the edge of a contact zone,
y grows like r^(-1/2). If bodies float, K z + B'y = q_u has a solution only if y balances q_u in the
way in which contact forces balance the load: y satisfies the equations of equilibrium
(`floating/equilibrium.py`) with q_u in place of the load.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import ROUGH
from dolfinx_tresca._base.patience import MOST_STEPS
from dolfinx_tresca.derivatives.followed_displacement import FollowedDisplacement
from dolfinx_tresca.dual.program import DualProgram, at_edge
from dolfinx_tresca.errors import ConvergenceError, InputError
from dolfinx_tresca.solvers.feasible_set import Face
from dolfinx_tresca.solvers.friction_cones import FrictionCones
from dolfinx_tresca.solvers.nodal_maps import NodalMaps, NodalPattern
from dolfinx_tresca.solvers.reductions import norm

#: Relative error of y in the energy norm of the model of A; its square is the relative error of the
#: adjoint's energy.
ADJOINT_ACCURACY = ROUGH

#: The right-hand side of the equations for GCR is a difference of two terms. The residual of GCR
#: counts as rounding up to this multiple of the sum of the terms' absolute values.
RESIDUAL_ROUNDING = 1e-10

#: No adjoint or tangent exists if the residual of the equations of equilibrium exceeds this
#: multiple of the size of the data (derivatives of the goal, or changes of the load).
UNMET = 1e-6

#: Error of z that an iterative solver for K may leave, divided by the tolerable error of y, both in
#: the energy norm.
SHARE = 0.03

#: State that is assumed for nodes that are about to change their state: as in the solution (None),
#: pressed and sticking ("held"), or open and slipping ("released").
EdgeState: TypeAlias = 'Literal["held", "released"] | None'


@dataclass(frozen=True)
class LinearisedContact:
    """The contact state at which the problem is linearised.

    Attributes:
        face: states of the nodes.
        curvature: (size,) diagonal of C, the curvature of the circles of slipping nodes.
        with_bound_change: (size, size) I + Q, with the change Q of slip bounds with the pressure.
    """

    face: Face
    curvature: Array
    with_bound_change: csr_array

    @classmethod
    def of(cls, dual: DualProgram, x: Array, r: Array, edge: EdgeState = None) -> LinearisedContact:
        """Return the contact state of multipliers x (size,) with gradient r (size,). Collective.

        Args:
            dual: the dual problem of the solve.
            x: multipliers at which the problem is linearised.
            r: gradient at x.
            edge: state that is assumed for nodes between two states, which `at_edge` finds.

        Raises:
            InputError: a slip bound depends on the slip.
        """
        cones = dual.admissible.at(x, r)
        target = dual.decoupled_minimiser(x, r)
        if edge is not None:
            rows, discs = at_edge(dual, x, r)
            held = edge == "held"
            x, target = x.copy(), target.copy()
            target[rows] = 1.0 if held else -1.0
            if not held:
                x[rows] = 0.0  # a bound that depends on this pressure becomes zero as well
            lam = cones.section(x)
            norms, factor = lam.norms(target), np.ones_like(lam.radius)
            beyond = 0.0 if held else 2.0 * lam.radius
            np.divide(beyond, norms, out=factor, where=discs & (norms > 0.0))
            target = lam.scaled_discs(target, factor)
        lam = cones.section(x)
        face = lam.face(target)
        follows = isinstance(cones, FrictionCones) and bool(cones.slopes(x, face)[1].any())
        if dual.reductions.minimum_over_ranks(-float(follows)) < 0.0:
            raise InputError(
                "the coefficient of friction depends on the slip, and derivatives and errors of "
                "numbers are not known for such laws: make it a function of the pressure alone."
            )
        change = cones.with_bound_change(x, face, np.ones_like(x))
        matrix = NodalPattern(dual.jump.row_nodes).matrix(lambda v: change(v, v))
        return cls(face, lam.circle_stiffness(r, face), matrix)

    def projected(self, v: Array) -> Array:
        """Return P (I + Q') v, with P and Q as in `maps`, for (size,) or (size, columns).

        Not collective.
        """
        return self.face.project(self.with_bound_change.T @ v)

    def maps(self, diagonal: Array, transpose: bool) -> NodalMaps:
        """Return the maps of `NodalMaps`, for the adjoint or the tangent. Not collective.

        P projects onto the face; Q is the change of slip bounds with the pressure.

        Args:
            diagonal: (size,) diagonal D of the model of A.
            transpose: True: the maps of the adjoint, with T = P (I + Q') and s = P s; False: the
                maps of the tangent, with T = P and s = (I + Q) P s.
        """
        project, change = self.face.project, self.with_bound_change
        weight = 1.0 / (diagonal + self.curvature)
        test = self.projected if transpose else project

        def inverse(v: Array) -> Array:
            weighted = np.asarray((weight * test(v).T).T)
            return weighted if transpose else change @ weighted

        def rest(v: Array) -> Array:
            along = project(v)
            curved = np.asarray((self.curvature * along.T).T)
            left = v - (along if transpose else change @ along)
            return (test(curved) if transpose else curved) + (left.T * diagonal).T

        return NodalMaps(test=test, rest=rest, inverse=inverse)


def tangent(
    dual: DualProgram,
    state: LinearisedContact,
    force: PETSc.Vec,
    offset: Array,
    radius: Array,
    accuracy: float,
) -> tuple[fem.Function, Array]:
    """Return the tangent (du, dx): the change of the solution by given changes of the data.

    Here du is a displacement and dx (size,) are multipliers, see the module. Products with A are
    kept for later solves. Collective.

    Args:
        dual: the problem.
        state: contact state at which the problem is linearised.
        force: change of the right-hand side of K u = f; rows of prescribed values have the change
            of these values.
        offset: (size,) change of the offsets (d; s), divided by `JumpOperator.length_scale`.
        radius: (n_discs,) change of the radii of the discs.
        accuracy: relative error of dx in the energy norm.

    Raises:
        ConvergenceError: no tangent exists.
    """
    face, jump, constraints = state.face, dual.jump, dual.constraints
    u = fem.Function(jump.system.V, name="displacement")
    w = u.x.petsc_vec
    grown = face.along_radius(np.where(face.slip, radius, 0.0))
    start = jump.contact_force(grown).copy()
    start.aypx(-1.0, force)
    followed = FollowedDisplacement.of(dual.compliance, start, w)
    jump_at_start = followed.solve_start()
    right = face.project(jump_at_start - offset)
    terms = np.abs(jump_at_start) + np.abs(offset)
    missing, size = -dual.inner(constraints.columns, grown), norm(dual, grown)
    free = force.copy()
    free.array[jump.system.prescribed] = 0.0
    if dual.equilibrium is not None:
        resultant, largest = dual.equilibrium.resultants(free)
        missing, size = missing + resultant, size + largest
    x, c = _solved(dual, state, False, followed, right, terms, missing, accuracy)
    unmet = missing - dual.inner(constraints.columns, x) - constraints.softness @ c
    if size > 0.0 and np.linalg.norm(unmet) > UNMET * (size + norm(dual, x)):
        raise _none(False)
    followed.end_at(x, SHARE * accuracy)
    x += grown
    free.destroy()
    start.destroy()
    if dual.equilibrium is not None:
        dual.equilibrium.move(x, w, c)
    u.x.scatter_forward()
    return u, x


def adjoint(
    dual: DualProgram,
    state: LinearisedContact,
    on_jump: Array,
    on_x: Array,
    accuracy: float = ADJOINT_ACCURACY,
    on_u: PETSc.Vec | None = None,
) -> tuple[fem.Function, Array]:
    """Return the adjoint solution (z, y) for the goal on_jump'B u + on_x'x + on_u'u. Collective.

    Here z is a displacement and y (size,) are multipliers, see the module. Products with A are kept
    for later solves.

    Args:
        dual: the problem.
        state: contact state at which the problem is linearised.
        on_jump: (size,) derivative of the goal with respect to B u.
        on_x: (size,) derivative of the goal with respect to x.
        accuracy: relative error of y in the energy norm.
        on_u: derivative of the goal with respect to u, zero where u is prescribed; None: zeros.

    Raises:
        ConvergenceError: no adjoint exists.
    """
    size, constraints = norm(dual, on_jump), dual.constraints
    missing = dual.inner(constraints.columns, on_jump)
    force = dual.jump.contact_force(on_jump).copy()
    if on_u is not None:
        force.axpy(1.0, on_u)
        if dual.equilibrium is not None:
            resultant, largest = dual.equilibrium.resultants(on_u)
            missing, size = missing + resultant, size + largest
    z = fem.Function(dual.jump.system.V, name="adjoint")
    u = z.x.petsc_vec
    followed = FollowedDisplacement.of(dual.compliance, force, u)
    jump_at_start = followed.solve_start()
    right = state.projected(jump_at_start - on_x)
    terms = np.abs(jump_at_start) + np.abs(on_x)
    y, c = _solved(dual, state, True, followed, right, terms, missing, accuracy)
    unmet = missing - dual.inner(constraints.columns, y) - constraints.softness @ c
    if size > 0.0 and np.linalg.norm(unmet) > UNMET * size:
        raise _none(True)
    followed.end_at(y, SHARE * accuracy)
    force.destroy()
    if dual.equilibrium is not None:
        dual.equilibrium.move(y, u, c)
    u.array[dual.jump.system.prescribed] = 0.0
    z.x.scatter_forward()
    return z, y


def _solved(
    dual: DualProgram,
    state: LinearisedContact,
    transpose: bool,
    followed: FollowedDisplacement,
    right: Array,
    terms: Array,
    missing: Array,
    accuracy: float,
) -> tuple[Array, Array]:
    """Return multipliers y (size,) of the adjoint or the tangent, and c (k,). Collective.

    They satisfy P (I + Q') ((A + C) y - G c) = right with y = P y for the adjoint (`transpose`),
    and P ((A + C) y - G c) = right with y = (I + Q) P y for the tangent. In both cases,
    G'y + S c = missing. P, Q and C are maps of the contact state; G and S are matrices of the
    equilibrium of floating bodies.

    The method is GCR (minimal residuals), which needs no symmetry. Its preconditioner is the same
    system, with A replaced by its model from all known products, including products of this call.
    The equation G'y + S c = missing therefore holds from the first step on. The displacement
    `followed` is updated with y, so that the error of a product only has to be small compared with
    its step.

    `terms` (size,) are the absolute values of the terms whose difference is `right`. If all nodes
    slip, `right` may be nothing but the rounding error of these terms.

    Raises:
        ConvergenceError: no solution exists.
    """
    G, S = dual.constraints.columns, dual.constraints.softness
    store = dual.known_products()
    model = store.model()
    weight = 1.0 / (model.diagonal + state.curvature)
    found: Array = np.zeros(len(right) + len(missing))
    steps: Array = np.empty((len(found), 0))
    images: Array = np.empty((len(right), 0))
    residual = right
    root, wanted = np.sqrt(weight), 0.0
    rounding = RESIDUAL_ROUNDING * norm(dual, root * terms)
    for count in range(MOST_STEPS):
        maps = state.maps(model.diagonal, transpose)
        step_y, step_c = model.solve_between(maps, residual, G, S, missing)
        step: Array = np.append(step_y, step_c)
        size = np.sqrt(max(float(dual.inner(step_y, model.apply(step_y))), 0.0))
        if count and (size <= wanted or norm(dual, root * residual) <= rounding):
            return step_y + found[: len(right)], step_c + found[len(right) :]
        product, error = followed.product(found[: len(right)], step_y, size)
        store.add(step_y, product, error)
        image = maps.test(product + state.curvature * step_y - G @ step_c)
        if count == 0:
            wanted, missing, length = accuracy * size, np.zeros_like(missing), 1.0
        else:
            before, known = norm(dual, root * image), dual.inner(images, weight * image)
            step, image = step - steps @ known, image - images @ known
            new = norm(dual, root * image)
            if new <= RESIDUAL_ROUNDING * before:  # errors of products, or no solution exists
                break
            step, image = 1.0 / new * step, 1.0 / new * image
            steps, images = np.column_stack([steps, step]), np.column_stack([images, image])
            length = float(dual.inner(image, weight * residual))
            followed.combine(known, 1.0 / new)
        found, residual = found + length * step, residual - length * image
        followed.advance(length)
        model = store.model()
    accepted = max(accuracy, ADJOINT_ACCURACY) * norm(dual, root * right)
    if norm(dual, root * residual) > max(accepted, rounding):
        raise _none(transpose)
    return found[: len(right)], found[len(right) :]


def _none(transpose: bool) -> ConvergenceError:
    """Return the error to raise if no adjoint (`transpose`) or no tangent exists."""
    if transpose:
        return ConvergenceError(
            "the number has no adjoint: with the contact state of each node fixed (open, sticking, "
            "slipping) nothing, or hardly anything, holds a body against the motion that the "
            "number depends on. Ask for another number, or refine for the energy error."
        )
    return ConvergenceError(
        "the solution has no tangent: with the contact state of each node fixed (open, sticking, "
        "slipping) nothing, or hardly anything, holds a body against the motion that the controls "
        "cause. Take another direction, or the difference of two solutions."
    )
