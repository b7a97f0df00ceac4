"""The facets of a tagged surface, gathered on every rank, as the displacement sees them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

import basix
import dolfinx

from dolfinx_tresca._base.compat import geometry_dofmap, same_topology
from dolfinx_tresca._base.parallel import errors_on_all_ranks, gather_rows
from dolfinx_tresca.errors import InputError, PairingError

FloatArray = npt.NDArray[np.float64]

#: Area over the square of the longest side, in 2D length over the longest one, that is none.
FLAT = 1e-10

#: Distance of a facet from its straight shape, over its size, that is rounding.
STRAIGHT = 1e-10


@dataclass(frozen=True)
class Facets:
    """All facets with a tag, the same on all ranks: curves in 2D, triangles or quadrilaterals.

    Their shape is the interpolation of the geometry in the space of the displacement, so that N, T
    and the gap treat positions as they treat displacements. In 2D points have a third coordinate 0.

    Attributes:
        cell: "interval", "triangle" or "quadrilateral".
        degree: of the displacement.
        nodes: (n, k) global numbers of the displacement's nodes, corners first.
        points: (n, k, 3) where they are [length].
        free: (n, corners, dim) directions in which the corners' displacement is not prescribed.
        file_numbers: (n, corners) numbers of the corners in the mesh file: no partition
            changes them.
        outward: (n,) 1 or -1: the sign of the normal that follows from the order of the nodes.
        bent: whether edges are curved, which takes degree 2.
        plane: whether each facet lies in a plane.
    """

    cell: str
    degree: int
    nodes: npt.NDArray[np.int64]
    points: FloatArray
    free: npt.NDArray[np.bool_]
    file_numbers: npt.NDArray[np.int64]
    outward: FloatArray
    bent: bool
    plane: bool

    @property
    def dim(self) -> int:
        """1 for curves, 2 for surfaces."""
        return 1 if self.cell == "interval" else 2

    @property
    def corners(self) -> int:
        """The number of corners of a facet."""
        return self.free.shape[1]

    @property
    def affine(self) -> bool:
        """Whether the map from the reference facet is affine."""
        return not self.bent and self.cell != "quadrilateral"

    def hats(self, x: FloatArray) -> FloatArray:
        """Return the hat functions (q, corners) of the corners at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, 1, 0, x)[0])

    def basis(self, x: FloatArray) -> FloatArray:
        """Return the basis functions (q, k) of the displacement at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, self.degree, 0, x)[0])

    def area_vectors(self, x: FloatArray) -> FloatArray:
        """Return outward normals (n, q, 3) at reference points; their length is dA over dx."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dqk,nki->dnqi", gradients, self.points)
        return np.asarray(_normals(along) * self.outward[:, None, None])

    def area_vectors_at(self, facet: npt.NDArray[np.intp], x: FloatArray) -> FloatArray:
        """Return the same (m, 3) at one reference point (m, dim) each of some facets (m,)."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dmk,mki->dmi", gradients, self.points[facet])
        return np.asarray(_normals(along) * self.outward[facet, None])


def _normals(along: FloatArray) -> FloatArray:
    """Return the cross products of tangents (dim, ..., 3); in 2D the second points along z."""
    second = along[1] if len(along) == 2 else np.array([0.0, 0.0, 1.0])
    return np.asarray(np.cross(along[0], second))


@cache
def _element(cell: str, degree: int) -> Any:
    return basix.create_element(
        basix.ElementFamily.P,
        basix.CellType[cell],
        degree,
        basix.LagrangeVariant.gll_warped if degree > 0 else basix.LagrangeVariant.unset,
    )


def tabulate(cell: str, degree: int, derivatives: int, x: FloatArray) -> FloatArray:
    """Return values, then first derivatives, (1 + dim, q, k) of a Lagrange basis."""
    if len(x) == 0:  # basix wants at least one point
        return np.zeros((1 + derivatives * x.shape[1], 0, _element(cell, degree).dim))
    return np.asarray(_element(cell, degree).tabulate(derivatives, x)[..., 0])


def quadrature(cell: str, degree: int) -> tuple[FloatArray, FloatArray]:
    """Return points (q, dim) and weights (q,) on a reference cell."""
    points, weights = basix.make_quadrature(basix.CellType[cell], degree)
    return np.asarray(points), np.asarray(weights)


def gather_facets(
    V: Any, prescribed: npt.NDArray[np.bool_], facet_tags: Any, tag: int, side: str
) -> Facets:
    """Return the facets with a tag. Collective.

    Args:
        V: vector space of degree 1 or 2.
        prescribed: (owned dofs,) those with a Dirichlet condition.
        facet_tags: tags of the facets of its mesh.
        tag: the surface.
        side: "secondary" or "primary", for error messages.

    Raises:
        InputError: the tags belong to another mesh or to other entities, or the tag marks nothing.
        PairingError: facets lie inside a body, or have no area.
    """
    mesh = V.mesh
    comm, dim = mesh.comm, mesh.topology.dim - 1
    with errors_on_all_ranks(comm):
        if not same_topology(facet_tags, mesh):
            raise InputError(
                "facet_tags belong to another mesh than the function space of the forms."
            )
        if facet_tags.dim != dim:
            raise InputError(
                f"facet_tags mark entities of dimension {facet_tags.dim}, facets have {dim}."
            )
    for first, second in ((dim, dim + 1), (dim + 1, dim)):
        mesh.topology.create_connectivity(first, second)
    facets = facet_tags.find(tag)
    facets = facets[facets < mesh.topology.index_map(dim).size_local]
    exterior = np.isin(facets, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    number, outside = comm.allreduce(np.array([len(facets), exterior.sum()]))
    if number == 0:
        known = sorted(set().union(*comm.allgather(set(np.unique(facet_tags.values).tolist()))))
        raise InputError(
            f"no facet has the tag {tag} of the {side} side; the tags in use are {known}."
        )
    if outside < number:
        raise PairingError(
            f"{number - outside} of the {number} facets with tag {tag} ({side} side) lie inside a "
            "body: contact needs two surfaces with nodes of their own. Do not merge the nodes of "
            "the bodies when meshing."
        )

    result = _gathered(V, prescribed, facets)
    _check_areas(result, tag, side)
    return result


def _gathered(V: Any, prescribed: npt.NDArray[np.bool_], facets: npt.NDArray[np.int32]) -> Facets:
    """Return the facets of all ranks from each one's own. Collective."""
    mesh, comm, dofmap = V.mesh, V.mesh.comm, V.dofmap
    dim = mesh.topology.dim - 1
    to_cell = mesh.topology.connectivity(dim, dim + 1)
    cells = to_cell.array[to_cell.offsets[facets]]
    kind = dolfinx.mesh.to_string(mesh.topology.cell_type)
    cell = {"triangle": "interval", "quadrilateral": "interval", "tetrahedron": "triangle",
            "hexahedron": "quadrilateral"}[kind]  # fmt: skip
    sides = dolfinx.cpp.mesh.cell_num_entities(mesh.topology.cell_type, dim)
    of_cell = mesh.topology.connectivity(dim + 1, dim).array.reshape(-1, sides)
    side = (of_cell[cells] == facets[:, None]).argmax(axis=1) if len(facets) else facets
    closures = np.array(
        [dofmap.dof_layout.entity_closure_dofs(dim, i) for i in range(sides)], dtype=np.int64
    )
    closure = closures[side]
    corners = {"interval": 2, "triangle": 3, "quadrilateral": 4}[cell]
    corners_of_cell = dolfinx.cpp.mesh.cell_num_entities(mesh.topology.cell_type, 0)

    x = V.tabulate_dof_coordinates()
    cell_nodes = dofmap.list[cells]
    nodes = np.take_along_axis(cell_nodes, closure, axis=1)
    points = x[nodes]
    middle = x[cell_nodes[:, :corners_of_cell]].mean(axis=1)
    free = _free_with_ghosts(V, prescribed)
    in_file = np.asarray(mesh.geometry.input_global_indices)[
        np.take_along_axis(geometry_dofmap(mesh)[cells], closure[:, :corners], axis=1)
    ]
    numbers = dofmap.index_map.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
    gathered = [
        gather_rows(comm, np.asarray(rows))
        for rows in (numbers, points, middle, free[nodes[:, :corners]], in_file)
    ]
    degree = V.element.basix_element.degree
    return _oriented(cell, degree, gathered)


