"""Random rotations, for what must not depend on the axes."""

from __future__ import annotations

import numpy as np


def rotation(seed: int, dim: int = 3) -> np.ndarray:
    """Return a random rotation (dim, dim); in the plane it is by an angle of `seed` radians."""
    if dim == 2:
        return in_plane(seed)
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def in_plane(angle: float) -> np.ndarray:
    """Return the rotation (2, 2) by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
