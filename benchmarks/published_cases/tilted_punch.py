"""Solve the punch that tilts."""

from __future__ import annotations

import math
from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface, bodies, next_step, pair_of

from dolfinx import fem

from dolfinx_tresca import ContactProblem, Coulomb, RigidPlane

YOUNG, POISSON, COEFFICIENT = 1.0, 0.4999, 0.5
MODULUS = YOUNG / (1.0 - POISSON**2)

#: Distances by which the far end of the block is pressed up and then moved aside, divided by the
#: half width.
DEPTH, ASIDE = 1e-3, 2.5e-4

#: Tilt at which the whole punch touches, and tilt at which a part of it lifts off.
SLIGHT, LARGE = 7e-5, 2.2e-4

#: Width of the stick zone divided by that of the contact, for the shear force of the motion
#: `ASIDE`.
STUCK = 0.616


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the edges of the punch. Collective."""
    block = bodies(comm, "tilted_punch.geo", YOUNG, POISSON, h=h)
    end = fem.Constant(block.mesh, (0.0, DEPTH))
    bcs = [block.fixed("bottom", end)]

    def under(tilt: float) -> ContactProblem:
        """Return the problem with a punch that is tilted about its corner at x = 1."""
        plane = RigidPlane(point=(1.0, 0.0), normal=(-tilt, -1.0))
        pair = pair_of(block, "contact", plane, Coulomb(COEFFICIENT))
        return replace(block, bcs=bcs, pairs=[pair]).problem()

    def stresses(problem: ContactProblem) -> list[np.ndarray]:
        """Return positions, weights, pressures and shear stresses of the next load step."""
        return along_surface(comm, next_step(problem), "weights", "pressure", "traction")

    with under(SLIGHT) as problem:
        x, weights, p, _ = stresses(problem)
        moment = weights * p @ x
    with under(LARGE) as problem:
        x, weights, p, _ = stresses(problem)
        force = weights @ p
        width = 4.0 * (1.0 - weights * p @ x / force)
        # p^2 (1 - x) is linear in x, except in the cells at the corner and at the end of the
        # contact
        inside = (x > 1.1 - width) & (x < 0.9)
        slope, start = np.polyfit(x[inside], p[inside] ** 2 * (1.0 - x[inside]), 1)
        end.value[0] = ASIDE
        x, weights, p, q = stresses(problem)
    q = q * np.sign(weights @ q)
    short = weights * (COEFFICIENT * p - q)  # F times the pressure under the force P - Q / F
    stick = 4.0 * (1.0 - short @ x / short.sum())
    values = CASE.named(
        moment / (math.pi * MODULUS * SLIGHT / 4.0),
        (1.0 + start / slope) / width,
        force / (math.pi * MODULUS * LARGE * width / 4.0),
        stick / width / (1.0 - weights @ q / (COEFFICIENT * force)),
    )
    unit = 2.0 * COEFFICIENT * force / (math.pi * width)
    away = (1.0 - x) / width
    near = np.flatnonzero((away > X[0]) & (away < X[-1]))[::-1]
    return Result(values, block.V, away[near], q[near] / unit)


def shear_stress(x: np.ndarray) -> np.ndarray:
    """Return shear stresses (n,) / (2 F P / (pi l)) at distances (n,) / l from the corner."""
    full, stuck = (np.sqrt(np.maximum(end - x, 0.0) / x) for end in (1.0, STUCK))
    return np.asarray(full - stuck)


X = np.linspace(0.02, 1.2, 300)
CASE = Case.read(__file__, solve, curve=(X, shear_stress(X)))
