"""Solve the twisted balls."""

from __future__ import annotations

import math
from typing import Any

from mpi4py import MPI

import numpy as np
from case import Case, Result, next_step
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, ContactSolution, Coulomb
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed, no_load
from scenes.hertz_theory import plane_strain_modulus
from scenes.nodal import surface_nodes_of

YOUNG, POISSON, COEFFICIENT = 1000.0, 0.3, 0.4  # MPa, -, -
RADIUS, WIDTH, APPROACH = 1000.0, 1.0, 2e-5  # mm; half width, and height, of each body

#: Argument of cosh at the ends: the widths of cells grow with cosh from the middle to the ends.
GRADING = 4.2

#: Angles between both bodies; then an angle at which the whole contact slips; divided by F p0 / G.
ANGLES, FAR = np.linspace(0.0, 1.0, 9), 10.0

UPPER, LOWER, TOP, BOTTOM = 1, 2, 3, 4


def angle_of(c: float) -> float:
    """Return the angle, divided by F p0 / G, at which a disc of the radius c, divided by a, sticks.

    The traction is a sum of tractions 4 G r / (pi sqrt(t^2 - r^2)) of discs that turn by an angle,
    for all radii t from c to a. Outside of c the sum is F p0 sqrt(1 - r^2 / a^2): an integral
    equation of Abel's kind for the angles. Inside of c each body turns by the sum of all angles.
    """
    return float(ellipk(1.0 - c**2) - ellipe(1.0 - c**2))


def stick_radius(angle: float) -> float:
    """Return the radius of the stick zone, divided by a, for an angle divided by F p0 / G."""
    return float(brentq(lambda c: angle_of(c) - angle, 1e-12, 1.0))


def moment(angle: float) -> float:
    """Return the moment, divided by F P a, for an angle divided by F p0 / G.

    A disc of the radius t that turns by the angle 1 contributes 16/3 G t^3.
    """
    c = stick_radius(angle)
    inner, _ = quad(lambda t: t**2 * angle_of(t), c, 1.0)
    return float(4.0 / math.pi * (c**3 * angle + 3.0 * inner))


def mean_square(angle: float) -> float:
    """Return the mean of r^2 / a^2, weighted with F p minus the shear stress, from discs."""
    c = stick_radius(angle)

    def of_discs(power: int) -> float:
        """Return the integral, over the angles of discs, of a power of their radii."""
        inner, _ = quad(lambda t: t ** (power - 1) * angle_of(t), 0.0, c)
        return float(power * inner - c**power * angle)

    return 0.75 * of_discs(4) / of_discs(2)


def moved(side: float) -> Any:
    """Return the map of a box to a body above (1) or below (-1) the contact."""

    def move(x: np.ndarray) -> np.ndarray:
        y = WIDTH * np.sinh(GRADING * x) / np.sinh(GRADING)
        face = (y[:, :2] ** 2).sum(axis=1) / (2.0 * RADIUS)
        y[:, 2] += side * face * (1.0 - np.abs(x[:, 2]))
        return y

    return move


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along a body. Collective."""
    bodies = [
        Body((int(n), int(n) // 2), [(-1.0, 1.0), (-1.0, 1.0), ends], move=moved(side))
        for ends, side in (((0.0, 1.0), 1.0), ((-1.0, 0.0), -1.0))
    ]
    made = boxes(comm, "hexahedron", bodies)
    faces = {UPPER: (0, 0.0), LOWER: (1, 0.0), TOP: (0, 1.0), BOTTOM: (1, -1.0)}
    tags = made.tags(
        *(
            (tag, [body], lambda x, place=place: np.abs(x[:, 2] - place) < 1e-9)
            for tag, (body, place) in faces.items()
        )
    )
    V, end = made.V, fem.Function(made.V)
    top = fem.locate_dofs_topological(V, 2, tags.find(TOP))
    bcs = [fem.dirichletbc(end, top), fixed(V, tags.find(BOTTOM))]
    pair = ContactPair(tags, UPPER, LOWER, Coulomb(COEFFICIENT))
    a, L = elasticity(V, YOUNG, POISSON), no_load(V)
    with ContactProblem(a, L, [pair], bcs) as problem:

        def turned_to(angle: float) -> tuple[float, float, ContactSolution]:
            """Turn the upper end, and return the normal force, the moment and the solution."""
            end.interpolate(
                lambda x: np.stack([-angle * x[1], angle * x[0], np.full_like(x[0], -APPROACH)])
            )
            solution = next_step(problem)
            (acting,) = solution.pair_resultants
            return abs(acting.force[2]), -acting.about(np.zeros(3)).moment[2], solution

        force, _, _ = turned_to(0.0)
        modulus = 0.5 * plane_strain_modulus(YOUNG, POISSON)
        radius = (0.75 * force * 0.5 * RADIUS / modulus) ** (1 / 3)
        peak, stiffness = 1.5 * force / (math.pi * radius**2), YOUNG / (2.0 * (1.0 + POISSON))
        slope, all_slips = COEFFICIENT * peak / stiffness, COEFFICIENT * force * radius
        moments, squares = [0.0], [0.0]
        for angle in ANGLES[1:]:
            _, found, solution = turned_to(angle * slope)
            moments.append(found / all_slips)
            points, fields = surface_nodes_of(solution)
            (x, y, _), (qx, qy, _) = points.T, fields["traction"].T
            square = x**2 + y**2
            shear = np.abs(x * qy - y * qx) / np.sqrt(np.maximum(square, 1e-30))
            short = fields["weights"] * (COEFFICIENT * fields["pressure"] - shear)
            second, whole = comm.allreduce(np.array([short @ square, short.sum()]))
            squares.append(second / whole / radius**2)
        back, full = (turned_to(angle * slope)[1] / all_slips for angle in (0.0, FAR))
    last, half = ANGLES[-1], len(ANGLES) // 2
    values = CASE.named(
        moments[-1] / moment(last),
        math.sqrt(squares[half] / mean_square(ANGLES[half])),
        back / (moment(last) - 2.0 * moment(0.5 * last)),
        full / moment(FAR),
    )
    return Result(values, V, ANGLES, np.array(moments))


X = np.linspace(0.0, ANGLES[-1], 201)
CASE = Case.read(__file__, solve, curve=(X, np.array([0.0, *map(moment, X[1:])])))
