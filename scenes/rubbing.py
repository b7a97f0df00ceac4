"""Two blocks that are pressed, dragged and tilted, so that parts stick, slip and open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import Tresca
from scenes.patches import dim_of, patch
from scenes.scene import Scene

#: Young's modulus of the upper block, and the slip bound divided by Young's modulus.
YOUNG, BOUND = 1000.0, 1e-3


def rubbing(
    comm: MPI.Comm,
    kind: str,
    degree: int = 1,
    *,
    turn: np.ndarray | None = None,
    shift: Sequence[float] = (0.0, 0.0, 0.0),
    scale: float = 1.0,
    young: float = YOUNG,
    **arguments: Any,
) -> Scene:
    """Return the scene: the lower end is clamped, the upper one is moved. Collective.

    Args:
        comm: communicator of the mesh.
        kind: type of the cells.
        degree: degree of the displacement.
        turn: see `patch`; displacements are turned, too.
        shift: see `patch`.
        scale: see `patch`; displacements are scaled, too.
        young: Young's modulus of the upper block; the lower one is twice as stiff.
        arguments: further arguments of `patch`.
    """
    dim = dim_of(kind)
    given = {"friction": Tresca(BOUND * young), "young": (young, 2.0 * young), **arguments}
    scene = patch(comm, kind, degree, turn=turn, shift=shift, scale=scale, **given)
    R = np.eye(dim) if turn is None else np.asarray(turn)
    nodes = scene.V.tabulate_dof_coordinates() - np.asarray(shift)
    x = nodes[:, :dim] @ R / scale
    u = np.zeros_like(x)
    upper = x[:, dim - 1] > 1.5  # only the values at the ends are used
    u[upper] = moved_end(x[upper])
    scene.data.exact.x.array[:] = scale * (u @ R.T).ravel()
    return scene


def moved_end(x: np.ndarray) -> np.ndarray:
    """Return displacements (n, dim) of the upper end: down, dragged along, and tilted."""
    u = np.zeros_like(x)
    u[:, 0] = 1e-3
    u[:, -1] = -4e-3 + 7e-3 * x[:, 0] ** 2
    if x.shape[1] == 3:
        u[:, 1] = 1e-3 * (x[:, 0] - x[:, 1])
    return u
