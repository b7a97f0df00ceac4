"""The jump between two surfaces at the secondary nodes: what each kind of pairing returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.nodes import SurfaceNodes


@dataclass(frozen=True)
class Coupling:
    """The jump of the displacement at secondary nodes of this rank, before directions are chosen.

    Attributes:
        pairing: how it was made, for people.
        position: (n,) the nodes: positions in the secondary side's `SurfaceNodes`.
        weights: (n,) the part of their areas that is in contact [length^2, in 2D length].
        normals: (n, 3) outward unit normals of the secondary side.
        jump: (n, nodes of V) sparse, with global column numbers: secondary minus primary.
        primary: (n, nodes of V) sparse, the part that is subtracted there: rows sum to 1, or are
            empty before an obstacle.
        gap_vector: (n, 3) from the secondary to the primary side [length].
        place: (n, 3) where the forces on the secondary side act, as a whole [length].
        raised: (n,) what the gap is less by since straight edges of degree 2 stand for a curved
            surface that is higher than them [length].
    """

    pairing: str
    position: Indices
    weights: Array
    normals: Array
    jump: Any
    primary: Any
    gap_vector: Array
    place: Array
    raised: Array


def owned(V: Any, nodes: SurfaceNodes) -> Mask:
    """Return which nodes this rank owns. Not collective."""
    low, high = V.dofmap.index_map.local_range
    return np.asarray((nodes.numbers >= low) & (nodes.numbers < high))


def nodes_with_multipliers(
    V: Any,
    pair: ContactPair,
    nodes: SurfaceNodes,
    unpaired: Mask,
    shared: Mask,
    kind: str,
    reason: str = "",
) -> Indices:
    """Return the positions of this rank's nodes that carry multipliers, and log them. Collective.

    Args:
        V: the space.
        pair: the pair.
        nodes: its secondary nodes.
        unpaired: (n,) those that face nothing; right for this rank's nodes.
        shared: (n,) those that belong to the primary side as well.
        kind: how they are paired.
        reason: why so.

    Raises:
        PairingError: there are none.
    """
    own = owned(V, nodes)
    held = ~nodes.free.any(axis=1)
    takes_part = own & ~unpaired & ~held & ~shared
    # a node on an edge faces something if it does so on any side of the edge
    faces = np.unique(nodes.numbers[own & ~unpaired])
    partly = takes_part & ~nodes.free.all(axis=1)
    parts = (own & ~unpaired & held, own & ~unpaired & ~held & shared, takes_part, partly)
    counts = [len(np.unique(nodes.numbers[part])) for part in (own, *parts)]
    facing, total, prescribed, common, number, some = reduce_array(
        V.mesh.comm, [len(faces), *counts]
    )
    outside = total - facing
    secondary, primary = pair.side("secondary"), pair.side("primary")
    if outside == total and pair.sliding == "finite":
        log(V.mesh.comm, "pairing: %s: the surfaces do not face each other now", pair)
        return np.flatnonzero(takes_part)
    if outside == total:
        within = "" if pair.search_distance is None else f" within {pair.search_distance:g}"
        raise PairingError(
            f"the surfaces do not face each other: from none of the {total} nodes of the secondary "
            f"side ({secondary}) the outward normal leads to the primary side "
            f"({primary}){within}. Check the tags{' and the search distance' if within else ''}."
        )
    if number == 0:
        raise PairingError(
            f"no node of the secondary side ({secondary}) can carry a multiplier: of its {total} "
            f"nodes {outside} face nothing of the primary side ({primary}), {prescribed} are "
            f"prescribed and {common} shared with it. Check the tags and the Dirichlet conditions."
        )
    log(V.mesh.comm, "pairing: %s, %s%s", pair, kind, f" since {reason}" if reason else "")
    left = {"face nothing": outside, "are prescribed": prescribed, "are shared": common}
    rest = "".join(f", {count} {why}" for why, count in left.items() if count)
    but = f", {some} of them prescribed in part" if some else ""
    log(V.mesh.comm, "pairing: %d of %d secondary nodes take part%s%s", number, total, but, rest)
    return np.flatnonzero(takes_part)
