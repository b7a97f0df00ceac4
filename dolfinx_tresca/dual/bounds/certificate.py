"""A bound of the iteration's error in the displacement, without a further solve with K."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.bounds.lift import Lift
from dolfinx_tresca.dual.bounds.saddle_lift import SaddleLift
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.solvers.feasible_set import FeasibleSet


class EnergyBound(PetscOwner):
    """Bounds |u - u*|_K for u = K^-1 (f - B'lambda), lambda in Lambda (docs/theory/accuracy.md).

    Here u* is the exact solution of the discrete problem. By weak duality, the primal energy J, the
    dual energy D, and any displacement v without penetration satisfy

        1/2 |u - u*|_K^2 + 1/2 |v - u*|_K^2 <= J(v) - D(lambda)
            = lambda_nu'(d - N v) + sum of (g |T v| - lambda_tau.T v) + 1/2 |v - u|_K^2.

    No term of this sum is negative, so nothing cancels. In load steps, T v stands for T v - s, the
    slip since the last step, here and below. The displacement v is u + w. The lift w moves contact
    nodes alone (`Lift`), such that the jump at every node takes its best value for fixed
    neighbours: nodes that should close or stick do so. If K also has rows for a pressure, w moves
    all nodes (`SaddleLift`), and |u|_K is the norm of the displacement alone, with the pressure
    eliminated. If such a K is the tangent of a Newton step, there is no bound: the factorisation
    for `SaddleLift` would double the cost of the step.

    Owns PETSc objects: call `destroy()`.
    """

    def __init__(self, jump: JumpOperator, local_stiffness: Array) -> None:
        """Prepare the lifts w. Collective.

        Args:
            jump: B, and the system with K.
            local_stiffness: (size,) 1 / diag(B diag(K)^-1 B'), the stiffness of a node with fixed
                neighbours.
        """
        self._local_stiffness = local_stiffness
        system = jump.system
        self.comm = system.comm
        self._lift: Lift | SaddleLift | None = None
        if system.component is None:
            self._lift = Lift(jump)
        elif not system.is_tangent:
            self._lift = SaddleLift(jump)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        if self._lift is not None:
            self._lift.destroy()

    def energy_bound(self, feasible_set: FeasibleSet, x: Array, r: Array, error: float) -> float:
        """Return a bound of the error in the energy norm [energy^(1/2)]. Collective.

        Args:
            feasible_set: Lambda.
            x: (size,) multipliers in Lambda.
            r: (size,) the gradient at x, from the computed displacement u: d - N u and -T u.
            error: a bound of the error of u, |u - K^-1 (f - B'x)|_K.

        Returns:
            the bound of |u - u*|_K; infinite if there is no bound, or if rows of B are linearly
            dependent.
        """
        if self._lift is None:
            return np.inf
        opening, gap = self._best_nodes(feasible_set, x, r)
        total = float(reduce_array(self.comm, gap))
        lift = self._lift.energy_norm(r - opening)
        return float(np.sqrt(2.0 * total + (lift + error) ** 2)) + error

    def _best_nodes(self, feasible_set: FeasibleSet, x: Array, r: Array) -> tuple[Array, float]:
        """Return d - N v and -T v (size,), and this rank's nodal terms of the duality gap.

        The remaining term of the gap, 1/2 |v - u|_K^2, is added in `energy_bound`. The jumps of v
        are chosen node by node: each node gets the jump for which the duality gap is smallest if
        its neighbours are fixed.
        """
        local = self._local_stiffness
        normal, tangential = feasible_set.normal, feasible_set.tangential
        opening = np.zeros_like(r)  # stays zero at bonded nodes
        opening[normal] = np.maximum(r[normal] - x[normal] / local[normal], 0.0)
        # one stiffness for all directions of a friction disc
        stiffness = feasible_set.disc_means(local)
        stiffness[stiffness == 0.0] = 1.0  # nodes without tangential rows
        slip = np.zeros_like(r)
        slip[tangential] = x[tangential] / stiffness[feasible_set.node] - r[tangential]
        length = feasible_set.norms(slip)
        factor = np.maximum(
            1.0 - feasible_set.radius / (stiffness * np.maximum(length, LEAST_DIVISOR)), 0.0
        )
        slip[tangential] *= factor[feasible_set.node]
        opening[tangential] = -slip[tangential]
        friction = feasible_set.dissipation(slip) - float(x[tangential] @ slip[tangential])
        return opening, float(x[normal] @ opening[normal]) + max(friction, 0.0)
