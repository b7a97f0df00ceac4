"""Types of numpy arrays, and the least divisor."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Mask: TypeAlias = npt.NDArray[np.bool_]

#: Numbers of nodes, cells, facets or rows, those of a rank and those of all ranks together (or in
#: the mesh file): DOLFINx's own types.
LocalNumbers: TypeAlias = npt.NDArray[np.int32]
GlobalNumbers: TypeAlias = npt.NDArray[np.int64]

#: What divisors, and arguments of logarithms, are raised to: below any length, stiffness, energy or
#: barrier of a scene, in whatever units, and 1 over it does not overflow.
LEAST_DIVISOR = 1e-300
