"""Demos as pages: each is run, and its page shows what it prints and draws.

Pages that are listed here are run as well; ```{printed} 2``` is what their second block printed.

What a run left is kept in `results/docs` under a name that is a hash of all that it depends on: the
demo, its size, the package, and DOLFINx. So a build runs only what has changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import dolfinx

import dolfinx_tresca

from .cells import cells

logger = logging.getLogger(__name__)

CHECKOUT = Path(__file__).parents[2]
DEMOS = CHECKOUT / "demos"
PAGES = [CHECKOUT / "docs" / "start" / "first_script.md"]
KEPT = CHECKOUT / "results" / "docs" / "demos"

#: Sizes of a quick build. With DOCS_SIZES=full demos have those of their prose.
QUICK = {
    "two_bricks": 16,
    "hertz": 6,
    "rigid_obstacle": 16,
    "press_fit": 10,
    "implant": 12,
    "fretting": 6,
    "adaptive": 20,
    "floating_block": 8,
    "hyperelastic_seal": 12,
    "impact": 40,
    "indentation": 8,
    "calibration": 8,
    "ironing": 40,
    "roller_profile": 3,
    "shrink_fit_thermal": 16,
}


def arguments(name: str) -> list[str]:
    """Return the arguments of a demo."""
    if os.environ.get("DOCS_SIZES") == "full":
        return []
    return [str(QUICK[name])] if name in QUICK else []


def key(demo: Path) -> str:
    """Return a hash of all that decides what a demo prints and draws."""
    package = Path(dolfinx_tresca.__file__).parent
    here = Path(__file__).parent
    files = [demo, here / "run_demo.py", here / "cells.py"]
    files += [*sorted(package.rglob("*.py")), *sorted(package.rglob("*.geo"))]
    digest = hashlib.sha256(repr((arguments(name_of(demo)), dolfinx.__version__)).encode())
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def name_of(demo: Path) -> str:
    """Return what is between `demo_` and `.py`."""
    return demo.stem.removeprefix("demo_")


def run(demo: Path) -> Path:
    """Run a demo, unless a run of the same is kept; return the folder of what it left.

    Raises:
        RuntimeError: it failed.
    """
    folder = KEPT / f"{name_of(demo)}-{key(demo)}"
    if (folder / "cells.json").exists():
        return folder
    for old in KEPT.glob(f"{name_of(demo)}-*"):
        shutil.rmtree(old)
    folder.mkdir(parents=True)
    logger.info("running %s", demo.name)
    runner = Path(__file__).with_name("run_demo.py")
    done = subprocess.run(
        [sys.executable, runner, demo, *arguments(name_of(demo))],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{demo.name} failed:\n{done.stdout}{done.stderr}")
    return folder


def page(demo: Path, records: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the parts of a demo's page, in Markdown.

    Args:
        demo: the script.
        records: what each of its cells of code printed and drew.
    """
    left = iter(records)
    parts = cells(demo.read_text())
    size = arguments(name_of(demo))
    note = f"run with the size {size[0]}" if size else "run with its own size"
    for number, cell in enumerate(parts):
        if not cell.prose:
            record = next(left)
            yield f"```python\n{cell.text}\n```"
            if printed := record["printed"].strip("\n"):
                yield f"```{{code-block}} text\n:class: printed\n\n{printed}\n```"
            for picture in record["pictures"]:
                yield f"![{name_of(demo)}: what this part draws]({picture})"
            continue
        yield cell.text
        if number == 0:
            yield (
                f"Download {{download}}`{demo.name} <../../demos/{demo.name}>`, or copy "
                "[the plain program](#the-plain-program). Below is what it printed and drew when "
                f"this page was built: {note}, DOLFINx {dolfinx.__version__}, one thread."
            )
    code = [cell.text for cell in parts if not cell.prose]
    yield "## The plain program"
    yield "```python\n" + "\n\n".join(code) + "\n```"


def records_of(folder: Path) -> list[dict[str, Any]]:
    """Return what each cell of a run printed and drew."""
    records: list[dict[str, Any]] = json.loads((folder / "cells.json").read_text())
    return records


def generate(app: Any) -> None:
    """Run all, and write the pages of the tutorials."""
    demos = sorted(DEMOS.glob("demo_*.py"))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        folders = list(pool.map(run, [*demos, *PAGES]))
    for file, folder in zip([*demos, *PAGES], folders, strict=True):
        records = records_of(folder)
        place = file.parent if file in PAGES else Path(app.srcdir) / "tutorials"
        for picture in sorted({name for record in records for name in record["pictures"]}):
            shutil.copy2(folder / "results" / picture, place / picture)
        if file in PAGES:
            continue
        text = "\n\n".join(page(file, records)) + "\n"
        target = place / f"{file.stem}.md"
        if not target.exists() or target.read_text() != text:  # or Sphinx would read it again
            target.write_text(text)


class Printed(SphinxDirective):
    """What a block of the page printed."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return it as a block."""
        source = Path(self.env.doc2path(self.env.docname))
        printed = records_of(run(source))[int(self.arguments[0]) - 1]["printed"].strip("\n")
        return [nodes.literal_block(printed, printed, language="text", classes=["printed"])]


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", generate)
    app.add_directive("printed", Printed)
    return {"parallel_read_safe": True}
