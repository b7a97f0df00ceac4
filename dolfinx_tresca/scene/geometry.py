"""The geometry that Gmsh made a mesh of: what is nearest to a point on its curved surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.gmsh_files import gmsh_session, open_file

#: Points along each parameter of a surface that tell whether it is flat, and the height of these
#: over their distances that is rounding.
SAMPLES, FLAT = 5, 1e-9

#: A node is on an edge of a surface if that is not farther away than so many times the surface
#: itself: other nodes are by the size of a facet, which is much more than its sagitta.
EDGE_REACH = 3.0

#: Part of the nodes that are on their surface before they are moved: the old ones, at least about
#: a fourth.
LEAST_ON_SURFACE = 0.1

#: Distance over the size of the surface that is rounding of Gmsh's projections.
PROJECTION_ROUNDING = 1e-8


@dataclass(frozen=True)
class GmshGeometry:
    """A `.geo` file, and which of its surfaces (in 2D curves) are curved.

    Attributes:
        path: of the file.
        parameters: values of names that it declares with `DefineConstant`.
        curved: tag of a physical group of facets -> its curved surfaces, by Gmsh's numbers.
    """

    path: Path
    parameters: Mapping[str, float]
    curved: Mapping[int, tuple[int, ...]]

    @classmethod
    def of(cls, gmsh: Any, path: Path, parameters: Mapping[str, float]) -> GmshGeometry:
        """Return the geometry of the file that is open in Gmsh."""
        model = gmsh.model
        dim = model.getDimension() - 1
        curved = {
            tag: tuple(
                int(entity)
                for entity in model.getEntitiesForPhysicalGroup(dim, tag)
                if not _is_flat(model, dim, entity)
            )
            for _, tag in model.getPhysicalGroups(dim)
        }
        return cls(path.resolve(), dict(parameters), {k: v for k, v in curved.items() if v})

    @contextmanager
    def projections(self) -> Iterator[dict[int, Callable[[Array], Array]]]:
        """Open the file, and yield tag -> function from points (3, n) to the nearest ones on it.

        Not collective: each rank has Gmsh for itself. Nodes on the edge of a surface stay on it, so
        that what is flat on its other side stays flat.

        Raises:
            InputError: a parameter is wrong by now.
            MeshError: there is no such file any more, or Gmsh cannot read it.
        """
        with gmsh_session() as gmsh:
            open_file(gmsh, self.path, self.parameters)
            dim = gmsh.model.getDimension() - 1
            yield {
                tag: partial(_nearest, gmsh.model, dim, entities)
                for tag, entities in self.curved.items()
            }


def _is_flat(model: Any, dim: int, entity: int) -> bool:
    """Return whether a surface is a plane, or a curve is straight."""
    if model.getType(dim, entity) in ("Plane", "Line"):
        return True
    low, high = model.getParametrizationBounds(dim, entity)
    lines = [np.linspace(one, other, SAMPLES) for one, other in zip(low, high, strict=True)]
    parameters = np.stack(np.meshgrid(*lines), axis=-1)
    points = np.reshape(model.getValue(dim, entity, parameters.ravel()), (-1, 3))
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(sizes[dim] <= FLAT * sizes[0])


def _nearest(model: Any, dim: int, entities: Sequence[int], points: Array) -> Array:
    """Return the nearest points (3, n) of surfaces, or of their edges next to these.

    Raises:
        InputError: too few points are on the surface to begin with.
    """
    surfaces = [(dim, entity) for entity in entities]
    place, distance = _nearest_of(model, surfaces, points)
    if dim > 1:
        edges = model.getBoundary(surfaces, oriented=False)
        on_edge, away = _nearest_of(model, edges, points)
        place = np.where(away <= EDGE_REACH * distance, on_edge, place)
    # nodes that are on the surface stay what they are, to the last digit
    there = distance <= PROJECTION_ROUNDING * np.ptp(points, axis=1).max()
    if there.mean() < LEAST_ON_SURFACE:
        raise InputError(
            "nodes are not on the surface of the geometry that Gmsh made the mesh of: it was moved "
            "or scaled since then. Give the curved surfaces as snap={tag: function}, or snap={}."
        )
    return np.where(there, points, place)


def _nearest_of(
    model: Any, entities: Sequence[tuple[int, int]], points: Array
) -> tuple[Array, Array]:
    """Return the nearest points (3, n) of some entities, and their distances (n,)."""
    place, distance = points.copy(), np.full(points.shape[1], np.inf)
    for dim, entity in entities:
        found, _ = model.getClosestPoint(dim, entity, points.T.ravel())
        there = np.reshape(found, (-1, 3)).T
        away = np.linalg.norm(there - points, axis=0)
        nearer = away < distance
        place[:, nearer], distance[nearer] = there[:, nearer], away[nearer]
    return place, distance
