"""Kept measurements on pages: tables that `make tables` writes, parts of them, and single figures.

    ```{measured} cost
    :rows: 105456
    :columns: scene; back end; ratio
    ```

is a table of benchmarks/README.md: the lines in which all these texts, divided by semicolons, are
cells or parts of cells; and the columns with these heads. {measured}`cost; 105456; ratio` is
the cell of the first such line. So no figure on a page is typed by hand.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective, SphinxRole

README = Path(__file__).parents[2] / "benchmarks" / "README.md"

_MARKED = re.compile(r"<!-- table: (\S+) -->\n(.*?)<!-- end -->", re.DOTALL)


@functools.cache
def tables() -> dict[str, tuple[list[str], list[list[str]], str]]:
    """Return heads, rows and the line about the code of each table."""
    found = {}
    for name, text in _MARKED.findall(README.read_text()):
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines[:-1]]
        found[name] = rows[0], rows[2:], lines[-1]
    return found


def split(text: str) -> list[str]:
    """Return the parts between semicolons."""
    return [part.strip() for part in text.split(";") if part.strip()]


def chosen(name: str, wanted: list[str]) -> list[list[str]]:
    """Return the rows of a table with all wanted texts.

    Raises:
        ValueError: there is no such table, or no such row.
    """
    if name not in tables():
        raise ValueError(f"no table {name!r} in benchmarks/README.md")
    rows = [row for row in tables()[name][1] if all(any(w in cell for cell in row) for w in wanted)]
    if not rows:
        raise ValueError(f"no row of table {name!r} has {wanted}")
    return rows


class Measured(SphinxDirective):
    """A table, or a part of one."""

    required_arguments = 1
    option_spec = {"rows": directives.unchanged, "columns": directives.unchanged}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        """Return the table, and which code was measured where it is whole."""
        name = self.arguments[0]
        try:
            rows = chosen(name, split(self.options.get("rows", "")))
            heads, _, code = tables()[name]
            wanted = split(self.options.get("columns", "")) or heads
            numbers = [heads.index(head) for head in wanted]
        except ValueError as error:
            raise self.error(f"measured: {error}") from error
        lines = [wanted, ["---"] * len(wanted), *([row[i] for i in numbers] for row in rows)]
        text = ["| " + " | ".join(line) + " |" for line in lines]
        where = f"Measured: table `{name}` of [all measurements](/benchmarks.md)."
        text += ["", "{.measured-by}", code if len(rows) == len(tables()[name][1]) else where]
        self.env.note_dependency(str(README))
        return self.parse_text_to_nodes("\n".join(text))


class MeasuredCell(SphinxRole):
    """A single figure."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the text of a cell."""
        name, *wanted, column = split(self.text)
        try:
            row = chosen(name, wanted)[0]
            text = row[tables()[name][0].index(column)].strip("*")
        except ValueError as error:
            message = self.inliner.reporter.error(f"measured: {error}", line=self.lineno)
            return [], [message]
        self.env.note_dependency(str(README))
        return [nodes.inline(text, text)], []


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("measured", Measured)
    app.add_role("measured", MeasuredCell())
    return {"parallel_read_safe": True}
