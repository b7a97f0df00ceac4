"""The number of random changes of the code that make quick tests fail.

    tools/fenicsx python3 benchmarks/mutation.py --here --reach .coverage

For each row one operator or number in `solvers/`, `dual/` or `pairing/` is changed in a copy of
the last commit, and tests run in this copy until a test fails: first the tests of the same folder,
then of the other two folders, then all other tests. Constants that `ablation.py` doubles and
halves, types, and texts of errors are not changed. Only tests that execute the changed line need to
run. With pytest-cov and `core = ctrace` the command

    tools/fenicsx python3 -m pytest tests --sample=first --cov --cov-context=test --cov-report=

writes the lines that each test executes to `.coverage`. Without `--reach` all tests run, which
takes several minutes for each change.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from ablation import CONSTANTS
from harness import Benchmark, Column, Comm, Row

ROOT = Path(__file__).parents[1]
FOLDERS = ("solvers", "dual", "pairing")
TUNED = set(" ".join(CONSTANTS.values()).split())
#: Limit for the tests of a change [processor seconds]. A change with which they take longer counts
#: as noticed.
SECONDS = 1800

#: Operator -> operators that may replace it; likewise for functions.
OPERATORS = {
    "Add": "Sub", "Sub": "Add", "Mult": "Div", "Div": "Mult", "FloorDiv": "Mult", "Pow": "Mult",
    "BitAnd": "BitOr", "BitOr": "BitAnd", "And": "Or", "Or": "And", "Lt": "LtE GtE",
    "LtE": "Lt Gt", "Gt": "GtE LtE", "GtE": "Gt Lt", "Eq": "NotEq", "NotEq": "Eq", "Is": "IsNot",
    "IsNot": "Is", "In": "NotIn", "NotIn": "In",
}  # fmt: skip
FUNCTIONS = {"min": "max", "minimum": "maximum", "argmin": "argmax", "any": "all"}
FUNCTIONS |= {value: key for key, value in FUNCTIONS.items()}


def replacements(node: ast.AST) -> Iterator[str]:
    """Yield source texts that may replace a node of the syntax tree."""
    match node:
        case ast.Constant(value=bool(value)):
            yield repr(not value)
        case ast.Constant(value=int(value)):
            yield repr(value + 1)
        case ast.Constant(value=float(value)):
            yield from map(repr, (2.0 * value or 1.0, 0.5 * value or -1.0))
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield ast.unparse(operand)
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign() | ast.Compare(ops=[_]):
            kept = dict(ast.iter_fields(node))
            old = kept["ops"][0] if "ops" in kept else kept["op"]
            for name in OPERATORS.get(type(old).__name__, "").split():
                new = getattr(ast, name)()
                kept.update({"ops": [new]} if "ops" in kept else {"op": new})
                yield ast.unparse(type(node)(**kept))
        case ast.Name(id=name) | ast.Attribute(attr=name) if name in FUNCTIONS:
            yield re.sub(r"\w+$", FUNCTIONS[name], ast.unparse(node))


def parts(node: ast.AST, statement: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Yield the parts of a node that may be changed, each with the statement that contains it."""
    tuned = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in TUNED
    check = isinstance(node, ast.keyword) and node.arg == "strict"
    if tuned or check or isinstance(node, ast.Raise | ast.JoinedStr | ast.ImportFrom):
        return
    statement = node if isinstance(node, ast.stmt) else statement
    yield node, statement
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in ("annotation", "returns"):
                yield from parts(child, statement)


