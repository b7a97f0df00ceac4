"""The tables of benchmarks/README.md, made of what benchmarks/data keeps.

    tools/fenicsx python3 benchmarks/readme.py

writes what stands between `<!-- table: NAME -->` and `<!-- end -->` anew; nothing is measured. NAME
is a table of the benchmark that has a file in `benchmarks/data`.
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
    """Yield all tables and the rows of which each is made."""
    for path in sorted(DATA.glob("*.json")):
        benchmark: Benchmark = importlib.import_module(path.stem).BENCHMARK
        rows = read(path)
        for table in benchmark.tables:
            yield table, rows


def filled(page: str) -> str:
    """Return a page with all its tables.

    Raises:
        KeyError: it names a table that there is not.
    """
    known = {table.name: table.markdown(rows) for table, rows in tables()}

    def put(found: re.Match[str]) -> str:
        indent, name = found.groups()
        lines = [f"<!-- table: {name} -->", *known[name].splitlines(), "<!-- end -->"]
        return "\n".join((indent + line).rstrip() for line in lines)

    return MARKED.sub(put, page)


if __name__ == "__main__":
    README.write_text(filled(README.read_text()))
