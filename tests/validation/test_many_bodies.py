"""Many bodies that only contact holds."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    InputError,
    RigidPlane,
)
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity

WEIGHT = 0.02  # N per mm of thickness, of a block of 1 mm x 1 mm


def column(comm, blocks, top=None):
    """Return the problem of a column of blocks on a rigid plane, under their weight.

    Args:
        comm: of the mesh.
        blocks: their number.
        top: law of friction below the topmost block; None: that of the others.
    """
    made = boxes(comm, "quadrilateral", [Body((2, 1), [(0, 1), (k, k + 1)]) for k in range(blocks)])
    marks = [
        (1 + 2 * k + side, [k], lambda x, height=k + side: np.isclose(x[:, 1], height))
        for k in range(blocks)
        for side in (0, 1)
    ]
    tags = made.tags(*marks)
    laws = [Coulomb(0.6)] * (blocks - 1) + [Coulomb(0.6) if top is None else top]
    pairs = [ContactPair(tags, 1, RigidPlane((0.0, 0.0), (0.0, 1.0)), laws[0])]
    pairs += [ContactPair(tags, 1 + 2 * k, 2 * k, laws[k]) for k in range(1, blocks)]
    load = -WEIGHT * ufl.TestFunction(made.V)[1] * ufl.dx
    return ContactProblem(elasticity(made.V, 5e3, 0.2), load, pairs)


@pytest.mark.parallel
def test_a_tall_column(comm):
    """Contact resists the motions of all bodies together with 1 / n^4 of one body's resistance."""
    blocks = 60
    with column(comm, blocks) as problem:
        solution = problem.solve(rtol=1e-6)
        solution.raise_if_failed()
    pressed = [one.force[1] for one in solution.pair_resultants]
    weights = WEIGHT * np.arange(blocks, 0, -1)
    assert pressed == pytest.approx(weights, rel=1e-9)


@pytest.mark.long
def test_a_column_of_300():
    with column(MPI.COMM_SELF, 300) as problem:
        solution = problem.solve(rtol=1e-6)
        solution.raise_if_failed()
    assert solution.pair_resultants[0].force[1] == pytest.approx(300 * WEIGHT, rel=1e-9)


@pytest.mark.parallel
def test_a_loose_block_on_a_tall_column(comm):
    """Nothing resists the sliding of the topmost block, whatever holds the others."""
    with pytest.raises(InputError, match=r"nothing holds body 60 of 60.*: translation along x,"):
        with column(comm, 60, Frictionless()) as problem:
            problem.solve()
