"""Lines that fit a terminal: of logs and of tables."""

from __future__ import annotations

import textwrap

#: Characters of a line, at most, but for words that are longer.
LINE_WIDTH = 100

#: A blank at which no line is broken, as between the components of a vector.
UNBROKEN = "\N{NO-BREAK SPACE}"


def fill(text: str, first: str = "", further: str = "  ") -> str:
    """Return a text broken into lines, the first one and the further ones behind a beginning."""
    lines = textwrap.fill(
        text,
        LINE_WIDTH,
        initial_indent=first,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines.replace(UNBROKEN, " ")
