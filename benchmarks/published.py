"""Published cases: values of other programs or of theory, and our values on three meshes.

    tools/fenicsx python3 benchmarks/published.py --json benchmarks/data/published.json \
        --picture docs/published.png
    tools/fenicsx python3 benchmarks/published.py --cases plate --sizes 64

Each case is a JSON file in `yardstick/cases` and a script in `benchmarks/published_cases`; the
second line solves a case on one mesh, whose size is the argument that the case names. From mesh to
mesh cells are refined by a constant factor r, so a value changes twice. The observed order of
convergence is the logarithm, to the base r, of the first change divided by the last change. The
error of the value on the finest mesh is estimated as the last change divided by r^q - 1, where the
order q is the observed order, limited to the range from 0.5 to the order of theory (W. L. Oberkampf
and C. J. Roy, Verification and Validation in Scientific Computing, 2010, section 8.6). The last
change may be small by chance: if the change that follows from the first change and the order of
theory is larger, that change is used instead. If the changes have different signs, the error is the
larger change. Changes below the residual of the solves count as zero.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from harness import Benchmark, Column, Comm, Row, Table, figure

sys.path.insert(0, str(Path(__file__).with_name("published_cases")))

from case import RTOL, number

if TYPE_CHECKING:
    from case import Case

#: Folder of the cases, from which they import each other.
CASES = sys.path[0]

#: Names of the cases, in the order of the table.
NAMES = tuple(
    """patch_test ball crossed roller moose_cylinder kratos_cylinder getfem_disc beam_gap
    rounded_punch shrink_fit punch rough_punch receding tilted_punch partial_slip bulk_tension
    twisting one_node triangle plate pushed_block incline impact indentation rolling
    ironing""".split()
)


def case_of(name: str) -> Case:
    """Return the case of a script."""
    if CASES not in sys.path:  # tests remove it
        sys.path.insert(0, CASES)
    case: Case = importlib.import_module(name).CASE
    return case


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield each case on each mesh."""
    for name in arguments.cases:
        sizes = arguments.sizes or case_of(name).sizes[: arguments.meshes]
        for level, size in enumerate(sizes):
            yield {"case": name, "level": level, "size": size, "finest": size == sizes[-1]}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the values of a case on a mesh, and the curve of its picture."""
    known = case_of(case["case"])
    start = time.perf_counter()
    result = known.solve(comm, case["size"])
    mesh, dofmap = result.space.mesh, result.space.dofmap
    common = {
        "seconds": time.perf_counter() - start,
        "kind": mesh.topology.cell_name(),
        "cells": mesh.topology.index_map(mesh.topology.dim).size_global,
        "unknowns": dofmap.index_map.size_global * dofmap.index_map_bs,
        "degree": result.space.ufl_element().degree,
    }
    if case["finest"] and len(result.x):
        x, y = ([float(f"{one:.6g}") for one in axis] for axis in (result.x, result.y))
        common.update(x=x, y=y)
    for quantity in known.published:
        yield {"quantity": quantity, "value": result.values[quantity], **common}
        common = {}  # only the first row of a mesh has these figures


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--cases", nargs="+", default=NAMES, choices=NAMES)
    parser.add_argument("--meshes", type=int, default=3, help="the coarsest ones")
    parser.add_argument("--sizes", type=float, nargs="+", help="instead of the usual meshes")


#: Observed orders of convergence below this number are replaced by it.
LEAST_ORDER = 0.5


def estimated(meshes: list[Row], known: Case) -> Row:
    """Return the observed order, None if values oscillate, and the error of the last value.

    Args:
        meshes: the rows of a quantity on three meshes, from coarse to fine.
        known: the case.
    """
    first, middle, last = (row["value"] for row in meshes)
    coarse, fine = (row["size"] for row in meshes[:2])
    factor = max(coarse / fine, fine / coarse)
    changes = [
        change if abs(change) > RTOL * abs(last) else 0.0
        for change in (middle - first, last - middle)
    ]
    if changes[0] * changes[1] < 0.0:
        order, error = None, max(map(abs, changes))
    elif changes[1] == 0.0:
        order, error = math.inf, 0.0
    else:
        ratio = abs(changes[0] / changes[1])
        order = math.log(ratio) / math.log(factor) if ratio > 0.0 else -math.inf
        counts = min(max(order, LEAST_ORDER), known.order)
        promised = abs(changes[0]) / factor**known.order
        error = max(abs(changes[1]), promised) / (factor**counts - 1.0)
    relative = error / abs(last) if error > 0.0 else 0.0
    return {"order": order, "error": max(relative, known.resolution)}


def quantities(rows: list[Row]) -> list[Row]:
    """Return a row for each quantity: values, observed order, and the error of the last value."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda row: (NAMES.index(row["case"]), row["level"])):
        if "quantity" in row:  # otherwise the case was stopped
            groups.setdefault((row["case"], row["quantity"]), []).append(row)
    result = []
    for (name, quantity), meshes in groups.items():
        known = case_of(name)
        low, high = (getattr(known.published[quantity], end) for end in ("low", "high"))
        row = {**meshes[-1], "values": [one["value"] for one in meshes], "title": known.title}
        last = row["value"]
        row["published"] = known.published[quantity].text
        row["source"] = known.published[quantity].source or known.source
        nearest = min(max(last, low), high)
        row["range"] = low < high
        row["off"] = (last - nearest) / abs(nearest) if last != nearest else 0.0
        if len(meshes) == 3:
            row.update(estimated(meshes, known))
        result.append(row)
    return result


