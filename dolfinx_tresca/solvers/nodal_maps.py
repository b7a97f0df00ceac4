"""Equations with models of A, along the faces of Lambda. Numpy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.solvers.feasible_set import Face

#: Least softness S of the equality constraints G'lambda + S c = e, times the compliance of the
#: multipliers. With this softness, the linear systems have a solution even if the constraints have
#: none.
LEAST_SOFTNESS = 1e-10


@dataclass(frozen=True)
class NodalMaps:
    """The maps T, V, C and P in the equations T (M + C) V s - T G c = T r and G'V s + S c = e.

    Here s = P s, M is the model of A, and G and S belong to equality constraints. Such equations
    determine Newton steps on a face, and steps towards an adjoint solution. Each map couples only
    multipliers of the same node. T, V and P are applied to arrays (size,) or (size, columns).

    Attributes:
        test: T, applied to both sides of the equation; P T = T.
        trial: V, from s to the change of the multipliers; V P = V.
        stiffness: (size,) diagonal of C, the same for all degrees of freedom of a disc, such as the
            curvature of the circles of slipping nodes.
        projector: P, such as the projector onto a face.
        inverse: V (T (D + C) V)^-1 T on the range of P, with the diagonal D of the model.
    """

    test: Callable[[Array], Array]
    trial: Callable[[Array], Array]
    stiffness: Array
    projector: Callable[[Array], Array]
    inverse: Callable[[Array], Array]

    @classmethod
    def on_face(
        cls,
        face: Face,
        diagonal: Array,
        stiffness: Array,
        with_bound_change: Callable[[Array, Array], Array],
    ) -> NodalMaps:
        """Return the maps along a face, with T = P and V = (I + Q) P. Not collective.

        Here Q is the change of slip bounds with the pressure.

        Args:
            face: face with the projector P.
            diagonal: (size,) D, the same for all degrees of freedom of a friction disc.
            stiffness: (size,) diagonal of C, the same for all degrees of freedom of a disc.
            with_bound_change: function (P s, v) -> (I + Q) P s, plus a term in v if bounds depend
                on the slip; see `FrictionCones.with_bound_change`.
        """
        weight = 1.0 / (diagonal + stiffness)
        return cls(
            test=face.project,
            trial=lambda v: with_bound_change(face.project(v), np.zeros_like(v)),
            stiffness=stiffness,
            projector=face.project,
            inverse=lambda v: with_bound_change(np.asarray((weight * face.project(v).T).T), v),
        )


def solve_or_fit(matrix: Array, right: Array) -> Array:
    """Return the solution; for a singular matrix, the least-squares solution of least norm."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right)[0], dtype=np.float64)
