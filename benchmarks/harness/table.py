"""Tables of rows: lines on a terminal while they are measured, Markdown for README.md."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from harness.record import Row

#: A template such as "{iterations}/{products}" for the one row of a cell, or a function of its
#: rows, of which there may be several. Where there is no row or figure the cell is empty.
Text: TypeAlias = str | Callable[[list[Row]], str]

#: What cells have that nothing was measured for.
DASH = "\N{EN DASH}"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        head: what stands above.
        text: of a cell.
        where: fields and values of the rows that a cell shows, of those of its line.
        missing: what a cell without rows or figures has.
        width: least width on a terminal.
    """

    head: str
    text: Text
    where: Mapping[str, Any] = field(default_factory=dict)
    missing: str = ""
    width: int = 0

    def rows(self, line: Sequence[Row]) -> list[Row]:
        """Return the rows of a line that a cell shows."""
        return [row for row in line if all(row.get(k) == v for k, v in self.where.items())]

    def cell(self, line: Sequence[Row]) -> str:
        """Return the text in a line."""
        rows = self.rows(line)
        if not rows:
            return self.missing
        if callable(self.text):
            return self.text(rows)
        try:
            return self.text.format(**rows[-1])
        except (KeyError, TypeError):  # no such figure, or None
            return self.missing


def krylov_iterations(rows: Sequence[Row]) -> str:
    """Return those of a cell's row, for a column; a direct solver has none."""
    return str(rows[-1].get("krylov_iterations") or DASH)


def heads(columns: Sequence[Column]) -> str:
    """Return the heads, for a terminal."""
    return "  ".join(column.head.rjust(column.width) for column in columns)


def printed(columns: Sequence[Column], row: Row) -> str:
    """Return a row below `heads`."""
    return "  ".join(
        column.cell([row]).rjust(max(column.width, len(column.head))) for column in columns
    ).rstrip()


@dataclass(frozen=True)
class Table:
    """What a table in README.md shows of the rows of a benchmark.

    Attributes:
        name: its name in README.md.
        columns: from left to right.
        chosen: which rows it shows.
        line: fields that the rows of a line have in common; none: each row has its own line.
        derived: makes other rows of those, each with the `run` of what it is made of.
    """

    name: str
    columns: Sequence[Column]
    chosen: Callable[[Row], bool] = lambda row: True
    line: Sequence[str] = ()
    derived: Callable[[list[Row]], list[Row]] = lambda rows: rows

    def lines(self, rows: Sequence[Row]) -> list[list[Row]]:
        """Return the rows of each line, lines in the order in which the first rows came."""
        result: dict[Any, list[Row]] = {}
        for number, row in enumerate(self.derived([row for row in rows if self.chosen(row)])):
            key = tuple(row.get(name) for name in self.line) if self.line else number
            result.setdefault(key, []).append(row)
        return list(result.values())

    def markdown(self, rows: Sequence[Row]) -> str:
        """Return the table, and below it which code measured which lines."""
        lines = self.lines(rows)
        texts = [
            [column.head for column in self.columns],
            ["---"] * len(self.columns),
            *([column.cell(line) for column in self.columns] for line in lines),
        ]
        table = ["| " + " | ".join(text) + " |" for text in texts]
        table[1] = "|" + "---|" * len(self.columns)
        return "\n".join([*table, "", self._sources(lines)])

    def _sources(self, lines: list[list[Row]]) -> str:
        """Return which run measured what is shown where."""
        # columns without `where` show what all rows of a line have in common
        numbered = [(n, column) for n, column in enumerate(self.columns, 1) if column.where]
        cells: dict[str, set[tuple[int, int]]] = {}
        for i, line in enumerate(lines, 1):
            for j, column in numbered or [(0, self.columns[0])]:
                for row in column.rows(line):
                    cells.setdefault(source(row["run"]), set()).add((i, j))
        if len(cells) == 1:
            return f"Code: {next(iter(cells))}."
        own = {text: sorted({i for i, _ in places}) for text, places in cells.items()}
        mixed = sum(map(len, own.values())) > len(lines)
        texts = []
        for text, places in cells.items():
            where = spans("line", own[text])
            if mixed:
                where += ", " + spans("column", sorted({j for _, j in places}))
            texts.append(f"{where}: {text}")
        return "Code: " + "; ".join(texts) + "."


def source(run: Row) -> str:
    """Return by which code, when, and on what a run was."""
    return (
        f"`{run['commit']}` of {run['date']} ({run['cpu']}, {run['cores']} cores, "
        f"threads: {run['threads']}, DOLFINx {run['dolfinx']}, PETSc {run['petsc']})"
    )


def spans(name: str, numbers: Sequence[int]) -> str:
    """Return ascending numbers of lines, say, shortly: "lines 1-3, 7"."""
    groups = itertools.groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0])
    runs = [[number for _, number in group] for _, group in groups]
    text = ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
    return f"{name}{'s' if len(numbers) > 1 else ''} {text}"
