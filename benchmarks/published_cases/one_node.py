"""Solve the triangle of which one node may touch."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import GROUND, Case, Result, next_step, tags_of_sides

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb
from scenes.elasticity import elasticity, lame_constants
from scenes.nodal import nodal
from scenes.patches import mesh_of

YOUNG, POISSON, COEFFICIENT = 1.0, 0.3, 2.0  # -, -, -
PRESSED = 1e-3  # N

#: Nodes of the triangle, of which the first one is free; then the triangle's area, and the gradient
#: of the free node's shape function.
NODES = np.array([[0.0, 0.0], [1.0, 0.0], [-0.873, 1.0]])
AREA, GRADIENT = 0.5, np.array([-1.0, -1.873])

MU, LAME = lame_constants(YOUNG, POISSON)
STIFFNESS = AREA * (
    MU * GRADIENT @ GRADIENT * np.eye(2) + (LAME + MU) * np.outer(GRADIENT, GRADIENT)
)

#: T/N at which the node sticks; at which it may stick, slip or be open; and at which it must be
#: open.
ONE, THREE, JUMP = 1.2, 1.75, 2.2

#: T/N of the load steps that the picture shows.
PULLS = np.linspace(0.0, JUMP, 46)


def solve(comm: MPI.Comm, _: float) -> Result:
    """Solve the load steps. Collective."""
    triangle = mesh_of(comm, "triangle", 1, NODES, np.array([[0, 1, 2]]))
    tags = tags_of_sides(triangle, {1: lambda x: np.isclose(x[1], 0.0)})
    V = fem.functionspace(triangle, ("Lagrange", 1, (2,)))
    held = fem.locate_dofs_geometrical(V, lambda x: np.abs(x[0]) > 0.5)
    bcs = [fem.dirichletbc(np.zeros(2), held, V)]
    load = fem.Constant(triangle, np.zeros(2))
    L = ufl.inner(load, ufl.TestFunction(V)) * ufl.dx
    pair = ContactPair(tags, 1, GROUND, Coulomb(COEFFICIENT))
    a = elasticity(V, YOUNG, POISSON)

    def force_at(problem: ContactProblem, pull: float) -> tuple[float, np.ndarray]:
        """Return (normal force) / N, and the displacement of the node."""
        load.value[:] = 3.0 / AREA * PRESSED * np.array([-pull, -1.0])
        solution = next_step(problem)
        u = comm.allreduce(nodal(solution.u).sum(axis=0))
        return solution.normal_force / PRESSED, u

    with ContactProblem(a, L, [pair], bcs) as problem:
        cold, _ = force_at(problem, THREE)
    with ContactProblem(a, L, [pair], bcs) as problem:
        force_at(problem, 0.0)
        one, _ = force_at(problem, ONE)
        three, _ = force_at(problem, THREE)
        _, u = force_at(problem, JUMP)
    with ContactProblem(a, L, [pair], bcs) as problem:
        path = np.array([force_at(problem, pull)[0] for pull in PULLS])
    free = np.linalg.solve(STIFFNESS, PRESSED * np.array([-JUMP, -1.0]))
    return Result(CASE.named(one, cold, three, u @ free / (free @ free)), V, PULLS, path)


CURVE = (np.array([0.0, COEFFICIENT, COEFFICIENT, JUMP]), np.array([1.0, 1.0, 0.0, 0.0]))
CASE = Case.read(__file__, solve, curve=CURVE)
