"""Surfaces without bodies, on one rank: for tests of what is done with facets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca.pairing.search.facets import FACET_ARRAYS, Facets, SurfaceNodes, quadrature
from scenes.patches import raised

#: Points (n, 3) -> points (n, 3).
Map = Callable[[np.ndarray], np.ndarray]

CELLS = ("interval", "triangle", "quadrilateral")


def sheet(
    cell: str,
    n: int,
    box: tuple[float, float] = (0.0, 1.0),
    *,
    degree: int = 1,
    height: float = 0.0,
    up: bool = True,
    distort: float = 0.0,
    first: int = 0,
    move: Map | None = None,
    away: Map | None = None,
) -> Facets:
    """Return a square of n by n parts along x and y, or in 2D a line of n parts along x.

    Args:
        cell: of the facets.
        n: parts along each side.
        box: where it is along each axis.
        degree: of the displacement.
        height: in 3D along z, in 2D along y.
        up: whether its outward normals point that way.
        distort: the largest shift of inner nodes, over half a part.
        first: the lowest number of a node.
        move: maps all points at last.
        away: outward directions at points before that, else given by `up`.
    """
    line = np.linspace(*box, n + 1)
    if cell == "interval":
        points, number = line[:, None], np.arange(n + 1)
        facets = np.stack([number[:-1], number[1:]], axis=1)
    else:
        x, y = np.meshgrid(line, line, indexing="ij")
        points = np.stack([x.ravel(), y.ravel()], axis=1)
        number = np.arange(len(points)).reshape(n + 1, n + 1)
        corners = (number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:])
        facets = np.stack([corner.ravel() for corner in corners], axis=1)
        if cell == "triangle":
            facets = np.concatenate([facets[:, [0, 1, 3]], facets[:, [0, 3, 2]]])
    inner = ((points > box[0] + 1e-9) & (points < box[1] - 1e-9)).all(axis=1)
    shift = np.random.default_rng(n).uniform(-0.5, 0.5, points.shape)
    points = points + distort * (box[1] - box[0]) / n * np.where(inner[:, None], shift, 0.0)
    if degree > 1:
        points, facets = raised(cell, degree, points, facets)
    dim = points.shape[1]
    x = np.zeros((len(points), 3))
    x[:, :dim], x[:, dim] = points, height
    normal = np.zeros(3)
    normal[dim] = 1.0 if up else -1.0
    count = dim + 1 if cell == "triangle" else 2**dim
    x = x if move is None else move(x)
    middle = x[facets[:, :count]].mean(axis=1)
    inside = middle - (normal if away is None else away(middle))
    free = np.ones((len(facets), count, dim + 1), dtype=bool)
    numbers = first + facets.astype(np.int64)
    result = Facets(
        cell,
        degree,
        numbers,
        x[facets],
        free,
        numbers[:, :count],
        outward=np.ones(len(facets)),
        offsets=np.zeros((len(facets), 0, 3)),
        origins=np.zeros((len(facets), 0)),
        tag_index=np.zeros(len(facets), dtype=np.intp),
        bent=False,
        plane=True,
    ).moved_to(x[facets])
    vectors = result.area_vectors(quadrature(cell, 1)[0])[:, 0]
    result.outward[np.einsum("ni,ni->n", vectors, middle - inside) < 0.0] = -1.0
    return result


def joined(*parts: Facets) -> Facets:
    """Return several surfaces as one."""
    one = parts[0]
    arrays = FACET_ARRAYS
    together = {name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays}
    bent, plane = any(part.bent for part in parts), all(part.plane for part in parts)
    return Facets(one.cell, one.degree, bent=bent, plane=plane, **together)


def nodes_of(facets: Facets) -> SurfaceNodes:
    """Return the nodes of a surface."""
    return SurfaceNodes.from_facets(facets)
