"""Pseudo-random integers that are the same on all ranks and machines."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def splitmix64(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Scramble the bits of 64-bit integers (n,), one to one. Not collective.

    This is the output function of SplitMix64 (Steele, Lea and Flood 2014).
    """
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    result: npt.NDArray[np.uint64] = x ^ (x >> np.uint64(31))
    return result
