"""The geometry that a mesh was made of: what is nearest to a point on its curved surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.number import integer
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.gmsh_files import gmsh_session, open_file

#: From points (3, n) near a surface to the points on it next to them [length].
Projection: TypeAlias = Callable[[Array], Array]

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
    def projections(self, *, to_edges: bool = True) -> Iterator[dict[int, Projection]]:
        """Open the file, and yield tag -> function from points (3, n) to the nearest ones on it.

        Not collective: each rank has Gmsh for itself.

        Args:
            to_edges: whether new nodes of a surface, which are next to its edge if they are on it,
                go there, so that what is flat on its other side stays flat.

        Raises:
            InputError: a parameter is wrong by now.
            MeshError: there is no such file any more, or Gmsh cannot read it.
        """
        with gmsh_session() as gmsh:
            open_file(gmsh, self.path, self.parameters, again=True)
            dim = gmsh.model.getDimension() - 1
            yield {
                tag: partial(_nearest, gmsh.model, dim, entities, to_edges)
                for tag, entities in self.curved.items()
            }


#: That of Gmsh, or tag of facets -> projection on the surface that they stand for.
Geometry: TypeAlias = GmshGeometry | Mapping[int, Projection]


def check_geometry(geometry: Geometry | None) -> None:
    """Check what a user gives. Not collective.

    Raises:
        InputError: it is no geometry.
    """
    if geometry is None or isinstance(geometry, GmshGeometry):
        return
    if not isinstance(geometry, Mapping) or not all(
        integer(tag) is not None and callable(function) for tag, function in geometry.items()
    ):
        raise InputError(
            "geometry must be that of read_gmsh(...), or such as {7: function}, from the tag of "
            "facets to a function from points (3, n) to those on the surface next to them; found "
            f"{shown(geometry)}."
        )


@contextmanager
def projections(geometry: Geometry) -> Iterator[Mapping[int, Projection]]:
    """Yield tag -> projection of any points; see `GmshGeometry.projections`. Not collective."""
    if isinstance(geometry, GmshGeometry):
        with geometry.projections(to_edges=False) as found:
            yield found
    else:
        yield geometry


def projected(points: Array, name: str, projection: Projection, dim: int) -> Array:
    """Return the points (n, 3) on a surface next to some [length]. Not collective.

    Args:
        points: (n, 3).
        name: of the projection, for messages.
        projection: on the surface.
        dim: of space; other coordinates stay as they are.

    Raises:
        InputError: the projection fails, or gives something else than as many finite points.
    """
    if len(points) == 0:
        return points
    found = np.asarray(projection(points.T.copy()))
    if found.shape != (3, len(points)) or found.dtype.kind not in "fiu":
        raise InputError(
            f"{name} must give real points of shape (3, {len(points)}), found {found.dtype} of "
            f"shape {found.shape}."
        )
    if not np.isfinite(found).all():
        where = tuple(float(f"{c:.6g}") for c in points[~np.isfinite(found).all(axis=0)][0])
        raise InputError(f"{name} gives no finite point next to {where}.")
    result = points.copy()
    result[:, :dim] = found.T[:, :dim]
    return result


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


def _nearest(model: Any, dim: int, entities: Sequence[int], to_edges: bool, points: Array) -> Array:
    """Return the nearest points (3, n) of surfaces, or of their edges next to these.

    Raises:
        InputError: too few points are on the surface to begin with.
    """
    surfaces = [(dim, entity) for entity in entities]
    place, distance = _nearest_of(model, surfaces, points)
    if dim > 1 and to_edges:
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
