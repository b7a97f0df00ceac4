"""The two bricks with a modulus that changes from solve to solve, for `ablation.py`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import ufl
from dolfinx import fem

from scenes.elasticity import elasticity
from scenes.scene import Scene
from scenes.two_bricks import YOUNG

#: Seed of the random waves, and the number of changes.
SEED, CHANGES_IN_A_ROW = 3, 10

#: Name of the changes.
IN_A_ROW = "ten_random_waves_of_50_%"


def form(scene: Scene, change: str = IN_A_ROW) -> tuple[Any, list[Callable[[], None]]]:
    """Return the form, and functions, to be called in turn, that change its modulus by waves."""
    x = ufl.SpatialCoordinate(scene.mesh)
    amplitude, q = fem.Constant(scene.mesh, 0.0), fem.Constant(scene.mesh, np.zeros(4))
    rng = np.random.default_rng(SEED)

    def change_waves() -> None:
        amplitude.value = 0.5
        q.value[:] = rng.uniform(0.0, 8.0, 4)

    young = YOUNG * (1 + amplitude * ufl.sin(q[0] * x[0] + q[1]) * ufl.cos(q[2] * x[2] + q[3]))
    return elasticity(scene.V, young, scene.data.poisson), [change_waves] * CHANGES_IN_A_ROW
