"""What happens at extremes: of data, shape and algebra, compared with ordinary scenes.

    tools/fenicsx python3 benchmarks/extremes.py --json FILE

Runs the cases of scenes/extremes, prints for each its status, iterations, products with A, and of
all that is checked (the laws of contact, analytic values, invariants) what is nearest to its limit.
Of each group the first case is an ordinary scene. FAILED marks a wrong answer or status, which the
tests do not let pass. It writes a list of objects with the same. It runs under mpirun too.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

from mpi4py import MPI

from scenes.extremes.cases import Case, Check
from scenes.extremes.cases_of_algebra import CASES as OF_ALGEBRA
from scenes.extremes.cases_of_data import CASES as OF_DATA
from scenes.extremes.cases_of_shape import CASES as OF_SHAPE


def measure(case: Case) -> dict[str, Any]:
    """Return a row of the table. Collective."""
    start = time.perf_counter()
    row = {"group": case.group, "case": case.name, "checks": [], "passed": False}
    try:
        found = case.run(MPI.COMM_WORLD)
    except Exception as error:  # that is what is looked for
        row |= {"status": f"{type(error).__name__}: {error}", "iterations": 0, "products": 0}
    else:
        row |= {
            "status": found.status,
            "iterations": found.iterations,
            "products": found.products,
            "passed": found.passed,
            "checks": [vars(check) for check in found.checks],
            "nearest": vars(found.worst),
        }
    return row | {"seconds": time.perf_counter() - start}


def print_row(row: dict[str, Any]) -> None:
    """Print a row of the table."""
    check = Check(**row["nearest"]) if row["checks"] else None
    shown = f"{check.error:8.1e} of {check.allowed:7.1e} {check.measure}" if check else ""
    print(
        f"  {row['case'][:52]:<52} {row['status'][:14]:<14} "
        f"{row['iterations']:>4}/{row['products']:<4} {shown}" + "  FAILED" * (not row["passed"]),
        flush=True,
    )


def main() -> None:
    """Read the arguments, run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="WORD", default="", help="groups with this in their name")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()

    warnings.simplefilter("error", RuntimeWarning)
    first = MPI.COMM_WORLD.rank == 0
    if first and arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.touch()
    rows: list[dict[str, Any]] = []
    for case in (*OF_DATA, *OF_SHAPE, *OF_ALGEBRA):
        if arguments.only not in case.group:
            continue
        if first and (not rows or rows[-1]["group"] != case.group):
            print(case.group)
        rows.append(measure(case))
        if first:
            print_row(rows[-1])
    if first:
        failed = sum(not row["passed"] for row in rows)
        print(f"{len(rows)} cases, {failed} failed")
        if arguments.json is not None:
            arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
