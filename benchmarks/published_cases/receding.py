"""Solve the receding contact of a layer, and the integral equation of its theory."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from mpi4py import MPI

import numpy as np
from case import Case, Result, along_surface, bodies, measure_on, next_step, pair_of

import ufl
from dolfinx import fem

from dolfinx_tresca import Frictionless

YOUNG, POISSON, FORCE, LOADED = 1.0, 0.3, 1e-4, 0.05  # -, -, per thickness, half width of load

#: Distance between the points of the integral equation, and position of the last point.
STEP, END = 0.02, 1.8

#: Number of wave numbers for the integrals up to the first limit, and again between both limits.
WAVES, LIMITS = 10_000, (20.0, 40.0 / STEP)


@cache
def theory() -> tuple[np.ndarray, np.ndarray]:
    """Return distances from the middle, and pressures divided by the force.

    A layer of thickness 1 under waves of pressure p below and q on top is squeezed and bent. With
    the wave number s its lower face moves by ((S + B) p - (B - S) q) / (E* s), and the face of the
    half-plane moves by -2 p / (E* s). The pressure is a sum of hat functions, each with a share of
    the force; where the pressure is positive, both faces have the same displacement.
    """
    parts = np.array([LIMITS[0], LIMITS[1] - LIMITS[0]]) / WAVES
    middles = np.arange(WAVES) + 0.5
    s = np.concatenate([parts[0] * middles, LIMITS[0] + parts[1] * middles])
    t = np.minimum(s, 300.0)  # beyond this wave number both factors are 1
    squeezed = (np.cosh(t) - 1) / (np.sinh(t) + t)
    bent = (np.cosh(t) + 1) / np.where(t < 0.05, t**3 / 6 * (1 + t**2 / 20), np.sinh(t) - t)
    strip, hat = np.sinc(s * LOADED / np.pi), np.sinc(s * STEP / 2 / np.pi) ** 2
    x = STEP * np.arange(round(END / STEP))
    waves = np.cos(np.outer(x, s))
    relative = (waves - 1.0) / s * np.repeat(parts, WAVES)  # to the displacement of the middle
    # subtract the infinite bending by the total of the shares, which is 1: the rest is finite
    matrix = relative @ ((squeezed + bent + 2) * (hat * waves - 1.0)).T
    gap = -relative @ (bent * (1 - strip) + squeezed * (1 + strip) + 2)
    for n in range(len(x), 0, -1):
        ones = np.ones((n, 1))
        system = np.block([[matrix[:n, :n], ones], [ones.T, np.zeros((1, 1))]])
        shares = np.linalg.solve(system, [*gap[:n], 1.0])[:-1]
        if shares[-1] >= 0.0:
            break
    return x[:n], shares / STEP / np.where(x[:n] > 0.0, 2.0, 1.0)


def half_width(x: np.ndarray, p: np.ndarray) -> float:
    """Return the end of contact: the zero of a line through the squares of small pressures."""
    edge = (p > 0.03 * p.max()) & (p < 0.3 * p.max())
    slope, square = np.polyfit(x[edge], p[edge] ** 2, 1)
    return float(-square / slope)


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the contact. Collective."""
    layer = bodies(comm, "receding.geo", YOUNG, POISSON, h=h, Growth=2 * h, Load=LOADED)
    load = fem.Constant(layer.mesh, (0.0, 0.0))
    scene = replace(
        layer,
        L=ufl.inner(load, ufl.TestFunction(layer.V)) * measure_on(layer, "load"),
        bcs=[layer.fixed("bottom"), layer.fixed("symmetry", 0.0, 0)],
        pairs=[pair_of(layer, "layer_contact", "block_contact", Frictionless())],
    )
    widths = []
    with scene.problem() as problem:
        for force in (100 * FORCE, FORCE):
            load.value[1] = -0.5 * force / LOADED
            x, p, weights = along_surface(comm, next_step(problem), "pressure", "weights")
            p = p / force
            widths.append(half_width(x, p))
    values = CASE.named(widths[1], widths[0] / widths[1], rms(x, weights * p))
    return Result(values, scene.V, x, p)


def rms(x: np.ndarray, forces: np.ndarray) -> float:
    """Return the root mean square distance of forces from the middle."""
    return float(np.sqrt(forces @ x**2 / forces.sum()))


X, P = theory()
CASE = Case.read(
    __file__,
    solve,
    half_width(X, P),
    1.0,
    rms(X, P * np.where(X > 0, 2.0, 1.0)),
    curve=(np.append(X, X[-1] + STEP), np.append(P, 0.0)),
)
