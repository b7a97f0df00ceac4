"""Pairs of faces of different bodies that touch or nearly touch, found in a mesh with tags."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective
from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers, Mask, real
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.parallel import each_warning_once, gather_rows, log, reduce_array
from dolfinx_tresca.errors import InputError, MeshError, PairingError, shown
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.output.table import Row, Tabulated
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.pairing.search.self_contact import FINER
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.scene.mesh import NamedTags, TaggedMesh
from dolfinx_tresca.scene.pair import ContactPair


@dataclass(frozen=True)
class TouchingFaces:
    """Measures of two faces that touch or nearly touch, where their distance is small.

    Gaps are those of the problem: means at the nodes of the secondary face, weighted by dual basis
    functions. At a ball that touches a plane they are off by about its height over a facet.

    Attributes:
        area: area of the secondary face there, in 2D its length [length^2].
        gap: least gap there [length]; 0 if faces overlap.
        overlap: largest overlap there [length]; 0 if there is none.
    """

    area: float
    gap: float
    overlap: float


class Contacts(Tabulated, list[ContactPair]):
    """The list of contact pairs that `contacts` has found; `print` shows their areas and gaps.

    It is changed like any list before it is given to a problem: `del pairs[0]`, or
    `pairs[0] = dataclasses.replace(pairs[0], friction=Bonded())`.

    Attributes:
        measures: (secondary, primary) tags -> area, gap and overlap.
        distance: largest distance of the faces [length].
    """

    def __init__(
        self,
        pairs: Sequence[ContactPair],
        measures: Mapping[tuple[int, int], TouchingFaces],
        distance: float,
    ) -> None:
        """Make the list of the pairs. Not collective."""
        super().__init__(pairs)
        self.measures, self.distance = dict(measures), distance

    def _rows(self) -> list[Row]:
        rows = [("contacts", f"{len(self)} pairs of faces nearer than {self.distance:.4g}")]
        for pair in self:
            words = str(pair.friction)
            faces = self.measures.get((pair.secondary, pair.primary))
            if faces is not None:
                distances = f"gap {faces.gap:.3g}, overlap {faces.overlap:.3g}"
                words = f"area {faces.area:.4g}, {distances}, {words}"
            rows.append((f"  {pair}", words))
        return rows

    def plot(self, mesh: Any) -> Any:
        """Return a `pyvista.Plotter` with the paired faces of this rank, a colour for each pair.

        Not collective.

        Args:
            mesh: the mesh.

        Raises:
            ImportError: pyvista is not installed.
        """
        import pyvista

        plotter = pyvista.Plotter()
        dim = mesh.topology.dim
        plotter.add_mesh(pyvista.UnstructuredGrid(*dolfinx.plot.vtk_mesh(mesh, dim)), opacity=0.1)
        for k, pair in enumerate(self):
            colour = pyvista.Color(f"tab:{('blue', 'orange', 'green', 'red', 'purple')[k % 5]}")
            for facets in (pair.facet_tags.find(tag) for tag in (pair.secondary, pair.primary)):
                if len(facets):
                    grid = pyvista.UnstructuredGrid(*dolfinx.plot.vtk_mesh(mesh, dim - 1, facets))
                    plotter.add_mesh(grid, color=colour, label=str(pair))
        plotter.add_legend()
        return plotter


@dataclass(frozen=True)
class _Face:
    """The facets with a tag: their nodes on this rank, bodies, box (2, 3) and mean size."""

    nodes: LocalNumbers
    bodies: frozenset[int]
    box: Array
    size: float


def _comm_of_mesh(given: Mapping[str, Any]) -> MPI.Comm | None:
    """Return the communicator of the argument `tagged`, if it has a mesh. Not collective."""
    tagged = given.get("tagged")
    return tagged.mesh.comm if isinstance(tagged, TaggedMesh) else None


@collective(_comm_of_mesh, ignored=("tagged", "friction"))
def contacts(
    tagged: TaggedMesh, *, friction: Friction, distance: float | None = None, **options: Any
) -> Contacts:
    """Return the contact pairs of all tagged faces of different bodies that are near each other.

    Collective. Of two bodies the one with finer facets is secondary, or the one with the smaller
    least x, then y, then z, if their facets are alike. Gaps are those of the problem: between exact
    surfaces where the geometry is known. Bodies that touch no other body are warned of.

    Args:
        tagged: result of `read_gmsh`. All faces that may touch have tags. Tags that several bodies
            have, such as those of planes of symmetry, are left out, which is logged.
        friction: law of all pairs.
        distance: largest gap and largest overlap [length] of faces that are a pair; None: the mean
            size of the facets of the finer body.
        **options: further arguments of all pairs, such as `sliding` (see `ContactPair`).

    Returns:
        A list of `ContactPair`, with a table.

    Raises:
        InputError: an argument is wrong.
        MeshError: no faces of different bodies are near each other.

    Example:
        >>> from mpi4py import MPI
        >>> from dolfinx_tresca import MESHES, Coulomb, contacts, read_gmsh
        >>> bricks = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_WORLD, N=2)
        >>> contacts(bricks, friction=Coulomb(0.3))
        [<ContactPair: lower_contact on upper_contact, coefficient of friction 0.3>]
    """
    if not isinstance(tagged, TaggedMesh):
        raise InputError(f"tagged must be the result of read_gmsh, found {shown(tagged)}.")
    limit = None if distance is None else real(distance)
    if distance is not None and (limit is None or not 0.0 < limit < np.inf):
        raise InputError(f"distance must be a positive number, found {shown(distance)}.")
    mesh, facet_tags = tagged.mesh, tagged.facet_tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
    label = label_bodies(V)
    faces = _faces(V, facet_tags, label)
    of_body: dict[int, list[float]] = {}
    for face in faces.values():
        if len(face.bodies) == 1:
            of_body.setdefault(min(face.bodies), []).append(face.size)
    sizes = {body: float(np.mean(body_sizes)) for body, body_sizes in of_body.items()}
    several = [str(tag) for tag, face in faces.items() if len(face.bodies) > 1]
    if several:
        log(mesh.comm, "contacts: tags %s, of several bodies, are left out", ", ".join(several))
    free = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=np.bool_)
    pairs: list[ContactPair] = []
    near_faces: dict[tuple[int, int], TouchingFaces] = {}
    reach = 0.0
    touched: set[int] = set()
    for both in combinations(sorted(faces), 2):
        face, other_face = (faces[tag] for tag in both)
        if len(face.bodies) > 1 or len(other_face.bodies) > 1 or face.bodies == other_face.bodies:
            continue
        bodies = [next(iter(side.bodies)) for side in (face, other_face)]
        near = min(sizes[body] for body in bodies) if limit is None else limit
        reach = max(reach, near)
        apart = np.maximum(face.box[0] - other_face.box[1], other_face.box[0] - face.box[1])
        if np.linalg.norm(np.maximum(apart, 0.0)) > near:
            continue
        ratio = sizes[bodies[0]] / sizes[bodies[1]]
        finer = ratio < FINER or (ratio <= 1.0 / FINER and bodies[0] < bodies[1])
        pair = ContactPair(facet_tags, *(both if finer else both[::-1]), friction, **options)
        measures = _measured(V, free, pair, near)
        if measures is not None:
            pairs.append(pair)
            near_faces[pair.secondary, pair.primary] = measures
            touched.update(bodies)
    cell_tags = tagged.cell_tags if isinstance(tagged.cell_tags, NamedTags) else None
    names = Bodies.from_space(V, cell_tags).names
    alone = [body for body in range(len(names)) if body not in touched]
    if alone and len(names) > 1:
        for body in alone:
            away = _distance_to_others(V, faces, body)
            error = MeshError(
                f"{names[body]} touches no other body: its tagged faces are {away:.3g} away from "
                f"those of others, more than {reach:.3g}. Check the positions and units of length "
                "of the bodies, that their faces have tags, or give a larger distance."
            )
            if not pairs:
                raise error
            log(mesh.comm, "%s", error, level=logging.WARNING, about=names[body])
    if not pairs:
        raise MeshError("the mesh is one body: contacts are between faces of different bodies.")
    return Contacts(pairs, near_faces, reach)


def _measured(V: Any, free: Mask, pair: ContactPair, near: float) -> TouchingFaces | None:
    """Return the measures of a pair's faces where they are near; None if nowhere. Collective."""
    limited = ContactPair(
        *(pair.facet_tags, pair.secondary, pair.primary, pair.friction),
        search_distance=near,
        geometry=pair.geometry,
    )
    try:
        with each_warning_once():
            operators = pair_surfaces(V, free, limited)
    except PairingError:
        return None
    depth = float(reduce_array(V.mesh.comm, -operators.gap.min(initial=np.inf), MPI.MAX))
    area = float(reduce_array(V.mesh.comm, operators.weights.sum()))
    return TouchingFaces(area, max(0.0, -depth), max(0.0, depth))


