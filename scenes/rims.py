"""A block pressed on a plate that it covers in part; lengths and stresses without units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import ContactPair, Frictionless
from scenes.boxes import Body, Map, Where, boxes
from scenes.elasticity import elasticity, fixed, no_load
from scenes.patches import dim_of
from scenes.scene import Scene

#: Tags of facets: faces of the block and the plate that touch, and those that are held.
BLOCK, PLATE, TOP, BOTTOM = 1, 2, 3, 4

YOUNG, APPROACH = 1000.0, 0.01


@dataclass(frozen=True)
class Rim:
    """What bounds the overlap.

    Attributes:
        span: start and end of the block along each axis across the load; the plate is the unit
            square or interval.
        plate: selects the cells of the plate by their midpoints; None: all.
        move: map of the points of the block; None: they stay.
        strip: whether the block is as wide as the plate along the second axis.
        shift: distance by which the block is moved along the plate's axes, in cells.
    """

    span: tuple[float, float] = (1 / 3, 2 / 3)
    plate: Where | None = None
    move: Map | None = None
    strip: bool = False
    shift: float = 0.3


def _raised(height: Callable[[np.ndarray], np.ndarray]) -> Map:
    """Return a map that raises the lower face; the height depends on the distance to the middle."""

    def move(x: np.ndarray) -> np.ndarray:
        x = x.copy()
        middle = 0.5 * (x[:, :-1].min(axis=0) + x[:, :-1].max(axis=0))
        far = np.abs(x[:, :-1] - middle).max(axis=1)
        x[:, -1] += height(far) * (1.0 - 2.0 * x[:, -1])
        return x

    return move


#: Name -> what bounds the overlap.
RIMS = {
    "edges": Rim(strip=True),
    "edges, nodes match": Rim(strip=True, shift=0.0),
    "corners": Rim(),
    "hole": Rim((1 / 6, 5 / 6), plate=lambda x: np.abs(x[:, :-1] - 0.5).max(axis=1) > 1 / 6),
    "step": Rim((1 / 6, 5 / 6), plate=lambda x: (x[:, 0] < 0.5) | (x[:, -1] < -1 / 6)),
    "chamfer": Rim((1 / 6, 5 / 6), move=_raised(lambda d: 0.2 * np.maximum(d - 1 / 6, 0.0))),
    "crown": Rim((1 / 6, 5 / 6), move=_raised(lambda d: 0.15 * d**2)),
}


def block_on_plate(comm: MPI.Comm, kind: str, name: str, n: int, degree: int = 1) -> Scene:
    """Return the scene with n cells along the plate, a multiple of 6. Collective.

    The upper face of the block is pressed down by `APPROACH`. The secondary side is the block.

    Args:
        comm: communicator of the mesh.
        kind: cells, see `scenes.patches.KINDS`.
        name: what bounds the overlap, of `RIMS`.
        n: cells along the plate.
        degree: degree of the displacement.
    """
    rim, dim = RIMS[name], dim_of(kind)
    start, end = (one + rim.shift / n for one in rim.span)
    wide = [(0.0, 1.0)] * (dim - 2)
    across = [(start, end), *(wide if rim.strip else [(start, end)] * (dim - 2))]
    bodies = [
        Body((n, n // 2), [(0.0, 1.0)] * (dim - 1) + [(-0.5, 0.0)], keep=rim.plate),
        Body((round(n * (end - start)), n // 2), [*across, (0.0, 0.5)], move=rim.move),
    ]
    both = boxes(comm, kind, bodies, degree)
    marks = [(PLATE, 0, 0.0), (BOTTOM, 0, -0.5), (BLOCK, 1, 0.0), (TOP, 1, 0.5)]
    tags = both.tags(
        *((tag, [body], lambda x, z=z: np.abs(x[:, -1] - z) < 1e-9) for tag, body, z in marks)
    )
    V, pressed = both.V, np.append(np.zeros(dim - 1), -APPROACH)
    bcs = [fixed(V, tags.find(BOTTOM)), fixed(V, tags.find(TOP), pressed)]
    pair = ContactPair(tags, BLOCK, PLATE, Frictionless(), pairing="mortar")
    return Scene(V, elasticity(V, YOUNG), no_load(V), bcs, [pair], tags)
