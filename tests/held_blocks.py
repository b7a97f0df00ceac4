"""A block in the plane that its top holds over a rigid obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

from dolfinx import fem

from dolfinx_tresca import RigidObstacle
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import fixed
from scenes.scene import Scene


def block_over(
    comm: MPI.Comm,
    n: tuple[int, int],
    height: float,
    obstacle: RigidObstacle,
    friction: Any,
    at: Sequence[float] = (0.0, 0.0),
) -> tuple[Scene, fem.Constant]:
    """Return the scene of a block of length 1, and the motion of its top. Collective.

    It has n cells along and across, an obstacle below it, and `at` is the motion of its top.
    """
    scene = block(
        comm,
        n,
        size=(1.0, height),
        boxes=True,
        load=(0.0, 0.0, 0.0),
        friction=friction,
        obstacles=[(BELOW, obstacle)],
    )
    motion = fem.Constant(scene.mesh, at)
    top = fixed(scene.V, scene.facet_tags.find(ABOVE), motion)
    return replace(scene, bcs=[top]), motion
