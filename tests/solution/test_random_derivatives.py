"""Derivatives of random scenes against central differences, and one-sided ones where states change.

Where no node changes its state between the solutions, both agree. Where one does, the difference of
two solutions over the change is a mean of the derivatives in between: it is between those at both
solutions, which are one-sided derivatives on the two sides of the change of state.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from rubbing_controls import along, values_of

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, Frictionless, MeanSlip, Tresca
from scenes.elasticity import elasticity, fixed
from scenes.patches import BOTTOM, LOWER, TOP, UPPER
from scenes.random_blocks import RandomBlocks

#: Residual of the solves; change of all controls, over their sizes.
RTOL, STEP = 1e-12, 2e-4

#: Difference of the derivative and the central difference of order 4, over the derivative, and over
#: the goal and the relative change of controls: residuals over the step.
ACCURACY, RESIDUALS = 1e-6, 1e-8

#: How far the mean may be outside of derivatives at both ends, over them: their change between the
#: ends on one branch is some multiples of the step.
BRANCHES = 20 * STEP

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
    load, gap = fem.Constant(mesh, rng.uniform(-0.5, 0.5, dim)), fem.Constant(mesh, 1e-4)
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
            values = np.array([problem.goal_value(goal) for goal in goals])
            return states(solution), values

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

        there, values = solve(0.0)
        at_start = slopes(values)
        results = {factor: solve(factor * STEP) for factor in (1.0, -1.0, 2.0, -2.0)}
        known = np.maximum(np.abs(values), least)
        scale = np.maximum(np.abs(at_start), RESIDUALS / ACCURACY * known)
        if all(states_now == there for states_now, _ in results.values()):
            found = {factor: one for factor, (_, one) in results.items()}
            wanted = 8.0 * (found[1.0] - found[-1.0]) - (found[2.0] - found[-2.0])
            error = np.abs(wanted / (12.0 * STEP) - at_start) / scale
            assert (error <= ACCURACY).all(), (seed, error)
            count["equal"] += 1
            return count
        if results[1.0][0] == there == results[-1.0][0]:
            count["states change beyond"] += 1
            return count
        ends = {}
        for factor in (1.0, -1.0):
            ends[factor] = slopes(solve(factor * STEP)[1])
        mean = (results[1.0][1] - results[-1.0][1]) / (2.0 * STEP)
        sides = np.array([ends[1.0], ends[-1.0], at_start])
        room = BRANCHES * np.maximum(scale, np.abs(ends[1.0]))
        inside = (mean >= sides.min(axis=0) - room) & (mean <= sides.max(axis=0) + room)
        assert inside.all(), (seed, mean, sides, room)
        count["inside"] += 1
    return count


@pytest.mark.parametrize("seed", range(FEW))
def test_some_random_scenes(comm, seed):
    """A scene in 2D and one in 3D."""
    assert compare(comm, seed).total() == 1


@pytest.mark.long
def test_many_random_scenes(comm):
    """Three hundred of them."""
    count = sum((compare(comm, seed) for seed in range(FEW, FEW + MANY)), Counter())
    print(count)
    assert count["equal"] > MANY / 2
    assert count["inside"] > 0
