"""A warning where the slow reference BLAS is in use."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path


@cache
def slow_blas() -> str | None:
    """Return the path of the reference BLAS if this process has loaded it, else None.

    Only Linux tells which libraries a process has loaded; elsewhere the answer is None.
    """
    maps = Path("/proc/self/maps")
    if not maps.exists():
        return None
    loaded = set(re.findall(r"/\S+\.so[.\d]*$", maps.read_text(), flags=re.MULTILINE))
    if any(re.search(r"openblas|mkl_|blis|atlas|flexiblas", path) for path in loaded):
        return None
    # Debian keeps the reference implementation in a folder .../blas/ of its own
    return next(
        (path for path in loaded if re.search(r"/(lib)?blas/libblas\.so|librefblas", path)), None
    )
