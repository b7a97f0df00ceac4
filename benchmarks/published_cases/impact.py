"""Run `demos/demo_impact.py`; cells and unknowns in the table are the block's."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, run_demo


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the bar. Collective."""
    demo = run_demo("impact", n)
    ratios = (
        demo["middle"].mean() / demo["wave_pressure"],
        demo["found_time"] / demo["contact_time"],
        demo["rebound"] / demo["impact_speed"],
        demo["moved"][-1] / demo["stopping_distance"],
    )
    time = demo["times"] * demo["wave_speed"] / demo["bar"]["length"]
    pressure = demo["pressures"] / demo["wave_pressure"]
    first = int(np.flatnonzero(pressure)[0])
    return Result(CASE.named(*ratios), demo["V"], time[first:] - time[first], pressure[first:])


CASE = Case.read(
    __file__, solve, curve=(np.array([0.0, 2.0, 2.0, 2.5]), np.array([1.0, 1.0, 0.0, 0.0]))
)
