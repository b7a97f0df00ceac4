"""Solve the pushed block."""

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
