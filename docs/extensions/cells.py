"""The cells of a demo: a script in percent format, as Jupyter, VS Code and Spyder know it."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

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
