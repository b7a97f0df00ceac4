"""Solve the disc of GetFEM."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import (
    GROUND,
    Case,
    Result,
    along_surface,
    bodies,
    displacements,
    next_step,
    pair_of,
)

import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb

RADIUS, WEIGHT, COEFFICIENT = 20.0, 0.05, 0.4
YOUNG, POISSON = 2.5, 0.25  # both of Lame's constants are 1

#: Nodes whose displacements are compared, with the component and its sign.
NODES = (
    ((0.0, 2.0 * RADIUS), 1, -1.0),
    ((0.0, RADIUS), 1, -1.0),
    ((RADIUS, RADIUS), 1, -1.0),
    ((RADIUS, RADIUS), 0, 1.0),
)

#: Distance from the middle of the node whose slip is compared.
SLIPPING = 15.2908


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h. Collective."""
    disc = bodies(comm, "getfem_disc.geo", YOUNG, POISSON, R=RADIUS, h=h)
    scene = replace(
        disc,
        L=-fem.Constant(disc.mesh, WEIGHT) * ufl.TestFunction(disc.V)[1] * ufl.dx,
        bcs=[disc.fixed("symmetry", 0.0, 0)],
        pairs=[pair_of(disc, "contact", GROUND, Coulomb(COEFFICIENT))],
    )
    with scene.problem() as problem:
        solution = next_step(problem)
        x, p, slip = along_surface(comm, solution, "pressure", "slip")
        places, u = displacements(comm, solution)
    moved = []
    for place, component, sign in NODES:
        node = np.argmin(np.linalg.norm(places - place, axis=1))
        moved.append(sign * u[node, component])
    inside = x < 0.25 * RADIUS
    pressure = np.polyfit(x[inside] ** 2, p[inside], 2)[-1]
    values = CASE.named(*moved, pressure, np.interp(SLIPPING, x, slip))
    return Result(values, scene.V, x, p)


CASE = Case.read(__file__, solve)
