"""Two blocks that are moved until they just touch, pressed on each other, and moved back."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, ContactStatus, Coulomb
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed, no_load

#: Distance of the blocks, and how far one is pressed in.
GAP, DEPTH = 0.5, 1e-3


@pytest.mark.parametrize("sliding", ["small", "finite"])
@pytest.mark.parametrize("number", [1, 2])
def test_an_exact_touch_has_converged(comm, number, sliding):
    """All forces are rounding then, whether the surfaces have one tag list or two tags."""
    angle = 0.35
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    bodies = [
        Body((8, 4), [(0.0, 1.0), (0.0, 0.5)]),
        Body((8, 4), [(0.0, 1.0), (0.5 + GAP, 1.0 + GAP)]),
    ]
    made = boxes(comm, "triangle", bodies, turn=turn)
    tags = made.tags(
        (1, [0], lambda x: np.isclose(x[:, 1], 0.5)),
        (2, [1], lambda x: np.isclose(x[:, 1], 0.5 + GAP)),
        (3, [0], lambda x: np.isclose(x[:, 1], 0.0)),
        (4, [1], lambda x: np.isclose(x[:, 1], 1.0 + GAP)),
    )
    push = fem.Constant(made.mesh, np.zeros(2))
    bcs = [fixed(made.V, tags.find(3)), fixed(made.V, tags.find(4), push)]
    sides = (1, 2) if number == 2 else ([1, 2], [1, 2])
    pair = ContactPair(tags, *sides, Coulomb(0.3), sliding=sliding)
    forces = []
    with ContactProblem(elasticity(made.V, 1.0, 0.3), no_load(made.V), [pair], bcs) as problem:
        for depth in (0.0, DEPTH, 0.0):
            push.value[:] = -(GAP + depth) * turn[:, 1]
            solution = problem.solve()
            assert solution.status is ContactStatus.CONVERGED
            problem.accept()
            forces.append(solution.normal_force)
    assert forces[1] > 0.5 * DEPTH
    assert max(forces[0], forces[2]) <= 1e-8 * forces[1]