def _free_with_ghosts(V: Any, prescribed: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return what is not prescribed, (nodes with ghosts, dim of space). Collective."""
    dim = V.dofmap.index_map_bs
    vector = dolfinx.la.vector(V.dofmap.index_map, dim, np.float64)
    vector.array[: len(prescribed)] = ~prescribed
    vector.scatter_forward()
    return np.asarray(vector.array.reshape(-1, dim) > 0.5)


def _oriented(cell: str, degree: int, gathered: list[npt.NDArray[Any]]) -> Facets:
    """Return the facets with the sign of their outward normals: away from their cells."""
    numbers, points, middle, free, in_file = gathered
    corners = points[:, : free.shape[1]]
    straight = np.einsum(
        "kc,nci->nki", tabulate(cell, 1, 0, _element(cell, degree).points)[0], corners
    )
    size = np.ptp(corners, axis=1).max(axis=1)
    bent = bool((np.abs(points - straight).max(axis=(1, 2)) > STRAIGHT * size).any())
    result = Facets(
        cell,
        degree,
        numbers.astype(np.int64),
        points,
        free.astype(np.bool_),
        in_file.astype(np.int64),
        np.ones(len(points)),
        bent,
        not bent and _flat(cell, corners, size),
    )
    centre, _ = quadrature(cell, 1)
    away = np.einsum("ni,ni->n", result.area_vectors(centre)[:, 0], corners.mean(axis=1) - middle)
    result.outward[away < 0.0] = -1.0
    return result


def _flat(cell: str, corners: FloatArray, size: FloatArray) -> bool:
    """Whether the corners of each facet lie in a plane."""
    if cell != "quadrilateral":
        return True
    sides = corners[:, 1:] - corners[:, :1]
    volume = np.einsum("ni,ni->n", np.cross(sides[:, 0], sides[:, 1]), sides[:, 2])
    return bool((np.abs(volume) <= STRAIGHT * size**3).all())


def _check_areas(facets: Facets, tag: int, side: str) -> None:
    """Check that no facet is degenerate. The same on all ranks.

    Raises:
        PairingError: one has no area.
    """
    points, weights = quadrature(facets.cell, 2 * facets.degree)
    area = np.linalg.norm(facets.area_vectors(points), axis=2) @ weights
    size = np.linalg.norm(np.ptp(facets.points, axis=1), axis=1)
    # a curve has no other size to compare with than that of all of it
    flat = area <= FLAT * (size**2 if facets.dim == 2 else size.max())
    if flat.any():
        where = facets.points[flat][0].mean(axis=0)
        raise PairingError(
            f"{flat.sum()} of the {len(area)} facets with tag {tag} ({side} side) have no area; "
            f"one is at {tuple(float(f'{c:.6g}') for c in where)}. Repair the mesh there."
        )
