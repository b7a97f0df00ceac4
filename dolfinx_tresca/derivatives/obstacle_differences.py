"""Derivatives with respect to the position of rigid obstacles, by central differences of B."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.derivatives.goal_error import weights_of
from dolfinx_tresca.derivatives.solved_step import SolvedStep
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import Carry
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.scene.goal import Goal

#: A tangent with displaced obstacles and a tangent with the obstacles where they are count as the
#: same row of T if none of their components differs by more than this number.
TURNED = 0.05


@dataclass(frozen=True)
class ObstacleDifferences(PetscOwner):
    """Central differences of B in a direction in which obstacles are displaced.

    Gaps, normals and tangents at the nodes depend on the position of an obstacle. Their central
    differences have relative errors of some 1e-10, and need no solve.

    Owns the operators `after` and `before`: call `destroy()`.

    Attributes:
        after: B with the obstacles displaced by `step` times the direction.
        before: B with the obstacles displaced by `-step` times the direction.
        step: size of the displacement, as a factor of the direction.
        bounds: slip bounds at the nodes of each pair.
        present: B with the obstacles where they are.
        origin: (size,) slip origin, divided by `JumpOperator.length_scale`, if at each node it is a
            fixed vector, whose components change with the tangents; None: the components of the
            slip origin are constant.
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

    def have_rows_of(self, jump: JumpOperator) -> bool:
        """Return whether both operators have the nodes, areas and rows of B on this rank.

        Otherwise differences of their values have no meaning. Not collective.
        """
        return all(
            np.array_equal(one.nodes, pair.nodes)
            and np.array_equal(one.row_node, pair.row_node)
            and np.allclose(one.weights, pair.weights, rtol=1e-9)
            and (np.abs(one.tangents - pair.tangents) <= TURNED).all()
            for side in (self.after, self.before)
            for one, pair in zip(side.pairs, jump.pairs, strict=True)
        )

    def difference(self, of: Callable[[JumpOperator], Any]) -> Any:
        """Return the directional derivative of a function of B, as a central difference."""
        return (of(self.after) - of(self.before)) / (2.0 * self.step)

    def offset(self, u: fem.Function) -> Array:
        """Return the directional derivative (size,) of (d; s) - B u for fixed u.

        Here d are the gaps and s the slip origins. Collective.
        """
        result = self.difference(lambda jump: jump.gap - jump.of_displacement(u))
        if self.origin is not None:
            origin, present = self.origin, self.present
            result += self.difference(lambda jump: Carry(present, jump).residuals(origin))
        return np.asarray(result)

    def traction(self, pair: int, x: Array) -> Array:
        """Return the directional derivative (n, d) of the tractions of a pair [stress].

        The multipliers are fixed; the tangents change.

        Args:
            pair: number of the pair, from 0 on.
            x: (size,) multipliers, which are tractions divided by `JumpOperator.stress_scale`.
        """

        def vectors(jump: JumpOperator) -> Array:
            rows = jump.by_pair[pair]
            return rows.operators.tangential_vectors((x * jump.stress_scale)[rows.tangential])

        return np.asarray(self.difference(vectors))

    def slip(self, pair: int, slip: Array) -> Array:
        """Return the directional derivative (n, d) of the slip vectors of a pair [length].

        The components of the slip are fixed; the tangents change.

        Args:
            pair: number of the pair, from 0 on.
            slip: (size,) slip, divided by `JumpOperator.length_scale`.
        """

        def vectors(jump: JumpOperator) -> Array:
            rows = jump.by_pair[pair]
            return rows.operators.tangential_vectors((slip * jump.length_scale)[rows.tangential])

        return np.asarray(self.difference(vectors))

    def force(self, x: Array) -> Array:
        """Return the directional derivative of -B'x [force] for fixed x, on this rank's own dofs.

        Collective.
        """
        return np.asarray(-self.difference(lambda jump: np.array(jump.whole_force(x).array)))

    def radius(self, x: Array) -> Array:
        """Return the directional derivative (n_discs,) of the radii of the friction discs.

        The pressures of x are fixed. Collective.
        """
        radii = [jump.bounded(self.bounds).section(x).radius for jump in (self.after, self.before)]
        known = np.isfinite(radii[0]) & np.isfinite(radii[1])
        one, two = (np.where(known, each, 0.0) for each in radii)
        return np.asarray((one - two) / (2.0 * self.step))

    def of(self, u: fem.Function) -> tuple[Array, Array]:
        """Return B u (size,) with the operators `after` and `before`, for `goal`. Collective."""
        return self.after.of_displacement(u), self.before.of_displacement(u)

    def goal(self, goal: Goal, x: Array, jumps: tuple[Array, Array]) -> float:
        """Return the directional derivative of a goal for fixed displacement and multipliers.

        A goal such as a force depends on the position of obstacles through normals and tangents.
        The method may be called after `destroy()`. Collective.

        Args:
            goal: a goal that is not a UFL form.
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
        """Return the directional derivative of a weighted sum of goals by the adjoint method.

        The sum contains weight times J for each of the `goals`, and on_jump' B u. Collective.

        Args:
            step: the solution.
            goals: pairs (weight, J) of the goals J that are not UFL forms.
            z: the adjoint displacement.
            y: (size,) the adjoint multipliers.
            radial: (n_discs,) derivatives of the sum with respect to the radii of the discs.
            on_jump: (size,) derivative of the sum with respect to B u, from later load steps.
        """
        x, inner = step.multipliers, step.dual.inner
        turned = self.difference(lambda jump: jump.of_displacement(z))
        result = float(inner(y, self.offset(step.u)) - inner(x, turned))
        result += float(inner(radial, self.radius(x)))
        jumps = self.of(step.u)
        result += float(inner(on_jump, jumps[0] - jumps[1])) / (2.0 * self.step)
        return result + sum(weight * self.goal(goal, x, jumps) for weight, goal in goals)


#: Function of a Constant and a direction in which its value changes. It returns the differences of
#: B, or None if no obstacle depends on the Constant.
FindDifferences: TypeAlias = "Callable[[fem.Constant, Array], ObstacleDifferences | None]"
