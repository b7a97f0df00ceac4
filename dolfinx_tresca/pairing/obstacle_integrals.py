"""Integrals over secondary facets that face a rigid obstacle, also where it is small."""

from __future__ import annotations

import math
from copy import copy

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, Mask, dots, unit
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, warn
from dolfinx_tresca.pairing.contact_normal import SmoothSurface, contact_normals, turned_angles
from dolfinx_tresca.pairing.facets import FACING_COSINE, OFFSET_DEGREE, SurfaceNodes, quadrature
from dolfinx_tresca.pairing.mortar_integrals import FacetIntegrals
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: Angle [rad] by which an obstacle's normal turns over a facet, up to which the mesh resolves the
#: obstacle; from three times the angle on, it is seen all over the facets around the node. With
#: twice instead of three times, the force on a cylinder with cells of a third of its radius is 9 to
#: 18 % too large, instead of 0 to 7 %.
RESOLVED_ANGLE = math.radians(10.0)
#: Angle [rad] from which on an obstacle that enters a facet is warned of: forces of cylinders are
#: then right to a quarter, those of balls to a factor of 1.7.
COARSE_ANGLE = 3.0 * RESOLVED_ANGLE

#: Height over its nearest point up to which an obstacle is seen, relative to its height over the
#: corners of a facet whose middle it touches. With half of it a cylinder as small as the facets has
#: up to 1.5 times the force; with 1.5 times of it, half the force.
SEEN_HEIGHT = 1.0 / 3.0
#: Degree of exactness of the quadrature over facets on which an obstacle is seen.
SEEN_DEGREE = 16
#: Unseen part of the depth by which an obstacle enters facets that is warned of. (On cells of 4/3
#: of a cylinder's radius it was 0.54, and the force right to 16 %.)
UNSEEN_PART = 0.3


def obstacle_integrals(
    comm: MPI.Comm, pair: ContactPair, obstacle: RigidObstacle, nodes: SurfaceNodes, displaced: bool
) -> tuple[SurfaceNodes, FacetIntegrals, Mask]:
    """Integrate over the facets of a surface that face a rigid obstacle. Collective.

    The signed distance is interpolated like a displacement and averaged with the dual basis; with
    degree 1, gap and jump are then the nodal values. With degree 2 the distance at nodes on
    straight edges is measured from the smooth curved surface (`SmoothSurface`), since a body of
    degree 2 can take the shape of the obstacle. Where the mesh does not resolve the obstacle, it is
    also seen between the nodes; what undeformed bodies enter unseen is warned of.

    Returns:
        the nodes, with a single entry for all facets at a node, since its patches share the normal
        of the obstacle; the integrals; and whether facets face it at their corners (n, corners).
    """
    facets, centre = nodes.facets, quadrature(nodes.facets.cell, 1)[0]
    entry = np.searchsorted(nodes.numbers, nodes.numbers, side="right") - 1
    with errors_on_all_ranks(comm):
        surface = SmoothSurface(nodes)
        nodes = copy(nodes)
        nodes.facet_nodes = entry[nodes.facet_nodes]
        at_corners = obstacle.at(nodes.points)[1][nodes.facet_nodes]
        centres = (facets.basis(centre) @ facets.points)[:, 0]
        _, at_centres = obstacle.at(centres)

        # A facet faces the obstacle at a corner if the normals are opposed there and at the centre:
        # at an edge in a corner between two walls, the facets in front of the nearest wall do.
        corner_normals = unit(facets.area_vectors(facets.lagrange_points(1)))
        faces: Mask = dots(corner_normals, at_corners) < -FACING_COSINE
        faces &= (dots(facets.mean_normals, at_centres) < -FACING_COSINE)[:, None]
        facing = np.asarray(faces.any(axis=1))

        # nodes have the obstacle's normal if the mesh resolves its turns, else the mean of both
        turns = turned_angles(dots(at_corners, at_centres[:, None])) * facing
        at_node = nodes.reduced(np.maximum, turns[:, None], 0.0)[nodes.facet_nodes]
        own_turns = surface.turns[:, None]
        mean_normals = contact_normals(surface.corner_normals, at_corners, own_turns, at_node)
        unresolved = np.clip(at_node / RESOLVED_ANGLE - 1.0, 0.0, 1.0)[:, :, None]
        normals = unresolved * mean_normals - (1.0 - unresolved) * at_corners

        # distances are interpolated between the nodes of the displacement, normals between corners
        every = np.arange(len(facing))
        distance, _ = _at(obstacle, surface.points(every, facets.lagrange_points(facets.degree)))
        height = _at(obstacle, facets.points)[0] - distance
        at_nodes = np.stack([distance, height, height], axis=2)
        # integrals over the facets that face the obstacle, zero over the others
        x, w = quadrature(facets.cell, 4 * facets.degree + 2)
        weighted = (facets.area_elements(x) * w * facing[:, None])[:, None] * facets.hats(x).T
        hats, values = weighted @ facets.hats(x), weighted @ facets.basis(x)
        means = np.concatenate([values @ at_nodes, hats @ normals], axis=2)
        least, full = distance.min(axis=1, initial=np.inf), np.ones(len(every), dtype=np.bool_)
        pairs = np.column_stack([every, np.zeros_like(every)])
        integrals = FacetIntegrals(hats, values, means, least, full, pairs, hats)

        # nodes see a hollow obstacle, such as a corner between walls, before all other points do
        spread = facets.points[:, : facets.corners] - centres[:, None]
        turns *= dots(spread, at_corners - at_centres[:, None]).sum(axis=1) > 0.0
        near = _see_between_nodes(obstacle, nodes, surface, turns, integrals)
    if displaced:
        return nodes, integrals, faces

    # warn if the obstacle enters facets farther than the mesh sees: what it sees is the least
    # distance at nodes, or of means over the facets around them
    seen = integrals.least.copy()
    gaps = nodes.reduced(np.add, integrals.means[near, :, 0], 0.0, near)
    areas = nodes.reduced(np.add, integrals.hats[near].sum(axis=2), 0.0, near)
    corners = nodes.facet_nodes[near]
    seen[near] = (gaps[corners] / areas[corners]).min(axis=1, initial=np.inf)
    front = np.flatnonzero(facing)
    with errors_on_all_ranks(comm):
        points = surface.points(front, facets.lagrange_points(OFFSET_DEGREE))
        depth = -_at(obstacle, points)[0].min(axis=1, initial=0.0)
    unseen = depth - np.maximum(-seen[front], 0.0)
    entered_turns = turns[front] * (depth > 0.0)
    greatest = [array.max(initial=0.0) for array in (depth, unseen, entered_turns, np.abs(points))]
    deepest, most_unseen, angle, extent = reduce_array(comm, greatest, MPI.MAX)
    rounding = ROUNDING * extent
    is_coarse = angle > COARSE_ANGLE and deepest > rounding
    if is_coarse or most_unseen > max(UNSEEN_PART * deepest, rounding):
        warn(
            comm,
            "contact pair %s: the obstacle enters facets by up to %.3g, and the mesh does not "
            "see %.3g of it; its normal turns by %.0f degrees over a facet: forces are "
            "inaccurate, and may be zero. Use facets a third as large as the radius of the "
            "obstacle.",
            *(pair, deepest, most_unseen, math.degrees(angle)),
            about=str(pair),
        )
    return nodes, integrals, faces


