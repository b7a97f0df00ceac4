"""Line breaks in log messages and tables."""

from __future__ import annotations

import textwrap

#: Greatest number of characters in a line; longer words are not broken.
LINE_WIDTH = 100

#: A space at which lines are not broken, such as a space between the components of a vector.
UNBROKEN = "\N{NO-BREAK SPACE}"


def fill(text: str, start: str = "", further: str = "  ") -> str:
    """Break a text into lines; `start` precedes the first line, and `further` each further line."""
    lines = textwrap.fill(
        text,
        LINE_WIDTH,
        initial_indent=start,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines.replace(UNBROKEN, " ")
