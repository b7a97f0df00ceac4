"""A solution, linearised at fixed contact states; its tangent and its adjoint.

With the state of each node fixed (open nodes stay open, sticking nodes stick, slipping nodes move
along their circles, which grow with the pressure if the law says so), a solution with the
displacement u and the multipliers x obeys

    K u + B'x = f,    P (B u - C x) = constant,    dx = (I + Q) P dx,

where P projects onto the face, C is the curvature of the circles, and Q contains the slope of the
slip bounds. Let the load change by df, the offsets (d; s) (gaps and slip origins) by do, and the
radii of the circles by dg. With the unit vectors t along the multipliers on the circles, the
tangent (du, dx) obeys

    K du + B'dx = df,    P (B du - C dx) = P do,    dx = (I + Q) P dx + t dg.

For a goal q_u'u + q_x'x, the adjoint (z, y) obeys

    K z + B'y = q_u,    P (I + Q') (B z - C y) = P (I + Q') q_x,    y = P y.

For Q = 0, both systems have the same matrix; slip bounds that follow the pressure make it
unsymmetric. The goal changes by z'df + y'do + (q_x - B z)'t dg. If bodies float, K z + B'y = q_u
has a solution only if y balances q_u in the way in which contact forces balance the load: y
satisfies the equations of equilibrium (`floating/equilibrium.py`) with q_u in place of the load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca._base.tolerances import FULL_ACCURACY, MOST_STEPS, ROUGH
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.errors import ConvergenceError, InputError
from dolfinx_tresca.solvers.constraints import norm
from dolfinx_tresca.solvers.feasible_set import Face
from dolfinx_tresca.solvers.products import NodalMaps

#: Relative error of y in the energy norm of the model of A, for estimates of errors (its square is
#: that of the adjoint's energy). If steps fail, a residual of this part of the first is accepted.
ADJOINT_ACCURACY = ROUGH

#: Whether K is factored, so that products with A are exact -> relative error, in the energy norm,
#: of the multipliers y of gradients and tangents.
ACCURACY = {True: 1e-10, False: 1e-5}

#: The right-hand side of the equations for GCR is a difference of two terms. The residual of GCR
#: counts as rounding up to this multiple of the sum of the terms' absolute values.
RESIDUAL_ROUNDING = 1e-10

#: Requested error of the displacement after a step of GCR, relative to the step, both in the energy
#: norm. The first step is the displacement at y = 0. With twice the value derivatives of
#: a rubbing block have an error of 1.2e-4 in place of 3e-5, since errors of products enter y.
STEP_ACCURACY = 0.05


@dataclass(frozen=True)
class LinearisedContact:
    """A solution u, x (`multipliers`) of a dual problem, and the contact states that are kept.

    Attributes:
        bounds: slip bounds at the nodes of each pair, for derivatives by places of obstacles.
    """

    dual: DualProgram
    multipliers: Array
    u: fem.Function
    bounds: Sequence[NodalBounds]

    @cached_property
    def gradient(self) -> Array:
        """(size,) gradient r = (d; s) - B u of the dual energy, with gaps d and slip origins s.

        Collective at the first access.
        """
        return self.dual.gradient_of(self.u.x.petsc_vec)

    @property
    def face(self) -> Face:
        """The states of the nodes, with the projector P. Collective at the first access."""
        return self._states[0]

    @cached_property
    def _states(self) -> tuple[Face, Array, csr_array]:
        """The face with P, the diagonal (size,) of C, and I + Q (size, size). Collective."""
        dual, x, r = self.dual, self.multipliers, self.gradient
        cones, target = dual.admissible.at_point(x, r), dual.local_minimiser(x, r)
        section = cones.section(x)
        face = section.face(target)
        slope, by_slip = cones.slopes(x, face.slip)
        if reduce_array(dual.jump.comm, float(by_slip.any())) > 0.0:
            raise InputError(
                "the coefficient of friction depends on the slip, and derivatives and errors of "
                "numbers are not known for such laws: make it a function of the pressure alone."
            )
        # Q is the sum of g' t n' over slipping nodes: slope g' of the bound, unit normal vector n
        follow = cones.nodal_matrix(np.ones_like(x), (face.radial, cones.at_normals(slope)))
        return face, section.circle_stiffness(r, face), follow

    def tangent(self, force: Array, offset: Array, radius: Array) -> tuple[fem.Function, Array]:
        """Return the changes du of the displacement and dx (size,) of the multipliers. Collective.

        Products with A are kept for later solves. The changes of the data are the force (owned
        degrees of freedom,), du_D in rows of prescribed values, else df - K du_D; the offset do
        (size,), divided by `JumpOperator.length_scale`; and the radius dg (n_discs,).
        """
        # with dx = y + t dg, y = (I + Q) P y obeys the equations of `_solve` for df - B't dg
        grown = self.face.along_radius(np.where(self.face.slip, radius, 0.0))
        right = self.dual.jump.contact_force(grown).copy()
        right.array = force - right.array
        du, y = self._solve(right, offset, None, transpose=False)
        return du, y + grown

    def adjoint(
        self, by_jump: Array, by_x: Array, by_u: Array | None = None, accuracy: float | None = None
    ) -> tuple[fem.Function, Array]:
        """Return the adjoint (z, y) for the goal by_jump'B u + by_x'x + by_u'u. Collective.

        Here z is a displacement, zero where u is prescribed, and y (size,) are multipliers, see the
        module. Products with A are kept for later solves. The vector by_u (owned degrees of
        freedom,) is zero where u is prescribed. The `accuracy` of y is relative, in energy norm.
        """
        right = self.dual.jump.contact_force(by_jump).copy()
        if by_u is not None:
            right.array += by_u
        return self._solve(right, by_x, accuracy, transpose=True)

    def _solve(
        self, force: PETSc.Vec, offset: Array, accuracy: float | None, transpose: bool
    ) -> tuple[fem.Function, Array]:
        """Return (v, y) with K v + B'y = force and T (B v - C y) = T offset. Collective.

        For the adjoint (`transpose`) (v, y) is (z, y), T = P (I + Q') and y = P y; for the tangent
        it is (du, dx - t dg), T = P and y = (I + Q) P y. The first equation gives
        v = K^-1 (force - B'y), plus rigid motions U c of floating bodies, B U = G. So y and c obey

            T ((A + C) y - G c) = T (B K^-1 force - offset),    G'y + S c = resultants,

        where G, S and the resultants of the force belong to the equilibrium of floating bodies.
        """
        dual, constraints = self.dual, self.dual.constraints
        if accuracy is None:
            accuracy = ACCURACY[dual.compliance.exact]
        prescribed = dual.jump.system.prescribed
        v = fem.Function(dual.jump.system.V, name="adjoint" if transpose else "displacement")
        displacement = _FollowedDisplacement(dual, force, v.x.petsc_vec)
        resultants, largest_resultant = np.zeros(constraints.columns.shape[1]), 0.0
        if dual.equilibrium is not None:
            free = force.copy()
            free.array[prescribed] = 0.0
            resultants, largest_resultant = dual.equilibrium.resultants(free)
        y, c, is_solved = self._gcr(displacement, offset, resultants, accuracy, transpose)
        unmet = resultants - dual.inner(constraints.columns, y) - constraints.softness @ c
        # a tangent has multipliers also from changes of gaps and slip bounds, without resultants
        largest = largest_resultant + (0.0 if transpose else norm(dual, y))
        is_balanced = largest_resultant == 0.0 or bool(np.linalg.norm(unmet) <= 1e-6 * largest)
        if not (is_solved and is_balanced):
            if transpose:
                raise ConvergenceError(
                    "the number has no adjoint: with the contact state of each node fixed (open, "
                    "sticking, slipping) nothing, or hardly anything, holds a body against the "
                    "motion that the number depends on. Ask for another number, or refine for the "
                    "energy error."
                )
            raise ConvergenceError(
                "the solution has no tangent: with the contact state of each node fixed (open, "
                "sticking, slipping) nothing, or hardly anything, holds a body against the motion "
                "that the controls cause. Take another direction, or the difference of two "
                "solutions."
            )
        # the error of v is a small part of the tolerable error of y
        displacement.improve(y, v.x.petsc_vec, 0.03 * accuracy, 0.0)
        if dual.equilibrium is not None:
            dual.equilibrium.add_rigid_displacements(y, v.x.petsc_vec, c)
        v.x.petsc_vec.array[prescribed] = force.array[prescribed]
        v.x.scatter_forward()
        return v, y

    def _gcr(
        self,
        displacement: _FollowedDisplacement,
        offset: Array,
        resultants: Array,
        accuracy: float,
        transpose: bool,
    ) -> tuple[Array, Array, bool]:
        """Return y (size,) and c (k,) of `_solve`, and whether they are accurate. Collective.

        GCR (generalised conjugate residuals) needs no symmetry. Its preconditioner is the same
        system, with A replaced by its model from all known products, including products of this
        call. The first step is taken whole, so that G'y + S c = resultants holds from then on;
        further steps have orthonormal images and the factors with the least residual.
        """
        dual, constraints, curvature = self.dual, self.dual.constraints, self._states[1]
        jump_at_start = dual.jump.of_unknowns(displacement.v)
        store = dual.compliance.known_products()
        model = store.model()
        # norms of residuals and images weigh each row by the inverse of the model's diagonal
        weight = 1.0 / (model.diagonal + curvature)
        root = np.sqrt(weight)
        maps = self._maps(model.diagonal, transpose)
        residual = maps.test @ (jump_at_start - offset)  # `solve_on_face` tests again: T T = T
        # if all nodes slip, the difference may be nothing but the rounding error of its terms
        rounding = RESIDUAL_ROUNDING * norm(dual, root * (np.abs(jump_at_start) + np.abs(offset)))
        accepted = max(max(accuracy, ADJOINT_ACCURACY) * norm(dual, root * residual), rounding)
        # the unknowns y, c and v in one array, as in each step of them; with a direct solver v is
        # empty here, since only its values at the start and at the end are needed
        v = np.zeros(0) if dual.compliance.exact else displacement.v.array
        point = np.concatenate([np.zeros_like(residual), np.zeros_like(resultants), v])
        ends = np.cumsum([len(residual), len(resultants)])  # of y and of c in the array
        y, c, v = np.split(point, ends)
        steps: list[Array] = []
        images: Array = np.empty((len(residual), 0))
        missing, wanted_length = resultants, 0.0
        for number in range(MOST_STEPS):
            step_y, step_c = model.solve_on_face(
                maps, residual, constraints.columns, constraints.softness, missing
            )
            length = np.sqrt(max(float(dual.inner(step_y, model.apply(step_y))), 0.0))
            # the last step needs no product: it is shorter than the wanted error, or the residual
            # from which it comes is rounding
            if number and (length <= wanted_length or norm(dual, root * residual) <= rounding):
                return y + step_y, c + step_c, True
            product, error, step_v = displacement.product(y, step_y, length)
            store.add(step_y, product, error)
            step = np.concatenate([step_y, step_c, step_v])
            image = maps.test @ (product + curvature * step_y - constraints.columns @ step_c)
            if number == 0:
                factor, wanted_length = 1.0, accuracy * length
                missing = np.zeros_like(missing)
            else:
                norm_before = norm(dual, root * image)
                overlaps = dual.inner(images, weight * image)
                image = image - images @ overlaps
                new_norm = norm(dual, root * image)
                if new_norm <= RESIDUAL_ROUNDING * norm_before:
                    break  # errors of products, or no solution exists
                for overlap, earlier in zip(overlaps, steps, strict=True):
                    step = step - overlap * earlier
                image = 1.0 / new_norm * image
                step = 1.0 / new_norm * step
                images = np.column_stack([images, image])
                steps.append(step)
                factor = float(dual.inner(image, weight * residual))
            point = point + factor * step
            residual = residual - factor * image
            y, c, v = np.split(point, ends)
            displacement.v.array[: len(v)] = v
            model = store.model()
            maps = self._maps(model.diagonal, transpose)
        return y, c, norm(dual, root * residual) <= accepted

    def _maps(self, diagonal: Array, transpose: bool) -> NodalMaps:
        """Return T and the other maps of `NodalMaps`, for `_gcr`. Not collective."""
        (face, curvature, follow), x = self._states, self.multipliers
        if not transpose:
            cones = self.dual.admissible.at_point(x, self.gradient)
            return NodalMaps.on_face(cones, x, face, diagonal, curvature)
        # The discs have the bounds of the solution, with Q = 0: this gives the maps for T = P. With
        # P (I + Q') for P the matrix P D + R stays the same, since Q' D y = 0 for y = P y.
        maps = NodalMaps.on_face(face.discs, x, face, diagonal, curvature)
        return replace(maps, test=maps.test @ follow.T, inverse=maps.inverse @ follow.T)


class _FollowedDisplacement:
    """The displacement v with K v = f - B'y while GCR changes y.

    With a direct solver for K each product is one solve, and v is computed for y = 0 and at the
    end. An iterative solver starts from the last v, and stops at a given part of the step's length.
    As steps become smaller, v becomes more accurate, and all steps together cost little more than
    one accurate solve. (If each product had the accuracy of the result instead, the derivatives of
    a goal on the two bricks with N = 16 would take 90 to 117 iterations of the solver for K in
    place of 33 to 40.) The product A s of a step s is then the difference of two jumps B v.
    """

    def __init__(self, dual: DualProgram, f: PETSc.Vec, v: PETSc.Vec) -> None:
        """Begin with y = 0: solve K v = f, which contains prescribed values. Collective."""
        self._compliance, self._jump, self._f, self.v = dual.compliance, dual.jump, f, v
        self._error = 0.0
        if f.norm() > 0.0:
            self._compliance.products += 1
            self._error = self.improve(None, v, STEP_ACCURACY, 0.0)

    def improve(self, y: Array | None, v: PETSc.Vec, rtol: float, accuracy: float) -> float:
        """Solve K v = f - B'y (None: y = 0) from the given v, return the error. Collective."""
        force, prescribed = self._f, self._jump.system.prescribed
        if y is not None:
            force = self._jump.contact_force(y)
            force.aypx(-1.0, self._f)
        error = self._compliance.solver.improve(force, v, rtol=rtol, accuracy=accuracy)
        v.array[prescribed] = self._f.array[prescribed]  # an iteration may change these values
        return error

    def product(self, y: Array, step: Array, length: float) -> tuple[Array, float, Array]:
        """Return A s (size,) for a step s from y, its error, and the step of v. Collective.

        With v = K^-1 (f - B'y) it is A s = B v(y) - B v(y + s). The `length` is about sqrt(s'A s),
        and the error is in the norm sqrt(e'A^-1 e).
        """
        if self._compliance.exact:
            return self._compliance.apply(step), 0.0, np.zeros(0)
        self._compliance.products += 1
        new_v, error_before = self.v.copy(), self._error
        self._error = self.improve(y + step, new_v, FULL_ACCURACY, STEP_ACCURACY * length)
        product = self._jump.of_unknowns(self.v) - self._jump.of_unknowns(new_v)
        change = new_v.array - self.v.array
        new_v.destroy()
        return product, float(np.hypot(self._error, error_before)), change
