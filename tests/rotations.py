"""Random rotations, for what must not depend on the axes."""

from __future__ import annotations

import numpy as np


def rotation(seed: int) -> np.ndarray:
    """A random rotation (3, 3)."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))
