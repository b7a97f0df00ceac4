"""Loose bodies as the dual problem sees them: the jumps of their motions, and loads in balance."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca.dual.balanced_set import BalancedSet, balance
from dolfinx_tresca.dual.feasible_set import Array, FeasibleSet
from dolfinx_tresca.stiffness.loose_motions import RigidResponse


class LooseBodies:
    """Bodies that K does not hold, or hardly; contact has to do so (`BalancedSet`).

    All methods are collective.
    """

    def __init__(self, response: RigidResponse, jump: Callable[[Array], Array]) -> None:
        """Compute the jumps of the bodies' motions.

        Args:
            response: what the motions do.
            jump: of a displacement's values on this rank.
        """
        self._response = response
        motions = response.displacements.T
        self._jumps = np.column_stack([jump(motion.toarray().ravel()) for motion in motions])

    def balanced(
        self,
        feasible_set: FeasibleSet,
        load: Array,
        inner: Callable[[Array, Array], Array],
        agreed: Callable[[Array], Array],
    ) -> BalancedSet:
        """Return what of Lambda balances the load; later motions are those of that set.

        Args:
            feasible_set: Lambda.
            load: f on this rank.
            inner: x'y over all ranks.
            agreed: the first rank's numbers.

        Raises:
            InputError: contact cannot hold a body, which is named with its motion.
        """
        loose = self._response.loose
        result, self._factors = balance(
            feasible_set,
            self._jumps,
            self._response.stiffness,
            *self._response.resultants(load),
            loose.body,
            inner,
            agreed,
            loose.describe,
        )
        return result

    def support_energy(self, u: PETSc.Vec) -> float:
        """Return twice the energy of the supports' springs under a displacement."""
        return self._response.loose.support_energy(u)

    def move(
        self, balanced: FeasibleSet, x: Array, r: Array, u: PETSc.Vec, rigid: Array
    ) -> tuple[Array, float]:
        """Add motions to u.

        Args:
            balanced: the newest result of `balanced()`.
            x: (size,) in that.
            r: (size,) the gradient at x without motions.
            u: (K + Z Z')^-1 (f - B'x), with the springs Z of the supports.
            rigid: (k,) the motions.

        Returns:
            the gradient, and the energy norm of motions that u lacks for loads in balance.
        """
        u.array += self._response.displacements @ (self._factors * rigid)
        return r - balanced.rigid_jumps @ rigid, balanced.rigid_error(x, rigid)
