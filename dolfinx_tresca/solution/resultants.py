"""Resultant force and moment of a pair, or of all contact, on a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.bodies import labels_of
from dolfinx_tresca._base.parallel import gather_rows, reduce_array
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.operators import PairOperators


@dataclass(frozen=True)
class Resultant:
    """Force and moment of contact on a body.

    Attributes:
        force: (d,) resultant force [force]; in 2D per unit of thickness.
        moment: (3,) resultant moment about `point` [force length]; in 2D (1,), about the axis out
            of the plane.
        point: (d,) reference point of the moment [length].
    """

    force: Array
    moment: Array
    point: Array

    def about(self, point: npt.ArrayLike) -> Resultant:
        """Return the resultant about another point (d,). Not collective.

        Raises:
            InputError: the point does not have d finite coordinates.
        """
        try:
            centre = np.array(point, dtype=np.float64)
        except (TypeError, ValueError):
            centre = np.zeros(0)
        if centre.shape != self.point.shape or not np.isfinite(centre).all():
            raise InputError(
                f"the point of a moment must have {len(self.point)} coordinates, "
                f"found {shown(point)}."
            )
        return Resultant(self.force, self.moment + moments(self.point - centre, self.force), centre)


class BoltForce(NamedTuple):
    """The force in a bolt that was cut, positive in tension.

    Attributes:
        force: the force [force].
        change: the force less the preload: zero while the bolt is pulled, and then due to loads.
    """

    force: float
    change: float


def moments(arm: Array, force: Array) -> Array:
    """Return the moments (..., 3) of forces (..., 3) with arms (..., 3). Not collective.

    In 2D moments are (..., 1), forces and arms (..., 2).
    """
    dim = force.shape[-1]
    arm, force = (
        np.concatenate([v, np.zeros((*v.shape[:-1], 3 - dim))], axis=-1) for v in (arm, force)
    )
    turning = np.cross(arm, force).astype(np.float64)
    return turning if dim == 3 else turning[..., 2:]


def centre_of_forces(comm: Any, places: Array, forces: Array) -> Array:
    """Return the centre (d,) of the bounding box of all points with forces. Collective.

    This is the point of moments unless the user gives another one; the origin without forces.

    Args:
        comm: communicator of the mesh.
        places: (n, d) points of application [length].
        forces: (n, d) forces.
    """
    places = places[forces.any(axis=1)]
    bounds = [places.min(axis=0, initial=np.inf), (-places).min(axis=0, initial=np.inf)]
    low, high = reduce_array(comm, bounds, MPI.MIN)
    return 0.5 * (low - high) if np.isfinite(low).all() else np.zeros_like(low)


def resultants_on(
    comm: Any, groups: Sequence[tuple[Array, Array, Indices]], number: int, point: Array
) -> tuple[Resultant, ...]:
    """Return resultants about a point. Collective.

    Args:
        comm: communicator of the mesh.
        groups: groups of this rank's forces: points of application (n, d) [length], forces (n, d),
            and the index (n,) of the resultant to which each force belongs.
        number: number of resultants.
        point: (d,) reference point of the moments [length].
    """
    places, forces, index = (np.concatenate(column) for column in zip(*groups, strict=True))
    both = np.hstack([forces, moments(places - point, forces)])
    sums = np.zeros((number, both.shape[1]))
    np.add.at(sums, index, both)
    dim = forces.shape[1]
    return tuple(Resultant(row[:dim], row[dim:], point) for row in reduce_array(comm, sums))


def forces_on_secondary(operators: PairOperators, pressure: Array, traction: Array) -> Array:
    """Return the contact forces (n, d) on the nodes of a pair's secondary side. Not collective.

    Args:
        operators: operators of the pair.
        pressure: (n_normal,) pressures [stress].
        traction: (n_tangential,) tangential multipliers [stress].
    """
    weights, forces = operators.weights, np.zeros_like(operators.normals)
    i, j = operators.normal_node, operators.tangent_node
    forces[i] -= (weights[i] * pressure)[:, None] * operators.normals[i]
    np.subtract.at(forces, j, (weights[j] * traction)[:, None] * operators.tangents)
    return forces


def shares_of_bodies(
    V: Any, label: npt.NDArray[np.int64], operators: PairOperators, forces: Array
) -> tuple[Array, Array, Indices]:
    """Split the forces on secondary nodes into one part for each body that exerts them. Collective.

    Args:
        V: the space of the displacement.
        label: (owned nodes of V,) the body of each node.
        operators: operators of the pair.
        forces: (n, d) contact forces on the nodes of the secondary side [force].

    Returns:
        Points of application (m, d) [length], forces (m, d), and the bodies (m, 2): the node's
        body, and the body that exerts the force. Forces of obstacles, and forces within a body, are
        left out.
    """
    primary = operators.primary.tocsr()
    numbers, column = np.unique(primary.indices, return_inverse=True)
    partner = labels_of(V, label, numbers.astype(np.int64))[column]
    node = np.repeat(np.arange(primary.shape[0]), np.diff(primary.indptr))
    body = label[operators.nodes[node]]
    foreign = body != partner
    node, share = node[foreign], primary.data[foreign]
    both = np.column_stack([body, partner])[foreign]
    return operators.places[node], share[:, None] * forces[node], both


def resultants_between(
    comm: Any, shares: Sequence[tuple[Array, Array, Indices]]
) -> dict[tuple[int, int], Resultant]:
    """Return (i, j) -> the resultant on body i by body j, for bodies i < j in contact. Collective.

    Moments are about the mean of the points at which the forces between the two bodies act,
    weighted by the sizes of the forces.

    Args:
        comm: communicator of the mesh.
        shares: results of `shares_of_bodies`, one for each pair.
    """
    places, forces, bodies = (np.concatenate(column) for column in zip(*shares, strict=True))
    acts = forces.any(axis=1)
    places, forces, bodies = places[acts], forces[acts], bodies[acts]
    sign = np.where(bodies[:, 0] < bodies[:, 1], 1.0, -1.0)[:, None]
    sizes = np.linalg.norm(forces, axis=1)[:, None]
    columns = [np.sort(bodies, axis=1), sizes, sizes * places, sign * forces]
    rows = np.hstack([*columns, sign * moments(places, forces)])
    rows = _summed_by_bodies(gather_rows(comm, _summed_by_bodies(rows)))
    dim = forces.shape[1]
    ends = [2, 3, 3 + dim, 3 + 2 * dim]
    split_rows = (np.split(row, ends) for row in rows)
    return {
        (int(both[0]), int(both[1])): Resultant(force, moment, np.zeros(dim)).about(place / size)
        for both, size, place, force, moment in split_rows
    }


def _summed_by_bodies(rows: Array) -> Array:
    """Add up rows (m, 2 + k) with the same two bodies in their first columns."""
    unique, position = np.unique(rows[:, :2], axis=0, return_inverse=True)
    sums = np.zeros((len(unique), rows.shape[1] - 2))
    np.add.at(sums, position.ravel(), rows[:, 2:])
    return np.hstack([unique, sums])