def places() -> Iterator[Row]:
    """Yield all places in the code that may be changed, each with its possible replacements."""
    for folder in FOLDERS:
        for path in sorted(ROOT.glob(f"dolfinx_tresca/{folder}/**/*.py")):
            tree = ast.parse(path.read_text())
            for node, statement in parts(tree, tree):
                body = getattr(statement, "body", None)
                if news := list(replacements(node)):
                    yield {
                        "path": str(path.relative_to(ROOT)),
                        "from": [node.lineno, node.col_offset],
                        "to": [node.end_lineno, node.end_col_offset],
                        "last": body[0].lineno - 1 if body else statement.end_lineno,
                        "old": ast.unparse(node),
                        "news": news if node is statement else [f"({new})" for new in news],
                    }


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield random changes."""
    draw = random.Random(arguments.seed)
    asked = {name: getattr(arguments, name) for name in ("seed", "tests", "reach")}
    for number, place in enumerate(draw.sample(list(places()), arguments.number)):
        new = draw.choice(place.pop("news"))
        if arguments.only is None or number in arguments.only:
            yield {"number": number, "new": new, **place, **asked}


def tests(case: Row) -> list[str]:
    """Return the arguments of pytest for the tests of a case, in the order of running."""
    own = case["path"].split("/")[1]
    folders = [f"tests/{name}" for name in sorted(FOLDERS, key=lambda name: name != own)]
    if case["tests"] or not case["reach"]:
        return case["tests"] or [*folders, "tests", "--sample=first"]
    from coverage import CoverageData

    data = CoverageData(case["reach"])
    data.read()
    (file,) = (file for file in data.measured_files() if file.endswith("/" + case["path"]))
    by_line = data.contexts_by_lineno(file)
    lines = range(case["from"][0], case["last"] + 1)
    if any("" in by_line.get(line, ()) for line in lines):  # the line runs at import
        lines = range(max(by_line) + 1)
    names = {test.partition("|")[0] for line in lines for test in by_line.get(line, ())} - {""}
    return sorted(names, key=lambda name: [not name.startswith(f"{one}/") for one in folders])


@cache
def copy() -> tempfile.TemporaryDirectory[str]:
    """Return a folder with a clone of the last commit, in which hypothesis shrinks no failures."""
    folder = tempfile.TemporaryDirectory()
    subprocess.run(["git", "clone", "-q", str(ROOT), folder.name], check=True)
    settings = Path(folder.name, "tests", "conftest.py")
    quick = "phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate], database=None"
    settings.write_text(settings.read_text().replace("database=None", quick))
    return folder


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Run the tests on one change."""
    root, names = Path(copy().name), tests(case)
    file, (first, start), (last, end) = root / case["path"], case["from"], case["to"]
    source = file.read_bytes()
    lines = source.splitlines(keepends=True)
    new = lines[first - 1][:start] + case["new"].encode() + lines[last - 1][end:]
    file.write_bytes(b"".join([*lines[: first - 1], new, *lines[last:]]))
    (root / "tests.txt").write_text("\n".join(names))
    row = {"where": f"{case['path']}:{first}", "change": f"{case['old']} -> {case['new']}"}
    noticed = ""
    if names:
        ended = subprocess.run(
            [sys.executable, "-m", "pytest", "-x", "-p", "no:xdist", "--tb=no", "@tests.txt"],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS)),
            capture_output=True,
            text=True,
        )
        failed = re.search(r"^(?:FAILED|ERROR) ([^\s:]+(?:::\w+)?)", ended.stdout, re.MULTILINE)
        status = f"status {ended.returncode}" if ended.returncode else ""
        noticed = failed[1] if failed else status
    file.write_bytes(source)
    yield {**row, "tests": len(names), "noticed": noticed}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--number", type=int, default=100, help="of changes")
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER", help="changes")
    parser.add_argument("--tests", nargs="+", metavar="TEST", help="others than these do not run")
    parser.add_argument("--reach", metavar="FILE", help="which tests reach which lines")


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("number", "seed"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        Column("", "{number}", width=3),
        Column("where", "{where}", width=50),
        Column("tests", "{tests}", width=5),
        Column("noticed by", "{noticed}", width=60),
        Column("change", "{change}"),
    ],
    summary=lambda rows: f"{sum(bool(row['noticed']) for row in rows)} of {len(rows)} are noticed",
)

if __name__ == "__main__":
    BENCHMARK.main()
