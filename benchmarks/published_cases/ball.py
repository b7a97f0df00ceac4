"""Solve the ball on a plane."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface, half_ellipse, next_step, peak_of

from scenes.revolution import APPROACH, BALL_POISSON, ball_on_plane, contact_radius

#: Name of the contact -> its size relative to the larger contact, and Poisson's ratio.
CONTACTS = {
    "": (1.0, BALL_POISSON),
    ", contact of 1/16": (1 / 16, BALL_POISSON),
    ", of 1/16, Poisson's ratio 0.48": (1 / 16, 0.48),
}


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the larger contact. Collective."""
    values, x, y = {}, [], []
    for name, (scale, poisson) in CONTACTS.items():
        scene = ball_on_plane(comm, h * scale, 2, growth=2.5 * h, scale=scale, poisson=poisson)
        with scene.problem(axisymmetric=True) as problem:
            solution = next_step(problem)
        theory = scene.data.theory(solution.normal_force)
        r, p = along_surface(comm, solution, "pressure")
        x.append(r / theory.contact_radius)
        y.append(p / theory.peak)
        radius = contact_radius(comm, solution)
        values[f"contact radius over Hertz's{name}"] = radius / theory.contact_radius
        values[f"peak pressure over Hertz's{name}"] = peak_of(x[-1], y[-1])
        values[f"approach over Hertz's{name}"] = APPROACH * scale**2 / theory.approach
    return Result(values, scene.V, x[0], y[0])


X = np.linspace(0.0, 1.4, 200)
CASE = Case.read(__file__, solve, curve=(X, half_ellipse(X)))
