"""Visibility: facets between two facets that face each other."""

from __future__ import annotations

import numpy as np
import pytest
from rotations import rotation
from sheets import CELLS, joined, sheet

from dolfinx_tresca.pairing.search.balls import Pieces
from dolfinx_tresca.pairing.search.facets import CREDIBLE_PART, Facets
from dolfinx_tresca.pairing.search.visibility import Visibility

UP, DOWN = True, False


def turn_of(cell: str) -> np.ndarray:
    if cell != "interval":
        return rotation(9)
    return np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


def layer(cell: str, height: float, up: bool, n: int = 2) -> Facets:
    """Return a sheet at a height along a rotated axis."""
    turn = turn_of(cell)
    axis = np.array([0.0, 1.0, 0.0] if cell == "interval" else [0.0, 0.0, 1.0])
    normal = turn @ (axis if up else -axis)
    return sheet(cell, n, height=height, up=up, first=int(1000 * height) + 5000 + 100 * n,
                 move=lambda x: x @ turn.T, away=lambda x: normal + 0.0 * x)  # fmt: skip


def hidden(cell: str, own, other, target: float) -> np.ndarray:
    """Return whether a primary sheet at height `target` is hidden from a secondary sheet at 0.

    The normal of the secondary sheet points down. `own` and `other` are further layers of the
    secondary and primary sides: their heights, and whether their normals point up.
    """
    first = layer(cell, 0.0, DOWN)
    mine = joined(first, *(layer(cell, *one) for one in own))
    theirs = joined(layer(cell, target, UP, 3), *(layer(cell, *one, 3) for one in other))
    pieces = Pieces.from_facets(mine)
    piece = np.flatnonzero(pieces.facet < len(first.points))
    places = np.zeros((len(piece), first.dim))
    start = np.zeros(len(piece))
    return Visibility(pieces, Pieces.from_facets(theirs)).hidden(
        piece, places, start, start - target
    )


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize(
    ("own", "other", "target", "expected"),
    [
        ([], [], -0.5, False),
        ([], [], 0.0, False),
        ([], [], 0.1, False),  # penetration
        # another part of the secondary body is in the gap
        ([(-0.2, UP), (-0.3, DOWN)], [], -0.5, True),
        ([(0.0, UP), (-0.3, DOWN)], [], -0.5, True),
        ([(0.0, UP), (-0.5, DOWN)], [], -0.5, True),
        ([(-0.2, UP), (-0.5, DOWN)], [], -0.5, True),
        # layers behind the target, or behind the secondary sheet
        ([(-0.6, UP), (-0.7, DOWN)], [(-0.7, DOWN)], -0.5, False),
        ([(0.1, UP)], [(0.2, DOWN)], -0.5, False),
        # another part of the primary body is in the gap
        ([], [(-0.2, DOWN)], -0.5, True),
        ([], [(-0.5, DOWN)], -0.5, True),
        # penetration through the far side of the secondary body
        ([(0.3, UP)], [], 0.5, True),
        ([(0.5, UP)], [], 0.5, True),
        ([(0.6, UP)], [(-0.1, DOWN)], 0.5, False),
        # penetration through another part of the primary body
        ([], [(0.2, DOWN)], 0.5, True),
        ([], [(0.0, DOWN)], 0.5, True),
        ([(1.0, UP)], [(-1.0, DOWN)], 0.05, False),  # two blocks that overlap a little
    ],
)
def test_hidden(cell, own, other, target, expected):
    """A negative height of the target is a gap, a positive height is penetration."""
    assert (hidden(cell, own, other, target) == expected).all()


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("shallow", [False, True])
def test_deep_penetration_beside_a_near_surface_is_hidden(cell, shallow):
    """The primary surface passes the points at a distance of a part of their penetration."""
    depth = 0.4
    side = (1.0 if shallow else 0.1) * CREDIBLE_PART * 1.01 * depth
    own, target = layer(cell, 0.0, DOWN), layer(cell, depth, UP, 3)
    pieces = Pieces.from_facets(own)
    # a sheet that ends at the distance `side` from the line
    axes = np.zeros((3, 3))
    axes[: own.dim] = pieces.frames[0, :-1]
    near = pieces.centres[0] + side * axes[0]
    beside = sheet(cell, 1, first=9000, move=lambda x: near + x @ axes)
    others = Pieces.from_facets(joined(target, beside))
    zero = np.zeros((1, own.dim)), np.zeros(1)
    found = Visibility(pieces, others).hidden(np.array([0]), *zero, np.array([-depth]))
    assert found[0] == (not shallow)
