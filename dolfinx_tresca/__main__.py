"""Solve the example, or print the versions that a bug report needs.

python -m dolfinx_tresca            solve two bricks; print a table, write files to results/
python -m dolfinx_tresca --check    print the versions of all software that a solve uses
"""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path

from mpi4py import MPI

from dolfinx_tresca.errors import ContactError
from dolfinx_tresca.output.report import environment


def main() -> None:
    """Parse the command line; solve the example, or print all versions. Collective."""
    parser = argparse.ArgumentParser(
        prog="python -m dolfinx_tresca",
        description="Solve two bricks in contact with friction, and write results to results/.",
    )
    parser.add_argument("--check", action="store_true", help="print versions, for bug reports")
    is_root = MPI.COMM_WORLD.rank == 0
    if parser.parse_args().check:
        if is_root:
            print(environment())
        return
    try:
        runpy.run_module("dolfinx_tresca.example")
    except ContactError as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from error
    if is_root:
        print(
            "\nresults/two_bricks.pvd opens in ParaView, results/two_bricks.png is a picture.\n"
            f"The script, to copy and to change: {Path(__file__).with_name('example.py')}\n"
            "Next to read: python -m pydoc dolfinx_tresca.ContactProblem, and .ContactPair;\n"
            "in the source archive docs/start/first_script.md, and demos/ with other scenes."
        )


main()
