"""The tables of benchmarks/README.md, made from the stored rows in benchmarks/data.

    tools/fenicsx python3 benchmarks/readme.py

This command replaces the text between `<!-- table: NAME -->` and `<!-- end -->`; nothing is
measured. NAME is the name of a table of a benchmark that has a file in `benchmarks/data`.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

from harness import Benchmark, Row, Table
from harness.record import read

README = Path(__file__).with_name("README.md")
DATA = Path(__file__).with_name("data")

MARKED = re.compile(r"( *)<!-- table: (\S+) -->\n.*?<!-- end -->", re.DOTALL)


def tables() -> Iterator[tuple[Table, list[Row]]]:
    """Yield each table with the rows from which it is made."""
    for path in sorted(DATA.glob("*.json")):
        benchmark: Benchmark = importlib.import_module(path.stem).BENCHMARK
        rows = read(path)
        for table in benchmark.tables:
            yield table, rows


def filled(page: str) -> str:
    """Return the text of a page with new contents of all its tables.

    Raises:
        KeyError: the page names a table that does not exist.
    """
    known = {table.name: table.markdown(rows) for table, rows in tables()}

    def put(found: re.Match[str]) -> str:
        indent, name = found.groups()
        lines = [f"<!-- table: {name} -->", *known[name].splitlines(), "<!-- end -->"]
        return "\n".join((indent + line).rstrip() for line in lines)

    return MARKED.sub(put, page)


if __name__ == "__main__":
    README.write_text(filled(README.read_text()))
