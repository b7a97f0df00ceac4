"""Which solver for K is the fastest, and which BLAS it calls."""

from __future__ import annotations

import ctypes
import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

from mpi4py import MPI

from dolfinx_tresca._base.arguments import check_type, check_word, checked_integer
from dolfinx_tresca._base.parallel import log, warn
from dolfinx_tresca.errors import InputError

#: Name of a solver for K.
ChosenMethod: TypeAlias = Literal["cholesky", "multigrid"]

#: Name of a solver for K as users request it; "auto": `choose` decides.
StiffnessMethod: TypeAlias = Literal["auto", ChosenMethod]

#: Largest numbers of degrees of freedom of a body, by the dimension of space, for which K is
#: factored by default for a single contact solve; above them multigrid is faster. The cost of
#: factors grows with the square of the size of each body. With twice the limit in 3D, solves of
#: sizes between both limits take up to twice the time.
CHOLESKY_LIMITS = {2: 800_000, 3: 50_000}


@dataclass(frozen=True)
class SolverRequest:
    """How the user wants to solve with K: see `ContactProblem`, where `method` is `stiffness`."""

    method: StiffnessMethod = "auto"
    petsc_options: Mapping[str, Any] | None = None
    prefix: str | None = None
    expected_solves: int = 1

    def __post_init__(self) -> None:
        """Check every value."""
        check_word("stiffness", self.method, get_args(StiffnessMethod))
        names = 'a mapping from names, such as {"ksp_rtol": 1e-8}'
        check_type("petsc_options", self.petsc_options, Mapping | None, names)
        for key in self.petsc_options or ():
            check_type("a name in petsc_options", key, str, "a string")
        check_type("petsc_options_prefix", self.prefix, str | None, "a string")
        if self.prefix is not None and self.prefix.startswith("-"):
            raise InputError(f"petsc_options_prefix has no leading hyphen, found '{self.prefix}'.")
        vars(self).update(expected_solves=checked_integer("expected_solves", self.expected_solves))

    def choose(
        self, unknowns: float, dim: int, comm: Any, *, saddle: bool = False
    ) -> tuple[ChosenMethod, str]:
        """Return the name of the solver for K, and the reason for the choice. Not collective.

        `unknowns` is a mean size of the bodies: each counts with its own number of unknowns as
        weight, so that large bodies decide. `saddle` tells that K belongs to a mixed space.
        """
        if self.method == "multigrid" and saddle:
            raise InputError(
                "stiffness='multigrid' needs a positive definite K, not one of a mixed space. Take "
                "'cholesky', or the displacement alone, with a lower quadrature_degree."
            )
        if self.method != "auto":
            return self.method, "requested"
        # each further solve raises the limit by a half, until factors would take too much memory
        limit = int(CHOLESKY_LIMITS[dim] * min(0.5 * (self.expected_solves + 1), 5.0))
        chosen: ChosenMethod = "cholesky" if saddle or unknowns <= limit else "multigrid"
        reason = (
            f"since {unknowns:,.0f} unknowns of a body {'<=' if unknowns <= limit else '>'} "
            f"{limit:,} (limit for {self.expected_solves} solve(s) in {dim}D)"
        )
        if saddle:
            reason = "since multigrid needs a positive definite K"
        log(comm, "stiffness: %s, %s", chosen, reason)
        return chosen, reason


#: Environment variables by which users set the number of OpenBLAS's threads.
THREAD_VARIABLES = {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"}

#: Pattern of the paths of BLAS libraries.
BLAS = re.compile(r"/lib[^/]*blas[^/]*$")


@cache
def warn_of_slow_blas() -> None:
    """Log a warning if this process uses the reference BLAS, at the first call only."""
    path = reference_blas(loaded_libraries())
    if path is not None:
        warn(
            MPI.COMM_SELF,
            "the reference BLAS is in use (%s): factorisations take 5 to 8 times as long as with "
            "OpenBLAS; on Debian install libopenblas0-pthread",
            path,
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


@cache
def openblas_threads() -> Sequence[tuple[Callable[[], int], Callable[[int], None]]]:
    """Return functions that get and set the number of threads of each loaded OpenBLAS."""
    functions = []
    for path in filter(BLAS.search, loaded_libraries()):
        library = ctypes.CDLL(path)
        # wheels of numpy and scipy rename the functions of OpenBLAS
        for prefix, suffix in itertools.product(("", "scipy_"), ("", "64_")):
            names = [f"{prefix}openblas_{verb}_num_threads{suffix}" for verb in ("get", "set")]
            if all(hasattr(library, name) for name in names):
                functions.append((library[names[0]], library[names[1]]))
    return functions


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenBLAS to one thread in a block, unless the environment sets a number.

    The matrix products of a contact solve are so small that threads cost more time than they save,
    and threads that wait take cores away from other ranks.
    """
    limited = [] if THREAD_VARIABLES & os.environ.keys() else openblas_threads()
    counts = [get() for get, _ in limited]
    for _, set_number in limited:
        set_number(1)
    try:
        yield
    finally:
        for (_, set_number), count in zip(limited, counts, strict=True):
            set_number(count)
