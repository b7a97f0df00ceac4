"""Tables of names and values: for `print`, and for notebooks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from typing import TypeAlias

from dolfinx_tresca._base.parallel import fill

#: A name, indented if it belongs to the row above, and its value.
Row: TypeAlias = tuple[str, str]

#: Largest number of rows of a list. Of a longer list the first rows are shown, and the number of
#: the remaining rows.
LISTED_ROWS = 8


class Tabulated(ABC):
    """An object that `print` and notebooks show as the same table."""

    @abstractmethod
    def _rows(self) -> list[Row]:
        """Return the rows of the table. Not collective."""

    def __str__(self) -> str:
        return as_text(self._rows())

    def _repr_html_(self) -> str:
        return as_html(self._rows())


def abridged(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return all rows of a list, or the first rows and a row like "and 5 other pairs" (`kind`)."""
    if len(rows) <= LISTED_ROWS:
        return list(rows)
    listed = list(rows[: LISTED_ROWS - 1])
    return [*listed, (listed[-1][0], f"and {len(rows) - len(listed)} other {kind}")]


def as_text(rows: Sequence[Row]) -> str:
    """Return a table as text: each row is a line, or several lines if its value is long."""
    return "\n".join(fill(value, f"{name:<14} ", 15 * " ") for name, value in rows)


def as_html(rows: Sequence[Sequence[str]]) -> str:
    """Return a table for notebooks, in the colours of the notebook's theme.

    Rows have a name and any number of values.
    """
    left = 'style="text-align: left"'  # Jupyter aligns texts in tables to the right
    lines = []
    for name, *values in rows:
        cells = "".join(f"<td {left}>{escape(value)}</td>" for value in values)
        lines.append(f"<tr><th {left}>{escape(name).replace(' ', '&nbsp;')}</th>{cells}</tr>")
    return "\n".join(["<table>", *lines, "</table>"])
