"""Of surfaces that overlap in part only the overlap counts, whether their meshes match or not."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from rotations import rotation

from dolfinx_tresca import ContactPair, PairingError, Tresca
from scenes.boxes import Body, boxes
from scenes.patches import KINDS, dim_of
from scenes.scene import EPS

ROUNDING = 1e5 * EPS

SECONDARY, PRIMARY, SECOND = 1, 2, 3


def top(x: np.ndarray) -> np.ndarray:
    return np.abs(x[:, -1]) < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_weights_of_a_small_block_on_a_large_plate(comm, kind):
    """Either side as the secondary one; meshes match in the overlap: rows have two nodes."""
    dim = dim_of(kind)
    plate = Body((4, 1), [(0.0, 2.0)] * (dim - 1) + [(-0.5, 0.0)])
    block = Body((2, 1), [(0.5, 1.5)] * (dim - 1) + [(0.0, 1.0)])
    both = boxes(comm, kind, [plate, block], turn=rotation(6, dim))
    tags = both.tags((SECONDARY, [0], top), (PRIMARY, [1], top))
    for one, other in ((SECONDARY, PRIMARY), (PRIMARY, SECONDARY)):
        found = both.operators(ContactPair(tags, one, other, Tresca(1.0), "nodes"))
        assert comm.allreduce(found.weights.sum()) == pytest.approx(1.0, rel=ROUNDING)
        assert comm.allreduce(len(found.nodes)) == 3 ** (dim - 1)
        for means in (found.secondary, found.primary):
            assert (np.sort(np.abs(means.toarray()), axis=1)[:, :-1] <= ROUNDING).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_block_on_two_blocks(comm, kind):
    """Nodes of the seam are there twice: one pair couples both, two pairs share the area."""
    dim = dim_of(kind)
    halves = [Body((2, 1), [(0.5 * i, 0.5 * i + 0.5)] + [(0.0, 0.5)] * (dim - 2) + [(-1.0, 0.0)])
              for i in range(2)]  # fmt: skip
    block = Body((4, 1), [(0.0, 1.0)] + [(0.0, 1.0)] * (dim - 2) + [(0.0, 1.0)])
    if dim == 3:  # cells of the same size both ways
        halves = [Body((2, 1), [(0.5 * i, 0.5 * i + 0.5), (0.0, 0.5), (-1.0, 0.0)])
                  for i in range(2)]  # fmt: skip
    bodies = boxes(comm, kind, [*halves, block], turn=rotation(6, dim))
    area = 1.0 if dim == 2 else 0.5
    single = bodies.tags((PRIMARY, [0, 1], top), (SECONDARY, [2], top))
    for one, other in ((SECONDARY, PRIMARY), (PRIMARY, SECONDARY)):
        found = bodies.operators(ContactPair(single, one, other, Tresca(1.0)))
        assert comm.allreduce(found.weights.sum()) == pytest.approx(area, rel=ROUNDING)
    double = bodies.tags((PRIMARY, [0], top), (SECOND, [1], top), (SECONDARY, [2], top))
    for other in (PRIMARY, SECOND):
        found = bodies.operators(ContactPair(double, SECONDARY, other, Tresca(1.0), "nodes"))
        half = comm.allreduce(found.weights.sum())
        assert half == pytest.approx(0.5 * area, rel=ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("shift", "match"), [(1e-11, True), (1e-6, False)])
def test_nodes_match_to_rounding_or_not_at_all(comm, kind, shift, match):
    dim = dim_of(kind)
    lower = Body((2, 1), [(0.0, 1.0)] * (dim - 1) + [(-1.0, 0.0)])
    upper = Body((2, 1), [(shift, 1.0 + shift)] * (dim - 1) + [(0.0, 1.0)])
    both = boxes(comm, kind, [lower, upper], turn=rotation(6, dim))
    tags = both.tags((SECONDARY, [1], top), (PRIMARY, [0], top))
    error = nullcontext() if match else pytest.raises(PairingError, match="do not match")
    with error:
        both.operators(ContactPair(tags, SECONDARY, PRIMARY, Tresca(1.0), "nodes"))


@pytest.mark.parametrize("kind", KINDS)
def test_graded_meshes_that_overlap_in_part_do_not_match(comm, kind):
    """Facets a hundred times as large beside small ones: no centre of a large one is near."""
    dim = dim_of(kind)

    def graded(x: np.ndarray) -> np.ndarray:
        x = x.copy()
        x[:, : dim - 1] = x[:, : dim - 1] ** 5
        return x

    lower = Body((1, 1), [(0.0, 1.0)] * (dim - 1) + [(-1.0, 0.0)])
    upper = Body((4, 1), [(0.0, 1.0)] * (dim - 1) + [(0.0, 1.0)], move=graded)
    both = boxes(comm, kind, [lower, upper], turn=rotation(6, dim))
    tags = both.tags((SECONDARY, [1], top), (PRIMARY, [0], top))
    for one, other in ((SECONDARY, PRIMARY), (PRIMARY, SECONDARY)):
        found = both.operators(ContactPair(tags, one, other, Tresca(1.0)))
        assert comm.allreduce(found.weights.sum()) == pytest.approx(1.0, rel=1e-3)
