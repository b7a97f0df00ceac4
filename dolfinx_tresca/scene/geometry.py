"""Gmsh's models, and the projection of points onto the curved surfaces that facets approximate."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arguments import check_word, checked_number
from dolfinx_tresca._base.arrays import Array, integer
from dolfinx_tresca.errors import InputError, MeshError, shown, shown_place

#: Endings of the names of CAD files, and of all files that Gmsh reads here.
CAD_SUFFIXES = (".step", ".stp", ".brep", ".iges", ".igs", ".xao")
SUFFIXES = (".geo", ".msh", *CAD_SUFFIXES)

#: Unit of length in which STEP and IGES files are read -> OpenCASCADE's name of this unit.
UNITS = {"mm": "MM", "cm": "CM", "m": "M", "um": "UM", "km": "KM", "in": "INCH", "ft": "FT"}


@contextmanager
def gmsh_session() -> Iterator[Any]:
    """Yield the initialised gmsh module; a session that the user has opened keeps its models."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MeshError(
            f"reading a Gmsh file needs the Python package gmsh: {error}. Install it with pip, and "
            "its libraries with apt: libglu1-mesa libgl1 libxrender1 libxcursor1 libxft2."
        ) from error

    ours = not gmsh.isInitialized()
    if ours:
        gmsh.initialize(interruptible=False)
    current, models = gmsh.model.getCurrent(), len(gmsh.model.list())
    try:
        with options(gmsh, {"General.Terminal": 0}):
            yield gmsh
    finally:
        if ours:
            gmsh.finalize()
        else:
            while len(gmsh.model.list()) > models:  # the newest model is current
                gmsh.model.remove()
            gmsh.model.setCurrent(current)


@contextmanager
def options(gmsh: Any, values: Mapping[str, float]) -> Iterator[None]:
    """Set options of Gmsh, name -> number, in a block, and restore them at its end."""
    before = {name: gmsh.option.getNumber(name) for name in values}
    try:
        for name, value in values.items():
            gmsh.option.setNumber(name, value)
        yield
    finally:
        for name, value in before.items():
            gmsh.option.setNumber(name, value)


