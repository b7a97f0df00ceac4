"""Normals of second order at the nodes of curved surfaces."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Costs of the unknowns, over those of a misfit of the neighbours' heights, where neighbours leave
#: them open: two slopes, mean curvature, and two differences of curvatures. A normal leans only as
#: far as neighbours say so, and with few of them curvatures are those of a sphere.
TILT_COST, CURVATURE_COSTS = 1e-1, (0.0, 1e-3, 1e-3)


def fitted_normals(facets: Facets, nodes: SurfaceNodes) -> Array:
    """Return the unit normals (n, 3) of parabolic surfaces through each node and its neighbours.

    The mean of the facets' normals (`SurfaceNodes.normals`) is exact on a sphere, but where a
    cylinder has facets of all sizes and shapes, as after local refinement, it is wrong by a part of
    the angle between them, and what is made of it, such as a height over facets, by a part of that
    height, however fine the mesh. A least-squares fit of a quadratic height function (Cazals and
    Pouget 2005, Estimating differential quantities using polynomial fitting of osculating jets) is
    not; where neighbours do not suffice for it the mean is kept. Right where all facets round a
    node are there.

    Not collective.

    Args:
        facets: of a surface.
        nodes: their corners.
    """
    count, corners = len(nodes.numbers), facets.corners
    one = np.repeat(nodes.facet_nodes, corners, axis=1).ravel()
    other = np.tile(nodes.facet_nodes, corners).ravel()
    one, other = one[one != other], other[one != other]
    across = np.eye(3)[np.abs(nodes.normals).argmin(axis=1)]
    if facets.dim == 1:
        across = np.broadcast_to([0.0, 0.0, 1.0], across.shape)
    x_axis = np.cross(across, nodes.normals)
    x_axis /= np.linalg.norm(x_axis, axis=1)[:, None]
    y_axis = np.cross(nodes.normals, x_axis)
    arm = nodes.points[other] - nodes.points[one]
    squares = np.bincount(one, np.square(arm).sum(axis=1), minlength=count)
    size = np.sqrt(squares / np.maximum(np.bincount(one, minlength=count), 1))
    arm = arm / size[one][:, None]
    x, y, height = (
        np.einsum("ni,ni->n", arm, axis[one]) for axis in (x_axis, y_axis, nodes.normals)
    )
    # costs of the last two are equal, and so the fit does not depend on the choice of axes
    terms = np.stack([x, y, x * x + y * y, x * x - y * y, 2.0 * x * y], axis=1)
    matrix, load = np.zeros((count, 5, 5)), np.zeros((count, 5))
    np.add.at(matrix, one, terms[:, :, None] * terms[:, None, :])
    np.add.at(load, one, terms * height[:, None])
    matrix += np.diag(np.square([TILT_COST, TILT_COST, *CURVATURE_COSTS]))
    slopes = np.linalg.solve(matrix, load[:, :, None])[:, :2, 0]
    normals = nodes.normals - slopes[:, :1] * x_axis - slopes[:, 1:] * y_axis
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])
