"""Guaranteed bounds of the error of the displacement, and of a goal from both sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.functions import assembled, owned_values, with_owned_values, zero_like
from dolfinx_tresca._base.parallel import largest_abs, reduce_array, summed_at_nodes
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.guaranteed.cells import MeshCells, StressEnergies, bernstein, rigid_motions
from dolfinx_tresca.guaranteed.contact import ContactSurface
from dolfinx_tresca.guaranteed.forms import elasticity, loads
from dolfinx_tresca.guaranteed.stars import Stars
from dolfinx_tresca.scene.pair import ContactForce, NormalForce, checked_goal
from dolfinx_tresca.stiffness.system import LinearSystem

#: Force missing on a cell, relative to the largest force on a facet, that still counts as rounding.
IMBALANCE = 1e-7
#: Least relative decrease of the bound by a step of conjugate gradients: after a smaller one they
#: end. With half of it the bound is 2 % smaller, for up to one and a half times as many steps.
GAIN = 0.02
#: Tried changes t J of the load, as |t w| / |u|: where contact changes, smaller ones are better.
MULTIPLES = (0.0625, 0.25, 1.0, 4.0)


@dataclass(frozen=True)
class GuaranteedError:
    """A proven bound of |u - u*|, where u* is the exact solution on the domain of the mesh.

    The norm is the energy norm, |v|^2 = a(v, v). The bound is proven up to rounding. u* solves
    Tresca's problem with gaps and slip bounds that are linear between contact nodes; slip bounds
    that depend on the pressure have the values that belong to the computed solution.

    Attributes:
        error: bound of |u - u*| [energy^(1/2)].
        relative_error: `error` divided by |u|; infinite if u is zero.
        cell_errors: a value of each cell [energy^(1/2)], for `refine`. The root of the sum of their
            squares is at least `error`, and hardly larger if `lift` and contact's terms are small.
        stress: |s - s(v)| for a stress s in equilibrium and the stress of v [energy^(1/2)].
        oscillation: root of the sum of squares of what loads add that are not linear in cells or on
            facets, since s balances only their linear projections [energy^(1/2)].
        complementarity: integral of the pressure times the gap that v leaves [energy].
        friction: integral of slip bound times slip of v, minus the work of friction [energy].
        lift: |u - v|, the distance of u from a displacement v that does not penetrate, and has no
            gap at nodes under pressure [energy^(1/2)].
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
        share = f"{self.relative_error:.1%} of the displacement's energy norm"
        return f"<GuaranteedError: at most {self.error:.3e}, {share}>"


class Candidate(NamedTuple):
    """A stress and a displacement whose distance bounds errors, as any such two do.

    Attributes:
        loading: (n, d + 1, d + 1, d) loading that balances the load; it stands for the stress.
        v: a displacement that does not penetrate.
        surfaces: the contact surfaces with their tractions, which `loading` contains.
    """

    loading: Array
    v: fem.Function
    surfaces: list[ContactSurface]


