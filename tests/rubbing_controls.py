"""Two blocks that rub on each other, whose data are controls of all types, and their directions."""

from __future__ import annotations

import dataclasses

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactForce,
    ContactProblem,
    ContactSolution,
    Coulomb,
    Frictionless,
    MeanPressure,
    MeanSlip,
    NormalForce,
    PressureNorm,
    Tresca,
)
from scenes.elasticity import elasticity
from scenes.rubbing import rubbing

#: Residual of the solves that differences are taken of.
RTOL = 1e-12


def values_of(control) -> np.ndarray:
    """Return the values of a control, as an array that shares their memory."""
    return control.value if isinstance(control, fem.Constant) else control.x.array


def smooth(control) -> np.ndarray:
    """Return a direction in which a control is changed, the same on any number of ranks."""
    if isinstance(control, fem.Constant):
        return np.cos(np.arange(control.value.size) + 0.3).reshape(control.value.shape)
    wave = fem.Function(control.function_space)
    if control.ufl_shape == ():
        wave.interpolate(lambda x: np.cos(2.0 * x[0] + x[1]))
    else:
        wave.interpolate(lambda x: np.array([np.cos(i + x[0]) for i in range(len(control))]))
    return wave.x.array


def direction_of(control):
    """Return the direction of `smooth` as the argument of a tangent."""
    if isinstance(control, fem.Constant):
        return smooth(control)
    result = fem.Function(control.function_space)
    result.x.array[:] = smooth(control)
    return result


def along(derivative, direction) -> float:
    """Return the derivative along a direction: a sum over the values of a control."""
    if not isinstance(derivative, fem.Function):
        return float(np.sum(derivative * direction))
    index_map, size = derivative.x.index_map, derivative.x.block_size
    owned = index_map.size_local * size
    return index_map.comm.allreduce(float(derivative.x.array[:owned] @ direction[:owned]))


def solved(problem: ContactProblem) -> ContactSolution:
    """Return the solution of linear bodies for the present controls."""
    problem.update_stiffness()
    solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    return solution


GOALS = [
    NormalForce(),
    ContactForce(direction=(1.0, 0.2)),
    MeanPressure(point=(0.3, 1.0), radius=0.5),
    MeanSlip(point=(0.3, 1.0), radius=0.5, direction=(1.0, 0.0)),
    PressureNorm(exponent=8.0),
]


def in_3d(goal):
    """Return a goal of the section as one of the body."""
    added = {
        name: (*getattr(goal, name), 0.3) if name == "direction" else (0.3, 0.5, 1.0)
        for name in ("direction", "point")
        if hasattr(goal, name)
    }
    return dataclasses.replace(goal, **added)


class Rubbing:
    """Two blocks whose modulus, load, end, gap and friction are controls of all types."""

    def __init__(self, comm, kind, degree=1, law="coulomb", upper=(3, 2), distort=0.3, **changes):
        scene = rubbing(comm, kind, degree, upper=upper, distort=distort)
        mesh, V = scene.mesh, scene.V
        self.goals = GOALS if mesh.geometry.dim == 2 else [in_3d(one) for one in GOALS]
        Q = fem.functionspace(mesh, ("Lagrange", 1))
        self.young = fem.Constant(mesh, 1000.0)
        self.poisson = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="Poisson")
        self.poisson.x.array[:] = 0.3
        self.load = fem.Constant(mesh, np.full(mesh.geometry.dim, 0.2))
        self.end = scene.data.exact
        self.coefficient, self.profile = fem.Function(Q, name="F"), fem.Function(Q, name="profile")
        self.coefficient.interpolate(lambda x: 0.25 + 0.1 * x[0])
        self.profile.interpolate(lambda x: 1e-4 * (1.0 + x[0]))
        self.factor, self.offset = fem.Constant(mesh, 1.1), fem.Constant(mesh, 1e-4)
        self.bound = fem.Constant(mesh, 0.8 if law == "coulomb" else 0.5)
        laws = {
            "coulomb": Coulomb(self.factor * self.coefficient, limit=self.bound),
            "tresca": Tresca(self.bound * (1 + self.coefficient)),
            "ellipse": Coulomb(
                (self.factor * self.coefficient, self.bound), direction=(1.0, 0.4, 0.0)
            ),
            "curve": Coulomb(self.curve),
            "frictionless": Frictionless(),
        }
        pair = dataclasses.replace(
            scene.pair, friction=laws[law], gap=self.profile + self.offset, **changes
        )
        self.a = elasticity(V, self.young, self.poisson)
        self.L = ufl.inner(self.load, ufl.TestFunction(V)) * ufl.dx
        self.arguments = self.a, self.L, [pair], scene.bcs
        self.controls = [self.young, self.poisson, self.load, self.end, self.profile, self.offset]
        if law in ("coulomb", "tresca"):
            self.controls += [self.coefficient]
        if law in ("coulomb", "tresca", "curve"):
            self.controls += [self.bound]
        if law in ("coulomb", "curve"):
            self.controls += [self.factor]

    def curve(self, p, v):
        """Return a coefficient of friction that reads two Constants."""
        return 0.3 * float(self.factor.value) / (1.0 + 0.2 * p / self.bound.value) + 0.0 * v
