"""Secondary nodes that carry no multiplier of their own: beyond the rim of the overlap, or held."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import gather_rows
from dolfinx_tresca.pairing.coupling import owned
from dolfinx_tresca.pairing.mortar_integrals import COVER_ROUNDING, MortarIntegrals
from dolfinx_tresca.scene.friction import DryFriction, Friction
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import FREE_PART, SurfaceNodes

#: Mean of a node's hat function over the covered parts of its facets, relative to the mean over
#: whole facets, from which on the node carries a multiplier. On the rim of the overlap, corners
#: included, it is 1; beyond a straight rim it is 1 less the distance over the facet's size. Twice
#: as far out (0.76) the nodes just beyond a block's edge show up to 1.5 times the pressure of the
#: nodes on that edge; half as far (0.94) nodes on a circle of 16 segments lose their multipliers,
#: as the chords of another mesh pass them by.
LEAST_MEAN = 0.88


#: The same where no facet nearby is covered as a whole: on an overlap of one or two facets' width a
#: body would turn about the single line of nodes that is left
#: (tests/validation/test_random_floating.py, scene 3). Half of 0.45 admits multipliers of a
#: twentieth of a node's area. Nearby is within two facets: at corners of bodies whole facets may be
#: no nearer.
LEAST_MEAN_OF_FEW = 0.45

#: Diameter of a secondary facet over the diameter of a primary one, less 1, that is rounding: the
#: meshes are equally fine.
SIZE_ROUNDING = 1e-6


def nodes_without_multiplier(
    V: Any,
    facets: Facets,
    nodes: SurfaceNodes,
    others: Facets,
    integrals: MortarIntegrals,
    shared: Mask,
    friction: Friction,
) -> Mask:
    """Return the nodes whose part in the overlap goes to other nodes of their facets. Collective.

    Nodes beyond the rim: a node that does not face the other side itself has a part of its area in
    contact, perhaps, but no place there. With a multiplier of its own the other side would seem to
    extend as far as the node: its force would be the force on a whole facet, and its pressure
    larger the smaller its part.

    Nodes held along the surface of a finer mesh: see `held_on_coarser_facets`.

    Where no corner of a facet has a multiplier otherwise, the one with the largest part keeps it.

    Args:
        V: the space.
        facets: of the secondary side.
        nodes: their nodes.
        others: facets of the primary side.
        integrals: over the overlap.
        shared: (n,) nodes that belong to the primary side as well.
        friction: of the pair.

    Returns:
        (n,) the same for a node on all ranks.
    """
    corners, weights = nodes.facet_nodes, integrals.own.weights
    count = len(nodes.numbers)
    covered = np.bincount(corners.ravel(), weights.ravel(), minlength=count)
    whole = np.broadcast_to(weights.mean(axis=1, keepdims=True), weights.shape)
    whole = np.bincount(corners.ravel(), whole.ravel(), minlength=count)
    # at a sharp edge a node is several; where both sides of it are covered they stay as they are
    _, number = np.unique(nodes.numbers, return_inverse=True)
    single: Mask = np.bincount(number, covered > 0.0)[number] == 1
    own = owned(V, nodes)

    def as_owners_say(some: Mask) -> Mask:
        """Return nodal flags as computed by the owners, which know all facets of their nodes."""
        return np.isin(nodes.numbers, gather_rows(V.mesh.comm, nodes.numbers[some & own]))

    part = ~integrals.full & (weights.sum(axis=1) > 0.0)
    at_rim = _corners_of(corners, part, count)
    gives = as_owners_say(at_rim & (covered < LEAST_MEAN * whole))
    # carrying nodes of whole facets, those beside them, and at last all nodes beside these
    near = as_owners_say(at_rim & _corners_of(corners, integrals.full, count))
    near = as_owners_say(
        at_rim & (near | _corners_of(corners, part & np.asarray(near)[corners].any(axis=1), count))
    )
    near = _corners_of(corners, part & (near & ~gives)[corners].any(axis=1), count)
    gives &= near | (covered < LEAST_MEAN_OF_FEW * whole)
    if isinstance(friction, DryFriction):
        gives |= held_on_coarser_facets(facets, nodes, others, integrals)
    gives = as_owners_say((covered > 0.0) & gives & single)
    takes = ~gives & ~shared & nodes.free.any(axis=1)
    alone = (weights.sum(axis=1) > 0.0) & ~takes[corners].any(axis=1)
    nearest = weights >= (1.0 - COVER_ROUNDING) * weights.max(axis=1, keepdims=True)
    gives[corners[alone[:, None] & nearest]] = False
    return as_owners_say(gives)


def held_on_coarser_facets(
    facets: Facets, nodes: SurfaceNodes, others: Facets, integrals: MortarIntegrals
) -> Mask:
    """Return the nodes held along the surface whose friction has no row of its own (n,).

    Where the displacement of a node is prescribed along the surface its friction acts on the other
    body alone (`PairOperators.of`). In 3D, along an edge of such nodes, these rows depend on each
    other if the other mesh is coarser: the nodes then leave their part to their neighbours.

    Right for nodes whose facets are all known. Not collective.

    Args:
        facets: of the secondary side.
        nodes: their nodes.
        others: facets of the primary side.
        integrals: over the overlap.
    """
    result = np.zeros(len(nodes.numbers), dtype=np.bool_)
    if facets.dim == 1:
        return result
    movable = np.linalg.norm(nodes.normals[:, : nodes.free.shape[1]] * nodes.free, axis=1)
    rubs = np.ones_like(nodes.free)
    corner, primary = nodes.facet_nodes[integrals.secondary], integrals.primary
    node = corner.ravel()
    free: Mask = np.asarray(others.free.all(axis=1))
    free = free[primary]
    np.logical_and.at(rubs, node, np.repeat(free, corner.shape[1], axis=0))
    finer = (
        _diameters(facets)[integrals.secondary]
        < (1.0 - SIZE_ROUNDING) * _diameters(others)[primary]
    )
    np.logical_or.at(result, node, np.repeat(finer, corner.shape[1]))
    return np.asarray(result & (movable > FREE_PART) & (~nodes.free & rubs).any(axis=1))


def _corners_of(corners: Indices, facets: Mask, count: int) -> Mask:
    """Return the nodes (count,) that are corners of some of the facets (n,) with corners (n, k)."""
    result = np.zeros(count, dtype=np.bool_)
    result[corners[facets]] = True
    return result


def _diameters(facets: Facets) -> Array:
    """Return the largest distance of two corners of each facet (n,) [length]."""
    corners = facets.points[:, : facets.corners]
    squares = np.square(corners[:, :, None] - corners[:, None]).sum(axis=3)
    return np.asarray(np.sqrt(squares.max(axis=(1, 2))))