class Bodies:
    """The elastic bodies as n cells of this rank with d + 1 vertices, for guaranteed bounds.

    Attributes:
        stiffness: (n, d * d, d * d) elasticity tensors of the cells.
        unknown: (n, d + 1, d) whether no load determines a component of the traction on a facet:
            inside the body, or where this component is prescribed at all nodes of the facet.
        factors: (n, d + 2) bounds of the work of loads, see `forms.loads`.
        load: (n, d + 1, d + 1, d) loading of L; `oscillation` (n,) bounds the work of its error.
    """

    def __init__(self, linear: LinearSystem, dual: DualProgram) -> None:
        """Check what the bound covers, and factor the equations of all stars. Collective."""
        self.linear, self.V, self.comm = linear, linear.V, linear.comm
        self.cells = cells = MeshCells(self.V)
        cells.require(
            linear.component is None and not linear.axisymmetric,
            "displacements in a plane or in space, not mixed spaces or revolution",
        )
        cells.require(
            dual.equilibrium is None,
            "Dirichlet conditions that hold bodies; here contact alone holds one against a motion",
        )
        (a, L), maps = linear.ufl_forms, linear.entity_maps
        self.stiffness, inverse, least = elasticity(a, cells, maps)
        self.energies = StressEnergies(cells, inverse)
        prescribed = cells.spread(linear.prescribed.reshape(-1, cells.d)) > 0.0
        held = prescribed[cells.facet_nodes].all(axis=(2, 3))
        self.unknown = held | (cells.sides[cells.facets, 0] == 2.0)
        self.stars = Stars(cells, self.energies.of_facets(), self.unknown)
        self.factors = cells.load_factors() / np.sqrt(least)[:, None]
        self.factors[:, 1:] *= ~held.all(axis=2)  # loads on held facets do no work
        self.load, self.oscillation = loads(L, cells, self.factors, maps)

    def loading_of(self, w: fem.Function) -> Array:
        """Return the loading (n, d + 1, d + 1, d) of the stress C eps(w) of a displacement w."""
        cells, (n, corners, d) = self.cells, self.cells.points.shape
        # the sum of C_ij lambda_i lambda_j has at vertex i the gradient sum of 2 C_ij grad lambda_j
        coefficients = 2.0 * np.swapaxes(bernstein(w.x.array.reshape(-1, d)[cells.nodes]), 2, 3)
        slopes = coefficients.reshape(n, corners * d, corners) @ cells.gradients
        stresses = slopes.reshape(n, corners, d * d) @ self.stiffness
        return cells.to_loading(stresses.reshape(n, corners, d, d))

    def response(self, dual: DualProgram, forces: fem.Function, rtol: float) -> fem.Function:
        """Return the displacement that nodal forces alone cause, by a solve with K. Collective."""
        w, free = zero_like(forces, "response"), forces.copy()
        owned_values(free)[self.linear.prescribed.reshape(-1, self.cells.d)] = 0.0
        dual.compliance.solver.improve(free.x.petsc_vec, w.x.petsc_vec, rtol=rtol, accuracy=0.0)
        w.x.scatter_forward()
        return w

    def candidate(
        self, dual: DualProgram, multipliers: Array, u: fem.Function, load: Array
    ) -> Candidate:
        """Return the candidate of a load (n, d + 1, d + 1, d), with one solve with K. Collective.

        It is built from a solution for this load or for a similar one: multipliers (size,) and u.
        """
        cells, d, given = self.cells, self.cells.d, load.copy()
        # contact surfaces give tractions, and move u so that it does not penetrate
        at_solution = dual.section_at(multipliers, dual.gradient_of(u.x.petsc_vec))
        areas = np.concatenate([pair.weights for pair in dual.jump.pairs])
        bounds = at_solution.radius[: len(areas)] / np.sqrt(areas)
        numbers = range(len(dual.jump.pairs))
        surfaces = [ContactSurface(cells, dual, k, multipliers, bounds) for k in numbers]
        v = u.copy()
        for surface in surfaces:
            surface.lift(v)
            for cell, facet, tractions in surface.sides:
                given[cell, facet, :d] += tractions
        # the stress of u does not balance `given`: the forces at vertices that it lacks act in one
        # more solve, with whose stress `discrete` balances hat functions, for any degree of V
        of_u = self.loading_of(u)
        unbalanced = cells.resultants(given - of_u)  # (n, d + 1, d)
        vertices = np.einsum("nkk->nk", cells.nodes)  # nodes[n, k, k] is at vertex k
        lacking = zero_like(u, "force")
        lacking.x.array[:] = summed_at_nodes(self.V.dofmap.index_map, vertices, unbalanced).ravel()
        discrete = of_u + self.loading_of(self.response(dual, lacking, rtol=1e-12))
        # its tractions take the place of unknown ones; then stars of cells change them, such that
        # each cell is in exact equilibrium
        np.copyto(given[:, :, :d], discrete[:, :, :d], where=self.unknown[:, :, None])
        loading = self.stars.equilibrated(given, discrete)
        self._check_equilibrium(loading, of_u)
        return Candidate(loading, v, surfaces)

    def _check_equilibrium(self, loading: Array, of_u: Array) -> None:
        """Raise ContactError if a loading does not balance in force or moment. Collective.

        Missing forces of cells are compared with the largest on a facet, of the loading or of that
        of the solution, `of_u`: for a goal that is a force, the loading balances L, perhaps zero.
        """
        cells = self.cells
        arms = (cells.points - cells.points[:, :1]) / cells.heights.max(axis=1)[:, None, None]
        lacking = np.einsum("nrkd,nkd->nr", rigid_motions(arms), cells.resultants(loading))
        largest = np.maximum(np.abs(loading), np.abs(of_u))[:, :, : cells.d]
        lack, size = largest_abs(self.comm, lacking, cells.areas[:, :, None, None] * largest)
        if not lack <= IMBALANCE * size:  # NaN fails, too
            raise ContactError(
                f"the displacement is not in equilibrium: on a cell, forces of {lack:.1e} are "
                f"missing, where forces on facets are up to {size:.1e}. A displacement that "
                "is prescribed at a point, and not on facets, cannot hold a force."
            )

    def defects(self, surfaces: Sequence[ContactSurface], v: fem.Function) -> Array:
        """Return the sums (n, 2) of `ContactSurface.defects` [energy] in each cell. Collective."""
        result = np.zeros((len(self.unknown), 2))
        for surface in surfaces:
            np.add.at(result, surface.cell, surface.defects(v))
        return result

    def shorten(self, difference: Array, gain: float) -> None:
        """Lower the norm of a stress by tractions that leave cells in equilibrium. Collective.

        The loading `difference` stands for the stress, and is changed in place by conjugate
        gradient steps, preconditioned by `Stars`. They end when a step lowers the squared norm by
        at most 2 `gain` times this square, so the norm by the part `gain`; or, if that is less, by
        at most `gain` times its decrease so far, since for goals the least norm itself is large.
        """
        descent = -self.energies.derivative(difference)  # minus half the derivative of the square
        square = -float(reduce_array(self.comm, (difference * descent).sum()))
        direction, previous, lowered, total = np.zeros_like(descent), np.inf, square, 0.0
        while lowered > gain * min(total, 2.0 * square) and square > 0.0:
            step = self.stars.preconditioned(descent)
            slope = float(reduce_array(self.comm, (step * descent).sum()))
            if not slope > 0.0:
                break
            direction, previous = step + slope / previous * direction, slope
            change = self.energies.derivative(direction)
            length = slope / float(reduce_array(self.comm, (direction * change).sum()))
            difference += length * direction
            descent -= length * change
            lowered = length * slope
            square, total = square - lowered, total + lowered

    def error(
        self, dual: DualProgram, multipliers: Array, u: fem.Function, gain: float = GAIN
    ) -> GuaranteedError:
        """Return a bound of the error of a solution, with one solve with K. Collective.

        Without contact and oscillation, the exact stress is in a ball round the mean of the
        candidate's stresses s and s(v), with the radius |s - s(v)| / 2; both enlarge the ball.
        """
        loading, v, surfaces = self.candidate(dual, multipliers, u, self.load)
        of_u, of_v, defects = self.loading_of(u), self.loading_of(v), self.defects(surfaces, v)
        difference = loading - of_v
        self.shorten(difference, gain)
        # squared norms of s - s(v), of the distance of s(u) from the mean, and of s(u) - s(v)
        stresses = difference, of_u - of_v - 0.5 * difference, of_u - of_v
        square, from_mean, moved = map(self.energies.squared_norms, stresses)
        eta_squares = (np.sqrt(square) + self.oscillation) ** 2
        offset_squares = (np.sqrt(from_mean) + 0.5 * self.oscillation) ** 2
        terms = eta_squares, offset_squares, square, self.oscillation**2, moved, *defects.T
        *squares, complementarity, friction = reduce_array(self.comm, [t.sum() for t in terms])
        eta, offset, stress, oscillation, lift = map(sqrt, squares)
        error = offset + sqrt(0.25 * eta**2 + max(complementarity + friction, 0.0))
        norm = dual.norm_of(u)
        relative_error = error / norm if norm > 0.0 else float("inf")
        constants = fem.functionspace(self.V.mesh, ("DG", 0))
        roots = np.sqrt(2.0 * (offset_squares + 0.25 * eta_squares + np.abs(defects.sum(axis=1))))
        cell_errors = with_owned_values(constants, roots, "guaranteed_cell_errors")
        contact = float(complementarity), float(friction), lift
        return GuaranteedError(error, relative_error, cell_errors, stress, oscillation, *contact)


