"""Pairing of a surface with a rigid obstacle."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca.pairing.contact_normal import SmoothSurface, contact_normals, turned_angles
from dolfinx_tresca.pairing.coupling import Coupling, couple
from dolfinx_tresca.pairing.group import PairGroup
from dolfinx_tresca.pairing.mortar_integrals import FacetIntegrals
from dolfinx_tresca.pairing.search.facets import Facets, lagrange_points, quadrature
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.visibility import FACING_COSINE
from dolfinx_tresca.scene.obstacle import RigidObstacle

#: Angles [rad] by which an obstacle's normal turns over a facet (10 and 20 degrees). Up to the
#: first one the mesh resolves the obstacle, and its exact normals at the nodes count; from the
#: second one on, the rule of both sides (`contact_normals`) holds. With half of both the moment of
#: a wheel of 32 cells is wrong by 0.3 %; with twice of both the force on a snap-fit hook jumps by
#: half of its value from one position to the next.
RESOLVED_ANGLES = math.radians(10.0), math.radians(20.0)

#: Part of the depth by which an obstacle enters facets between their nodes that is warned of. (With
#: cells of two thirds of the radius of a cylinder it is 0.45, and its force varies by a third.)
UNSEEN_PART = 0.3

#: Degree of the lattice of points on each facet at which this depth is measured.
ENTERED_DEGREE = 4


def couple_to_obstacle(
    V: Any, group: PairGroup, obstacle: RigidObstacle, nodes: SurfaceNodes, moved: bool
) -> Coupling:
    """Find the jumps at the nodes of a surface that faces a rigid obstacle. Collective.

    The signed distance is interpolated like a displacement and averaged with the dual basis; with
    degree 1, gap and jump are then the nodal values. With degree 2 the distance at nodes on
    straight edges is measured from the smooth curved surface (`SmoothSurface`), since a body of
    degree 2 can take the shape of the obstacle. The direction at each node is the mean of the
    contact normals of its facets (`contact_normals`): where the obstacle turns over a facet by more
    than the body does, this is the body's normal, since a small obstacle that touches the facet
    between its nodes pushes along the normal of the facet. The gap along it is the distance divided
    by the cosine between both normals. Only facets that face the obstacle contribute. A warning
    tells that an undeformed body is entered between its nodes, unless it is `moved`.

    Raises:
        InputError: the signed distance does not return distances and unit normals.
        PairingError: no node can carry a multiplier.
    """
    facets, comm = nodes.facets, V.mesh.comm
    # the patches of a node share the normal of the obstacle: only one entry per node is kept
    entry = np.searchsorted(nodes.numbers, nodes.numbers, side="right") - 1
    whole_nodes = replace(nodes, facet_nodes=entry[nodes.facet_nodes])
    with errors_on_all_ranks(comm):
        distance, _ = obstacle.at(facets.points.reshape(-1, 3))
        height = np.zeros_like(distance)
        surface = SmoothSurface(nodes)
        if facets.degree > 1:
            x = lagrange_points(facets.cell, facets.degree)
            smooth = surface.points(np.arange(len(facets.points)), x)
            height = distance - obstacle.at(smooth.reshape(-1, 3))[0]
        _, obstacle_normals = obstacle.at(nodes.points)
        at_corners = obstacle_normals[nodes.facet_nodes]
        faces, turns = _facing_corners(facets, obstacle, at_corners)
        facing: Mask = np.asarray(faces.any(axis=1))
        turns = np.where(facing, turns, 0.0)
        normals = _corner_contact_normals(surface, whole_nodes.facet_nodes, at_corners, turns)
    distance, height = (array.reshape(facets.nodes.shape) for array in (distance, height))
    hats, values = (facing[:, None, None] * array for array in whole_facet_integrals(facets))
    at_nodes = np.stack([distance - height, height, height], axis=2)
    count = len(hats)
    integrals = FacetIntegrals(
        hats,
        values,
        means=np.concatenate([values @ at_nodes, hats @ normals], axis=2),
        least=np.zeros(count),
        full=np.ones(count, dtype=np.bool_),
        pairs=np.zeros((0, 2), dtype=np.intp),
        partner=np.zeros((0, *values.shape[1:])),
    )
    if not moved:
        # the obstacle enters the smooth surface between nodes, which do not see it
        on_surface, size = distance - height, np.linalg.norm(np.ptp(facets.points, axis=1), axis=1)
        near = np.flatnonzero(facing & (np.abs(on_surface).min(axis=1, initial=np.inf) <= size))
        points = surface.points(near, lagrange_points(facets.cell, ENTERED_DEGREE))
        with errors_on_all_ranks(comm):
            inside = -obstacle.at(points.reshape(-1, 3))[0].reshape(points.shape[:2])
        depth = inside.max(axis=1, initial=0.0)
        seen = np.maximum(-on_surface[near].min(axis=1, initial=np.inf), 0.0)
        largest = [depth.max(initial=0.0), (depth - seen).max(initial=0.0)]
        deepest, unseen = reduce_array(comm, largest, MPI.MAX)
        if unseen > UNSEEN_PART * deepest:
            log(
                comm,
                "contact pair %s: the obstacle enters facets by up to %.3g, %.3g of it between "
                "their nodes, which carry the contact and do not see it: forces are too small, and "
                "vary as the obstacle slides from node to node. Use facets a third as large as its "
                "radius.",
                *(group.surfaces, deepest, unseen),
                level=logging.WARNING,
                about=str(group.surfaces),
            )
    shared = np.zeros(len(entry), dtype=np.bool_)
    return couple(
        V, group, whole_nodes, None, integrals, faces, shared, moved, measured=-obstacle_normals
    )


def _corner_contact_normals(
    surface: SmoothSurface, facet_nodes: Indices, obstacle_normals: Array, turns: Array
) -> Array:
    """Return the contact normals (n, corners, 3) at the corners of facets.

    Args:
        surface: the smooth surface of the facets.
        facet_nodes: (n, corners) nodes at the corners.
        obstacle_normals: (n, corners, 3) unit normals of the obstacle at the corners.
        turns: (n,) angles by which the obstacle's normals turn over the facets [rad].
    """
    outward = surface.corner_normals.reshape(-1, 3)
    own_turns = np.repeat(surface.turns, facet_nodes.shape[1])
    largest = np.zeros(facet_nodes.max(initial=-1) + 1)
    np.maximum.at(largest, facet_nodes, turns[:, None])
    at_nodes = largest[facet_nodes].ravel()
    exact = -obstacle_normals.reshape(-1, 3)
    normals, _ = contact_normals(outward, -exact, own_turns, at_nodes)
    low, high = RESOLVED_ANGLES
    unresolved = np.clip((at_nodes - low) / (high - low), 0.0, 1.0)[:, None]
    normals = unresolved * normals + (1.0 - unresolved) * exact
    return np.asarray(normals.reshape(obstacle_normals.shape))


def _facing_corners(facets: Facets, obstacle: RigidObstacle, normals: Array) -> tuple[Mask, Array]:
    """Return where facets face the obstacle, and how far its normals turn.

    A facet faces the obstacle at a corner if the normals of both are opposed at this corner and at
    the centre of the facet. So, if an edge of the body lies in a corner between walls of the
    obstacle, only the facets in front of the wall that is nearest to this edge count at the edge's
    nodes.

    Args:
        facets: the facets of the surface.
        obstacle: the rigid obstacle.
        normals: (n, corners, 3) unit normals of the obstacle at the corners.

    Returns:
        Whether a facet faces the obstacle at its corners (n, corners), and the angles (n,) by which
        the obstacle's normals turn over the facets [rad].
    """
    middle, _ = quadrature(facets.cell, 1)
    centres = np.einsum("qk,nki->nqi", facets.basis(middle), facets.points)[:, 0]
    _, centre_normals = obstacle.at(centres)

    def opposed(x: Array, normals: Array) -> Mask:
        vectors = facets.area_vectors(x)
        cosine = np.einsum("nqi,nqi->nq", vectors, normals) / np.linalg.norm(vectors, axis=2)
        return np.asarray(cosine < -FACING_COSINE)

    faces = opposed(lagrange_points(facets.cell, 1), normals)
    faces &= opposed(middle, centre_normals[:, None])
    return faces, turned_angles(np.einsum("nci,ni->nc", normals, centre_normals))


def whole_facet_integrals(facets: Facets) -> tuple[Array, Array]:
    """Return integrals as if every facet were covered completely. Not collective.

    Returns:
        (n, corners, corners) integrals of the products of two hat functions, and (n, corners, k)
        integrals of hat functions times basis functions of the displacement.
    """
    x, w = quadrature(facets.cell, 4 * facets.degree + 2)
    area = facets.area_elements(x) * w
    hats, basis = facets.hats(x), facets.basis(x)
    return (
        np.einsum("nq,qa,qb->nab", area, hats, hats, optimize=True),
        np.einsum("nq,qa,qk->nak", area, hats, basis, optimize=True),
    )
