"""A block with a narrow slot, whose two faces touch when it is pressed; in 2D and 3D."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed, no_load
from scenes.patches import dim_of
from scenes.scene import Scene

#: Tags of the lower and upper face of the slot, the bottom and the top.
LOWER, UPPER, BOTTOM, TOP = 1, 2, 3, 4

#: Where the slot ends inside the block of size 1, and its height before it is narrowed.
END, HEIGHT = 0.25, 1.0 / 7.0


def slot(
    comm: MPI.Comm,
    kind: str,
    gap: float,
    *,
    angle: float = 0.0,
    shift: float = 0.0,
    across: int = 12,
    degree: int = 1,
) -> Scene:
    """Return a block with a slot at mid height, open at one side, its top pressed down. Collective.

    The pair has both faces on both sides. `data.halves` has two pairs of the lower and the upper
    face, each with another secondary side.

    Args:
        comm: communicator of the mesh.
        kind: type of the cells.
        gap: height of the slot; the block has the size 1.
        angle: angle by which the scene is turned in the plane of the first and the last axis.
        shift: largest shift along the slot of the nodes above it, so that meshes do not match.
        across: divisions along each axis but the last, which has seven.
        degree: degree of the displacement.
    """
    dim = dim_of(kind)
    low, high = 0.5 * (1.0 - HEIGHT), 0.5 * (1.0 + HEIGHT)

    def solid(x: np.ndarray) -> np.ndarray:
        return (x[:, 0] < END) | (np.abs(x[:, -1] - 0.5) > 0.5 * HEIGHT)

    def narrowed(x: np.ndarray) -> np.ndarray:
        result, z = x.copy(), x[:, -1]
        part = np.clip((x[:, 0] - END) / (1.0 - END) * 4.0, 0.0, 1.0)
        half = 0.5 * ((1.0 - part) * HEIGHT + part * gap)
        middle = 0.5 + half * (z - 0.5) / (0.5 * HEIGHT)
        below, above = z / low * (0.5 - half), 1.0 - (1.0 - z) / (1.0 - high) * (0.5 - half)
        lower, upper = z < low + 1e-9, z > high - 1e-9
        result[:, -1] = np.where(lower, below, np.where(upper, above, middle))
        along = np.sin(np.pi * np.clip((x[:, 0] - END) / (1.0 - END), 0.0, 1.0))
        result[:, 0] += shift * upper * along * (1.0 - z) / (1.0 - high)
        return result

    turn = np.eye(dim)
    turn[np.ix_([0, -1], [0, -1])] = [
        [np.cos(angle), -np.sin(angle)],
        [np.sin(angle), np.cos(angle)],
    ]
    body = Body((across, 7), [(0.0, 1.0)] * dim, solid, narrowed)
    made = boxes(comm, kind, [body], degree, turn=turn)
    faces = [
        (tag, [0], lambda x, z=z, start=start: (np.abs(x[:, -1] - z) < 1e-9) & (x[:, 0] > start))
        for tag, z, start in ((LOWER, low, END), (UPPER, high, END), (BOTTOM, 0, -1), (TOP, 1, -1))
    ]
    tags = made.tags(*faces)
    V = made.V
    push = fem.Constant(made.mesh, turn[:, 0] * 0.002 - turn[:, -1] * 0.02)
    bcs = [fixed(V, tags.find(BOTTOM)), fixed(V, tags.find(TOP), push)]
    pair = ContactPair(tags, (LOWER, UPPER), (LOWER, UPPER), Coulomb(0.3))
    data = SimpleNamespace(
        halves=[
            ContactPair(tags, *sides, Coulomb(0.3)) for sides in ((LOWER, UPPER), (UPPER, LOWER))
        ]
    )
    return Scene(V, elasticity(V, 1.0, 0.3), no_load(V), bcs, [pair], tags, data=data)
