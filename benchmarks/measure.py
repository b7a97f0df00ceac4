"""Run all commands of benchmarks/README.md that store measurements, in the order of the page.

    make measure

Commands that name no number of threads get one thread. Minutes and exit codes are logged in
`results/measure.log`; a command that fails does not stop the other commands. Afterwards
`make tables` writes the tables of the page. This script needs no DOLFINx, since each command calls
`tools/fenicsx`.
"""

from __future__ import annotations

import datetime
import os
import re
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOG = ROOT / "results" / "measure.log"


def commands(page: str) -> list[str]:
    """Return the commands of a page that write JSON."""
    lines = re.findall(
        r"^ {4,}(.*tools/fenicsx python3 benchmarks/\w+\.py.*)$",
        page.replace("\\\n", " "),
        re.MULTILINE,
    )
    return [" ".join(line.split()) for line in lines if "--json" in line]


def main() -> None:
    """Run the commands."""
    LOG.parent.mkdir(exist_ok=True)
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    for command in commands((ROOT / "benchmarks" / "README.md").read_text()):
        start = time.perf_counter()
        code = subprocess.run(command, shell=True, cwd=ROOT, env=environment).returncode
        minutes = (time.perf_counter() - start) / 60
        now = datetime.datetime.now().isoformat(timespec="minutes")
        line = f"{now} {minutes:7.1f} minutes, exit code {code}: {command}"
        print(line, flush=True)
        with LOG.open("a") as log:
            print(line, file=log)


if __name__ == "__main__":
    main()
