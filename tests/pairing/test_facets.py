"""Facets of a mesh: areas, outward normals, prescribed components, shapes."""

from __future__ import annotations

import numpy as np
import pytest
from rotations import rotation
from sheets import CELLS, joined, nodes_of, sheet

from dolfinx_tresca import InputError, PairingError
from dolfinx_tresca.pairing.search.facets import Facets, quadrature
from dolfinx_tresca.pairing.search.tagged import tagged_facets
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.patches import KINDS, LOWER, SIDES, UPPER, dim_of, patch
from scenes.scene import EPS

FACET_CELLS = {"triangle": "interval", "quadrilateral": "interval",
                       "tetrahedron": "triangle", "hexahedron": "quadrilateral"}  # fmt: skip


def owned(scene, tag: int) -> Facets:
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        return tagged_facets(scene.V, system.prescribed, scene.facet_tags, tag, "secondary")


def area(facets: Facets) -> float:
    x, w = quadrature(facets.cell, 6)
    return float((np.linalg.norm(facets.area_vectors(x), axis=2) @ w).sum())


def mirror_turn(dim: int) -> np.ndarray:
    return rotation(5, dim) @ np.diag([-1.0] + [1.0] * (dim - 1))


@pytest.mark.parallel(kind=["triangle", "hexahedron"], moved=[True])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("degree", "geometry"), [(1, 1), (2, 1), (2, 2)])
@pytest.mark.parametrize("moved", [False, True])
def test_areas_and_outward_normals(comm, kind, degree, geometry, moved):
    """They are right for either order of the nodes of cells, and after a motion and reflection."""
    dim = dim_of(kind)
    options = {"turn": mirror_turn(dim), "scale": 0.01} if moved else {}
    scene = patch(
        comm, kind, degree, geometry=geometry, reverse=geometry == 1, split=True, **options
    )
    scale = options.get("scale", 1.0) ** (dim - 1)
    for tag, sign in ((UPPER, -1.0), (LOWER, 1.0)):
        facets = owned(scene, tag)
        assert facets.cell == FACET_CELLS[kind]
        assert (facets.dim, facets.degree) == (dim - 1, degree)
        assert facets.plane and not facets.bent
        assert comm.allreduce(area(facets)) == pytest.approx(scale, rel=1e4 * EPS)
        nodes = nodes_of(facets)
        assert comm.allreduce(nodes.weights.sum()) == pytest.approx(scale, rel=1e4 * EPS)
        assert np.allclose(nodes.normals, sign * scene.data.axis, atol=1e5 * EPS)
        assert (nodes.weights > 0.0).all()
    side = nodes_of(owned(scene, SIDES[0]))
    assert comm.allreduce(side.weights.sum()) == pytest.approx(2.0 * scale, rel=1e4 * EPS)


@pytest.mark.parallel
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_every_facet_is_owned_by_one_rank(comm, kind, degree):
    facets = owned(patch(comm, kind, degree), UPPER)
    count = {"triangle": 3, "quadrilateral": 3, "tetrahedron": 18, "hexahedron": 9}[kind]
    corners = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 4}[kind]
    assert facets.free.shape[:2] == (len(facets.nodes), corners)
    assert facets.corners == corners
    every = np.concatenate(comm.allgather(np.sort(facets.nodes[:, :corners], axis=1)))
    assert len(every) == len(np.unique(every, axis=0)) == count
    # the number of a node determines its position
    _, first, position = np.unique(facets.nodes, return_index=True, return_inverse=True)
    again = facets.points.reshape(-1, 3)[first][position.ravel()]
    assert np.array_equal(again.reshape(facets.points.shape), facets.points)


@pytest.mark.parallel
@pytest.mark.parametrize("kind", KINDS)
def test_prescribed_components_are_not_free(comm, kind):
    scene = patch(comm, kind, symmetry=True)
    facets = owned(scene, UPPER)
    dim = dim_of(kind)
    corners = facets.points[:, : facets.corners]
    for component in range(dim):
        fixed = corners[..., component] < 1e-9 if component < dim - 1 else False
        assert np.array_equal(
            facets.free[..., component], ~(fixed | np.zeros_like(corners[..., 0], bool))
        )


