"""Sums of contact forces: what a pair, or all of contact, does to a body as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.operators import PairOperators


@dataclass(frozen=True)
class Resultant:
    """Force and moment of contact on a body.

    Attributes:
        force: (d,) [force]; in 2D of a unit of thickness.
        moment: (3,) about `point` [force length]; in 2D (1,), about the axis out of the plane.
        point: (d,) [length].
    """

    force: Array
    moment: Array
    point: Array

    def about(self, point: npt.ArrayLike) -> Resultant:
        """Return the resultant about another point (d,). Not collective.

        Raises:
            InputError: it is no point.
        """
        try:
            other = np.array(point, dtype=np.float64)
        except (TypeError, ValueError):
            other = np.zeros(0)
        if other.shape != self.point.shape or not np.isfinite(other).all():
            raise InputError(
                f"the point of a moment must have {len(self.point)} coordinates, "
                f"found {shown(point)}."
            )
        return Resultant(self.force, self.moment + moments(self.point - other, self.force), other)


def moments(arm: Array, force: Array) -> Array:
    """Return moments (..., 3) of forces (..., 3), or (..., 1) of such in 2D. Not collective."""
    dim = force.shape[-1]
    arm, force = (
        np.concatenate([v, np.zeros((*v.shape[:-1], 3 - dim))], axis=-1) for v in (arm, force)
    )
    turning = np.cross(arm, force).astype(np.float64)
    return turning if dim == 3 else turning[..., 2:]


def resultants_on(
    comm: Any, parts: Sequence[tuple[Array, Array, Indices]], number: int
) -> tuple[Resultant, ...]:
    """Return the resultants of forces, about the middle of where there are any. Collective.

    Args:
        comm: communicator of the mesh.
        parts: for some of this rank's forces their places (n, d), themselves (n, d), and to which
            sum each belongs (n,).
        number: number of the sums.
    """
    places, forces, index = (np.concatenate(column) for column in zip(*parts, strict=True))
    acts = forces.any(axis=1)
    places, forces, index = places[acts], forces[acts], index[acts]
    bounds = [places.min(axis=0, initial=np.inf), (-places).min(axis=0, initial=np.inf)]
    low, high = reduce_array(comm, bounds, MPI.MIN)
    middle = 0.5 * (low - high) if np.isfinite(low).all() else np.zeros_like(low)
    both = np.hstack([forces, moments(places - middle, forces)])
    sums = np.zeros((number, both.shape[1]))
    np.add.at(sums, index, both)
    dim = forces.shape[1]
    return tuple(Resultant(one[:dim], one[dim:], middle) for one in reduce_array(comm, sums))


def forces_on_secondary(operators: PairOperators, pressure: Array, traction: Array) -> Array:
    """Return the contact forces (n, d) on the nodes of a pair's secondary side. Not collective.

    Args:
        operators: the pair's.
        pressure: (n_normal,) [stress].
        traction: (n_tangential,) [stress].
    """
    weights, forces = operators.weights, np.zeros_like(operators.normals)
    i, j = operators.normal_node, operators.tangent_node
    forces[i] -= (weights[i] * pressure)[:, None] * operators.normals[i]
    np.subtract.at(forces, j, (weights[j] * traction)[:, None] * operators.tangents)
    return forces
