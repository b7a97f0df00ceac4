"""Solves with extreme data, shapes and algebra, compared with ordinary scenes.

    tools/fenicsx python3 benchmarks/extremes.py --json FILE

The script runs the cases of scenes/extremes. For each case it prints the status, iterations and
products with A. It also checks the laws of contact, analytic values and invariants, and prints the
check that is nearest to its limit. The first case of each group is an ordinary scene. FAILED marks
a wrong answer or status, with which the tests fail, too.
"""

from __future__ import annotations

import argparse
import itertools
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence

from harness import Benchmark, Column, Comm, Row, Table, add_ranks

from dolfinx_tresca import ContactStatus
from scenes.extremes.cases import Case, Check
from scenes.extremes.cases_of_algebra import CASES as OF_ALGEBRA
from scenes.extremes.cases_of_data import CASES as OF_DATA
from scenes.extremes.cases_of_shape import CASES as OF_SHAPE

ALL = (*OF_DATA, *OF_SHAPE, *OF_ALGEBRA)
GROUPS = list(dict.fromkeys(case.group for case in ALL))


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the groups."""
    for ranks, group in itertools.product(arguments.ranks, GROUPS):
        if arguments.only in group:
            yield {"ranks": ranks, "group": group}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each case of a group. Collective."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        for one in ALL:
            if one.group == case["group"]:
                yield outcome(comm, one)


def outcome(comm: Comm, case: Case) -> Row:
    """Return the row of a case. Collective."""
    start = time.perf_counter()
    row: Row = {"case": case.name, "passed": False}
    try:
        found = case.run(comm)
    except Exception as error:  # such errors are what this benchmark looks for
        row |= {"status": f"{type(error).__name__}: {error}"}
    else:
        row |= {
            "status": found.status,
            "iterations": found.iterations,
            "products": found.products,
            "passed": found.passed,
            "nearest": vars(found.worst) if found.checks else None,
        }
    return row | {"seconds": time.perf_counter() - start}


def nearest(rows: list[Row]) -> str:
    """Return the check that is nearest to its limit."""
    if not rows[0].get("nearest"):
        return ""
    check = Check(**rows[0]["nearest"])
    return f"{check.error:8.1e} of {check.allowed:7.1e} {check.measure}"


def summary(rows: list[Row]) -> str:
    """Return the numbers of all cases and of failed cases."""
    return f"{len(rows)} cases, {sum(not row.get('passed') for row in rows)} failed"


#: Status -> its name in the table; any other status is an error.
OUTCOMES = {
    ContactStatus.CONVERGED.name: "converged",
    ContactStatus.OUTSIDE_THEORY.name: "converged, outside of linear theory",
    ContactStatus.MAX_ITERATIONS.name: "at the iteration limit",
    ContactStatus.STAGNATED.name: "stagnated",
}


#: Group -> range of its cases, if the name of the group does not say it.
RANGES = {
    "stiffness of the upper body over that of the lower": "1e-9 to 1e9",
    "Poisson's ratio": "0 to 0.4999 (degree 1 locks, degree 2 does not)",
    "slip bound": "0, 1e-300 to 1e300, infinite, zero on a half, jumping by 1e9",
    "load": "0 and 1e-120 to 1e120; beyond 1e140 squares are no numbers",
    "units of length and of stress": "micrometres to kilometres, Pa to GPa",
    "shape of cells": "1e4 times as wide as high, and as high as wide",
    "cells of the secondary side over those of the primary side": "1:50 to 50:1",
    "gap over the size of the body": "1e-14 to 1e3, penetration of half of it",
    "what touches": "one node, none, all, a point; opposite slips; edges",
    "repeated constraints": "the same or dependent ones",
    "rho times the largest eigenvalue": "both ends of its interval",
    "spring that holds the body, over the body's stiffness": "1e-10 to 1e-2",
    "accuracy that is requested": "more than double precision has",
    "condition of A": "to 1e12, dense",
}


def described(rows: list[Row]) -> str:
    """Return the name of a line's group, and the range of its cases."""
    group = rows[0]["group"]
    return f"{group}: {RANGES[group]}" if group in RANGES else str(group)


def outcomes(rows: list[Row]) -> str:
    """Return the outcome of the cases of a group, with numbers if there are several outcomes."""
    found = Counter(OUTCOMES.get(row["status"], "refused") for row in rows)
    if len(found) == 1:
        return next(iter(found))
    return ", ".join(f"{number} {name}" for name, number in found.most_common())


def converged(rows: list[Row]) -> list[Row]:
    """Return the rows of cases that converge; the first one is the ordinary scene."""
    return [row for row in rows if row["status"] == ContactStatus.CONVERGED.name]


def ordinary(rows: list[Row]) -> str:
    """Return iterations and products of the ordinary scene."""
    return "{iterations}/{products}".format(**converged(rows)[0])


def ranges(rows: list[Row]) -> str:
    """Return the ranges of iterations and of products over the cases that converge."""
    own = converged(rows)
    return " / ".join(between([row[name] for row in own]) for name in ("iterations", "products"))


def between(values: Sequence[int]) -> str:
    """Return the range of values as text."""
    least, most = min(values), max(values)
    return f"{least}" if least == most else f"{least} to {most}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--only", metavar="WORD", default="", help="groups with this in their name")
    add_ranks(parser)


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("group", "case", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    summary=summary,
    shown=[
        Column("group", lambda rows: rows[0]["group"][:24], width=24),
        Column("case", lambda rows: rows[0].get("case", "")[:40], width=40),
        Column("status", lambda rows: rows[0]["status"][:14], width=14),
        Column("iter/n_A", "{iterations}/{products}"),
        Column("", lambda rows: "" if rows[0].get("passed") else "FAILED"),
        Column("nearest", nearest, width=30),
    ],
    tables=[
        Table(
            "extremes",
            [
                Column("group", described),
                Column("cases", lambda rows: str(len(rows))),
                Column("outcome", outcomes),
                Column("ordinary scene", ordinary),
                Column("all that converge", ranges),
            ],
            chosen=lambda row: row["ranks"] == 1 and "case" in row,
            line=["group"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