def _at(obstacle: RigidObstacle, points: Array) -> tuple[Array, Array]:
    """Return distances (n, q) and normals (n, q, 3) of an obstacle at points (n, q, 3)."""
    distance, normals = obstacle.at(points.reshape(-1, 3))
    return distance.reshape(points.shape[:2]), normals.reshape(points.shape)


def _see_between_nodes(
    obstacle: RigidObstacle,
    nodes: SurfaceNodes,
    surface: SmoothSurface,
    turns: Array,
    integrals: FacetIntegrals,
) -> Indices:
    """Take means around the nearest points of an obstacle that the mesh does not resolve.

    An obstacle that is smaller than a facet may touch it between nodes. Gap, contact normal and
    displacement of a node are then means over the facets around it, with its hat function times
    exp(-(g - least) / height) as weight, where g is the distance and `least` its least value on
    these facets. So the force acts where the obstacle touches. The height is a part (`SEEN_HEIGHT`)
    of the height of the obstacle over the corners of a facet whose middle it touches.

    The obstacle's normal turns by `turns` (n,) over facets [rad], zero where they do not face it.
    The integrals change in place over the facets (m,) that are returned; `hats` become diagonal.
    """
    facets = nodes.facets
    # share (m, corners, 1) of the new means, which take over gradually as the angle grows
    around = nodes.reduced(np.maximum, turns[:, None], 0.0)[nodes.facet_nodes]
    share = np.clip(0.5 * (around / RESOLVED_ANGLE - 1.0), 0.0, 1.0)
    near = np.flatnonzero(integrals.hats.any(axis=(1, 2)) & share.any(axis=1))
    close, corners, share = facets.selected(near), nodes.facet_nodes[near], share[near, :, None]
    turns = turns[near]
    # the six quantities of `FacetIntegrals.means` at points all over the facets
    x, w = quadrature(facets.cell, SEEN_DEGREE)
    hats, points = facets.hats(x), surface.points(near, x)
    distance, outward = _at(obstacle, points)
    own = unit(hats @ surface.corner_normals[near])
    normals = contact_normals(own, outward, surface.turns[near, None], turns[:, None])
    above = dots(facets.basis(x) @ close.points - points, outward)
    seen = np.dstack([distance, above, above, normals])
    # weights (m, corners, points): the hat function times the exponential function, scaled such
    # that a node keeps its area. An arc over a chord of length l has the height turn l / 8
    sizes = (np.linalg.norm(close.area_vectors(x), axis=2) @ w) ** (1.0 / facets.dim)
    own_height = SEEN_HEIGHT / 8.0 * facets.dim * turns * sizes
    height = nodes.reduced(np.maximum, own_height[:, None], 0.0, near)
    least = nodes.reduced(np.minimum, distance.min(axis=1)[:, None], np.inf, near)
    heights = np.where(share > 0.0, height[corners][:, :, None], 1.0)
    excess = (distance[:, None] - least[corners][:, :, None]) / heights
    weights = np.exp(-excess) * hats.T * (close.area_elements(x) * w)[:, None]
    areas = integrals.hats[near].sum(axis=2)
    total = nodes.reduced(np.add, weights.sum(axis=2), 0.0, near)[corners]
    weights *= (nodes.reduced(np.add, areas, 0.0, near)[corners] / total)[:, :, None]
    # the integrals so far get dual functions; diagonal `hats` tell `couple` to keep these
    dual = areas[:, :, None] * np.linalg.inv(integrals.hats[near])
    values, means = dual @ integrals.values[near], dual @ integrals.means[near]
    # the normal at a node half a facet away is wrong by more than the distance there
    shares = share * [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    integrals.values[near] = values + share * (weights @ facets.basis(x) - values)
    integrals.means[near] = means + np.minimum(shares, 1.0) * (weights @ seen - means)
    integrals.hats[near] = areas[:, :, None] * np.eye(facets.corners)
    return near
