"""Solve the half cylinder of Kratos."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import (
    GROUND,
    Case,
    Result,
    bodies,
    displacements,
    measure_on,
    next_step,
    pair_of,
)

import ufl
from dolfinx import fem

from dolfinx_tresca import MESHES, Frictionless

RADIUS, YOUNG, POISSON, PRESSURE = 8.0, 200.0, 0.3, 0.2

#: Distances from the middle of the nodes whose displacements are compared.
PLACES = (2.0, 1.70406, 1.40566)

#: Distance from the middle up to which the picture shows displacements.
SHOWN = 2.2


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the contact. Collective."""
    shape = {"R": RADIUS, "h": h, "Zone": 0.6, "Arc": 2.05, "Growth": 2 * h}
    disc = bodies(comm, MESHES / "half_disc.geo", YOUNG, POISSON, **shape)
    pressure = fem.Constant(disc.mesh, PRESSURE)
    scene = replace(
        disc,
        L=-pressure * ufl.TestFunction(disc.V)[1] * measure_on(disc, "cut"),
        bcs=[disc.fixed(name, 0.0, 0) for name in ("symmetry", "cut")],
        pairs=[pair_of(disc, "contact", GROUND, Frictionless())],
    )
    with scene.problem() as problem:
        x, u = displacements(comm, next_step(problem))
    on_arc = (x[:, 1] < 1.0) & (np.hypot(x[:, 0], x[:, 1] - 8.0) > 8.0 - h**2)
    along, u = x[on_arc, 0], u[on_arc]
    order = np.argsort(along)
    values = []
    for place in PLACES:
        across, down = (-np.interp(place, along[order], u[order, i]) for i in range(2))
        values += [abs(across), down]
    near = order[np.abs(along[order]) < SHOWN]
    return Result(CASE.named(*values), scene.V, along[near], -u[near, 1])


CASE = Case.read(__file__, solve)