@dataclass(frozen=True)
class GuaranteedGoal:
    """A proven interval that contains the value of a goal in the exact solution.

    Attributes:
        lower: the least possible value [unit of the goal], proven up to rounding.
        upper: the largest possible value.
        value: the value in the computed solution, usually between both.
    """

    lower: float
    upper: float
    value: float

    def __repr__(self) -> str:
        return f"<GuaranteedGoal: from {self.lower:.6g} to {self.upper:.6g}>"


class Functional:
    """A goal that is linear in the displacement v, as J(v) or, for a force, a(w, v) - L(w).

    Attributes:
        form: the linear form of v: J, or a(w, v); `derivative` is its vector.
        w: the displacement that the form causes as a load, without contact. For a force it is a
            unit displacement of the pair's secondary nodes alone; else a rough solve yields it.
        constant: L(w) for a force, else zero.
        load: the loading of J; zero for a force, since the stress of w itself balances a(w, v).
    """

    def __init__(self, goal: Any, bodies: Bodies, dual: DualProgram) -> None:
        """Check a goal, and find its form, w and load. Collective."""
        bodies.cells.require(
            dual.admissible.has_given_bounds,
            "slip bounds that do not depend on the pressure if it is of a goal",
        )
        self._bodies, self._dual, linear = bodies, dual, bodies.linear
        test, trial = linear.ufl_forms[0].arguments()
        is_force, self.constant = isinstance(goal, ContactForce | NormalForce), 0.0
        arguments = goal.arguments() if isinstance(goal, ufl.Form) else []
        if is_force:
            pairs = dual.jump.by_pair
            operators = pairs[checked_goal(goal, len(pairs), bodies.cells.d).pair].operators
            self.w, forces = fem.Function(bodies.V), linear.assemble_forces()
            direction = -operators.normals if isinstance(goal, NormalForce) else goal.direction
            self.w.x.array.reshape(-1, bodies.cells.d)[operators.nodes] = direction
            self.w.x.array[: len(linear.prescribed)][linear.prescribed] = 0.0
            self.w.x.scatter_forward()
            self.constant = float(forces.x.petsc_vec.dot(self.w.x.petsc_vec))
            self.form = ufl.replace(linear.ufl_forms[0], {trial: self.w})
        elif [argument.ufl_function_space() for argument in arguments] == [bodies.V]:
            self.form = ufl.replace(goal, dict(zip(arguments, [test], strict=True)))
        else:
            raise InputError(
                "a goal with guaranteed bounds must be a NormalForce, a ContactForce or a linear "
                "form on the space of the displacement, such as "
                f"ufl.inner(direction, ufl.TestFunction(V)) * ds, found {shown(goal)}."
            )
        self.derivative = assembled(self.form, bodies.V, linear.entity_maps)
        if not is_force:
            self.w = bodies.response(dual, self.derivative, rtol=0.1)
        if dual.norm_of(self.w) == 0.0:
            raise InputError("no free displacement changes the goal: check its tag and direction.")
        self._stress = bodies.loading_of(self.w) if is_force else 0.0
        L = None if is_force else self.form
        self.load, self._oscillation = loads(L, bodies.cells, bodies.factors, linear.entity_maps)

    def value(self, v: fem.Function) -> float:
        """Return the goal's value for a displacement [unit of the goal]. Collective."""
        return float(self.derivative.x.petsc_vec.dot(v.x.petsc_vec)) - self.constant

    def interval(
        self, u: fem.Function, size: float, candidate_at: Callable[[float], Candidate], gain: float
    ) -> GuaranteedGoal:
        """Return an interval that contains the value in the exact solution. Collective.

        Without oscillation, t J(u*) - t J(v) <= |s - s(v)|^2 / 4 + G, with s of the load L + t J
        and v of L - t J: an upper limit if t > 0, else a lower one. If t is small, errors divided
        by t are large; if t is large, contact changes, and its defects G are large. `size` is |u|
        or, if u is zero, the bound of its error, which is zero if u is exact. `candidate_at` gives
        the candidate of L + t J; if the goal is a force, its `loading` balances L alone.
        """
        bodies, limits = self._bodies, []
        if size == 0.0:
            return GuaranteedGoal(*[self.value(u)] * 3)
        scale = size / self._dual.norm_of(self.w)
        changes = [sign * multiple * scale for multiple in MULTIPLES for sign in (1.0, -1.0)]
        candidates = {t: candidate_at(t) for t in changes}
        for t, candidate in candidates.items():
            v = candidates[-t].v
            difference = candidate.loading - bodies.loading_of(v) + t * self._stress
            bodies.shorten(difference, gain)
            eta = np.sqrt(bodies.energies.squared_norms(difference))
            eta += bodies.oscillation + abs(t) * self._oscillation
            defects = bodies.defects(candidate.surfaces, v)
            square, defect = reduce_array(bodies.comm, [(eta**2).sum(), defects.sum()])
            limits.append(self.value(v) + float(0.25 * square + max(defect, 0.0)) / t)
        return GuaranteedGoal(max(limits[1::2]), min(limits[::2]), self.value(u))
