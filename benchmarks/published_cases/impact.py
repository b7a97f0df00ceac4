"""An elastic bar hits a rigid wall, and a block slides until friction has stopped it.

    tools/fenicsx python3 benchmarks/published_cases/impact.py 50

Wave theory (K. L. Johnson, Contact Mechanics, section 11.1): the bar presses with rho c v for the
time 2 l / c and rebounds with its initial speed. By Coulomb's law the block stops after the time v
/ (F g) and the distance v^2 / (2 F g). The script runs `demos/demo_impact.py`, which has both
problems. The argument is the number of cells along the bar; the numbers of cells and unknowns in
the table are the block's.
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
from case import Case, Result, exactly

DEMO = Path(__file__).parents[2] / "demos" / "demo_impact.py"

PUBLISHED = {
    f"{quantity} over theory's": exactly(1.0)
    for quantity in ("pressure", "time of contact", "rebound", "stopping distance")
}


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the bar. Collective."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        with mock.patch.object(sys, "argv", ["demo_impact", str(int(n))]):
            with contextlib.redirect_stdout(io.StringIO()):
                found = runpy.run_path(str(DEMO))
    ratios = (
        found["middle"].mean() / found["wave_pressure"],
        found["found_time"] / found["contact_time"],
        found["rebound"] / found["impact_speed"],
        found["moved"][-1] / found["stopping_distance"],
    )
    time = found["times"] * found["wave_speed"] / found["bar"]["length"]
    pressure = found["pressures"] / found["wave_pressure"]
    first = int(np.flatnonzero(pressure)[0])
    values = dict(zip(PUBLISHED, map(float, ratios), strict=True))
    return Result(values, found["V"], time[first:] - time[first], pressure[first:])


CASE = Case(
    name="impact",
    title="Impact of a bar, sliding block",
    published=PUBLISHED,
    source="formula",
    argument="cells along the bar",
    sizes=(25, 50, 100),
    solve=solve,
    order=2 / 3,
    axes=("time over l / c", "pressure over rho c v"),
    curve=(np.array([0.0, 2.0, 2.0, 2.5]), np.array([1.0, 1.0, 0.0, 0.0])),
)

if __name__ == "__main__":
    CASE.main()
