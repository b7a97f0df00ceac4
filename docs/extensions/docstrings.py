r"""Docstrings of the package are prose with `names`: what reStructuredText would take for its own.

That is |u|_K, which would be a substitution, and lambda* or u_, which would be emphasis or a link.
"""

from __future__ import annotations

import re
from typing import Any

#: `names`, which stay as they are, or a character to escape.
_SPECIAL = re.compile(r"(`[^`]*`)|([|*]|_(?!\w))")


def escaped(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with special characters outside of examples escaped."""
    result, example = [], False
    for line in lines:
        example = line.lstrip().startswith(">>>") or (example and bool(line.strip()))
        if not example and not line.lstrip().startswith("* "):
            line = _SPECIAL.sub(lambda found: found[1] or "\\" + found[2], line)
        result.append(line)
    return result


def process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape a docstring in place."""
    lines[:] = escaped(lines)


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx, before Napoleon, which adds characters that are meant."""
    app.connect("autodoc-process-docstring", process, priority=100)
    return {"parallel_read_safe": True}
