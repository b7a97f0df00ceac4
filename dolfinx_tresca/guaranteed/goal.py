"""Guaranteed bounds of a goal from both sides: of a force, or a mean displacement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.functions import assembled, owned_values
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.guaranteed.bound import Bodies, Candidate
from dolfinx_tresca.guaranteed.mesh_cells import require
from dolfinx_tresca.scene.pair import ContactForce, NormalForce, checked_goal

#: Factor by which the size of the change of the load is varied as long as the interval shrinks, and
#: largest power of it.
STEP, MOST_STEPS = 4.0, 3


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
        solver = dual.operator.solver
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