def _faces(V: Any, facet_tags: Any, label: Indices) -> dict[int, _Face]:
    """Return tag -> the face, for all tags whose facets are on the boundary. Collective."""
    mesh = V.mesh
    comm, dim = mesh.comm, facet_tags.dim
    mesh.topology.create_connectivity(dim, dim + 1)
    outside = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    owned = mesh.topology.index_map(dim).size_local
    x = V.tabulate_dof_coordinates()
    result: dict[int, _Face] = {}
    for tag in sorted(set().union(*comm.allgather(set(np.unique(facet_tags.values).tolist())))):
        facets = facet_tags.find(tag)
        facets = facets[facets < owned]
        inside = reduce_array(comm, int((~np.isin(facets, outside)).sum()))
        nodes = fem.locate_dofs_topological(V, dim, facets, remote=False)
        points = x[nodes]
        corners = [points.min(axis=0, initial=np.inf), -points.max(axis=0, initial=-np.inf)]
        low, high = reduce_array(comm, corners, MPI.MIN)
        h = mesh.h(dim, facets) if len(facets) else np.zeros(0)
        length, number = reduce_array(comm, [h.sum(), float(len(h))])
        bodies = frozenset[int]().union(*comm.allgather(frozenset(label[nodes].tolist())))
        if not inside and number:
            result[tag] = _Face(nodes, bodies, np.vstack([low, -high]), length / number)
    return result


def _distance_to_others(V: Any, faces: Mapping[int, _Face], body: int) -> float:
    """Return the least distance of tagged nodes of a body from those of others. Collective."""
    x = V.tabulate_dof_coordinates()
    sides = [(x[face.nodes], body in face.bodies) for face in faces.values()]
    own_points, other_points = (
        np.concatenate([x[:0], *(face for face, is_own in sides if is_own == side)])
        for side in (True, False)
    )
    points = gather_rows(V.mesh.comm, own_points)
    nearest = np.inf
    if len(points) and len(other_points):
        nearest = float(cKDTree(points).query(other_points)[0].min())
    return float(reduce_array(V.mesh.comm, nearest, MPI.MIN))
