"""Seconds of a factorisation of K and of a solve, by the package that factors K.

    FENICSX_SUITE=trixie tools/fenicsx python3 benchmarks/cholesky.py --json cholesky.json
    FENICSX_SUITE=wheels tools/fenicsx python3 benchmarks/cholesky.py --json cholesky.json

The stiffness matrix of the two bricks is factored with each direct solver that PETSc was built
with: Debian's PETSc has CHOLMOD, the PETSc from PyPI does not.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator

from mpi4py import MPI
from petsc4py import PETSc

from harness import Benchmark, Column, Row, Table, add_ranks
from harness.table import DASH

import dolfinx
from dolfinx import fem
from dolfinx.fem import petsc

from dolfinx_tresca.stiffness.cholesky import DEFAULTS, PACKAGE
from scenes.two_bricks import two_bricks

#: Package -> options of PETSc, in addition to the options of `stiffness="cholesky"`.
PACKAGES = {
    "CHOLMOD": {PACKAGE: "cholmod"},
    "MUMPS": {},
    "PETSc": {PACKAGE: "petsc", "pc_factor_mat_ordering_type": "nd"},
    "SuperLU_DIST": {PACKAGE: "superlu_dist", "pc_type": "lu"},
}

#: Packages that cannot solve on several ranks.
SERIAL = ("CHOLMOD", "PETSc")

#: Number of solves over which the time is averaged.
SOLVES = 10

#: Origin of PETSc: DOLFINx 0.9 comes from Debian, the latest DOLFINx from PyPI.
SOURCE = "Debian" if dolfinx.__version__.startswith("0.9") else "PyPI"


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield sizes, numbers of ranks and packages."""
    loops = (arguments.sizes, arguments.ranks, arguments.packages)
    for N, ranks, package in itertools.product(*loops):
        if ranks == 1 or package not in SERIAL:
            yield {"N": N, "ranks": ranks, "package": package, "source": SOURCE}


def measure(comm: MPI.Comm, case: Row) -> Iterator[Row]:
    """Yield the seconds of a factorisation and of a solve. Collective."""
    scene = two_bricks(comm, case["N"])
    K = petsc.assemble_matrix(fem.form(scene.a), scene.bcs)
    K.assemble()
    K.setOption(PETSc.Mat.Option.SPD, True)
    b, x = K.createVecLeft(), K.createVecRight()
    b.set(1.0)
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(K)
    ksp.setOptionsPrefix("benchmark_")
    options = PETSc.Options("benchmark_")
    for name, value in (DEFAULTS | PACKAGES[case["package"]]).items():
        options[name] = value
    ksp.setFromOptions()
    try:
        begun = time.perf_counter()
        ksp.setUp()
        factored = time.perf_counter()
        for _ in range(SOLVES):
            ksp.solve(b, x)
        solved = time.perf_counter()
    except PETSc.Error:
        yield {"status": "not built", "dofs": K.size[0]}
        return
    residual = b.duplicate()
    K.mult(x, residual)
    residual.axpy(-1.0, b)
    yield {
        "status": "CONVERGED" if residual.norm() <= 1e-8 * b.norm() else "wrong",
        "dofs": K.size[0],
        "factorisation": factored - begun,
        "solve": (solved - factored) / SOLVES,
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", nargs="+", type=int, default=[12, 20, 26, 36], metavar="N")
    known = list(PACKAGES)
    parser.add_argument("--packages", nargs="+", default=known, choices=known, metavar="NAME")
    add_ranks(parser)


def seconds(package: str, source: str) -> Column:
    """Return the column with the seconds of a package."""
    return Column(
        f"{package}, {source}",
        "{factorisation:.2g} / {solve:.2g}",
        {"package": package, "source": source},
        missing=DASH,
    )


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("N", "ranks", "package", "source"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        Column("dofs", "{dofs}"),
        Column("ranks", "{ranks}"),
        Column("package", "{package}", width=12),
        Column("from", "{source}", width=6),
        Column("factorisation", "{factorisation:.2f}"),
        Column("solve", "{solve:.4f}"),
    ],
    tables=[
        Table(
            "cholesky",
            [
                Column("unknowns", "{dofs}"),
                Column("ranks", "{ranks}"),
                *(
                    seconds(package, source)
                    for package, source in itertools.product(PACKAGES, ("Debian", "PyPI"))
                    if (package, source) != ("CHOLMOD", "PyPI")
                ),
            ],
            chosen=lambda row: "solve" in row,
            line=["dofs", "ranks"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