def meshes_of(rows: list[Row]) -> list[Row]:
    """Return a row for each case: its meshes, the seconds on the finest, and its command."""
    groups: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: (NAMES.index(row["case"]), row["level"])):
        if "unknowns" in row:
            groups.setdefault(row["case"], []).append(row)
    result = []
    for name, meshes in groups.items():
        known = case_of(name)
        row = {**meshes[-1], "title": known.title, "argument": known.argument}
        for field in ("size", "cells", "unknowns"):
            row[f"all_{field}"] = ", ".join(f"{one[field]:.6g}" for one in meshes)
        result.append(row)
    return result


def value_on(level: int) -> Callable[[list[Row]], str]:
    """Return a function that writes the value on a mesh; `level` 0 is the coarsest mesh."""

    def text(rows: list[Row]) -> str:
        values = rows[0]["values"]
        return number(values[level]) if level < len(values) else ""

    return text


def observed_order(rows: list[Row]) -> str:
    """Return the observed order of convergence as text."""
    if "order" not in rows[0]:
        return ""
    order = rows[0]["order"]
    return "oscillates" if order is None else "" if math.isinf(order) else f"{order:.1f}"


def own_error(rows: list[Row]) -> str:
    """Return the estimated relative error of the value on the finest mesh, as text."""
    error = rows[0].get("error")
    return "" if error is None else f"{100 * error:.1g} %"


def difference(rows: list[Row]) -> str:
    """Return the relative distance of the value on the finest mesh from the published range."""
    (row,) = rows
    return "inside" if row["off"] == 0.0 and row["range"] else f"{100 * row['off']:+.2g} %"


def draw(path: Path, rows: list[Row]) -> None:
    """Save a picture with a panel for each case: the published curve, and ours (finest mesh)."""
    curves = [row for row in rows if "x" in row]
    drawn = {row["case"] for row in curves}
    names = [name for name in NAMES if name in drawn and case_of(name).axes]
    lines = math.ceil(len(names) / 2)
    picture, panels = figure.new_figure(2.6 * lines, lines, 2)
    for panel, name in itertools.zip_longest(panels.ravel(), names):
        if name is None:
            panel.set_axis_off()
            continue
        case = case_of(name)
        finest = max((row for row in curves if row["case"] == name), key=lambda row: row["level"])
        if case.curve is not None:
            panel.plot(*case.curve, color="0.7", lw=4, label="reference")
            panel.set_xlim(case.curve[0][0], case.curve[0][-1])
        panel.plot(finest["x"], finest["y"], color="tab:blue", lw=1, label="computed")
        if case.marks is not None:
            panel.plot(*case.marks, "o", color="tab:orange", ms=4, label="reference")
        assert case.axes is not None
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
    Column("published", "{published}"),
    Column("by", "{source}"),
    *(Column(head, value_on(level)) for level, head in enumerate(("coarse", "medium", "fine"))),
    Column("order", observed_order),
    Column("own error", own_error),
    Column("fine, off the published", difference),
]

MESHES = [
    Column("case", "{title}"),
    Column("size", "{argument}"),
    Column("on the three meshes", "{all_size}"),
    Column("cells", "{all_cells}"),
    Column("", "{kind}, degree {degree}"),
    Column("unknowns", "{all_unknowns}"),
    Column("finest, seconds", "{seconds:.0f}"),
    Column("script", "`{case}.py`"),
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
        Column("quantity", "{quantity}", width=42),
        Column("value", "{value:.6g}", width=10),
        Column("seconds", "{seconds:.1f}"),
    ],
    tables=[
        Table("published", COLUMNS, derived=quantities),
        Table("published_meshes", MESHES, derived=meshes_of),
    ],
    draw=draw,
)

if __name__ == "__main__":
    BENCHMARK.main()
