"""Solve the crossed cylinders: one elastic, a quarter of a block; the other rigid."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np
from case import Case, Result, half_ellipse, next_step, peak_of
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from dolfinx_tresca import ContactPair, ContactProblem, Frictionless, RigidCylinder
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed, no_load
from scenes.hertz_theory import plane_strain_modulus
from scenes.nodal import gathered, surface_nodes_of

YOUNG, POISSON = 1000.0, 0.3  # MPa, -
RADIUS, RIGID_RADIUS = 1000.0, 3000.0  # mm
WIDTH, APPROACH, GRADING = 1.0, 1e-5, 3.0  # mm, mm, as in scenes/cattaneo.py

TOP, BOTTOM, SIDES = 1, 2, (3, 4)


def theory(force: float) -> tuple[float, float, float]:
    """Return the long and the short semi-axis [mm] and the peak pressure [MPa] for a force [N]."""
    short, long = sorted((RADIUS, RIGID_RADIUS))

    def moments(ratio: float) -> tuple[float, float, float]:
        m = 1.0 - ratio**-2  # e^2, for the ratio of the axes
        return m, ratio**2 * ellipe(m) - ellipk(m), ellipk(m) - ellipe(m)

    def off(ratio: float) -> float:
        _, first, second = moments(ratio)
        return first / second - long / short

    ratio = brentq(off, 1.0 + 1e-6, 100.0)
    m, first, second = moments(ratio)
    size = 0.75 * force * math.sqrt(short * long) / plane_strain_modulus(YOUNG, POISSON)
    product = (size * 4 / (math.pi * m) * ratio**-1.5 * math.sqrt(first * second)) ** (2 / 3)
    return math.sqrt(product * ratio), math.sqrt(product / ratio), 1.5 * force / math.pi / product


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along a side. Collective."""

    def graded(x: np.ndarray) -> np.ndarray:
        y = WIDTH * np.sinh(GRADING * x) / np.sinh(GRADING)
        y[:, 2] -= y[:, 0] ** 2 / (2 * RADIUS) * (1 + x[:, 2])
        return y

    def at(axis: int, place: float):
        return lambda x: np.abs(x[:, axis] - place) < 1e-9

    body = Body((int(n), int(n) // 2), [(0.0, 1.0), (0.0, 1.0), (-1.0, 0.0)], move=graded)
    made = boxes(comm, "hexahedron", [body], 1)
    places = {TOP: (2, 0.0), BOTTOM: (2, -1.0), SIDES[0]: (0, 0.0), SIDES[1]: (1, 0.0)}
    tags = made.tags(*((tag, [0], at(*place)) for tag, place in places.items()))
    V = made.V
    rigid = RigidCylinder((0.0, 0.0, RIGID_RADIUS), (1.0, 0.0, 0.0), RIGID_RADIUS)
    pair = ContactPair(tags, TOP, rigid, Frictionless())
    bcs = [fixed(V, tags.find(BOTTOM), (0.0, 0.0, APPROACH))]
    bcs += [fixed(V, tags.find(side), 0.0, axis) for axis, side in enumerate(SIDES)]
    with ContactProblem(elasticity(V, YOUNG, POISSON), no_load(V), [pair], bcs) as problem:
        points, fields = surface_nodes_of(next_step(problem))
        points, p, weights = gathered(comm, points, fields["pressure"], fields["weights"])
    force = float(weights @ p)
    second = (weights * p) @ points[:, :2] ** 2 / force  # a fifth of the squares of the semi-axes
    long, short, peak = theory(4 * force)
    x, y = points[:, 0] / short, points[:, 1] / long  # the rigid cylinder is flat along x
    axes = (5 * second[1]) ** 0.5 / long, (5 * second[0]) ** 0.5 / short
    values = CASE.named(*axes, peak_of(np.hypot(x, y), p) / peak)
    along = np.flatnonzero((points[:, 0] < 1e-9) & (y < 1.4))
    along = along[np.argsort(y[along])]
    return Result(values, V, y[along], p[along] / peak)


X = np.linspace(0.0, 1.4, 281)
CASE = Case.read(__file__, solve, curve=(X, half_ellipse(X)))
