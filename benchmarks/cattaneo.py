"""Coulomb's law and load steps against Cattaneo and Mindlin: errors and rates on refined meshes.

    tools/fenicsx python3 benchmarks/cattaneo.py --json benchmarks/data/cattaneo.json

Two equal bodies are pressed together, shifted tangentially, and rubbed once to and fro
(`scenes/cattaneo.py` and `cattaneo_cycle.py`), in plane strain and in 3D. Errors are relative. They
are root mean squares over four loads, since on one mesh an error depends on the position of the
edges of the contact and stick zones between the nodes. Expected rates: at these edges pressure and
traction behave like a square root, so they converge with h in L2; integrals of pressure or traction
converge faster.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable, Iterator

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table

from scenes.cattaneo_cycle import cycle_errors

#: Dimension of space -> numbers of cells along a body.
SIZES = {2: (24, 48, 96, 192), 3: (12, 16, 24, 32)}

#: Approaches of the bodies, divided by the scene's own approach.
LOADS = (1.0, 1.2, 1.45, 1.75)

RTOL = 1e-9

#: Head of a column -> name of the error.
ERRORS = {
    "pressure": "pressure",
    "traction": "traction",
    "contact radius": "contact",
    "stick radius": "stick",
    "shift": "shift",
    "of half-spaces": "half_space",
    "work of a cycle": "dissipation",
}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the meshes."""
    for dim in arguments.dims:
        for n in arguments.sizes or SIZES[dim]:
            yield {"dim": dim, "n": n}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the errors on a mesh."""
    start = time.perf_counter()
    errors = cycle_errors(comm, case["dim"], case["n"], RTOL, LOADS)
    yield {**errors, "seconds": time.perf_counter() - start}


def with_rates(rows: list[Row]) -> list[Row]:
    """Return the rows, with the rates of convergence from the previous mesh."""
    result = []
    for _, family in itertools.groupby(rows, key=lambda row: row["dim"]):
        before: Row = {}
        for row in sorted(family, key=lambda row: -row["cell"]):
            rates = {
                error: math.log(row[error] / before[error]) / math.log(row["cell"] / before["cell"])
                for error in ERRORS.values()
                if error in before
            }
            result.append({**row, "rates": rates})
            before = row
    return result


def error_and_rate(error: str) -> Callable[[list[Row]], str]:
    """Return a function that writes an error and its rate in a cell of the table."""

    def text(rows: list[Row]) -> str:
        (row,) = rows
        if error not in row:
            return ""
        rate = row.get("rates", {}).get(error)
        return f"{100.0 * row[error]:.2g} %" + ("" if rate is None else f" ({rate:.1f})")

    return text


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--dims", type=int, nargs="+", default=[2, 3], choices=[2, 3])
    parser.add_argument("--sizes", type=int, nargs="+", metavar="N", help="instead of the usual")


def fitted_rates(rows: list[Row]) -> str:
    """Return the text of the rates that are fitted to all meshes of each dimension."""
    lines = []
    for dim, family in itertools.groupby(rows, key=lambda row: row["dim"]):
        found = list(family)
        cells = np.log([row["cell"] for row in found])
        if len(found) > 1:
            rates = (
                f"{head} {np.polyfit(cells, np.log([row[error] for row in found]), 1)[0]:.2f}"
                for head, error in ERRORS.items()
                if error in found[0]
            )
            lines.append(f"{dim}D, rates of all meshes: " + ", ".join(rates))
    return "\n".join(lines)


SHOWN = [
    Column("dim", "{dim}D"),
    Column("cells", "{n}"),
    Column("h/a", "{cell:.2f}", width=4),
    *(Column(head, error_and_rate(error), width=12) for head, error in ERRORS.items()),
    Column("off Masing", "{masing:.0e}"),
    Column("open", "{open:.0e}", width=5),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("dim", "n"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[*SHOWN, Column("seconds", "{seconds:.0f}")],
    tables=[Table("cattaneo", SHOWN, derived=with_rates)],
    summary=fitted_rates,
)

if __name__ == "__main__":
    BENCHMARK.main()
