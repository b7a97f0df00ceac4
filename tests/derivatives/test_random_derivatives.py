"""Derivatives of random scenes against central differences.

Where no node changes its state between the solutions, both agree.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from rubbing_controls import along, values_of

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    MeanSlip,
    Tresca,
)
from scenes.elasticity import elasticity, fixed
from scenes.patches import BOTTOM, LOWER, TOP, UPPER
from scenes.random_blocks import RandomBlocks

#: Residual of the solves; change of all controls, over their sizes.
RTOL, STEP = 1e-12, 1e-4

#: Difference of the derivative and the central difference, over the derivative; goals of which it
#: is this part are known to their residuals over the step.
ACCURACY, PART = 1e-6, 1e-2

#: Random scenes of `make test`, and of `make test-long`.
FEW, MANY = 2, 300

#: Difference of gradient and tangent, over the goal or the largest term of the sum over controls.
TRANSPOSED = 1e-8


def as_direction(control, values):
    """Return a change of a control as the argument of a tangent."""
    if isinstance(control, fem.Constant):
        return values
    result = fem.Function(control.function_space)
    result.x.array[:] = values
    return result


def states(solution) -> list[float]:
    """Return the states of all nodes."""
    return solution.surfaces[0].state.x.array.tolist()


def compare(comm, seed: int) -> Counter:
    """Compare all goals of a random scene along a random direction; count how it was compared."""
    drawn = RandomBlocks.drawn(seed, dim=2 + seed % 2)
    scene = drawn.coarse(comm)
    rng = np.random.default_rng([7, seed])
    mesh, V = scene.mesh, scene.V
    dim = mesh.geometry.dim
    young, bound = fem.Constant(mesh, drawn.young), fem.Constant(mesh, 1.0)
    load = fem.Constant(mesh, rng.uniform(-0.5, 0.5, dim))
    gap = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="gap")
    gap.interpolate(lambda x: 1e-4 * (1.0 + x[0]))
    moved = fem.Function(V, name="moved")
    moved.interpolate(drawn._moved)
    law = drawn.friction
    if isinstance(law, Tresca):
        bound.value, law = law.slip_bound, Tresca(bound)
    elif isinstance(law, Coulomb):
        bound.value, law = law.coefficient, Coulomb(bound)
    a = elasticity(V, young, drawn.poisson)
    L = ufl.inner(load, ufl.TestFunction(V)) * ufl.dx
    top = fem.locate_dofs_topological(V, dim - 1, scene.facet_tags.find(TOP))
    bcs = [fem.dirichletbc(moved, top), fixed(V, scene.facet_tags.find(BOTTOM))]
    pair = ContactPair(scene.facet_tags, UPPER, LOWER, law, gap=gap)
    controls = [young, load, gap, moved]
    if not isinstance(law, Frictionless):
        controls.append(bound)
    start = [values_of(one).copy() for one in controls]
    sizes = [np.abs(one).max() for one in start]
    directions = [
        size * rng.uniform(-1.0, 1.0, one.shape) for size, one in zip(sizes, start, strict=True)
    ]
    directions[3][:] = sizes[3] * rng.uniform(-1.0, 1.0) * start[3] / sizes[3]
    goals = list(drawn.goals().values())
    count: Counter = Counter()
    with ContactProblem(a, L, [pair], bcs, stiffness="cholesky") as problem:

        def solve(factor: float):
            for one, before, direction in zip(controls, start, directions, strict=True):
                values_of(one)[...] = before + factor * direction
            problem.update_stiffness()
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            return solution

        def numbers() -> np.ndarray:
            return np.array([problem.goal_value(goal) for goal in goals])

        least = [sizes[3] if isinstance(one, MeanSlip) else 0.0 for one in goals]

        def slopes(values: np.ndarray) -> np.ndarray:
            """Return the derivatives of all goals, one of them by its gradient as well."""
            along_all = [as_direction(one, d) for one, d in zip(controls, directions, strict=True)]
            tangent = problem.tangent(controls, along_all)
            found = np.array([tangent.of(goal) for goal in goals])
            k = seed % len(goals)
            parts = problem.gradient(goals[k], controls)
            terms = [along(one, d) for one, d in zip(parts, directions, strict=True)]
            size = max(*np.abs(terms), abs(values[k]), least[k])
            assert abs(sum(terms) - found[k]) <= TRANSPOSED * size, (seed, terms, found[k])
            return found

        first = solve(0.0)
        there, values = states(first), numbers()
        at_start = slopes(values)
        known = np.maximum(np.abs(values), least)
        differences, same = [], True
        for factor in (STEP, -STEP):
            same &= states(solve(factor)) == there
            differences.append(numbers())
        if same:
            wanted = (differences[0] - differences[1]) / (2.0 * STEP)
            error = np.abs(wanted - at_start) / np.maximum(np.abs(at_start), PART * known)
            assert (error <= ACCURACY).all(), (seed, error)
            count["equal"] += 1
        else:
            count["states change"] += 1
    return count


@pytest.mark.parametrize("seed", range(FEW))
def test_some_random_scenes(comm, seed):
    """A scene in 2D and one in 3D."""
    assert compare(comm, seed)["equal"] == 1


@pytest.mark.long
def test_many_random_scenes(comm):
    """Three hundred of them."""
    count = sum((compare(comm, seed) for seed in range(FEW, FEW + MANY)), Counter())
    print(count)
    assert count["equal"] > 0.9 * MANY
