"""The operators for rigid obstacles a little before and after their place, and differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import carried_residuals
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.solution.goal_error import weights_of

if TYPE_CHECKING:
    from dolfinx_tresca.solution.gradient import SolvedStep

#: Largest difference of the directions of rows on both sides that is a small change.
TURNED = 0.05


@dataclass(frozen=True)
class JumpsBeside(PetscOwner):
    """B for places of obstacles on both sides of the present one along a change.

    The contact of nodes with an obstacle depends on its place by gaps, normals and tangents, whose
    central differences have relative errors of some 1e-10. No solution is involved in them.

    Owns both operators: call `destroy()`.

    Attributes:
        after: B at the present place plus `step` times the change.
        before: B at the present place minus that.
        step: factor of the change.
        bounds: slip bounds at the nodes of each pair.
        present: B at the present place.
        origin: (size,) origin of the slip over `JumpOperator.length_scale`, a vector that a change
            of place carries over to other tangents; None: its components remain.
    """

    after: JumpOperator
    before: JumpOperator
    step: float
    bounds: Sequence[NodalBounds]
    present: JumpOperator
    origin: Array | None

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self.after.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self.after.destroy()
        self.before.destroy()

    def are_beside(self, jump: JumpOperator) -> bool:
        """Return whether nodes, areas and rows on this rank are those of B. Not collective."""
        return all(
            np.array_equal(one.nodes, pair.nodes)
            and np.array_equal(one.row_node, pair.row_node)
            and np.allclose(one.weights, pair.weights, rtol=1e-9)
            and (np.abs(one.tangents - pair.tangents) <= TURNED).all()
            for side in (self.after, self.before)
            for one, pair in zip(side.pairs, jump.pairs, strict=True)
        )

    def difference(self, of: Callable[[JumpOperator], Any]) -> Any:
        """Return the derivative of what a function computes from B along the change."""
        return (of(self.after) - of(self.before)) / (2.0 * self.step)

    def offset(self, u: fem.Function) -> Array:
        """Return the change (size,) of (d; s) - B u. Collective."""
        result = self.difference(lambda jump: jump.gap - jump.of_displacement(u))
        if self.origin is not None:
            origin, present = self.origin, self.present
            result += self.difference(lambda jump: carried_residuals(origin, present, jump))
        return np.asarray(result)

    def traction(self, pair: int, rows: slice, x: Array) -> Array:
        """Return the change (n, d) of the tractions of a pair with their tangents [stress]."""

        def vectors(jump: JumpOperator) -> Array:
            return jump.pairs[pair].tangential_vectors((x * jump.stress_scale)[rows])

        return np.asarray(self.difference(vectors))

    def slip(self, pair: int, rows: slice, slip: Array) -> Array:
        """Return the change (n, d) of the slip of a pair with its tangents [length].

        Args:
            pair: number of the pair.
            rows: positions of the pair's tangential multipliers.
            slip: (size,) slip over `JumpOperator.length_scale`.
        """

        def vectors(jump: JumpOperator) -> Array:
            return jump.pairs[pair].tangential_vectors((slip * jump.length_scale)[rows])

        return np.asarray(self.difference(vectors))

    def force(self, x: Array) -> Array:
        """Return the change of -B'x [force] with B, for fixed x, on owned dofs. Collective."""
        return np.asarray(-self.difference(lambda jump: np.array(jump.whole_force(x).array)))

    def radius(self, x: Array) -> Array:
        """Return the change (n_discs,) of the discs' radii at the pressures of x. Collective."""
        radii = [jump.bounded(self.bounds).section(x).radius for jump in (self.after, self.before)]
        known = np.isfinite(radii[0]) & np.isfinite(radii[1])
        one, two = (np.where(known, each, 0.0) for each in radii)
        return np.asarray((one - two) / (2.0 * self.step))

    def of(self, u: fem.Function) -> tuple[Array, Array]:
        """Return B u (size,) after and before. Collective."""
        return self.after.of_displacement(u), self.before.of_displacement(u)

    def goal(self, goal: Goal, x: Array, jumps: tuple[Array, Array]) -> float:
        """Return the change of a goal by its directions at the nodes. Collective.

        It may be called after `destroy()`.

        Args:
            goal: a goal that is no form.
            x: (size,) multipliers.
            jumps: the result of `of` for the displacement.
        """
        values = []
        for jump, of_u in zip((self.after, self.before), jumps, strict=True):
            on_jump, on_x = weights_of(goal, jump, x)
            inner = jump.reductions.inner
            values.append(float(inner(on_jump, of_u) + inner(on_x, x)))
        return (values[0] - values[1]) / (2.0 * self.step)

    def derivative(
        self,
        step: SolvedStep,
        goals: Sequence[tuple[float, Any]],
        z: fem.Function,
        y: Array,
        radial: Array,
        on_jump: Array,
    ) -> float:
        """Return the derivative of a sum of goals along the change. Collective.

        Args:
            step: the solution.
            goals: factors and goals that are no forms.
            on_jump: (size,) weights of B u, which is added to the goals.
            z: the adjoint displacement.
            y: (size,) the adjoint multipliers.
            radial: (n_discs,) derivatives of the goals by the radii of the discs.
        """
        x, inner = step.multipliers, step.dual.inner
        turned = self.difference(lambda jump: jump.of_displacement(z))
        result = float(inner(y, self.offset(step.u)) - inner(x, turned))
        result += float(inner(radial, self.radius(x)))
        jumps = self.of(step.u)
        result += float(inner(on_jump, jumps[0] - jumps[1])) / (2.0 * self.step)
        return result + sum(weight * self.goal(goal, x, jumps) for weight, goal in goals)


#: Returns B beside the present one for a change of a Constant; None if no obstacle depends on it.
Beside: TypeAlias = "Callable[[fem.Constant, Array], JumpsBeside | None]"