@pytest.mark.parallel
@pytest.mark.parametrize("kind", KINDS)
def test_file_numbers_do_not_depend_on_the_partition(comm, kind):
    """They are the same if one rank or all ranks bring the cells; tangents depend on them."""
    tables = []
    for split in (False, True):
        facets = owned(patch(comm, kind, split=split), UPPER)
        places = facets.points[:, : facets.corners].reshape(-1, 3)
        table = np.column_stack([facets.file_numbers.ravel(), places])
        table = np.concatenate(comm.allgather(table))
        tables.append(np.unique(np.round(table, 9), axis=0))
    assert np.array_equal(*tables)


def sphere(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=1)[:, None]


@pytest.mark.parametrize("cell", CELLS)
def test_area_of_a_sphere(cell):
    """The error of a sixth of a sphere, or a quarter of a circle, is O(h^2); degree 2: O(h^4)."""
    exact = np.pi / 2 if cell == "interval" else 4 * np.pi / 6
    for degree, order in ((1, 2.0), (2, 4.0)):
        errors = []
        for n in (3, 6):
            facets = sheet(cell, n, (-1.0, 1.0), degree=degree, height=1.0, move=sphere)
            assert facets.bent == (degree == 2)
            assert facets.plane == (degree == 1 and cell != "quadrilateral")
            errors.append(abs(area(facets) - exact))
            assert abs(nodes_of(facets).weights.sum() - exact) == pytest.approx(errors[-1], rel=0.2)
        assert np.log2(errors[0] / errors[1]) > order - 0.3


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
def test_area_vectors_at_single_points(cell, degree):
    facets = sheet(cell, 2, (-1.0, 1.0), degree=degree, height=1.0, move=sphere)
    x, _ = quadrature(cell, 4)
    everywhere = facets.area_vectors(x)
    facet = np.arange(len(x)) % len(facets.points)
    assert np.allclose(
        facets.area_vectors_at(facet, x), everywhere[facet, np.arange(len(x))], atol=10 * EPS
    )
    assert (
        np.einsum("ni,ni->n", facets.area_vectors_at(facet, x), facets.points[facet, 0]) > 0
    ).all()


@pytest.mark.parallel(kind=["tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_facet_without_area_is_an_error(comm, kind):
    """A node of the upper face is moved onto another node."""
    scene = patch(comm, kind, distort=0.0)
    x = scene.mesh.geometry.x
    line = np.isclose(x[:, dim_of(kind) - 1], 1.0) & np.isclose(x[:, 0], 1 / 3)
    x[line, 0] = 0.0
    with pytest.raises(PairingError, match=r"facets of tag 1 \(secondary side\) have no area"):
        owned(scene, UPPER)
    with pytest.raises(PairingError, match=r"have no area.*Repair the mesh"):
        scene.problem()


def test_sheet_with_both_faces_in_one_tag_has_two_normals_at_each_node():
    one, other = (sheet("triangle", 2, up=up) for up in (True, False))
    both = joined(one, other)
    nodes, single = nodes_of(both), nodes_of(one)
    assert len(nodes.numbers) == 2 * len(single.numbers)
    assert np.allclose(np.abs(nodes.normals), [0.0, 0.0, 1.0])
    assert np.allclose(np.bincount(nodes.numbers, nodes.normals[:, 2]), 0.0)
    assert np.allclose(np.bincount(nodes.numbers, nodes.weights), 2.0 * single.weights)


@pytest.mark.parallel
def test_error_for_an_unused_tag_lists_the_tags_in_use(comm):
    with pytest.raises(InputError, match=r"tag 99 .*secondary.*\[1, 2, 3, 4, 5, 6\]"):
        owned(patch(comm, "hexahedron"), 99)
