"""A as a sparse matrix, from products that many bodies share."""

from __future__ import annotations

import numpy as np
import pytest

from scenes.wall import HEIGHT, wall

#: Bricks in a course and courses.
SIZE = 3, 5


def pushed(comm, parts: list[float]) -> tuple[np.ndarray, int]:
    """Displacements of the wall's top at the end of accepted load steps, and products."""
    scene = wall(comm, *SIZE)
    course = scene.data.weights.sum() / SIZE[1]
    products = 0
    with scene.problem() as problem:
        for part in parts:
            scene.data.push.value = part * course / HEIGHT
            solution = problem.solve(rtol=1e-9)
            solution.raise_if_failed()
            products += solution.products
            problem.accept()
        u = solution.u.x.petsc_vec
        return np.array([u.norm(), u.sum()]), products


@pytest.mark.parallel
def test_solutions_are_those_without_the_matrix(comm, monkeypatch):
    """The wall under its weight and pushed: the same displacement; a push takes no product."""
    with_matrix, products = pushed(comm, [0.0, 0.1])
    monkeypatch.setattr("dolfinx_tresca.dual.products.sparse_rows", lambda *arguments: None)
    without, _ = pushed(comm, [0.0, 0.1])
    # relative residuals of 1e-9; displacements of the wall as a whole magnify them
    assert np.allclose(with_matrix, without, rtol=1e-6)
    assert products <= 32
