"""Scenes that are most likely a mistake get a hint in the log, others none."""

from __future__ import annotations

import dataclasses
import logging

import pytest
from logged import logged

from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb, RigidPlane
from scenes.blocks import BELOW, block
from scenes.patches import LOWER, UPPER, patch
from scenes.scene import Scene


def hints(caplog, scene: Scene, *, pairs: list[ContactPair] | None = None):
    """Return what the first rank logs while a scene is built."""
    caplog.clear()
    with (
        caplog.at_level(logging.INFO, "dolfinx_tresca"),
        scene.problem(pairs=[scene.pair] if pairs is None else pairs),
    ):
        pass
    return logged(caplog)


def two_blocks(comm, **changes) -> Scene:
    return patch(comm, "quadrilateral", upper=(3, 1), lower=(2, 1), distort=0.0, **changes)


@pytest.mark.parallel
@pytest.mark.parametrize(("depth", "deep"), [(0.2, False), (1.2, True)])
def test_overlaps(comm, caplog, depth, deep):
    """The block is 1 high: units of length that are mixed up, or a body in the wrong place."""
    scene = block(comm, (3, 3), obstacles=[(BELOW, RigidPlane((0, depth), (0, 1)))])
    expected = deep and comm.rank == 0
    assert (f"overlaps by {depth:g} before anything moves" in hints(caplog, scene)) == expected


@pytest.mark.parallel(sliding=["finite"], down=[0.02])
@pytest.mark.parametrize("sliding", ["small", "finite"])
@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.parametrize("obstacle", [False, True])
@pytest.mark.parametrize("down", [0.02, 0.0, -0.01])
def test_prescribed_overlaps(comm, caplog, sliding, exchanged, obstacle, down):
    """Both faces, or one above a plane, have prescribed normal components and free tangents.

    The gap is what was prescribed, also where no pressure can change it.
    """
    scene = two_blocks(comm, scale=10.0)
    normal = scene.V.sub(1)
    bcs = [*scene.bcs]
    for tag, value in ((UPPER, -down), (LOWER, down / 2)):
        dofs = fem.locate_dofs_topological(normal, 1, scene.facet_tags.find(tag))
        bcs.append(fem.dirichletbc(value, dofs, normal))
    pair = dataclasses.replace(scene.pair, friction=Coulomb(0.3), sliding=sliding)
    if exchanged:
        pair = dataclasses.replace(pair, secondary=pair.primary, primary=pair.secondary)
    if obstacle:
        plane = RigidPlane((0.0, 10.0), (0.0, 1.0))
        pair = dataclasses.replace(pair, secondary=UPPER, primary=plane)
    overlap = down if obstacle else 1.5 * down
    caplog.clear()
    with (
        caplog.at_level(logging.INFO, "dolfinx_tresca"),
        scene.problem(pairs=[pair], bcs=bcs) as problem,
    ):
        solution = problem.solve()
        surface = solution.surfaces[0]
        carries = surface.state.x.array >= 0
        assert comm.allreduce(int(carries.sum())) > 0
        assert surface.gap.x.array[carries] == pytest.approx(-overlap, abs=1e-13 * 20.0)
    text = logged(caplog)
    warned = comm.rank == 0 and overlap > 0.0
    assert (f"overlaps by up to {overlap:g}, at (" in text) == warned


@pytest.mark.parallel
def test_both_sides_on_one_body(comm, caplog):
    """Two blocks that share the nodes at one end of the contact, and two that do not."""
    for merge, expected in ((None, False), (lambda x: x[:, 0] < 1e-9, comm.rank == 0)):
        scene = patch(comm, "quadrilateral", upper=(3, 1), lower=(3, 1), distort=0.0, merge=merge)
        assert ("are on body 1: it touches itself" in hints(caplog, scene)) == expected
