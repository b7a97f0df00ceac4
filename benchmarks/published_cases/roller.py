"""Solve the roller on a block, in contacts of two sizes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

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
    peak_of,
)

import ufl
from dolfinx import fem

from dolfinx_tresca import Frictionless
from scenes.hertz_theory import HertzLine

FORCE, RADIUS, LOADED = 35_000.0, 50.0, 10.0  # N per mm of thickness, mm, mm
YOUNG, POISSON = {"cylinder": 210_000.0, "block": 70_000.0}, 0.3  # MPa

#: Young's modulus [MPa] of two equal bodies with the same total compliance.
EQUAL = dict.fromkeys(YOUNG, 105_000.0)

#: Name of the contact -> its relative size, and Young's moduli; the force is proportional to the
#: square of the size.
CONTACTS = {
    "": (1.0, YOUNG),
    ", contact of 1/16": (1 / 16, YOUNG),
    ", of 1/16, equal bodies": (1 / 16, EQUAL),
}


def hertz(scale: float) -> HertzLine:
    """Return Hertz's theory for a contact of relative size `scale`."""
    compliance = sum((1 - POISSON**2) / young for young in YOUNG.values())
    return HertzLine(scale**2 * FORCE, RADIUS, 1 / compliance)


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the larger contact. Collective."""
    values, curves = {}, []
    for name, (scale, young) in CONTACTS.items():
        V, x, p, weights, down = pressed(comm, h * scale, 0.5 * h, scale, young)
        curves.append((x, p))
        # a half ellipse has the second moment a^2 / 4
        half_width = 2 * math.sqrt(float(weights @ (p * x**2)) / float(weights @ p))
        values[f"peak pressure [MPa]{name}"] = peak_of(x / hertz(scale).contact_radius, p)
        values[f"half width [mm]{name}"] = half_width
        values.setdefault("displacement of the middle [mm]", down)  # first: for the whole force
    return Result(values, V, *curves[0])


def pressed(
    comm: MPI.Comm, h: float, growth: float, scale: float, young: dict[str, float]
) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, float]:
    """Solve with cells of size h [mm] at the contact. Collective.

    Returns:
        The space of the displacement; distances from the middle, pressures and weights of the
        contact nodes; and the displacement of the middle.
    """
    shape = {"R": RADIUS, "h": h, "Zone": 10.0 * scale, "Growth": growth}
    roller = bodies(comm, "roller.geo", young, POISSON, **shape)
    top = measure_on(roller, "top")
    # length of the loaded arc of half the cylinder: the mesh has chords of this arc
    length = comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(roller.mesh, 1.0) * top)))
    load = fem.Constant(roller.mesh, (0.0, -0.5 * scale**2 * FORCE / length))
    scene = replace(
        roller,
        L=ufl.inner(load, ufl.TestFunction(roller.V)) * top,
        bcs=[roller.fixed("bottom"), roller.fixed("symmetry", 0.0, 0)],
        pairs=[pair_of(roller, "cylinder_contact", "block_contact", Frictionless())],
    )
    with scene.problem() as problem:
        solution = next_step(problem)
        x, p, weights = along_surface(comm, solution, "pressure", "weights")
        places, u = displacements(comm, solution)
    middle = np.hypot(*places.T) < 1e-9  # equal in both bodies
    return scene.V, x, p, weights, -float(u[middle, 1].mean())


R = np.linspace(0.0, 8.0, 200)
CASE = Case.read(
    __file__,
    solve,
    *(
        getattr(hertz(scale), attribute)
        for scale, _ in CONTACTS.values()
        for attribute in ("peak", "contact_radius")
    ),
    curve=(R, hertz(1.0).pressure(R)),
)
