"""Mortar rows on surfaces without bodies, the same on all ranks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rotations import rotation
from sheets import CELLS, joined, nodes_of, part_of, sheet

from dolfinx_tresca.pairing.coupling import MortarRows, mortar_rows
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.search.facets import Facets
from scenes.scene import EPS

#: Rounding of sums of some hundred products of numbers of size 1.
ROUNDING = 1e4 * EPS

#: Cells of the secondary and the primary side: in 3D also tetrahedra on hexahedra.
PAIRS = [(cell, cell) for cell in CELLS] + [
    ("triangle", "quadrilateral"),
    ("quadrilateral", "triangle"),
]
SIDES = pytest.mark.parametrize(("cell", "other"), PAIRS)
DEGREES = pytest.mark.parametrize("degree", [1, 2])


def pair_of(secondary: Facets, primary: Facets, limit: float = np.inf, selected=None) -> MortarRows:
    columns = int(max(secondary.nodes.max(), primary.nodes.max())) + 1
    if selected is None:
        selected = np.arange(len(secondary.points))
    nodes, other_nodes = nodes_of(secondary), nodes_of(primary)
    integrals = MortarIntegrals(nodes, other_nodes, selected, limit)
    carries = np.ones(nodes.facet_nodes.shape, dtype=bool)
    return mortar_rows(nodes, primary, integrals, columns, carries)


def values_at(function, *sides: Facets, size: int | None = None) -> np.ndarray:
    """Return the values (size,) of a function at the nodes of sides, by node number, else 0."""
    result = np.zeros(int(max(side.nodes.max() for side in sides)) + 1 if size is None else size)
    for side in sides:
        result[side.nodes] = function(side.points)
    return result


def square(dim: int, box: tuple[float, float]) -> float:
    return (box[1] - box[0]) ** dim


@SIDES
@DEGREES
@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_jump_of_linear_displacements_is_exact_on_flat_sides(cell, other, degree, gap):
    """Each side has its own linear displacement."""
    secondary = sheet(cell, 3, degree=degree, height=gap, up=False, distort=0.5)
    primary = sheet(other, 4, degree=degree, distort=0.5, first=1000)
    rows = pair_of(secondary, primary)
    nodes = nodes_of(secondary)
    assert np.allclose(rows.weights, nodes.weights, atol=ROUNDING)
    assert np.abs(rows.jump.sum(axis=1)).max() <= ROUNDING
    assert not rows.means[:, 2].any()
    size = rows.jump.shape[1]
    u = values_at(lambda x: 1.0 + 2.0 * x[..., 0] - 3.0 * x[..., 1], secondary, size=size)
    u += values_at(lambda x: -2.0 + x[..., 0] + 0.5 * x[..., 1], primary, size=size)
    x = nodes.points
    other_y = np.zeros(len(x)) if cell == "interval" else x[:, 1]  # the gap is along y there
    jump = (1.0 + 2.0 * x[:, 0] - 3.0 * x[:, 1]) - (-2.0 + x[:, 0] + 0.5 * other_y)
    assert np.allclose((rows.jump @ u) / rows.weights, jump, atol=ROUNDING * 10)


@SIDES
@DEGREES
@pytest.mark.parametrize("shift", [0.3, 0.5, 0.973, 1.0 - 1e-5])
def test_partial_overlap(cell, other, degree, shift):
    """The integral over the overlap is exact for constant and linear displacements."""
    box = (shift, 1.0 + shift)
    secondary = sheet(cell, 3, box, degree=degree, height=0.1, up=False)
    primary = sheet(other, 4, degree=degree, first=1000)
    rows = pair_of(secondary, primary)
    dim = secondary.dim
    area = square(dim, (shift, 1.0))
    assert rows.weights.sum() == pytest.approx(area, rel=1e-8)
    assert np.abs(rows.jump.sum(axis=1)).max() <= ROUNDING * area
    assert (rows.weights >= 0.0).all()
    linear = rows.jump @ values_at(lambda x: x[..., 0], secondary, primary)
    assert np.abs(linear).max() <= ROUNDING * area
    alone = values_at(lambda x: x[..., 0], secondary, size=rows.jump.shape[1])
    total = (rows.jump @ alone).sum()
    assert total == pytest.approx(0.5 * (1.0 + shift) * area, rel=1e-8)


@SIDES
def test_sides_that_do_not_overlap_have_no_rows(cell, other):
    """They are close, so that the search finds candidates, or far apart."""
    for shift in (1.001, 50.0):
        secondary = sheet(cell, 3, (shift, 1.0 + shift), up=False)
        rows = pair_of(secondary, sheet(other, 4, first=1000))
        assert not rows.weights.any() and rows.jump.nnz == 0
    same_way = pair_of(sheet(cell, 3, height=0.1), sheet(other, 4, first=1000))
    assert not same_way.weights.any()


@SIDES
def test_no_facets_selected(cell, other):
    """A rank that owns no node selects no facets."""
    secondary, primary = sheet(cell, 3, up=False), sheet(other, 4, first=1000)
    rows = pair_of(secondary, primary, selected=np.zeros(0, dtype=np.intp))
    assert not rows.weights.any() and rows.jump.nnz == 0


@SIDES
@DEGREES
def test_rows_from_selected_facets_equal_rows_from_all_facets(cell, other, degree):
    """A rank selects the facets at its nodes."""
    secondary = sheet(cell, 3, degree=degree, up=False, distort=0.5)
    primary = sheet(other, 4, degree=degree, first=1000)
    whole = pair_of(secondary, primary)
    nodes = nodes_of(secondary)
    for node in (0, len(nodes.numbers) // 2):
        around = np.flatnonzero((nodes.facet_nodes == node).any(axis=1))
        part = pair_of(secondary, primary, selected=around)
        assert part.weights[node] == pytest.approx(whole.weights[node], rel=ROUNDING)
        difference = (part.jump[[node]] - whole.jump[[node]]).toarray()
        assert np.abs(difference).max() <= ROUNDING


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("gap", [0.0, 0.3])
def test_matching_meshes_give_the_rows_of_node_to_node(cell, gap):
    """With the dual basis the jump has the entries 1 and -1 at the two nodes."""
    secondary = sheet(cell, 4, height=gap, up=False, distort=0.5)
    primary = sheet(cell, 4, distort=0.5, first=1000)
    rows = pair_of(secondary, primary)
    number = len(nodes_of(secondary).numbers)
    expected = np.zeros((number, 1000 + number))
    expected[np.arange(number), np.arange(number)] = 1.0
    expected[np.arange(number), 1000 + np.arange(number)] = -1.0
    scaled = rows.jump.toarray() / rows.weights[:, None]
    assert np.allclose(scaled, expected, atol=ROUNDING)
    if cell != "quadrilateral":  # there rounding is left of bilinear maps
        assert rows.jump.nnz == 2 * number


@SIDES
@pytest.mark.parametrize(("n", "m"), [(1, 50), (50, 1)])
def test_meshes_of_very_different_fineness(cell, other, n, m):
    secondary = sheet(cell, n, up=False)
    primary = sheet(other, m, first=10_000)
    rows = pair_of(secondary, primary)
    assert np.allclose(rows.weights, nodes_of(secondary).weights, rtol=1e-9)
    assert (
        np.abs(rows.jump @ values_at(lambda x: 1.0 + x[..., 0], secondary, primary)).max()
        <= ROUNDING
    )


@SIDES
@DEGREES
def test_rows_are_invariant_under_motion_and_scaling(cell, other, degree):
    """Both sides are rotated, mirrored, moved far away and scaled; only the area changes."""
    size = 1e-3
    turn = rotation(3) @ np.diag([1.0, -1.0, 1.0])
    if cell == "interval":
        turn = np.array([[0.6, 0.8, 0.0], [0.8, -0.6, 0.0], [0.0, 0.0, 1.0]])

    def move(x: np.ndarray) -> np.ndarray:
        return size * (x @ turn.T + [5.0, -3.0, 0.0])

    results = []
    for image in (None, move):
        down = np.array([0.0, -1.0, 0.0] if cell == "interval" else [0.0, 0.0, -1.0])
        options = {"degree": degree, "distort": 0.4}
        secondary = sheet(cell, 3, height=0.1, up=False, **options, move=image,
                          away=(lambda x, d=down: turn @ d * size) if image else None)  # fmt: skip
        primary = sheet(other, 4, first=1000, **options, move=image,
                        away=(lambda x, d=down: -turn @ d * size) if image else None)  # fmt: skip
        results.append(pair_of(secondary, primary))
    plain, moved = results
    assert np.allclose(moved.weights, size**secondary.dim * plain.weights, rtol=1e-9)
    difference = moved.jump / size**secondary.dim - plain.jump
    # the integrands on quadrilaterals are not polynomials, and the overlaps are cut differently
    rounding = 1e-8 if cell == other == "quadrilateral" else 100 * ROUNDING
    assert np.abs(difference).max() <= rounding


@pytest.mark.parametrize("cell", CELLS)
def test_search_distance_bounds_gap_and_penetration(cell):
    primary = sheet(cell, 4, first=1000)
    for height in (0.3, -0.3):
        secondary = sheet(cell, 3, height=height, up=False)
        assert pair_of(secondary, primary, limit=0.31).weights.sum() == pytest.approx(1.0)
        assert not pair_of(secondary, primary, limit=0.29).weights.any()


@pytest.mark.parametrize("cell", CELLS)
@DEGREES
def test_concentric_spheres_are_as_far_apart_as_their_radii(cell, degree):
    """With the sagitta the error of the gap relative to the sagitta is O(h^2)."""
    errors = []
    for n in (5, 10):

        def onto(radius: float):
            return lambda x: radius * x / np.linalg.norm(x, axis=1)[:, None]

        options = {"box": (-0.5, 0.5), "degree": degree, "height": 1.0}
        secondary = sheet(cell, n, **options, move=onto(1.0))
        primary = sheet(cell, n + 1, **options, move=onto(1.1), up=False, first=5000)
        rows = pair_of(secondary, primary)
        nodes = nodes_of(secondary)
        inner = (
            np.abs(nodes.points[:, :1] if cell == "interval" else nodes.points[:, :2]).max(axis=1)
            < 0.3
        )
        offset = (
            np.stack(
                [
                    -(rows.jump @ values_at(lambda x, i=i: x[..., i], secondary, primary))
                    for i in range(3)
                ],
                axis=1,
            )
            / rows.weights[:, None]
        )
        gap = np.einsum("ni,ni->n", offset, nodes.normals) - rows.means[:, 2] / rows.weights
        errors.append(np.abs(gap - 0.1)[inner].max())
    assert errors[0] < 1e-3
    assert np.log2(errors[0] / errors[1]) > 1.8


@pytest.mark.parametrize("cell", ["interval", "triangle"])
def test_gaps_of_curved_sides_do_not_depend_on_the_triangulation_of_overlaps(cell):
    """The triangulation depends on the order of a facet's nodes, and so on the partition."""

    def bowl(x: np.ndarray) -> np.ndarray:
        x = x.copy()
        x[:, secondary_axis] += 0.2 * (x[:, :secondary_axis] ** 2).sum(axis=1)
        return x

    secondary_axis = 1 if cell == "interval" else 2
    primary = sheet(cell, 4, move=bowl, first=1000)
    secondary = sheet(cell, 3, up=False, move=bowl)
    plain = pair_of(secondary, primary)
    assert np.abs(plain.means[:, 2]).max() > 0.0
    order = [1, 0] if cell == "interval" else [1, 2, 0]
    names = ("nodes", "points", "free", "file_numbers")
    turned = {name: getattr(secondary, name)[:, order] for name in names}
    sign = -1.0 if cell == "interval" else 1.0
    other = dataclasses.replace(secondary, **turned, outward=sign * secondary.outward)
    difference = pair_of(other, primary).means[:, 2] - plain.means[:, 2]
    # heights are differences of coordinates of size 1, and much smaller than these
    assert np.abs(difference).max() <= ROUNDING * plain.weights.max()


def test_blocks_of_pairs_do_not_change_the_result(monkeypatch):
    """Blocks bound the memory."""
    secondary, primary = sheet("triangle", 6, up=False), sheet("triangle", 7, first=1000)
    whole = pair_of(secondary, primary)
    monkeypatch.setattr("dolfinx_tresca.pairing.mortar_integrals.PAIRS_AT_ONCE", 10)
    parts = pair_of(secondary, primary)
    assert np.allclose(parts.weights, whole.weights, rtol=ROUNDING)
    assert np.abs(parts.jump - whole.jump).max() <= ROUNDING


def test_primary_side_in_two_parts():
    secondary = sheet("triangle", 3, up=False)
    left = sheet("triangle", 4, first=1000)
    x = left.points.mean(axis=1)[:, 0] < 0.5
    parts = []
    for mask, offset in ((x, 0), (~x, 1000)):
        part = part_of(left, mask)
        parts.append(dataclasses.replace(part, nodes=part.nodes + offset))
    rows = pair_of(secondary, joined(*parts))
    assert rows.weights.sum() == pytest.approx(1.0, rel=ROUNDING)
    assert np.abs(rows.jump.sum(axis=1)).max() <= ROUNDING
