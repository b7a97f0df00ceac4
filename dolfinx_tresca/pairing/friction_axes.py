"""Friction with two axes: tangents along them, and the ellipses that bound the tractions."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators

#: Part of a semi-axis, over the longer one, or of a unit vector, that is rounding and means zero.
AXIS_ROUNDING = 64 * float(np.finfo(float).eps)

#: Sine of the angle between direction and normal up to which the direction is none in the surface.
LEAST_SINE = 1e-6


@dataclass(frozen=True)
class NodalEllipses:
    """The shapes of the ellipses that bound tractions at the nodes of a pair on this rank.

    Attributes:
        direction: (n, 3) vectors of any length, whose parts in the surface are the first axes.
        shape: (n, 2) semi-axes along the first axis and across it, over the longer one.
    """

    direction: Array
    shape: Array


def along_axes(V: Any, pair: PairOperators, ellipses: NodalEllipses) -> PairOperators:
    """Return the operators with tangents along the axes of friction. Collective.

    On a rank where axes and ellipses are those of `pair`, but for rounding, that is `pair` itself.
    A node that can move in one tangential direction only keeps that one: its bound is the section
    of the ellipse. A node with a circle keeps its tangents.

    Raises:
        InputError: the direction is no vector at a node, or normal to the surface there.
    """
    shape = np.where(ellipses.shape > AXIS_ROUNDING, ellipses.shape, 0.0)
    round_ones = shape[:, 0] == shape[:, 1]
    axes = _axes(V, pair, np.where(round_ones[:, None], 0.0, ellipses.direction), round_ones)
    node = pair.tangent_node
    second = np.flatnonzero(node[1:] == node[:-1]) + 1
    second = second[~round_ones[node[second]]]
    rows = np.stack([second - 1, second], axis=1)
    tangents = pair.tangents.copy()
    tangents[rows] = axes[node[second]]
    semi_axes = _sections(np.einsum("rai,ri->ra", axes[node], tangents), shape[node])
    if _close(tangents, pair.tangents) and _close(semi_axes, pair.semi_axes):
        return pair
    turn = np.einsum("nai,nbi->nab", tangents[rows], pair.tangents[rows])
    kept = np.setdiff1d(np.arange(len(node)), rows)
    turned = csr_array(
        (
            np.append(turn.ravel(), np.ones(len(kept))),
            (
                np.append(np.repeat(rows, 2, axis=1).ravel(), kept),
                np.append(np.tile(rows, (1, 2)).ravel(), kept),
            ),
        ),
        shape=(len(node), len(node)),
    )
    return dataclasses.replace(pair, T=turned @ pair.T, tangents=tangents, semi_axes=semi_axes)


def _close(one: Array, other: Array) -> bool:
    return bool((np.abs(one - other) <= AXIS_ROUNDING).all())


def _axes(V: Any, pair: PairOperators, direction: Array, round_ones: Mask) -> Array:
    """Return the axes (n, 2, 3) of each node, zero where a circle needs none. Collective."""
    first = direction - np.einsum("ni,ni->n", direction, pair.normals)[:, None] * pair.normals
    length, whole = np.linalg.norm(first, axis=1), np.linalg.norm(direction, axis=1)
    rubs = np.zeros(len(length), dtype=np.bool_)
    rubs[pair.tangent_node] = True
    with errors_on_all_ranks(V.mesh.comm):
        bad = np.flatnonzero(rubs & ~round_ones & ~(length > LEAST_SINE * whole))
        if len(bad):
            _refuse(V, pair, direction, bad)
    length[length == 0.0] = 1.0
    first /= length[:, None]
    return np.stack([first, np.cross(pair.normals, first)], axis=1)


def _refuse(V: Any, pair: PairOperators, direction: Array, bad: Indices) -> None:
    """Refuse the direction at some of a pair's nodes.

    Raises:
        InputError: always.
    """
    found, first = direction[bad[0]], pair.nodes[bad[0]]
    if not np.isfinite(found).all():
        what = "is not finite"
    else:
        what = "is normal to the surface" if found.any() else "is zero"
    raise InputError(
        f"the direction of the slip bound {what}: found {_shown(found)} at "
        f"{_shown(V.tabulate_dof_coordinates()[first])}, with the normal "
        f"{_shown(pair.normals[bad[0]])}, and so at {len(bad)} of the {len(pair.nodes)} contact "
        f"nodes of rank {V.mesh.comm.rank}. Give a direction that varies, or two equal bounds "
        "where it has no meaning."
    )


def _shown(vector: Array) -> str:
    """Return components, with what is rounding beside the others shown as zero."""
    rounding = np.abs(vector) <= AXIS_ROUNDING * np.abs(vector).max()
    return f"({', '.join(f'{component:.4g}' for component in np.where(rounding, 0.0, vector))})"


def _sections(direction: Array, shape: Array) -> Array:
    """Return the lengths (n,) of the semi-diameters of ellipses in a direction.

    Args:
        direction: (n, 2) components of a unit vector along the axes.
        shape: (n, 2) semi-axes.
    """
    leans = np.abs(direction) > AXIS_ROUNDING
    inverse = np.zeros_like(shape)
    np.divide(direction, shape, out=inverse, where=leans & (shape > 0.0))
    length = np.linalg.norm(inverse, axis=1)
    length[(leans & (shape == 0.0)).any(axis=1)] = np.inf
    # a circle has no axes: the same in all directions
    length[shape[:, 0] == shape[:, 1]] = 1.0
    result: Array = 1.0 / length
    return result
