"""Derivatives of goals: against central differences where no node changes its state."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactForce,
    Coulomb,
    InputError,
    MeanPressure,
    MeanSlip,
    NormalForce,
    Tresca,
)
from scenes.elasticity import elasticity
from scenes.two_bricks import two_bricks

#: Residual of the solves; step of central differences of order 4 over the control. (With order 2
#: either their error or the residuals over the step are 1e-6 of some derivatives.)
RTOL, STEP = 1e-12, 5e-4

#: Error of central differences that the solves' residuals and the step allow, over the derivative.
ACCURACY = 1e-6

LAWS = {
    "tresca": lambda c: Tresca(c),
    "coulomb": lambda c: Coulomb(c),
    "limited": lambda c: Coulomb(c, limit=0.2),
}


class Bricks:
    """Two bricks whose modulus, loads and friction are controls."""

    def __init__(self, comm, law, n=3):
        scene = two_bricks(comm, n)
        mesh, V = scene.mesh, scene.V
        self.friction = fem.Constant(mesh, 0.09 if law == "tresca" else 0.31)
        self.young = fem.Constant(mesh, 5e4)
        self.poisson = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="Poisson")
        self.poisson.x.array[:] = 0.3
        self.load = fem.Constant(mesh, (0.3, 0.05, -1.0))
        self.pressure = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="pressure")
        self.pressure.interpolate(lambda x: 0.1 + 0.2 * x[0])
        v = ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=scene.facet_tags)
        top = ds(scene.tags["upper_top"])
        L = ufl.inner(self.load, v) * top - self.pressure * v[2] * top
        scene = scene.but(friction=LAWS[law](self.friction))
        self.problem = scene.problem(
            a=elasticity(V, self.young, self.poisson), L=L, stiffness="cholesky"
        )

    def value(self, goal):
        """Return a goal of the solution for the present controls."""
        self.problem.update_stiffness()
        self.problem.solve(rtol=RTOL).raise_if_failed()
        return self.problem.goal_error(goal).value


GOALS = [
    NormalForce(),
    ContactForce(direction=(1.0, 0.0, 0.2)),
    MeanPressure(point=(1.5, 0.5, 1.0), radius=1.0),
    MeanSlip(point=(1.5, 0.5, 1.0), radius=1.0, direction=(1.0, 0.0, 0.0)),
]


@pytest.mark.parallel(law=["coulomb"])
@pytest.mark.parametrize("law", LAWS)
def test_central_differences(comm, law):
    """Of each goal with respect to the modulus, a load and friction: numbers of one kind each."""
    bricks = Bricks(comm, law)
    controls = [bricks.young, bricks.load, bricks.friction]
    with bricks.problem as problem:
        problem.solve(rtol=RTOL).raise_if_failed()
        found = [problem.gradient(goal, controls) for goal in GOALS]
        for k, control in enumerate(controls):
            start = np.array(control.value, dtype=float)
            for i in range(start.size):
                size = STEP * max(abs(start.flat[i]), 0.1)
                values = []
                for steps in (1.0, -1.0, 2.0, -2.0):
                    changed = start.copy()
                    changed.flat[i] += steps * size
                    control.value = changed if changed.shape else float(changed)
                    values.append([bricks.value(goal) for goal in GOALS])
                control.value = start if start.shape else float(start)
                differences = np.array([8.0, -8.0, -1.0, 1.0]) @ values / (12.0 * size)
                for one, wanted, value in zip(found, differences, values[0], strict=True):
                    scale = max(abs(wanted), abs(value) / max(np.abs(start).max(), 0.1))
                    assert abs(np.ravel(one[k])[i] - wanted) <= ACCURACY * scale


@pytest.mark.parallel
def test_functions(comm):
    """Taylor's remainders along random directions fall by four where steps are halved."""
    bricks = Bricks(comm, "coulomb")
    controls = [bricks.poisson, bricks.pressure]
    goal = ContactForce(direction=(1.0, 0.0, 1.0))
    with bricks.problem as problem:
        start = bricks.value(goal)
        derivatives = problem.gradient(goal, controls)
        for control, derivative in zip(controls, derivatives, strict=True):
            before = control.x.array.copy()
            direction = fem.Function(control.function_space)
            direction.interpolate(lambda x: 0.02 * np.cos(x[0] + 2.0 * x[1]))
            owned = control.function_space.dofmap.index_map.size_local
            slope = comm.allreduce(derivative.x.array[:owned] @ direction.x.array[:owned])
            remainders = []
            for size in (0.02, 0.01):
                control.x.array[:] = before + size * direction.x.array
                remainders.append(abs(bricks.value(goal) - start - size * slope))
            control.x.array[:] = before
            rounding = 1e3 * RTOL * abs(start)
            assert remainders[1] <= 0.3 * remainders[0] + rounding
            assert remainders[0] <= 0.02 * abs(0.02 * slope) + rounding


def test_wrong_controls(comm):
    """Each error says what may be given."""
    bricks = Bricks(comm, "tresca")
    with bricks.problem as problem:
        with pytest.raises(ContactError, match=r"no solution for a derivative: call solve\(\)"):
            problem.gradient(NormalForce(), [bricks.young])
        problem.solve()
        for control, message in (
            (3.0, r"must be a fem\.Constant or a fem\.Function, found 3"),
            (fem.Function(bricks.pressure.function_space), "neither a nor L depends"),
        ):
            with pytest.raises(InputError, match=message):
                problem.gradient(NormalForce(), [control])
        bricks.young.value *= 1.1
        with pytest.raises(ContactError, match=r"call update_stiffness\(\) and solve\(\)"):
            problem.gradient(NormalForce(), [bricks.young])


def test_bounds_that_are_expressions(comm):
    """A Constant inside of an expression of a bound is refused: its derivative is not known."""
    scene = two_bricks(comm, 2)
    part = fem.Constant(scene.mesh, 0.5)
    with scene.but(friction=Tresca(0.1 * part)).problem() as problem:
        problem.solve()
        with pytest.raises(InputError, match="of an ellipse or of an expression"):
            problem.gradient(NormalForce(), [part])