def open_file(gmsh: Any, path: Path, parameters: Mapping[str, float], *, unit: str = "mm") -> None:
    """Open a file with one of `SUFFIXES` in Gmsh, as a new current model.

    `parameters` are values of names that a `.geo` file declares with `DefineConstant`; a file that
    sets them itself is refused. `unit` is the unit of length of coordinates, for STEP and IGES.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"read_gmsh reads {', '.join(SUFFIXES)} files, found '{path}'.")
    check_word("unit", unit, tuple(UNITS))
    if not path.is_file():
        raise MeshError(f"there is no file '{path}' (looked for from '{Path.cwd()}').")
    for name, value in parameters.items():
        checked_number(f"parameter {name} of '{path}'", value, "(-inf, inf)")
    if suffix in CAD_SUFFIXES:
        gmsh.option.setString("Geometry.OCCTargetUnit", UNITS[unit])
        for option in ("OCCSewFaces", "OCCMakeSolids"):  # IGES files have faces without order
            gmsh.option.setNumber(f"Geometry.{option}", suffix in (".iges", ".igs"))
    gmsh.model.add("")  # gmsh.open deletes the current model if it looks empty
    gmsh.parser.clear()
    gmsh.onelab.clear()
    # if Gmsh's parser raised an error itself, the next call would continue with the rest of the
    # file, even after gmsh.finalize()
    with options(gmsh, {"General.AbortOnError": 0}), tempfile.TemporaryDirectory() as folder:
        opened = Path(folder, "with_parameters.geo") if parameters else path
        if parameters:  # a `.geo` file that sets them, so that DefineConstant does not change them
            lines = [f"{name} = {float(value)!r};" for name, value in parameters.items()]
            quote = "'" if '"' in str(path.resolve()) else '"'  # Gmsh has no escape sequence
            opened.write_text("\n".join([*lines, f"Include {quote}{path.resolve()}{quote};\n"]))
        gmsh.logger.start()
        try:
            gmsh.open(str(opened))
            errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
        except Exception as error:  # gmsh raises nothing more specific
            errors = [f"Error: {error}"]
        finally:
            gmsh.logger.stop()
    if errors:
        raise MeshError(f"Gmsh cannot use '{path}': {errors[0].partition(': ')[2]}")
    for name, value in parameters.items():
        actual = gmsh.parser.getNumber(name)[0]
        if actual != float(value):
            raise InputError(
                f"'{path}' sets {name} = {actual:g} itself and ignores the value {float(value):g}. "
                f"Declare it there as DefineConstant[ {name} = {actual:g} ]."
            )


#: Function from points (3, n) near a surface to the nearest points (3, n) on the surface [length].
Projection: TypeAlias = Callable[[Array], Array]

#: Distance of nodes from the surface from which the mesh was made, relative to the size of a facet,
#: up to which they count as on it. CAD files are accurate to about 1e-7 of their unit of length.
ON_SURFACE = 1e-5

#: Rounding error of projected points, relative to the size of the surface.
PROJECTION_ROUNDING = 1e-8


@dataclass(frozen=True)
class GmshGeometry:
    """The model from which Gmsh made a mesh, and its groups of curved surfaces (in 2D curves).

    Attributes:
        path: path of the `.geo` or CAD file; `gmsh.model` for a model without file.
        parameters: values of the names that the file declares with `DefineConstant`.
        curved: tag of a physical group of facets that has a curved part -> Gmsh's numbers of all
            surfaces in the group.
        unit: unit of length of the mesh, for STEP and IGES files.
        content: shapes of a model without file, as text of a `.xao` file.
    """

    path: Path
    parameters: Mapping[str, float]
    curved: Mapping[int, tuple[int, ...]]
    unit: str = "mm"
    content: bytes | None = field(default=None, repr=False)

    @classmethod
    def from_shapes(cls, gmsh: Any) -> GmshGeometry | None:
        """Return the geometry of the current model; None if it has no shapes of OpenCASCADE."""
        if not gmsh.model.occ.getEntities(gmsh.model.getDimension() - 1):
            return None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "shapes.xao"  # it keeps groups, in contrast to .brep
            gmsh.write(str(path))
            shapes = cls(Path("gmsh.model"), {}, {}, content=path.read_bytes())
        with shapes._model() as copied:  # the copy may number its surfaces in another way
            return replace(shapes, curved=curved_groups(copied))

    @contextmanager
    def _model(self) -> Iterator[Any]:
        """Open the file, or the `content`, in Gmsh and yield the model until the block ends."""
        with gmsh_session() as gmsh, tempfile.TemporaryDirectory() as folder:
            path = self.path
            if self.content is not None:
                path = Path(folder) / "shapes.xao"
                path.write_bytes(self.content)
            open_file(gmsh, path, self.parameters, unit=self.unit)
            yield gmsh.model


def curved_groups(model: Any) -> dict[int, tuple[int, ...]]:
    """Return `GmshGeometry.curved`: tag -> all surfaces of each group that has a curved one."""
    dim = model.getDimension() - 1
    groups = {}
    for _, tag in model.getPhysicalGroups(dim):
        entities = tuple(map(int, model.getEntitiesForPhysicalGroup(dim, tag)))
        if not all(_is_flat(model, dim, entity) for entity in entities):
            groups[tag] = entities
    return groups


#: A geometry of Gmsh, or tag of facets -> projection onto the surface that the facets approximate.
Geometry: TypeAlias = GmshGeometry | Mapping[int, Projection]


def check_geometry(geometry: Geometry | None) -> None:
    """Check the type of the user's argument `geometry`. Not collective."""
    is_table = isinstance(geometry, Mapping) and all(
        integer(tag) is not None and callable(function) for tag, function in geometry.items()
    )
    if not (is_table or geometry is None or isinstance(geometry, GmshGeometry)):
        raise InputError(
            "geometry must be read_gmsh(...).geometry, or tag of facets -> function from points "
            f"(3, n) to the nearest points (3, n) on the surface; found {shown(geometry)}."
        )


class ExactSurface(NamedTuple):
    """The surface that the facets with a tag approximate, by projections [length].

    Attributes:
        projections: the projection onto each smooth piece of the surface, for gaps and normals.
        project: projection of the nodes of a refined mesh onto the whole surface, and of those at
            an edge onto the edge, so that a flat surface beyond it stays flat. With Gmsh's geometry
            an InputError is raised if less than a tenth of the nodes are on the surface before.
    """

    projections: Sequence[Projection]
    project: Projection


@contextmanager
def open_geometry(geometry: Geometry) -> Iterator[Mapping[int, ExactSurface]]:
    """Yield tag -> exact surface, for tags of curved surfaces; each rank opens the model itself."""
    if not isinstance(geometry, GmshGeometry):
        yield {int(tag): ExactSurface([function], function) for tag, function in geometry.items()}
        return
    with geometry._model() as model:
        dim = model.getDimension() - 1
        yield {
            tag: ExactSurface(
                [partial(_nearest, model, (dim, entity)) for entity in entities],
                partial(_project_to_surfaces, model, dim, entities),
            )
            for tag, entities in geometry.curved.items()
        }


def project_points(points: Array, name: str, projection: Projection, dim: int) -> Array:
    """Return points (n, 3) moved by a user's or Gmsh's projection, whose result is checked.

    Error messages call the projection `name`. If `dim` is 2, the third coordinate stays.
    """
    if len(points) == 0:
        return points
    projected = np.asarray(projection(points.T.copy()))
    if projected.shape != (3, len(points)) or projected.dtype.kind not in "fiu":
        raise InputError(
            f"{name} must give real points of shape (3, {len(points)}), found {projected.dtype} of "
            f"shape {projected.shape}."
        )
    finite = np.isfinite(projected).all(axis=0)
    if not finite.all():
        raise InputError(f"{name} gives no finite point next to {shown_place(points[~finite][0])}.")
    result = points.copy()
    result[:, :dim] = projected.T[:, :dim]
    return result


