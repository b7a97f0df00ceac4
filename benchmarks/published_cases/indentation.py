"""A rigid ball on steel that yields, without friction.

K. L. Johnson, Contact Mechanics, sections 3.4 and 6.2: by Hertz's stresses below the surface and
von Mises' condition, yield begins when the pressure in the middle is 1.613 Y, for Poisson's ratio
0.3. W. C. Oliver and G. M. Pharr, J. Mater. Res. 7, 1992: when the ball begins to go up, the
derivative of the force with respect to the depth is 2 E* a. The script runs
`demos/demo_indentation.py`, which has both comparisons. The argument is the number of load steps
downwards; with more steps cells are smaller and the last depth is larger.
"""

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
