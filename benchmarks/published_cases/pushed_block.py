"""A block that is pressed on a rigid plane and pushed along it: Kikuchi and Oden's example.

J. T. Oden and E. B. Pires, Nonlocal and nonlinear friction laws and variational principles for
contact problems in elasticity, J. Appl. Mech. 50, 1983; N. Kikuchi and J. T. Oden, Contact Problems
in Elasticity, 1988: an elastic block with a pressure on its top and a pressure on one side is held
only by a rigid plane with friction. Their dimensions, loads and figures were not at hand. The data
here are our own, in plane strain, chosen so that a part of the contact opens, a part slips and a
part sticks. Our values are compared with values of GetFEM 5.4.4 (its script: "Measured once" in
`benchmarks/README.md`), with 128 cells along the block, conditions of the multipliers that are
integrals instead of nodal, and GetFEM's own assembly and Newton method. GetFEM's values with 64
cells differ by at most 7e-4 of themselves, the lift by 3e-3. The argument is the number of cells
along the block; cells become smaller towards the corners on the plane.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import GROUND, Case, Result, along_surface, displacements, next_step

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity

WIDTH, HEIGHT = 4.0, 2.0
YOUNG, POISSON, COEFFICIENT = 1000.0, 0.3, 0.5
ABOVE, BESIDE = 100.0, 80.0

#: Position up to which the picture shows shear stresses, which are unbounded at the right corner.
SHOWN = 3.9


def graded(x: np.ndarray) -> np.ndarray:
    """Return points (n, 2) of the block from points (n, 2) of the unit square."""
    across = 0.5 * WIDTH * (1.0 - np.cos(np.pi * x[:, 0]))
    return np.stack([across, HEIGHT * x[:, 1] ** 2], axis=1)


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the block and n / 2 cells over its height. Collective."""
    body = Body((int(n), int(n) // 2), [(0.0, 1.0), (0.0, 1.0)], move=graded)
    made = boxes(comm, "quadrilateral", [body], degree=2)
    sides = {1: (1, 0.0), 2: (1, 1.0), 3: (0, 0.0)}  # bottom, top, left
    tags = made.tags(
        *((tag, [0], lambda x, i=i, c=c: np.isclose(x[:, i], c)) for tag, (i, c) in sides.items())
    )
    V, mesh = made.V, made.mesh
    ds, v = ufl.Measure("ds", mesh, subdomain_data=tags), ufl.TestFunction(V)
    L = fem.Constant(mesh, BESIDE) * v[0] * ds(3) - fem.Constant(mesh, ABOVE) * v[1] * ds(2)
    pair = ContactPair(tags, 1, GROUND, Coulomb(COEFFICIENT))
    with ContactProblem(elasticity(V, YOUNG, POISSON), L, [pair], []) as problem:
        solution = next_step(problem)
    x, p, q, weights = along_surface(comm, solution, "pressure", "traction", "weights")
    places, u = displacements(comm, solution)
    q = np.abs(q)
    left = weights * np.where(np.isclose(x, 0.5 * WIDTH), 0.5, x < 0.5 * WIDTH)

    def node_displacement(*place: float) -> np.ndarray:
        return np.asarray(u[np.argmin(np.linalg.norm(places - place, axis=1))])

    below = np.flatnonzero(places[:, 1] < 1e-9)
    below = below[np.argsort(places[below, 0])]
    values = CASE.named(
        node_displacement(0.0, HEIGHT)[0],
        -node_displacement(WIDTH, HEIGHT)[1],
        *node_displacement(0.0, 0.0),
        np.interp(0.25 * WIDTH, places[below, 0], u[below, 0]),
        np.interp(0.5 * WIDTH, x, p),
        np.interp(0.5 * WIDTH, x, q),
        left @ p / (weights @ p),
        left @ q / (weights @ q),
    )
    shown = x < SHOWN
    return Result(values, V, x[shown], q[shown])


CASE = Case.read(__file__, solve)
