"""What of a file is prose and what is code.

Demos are scripts in percent format, as Jupyter, VS Code and Spyder know it; pages have blocks.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from pathlib import Path

MARK = "# %%"
PROSE = "# %% [markdown]"


@dataclass(frozen=True)
class Cell:
    """A part of a script.

    Attributes:
        prose: whether it is Markdown, or else code.
        text: Markdown without comment signs, or code.
        line: of the script where the text begins, from 1.
    """

    prose: bool
    text: str
    line: int


def cells_of(file: Path) -> list[Cell]:
    """Return the cells of a demo, or the blocks of Python of a page."""
    text = file.read_text()
    return blocks(text, "python") if file.suffix == ".md" else cells(text)


def blocks(page: str, language: str) -> list[Cell]:
    """Return what stands in a page between ```language and ```, also where it is indented."""
    found = re.finditer(rf"^( *)```{language}\n(.*?)^\1```$", page, re.DOTALL | re.MULTILINE)
    return [
        Cell(False, textwrap.dedent(block[2]).strip("\n"), page.count("\n", 0, block.start(2)) + 1)
        for block in found
    ]


def cells(script: str) -> list[Cell]:
    """Return the cells of a script that begins with one."""
    found: list[Cell] = []
    lines = script.splitlines()
    starts = [i for i, line in enumerate(lines) if line.startswith(MARK)]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        prose = lines[start].startswith(PROSE)
        part = lines[start + 1 : end]
        if prose:
            part = [line.removeprefix("#").removeprefix(" ") for line in part]
        text = textwrap.dedent("\n".join(part)) if prose else "\n".join(part)
        found.append(Cell(prose, text.strip("\n"), start + 2))
    return found
