"""A hook that a block bends down and lets go: contact at a node or two, on round edges."""

from __future__ import annotations

import numpy as np
import pytest
from logged import logged

from dolfinx import fem

from dolfinx_tresca import ContactStatus, Coulomb, Frictionless, NewtonOptions
from scenes.snap_fit import FLAT, HEIGHT, IN, LENGTH, WIDTH, snap_fit

#: Coefficient of friction with which the way in needs three times the force.
ROUGH = 0.6


def forces(problem_of_hook, path):
    """Return the forces (steps, 2) [N] on the hook along a path, and numbers of Newton steps."""
    found, steps = [], []
    with problem_of_hook.problem as problem:
        for distance in path:
            problem_of_hook.push(distance)
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            found.append(WIDTH * solution.pair_resultants[0].force)
            steps.append(len(solution.newton.steps))
    return np.array(found), steps


@pytest.mark.parallel()
def test_an_edge_that_slides_off_a_corner_snaps(comm):
    """Without friction the tip leaves the flat face of the block, and slides over its round edge.

    On cells a third as large the tip reaches the edge between 6.3 and 6.45.
    """
    path = [0.9, 1.8, 2.7, 3.6, 4.5, 5.4, 6.0, 6.15, 6.6]
    found, steps = forces(snap_fit(comm, Frictionless()), path)
    assert np.allclose(found[-4:-2], [0.0, -29.1], atol=0.1)
    assert np.allclose(found[-2], [0.0, -29.1], atol=1.0)  # the edge is near, and no facet as small
    assert found[-1][0] > 10.0  # the steep side of the nose pushes the block out
    assert max(steps) <= 20


def test_contact_passes_from_node_to_node_under_a_force_near_buckling(comm):
    """With friction the slope sticks almost; two nodes share the force, or either has it all."""
    path = [0.75, 1.5, 2.25, 3.0, 3.375, 3.525, 3.6, 3.675, 3.75, 3.825, 4.5, 5.625]
    found, steps = forces(snap_fit(comm, Coulomb(ROUGH)), path)
    assert -found[9][0] == pytest.approx(88.2, rel=6e-2)  # with cells half as large: 88.2
    assert found[-1] == pytest.approx([-19.7, -32.83], rel=1e-2)
    assert found[-1][0] / found[-1][1] == pytest.approx(ROUGH, rel=1e-4)
    assert max(steps) <= 40 and np.mean(steps) <= 12


@pytest.mark.parallel()
def test_a_hook_that_springs_free_releases_its_energy(comm):
    """The block goes away sideways in one step: nothing takes up what the hook has stored."""
    hook = snap_fit(comm, Frictionless())
    form = fem.form(hook.energy)
    with hook.problem as problem:
        for distance in (0.9, 1.8, 2.7, 3.6, 4.5, 5.4):
            hook.push(distance)
            problem.solve().raise_if_failed()
            problem.accept()
        stored = comm.allreduce(fem.assemble_scalar(form))
        hook.push(10.0)
        solution = problem.solve()
        solution.raise_if_failed()
        left = comm.allreduce(fem.assemble_scalar(form))
    assert left <= 1e-3 * stored  # the block still touches the beam
    assert solution.newton.released == pytest.approx(stored - left, rel=1e-2)


def test_a_failure_shows_where_contact_changes(comm):
    """Few Newton steps, and no smaller part of the load: the force passes between two nodes."""
    hook = snap_fit(comm, Coulomb(ROUGH))
    with hook.problem as problem:
        for distance in (0.75, 1.5, 2.25, 3.0, 3.6, 3.675):
            hook.push(distance)
            problem.solve().raise_if_failed()
            problem.accept()
        held = problem.prescribed
        hook.push(3.75)
        solution = problem.solve(newton=NewtonOptions(max_iterations=4, max_halvings=0))
    assert solution.status is ContactStatus.NO_EQUILIBRIUM
    flips, unbalanced = solution.newton.flips, solution.newton.unbalanced
    x = flips.function_space.tabulate_dof_coordinates()[flips.x.array > 0]
    corner, end = LENGTH + FLAT, LENGTH + FLAT + HEIGHT / np.tan(IN)
    assert len(x) and ((corner <= x[:, 0]) & (x[:, 0] <= end) & (x[:, 1] > 0.0)).all()
    assert 0.0 < np.abs(unbalanced.x.array).max() < np.inf
    assert not unbalanced.x.array[: len(held)][held].any()


def test_a_solve_of_many_newton_steps_says_so(comm, caplog):
    """More steps than twice `max_iterations` in all parts of a load step."""
    hook = snap_fit(comm, Frictionless())
    with hook.problem as problem:
        hook.push(0.9)
        solution = problem.solve(newton=NewtonOptions(max_iterations=2))
    assert f"took {len(solution.newton.steps)} Newton steps" in logged(caplog)
