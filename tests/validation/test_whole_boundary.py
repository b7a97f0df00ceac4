"""Tags that go round edges, or mark whole boundaries, pair what the clean tag pairs."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from rotations import rotation

from dolfinx_tresca import (
    ContactPair,
    Frictionless,
    PairingError,
    RigidCylinder,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    Tresca,
)
from scenes.boxes import Body, boxes, near, same
from scenes.patches import KINDS, dim_of
from scenes.scene import EPS

#: Of sums over some products of numbers of size 1.
ROUNDING = 1e5 * EPS

SECONDARY, PRIMARY = 1, 2


def sides(dim: int, low: float, high: float):
    return lambda x: (
        (np.abs(x[:, : dim - 1] - low) < 1e-9).any(axis=1)
        | (np.abs(x[:, : dim - 1] - high) < 1e-9).any(axis=1)
    )


def box(dim: int, low: float, high: float, *across: float):
    start, end = across or (0.0, 1.0)
    return [(start, end)] * (dim - 1) + [(low, high)]


def obstacles(dim: int, turn: np.ndarray):
    """A plane, a ball, a hole and a cylinder that all touch the turned unit block from below."""
    axis = turn[:, -1]
    middle = turn @ np.array([0.5] * (dim - 1) + [0.0])
    along = turn[:, 0] if dim == 3 else np.array([0.0, 0.0, 1.0])
    ball = middle - 0.8 * axis
    yield RigidPlane(middle - 0.01 * axis, axis)
    yield RigidSphere(ball, 0.8)
    yield RigidSphere(middle + 2.0 * axis, 2.2, hollow=True)
    yield RigidCylinder(ball, along, 0.7)

    def distance(x):
        return axis @ (x[:dim] - middle[:, None]), np.pad(axis, (0, 3 - dim))[:, None] + 0 * x

    yield RigidObstacle(distance)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_before_an_obstacle_only_the_facets_that_face_it_count(comm, kind, degree):
    """Tags of the bottom alone, of its sides and of all facets give the same pairing."""
    dim = dim_of(kind)
    turn = rotation(4, dim)
    block = boxes(comm, kind, [Body((2, 2), box(dim, 0.0, 1.0))], degree, turn=turn)
    bottom = near(dim - 1, 0.0)
    round_ = sides(dim, 0.0, 1.0)
    for obstacle in obstacles(dim, turn):
        results = [
            block.operators(ContactPair(tags, SECONDARY, obstacle, Tresca(1.0)))
            for tags in (
                block.tags((SECONDARY, [0], bottom)),
                block.tags((SECONDARY, [0], lambda x: bottom(x) | round_(x))),
                block.tags((SECONDARY, [0], None)),
            )
        ]
        for other in results[1:]:
            if "hollow" not in str(obstacle):
                same(comm, results[0], other, ROUNDING)
            else:  # from within the sides face the hole too
                assert comm.allreduce(other.weights.sum()) > 1.0 + ROUNDING


#: Gap, extent of the upper block, and cells along a side of the lower and of the upper block.
STACKS = {
    "apart": (0.05, (0.0, 1.0), (2, 3)),
    "touching": (0.0, (0.0, 1.0), (4, 4)),
    "overlapping": (-0.03, (0.0, 1.0), (2, 3)),
    "shifted": (0.0, (0.25, 1.25), (4, 4)),
    "shifted into each other": (-0.03, (0.3, 1.3), (2, 3)),
    "smaller": (0.0, (0.25, 0.75), (4, 4)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", STACKS)
def test_stacked_blocks(comm, kind, name):
    """Tags of faces, of faces and sides, and of whole boundaries give the same pairing."""
    dim = dim_of(kind)
    gap, across, divisions = STACKS[name]
    if dim == 3 and divisions == (4, 4):
        divisions = (2, 2)
    lower = Body((divisions[0], 1), box(dim, 0.0, 1.0))
    upper = Body((divisions[1], 1), box(dim, 1.0 + gap, 2.0 + gap, *across))
    stack = boxes(comm, kind, [lower, upper], turn=rotation(4, dim))
    faces = (near(dim - 1, 1.0), near(dim - 1, 1.0 + gap))
    rims = (sides(dim, 0.0, 1.0), sides(dim, *across))
    for one, other in ((0, 1), (1, 0)):
        results = []
        for what in ("faces", "sides", "whole"):
            marks = []
            for tag, body in ((SECONDARY, one), (PRIMARY, other)):
                face, rim = faces[body], rims[body]
                where = {
                    "faces": face,
                    "sides": lambda x, face=face, rim=rim: face(x) | rim(x),
                    "whole": None,
                }[what]
                marks.append((tag, [body], where))
            pair = ContactPair(stack.tags(*marks), SECONDARY, PRIMARY, Tresca(1.0))
            results.append(stack.operators(pair))
        for found in results[1:]:
            same(comm, results[0], found, ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("divisions", [(2, 2), (2, 3)])
def test_nothing_pairs_through_a_plate_that_touches_both(comm, kind, divisions):
    """Of two plates in one tag only the lower one touches the block below."""
    dim = dim_of(kind)
    h = 0.05
    bodies = [Body((divisions[0], 1), box(dim, -1.0, 0.0))]
    bodies += [Body((divisions[1], 1), box(dim, i * h, (i + 1) * h)) for i in range(2)]
    stack = boxes(comm, kind, bodies, turn=rotation(4, dim))
    touching = near(dim - 1, 0.0)
    clean = stack.tags((SECONDARY, [1], touching), (PRIMARY, [0], touching))
    whole = stack.tags((SECONDARY, [1, 2], None), (PRIMARY, [0], None))
    for one, other in ((SECONDARY, PRIMARY), (PRIMARY, SECONDARY)):
        pairs = [ContactPair(tags, one, other, Frictionless()) for tags in (clean, whole)]
        same(comm, *(stack.operators(pair) for pair in pairs), ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sunk", [False, True])
def test_of_two_layers_the_nearer_one_is_paired(comm, kind, sunk):
    """Two plates with one tag lie apart below a block, which may be sunk into the upper one.

    Then the lower plate is nearer, but behind the lower face of the upper plate, and both plates
    have the tag on all sides; else on their upper faces only.
    """
    upper, lower, gap = (
        ((0.98, 1.04), (0.3, 0.97), -0.04) if sunk else ((0.85, 0.9), (0.3, 0.5), 0.1)
    )
    dim = dim_of(kind)
    layers = [((1.0, 2.0), (0.0, 1.0)), (upper, (-0.13, 1.08)), (lower, (-0.07, 1.19))]
    bodies = [
        Body((3 + k, 1), box(dim, *heights, *across)) for k, (heights, across) in enumerate(layers)
    ]
    stack = boxes(comm, kind, bodies, turn=rotation(4, dim))
    plates = [
        (PRIMARY, [k], None if sunk else near(dim - 1, heights[1]))
        for k, heights in ((1, upper), (2, lower))
    ]
    tags = stack.tags((SECONDARY, [0], near(dim - 1, 1.0)), *plates)
    operators = stack.operators(ContactPair(tags, SECONDARY, PRIMARY, Frictionless()))
    assert comm.allreduce(operators.weights.sum()) == pytest.approx(1.0, rel=ROUNDING)
    assert np.abs(operators.gap - gap).max(initial=0.0) <= ROUNDING


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("secondary", "primary"),
    [  # each body is a layer: its heights, and the heights of its faces that have the tag
        ([((0.0, 0.3), [0.0, 0.3])], [((0.35, 0.5), [0.5])]),
        ([((0.0, 1.0), [0.0])], [((0.2, 0.5), [0.2, 0.5])]),
        ([((0.0, 1.0), [0.0])], [((-0.2, -0.1), [-0.2]), ((-1.0, -0.5), [-0.5])]),
        ([((0.0, 1.0), [0.0]), ((-0.2, -0.1), [-0.1])], [((-1.0, -0.5), [-0.5])]),
    ],
)
def test_what_lies_behind_a_body_is_not_paired(comm, kind, secondary, primary):
    """Faces are opposed, but between them is a body, or they overlap by more than a whole body."""
    dim = dim_of(kind)
    layers = [*secondary, *primary]
    bodies = [Body((2 + k, 1), box(dim, *heights)) for k, (heights, _) in enumerate(layers)]
    stack = boxes(comm, kind, bodies, turn=rotation(4, dim))
    marks = [
        (SECONDARY if k < len(secondary) else PRIMARY, [k], near(dim - 1, height))
        for k, (_, faces) in enumerate(layers)
        for height in faces
    ]
    with pytest.raises(PairingError, match="do not face each other"):
        stack.operators(ContactPair(stack.tags(*marks), SECONDARY, PRIMARY, Frictionless()))


def bent_round(radius: float, dim: int):
    """Map the last axis, from 0 to 1, to the angle, and the first one to the radius."""

    def move(x: np.ndarray) -> np.ndarray:
        angle, r = -2.0 * np.pi * x[:, dim - 1], radius + x[:, 0]
        rest = [x[:, 1]] if dim == 3 else []
        return np.stack([r * np.cos(angle), r * np.sin(angle), *rest], axis=1)

    return move


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fit", [0.0, 0.01, -0.01])
def test_a_ring_on_a_ring(comm, kind, fit):
    """Whole boundaries of rings give the pairing of clean tags, with and without clearance."""
    dim = dim_of(kind)
    n = 16 if dim == 2 else 8
    radius = 1.0
    along = [(0.0, 1.0)] * (dim - 1)
    inner = Body((1, n), [(-0.3, 0.0), *along], move=bent_round(radius, dim))
    outer = Body((1, n + 1), [(fit, 0.3), *along], move=bent_round(radius, dim))
    rings = boxes(comm, kind, [inner, outer], turn=rotation(4, dim))
    clean = (near(0, 0.0), near(0, fit))
    for one, other in ((0, 1), (1, 0)):
        tags = [
            rings.tags(
                (SECONDARY, [one], clean[one] if cleanly else None),
                (PRIMARY, [other], clean[other] if cleanly else None),
            )
            for cleanly in (True, False)
        ]
        results = [
            rings.operators(ContactPair(t, SECONDARY, PRIMARY, Frictionless())) for t in tags
        ]
        same(comm, *results, ROUNDING)
        assert np.abs(results[0].gap - fit).max(initial=0.0) < 0.3 / n


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("shift", "match"), [(1e-11, True), (1e-6, False)])
def test_nodes_match_to_rounding_or_not_at_all(comm, kind, shift, match):
    """Meshes that are shifted by rounding match; others are refused by the pairing of nodes."""
    dim = dim_of(kind)
    lower = Body((2, 1), [(0.0, 1.0)] * (dim - 1) + [(-1.0, 0.0)])
    upper = Body((2, 1), [(shift, 1.0 + shift)] * (dim - 1) + [(0.0, 1.0)])
    both = boxes(comm, kind, [lower, upper], turn=rotation(6, dim))
    tags = both.tags((SECONDARY, [1], near(-1, 0.0)), (PRIMARY, [0], near(-1, 0.0)))
    error = nullcontext() if match else pytest.raises(PairingError, match="do not match")
    with error:
        both.operators(ContactPair(tags, SECONDARY, PRIMARY, Tresca(1.0), "nodes"))
