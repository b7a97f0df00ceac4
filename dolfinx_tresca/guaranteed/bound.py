"""Guaranteed bounds of the error of the displacement, and of a goal from both sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.functions import assembled, zero_like
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.guaranteed.cells import MeshCells, StressEnergies, rigid_motions
from dolfinx_tresca.guaranteed.contact import ContactSurface
from dolfinx_tresca.guaranteed.forms import elasticity, loads
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
STEP, LARGEST_POWER = 4.0, 3


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
    """Tractions, a stress and a displacement that bound the exact solution of a load.

    Attributes:
        surfaces: the contact surfaces, with admissible tractions.
        v: a displacement that does not penetrate.
        loading: (n, d + 1, d + 1, d) loading of a stress in equilibrium with the load and the
            tractions of `surfaces`.
        oscillation: (n,) bounds of what the load does that `loading` does not balance.
    """

    surfaces: list[ContactSurface]
    v: fem.Function
    loading: Array
    oscillation: Array


class Bodies:
    """The cells of elastic bodies with their stiffnesses, for stresses in equilibrium."""

    def __init__(self, linear: LinearSystem, dual: DualProgram) -> None:
        """Check what the bound covers, and factor the equations of all stars. Collective."""
        self.linear, self.V, self.comm = linear, linear.V, linear.comm
        self.cells = cells = MeshCells.from_space(self.V)
        cells.require(
            linear.component is None and not linear.axisymmetric,
            "displacements in a plane or in space, not mixed spaces or revolution",
        )
        cells.require(
            dual.equilibrium is None,
            "Dirichlet conditions that hold each body; here contact alone holds a body against "
            "some motion",
        )
        self.stiffness = elasticity(linear.ufl_forms[0], cells, linear.entity_maps)
        self.energies = StressEnergies(cells, np.asarray(np.linalg.inv(self.stiffness)))
        self.prescribed = cells.spread(linear.prescribed.reshape(-1, cells.d)) > 0.0
        exterior = dolfinx.mesh.exterior_facet_indices(self.V.mesh.topology)
        inside = ~np.isin(cells.facets, exterior)[:, :, None]
        held = self.prescribed[cells.facet_nodes].all(axis=(2, 3)) & ~inside
        self.unknown = held | inside
        self.stars = Stars(cells, self.energies.of_facets(), self.unknown)
        # facets that are held take any load
        traces = cells.trace_factors * ~held.all(axis=2)
        factors = np.hstack([cells.poincare_factors[:, None], traces])
        self.factors = factors / np.sqrt(np.linalg.eigvalsh(self.stiffness)[:, :1])

    def loading_of(self, w: fem.Function) -> Array:
        """Return the loading of the stress of a displacement."""
        return self.cells.loading_of(self.cells.stresses(w, self.stiffness))

    def response(
        self, dual: DualProgram, forces: fem.Function, u: fem.Function, rtol: float
    ) -> fem.Function:
        """Return the displacement that forces cause beyond u, with one solve with K. Collective."""
        result = zero_like(u, "response")
        residual = self.linear.residual_of(forces.x.petsc_vec, u.x.petsc_vec)
        dual.compliance.solver.improve(residual, result.x.petsc_vec, rtol=rtol, accuracy=0.0)
        residual.destroy()
        result.x.scatter_forward()
        return result

    def candidate(
        self, dual: DualProgram, multipliers: Array, u: fem.Function, L: ufl.Form | None
    ) -> Candidate:
        """Return the candidate of the load L; this takes one solve with K. Collective.

        The tractions on the boundary are given, or follow from the multipliers (size,) of the dual
        problem that was solved; others come from the displacement for these, and are corrected star
        by star.
        """
        cells, d = self.cells, self.cells.d
        given, oscillation = loads(L, cells, self.factors, self.linear.entity_maps)
        at_solution = dual.section_at(multipliers, dual.gradient_of(u.x.petsc_vec))
        areas = np.concatenate([pair.weights for pair in dual.jump.pairs])
        bounds = at_solution.radius[: len(areas)] / np.sqrt(areas)
        surfaces = [
            ContactSurface(cells, dual, number, multipliers, bounds, self.prescribed)
            for number in range(len(dual.jump.pairs))
        ]
        v, force = u.copy(), zero_like(u, "force")
        for surface in surfaces:
            surface.lift(v)
            for cell, facet, tractions in surface.sides:
                given[cell, facet, :d] += tractions
        force.x.array[:] = cells.nodal_forces(given).ravel()
        balanced = self.response(dual, force, u, rtol=1e-12)
        balanced.x.array[:] += u.x.array
        discrete, of_v = (cells.stresses(w, self.stiffness) for w in (balanced, v))
        approximate = self.unknown[:, :, None] & (np.arange(d + 1) < d)[:, None]
        loading = np.where(approximate, cells.loading_of(discrete), given)
        # a body may be free of forces where v, of another load, is not
        forces, forces_of_v = map(cells.internal_forces, (discrete, of_v))
        loading = self.stars.equilibrated(loading, forces)
        arms = (cells.points - cells.points[:, :1]) / cells.heights.max(axis=1)[:, None, None]
        lacking = np.einsum("nrkd,nkd->nr", rigid_motions(arms), cells.resultants(loading))
        largest = [np.abs(field).max(initial=0.0) for field in (lacking, forces, forces_of_v)]
        missing, *sizes = reduce_array(self.comm, largest, MPI.MAX)
        if not missing <= IMBALANCE * max(sizes):  # NaN fails, too
            raise ContactError(
                f"the displacement is not in equilibrium: on a cell, forces of {missing:.1e} are "
                f"missing, where forces on cells are up to {max(sizes):.1e}. A displacement that "
                "is prescribed at a point, and not on facets, cannot hold a force."
            )
        return Candidate(surfaces, v, loading, oscillation)

    def defects(self, surfaces: Sequence[ContactSurface], v: fem.Function) -> Array:
        """Return the defects of tractions and a displacement in the law of contact. Collective.

        The (2, n) integrals over the facets of cells [energy] are those of pressure times gap, and
        of what the work of friction lacks of its bound.
        """
        result = np.zeros((2, len(self.unknown)))
        largest = reduce_array(self.comm, np.abs(v.x.array).max(initial=0.0), MPI.MAX)
        for surface in surfaces:
            *defects, deepest = surface.defects(v)
            for total, defect in zip(result, defects, strict=True):
                np.add.at(total, surface.cell, defect)
            self.cells.require(
                deepest <= PENETRATION * largest,
                "an exact solution, and prescribed displacements penetrate at contact pair "
                f"{surface.pair}",
            )
        return result

    def shorten(self, difference: Array, gain: float) -> None:
        """Add tractions without resultants that make a stress smaller, in place. Collective.

        `difference` is its loading; the steps end if one lowers its norm by less than the part
        `gain`.
        """
        descent = -self.energies.derivative(difference)
        square = -float(reduce_array(self.comm, (difference * descent).sum()))
        direction, previous, lowered, total = np.zeros_like(descent), np.inf, square, 0.0
        # for goals the distance is large by itself, and its decrease tells more
        while lowered > gain * min(total, 2.0 * square) and square > 0.0:
            step = self.stars.preconditioned(descent)
            slope = float(reduce_array(self.comm, (step * descent).sum()))
            if not slope > 0.0:
                break
            direction = step + slope / previous * direction
            previous = slope
            change = self.energies.derivative(direction)
            length = slope / float(reduce_array(self.comm, (direction * change).sum()))
            difference += length * direction
            descent -= length * change
            lowered = length * slope
            square, total = square - lowered, total + lowered

    def error(
        self, dual: DualProgram, multipliers: Array, u: fem.Function, gain: float = GAIN
    ) -> GuaranteedError:
        """Return a guaranteed bound of the error of a solution, with one solve with K. Collective.

        The solution of the dual problem has multipliers (size,) and the displacement u.
        """
        candidate = self.candidate(dual, multipliers, u, self.linear.ufl_forms[1])
        of_u, of_v = self.loading_of(u), self.loading_of(candidate.v)
        defects = self.defects(candidate.surfaces, candidate.v)
        difference = candidate.loading - of_v
        self.shorten(difference, gain)
        # the mean of both stresses is the centre of a ball that contains the exact stress
        stresses = difference, of_u - of_v, of_u - of_v - 0.5 * difference
        square, moved, from_centre = map(self.energies.squared_norms, stresses)
        by_cell = (np.sqrt(square) + candidate.oscillation) ** 2
        terms = by_cell, square, candidate.oscillation**2, moved, from_centre, *defects
        *sums, complementarity, friction = reduce_array(self.comm, [term.sum() for term in terms])
        eta, stress, oscillation, lift, offset = map(float, np.sqrt(sums))
        defect = max(float(complementarity + friction), 0.0)  # of the conditions of contact
        # the larger root e of e^2 = eta e + defect
        error_of_v = 0.5 * eta + np.sqrt(0.25 * eta**2 + defect)
        radius = np.sqrt(0.25 * stress**2 + defect + oscillation * error_of_v)
        error, norm = float(min(error_of_v + lift, offset + radius)), dual.norm_of(u)
        constants = fem.functionspace(self.V.mesh, ("DG", 0))
        cell_errors = fem.Function(constants, name="guaranteed_cell_errors")
        dofs = constants.dofmap.list[: len(moved), 0]
        lack = np.maximum(defects.sum(axis=0), 0.0)
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
        form: the linear form: J, or a(w, v); `derivative` is its vector.
        w: the displacement that the form causes as a load, without contact; exact for a force.
        is_force: whether the goal is a force, the work of tractions on w.
        constant: L(w).
    """

    form: ufl.Form
    derivative: fem.Function
    w: fem.Function
    is_force: bool
    constant: float = 0.0

    @classmethod
    def of_goal(cls, goal: Any, bodies: Bodies, dual: DualProgram) -> Functional:
        """Check a goal. Collective."""
        bodies.cells.require(
            dual.admissible.has_given_bounds,
            "slip bounds that do not depend on the pressure if it is of a goal",
        )
        linear, pairs = bodies.linear, dual.jump.by_pair
        test, trial = linear.ufl_forms[0].arguments()
        if isinstance(goal, ufl.Form):
            if [argument.ufl_function_space() for argument in goal.arguments()] != [bodies.V]:
                raise InputError("a goal must be a linear form on the space of the displacement.")
            form = ufl.replace(goal, {goal.arguments()[0]: test})
            derivative = assembled(form, bodies.V, linear.entity_maps)
            w = bodies.response(dual, derivative, fem.Function(bodies.V), rtol=0.1)
            return cls(form, derivative, w, is_force=False)
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
        forces = linear.assemble_forces()
        constant = float(forces.x.petsc_vec.dot(w.x.petsc_vec))
        return cls(form, derivative, w, is_force=True, constant=constant)

    def value(self, v: fem.Function) -> float:
        """Return the value for a displacement. Collective."""
        return float(self.derivative.x.petsc_vec.dot(v.x.petsc_vec)) - self.constant


