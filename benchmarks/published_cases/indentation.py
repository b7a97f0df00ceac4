"""Run `demos/demo_indentation.py`."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, run_demo
from scipy.optimize import minimize_scalar

POISSON = 0.3


def pressure_at_yield() -> float:
    """Return (pressure in the middle) / Y at first yield, by Hertz's stresses on the axis."""

    def negative_stress(z: float) -> float:
        """Return -(von Mises stress) / (pressure in the middle) at the depth z / (radius)."""
        axial = 1.0 / (1.0 + z**2)
        radial = (1.0 + POISSON) * (1.0 - z * np.arctan(1.0 / z)) - 0.5 * axial
        return -float(abs(axial - radial))

    return -1.0 / float(minimize_scalar(negative_stress, bounds=(0.1, 1.0)).fun)


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n load steps downwards. Collective."""
    demo = run_demo("indentation", n)
    down, up, _ = demo["smooth"]
    reduced, radius, limit = (demo[name] for name in ("reduced", "radius", "yield_stress"))
    last = [step for step in down if step.stress <= limit][-1]  # elastic: stress ~ pressure
    middle = (6 * last.force * reduced**2 / (np.pi**3 * radius**2)) ** (1 / 3)
    slope = (down[-1].force - up[0].force) / (down[-1].depth - up[0].depth)
    values = CASE.named(middle / last.stress, slope / (2 * reduced * down[-1].contact_radius))
    strain, mean = np.array([(step.strain, step.mean_pressure / limit) for step in down]).T
    return Result(values, demo["V"], strain, mean)


#: E* a / (Y R), and below the mean pressure divided by Y: at first yield, by Hertz's formulas, and
#: approximately at full plasticity, by Johnson, section 6.3.
STRAINS = (0.5 * np.pi * pressure_at_yield(), 40.0)
PRESSURES = (2 / 3 * pressure_at_yield(), 3.0)

CASE = Case.read(__file__, solve, pressure_at_yield(), marks=(STRAINS, PRESSURES))
