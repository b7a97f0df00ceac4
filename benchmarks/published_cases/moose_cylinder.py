"""An elastic cylinder on a rigid plane, without friction and glued: tests of MOOSE.

The folder `modules/contact/test/tests/verification/hertz_cyl` of MOOSE (Idaho National Laboratory)
keeps the results of half a cylinder of radius 3, whose cut is moved by 0.002 towards the plane. The
values are those of its files `half_symm_q8/gold/hertz_cyl_half_1deg_*.csv`, with quadrilaterals of
degree 2, eight along the half width of the contact, and `half_symm_q4`, of degree 1:
`frictionless_kin_check2`, `frictionless_kin_check_cont_press_0035`, and `glued_pen_check2`, where
nodes that touch are glued to the plane in each of ten load steps. Here they stick by Coulomb's law
with a coefficient that no traction exceeds. The pressure in the middle is the peak of half an
ellipse that is fitted to MOOSE's values at vertices or at midpoints of cells.
"""

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