def guaranteed_goal(
    functional: Functional,
    bodies: Bodies,
    dual: DualProgram,
    u: fem.Function,
    candidate_at: Callable[[float], Candidate],
    gain: float,
) -> GuaranteedGoal:
    """Return an interval that contains the value in the exact solution. Collective.

    For all t > 0, all admissible stresses s in equilibrium with the load L + t J, and all v that do
    not penetrate, J(u*) - J(v) <= (|s - s(v)|^2 / 4 + G) / t, with the integral G of what both lack
    of the law of contact; v is taken from the load L - t J (docs/theory/guaranteed.md). With a
    small t the errors count much, with a large one contact changes, and G is large.

    The collective function `candidate_at` returns the candidate with the load L + t J; if the goal
    is a force, its `loading` balances L alone. For `gain` see `Bodies.shorten`.
    """
    of_w = bodies.loading_of(functional.w) if functional.is_force else 0.0

    def limits_at(t: float) -> Array:
        """Return upper limits (2,) of J and -J; their sum is the width of the interval."""
        candidates, result = {sign: candidate_at(sign * t) for sign in (1.0, -1.0)}, []
        for sign, candidate in candidates.items():
            v = candidates[-sign].v
            # the stress of `functional.w` balances the load t J of a force
            difference = candidate.loading - bodies.loading_of(v) + sign * t * of_w
            defects = bodies.defects(candidate.surfaces, v)
            bodies.shorten(difference, gain)
            eta = np.sqrt(bodies.energies.squared_norms(difference)) + candidate.oscillation
            square, defect = reduce_array(bodies.comm, [0.25 * (eta**2).sum(), defects.sum()])
            result.append(sign * functional.value(v) + (square + max(defect, 0.0)) / t)
        return np.array(result)

    start = dual.norm_of(u) / dual.norm_of(functional.w)
    best = limits_at(start)
    for factor in (1.0 / STEP, STEP):
        for power in range(1, LARGEST_POWER + 1):
            limits = limits_at(start * factor**power)
            is_narrower = limits.sum() < best.sum()
            best = np.minimum(best, limits)
            if not is_narrower:
                break
        if power > 1:  # smaller t narrowed the interval: larger ones would not
            break
    return GuaranteedGoal(-float(best[1]), float(best[0]), functional.value(u))
