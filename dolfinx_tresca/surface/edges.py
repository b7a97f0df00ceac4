"""Sharp edges: where the facets round a node belong to several smooth patches."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.surface.search import expanded_ranges

#: Angle between the normals of two facets at a node [degrees] beyond which there is an edge between
#: them. Regular polygons of seven sides and more, which stand for circles, are smooth (51.4 degrees
#: and less); boxes and hexagonal prisms have edges (60 degrees and more).
EDGE_ANGLE = 55.0


def smooth_patches(node: Indices, normals: Array) -> tuple[Indices, Indices]:
    """Return the smooth patches round nodes: normals are averaged within one of them only.

    Two corners at one node are in the same patch if their normals differ by at most `EDGE_ANGLE`,
    or a chain of such corners connects them: a fillet is smooth.

    Args:
        node: (n,) the node of each corner of a facet, 0, 1, 2, ...
        normals: (n, 3) unit normals of the facets there.

    Returns:
        (n,) the patch of each corner, numbered by ascending nodes, and (patches,) their nodes.
    """
    count = int(node.max(initial=-1)) + 1
    mean = np.stack([np.bincount(node, normals[:, i], count) for i in range(3)], axis=1)
    leans = np.einsum("ni,ni->n", normals, mean[node])
    # within half the angle of their mean all normals are within the angle of each other
    limit = math.cos(math.radians(0.5 * EDGE_ANGLE)) * np.linalg.norm(mean, axis=1)
    corners = np.flatnonzero(np.isin(node, node[leans <= limit[node]]))
    if len(corners) == 0:
        return node, np.arange(count)
    part = np.zeros(len(node), dtype=np.intp)
    part[corners] = _connected(node[corners], normals[corners])
    parts = int(part.max()) + 1
    patches, patch = np.unique(node * parts + part, return_inverse=True)
    return patch, patches // parts


def _connected(node: Indices, normals: Array) -> Indices:
    """Return a number for each corner (n,), the same for those that are connected."""
    order = np.argsort(node, kind="stable")
    starts = np.searchsorted(node[order], node)
    numbers = np.searchsorted(node[order], node, side="right") - starts
    first, place = expanded_ranges(starts, numbers)
    second = order[place]
    angle = np.einsum("ni,ni->n", normals[first], normals[second])
    near = angle >= math.cos(math.radians(EDGE_ANGLE))
    graph = coo_array(
        (np.ones(near.sum()), (first[near], second[near])), shape=(len(node), len(node))
    )
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)
