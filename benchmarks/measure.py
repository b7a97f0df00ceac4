"""Run the commands of benchmarks/README.md that store measurements, in the order of the page.

    make measure
    python3 benchmarks/measure.py peers published

The second line runs the commands of two scripts only. Commands that name no number of threads get
one thread. Minutes and exit codes are logged in `results/measure.log`; a command that fails does
not stop the other commands. Afterwards `make tables` writes the tables of the page. This script
needs no DOLFINx, since each command calls `tools/fenicsx`.
"""

from __future__ import annotations

import argparse
import datetime
import os
import re
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOG = ROOT / "results" / "measure.log"


def commands(page: str) -> list[tuple[str, str]]:
    """Return the commands of a page that write JSON, each after the name of its script."""
    lines = re.findall(
        r"^ {4,}(.*tools/fenicsx python3 benchmarks/(\w+)\.py.*)$",
        page.replace("\\\n", " "),
        re.MULTILINE,
    )
    return [(name, " ".join(line.split())) for line, name in lines if "--json" in line]


def main() -> None:
    """Run the commands of the named scripts, of all scripts by default."""
    found = commands((ROOT / "benchmarks" / "README.md").read_text())
    parser = argparse.ArgumentParser(description="Measure anew what benchmarks/README.md shows.")
    parser.add_argument(
        "scripts",
        nargs="*",
        metavar="SCRIPT",
        help="measure with these scripts only: " + ", ".join(sorted({name for name, _ in found})),
    )
    chosen = parser.parse_args().scripts
    if unknown := set(chosen) - {name for name, _ in found}:
        parser.error(f"the page has no command of {', '.join(sorted(unknown))} that stores figures")
    LOG.parent.mkdir(exist_ok=True)
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    for name, command in found:
        if chosen and name not in chosen:
            continue
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
