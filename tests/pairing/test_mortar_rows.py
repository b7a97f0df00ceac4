"""Mortar rows on surfaces without bodies, the same on all ranks."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from sheets import CELLS, nodes_of, sheet

from dolfinx_tresca.pairing.coupling import mortar_rows
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.search.facets import Facets
from dolfinx_tresca.pairing.search.visibility import overlaps
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


def pair_of(secondary: Facets, primary: Facets) -> SimpleNamespace:
    columns = int(max(secondary.nodes.max(), primary.nodes.max())) + 1
    nodes, other_nodes = nodes_of(secondary), nodes_of(primary)
    integrals = MortarIntegrals(nodes, other_nodes, np.arange(len(secondary.points)), np.inf)
    carries = np.ones(nodes.facet_nodes.shape, dtype=bool)
    rows = mortar_rows(nodes, primary, integrals, columns, carries)
    return SimpleNamespace(**dict(zip(("weights", "jump", "primary", "means"), rows, strict=True)))


def values_at(function, *sides: Facets, size: int | None = None) -> np.ndarray:
    """Return the values (size,) of a function at the nodes of sides, by node number, else 0."""
    result = np.zeros(int(max(side.nodes.max() for side in sides)) + 1 if size is None else size)
    for side in sides:
        result[side.nodes] = function(side.points)
    return result


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


def test_triangles_that_coincide_up_to_rounding():
    """With corners that coincide up to rounding a polygon may cross a line more than twice."""
    first = np.array([
        [-111.11111111091031, 166.66666666657434],
        [222.22222222227202, 166.66666666657434],
        [-111.11111111136182, -333.33333333314835],
    ])  # fmt: skip
    second = np.array([
        [-111.11111111136182, -333.33333333314846],
        [222.22222222227202, 166.66666666657434],
        [-111.11111111091037, 166.66666666657457],
    ])  # fmt: skip
    area = 0.5 * 333.333333333 * 500.0
    assert overlaps(first[None], second[None])[1].sum() == pytest.approx(area, rel=1e-9)
    rng = np.random.default_rng(1)
    many = rng.standard_normal((2000, 3, 2))
    shaken = many[:, [2, 0, 1]] * (1.0 + 4 * EPS * rng.standard_normal((2000, 3, 2)))
    areas = 0.5 * np.abs(np.linalg.det(many[:, 1:] - many[:, :1]))
    _, size, pair = overlaps(many, shaken)
    rounding = 1e3 * EPS * np.abs(many).max() ** 2
    assert np.abs(np.bincount(pair, size, 2000) - areas).max() <= rounding
