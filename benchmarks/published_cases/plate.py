"""Solve the plate on a rigid plane."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import (
    GROUND,
    Case,
    Result,
    along_surface,
    displacements,
    next_step,
    tags_of_sides,
)

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb
from scenes.elasticity import elasticity, fixed

SIDE = 40.0  # mm
YOUNG, POISSON, COEFFICIENT = 130_000.0, 0.2, 1.0  # MPa, -, -
ABOVE, BESIDE = 50.0, 150.0  # MPa

#: Distances from the loaded corner [mm] at which displacements are compared.
PLACES = (0.0, 1.25, 5.0, 7.5, 11.25)

#: Distance from the symmetry plane [mm] of the node whose normal force is compared, which is also
#: the cell size.
BESIDE_SYMMETRY = 1.25


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n x n cells. Collective."""
    plate = mesh.create_rectangle(
        comm, [[0.0, 0.0], [SIDE, SIDE]], [int(n), int(n)], mesh.CellType.quadrilateral
    )
    places = {1: (1, 0.0), 2: (0, SIDE), 3: (1, SIDE), 4: (0, 0.0)}  # bottom, symmetry, top, side
    tags = tags_of_sides(
        plate, {tag: lambda x, i=i, c=c: np.isclose(x[i], c) for tag, (i, c) in places.items()}
    )
    V = fem.functionspace(plate, ("Lagrange", 1, (2,)))
    ds, v = ufl.Measure("ds", plate, subdomain_data=tags), ufl.TestFunction(V)
    L = -fem.Constant(plate, ABOVE) * v[1] * ds(3) + fem.Constant(plate, BESIDE) * v[0] * ds(4)
    pair = ContactPair(tags, 1, GROUND, Coulomb(COEFFICIENT))
    bcs = [fixed(V, tags.find(2), 0.0, 0)]
    with ContactProblem(elasticity(V, YOUNG, POISSON), L, [pair], bcs) as problem:
        solution = next_step(problem)
    x, p, weights = along_surface(comm, solution, "pressure", "weights")
    hat = np.maximum(1.0 - np.abs(SIDE - x - BESIDE_SYMMETRY) / BESIDE_SYMMETRY, 0.0)
    force = float(p @ (weights * hat))
    nodes, u = displacements(comm, solution)
    below = np.flatnonzero(np.isclose(nodes[:, 1], 0.0))
    below = below[np.argsort(nodes[below, 0])]
    x, u = nodes[below, 0], 1000.0 * u[below, 0]
    values = CASE.named(*(np.interp(place, x, u) for place in PLACES), force)
    return Result(values, V, x, u)


CASE = Case.read(__file__, solve)
