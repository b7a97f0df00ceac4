"""Solve partial slip of two cylinders, one of them under tension."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
from case import Case, Result, half_ellipse, next_step

import ufl
from dolfinx import fem

from scenes.cattaneo import BOTTOM, COEFFICIENT, POISSON, TOP, YOUNG, Cattaneo, cattaneo
from scenes.cattaneo_cycle import APPROACH, Found
from scenes.elasticity import fixed

#: Tension divided by mu p0; approach [mm]; shift divided by the approach.
TENSION, DEPTH, SHIFT = 0.6, 4 * APPROACH[2], -0.3

#: Half width of the stick zone divided by that of the contact, for the shear force of this shift.
STICK = 0.7015

MODULUS = YOUNG / (1.0 - POISSON[2] ** 2)


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along a body; on one rank."""
    scene = cattaneo(comm, 2, int(n), approach=DEPTH)
    V, end = scene.V, scene.data.end
    stretch = fem.Function(V)  # displacement of the lower body, of height 1, without contact
    tension = fem.Constant(V.mesh, 0.0)
    x = ufl.SpatialCoordinate(V.mesh)
    side = ufl.conditional(ufl.lt(x[1], 0.0), ufl.sign(x[0]), 0.0)
    side *= ufl.conditional(ufl.gt(abs(x[0]), 1.0 - 1e-9), 1.0, 0.0)
    below = fem.locate_dofs_topological(V, 1, scene.facet_tags.find(BOTTOM))
    bcs = [
        fixed(V, scene.facet_tags.find(TOP), end),
        fem.dirichletbc(stretch, below),
    ]
    L = tension * side * ufl.TestFunction(V)[0] * ufl.ds
    with replace(scene, L=L, bcs=bcs).problem(stiffness="cholesky") as problem:
        pressed = Found.of(next_step(problem), 2)
        peak = Cattaneo(2, pressed.force(pressed.pressure), 0.0).peak
        tension.value = TENSION * COEFFICIENT * peak
        strain = float(tension.value) / MODULUS
        across = POISSON[2] / (1.0 - POISSON[2]) * strain
        stretch.interpolate(lambda x: np.stack([strain * x[0], np.full_like(x[0], across)]))
        end.value[0] = SHIFT * DEPTH
        solution = next_step(problem)
        found = Found.of(solution, 2)
    place = solution.surface.points[:, 0]
    normal, tangential = found.force(found.pressure), found.force(found.traction)
    theory, sign = Cattaneo(2, normal, abs(tangential)), np.sign(tangential)
    short = found.areas * (COEFFICIENT * found.pressure - sign * found.traction)
    middle = float(short @ place / short.sum())
    width = 2.0 * float(np.sqrt(short @ (place - middle) ** 2 / short.sum()))
    shift = float(tension.value) * theory.radius / (4.0 * COEFFICIENT * theory.peak)
    values = CASE.named(abs(middle) / shift, width / theory.stick_radius(tangential))
    along = np.sign(middle) * place / theory.radius
    order = np.argsort(along)
    order = order[abs(along[order]) < 1.2]
    shear = sign * found.traction[order] / (COEFFICIENT * theory.peak)
    return Result(values, V, along[order], shear)


def shear_stress(x: np.ndarray) -> np.ndarray:
    """Return shear stresses (n,) / (mu p0) at positions (n,) / (half width of the contact)."""
    return half_ellipse(x) - STICK * half_ellipse((x - 0.25 * TENSION) / STICK)


X = np.linspace(-1.2, 1.2, 481)
CASE = Case.read(__file__, solve, curve=(X, shear_stress(X)))
