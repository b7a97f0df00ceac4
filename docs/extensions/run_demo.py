"""Run a demo, or the Python of a page, cell by cell, and keep what each one prints and draws.

    python3 run_demo.py FILE [SIZE]

works in the current folder and writes `cells.json` there when the demo has passed its own checks:
for each cell of code what it printed, log included, and the pictures that it made.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

from cells import cells_of


def pictures() -> dict[Path, float]:
    """Return the pictures there are, and when they were written."""
    return {path: path.stat().st_mtime for path in sorted(Path("results").glob("*.png"))}


def main(script: str, arguments: list[str]) -> None:
    """Run a script in the same way as `python3 script arguments` does."""
    sys.argv = [script, *arguments]
    names: dict[str, Any] = {"__name__": "__main__", "__file__": script}
    terminal = sys.stderr
    printed = sys.stdout = sys.stderr = io.StringIO()  # no terminal: progress bars are silent
    records = []
    try:
        for cell in cells_of(Path(script)):
            if cell.prose:
                continue
            before = pictures()
            code = "\n" * (cell.line - 1) + cell.text  # tracebacks name the lines of the script
            exec(compile(code, script, "exec"), names)
            drawn = [path.name for path, time in pictures().items() if before.get(path) != time]
            records.append({"printed": printed.getvalue(), "pictures": drawn})
            printed.seek(0)
            printed.truncate()
    except BaseException:
        terminal.write(printed.getvalue())
        sys.stderr = terminal
        raise
    Path("cells.json").write_text(json.dumps(records))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
