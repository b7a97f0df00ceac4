"""Shallow arches: past the greatest force of a ball that pushes, and through under a dead load."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    Frictionless,
    NonlinearContactProblem,
    RigidPlane,
    RigidSphere,
)
from scenes.blocks import ABOVE, BELOW, LEFT, RIGHT, block
from scenes.elasticity import fixed
from scenes.rubber_block import neo_hookean

#: Step of the dead load.
STEP = 0.01

#: Span, thickness and rise of the arch, radius of the ball.
SPAN, THICK, RISE, RADIUS = 20.0, 0.5, 1.5, 5.0


def arch(comm):
    """Return the space of a clamped arch, tags of its faces, and the facets of its ends."""
    scene = block(comm, (40, 2), size=(SPAN, THICK), degree=2, boxes=True)
    tags, x = scene.facet_tags, scene.mesh.geometry.x
    x[:, 0] -= SPAN / 2.0
    x[:, 1] += RISE / 2.0 * (1.0 + np.cos(2.0 * np.pi * x[:, 0] / SPAN))
    return scene.V, tags, np.sort(np.concatenate([tags.find(LEFT), tags.find(RIGHT)]))


@pytest.mark.parallel(sliding=["finite"])
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_a_greatest_force_under_a_ball_is_no_failure(comm, sliding):
    """The ball holds the arch on its way down: its force falls, and its work is stored.

    With finite sliding, springs in the contact carried the force at two of these steps, and the
    contact none.
    """
    V, tags, ends = arch(comm)
    u = fem.Function(V)
    energy = neo_hookean(u, 100.0, 150.0) * ufl.dx(degree=4)
    form = fem.form(energy)
    ball = RigidSphere((0.0, RISE + THICK + RADIUS), RADIUS)
    pair = ContactPair(tags, ABOVE, ball, Frictionless(), sliding=sliding)
    F = ufl.derivative(energy, u, ufl.TestFunction(V))
    forces, stored, steps = [0.0], [0.0], []
    with NonlinearContactProblem(F, u, [pair], [fixed(V, ends)]) as problem:
        for depth in 0.165 * np.arange(1.0, 8.0):
            ball.move_to((0.0, -depth))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            forces.append(-solution.pair_resultants[0].force[1])
            stored.append(comm.allreduce(fem.assemble_scalar(form)))
            steps.append(solution.newton.steps)
            assert not solution.newton.snaps
            released = 0.165 * (forces[-1] + forces[-2]) / 2.0 - stored[-1] + stored[-2]
            assert solution.newton.released == pytest.approx(released, abs=1e-3 * stored[-1])
    assert np.argmax(forces) == 3
    assert forces[3:] == pytest.approx([0.2346, 0.177, 0.174, 0.149, 0.129], rel=1e-2)
    assert {step.fraction for part in steps for step in part} == {1.0}
    assert np.mean([len(part) for part in steps]) <= 13


@pytest.mark.parallel()
def test_an_arch_that_snaps_through_says_so(comm, caplog):
    """A dead load that the arch bears no more, and a plane on which it lands."""
    V, tags, ends = arch(comm)
    u, load = fem.Function(V), fem.Constant(V.mesh, 0.0)
    elastic = neo_hookean(u, 100.0, 150.0) * ufl.dx(degree=4)
    pair = ContactPair(tags, BELOW, RigidPlane((0.0, -1.2), (0.0, 1.0)), Frictionless())
    seen = np.zeros_like(u.x.array)
    changes = {"before_assembly": lambda: np.copyto(seen, u.x.array)}
    F = ufl.derivative(elastic + load * u[1] * ufl.dx, u, ufl.TestFunction(V))
    form, weight = fem.form(elastic), fem.form(u[1] * ufl.dx)
    jumps = []
    with NonlinearContactProblem(F, u, [pair], [fixed(V, ends)], **changes) as problem:
        before = np.zeros(3)
        for load.value in np.arange(1.0, 9.0) * STEP:
            solution = problem.solve()
            solution.raise_if_failed()
            assert np.array_equal(seen, u.x.array)  # not on the way of the energy's integral
            problem.accept()
            sums = [comm.allreduce(fem.assemble_scalar(part)) for part in (form, weight)]
            now = np.array([*sums, float(load.value)])
            work = -(now[2] + before[2]) / 2.0 * (now[1] - before[1])
            if solution.newton.snaps:
                jumps.append((solution.newton.released, work - now[0] + before[0]))
                assert "bodies snap" in str(solution)
            before = now
    ((released, wanted),) = jumps
    assert released == pytest.approx(wanted, rel=1e-2)
    assert solution.counts.contact > 0
