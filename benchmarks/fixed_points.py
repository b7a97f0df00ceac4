"""Numbers of random dense problems for which each way finds a fixed point of Coulomb's law.

    tools/fenicsx python3 benchmarks/fixed_points.py --json benchmarks/data/fixed_points.json

Each problem has 1 to 8 nodes, a full A with a condition number of up to 1e4, and one coefficient of
friction F at all nodes; by Brouwer's theorem each problem has a fixed point. The table counts the
problems that are solved to a relative residual of 1e-7 in the following ways: Newton's method on
the model of A takes full steps from the present point; it also shortens steps that do not reduce
the residual; in addition, A is computed whole where the residual falls slowly; and points of an
interior-point method are other initial guesses, as in the package.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table

from dolfinx_tresca import ContactStatus
from dolfinx_tresca.solvers import semismooth_newton
from dolfinx_tresca.solvers.iteration import ModelNewton
from scenes.dense import random_dry_problem, run

#: Coefficients of friction.
COEFFICIENTS = (1.0, 3.0)

#: Relative residual at which solves end.
RTOL = 1e-7

#: Name of a way -> its text in the table, and what it has besides full steps from the present
#: point.
WAYS: dict[str, tuple[str, tuple[str, ...]]] = {
    "newton": ("Newton's method from the present point", ()),
    "damped": ("and steps shortened", ("damped",)),
    "whole": ("and A known whole", ("damped", "whole")),
    "all": ("and from interior points, as built", ("damped", "whole", "interior")),
}


def only(ways: tuple[str, ...]) -> contextlib.ExitStack:
    """Return a context in which the iteration has no ways other than `ways`."""
    stack = contextlib.ExitStack()

    def change(owner: Any, **values: Any) -> None:
        for name, value in values.items():
            stack.enter_context(mock.patch.object(owner, name, value))

    if "damped" not in ways:
        change(semismooth_newton, MOST_CUTS=0)
    if "whole" not in ways:
        change(ModelNewton, complete_products=lambda self: False)
    if "interior" not in ways:
        change(semismooth_newton, GUESSES=0)
    return stack


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield coefficients and ways."""
    for way, F in itertools.product(arguments.ways, arguments.coefficients):
        yield {"way": way, "F": F, "number": arguments.number}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the number of problems that are solved, and the mean of their products."""
    rng = np.random.default_rng(7)
    products = []
    with only(WAYS[case["way"]][1]):
        for seed in range(case["number"]):
            nodes, decades = int(rng.integers(1, 9)), float(rng.uniform(0.0, 4.0))
            problem = random_dry_problem(seed, nodes, decades, case["F"])
            if run(problem, rtol=RTOL).status is ContactStatus.CONVERGED:
                products.append(problem.products)
    yield {"found": len(products), "products": float(np.mean(products))}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--ways", nargs="+", default=list(WAYS), choices=WAYS)
    parser.add_argument("--coefficients", nargs="+", type=float, default=list(COEFFICIENTS))
    parser.add_argument("--number", type=int, default=400, help="of problems")


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("way", "F", "number"),
    cases=cases,
    measure=measure,
    options=options,
    small={"number": 1},
    shown=[
        Column("way", "{way}", width=8),
        Column("F", "{F}", width=4),
        Column("of", "{number}", width=4),
        Column("found", "{found}"),
        Column("products", "{products:.1f}"),
    ],
    tables=[
        Table(
            "fixed_points",
            [
                Column("way", lambda rows: WAYS[rows[-1]["way"]][0]),
                *(Column(f"F = {F:.0f}", "{found}", {"F": F}) for F in COEFFICIENTS),
            ],
            chosen=lambda row: row["number"] == 400,
            line=["way"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
