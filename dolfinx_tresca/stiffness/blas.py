"""A warning where the slow reference BLAS is in use."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from mpi4py import MPI

from dolfinx_tresca._base.parallel import log


@cache
def warn_of_slow_blas() -> None:
    """Log a warning if this process uses the reference BLAS, at the first call only."""
    path = reference_blas(loaded_libraries())
    if path is not None:
        log(
            MPI.COMM_SELF,
            "the reference BLAS is in use (%s): factorisations take 5 to 8 times as long as with "
            "OpenBLAS; on Debian install libopenblas0-pthread",
            path,
            level=logging.WARNING,
        )


def loaded_libraries() -> set[str]:
    """Return the paths of this process's shared libraries; none on systems other than Linux."""
    maps = Path("/proc/self/maps")
    if not maps.exists():
        return set()
    return set(re.findall(r"/\S+\.so[.\d]*$", maps.read_text(), flags=re.MULTILINE))


def reference_blas(libraries: Iterable[str]) -> str | None:
    """Return the path of the reference BLAS; None if it is missing, or a fast BLAS is present."""
    # wheels of numpy and scipy bring an OpenBLAS of their own, which PETSc does not use
    libraries = sorted(path for path in libraries if not re.search(r"/(num|sci)py\.libs/", path))
    if any(re.search(r"openblas|mkl_|blis|atlas|flexiblas", path) for path in libraries):
        return None
    # Debian keeps the reference implementation in a folder .../blas/ of its own
    reference = re.compile(r"/blas/libblas\.so|librefblas")
    return next((path for path in libraries if reference.search(path)), None)
