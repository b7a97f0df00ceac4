"""Shallow ironing: a block with a round face, pressed on a soft foundation and pulled along it.

    tools/fenicsx python3 benchmarks/published_cases/ironing.py 60

K. A. Fischer and P. Wriggers, Comput. Methods Appl. Mech. Eng. 195, 2006. The script runs
`demos/demo_ironing.py`, which has the data and the figures of several groups. The argument is the
number of cells along the foundation, a multiple of 20; the number of load steps is proportional to
it.
"""

from __future__ import annotations

import contextlib
import io
import runpy
import sys
import tempfile
from pathlib import Path
from unittest import mock

from mpi4py import MPI

import numpy as np
from case import Case, Result, between, by_group

DEMO = Path(__file__).parents[2] / "demos" / "demo_ironing.py"

#: Forces [N]: the lowest and the highest value of several groups at t = 1, single values at t =
#: 1.5.
PUBLISHED = {
    "vertical force at t = 1 [N]": between(268.0, 332.0),
    "horizontal force at t = 1 [N]": between(55.0, 71.0),
    "vertical force at t = 1.5 [N]": by_group(
        {
            "Fischer and Wriggers": 365.0,
            "Hartmann et al.": 408.0,
            "Poulios and Renard": 338.0,
            "Code_Aster": 421.0,
        }
    ),
    "horizontal force at t = 1.5 [N]": by_group(
        {
            "Fischer and Wriggers": 189.0,
            "Hartmann et al.": 160.0,
            "Poulios and Renard": 102.0,
            "Code_Aster": 143.0,
        }
    ),
}


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the foundation. Collective."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        with mock.patch.object(sys, "argv", ["demo_ironing", str(int(n))]):
            with contextlib.redirect_stdout(io.StringIO()):
                found = runpy.run_path(str(DEMO))
    times, vertical, horizontal = (found[one] for one in ("times", "vertical", "horizontal"))
    end = int(np.argmin(np.abs(times - 1.0)))
    forces = (vertical[end], horizontal[end], vertical[-1], horizontal[-1])
    return Result(
        dict(zip(PUBLISHED, map(float, forces), strict=True)), found["V"], times, vertical
    )


CASE = Case(
    name="ironing",
    title="Shallow ironing",
    published=PUBLISHED,
    source="programs",
    argument="cells along the foundation",
    sizes=(40, 80, 160),
    solve=solve,
    axes=("t", "vertical force [N]"),
    marks=([1.0, 1.0, 1.5, 1.5, 1.5, 1.5], [268.0, 332.0, 365.0, 408.0, 338.0, 421.0]),
)

if __name__ == "__main__":
    CASE.main()
