"""Numbers without a pattern from numbers with one, the same on any rank and machine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def mixed(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return 64-bit integers (n,) with their bits mixed, different ones for different ones.

    The last step of SplitMix64 (Steele, Lea, Flood 2014). Not collective.
    """
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    result: npt.NDArray[np.uint64] = x ^ (x >> np.uint64(31))
    return result
