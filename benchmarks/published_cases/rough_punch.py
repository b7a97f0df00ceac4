"""Solve the flat punch that slips at its edges, and the integral equations of its theory."""

from __future__ import annotations

from bisect import bisect_left
from functools import cache

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface, next_step
from punch import POISSON, under_punch

from dolfinx_tresca import ContactState, Coulomb

COEFFICIENT = 0.5

#: Factor of the tangential displacement that a pressure causes, (1 - 2 nu) / (2 (1 - nu)).
COUPLING = (1.0 - 2.0 * POISSON) / (2.0 * (1.0 - POISSON))

#: Number of strips on half the contact; with twice as many, values change by at most 1e-5 of
#: themselves.
STRIPS = 300


def strip_ends() -> np.ndarray:
    """Return the ends (n + 1,) of the strips of half the contact."""
    return np.asarray(np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, STRIPS + 1)))


def inside_of_strips() -> np.ndarray:
    """Return the part (n,) of each strip that lies in the inner half of the contact."""
    ends = strip_ends()
    return np.asarray(np.clip((0.5 - ends[:-1]) / np.diff(ends), 0.0, 1.0))


@cache
def theory() -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Return the end of the stick zone, and positions, pressures and shear stresses of the strips.

    Displacements are divided by 2 (1 - nu^2) / E. The half width is 1 and the force is pi, so
    pressures are divided by P / (pi a). Pressures are even and shear stresses are odd functions of
    x. The middles of all strips move down by the same distance; each middle sticks, or its shear
    stress is F p.
    """
    ends = strip_ends()
    x, width = 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)

    def log_integrals(y: np.ndarray) -> np.ndarray:
        """Return integrals of log |y - s| over the strips (n, n)."""
        d = y[:, None] - ends
        primitive = d * np.log(np.maximum(np.abs(d), 1e-300)) - d
        return np.asarray(primitive[:, :-1] - primitive[:, 1:])

    near, far = log_integrals(x), log_integrals(-x)
    until = np.tril(np.ones((STRIPS, STRIPS)), -1) * width + np.diag(0.5 * width)
    down = np.block([-(near + far) / np.pi, COUPLING * until])
    aside = np.block([-COUPLING * until, -(near - far) / np.pi])
    load = np.concatenate([width, np.zeros(STRIPS)]) / (0.5 * np.pi)
    law = np.block([-COEFFICIENT * np.eye(STRIPS), np.eye(STRIPS)])
    right = np.zeros(2 * STRIPS)
    right[STRIPS - 1] = 1.0

    def solved(sticks: int) -> tuple[np.ndarray, np.ndarray]:
        """Return pressures and shear stresses if the first `sticks` strips stick."""
        rows = np.vstack([down[1:] - down[0], load, aside[:sticks], law[sticks:]])
        p, q = np.split(np.linalg.solve(rows, right), 2)
        return p, q

    def slips(sticks: int) -> bool:
        """Return whether the last one of `sticks` sticking strips exceeds F p."""
        p, q = solved(sticks)
        return bool(q[sticks - 1] > COEFFICIENT * p[sticks - 1])

    last = 1 + bisect_left(range(2, STRIPS), True, key=slips)
    p, q = solved(last)
    return float(ends[last]), x, p, q


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the edge of the punch. Collective."""
    with under_punch(comm, h, Coulomb(COEFFICIENT)) as problem:
        solution = next_step(problem)
        names = ("pressure", "traction", "state", "weights")
        x, p, q, state, weights = along_surface(comm, solution, *names)
    q, half_force = np.abs(q), float(weights @ p)
    sticks = state == ContactState.STICK
    values = CASE.named(
        weights[sticks].sum(),
        np.trapezoid(*within(x, p)) / half_force,
        weights @ q / (2.0 * half_force),
    )
    return Result(values, solution.u.function_space, x, np.pi * q / (2.0 * half_force))


def within(x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes in the inner half of the contact: pressures and positions, with its end."""
    inside = x < 0.5
    return np.append(p[inside], np.interp(0.5, x, p)), np.append(x[inside], 0.5)


C, X, P, Q = theory()
WIDTHS = np.diff(strip_ends())
CASE = Case.read(
    __file__,
    solve,
    C,
    float(WIDTHS @ (P * inside_of_strips())) * 2.0 / np.pi,
    float(WIDTHS @ Q) / np.pi,
    curve=(X[X < 0.98], Q[X < 0.98]),
)
