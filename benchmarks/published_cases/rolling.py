"""Solve the rolling cylinder, with finite sliding."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface, bodies, half_ellipse, pair_of, peak_of

from dolfinx_tresca import ContactState, Coulomb, Frictionless, RigidSphere, SolverOptions
from scenes.nodal import surface_nodes_of
from scenes.scene import Scene

RADIUS, YOUNG, POISSON, COEFFICIENT = 1000.0, 1000.0, 0.499, 0.3
MODULUS = YOUNG / (1.0 - POISSON**2)

#: Depth to which the cylinder is pressed in, so that the half width of the contact is about 1.
DEPTH = 0.0017

#: Start and end of the way. At the end both sides of the block are equally far away, as in theory.
START, END = -8.0, 0.0

#: Creepage divided by the creepage of full sliding, mu a / R.
CREEPAGE = 0.5

#: Length of rolling whose creepage is applied before the first step: with it the force is close to
#: the steady force from the first step on.
AHEAD = 6.0

OPTIONS = SolverOptions(rtol=1e-6, geometry_accuracy=1e-5)


class Way:
    """The way of a cylinder over a block, in steps of one cell."""

    def __init__(
        self, block: Scene, h: float, friction: Coulomb | Frictionless, creepage: float
    ) -> None:
        """Roll from one end to the other. Collective.

        Args:
            block: the block, from `bodies`.
            h: length of a step.
            friction: law of friction between cylinder and block.
            creepage: mean sliding velocity divided by the velocity of the cylinder.
        """
        cylinder = RigidSphere((START, RADIUS), RADIUS)
        pair = replace(pair_of(block, "contact", cylinder, friction), sliding="finite")
        scene = replace(block, bcs=[block.fixed("bottom")], pairs=[pair])
        problem = scene.problem(options=OPTIONS)
        self.V, self.forces = block.V, []
        with problem:
            for x in np.linspace(0.0, END - START, round((END - START) / h) + 1):
                cylinder.move_to((x, -DEPTH), -(x + creepage * (x + AHEAD)) / RADIUS)
                self.last = problem.solve()
                self.last.raise_if_failed()
                problem.accept()
                self.forces.append(self.last.pair_resultants[0].force)

    @property
    def half_width(self) -> float:
        """Half width of the contact by Hertz's theory, for the computed force."""
        return float(np.sqrt(4.0 * RADIUS * abs(self.forces[-1][1]) / (np.pi * MODULUS)))

    def stick_zone(self, comm: MPI.Comm) -> float:
        """Return half the length of the stick zone, divided by `half_width`. Collective."""
        _, fields = surface_nodes_of(self.last)
        sticks = (fields["pressure"] > 0.0) & (fields["state"] == ContactState.STICK)
        return 0.5 * comm.allreduce(float(fields["weights"][sticks].sum())) / self.half_width


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h. Collective."""
    block = bodies(comm, "rolling.geo", YOUNG, POISSON, h=h)
    smooth = np.array(Way(block, h, Frictionless(), 0.0).forces)[:, 1]
    steps = np.arange(len(smooth))
    free = Way(block, h, Coulomb(COEFFICIENT), 0.0)
    creepage = CREEPAGE * COEFFICIENT * free.half_width / RADIUS
    driven = Way(block, h, Coulomb(COEFFICIENT), creepage)
    tangential, normal = abs(driven.forces[-1])
    x, pressure, traction = along_surface(comm, driven.last, "pressure", "traction")
    place = x / driven.half_width
    inside = abs(place) < 1.2
    peak = COEFFICIENT * peak_of(abs(place), pressure)
    values = CASE.named(
        tangential / normal / COEFFICIENT,
        driven.stick_zone(comm),
        free.stick_zone(comm),
        (smooth / np.polyval(np.polyfit(steps, smooth, 2), steps)).max(),
    )
    return Result(values, driven.V, place[inside], abs(traction[inside]) / peak)


def carter(x: np.ndarray) -> np.ndarray:
    """Return shear stresses (n,) / (mu p0) at positions (n,) / (half width of the contact)."""
    stick = 1.0 - CREEPAGE
    return half_ellipse(x) - stick * half_ellipse((x - CREEPAGE) / stick)


X = np.linspace(-1.2, 1.2, 481)
CASE = Case.read(__file__, solve, 1.0 - (1.0 - CREEPAGE) ** 2, 1.0 - CREEPAGE, curve=(X, carter(X)))
