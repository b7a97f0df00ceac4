"""Tables of rows: lines on the terminal during measurements, and Markdown for README.md."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from harness.record import Row

#: Text of a cell: a template such as "{iterations}/{products}", filled from the last row of the
#: cell, or a function from all rows of the cell to the text.
Text: TypeAlias = str | Callable[[list[Row]], str]

#: Text of cells for which nothing was measured.
DASH = "\N{EN DASH}"


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        head: head of the column.
        text: text of a cell.
        where: fields with their values: a cell shows those rows of its line that have these values.
        missing: text of a cell without rows or figures.
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
        """Return the text of the column's cell in a line of rows."""
        rows = self.rows(line)
        if not rows:
            return self.missing
        try:
            return self.text(rows) if callable(self.text) else self.text.format(**rows[-1])
        except (KeyError, TypeError):  # no such figure, or None
            return self.missing


def krylov_iterations(rows: Sequence[Row]) -> str:
    """Return the Krylov iterations of a cell's last row; a dash for a direct solver."""
    return str(rows[-1].get("krylov_iterations") or DASH)


def heads(columns: Sequence[Column]) -> str:
    """Return the heads of columns as a line for a terminal."""
    return "  ".join(column.head.rjust(column.width) for column in columns)


def printed(columns: Sequence[Column], row: Row) -> str:
    """Return a row as a line for a terminal, aligned with `heads`."""
    return "  ".join(
        column.cell([row]).rjust(max(column.width, len(column.head))) for column in columns
    ).rstrip()


@dataclass(frozen=True)
class Table:
    """A table in README.md, made from rows of a benchmark.

    Attributes:
        name: name of the table in README.md.
        columns: columns from left to right.
        chosen: function that says whether the table uses a row.
        line: rows with equal values of these fields share a line; empty: each row has its own line.
        derived: function from the chosen rows to the rows of the table, each with the `run` of a
            row from which it was made.
    """

    name: str
    columns: Sequence[Column]
    chosen: Callable[[Row], bool] = lambda row: True
    line: Sequence[str] = ()
    derived: Callable[[list[Row]], list[Row]] = lambda rows: rows

    def lines(self, rows: Sequence[Row]) -> list[list[Row]]:
        """Return the rows of each line; lines have the order of their first rows."""
        result: dict[Any, list[Row]] = {}
        for number, row in enumerate(self.derived([row for row in rows if self.chosen(row)])):
            key = tuple(row.get(name) for name in self.line) if self.line else number
            result.setdefault(key, []).append(row)
        return list(result.values())

    def markdown(self, rows: Sequence[Row]) -> str:
        """Return the table as Markdown, and below it the code that measured each line."""
        lines = self.lines(rows)
        texts = [
            [column.head for column in self.columns],
            ["---"] * len(self.columns),
            *([column.cell(line) for column in self.columns] for line in lines),
        ]
        table = ["| " + " | ".join(text) + " |" for text in texts]
        table[1] = "|" + "---|" * len(self.columns)
        return "\n".join([*table, "", self._sources(lines)] if lines else table)

    def _sources(self, lines: list[list[Row]]) -> str:
        """Return a text that says which run measured which lines and columns."""
        # columns without `where` are left out: they show values that are equal in all rows of a
        # line
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
    """Return the code, date, machine and versions of a run as text."""
    return (
        f"`{run['commit']}` of {run['date']} ({run['cpu']}, {run['cores']} cores, "
        f"threads: {run['threads']}, DOLFINx {run['dolfinx']}, PETSc {run['petsc']})"
    )


def spans(name: str, numbers: Sequence[int]) -> str:
    """Return ascending numbers as a short text, such as "lines 1-3, 7"."""
    groups = itertools.groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0])
    runs = [[number for _, number in group] for _, group in groups]
    text = ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
    return f"{name}{'s' if len(numbers) > 1 else ''} {text}"
