"""Published cases: values of other programs and of theory, and ours on three meshes.

    tools/fenicsx python3 benchmarks/published.py --json benchmarks/data/published.json \
        --picture docs/validation.png

Each case is a script in `benchmarks/published_cases`. Cells are
refined by a constant factor; the error of the finest value is a Richardson extrapolation.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from harness import Benchmark, Column, Comm, Row, Table, figure

sys.path.insert(0, str(Path(__file__).with_name("published_cases")))

if TYPE_CHECKING:
    from published_cases.case import Case

#: Names of the cases, in the order of the table.
NAMES = ("ball", "roller", "shrink_fit", "punch", "plate", "incline", "ironing")


def case_of(name: str) -> Case:
    """Return a case."""
    case: Case = importlib.import_module(name).CASE
    return case


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield each case on each mesh."""
    for name in arguments.cases:
        for level, size in enumerate(case_of(name).sizes[: arguments.meshes]):
            yield {"case": name, "level": level, "size": size}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the values of a case on a mesh, and the curve of its picture."""
    known = case_of(case["case"])
    result = known.solve(comm, case["size"])
    curve = {"x": [*map(float, result.x)], "y": [*map(float, result.y)]}
    for quantity, (low, high) in known.published.items():
        yield {
            "title": known.title,
            "quantity": quantity,
            "low": low,
            "high": high,
            "value": result.values[quantity],
            **curve,
        }
        curve = {}  # the first row has it


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--cases", nargs="+", default=NAMES, choices=NAMES)
    parser.add_argument("--meshes", type=int, default=3, help="the coarsest ones")


def extrapolated(rows: list[Row]) -> list[Row]:
    """Return a row for each quantity: three values, the rate, and the error of the last."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda row: (NAMES.index(row["case"]), row["level"])):
        groups.setdefault((row["case"], row["quantity"]), []).append(row)
    result = []
    for meshes in groups.values():
        row = {**meshes[-1], "values": [one["value"] for one in meshes]}
        low, high, last = row["low"], row["high"], row["values"][-1]
        row["off"] = (last - min(max(last, low), high)) / max(abs(low), abs(high))
        if len(meshes) == 3:
            first, middle, _ = row["values"]
            changes = abs(middle - first), abs(last - middle)
            if changes[1] > 0.0:
                # a ratio below 2 is no sign of convergence with order 1: take the last change
                ratio = max(changes[0] / changes[1], 2.0)
                row["error"] = changes[1] / (ratio - 1.0) / abs(last)
        result.append(row)
    return result


def number(value: float) -> str:
    """Return a value with four digits."""
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"


def published(rows: list[Row]) -> str:
    """Return the published value, or the lowest and the highest."""
    (row,) = rows
    if row["low"] == row["high"]:
        return number(row["low"])
    return f"{number(row['low'])} to {number(row['high'])}"


def value_on(level: int) -> Callable[[list[Row]], str]:
    """Return the text of a column: the value on a mesh."""

    def text(rows: list[Row]) -> str:
        values = rows[0]["values"]
        return number(values[level]) if level < len(values) else ""

    return text


def own_error(rows: list[Row]) -> str:
    """Return the estimated error of the finest value."""
    error = rows[0].get("error")
    return "" if error is None else f"{100 * error:.1g} %"


def difference(rows: list[Row]) -> str:
    """Return how far the finest value is from the published range."""
    off = rows[0]["off"]
    return "inside" if off == 0.0 and rows[0]["low"] < rows[0]["high"] else f"{100 * off:+.2g} %"


def draw(path: Path, rows: list[Row]) -> None:
    """Save a panel for each case: our curve on the finest mesh over the published one."""
    curves = [row for row in rows if "x" in row]
    names = [name for name in NAMES if any(row["case"] == name for row in curves)]
    lines = math.ceil(len(names) / 2)
    picture, panels = figure.new_figure(2.6 * lines, lines, 2)
    for panel, name in itertools.zip_longest(panels.ravel(), names):
        if name is None:
            panel.set_axis_off()
            continue
        case = case_of(name)
        finest = max((row for row in curves if row["case"] == name), key=lambda row: row["level"])
        if case.curve is not None:
            panel.plot(*case.curve, color="0.7", lw=4, label="published")
            panel.set_xlim(case.curve[0][0], case.curve[0][-1])
        panel.plot(finest["x"], finest["y"], color="tab:blue", lw=1, label="computed")
        if case.marks is not None:
            panel.plot(*case.marks, "o", color="tab:orange", ms=4, label="published")
        panel.set(title=case.title, xlabel=case.axes[0], ylabel=case.axes[1])
        end = panel.get_xlim()[1]
        points = [line.get_data() for line in panel.lines]
        shown = [y for xs, ys in points for x, y in zip(xs, ys, strict=True) if x <= end]
        panel.set_ylim(0.0, 1.1 * max(shown))
        panel.legend(frameon=False)
    figure.save(picture, path)


COLUMNS = [
    Column("case", "{title}"),
    Column("quantity", "{quantity}"),
    Column("published", published),
    *(Column(head, value_on(level)) for level, head in enumerate(("coarse", "medium", "fine"))),
    Column("own error", own_error),
    Column("fine, off the published", difference),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("case", "level", "size", "quantity"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        Column("case", "{case}", width=10),
        Column("size", "{size:g}", width=6),
        Column("quantity", "{quantity}", width=32),
        Column("value", "{value:.6g}", width=10),
    ],
    tables=[Table("published", COLUMNS, derived=extrapolated)],
    draw=draw,
)

if __name__ == "__main__":
    BENCHMARK.main()
