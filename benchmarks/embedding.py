"""Lines of code, and products per contact solve, of larger models with contact.

    tools/fenicsx python3 benchmarks/embedding.py --json benchmarks/data/embedding.json

Demos of this project, in the size that tests use, are compared with the most similar examples of
other packages (`PEERS`): asimov-contact at commit db958afe, and GetFEM at commit d05e3018. Lines of
code are counted in whole scripts, without blank lines, comments and docstrings. Checks against
analysis and pictures are included; only some examples of other packages have them. Mesh files are
not counted.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import re
import runpy
import sys
import tempfile
import time
import tokenize
from collections.abc import Iterator
from pathlib import Path
from statistics import mean
from typing import Any
from unittest import mock

from harness import DASH, Benchmark, Column, Comm, Row, Table

from dolfinx_tresca.contact.contact_system import ContactSystem

DEMOS = Path(__file__).parents[1] / "demos"

#: Model -> the demo and its size.
MODELS = {
    "O-ring seal": ("hyperelastic_seal", 8),
    "thermal shrink fit": ("shrink_fit_thermal", 8),
    "impact": ("impact", 20),
}

#: Model -> package -> lines of code of its most similar example, by `code_lines`, and its path.
PEERS: dict[str, dict[str, str]] = {
    "O-ring seal": {
        "asimov": "none",
        "getfem": "198: an elastic ring pressed on a block, `interface/tests/python/"
        "demo_elastic_ring_contact.py`",
    },
    "thermal shrink fit": {
        "asimov": "216: thermal strain, no heat through the contact, `python/demos/"
        "demo_thermo_mech_xmas2D.py`; 332: heat through tied surfaces, `python/demos/"
        "meshtie_demos/thermo_mech.py`",
        "getfem": "none with contact",
    },
    "impact": {
        "asimov": "none",
        "getfem": "373: a bar of one dimension, without friction, `interface/tests/python/"
        "demo_dynamic_contact_1D.py`",
    },
}

NOT_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_lines(text: str) -> int:
    """Return the number of lines of Python without blank lines, comments and docstrings."""
    said: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
            node
        ):
            said |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NOT_CODE:
            found |= set(range(token.start[0], token.end[0] + 1))
    return len(found - said)


def without_checks(text: str) -> str:
    """Return the text of a demo without the sections on its formula, checks and pictures."""
    parts = re.split(r"^# %% \[markdown\]\n", text, flags=re.MULTILINE)
    return "".join(
        part
        for part in parts
        if not part.startswith(("# ## The formula", "# ## Check", "# ## Draw"))
    )


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the models."""
    for model in arguments.models:
        yield {"model": model}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Run a demo, and yield its lines of code and the products of its solves. Collective."""
    name, size = MODELS[case["model"]]
    script = DEMOS / f"demo_{name}.py"
    products: list[int] = []
    solve = ContactSystem.solve

    def counted(self: ContactSystem, *arguments: Any, **named: Any) -> Any:
        found = solve(self, *arguments, **named)
        products.append(found.products)
        return found

    start = time.perf_counter()
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        mock.patch.object(sys, "argv", [str(script), str(size)]),
        mock.patch.object(ContactSystem, "solve", counted),
    ):
        runpy.run_path(str(script), run_name="__main__")
    yield {
        "lines": code_lines(script.read_text()),
        "model_lines": code_lines(without_checks(script.read_text())),
        "products": products,
        "seconds": time.perf_counter() - start,
        "status": "CONVERGED",  # otherwise the demo raises an error
    }


def solves(rows: list[Row]) -> str:
    """Return the number of solves, the products of the first, and the mean of the later ones."""
    products = rows[-1]["products"]
    return f"{len(products)}: {products[0]} / {mean(products[1:]):.1f}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the option of the cases."""
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=MODELS)


def peer(name: str, rows: list[Row]) -> str:
    """Return the lines and the path of the most similar example of another package."""
    return PEERS.get(rows[-1]["model"], {}).get(name, DASH)


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("model",),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        Column("model", "{model}", width=18),
        Column("lines", "{lines}"),
        Column("solves: products, first / later", solves, width=16),
        Column("s", "{seconds:.1f}"),
    ],
    tables=[
        Table(
            "embedding",
            [
                Column("model", "{model}"),
                Column("lines here", "{lines}"),
                Column("without formula, checks, pictures", "{model_lines}"),
                Column("asimov-contact", lambda rows: peer("asimov", rows)),
                Column("GetFEM", lambda rows: peer("getfem", rows)),
                Column("contact solves: products of the first / the later ones", solves),
                Column("seconds in all", "{seconds:.0f}"),
            ],
            line=["model"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
