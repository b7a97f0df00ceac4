"""Scenes that leave linear theory get a status, near its end a warning, and inside no word."""

from __future__ import annotations

import logging
import re

import numpy as np
import pytest
from logged import logged

from dolfinx import fem

from dolfinx_tresca import ContactStatus, Coulomb, Frictionless, RigidSphere
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import fixed
from scenes.patches import BOTTOM, TOP, patch

FRICTION = 0.15


def warnings(caplog) -> int:
    """Return the number of warnings that the first rank has logged."""
    return sum(record.levelno >= logging.WARNING for record in caplog.records)


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("angle", "status", "warned"),
    [
        (0.008, ContactStatus.CONVERGED, 0),
        (0.045, ContactStatus.CONVERGED, 1),
        (0.055, ContactStatus.OUTSIDE_THEORY, 2),
    ],
)
def test_block_that_tips_on_a_plane(comm, caplog, angle, status, warned):
    """The moment 0.15 N m of the loads about the centre turns a block on soft springs.

    A lifted block turns by the moment divided by the springs' stiffness of rotation, k / 6. Within
    the limits the log is silent or warns in the first of two solves; beyond them it warns in both.
    """
    stiffness, load = 6.0 * 0.15 / angle, (0.3, 0.0, 1.0)
    scene = block(comm, (4, 4), spring=stiffness, load=load, friction=Coulomb(FRICTION))
    with scene.problem() as problem:
        for _ in range(2):
            solution = problem.solve()
    assert solution.status is status
    assert warnings(caplog) == warned * (comm.rank == 0)
    if warned and comm.rank == 0:
        shown = float(re.search(r"turns by ([0-9.]+) rad", logged(caplog)).group(1))
        assert shown == pytest.approx(angle, rel=0.02)  # bodies deform, too
    if status is ContactStatus.OUTSIDE_THEORY:
        assert f"turns by {angle:.2g}"[:13] in solution.sliding
        assert "NonlinearContactProblem" in solution.sliding


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_pressed_block_that_turns_on_a_plane(comm, sliding):
    """The top of the block is turned, which presses a corner; with finite sliding it has a frame.

    Only in linear theory the corner is pressed at 0.06 rad: a turned block is shorter below its top
    by its height times 0.06^2 / 2, more than the 0.001 by which the top is lowered.
    """
    turned = {0.04: ContactStatus.CONVERGED, 0.06: ContactStatus.OUTSIDE_THEORY}
    for angle, status in turned.items():
        scene = block(
            comm,
            (3, 3),
            held=(ABOVE,),
            moved=lambda x, angle=angle: angle * np.array([0.5 - x[1], x[0]]) - 0.001,
            friction=Coulomb(FRICTION),
        ).but(sliding=sliding)
        with scene.problem() as problem:
            solution = problem.solve(rtol=1e-8)
            if sliding == "finite":
                status = ContactStatus.CONVERGED
            assert solution.status is status
            assert (solution.normal_force > 0.0) == (sliding == "small" or angle < 0.002**0.5)


@pytest.mark.parallel
@pytest.mark.parametrize("law", [Coulomb(FRICTION), Frictionless()])
@pytest.mark.parametrize("deformable", [False, True])
@pytest.mark.parametrize(
    ("shift", "status", "warned"),
    [
        (0.2, ContactStatus.CONVERGED, 0),
        (0.5, ContactStatus.CONVERGED, 1),
        (2.0, ContactStatus.OUTSIDE_THEORY, 1),
    ],
)
def test_slip_over_the_size_of_the_contact(comm, caplog, shift, status, warned, deformable, law):
    """A block of width 1 slides on a large ball or on another block, with facets of at most 1/3."""
    if deformable:
        scene = patch(comm, "quadrilateral", upper=(3, 1), lower=(3, 1), distort=0.0, friction=law)
        moved = fixed(scene.V, scene.facet_tags.find(TOP), (-shift, -0.001))
        bcs = [moved, fixed(scene.V, scene.facet_tags.find(BOTTOM))]
    else:
        motion = np.array([[-shift], [-0.001]])
        ball = [(BELOW, RigidSphere((0.5, -1e3), 1e3))]
        scene = block(
            comm,
            (3, 3),
            boxes=True,
            held=(ABOVE,),
            moved=lambda x: 0.0 * x[:2] + motion,
            obstacles=ball,
            friction=law,
        )
        bcs = scene.bcs
    caplog.clear()
    with scene.problem(bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-8)
    assert solution.status is status
    assert warnings(caplog) == warned * (comm.rank == 0)
    if status is ContactStatus.OUTSIDE_THEORY:
        assert f"contact pair {solution.surface.name}: pressed nodes have slid by {shift:.2g}" in (
            solution.sliding
        )
        assert 'sliding="finite"' in solution.sliding


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron", "tetrahedron"])
@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("outwards", [True, False])
def test_a_block_leaves_the_rim_of_another_one(comm, caplog, kind, again, outwards):
    """Both overlap by 0.2 at first: the upper block slides off the lower one, or farther onto it.

    In 3D the contact is so long that this slip is small for its size. A pairing in the displaced
    position has other overlaps, 0.1 and 0.3, of which it may slide off.
    """
    slip, half = 0.4 if outwards else -0.4, 0.1 if outwards else -0.1
    deep = [] if kind == "quadrilateral" else [(0.0, 1.0)]
    scene = patch(comm, kind, upper=(10, 1), lower=(10, 1), distort=0.0, span=[(0.8, 1.8), *deep])
    down = np.zeros(scene.mesh.geometry.dim)
    down[-1] = -0.001
    value = fem.Constant(scene.mesh, down)
    held = [fixed(scene.V, scene.facet_tags.find(TOP), value)]
    held += [fixed(scene.V, scene.facet_tags.find(BOTTOM))]
    with scene.problem(bcs=held) as problem:
        if again:
            value.value[0] = half
            problem.solve(rtol=1e-8)
            problem.update_geometry()
        caplog.clear()
        value.value[0] += slip
        solution = problem.solve(rtol=1e-8)
    assert solution.normal_force > 0.0
    off = re.search(r"and ([0-9]+) % of the contact force", solution.sliding)
    if outwards:
        assert solution.status is ContactStatus.OUTSIDE_THEORY
        assert float(off.group(1)) == 100.0
    else:
        assert off is None
        assert "of the contact force" not in logged(caplog)


@pytest.mark.parallel
@pytest.mark.parametrize("modulus", [1e3, 1e-3])
def test_deformation_beyond_the_size_of_the_body(comm, modulus):
    """As with a modulus in GPa beside loads in Pa."""
    with block(comm, (3, 3), young=modulus).problem() as problem:
        solution = problem.solve()
    if modulus > 1.0:
        assert solution.status is ContactStatus.CONVERGED
    else:
        assert solution.status is ContactStatus.OUTSIDE_THEORY
        assert "units of moduli and loads" in solution.sliding
