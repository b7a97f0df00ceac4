"""Solve the triangle with a large coefficient of friction."""

from __future__ import annotations

import math
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
from case import Case, Result, next_step, tags_of_sides

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, RigidPlane
from scenes.elasticity import elasticity, lame_constants
from scenes.nodal import nodal, surface_nodes_of
from scenes.patches import mesh_of

YOUNG, POISSON = 1.0, 0.3
PRESSED = 1e-3  # N, over Young's modulus

CRITICAL = math.sqrt((1.0 - POISSON) / POISSON)

#: Tangents of the angles at both ends of the side on the plane, whose length is 1; and the third
#: corner.
HELD, LOADED = (1.0 - 2.0 * POISSON) / (2.0 * math.sqrt(POISSON * (1.0 - POISSON))), 1.0 / CRITICAL
TOP = np.array([LOADED, HELD * LOADED]) / (HELD + LOADED)

#: Coefficients of friction divided by F_c: one below and one above F_c.
BELOW, BEYOND = 0.8, 1.2

#: T / N divided by F_c: where the triangle slips with the smaller F; where it may stick, slip or be
#: open with the larger F; and where it must be open.
SLIPS, THREE, JUMP = 0.9, 1.1, 1.3

#: T / N divided by F_c, in the load steps that the picture shows.
PULLS = np.linspace(0.0, JUMP, 53)


def slipping(pull: float, friction: float) -> float:
    """Return the pressure divided by N if the whole side slips.

    Args:
        pull: T / N divided by F_c.
        friction: F divided by F_c.
    """
    return (pull - 1.0) / (friction - 1.0)


def triangulation(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points and cells of the triangle with n cells along a side."""
    j, i = np.nonzero(np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n)
    number = np.full((n + 2, n + 2), -1)
    number[i, j] = np.arange(len(i))
    right, above, beyond = number[i + 1, j], number[i, j + 1], number[i + 1, j + 1]
    cells = np.concatenate(
        [np.stack([number[i, j], right, above], axis=1), np.stack([right, beyond, above], axis=1)]
    )
    points = np.outer(i / n, [1.0, 0.0]) + np.outer(j / n, TOP)
    return points, cells[(cells >= 0).all(axis=1)]


def scene(comm: MPI.Comm, n: int) -> SimpleNamespace:
    """Return forms, conditions, tags and loads of the triangle. Collective."""
    triangle = mesh_of(comm, "triangle", 1, *triangulation(n))
    tags = tags_of_sides(
        triangle,
        {
            1: lambda x: abs(x[1]) < 1e-9,
            2: lambda x: abs(x[1] - HELD * x[0]) < 1e-9,
            3: lambda x: abs(x[1] - LOADED * (1.0 - x[0])) < 1e-9,
        },
    )
    V = fem.functionspace(triangle, ("Lagrange", 1, (2,)))
    stretch = fem.Constant(triangle, np.zeros(2))  # sticking: u = stretch y
    mu, lame = lame_constants(YOUNG, POISSON)
    gradient = ufl.outer(stretch, ufl.as_vector([0.0, 1.0]))
    stress = 2.0 * mu * ufl.sym(gradient) + lame * ufl.tr(gradient) * ufl.Identity(2)
    ds = ufl.Measure("ds", triangle, subdomain_data=tags)
    L = ufl.inner(stress * ufl.FacetNormal(triangle), ufl.TestFunction(V)) * ds(3)
    sticking = fem.Function(V)
    bcs = [fem.dirichletbc(sticking, fem.locate_dofs_topological(V, 1, tags.find(2)))]

    def pull(part: float) -> None:
        """Set the loads such that T = `part` F_c N."""
        stretch.value[:] = PRESSED * np.array([part * CRITICAL / mu, -1.0 / (lame + 2.0 * mu)])
        sticking.interpolate(lambda x: np.outer(stretch.value, x[1]))

    return SimpleNamespace(
        V=V, a=elasticity(V, YOUNG, POISSON), L=L, bcs=bcs, tags=tags, pull=pull, sticking=sticking
    )


def problem_of(one: SimpleNamespace, friction: float, gap: float = 0.0) -> ContactProblem:
    """Return the problem with F = `friction` F_c, and a gap above the plane. Collective."""
    plane = RigidPlane(point=(0.0, -gap), normal=(0.0, 1.0))
    pair = ContactPair(one.tags, 1, plane, Coulomb(friction * CRITICAL))
    return ContactProblem(one.a, one.L, [pair], one.bcs)


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along a side. Collective."""
    one = scene(comm, int(n))

    def after(problem: ContactProblem, pull: float) -> tuple[float, np.ndarray]:
        """Solve the next load step; return its mean pressure divided by N, and its displacement."""
        one.pull(pull)
        solution = next_step(problem)
        _, fields = surface_nodes_of(solution)
        sums = np.array([fields["pressure"] @ fields["weights"], fields["weights"].sum()])
        force, width = comm.allreduce(sums)
        return float(force / width) / PRESSED, nodal(solution.u).copy()

    with problem_of(one, BELOW) as problem:
        slips, _ = after(problem, SLIPS)
    with problem_of(one, BELOW) as problem:
        path = np.array([after(problem, pull)[0] for pull in PULLS])
    with problem_of(one, 1.0) as problem:
        ray, _ = after(problem, 1.0)
    with problem_of(one, BEYOND) as problem:
        cold, _ = after(problem, THREE)
    with problem_of(one, BEYOND) as problem:
        after(problem, 0.0)
        three, _ = after(problem, THREE)
        _, u = after(problem, JUMP)
    with problem_of(one, BEYOND, gap=1.0) as problem:
        _, free = after(problem, JUMP)
    along_free, whole = comm.allreduce(np.array([(u * free).sum(), (free * free).sum()]))
    critical = (SLIPS - BELOW * slips) / (1.0 - slips)
    values = CASE.named(critical, ray, cold, three, along_free / whole)
    return Result(values, one.V, PULLS, path)


CURVE = (np.array([0.0, BELOW, 1.0, JUMP]), np.array([1.0, 1.0, 0.0, 0.0]))
CASE = Case.read(__file__, solve, curve=CURVE)
