"""Guaranteed bounds of the error of the displacement, and of a goal from both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import geometry_degree
from dolfinx_tresca._base.functions import assembled, owned_values, zero_like
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.guaranteed.cells import (
    OwnedCells,
    StressEnergies,
    require,
    rigid_motions,
    spread,
    stress_data,
    symmetric_basis,
)
from dolfinx_tresca.guaranteed.contact import ContactSurface
from dolfinx_tresca.guaranteed.forms import Loads, elasticity, loads
from dolfinx_tresca.guaranteed.stars import Stars
from dolfinx_tresca.scene.pair import ContactForce, NormalForce, checked_goal
from dolfinx_tresca.stiffness.system import LinearSystem

#: Force that a cell lacks, relative to the largest force on a cell, above which the displacement is
#: not in equilibrium: a force at a point, or a failed solve.
IMBALANCE = 1e-7

#: Penetration relative to the largest displacement that counts as rounding.
PENETRATION = 1e-10

#: Part of the bound by which a step of the conjugate gradient method must lower it, or the steps
#: end. With half of it the bound is 2 % smaller, for up to one and a half times as many steps.
GAIN = 0.02

#: Factor by which the size of the change of the load is varied as long as the interval shrinks, and
#: largest power of it.
STEP, MOST_STEPS = 4.0, 3


@dataclass(frozen=True)
class GuaranteedError:
    """A proven bound of |u - u*|, where u* is the exact solution on the domain of the mesh.

    The norm is the energy norm, |v|^2 = a(v, v). The bound is proven up to rounding
    (docs/theory/guaranteed.md). u* is the solution of Tresca's problem whose gaps and slip bounds
    are linear between contact nodes; if bounds depend on the pressure, they are those of the
    solution.

    Attributes:
        error: bound of |u - u*| [energy^(1/2)].
        relative_error: `error` divided by |u|.
        cell_errors: for each cell, root of its part of the square [energy^(1/2)], for `refine`. The
            root of the sum of their squares is at most some percent larger than `error` if `lift`
            is small.
        stress: |s - s(u)|, the distance of the stress in equilibrium from the stress of the
            displacement [energy^(1/2)].
        oscillation: root of the sum of squares of the terms of loads that are not balanced exactly
            [energy^(1/2)]; zero for loads that are linear in cells, and tractions on facets.
        complementarity: integral of pressure times gap [energy].
        friction: integral of what the work of friction lacks of its bound [energy].
        lift: |u - v|, the distance of u from a displacement v that does not penetrate, and has no
            gap where it is pressed [energy^(1/2)].
    """

    error: float
    relative_error: float
    cell_errors: fem.Function
    stress: float
    oscillation: float
    complementarity: float
    friction: float
    lift: float

    def __repr__(self) -> str:
        return (
            f"<GuaranteedError: at most {self.error:.3e}, {self.relative_error:.1%} of the "
            "displacement's energy norm>"
        )


@dataclass(frozen=True)
class Candidate:
    """Tractions, loads and displacements that bound the exact solution of a load.

    Attributes:
        surfaces: the contact surfaces, with admissible tractions.
        loads: loads, and tractions on the whole boundary.
        v: a displacement that does not penetrate.
        balanced: (n, d + 1, d, d) stress of a displacement that balances the loads.
    """

    surfaces: list[ContactSurface]
    loads: Loads
    v: fem.Function
    balanced: Array


@dataclass(frozen=True)
class Distance:
    """The distance of a stress in equilibrium from that of a displacement v, by cell.

    Attributes:
        difference: data of the difference of both stresses, see `StressEnergies`.
        stress: (n,) the norm of the difference.
        oscillation: (n,) bounds of what loads do that the stress does not balance.
        complementarity: (n,) integrals of pressure times gap.
        friction: (n,) integrals of what the work of friction lacks of its bound.
    """

    difference: Array
    stress: Array
    oscillation: Array
    complementarity: Array
    friction: Array


class Bodies:
    """The cells of elastic bodies with their stiffnesses, for stresses in equilibrium."""

    def __init__(self, linear: LinearSystem, dual: DualProgram) -> None:
        """Check what the bound covers, and factor the equations of all stars. Collective.

        Raises:
            InputError: the bound does not cover the problem.
        """
        mesh, self.linear, self.V = linear.V.mesh, linear, linear.V
        self.comm, cell = mesh.comm, mesh.topology.cell_name()
        plain = linear.component is None and not linear.axisymmetric
        for holds, needed in (
            (plain, "displacements in a plane or in space, not mixed spaces or revolution"),
            (
                cell in ("triangle", "tetrahedron"),
                f"triangles or tetrahedra, found {cell} cells. Divide them into simplices",
            ),
            (geometry_degree(mesh) == 1, "cells with straight edges"),
            (
                dual.equilibrium is None,
                "Dirichlet conditions that hold each body; here contact alone holds a body "
                "against some motion",
            ),
        ):
            require(self.comm, holds, needed)
        self.owned = owned = OwnedCells.from_space(self.V)
        self.cells = cells = owned.cells
        self.stiffness = elasticity(linear.ufl_forms[0], owned, linear.entity_maps)
        self.energies = StressEnergies(cells, np.asarray(np.linalg.inv(self.stiffness)))
        self.prescribed = spread(self.V, linear.prescribed.reshape(-1, cells.d)) > 0.0
        exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology)
        inside = ~np.isin(owned.facets, exterior)[:, :, None]
        held = self.prescribed[owned.nodes[:, owned.on_facets]].all(axis=2) & ~inside
        self.unknown = held | inside
        self.stars = Stars(owned, self.energies.facet_stiffness(), self.unknown)
        # facets that are held take any load
        traces = cells.trace_factors * ~held.all(axis=2)
        factors = np.hstack([cells.poincare_factors[:, None], traces])
        self.factors = factors / np.sqrt(np.linalg.eigvalsh(self.stiffness)[:, :1])

    def stress_data(self, w: fem.Function) -> Array:
        """Return the data of the stresses of a displacement, see `StressEnergies`."""
        return stress_data(self.cells, self.stresses(w))

    def stresses(self, w: fem.Function) -> Array:
        """Return the stresses (n, d + 1, d, d) of a displacement at the vertices of cells."""
        owned, tensors = self.owned, symmetric_basis(self.cells.d)
        values = w.x.array.reshape(-1, owned.cells.d)[owned.nodes]
        slopes = 2.0 * np.einsum("kab,nki->naib", owned.basis, values)
        strains = np.tensordot(slopes @ owned.cells.gradients[:, None], tensors, ([2, 3], [1, 2]))
        return np.asarray(np.tensordot(strains @ self.stiffness, tensors, axes=1))

    def candidate(
        self, dual: DualProgram, multipliers: Array, u: fem.Function, L: ufl.Form | None
    ) -> Candidate:
        """Return admissible tractions and displacements, with one solve with K. Collective.

        Args:
            dual: the dual problem that was solved.
            multipliers: (size,) multipliers.
            u: the displacement.
            L: the load that the stress is to balance.

        Raises:
            InputError: the bound does not cover the contact pairs, or the load.
        """
        given = loads(L, self.owned, self.factors, self.linear.entity_maps)
        at_solution = dual.bounds(multipliers, dual.gradient_of(u.x.petsc_vec))
        areas = np.concatenate([pair.weights for pair in dual.jump.pairs])
        bounds = at_solution.radius[: len(areas)] / np.sqrt(areas)
        surfaces = [
            ContactSurface(self.owned, dual, number, multipliers, bounds, self.prescribed)
            for number in range(len(dual.jump.pairs))
        ]
        v, right, balanced = u.copy(), zero_like(u, "force"), zero_like(u, "balanced")
        for surface in surfaces:
            surface.lift(v)
            for cell, facet, tractions in surface.sides:
                given.traction[cell, facet] += tractions
        right.x.array[:] = self.owned.nodal_forces(given.load, given.traction).ravel()
        residual = self.linear.residual_of(right.x.petsc_vec, u.x.petsc_vec)
        dual.compliance.solver.improve(residual, balanced.x.petsc_vec, rtol=1e-12, accuracy=0.0)
        residual.destroy()
        balanced.x.scatter_forward()
        balanced.x.array[:] += u.x.array
        return Candidate(surfaces, given, v, self.stresses(balanced))

    def distance(
        self, candidate: Candidate, v: fem.Function, target: Array, gain: float
    ) -> Distance:
        """Return the distance of a stress in equilibrium from that of a displacement. Collective.

        Args:
            candidate: the loads and tractions that the stress balances.
            v: displacement that does not penetrate.
            target: data of the stress that is to be near, see `StressEnergies`.
            gain: part of the distance by which a step must lower it, or the steps end.

        Raises:
            InputError: prescribed displacements penetrate.
            ContactError: the displacement is not in equilibrium.
        """
        defects = np.zeros((2, len(self.unknown)))
        largest = reduce_array(self.comm, np.abs(v.x.array).max(initial=0.0), MPI.MAX)
        for surface in candidate.surfaces:
            *lacking, deepest = surface.defects(v)
            for total, lack in zip(defects, lacking, strict=True):
                np.add.at(total, surface.cell, lack)
            require(
                self.comm,
                deepest <= PENETRATION * largest,
                "an exact solution, and prescribed displacements penetrate at contact pair "
                f"{surface.pair}",
            )
        difference = self._equilibrated(candidate, target) - target
        self._shorten(difference, gain)
        stress = np.sqrt(self.energies.squared_norms(difference))
        return Distance(difference, stress, candidate.loads.oscillation, *defects)

    def _equilibrated(self, candidate: Candidate, reference: Array) -> Array:
        """Return data of a stress in equilibrium with a candidate's loads. Collective.

        Boundary tractions are the given ones; others come from `candidate.balanced`, corrected star
        by star. The data of `reference`, see `StressEnergies`, only tell how large forces are.
        """
        cells, count, load = self.cells, self.energies.count, candidate.loads.load
        given, shape = candidate.loads.traction, candidate.loads.traction.shape
        discrete = stress_data(cells, candidate.balanced)[:, :count].reshape(shape)
        near = np.where(self.unknown[:, :, None], discrete, given)
        internal = np.einsum("nkab,njb->nja", candidate.balanced, cells.gradients) / shape[1]
        loaded = cells.volume_forces(load)
        tractions = self.stars.equilibrated(near, cells.volumes[:, None, None] * internal - loaded)

        forces = cells.facet_forces(tractions)
        # a body may be free of forces where the reference, of another load, is not
        aimed = cells.facet_forces(reference[:, :count].reshape(shape))
        arms = (cells.points - cells.points[:, :1]) / cells.heights.max(axis=1)[:, None, None]
        lacking = np.einsum("nrkd,nkd->nr", rigid_motions(arms), forces + loaded)
        largest = [np.abs(field).max(initial=0.0) for field in (lacking, forces, aimed)]
        missing, *sizes = reduce_array(self.comm, largest, MPI.MAX)
        if not missing <= IMBALANCE * max(sizes):  # NaN fails, too
            raise ContactError(
                f"the displacement is not in equilibrium: on a cell, forces of {missing:.1e} are "
                f"missing, where forces on cells are up to {max(sizes):.1e}. A displacement that "
                "is prescribed at a point, and not on facets, cannot hold a force."
            )
        return np.concatenate([tractions.reshape(len(load), count, -1), -load], axis=1)

    def _shorten(self, difference: Array, gain: float) -> None:
        """Add tractions without resultants that shorten a stress, in place. Collective."""
        count, shape = self.energies.count, self.unknown.shape
        derivative = self.energies.derivative(difference)
        square = float(reduce_array(self.comm, (difference * derivative).sum()))
        descent = -derivative[:, :count]
        direction, previous, lowered, total = np.zeros_like(descent), np.inf, square, 0.0
        # for goals the distance is large by itself, and its decrease tells more
        while lowered > gain * min(total, 2.0 * square) and square > 0.0:
            step = self.stars.preconditioned(descent.reshape(*shape, -1)).reshape(descent.shape)
            slope = float(reduce_array(self.comm, (step * descent).sum()))
            if not slope > 0.0:
                break
            direction = step + slope / previous * direction
            previous = slope
            change = self.energies.derivative(direction)
            length = slope / float(reduce_array(self.comm, (direction * change).sum()))
            difference[:, :count] += length * direction
            descent -= length * change
            lowered = length * slope
            square, total = square - lowered, total + lowered

    def error(
        self, dual: DualProgram, multipliers: Array, u: fem.Function, gain: float = GAIN
    ) -> GuaranteedError:
        """Return a guaranteed bound of the error of a solution, with one solve with K. Collective.

        Args:
            dual: the dual problem that was solved.
            multipliers: (size,) multipliers of the solution.
            u: the displacement of the solution.
            gain: part of the bound by which a step must lower it, or the steps end.

        Raises:
            InputError: the bound does not cover the problem.
            ContactError: the displacement is not in equilibrium.
        """
        candidate = self.candidate(dual, multipliers, u, self.linear.ufl_forms[1])
        of_u, of_v = self.stress_data(u), self.stress_data(candidate.v)
        distance = self.distance(candidate, candidate.v, of_v, gain)
        moved = self.energies.squared_norms(of_u - of_v)
        # the mean of both stresses is the centre of a ball that contains the exact stress
        from_centre = self.energies.squared_norms(of_u - of_v - 0.5 * distance.difference)
        by_cell = (distance.stress + distance.oscillation) ** 2
        squares = by_cell, distance.stress**2, distance.oscillation**2, moved, from_centre
        terms = *squares, distance.complementarity, distance.friction
        *sums, complementarity, friction = reduce_array(self.comm, [term.sum() for term in terms])
        eta, stress, oscillation, lift, offset = map(float, np.sqrt(sums))
        gap = max(float(complementarity + friction), 0.0)
        error_of_v = 0.5 * eta + np.sqrt(0.25 * eta**2 + gap)
        radius = np.sqrt(0.25 * stress**2 + gap + oscillation * error_of_v)
        error, norm = float(min(error_of_v + lift, offset + radius)), dual.norm_of(u)
        cell_errors = fem.Function(
            fem.functionspace(self.V.mesh, ("DG", 0)), name="guaranteed_cell_errors"
        )
        lack = np.maximum(distance.complementarity + distance.friction, 0.0)
        dofs = cell_errors.function_space.dofmap.list[: len(lack), 0]
        cell_errors.x.array[dofs] = np.sqrt(by_cell + 2.0 * lack + moved)
        cell_errors.x.scatter_forward()
        return GuaranteedError(
            error=error,
            relative_error=error / norm if norm > 0.0 else float("inf"),
            cell_errors=cell_errors,
            stress=stress,
            oscillation=oscillation,
            complementarity=float(complementarity),
            friction=float(friction),
            lift=lift,
        )


@dataclass(frozen=True)
class GuaranteedGoal:
    """A proven interval that contains the value of a goal in the exact solution.

    It is of the goal's unit, and proven up to rounding. See `GuaranteedError` for what the exact
    solution is.

    Attributes:
        lower: the least possible value.
        upper: the largest possible value.
        value: the value in the computed solution, usually inside.
    """

    lower: float
    upper: float
    value: float

    def __repr__(self) -> str:
        return f"<GuaranteedGoal: from {self.lower:.6g} to {self.upper:.6g}>"


@dataclass(frozen=True)
class Functional:
    """A goal that is linear in the displacement v, as J(v) or, for a force, a(w, v) - L(w).

    Attributes:
        form: the linear form: J, or a(w, v).
        derivative: the form's vector.
        w: the displacement with which tractions do the work that is the force; None: no force.
        constant: L(w).
    """

    form: ufl.Form
    derivative: fem.Function
    w: fem.Function | None = None
    constant: float = 0.0

    @classmethod
    def of_goal(cls, goal: Any, bodies: Bodies, dual: DualProgram) -> Functional:
        """Check a goal. Collective.

        Raises:
            InputError: the goal is neither a force nor a linear form, or slip bounds depend on
                pressures.
        """
        fixed_bounds = dual.admissible.has_given_bounds
        require(
            bodies.comm,
            fixed_bounds,
            "slip bounds that do not depend on the pressure if it is of a goal",
        )
        linear, pairs = bodies.linear, dual.jump.by_pair
        test, trial = linear.ufl_forms[0].arguments()
        if isinstance(goal, ufl.Form):
            if [argument.ufl_function_space() for argument in goal.arguments()] != [bodies.V]:
                raise InputError("a goal must be a linear form on the space of the displacement.")
            form = ufl.replace(goal, {goal.arguments()[0]: test})
            return cls(form, assembled(form, bodies.V, linear.entity_maps))
        if not isinstance(goal, ContactForce | NormalForce):
            raise InputError(
                "a goal with guaranteed bounds must be a NormalForce, a ContactForce or a linear "
                f"form such as ufl.inner(direction, ufl.TestFunction(V)) * ds, found {shown(goal)}."
            )
        pair = pairs[checked_goal(goal, len(pairs), bodies.cells.d).pair].operators
        w = fem.Function(bodies.V)
        direction = -pair.normals if isinstance(goal, NormalForce) else goal.direction
        w.x.array.reshape(-1, bodies.cells.d)[pair.nodes] = direction
        w.x.array[: len(linear.prescribed)][linear.prescribed] = 0.0
        w.x.scatter_forward()
        form = ufl.replace(linear.ufl_forms[0], {trial: w})
        derivative = assembled(form, bodies.V, linear.entity_maps)
        return cls(form, derivative, w, _work(linear.assemble_forces(), w))

    def response(self, bodies: Bodies, dual: DualProgram) -> fem.Function:
        """Return the displacement that the goal causes as a load, without contact. Collective."""
        if self.w is not None:
            return self.w
        result, force = fem.Function(bodies.V), self.derivative.copy()
        force.x.array[: len(bodies.linear.prescribed)][bodies.linear.prescribed] = 0.0
        solver = dual.compliance.solver
        solver.improve(force.x.petsc_vec, result.x.petsc_vec, rtol=0.1, accuracy=0.0)
        result.x.scatter_forward()
        return result

    def value(self, v: fem.Function) -> float:
        """Return the value for a displacement. Collective."""
        return _work(self.derivative, v) - self.constant


def _work(force: fem.Function, v: fem.Function) -> float:
    """Return the work of forces on a displacement. Collective."""
    work = (owned_values(force) * owned_values(v)).sum()
    return float(reduce_array(v.function_space.mesh.comm, work))


def guaranteed_goal(
    functional: Functional,
    bodies: Bodies,
    dual: DualProgram,
    u: fem.Function,
    solve: Callable[[float], Candidate],
    gain: float,
) -> GuaranteedGoal:
    """Return an interval that contains the value in the exact solution. Collective.

    For all t > 0, all admissible stresses s in equilibrium with the load L + t J, and all v that do
    not penetrate, J(u*) - J(v) <= (|s - s(v)|^2 / 4 + G) / t, with the integral G of what both lack
    of the law of contact; v is taken from the load L - t J (docs/theory/guaranteed.md). With a
    small t the errors count much, with a large one contact changes, and G is large.

    Args:
        functional: the goal.
        bodies: the bodies.
        dual: the dual problem that was solved.
        u: the displacement.
        solve: function that returns the candidate with the load L + t J; it is collective.
        gain: part of a distance by which a step must lower it, or the steps end.

    Raises:
        InputError: the bound does not cover the problem.
        ContactError: a displacement is not in equilibrium.
    """
    of_w = 0.0 if functional.w is None else bodies.stress_data(functional.w)

    def limits_at(t: float) -> Array:
        """Return upper limits (2,) of J and -J."""
        candidates, result = {sign: solve(sign * t) for sign in (1.0, -1.0)}, []
        for sign, candidate in candidates.items():
            v = candidates[-sign].v
            target = bodies.stress_data(v) - sign * t * of_w
            distance = bodies.distance(candidate, v, target, gain)
            eta = distance.stress + distance.oscillation
            lack = distance.complementarity + distance.friction
            square, gap = reduce_array(bodies.comm, [0.25 * (eta**2).sum(), lack.sum()])
            result.append(sign * functional.value(v) + (square + max(gap, 0.0)) / t)
        return np.array(result)

    start = dual.norm_of(u) / dual.norm_of(functional.response(bodies, dual))
    best = limits_at(start)
    for factor in (1.0 / STEP, STEP):
        t, narrower = start, True
        while narrower and abs(np.log(t / start)) < MOST_STEPS * np.log(STEP):
            t *= factor
            limits = limits_at(t)
            narrower = bool(limits.sum() < best.sum())
            best = np.minimum(best, limits)
        if t < start / STEP:
            break
    return GuaranteedGoal(-float(best[1]), float(best[0]), functional.value(u))
