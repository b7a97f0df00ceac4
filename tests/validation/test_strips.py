"""Two slender strips, clamped at an end and pressed on each other: they stick, or slide if bent."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import Bonded, ContactPair, ContactProblem, Coulomb
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity

LENGTH, THICKNESS, YOUNG, PRESSURE, FRICTION = 200.0, 5.0, 70e3, 0.2, 0.3
CLAMPED, TIP, BELOW, ABOVE, UPPER, LOWER = range(1, 7)


def pressed_strips(comm, cells: int, degree: int, law):
    """Return the problem, and the shear force at the tip [force per thickness]."""
    spans = [(0.0, THICKNESS), (THICKNESS, 2.0 * THICKNESS)]
    bodies = [Body((cells, 2), [(0.0, LENGTH), span]) for span in spans]
    made = boxes(comm, "quadrilateral", bodies, degree)

    def near(axis: int, value: float):
        return lambda x: np.abs(x[:, axis] - value) < 1e-6

    both = [0, 1]
    tags = made.tags(
        (CLAMPED, both, near(0, 0.0)),
        (TIP, both, near(0, LENGTH)),
        (BELOW, [0], near(1, 0.0)),
        (ABOVE, [1], near(1, 2.0 * THICKNESS)),
        (UPPER, [1], near(1, THICKNESS)),
        (LOWER, [0], near(1, THICKNESS)),
    )
    V, shear = made.V, fem.Constant(made.mesh, 0.0)
    v, ds = ufl.TestFunction(V), ufl.Measure("ds", domain=made.mesh, subdomain_data=tags)
    L = PRESSURE * v[1] * ds(BELOW) - PRESSURE * v[1] * ds(ABOVE)
    L += shear / (2.0 * THICKNESS) * v[1] * ds(TIP)
    clamped = fem.locate_dofs_topological(V, 1, tags.find(CLAMPED))
    bcs = [fem.dirichletbc(np.zeros(2), clamped, V)]
    pairs = [ContactPair(tags, UPPER, LOWER, law)]
    return ContactProblem(elasticity(V, YOUNG, 0.0), L, pairs, bcs), shear


@pytest.mark.parallel(cells=[100])
@pytest.mark.parametrize(("cells", "degree"), [(100, 1), (100, 2), (400, 1)])
def test_strips_that_stick(comm, cells, degree):
    """They are as if they were bonded; far from the clamped end the pressure is that of the load.

    Slender bodies bend a million times as much as their surfaces are pressed in, so that pressures
    have larger errors than the residual.
    """
    found = []
    for law in (Coulomb(FRICTION), Bonded()):
        problem, _ = pressed_strips(comm, cells, degree, law)
        with problem:
            solution = problem.solve(rtol=1e-9)
        solution.raise_if_failed()
        found.append((solution.normal_force, solution.pressure.x.array.copy()))
        far = solution.surface.points[:, 0] > 0.5 * LENGTH
        near = solution.surface.weights > 0.0
        assert solution.surface.pressure.x.array[far & near] == pytest.approx(PRESSURE, 1e-2)
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-4)
    assert np.abs(found[0][1] - found[1][1]).max(initial=0.0) <= 5e-3 * PRESSURE


def test_strips_that_are_bent_and_let_go(comm):
    """The joint carries the load that the clamped end does not, at each of three steps."""
    problem, shear = pressed_strips(comm, 100, 2, Coulomb(FRICTION))
    with problem:
        for value in (0.8, 0.4, 0.0):
            shear.value = value
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            assert solution.normal_force == pytest.approx(PRESSURE * LENGTH, rel=0.02)
