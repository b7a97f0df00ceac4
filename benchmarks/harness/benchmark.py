"""The description of a benchmark, and its command line."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mpi4py import MPI

from harness import process, table
from harness.process import Measure
from harness.record import Record, Row, commit, is_known, read, this_run
from harness.table import Column, Table

#: Status that is not printed, since it is the usual one: ContactStatus.CONVERGED.name.
WELL = "CONVERGED"


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Cases, the function that measures a case, and the columns and tables for its rows.

    Attributes:
        script: path of the benchmark's file; its rows are stored in `benchmarks/data`, in a file of
            the same name.
        about: docstring of the script.
        key: fields that identify a row; a row gets the values of these fields from its case.
        cases: function from the command line to the cases, in the order in which they are run. A
            case can be written as JSON. Its entry `ranks` is the number of MPI ranks (1 without
            it); its other entries are for `measure`.
        measure: function that yields figures of a case. Collective.
        shown: columns on the terminal.
        options: function that adds the options that `cases` uses.
        tables: tables in README.md.
        small: entries that replace those of the case in a first, small run, which loads code and
            compiles forms before the case is measured; empty: no first run.
        prepare: function from a case and the rows of earlier cases to the case with further
            entries; a case with an entry `status` is not run.
        summary: function from the rows to a text below the rows on the terminal.
        draw: function that saves a picture of the rows.
    """

    script: str
    about: str
    key: Sequence[str]
    cases: Callable[[argparse.Namespace], Iterable[Row]]
    measure: Measure
    shown: Sequence[Column]
    options: Callable[[argparse.ArgumentParser], None] = lambda parser: None
    tables: Sequence[Table] = ()
    small: Row = field(default_factory=dict)
    prepare: Callable[[Row, list[Row]], Row] = lambda case, rows: case
    summary: Callable[[list[Row]], str] | None = None
    draw: Callable[[Path, list[Row]], None] | None = None

    def main(self) -> None:
        """Read the command line; then measure, print and store rows, or draw stored rows."""
        arguments = self.parser().parse_args()
        if arguments.work:
            process.work(self.measure, self.small, json.loads(arguments.work))
        elif arguments.kept:
            self._save_picture(arguments, read(arguments.kept))
        else:
            self._measure(arguments)

    def parser(self) -> argparse.ArgumentParser:
        """Return the parser of the command line."""
        parser = argparse.ArgumentParser(description=self.about.splitlines()[0])
        self.options(parser)
        parser.add_argument("--limit", type=float, default=0.0, help="seconds for a case (any)")
        parser.add_argument(
            "--json", type=Path, metavar="FILE", help="keep the rows there, beside others"
        )
        parser.add_argument(
            "--changed", action="store_true", help="keep rows of code that is not committed, too"
        )
        parser.add_argument(
            "--here", action="store_true", help="in this process: for profilers and debuggers"
        )
        parser.add_argument("--picture", type=Path, metavar="FILE")
        parser.add_argument(
            "--from", dest="kept", type=Path, metavar="FILE", help="draw the picture of that"
        )
        parser.add_argument("--work", metavar="TASK", help=argparse.SUPPRESS)
        return parser

    def _measure(self, arguments: argparse.Namespace) -> None:
        """Run all cases; with `--here` on the MPI ranks that run already. The first rank prints."""
        if arguments.json and not arguments.changed and not is_known(commit()):
            raise SystemExit(
                "nobody could measure this again: the code is not committed. Commit it, or keep "
                "the rows with a + behind their commit: --changed."
            )
        first = MPI.COMM_WORLD.rank == 0
        record = Record(arguments.json if first else None, self.key)
        if first:
            record.write()  # if the file cannot be written, fail before the work
            print("        done     " + table.heads(self.shown), flush=True)
        run, start = this_run(), time.perf_counter()
        mine: list[Row] = []
        cases = list(self.cases(arguments))
        if arguments.here:
            cases = [{**case, "ranks": MPI.COMM_WORLD.size} for case in cases]
        for number, case in enumerate(cases, 1):
            named = {name: case[name] for name in self.key if name in case}
            for found in self._rows_of(case, mine, arguments):
                row = record.add({**named, **found}, run)
                mine = [r for r in record.rows if r["run"] is run]
                record.write()
                if first:
                    progress = f"{number}/{len(cases)}".rjust(7)
                    seconds = f"{time.perf_counter() - start:7.0f} s  "
                    print(progress + seconds + self._text(row), flush=True)
        if not first:
            return
        for one in self.tables:
            if one.lines(mine):
                print(f"\n{one.name}:\n\n{one.markdown(mine)}")
        if self.summary:
            print("\n" + self.summary(mine))
        if arguments.picture:
            self._save_picture(arguments, mine)

    def _rows_of(self, case: Row, rows: list[Row], arguments: argparse.Namespace) -> Iterator[Row]:
        """Yield the rows of a case."""
        case = self.prepare(case, rows)
        if "status" in case:
            yield {"status": case["status"]}
        elif arguments.here:
            yield from self.measure(MPI.COMM_WORLD, case)
        else:
            yield from process.in_new(self.script, case, arguments.limit)

    def _text(self, row: Row) -> str:
        """Return a row for the terminal, with its status unless the status is `WELL`."""
        status = row.get("status", WELL)
        said = status == WELL or any(column.text == "{status}" for column in self.shown)
        return table.printed(self.shown, row) + ("" if said else f"  {status}")

    def _save_picture(self, arguments: argparse.Namespace, rows: list[Row]) -> None:
        if self.draw is None or arguments.picture is None:
            raise SystemExit("--from needs --picture: where to draw; and not all benchmarks can")
        self.draw(arguments.picture, rows)


def add_ranks(parser: argparse.ArgumentParser) -> None:
    """Add an option for numbers of MPI ranks."""
    parser.add_argument("--ranks", type=int, nargs="+", default=[1], help="more than cores, too")
