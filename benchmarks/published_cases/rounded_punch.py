"""Solve the punch with a rounded edge."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import (
    Case,
    Result,
    along_surface,
    bodies,
    displacements,
    measure_on,
    next_step,
    pair_of,
)

import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb, Frictionless
from scenes.elasticity import by_body
from scenes.revolution import ring_elasticity

YOUNG, POISSON, COEFFICIENT = {"punch": 210_000.0, "foundation": 70_000.0}, 0.3, 0.1  # MPa, -, -
LOAD, STEPS = 100.0, 2  # MPa, number of load steps as in Code_Aster


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the end of the flat face. Collective."""
    plane = bodies(comm, "rounded_punch.geo", YOUNG, POISSON, h=h, Growth=0.4 * h)
    r = ufl.SpatialCoordinate(plane.mesh)[0]
    load = fem.Constant(plane.mesh, 0.0)
    rings = replace(
        plane,
        a=ring_elasticity(plane.V, by_body(plane.tagged_mesh, YOUNG), POISSON),
        L=-load * ufl.TestFunction(plane.V)[1] * 2 * np.pi * r * measure_on(plane, "top"),
        bcs=[plane.fixed("bottom"), plane.fixed("axis", 0.0, 0)],
    )
    values = []
    for friction in (Frictionless(), Coulomb(COEFFICIENT)):
        pair = pair_of(rings, "punch_contact", "foundation_contact", friction)
        with rings.problem(pairs=[pair], axisymmetric=True) as problem:
            for step in range(STEPS):
                load.value = LOAD * (step + 1) / STEPS
                solution = next_step(problem)
        x, p = along_surface(comm, solution, "pressure")
        places, u = displacements(comm, solution)
        middle = np.hypot(*places.T) < 1e-9  # equal in both bodies
        inside = x < 20.0
        values += [-u[middle, 1].mean(), np.polyfit(x[inside] ** 2, p[inside], 2)[-1]]
    return Result(CASE.named(*values), rings.V, x, p)


CASE = Case.read(__file__, solve)
