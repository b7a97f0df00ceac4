"""Shallow ironing: a block with a round face, pressed on a soft foundation and pulled along it.

K. A. Fischer and P. Wriggers, Comput. Methods Appl. Mech. Eng. 195, 2006. The script runs
`demos/demo_ironing.py`, which has the data and the figures of several groups. The argument is the
number of cells along the foundation, a multiple of 20; the number of load steps is proportional to
it.
"""

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