def _is_flat(model: Any, dim: int, entity: int) -> bool:
    """Return whether a surface (dim = 2) is plane, or a curve (dim = 1) is straight."""
    if model.getType(dim, entity) in ("Plane", "Line"):
        return True
    _, points = _samples(model, dim, entity, per_axis=5)
    # the extents along the principal axes, from the largest to the least
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[dim] <= 1e-9 * extents[0])  # less is rounding


def _samples(model: Any, dim: int, entity: int, per_axis: int) -> tuple[Array, Array]:
    """Return the parameters (n, dim) and points (n, 3) of a grid on a surface or a curve."""
    low, high = model.getParametrizationBounds(dim, entity)
    axes = np.linspace(low, high, per_axis).T  # (dim, per_axis)
    grid = np.meshgrid(*axes)  # an array for each parameter
    parameters = np.stack(grid, axis=-1).reshape(-1, dim)
    points = np.reshape(model.getValue(dim, entity, parameters.ravel()), (-1, 3))
    return parameters, points


def _project_to_surfaces(model: Any, dim: int, entities: Sequence[int], points: Array) -> Array:
    """Return points (3, n) projected onto surfaces; see `ExactSurface.project`."""
    surfaces = [(dim, entity) for entity in entities]
    nearest, distance = _nearest_points(model, surfaces, points)
    if dim > 1:
        on_edge, away = _nearest_points(model, model.getBoundary(surfaces, oriented=False), points)
        # other nodes are about a facet's size away from the edge, but hardly from the surfaces
        nearest = np.where(away <= 3.0 * distance, on_edge, nearest)
    # nodes that are on the surface keep their coordinates to the last digit
    on_surface = distance <= PROJECTION_ROUNDING * np.ptp(points, axis=1).max()
    if on_surface.mean() < 0.1:  # after a refinement at least a fourth, the old nodes, are on it
        raise InputError(
            "nodes are not on the surfaces from which Gmsh made the mesh: it was moved or scaled. "
            "Take dataclasses.replace(tagged_mesh, geometry=...) with {tag: function} or None."
        )
    return np.where(on_surface, points, nearest)


def _nearest_points(
    model: Any, entities: Sequence[tuple[int, int]], points: Array
) -> tuple[Array, Array]:
    """Return, for points (3, n), the nearest (3, n) on any entity, and the distances (n,)."""
    nearest, distance = points.copy(), np.full(points.shape[1], np.inf)
    for entity in entities:
        candidate = _nearest(model, entity, points)
        away = np.linalg.norm(candidate - points, axis=0)
        nearer = away < distance
        nearest[:, nearer] = candidate[:, nearer]
        distance[nearer] = away[nearer]
    return nearest, distance


def _nearest(model: Any, entity: tuple[int, int], points: Array) -> Array:
    """Return the points (3, n) of a surface or a curve (dim, number) nearest to points (3, n)."""
    # "Surface": the type of surfaces of Gmsh's built-in kernel that were not made as planes
    if model.getType(*entity) == "Surface" and not _is_flat(model, *entity):
        return _nearest_by_gauss_newton(model, entity[1], points)
    closest = model.getClosestPoint(*entity, points.T.ravel())[0]
    nearest = np.reshape(closest, (-1, 3)).T
    ends = model.getParametrizationBounds(*entity) if entity[0] == 1 else ()
    # OpenCASCADE's search misses the end of an arc that ends where its circle begins
    for end in np.ravel(ends):
        point = np.reshape(model.getValue(*entity, [end]), (3, 1))
        nearer = np.linalg.norm(point - points, axis=0) < np.linalg.norm(nearest - points, axis=0)
        nearest[:, nearer] = point
    return nearest


def _nearest_by_gauss_newton(model: Any, surface: int, points: Array) -> Array:
    """Return the nearest points (3, n) of a curved surface of Gmsh's built-in kernel.

    Gmsh's own search, on the surfaces of `press_fit.geo`, takes 4 to 35 times as long, and finds
    points that are farther away than the nearest ones, by up to 1e-3 of the size of the surface.
    """
    # start at the nearest of 32 x 32 points of the surface
    low, high = model.getParametrizationBounds(2, surface)
    grid, samples = _samples(model, 2, surface, per_axis=32)
    rounding = PROJECTION_ROUNDING * np.ptp(samples, axis=0).max()
    parameters = grid[cKDTree(samples).query(points.T)[1]]
    for _ in range(20):  # on the surfaces of the package's meshes it takes three steps
        tangents = np.reshape(model.getDerivative(2, surface, parameters.ravel()), (-1, 2, 3))
        places = np.reshape(model.getValue(2, surface, parameters.ravel()), (-1, 3))
        # Gauss-Newton: parameters' step with which the tangent plane comes nearest to the point
        step = np.linalg.pinv(tangents.swapaxes(1, 2)) @ (points.T - places)[:, :, None]
        previous, parameters = parameters, np.clip(parameters + step[:, :, 0], low, high)
        shifts = np.einsum("ni,nik->nk", parameters - previous, tangents)
        if np.abs(shifts).max(initial=0.0) <= rounding:
            break
    return np.reshape(model.getValue(2, surface, parameters.ravel()), (-1, 3)).T
