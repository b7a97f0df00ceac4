"""Solve the half cylinder of MOOSE; glued nodes stick by a friction that no traction exceeds."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import GROUND, Case, Result, along_surface, bodies, next_step, pair_of, peak_of

from dolfinx import fem

from dolfinx_tresca import MESHES, Coulomb, Frictionless

RADIUS, YOUNG, POISSON, DEPTH, STEPS = 3.0, 1e6, 0.3, 0.002, 10

#: A coefficient of friction so large that all nodes in contact stick.
LARGE = 10.0


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the contact. Collective."""
    shape = {"R": RADIUS, "h": h, "Zone": 0.08, "Arc": 0.3, "Growth": 40 * h}
    disc = bodies(comm, MESHES / "half_disc.geo", YOUNG, POISSON, **shape)
    depth = fem.Constant(disc.mesh, 0.0)
    bcs = [disc.fixed("cut", 0.0, 0), disc.fixed("cut", depth, 1), disc.fixed("symmetry", 0.0, 0)]
    forces = []
    for friction, steps in ((Frictionless(), 1), (Coulomb(LARGE), STEPS)):
        pair = pair_of(disc, "contact", GROUND, friction)
        with replace(disc, bcs=bcs, pairs=[pair]).problem() as problem:
            for step in range(steps):
                depth.value = -DEPTH * (step + 1) / steps
                solution = next_step(problem)
        forces.append(2.0 * solution.normal_force)
        if steps == 1:
            x, p = along_surface(comm, solution, "pressure")
    values = CASE.named(forces[0], peak_of(x / HALF_WIDTH, p), forces[1])
    near = x < 0.06
    return Result(values, disc.V, x[near], p[near])


#: Half width of the contact by Hertz's theory, for MOOSE's force.
HALF_WIDTH = float(np.sqrt(4 * 716.811 * RADIUS * (1 - POISSON**2) / (np.pi * YOUNG)))
CASE = Case.read(__file__, solve)
