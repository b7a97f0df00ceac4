"""Run `demos/demo_ironing.py`; its load steps are proportional to the cells, a multiple of 20."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, run_demo


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the foundation. Collective."""
    demo = run_demo("ironing", n)
    times, vertical, horizontal = (demo[name] for name in ("times", "vertical", "horizontal"))
    end = int(np.argmin(np.abs(times - 1.0)))
    forces = (vertical[end], horizontal[end], vertical[-1], horizontal[-1])
    return Result(CASE.named(*forces), demo["V"], times, vertical)


CASE = Case.read(__file__, solve)
