"""Pairs of faces of different bodies that touch or nearly touch, found in a mesh with tags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.arguments import check_type, checked_number
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.parallel import each_warning_once, log, reduce_array, warn
from dolfinx_tresca.errors import MeshError, PairingError
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.pairing.visibility import is_secondary_body
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.scene.mesh import TaggedMesh, abridged_names
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.table import Row, Tabulated


class TouchingFaces(NamedTuple):
    """Measures of two faces, taken where they are within the `distance` of `contacts`.

    Gaps are those of the problem: means at the nodes of the secondary face, weighted by dual basis
    functions. Where a ball touches a plane, they are off by about the ball's height over a facet.

    Attributes:
        area: area of this part of the secondary face [length^2], in 2D its length [length].
        gap: least gap [length]; 0 if the faces overlap.
        overlap: largest overlap [length]; 0 if there is none.
    """

    area: float
    gap: float
    overlap: float


class Contacts(Tabulated, list[ContactPair]):
    """The list of contact pairs that `contacts` has found; `print` shows their areas and gaps.

    Change it like any list: `pairs[0] = dataclasses.replace(pairs[0], friction=Bonded())`.

    Attributes:
        measures: (secondary, primary) tags -> area, gap and overlap.
        distance: largest of the distances up to which two faces are paired [length].
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
            if faces := self.measures.get((pair.secondary, pair.primary)):
                area, gap, overlap = faces
                words = f"area {area:.4g}, gap {gap:.3g}, overlap {overlap:.3g}, {words}"
            rows.append((f"  {pair}", words))
        return rows


class _Face(NamedTuple):
    """The facets with a tag: their body, box (2, 3) and mean size."""

    body: int
    box: Array
    size: float


@collective(comm_of("tagged"), ignored=("tagged", "friction"))
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
        A list of `ContactPair`, whose areas and gaps `print` shows in a table.

    Raises:
        InputError: an argument is wrong.
        MeshError: no faces of different bodies are near each other.
    """
    check_type("tagged", tagged, TaggedMesh, "the result of read_gmsh")
    limit = None if distance is None else checked_number("distance", distance)
    mesh, facet_tags = tagged.mesh, tagged.facet_tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
    prescribed = np.zeros(V.dofmap.index_map.size_local * V.dofmap.index_map_bs, dtype=np.bool_)
    faces = _faces(V, facet_tags)
    # for each body its tags, the mean size of its facets, and how far away the other bodies are
    tags_of_body: dict[int, list[int]] = {}
    for tag, face in faces.items():
        tags_of_body.setdefault(face.body, []).append(tag)
    sizes: dict[int, float] = {}
    for body, tags_of_faces in tags_of_body.items():
        sizes[body] = float(np.mean([faces[tag].size for tag in tags_of_faces]))
    if len(sizes) < 2:
        raise MeshError("contacts need tags of two bodies, which no other body has on its faces.")
    distances = {body: np.inf for body in sizes}
    pairs: list[ContactPair] = []
    measures: dict[tuple[int, int], TouchingFaces] = {}
    reach = 0.0  # the largest of the distances up to which faces are a pair
    for tags in combinations(faces, 2):
        face, opposite = faces[tags[0]], faces[tags[1]]
        if face.body == opposite.body:
            continue
        near = min(sizes[face.body], sizes[opposite.body]) if limit is None else limit
        reach = max(reach, near)
        # distance of the boxes, from how far they are apart along each axis
        apart = np.maximum(face.box[0] - opposite.box[1], opposite.box[0] - face.box[1])
        away = float(np.linalg.norm(np.maximum(apart, 0.0)))
        for body in (face.body, opposite.body):
            distances[body] = min(distances[body], away)
        if away > near:
            continue
        if not is_secondary_body(face.body, opposite.body, sizes[face.body], sizes[opposite.body]):
            tags = tags[::-1]  # the secondary face comes first
        pair = ContactPair(facet_tags, *tags, friction, **options)
        # paired as in a problem, but without prescribed displacements, where the faces are near
        limited = replace(pair, pairing="auto", search_distance=near, sliding="small", gap=None)
        try:
            with each_warning_once():
                operators = pair_surfaces(V, prescribed, limited)
        except PairingError:
            continue
        depth = float(reduce_array(mesh.comm, -operators.gap.min(initial=np.inf), MPI.MAX))
        area = float(reduce_array(mesh.comm, operators.weights.sum()))
        pairs.append(pair)
        touch = TouchingFaces(area, gap=max(0.0, -depth), overlap=max(0.0, depth))
        measures[pair.secondary, pair.primary] = touch
    # warn of bodies that touch no other body; without any contact this is an error
    touching = {faces[tag].body for tags in measures for tag in tags}
    for body in sorted(sizes.keys() - touching):
        names = abridged_names(tags_of_body[body], facet_tags)
        error = MeshError(
            f"{names} touch no other body: their box is {distances[body]:.3g} away from the faces "
            f"of others, and pairs are nearer than {reach:.3g}. Check the positions and units of "
            "length of the bodies, that their faces have tags, or give a larger distance."
        )
        if not pairs:
            raise error
        warn(mesh.comm, "%s", error, about=names)
    return Contacts(pairs, measures, reach)


def _faces(V: Any, facet_tags: Any) -> dict[int, _Face]:
    """Return tag -> face, for tags whose facets are on the outside of one body. Collective.

    Tags of facets inside of a body are ignored, and tags of several bodies are logged.
    """
    mesh, label = V.mesh, label_bodies(V)
    comm, dim, x = mesh.comm, facet_tags.dim, V.tabulate_dof_coordinates()
    mesh.topology.create_connectivity(dim, dim + 1)
    outside = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    owned = mesh.topology.index_map(dim).size_local
    result: dict[int, _Face] = {}
    shared_tags = []
    own_tags = set(np.unique(facet_tags.values).tolist())
    for tag in sorted(set().union(*comm.allgather(own_tags))):
        facets = facet_tags.find(tag)
        facets = facets[facets < owned]
        nodes = fem.locate_dofs_topological(V, dim, facets, remote=False)
        # one minimum over the ranks for both corners of the box, the second one negated
        corners = [x[nodes].min(axis=0, initial=np.inf), -x[nodes].max(axis=0, initial=-np.inf)]
        low, negated_high = reduce_array(comm, corners, MPI.MIN)
        h = mesh.h(dim, facets) if len(facets) else np.zeros(0)
        outer = float(np.isin(facets, outside).sum())
        sizes, number, outer = reduce_array(comm, [h.sum(), float(len(h)), outer])
        bodies = set().union(*comm.allgather(set(label[nodes].tolist())))
        if len(bodies) == 1 and outer == number:
            result[tag] = _Face(bodies.pop(), np.vstack([low, -negated_high]), sizes / number)
        elif len(bodies) > 1:
            shared_tags.append(str(tag))
    if shared_tags:
        log(comm, "contacts: tags %s, of several bodies, are left out", ", ".join(shared_tags))
    return result
