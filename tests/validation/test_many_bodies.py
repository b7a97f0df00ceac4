"""Many bodies that only contact holds."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from rigid_blocks import RigidBlocks, loads_of

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    ContactState,
    Coulomb,
    MechanismError,
    RigidPlane,
)
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity
from scenes.scene import EPS
from scenes.wall import FRICTION, HEIGHT, tower, wall
from scenes.wall import WEIGHT as STONE

#: Error of a mechanism, over its greatest displacement: the search ends before forces are infinite.
MOTION = 1e-2

WEIGHT = 0.02  # N per mm of thickness, of a block of 1 mm x 1 mm


def column(comm, blocks, top=None):
    """Return the problem of a column of blocks on a rigid plane, under their weight.

    Args:
        comm: of the mesh.
        blocks: their number.
        top: law of friction below the topmost block; None: that of the others.
    """
    made = boxes(comm, "quadrilateral", [Body((2, 1), [(0, 1), (k, k + 1)]) for k in range(blocks)])
    marks = [
        (1 + 2 * k + side, [k], lambda x, height=k + side: np.isclose(x[:, 1], height))
        for k in range(blocks)
        for side in (0, 1)
    ]
    tags = made.tags(*marks)
    laws = [Coulomb(0.6)] * (blocks - 1) + [Coulomb(0.6) if top is None else top]
    pairs = [ContactPair(tags, 1, RigidPlane((0.0, 0.0), (0.0, 1.0)), laws[0])]
    pairs += [ContactPair(tags, 1 + 2 * k, 2 * k, laws[k]) for k in range(1, blocks)]
    load = -WEIGHT * ufl.TestFunction(made.V)[1] * ufl.dx
    return ContactProblem(elasticity(made.V, 5e3, 0.2), load, pairs)


@pytest.mark.parallel(blocks=[60])
@pytest.mark.parametrize("blocks", [60, pytest.param(300, marks=pytest.mark.long)])
def test_a_tall_column(comm, blocks):
    """Contact resists the motions of all bodies together with 1 / n^4 of one body's resistance.

    So many pairs share meshes of their surfaces: each has its own fields on its own facets there.
    """
    with column(comm, blocks) as problem:
        solution = problem.solve(rtol=1e-6)
        solution.raise_if_failed()
    pressed = [one.force[1] for one in solution.pair_resultants]
    weights = WEIGHT * np.arange(blocks, 0, -1)
    assert pressed == pytest.approx(weights, rel=1e-9)
    for k, surface in enumerate(solution.surfaces):
        carries = surface.state.x.array != ContactState.OUTSIDE
        assert np.allclose(surface.points[carries, 1], k)
        assert not surface.pressure.x.array[~carries].any()
        force = comm.allreduce(surface.weights @ surface.pressure.x.array)
        assert force == pytest.approx(weights[k], rel=1e-9)


@pytest.mark.parametrize("loose", [1, 10])
def test_loose_stones_that_nothing_holds_are_named(comm, loose):
    """Bodies are numbered from the left, so the loose stones are the first ones."""
    scene = wall(comm, 2, 3, loose=loose, divisions=(2, 1))
    scene.data.loose_weight.value = STONE
    with (
        scene.problem() as problem,
        pytest.raises(MechanismError, match=r"no contact .*translation along y") as caught,
    ):
        problem.solve()
    number = int(str(caught.value).partition("body ")[2].split()[0])
    assert number <= loose


@pytest.mark.parametrize(
    ("blocks", "width", "tips"),
    [(1, 0.25, False), (4, 0.08, True), (3, 0.25, False), (20, 0.08, True), (20, 0.25, False)],
)
def test_a_tower_slides_or_tips_as_statics_says(comm, blocks, width, tips):
    """The part above a joint slides at a push of F W, and tips at W b / (2 h) at a height h."""
    scene = tower(comm, blocks, width)
    weights = np.cumsum(scene.data.weights)[::-1]  # above each joint
    heights = HEIGHT * (np.arange(blocks, 0, -1) - 0.5)
    limits = weights * np.minimum(FRICTION, width / (2.0 * heights))
    limit = limits.min()
    assert (limit < FRICTION * weights.min()) == tips
    with scene.problem() as problem:
        for part in (0.5, 0.99):
            scene.data.push.value = part * limit / HEIGHT
            solution = problem.solve(rtol=1e-6)
            solution.raise_if_failed()
            force = solution.pair_resultants[0].force
            assert force == pytest.approx([part * limit, weights[0]], rel=1e-9)
        scene.data.push.value = 1.01 * limit / HEIGHT
        with pytest.raises(MechanismError, match="no contact forces balance the loads") as caught:
            problem.solve()
    motion = caught.value.motion
    owned = scene.V.dofmap.index_map.size_local
    u, x = motion.x.array.reshape(-1, 2)[:owned], scene.V.tabulate_dof_coordinates()[:owned]
    if tips:  # about the lower left corner
        wanted = np.column_stack([-x[:, 1], x[:, 0]]) / np.hypot(width, blocks * HEIGHT)
    else:  # the uppermost block; friction of limit analysis lifts what slides
        cell = scene.V.dofmap.list[np.arange(scene.mesh.topology.index_map(2).size_local)]
        middle = scene.V.tabulate_dof_coordinates()[cell, 1].mean(axis=1)
        slides = np.zeros(len(scene.V.tabulate_dof_coordinates()), dtype=np.bool_)
        slides[cell[middle > (blocks - 1) * HEIGHT]] = True
        wanted = slides[:owned, None] * [-1.0, FRICTION] / np.hypot(1.0, FRICTION)
    assert np.allclose(u, wanted, rtol=0.0, atol=MOTION)


@pytest.mark.parametrize(
    ("bricks", "courses", "friction", "named"),
    [
        (2, 5, 0.8, r"together with bodies \d.*: .*rotation"),
        pytest.param(2, 8, 0.6, r"together with bodies \d.* more: .*y", marks=pytest.mark.long),
    ],
)
def test_a_wall_that_is_tilted_falls_between_the_bounds_of_limit_analysis(
    bricks, courses, friction, named
):
    """The weight is inclined in accepted steps.

    Friction that is associated is an upper bound of the limit, beyond which a mechanism is named.
    A reduced friction, the sine of its angle, is a safe estimate (Davis 1968), since bricks that
    slide do not move apart.
    """
    scene = wall(MPI.COMM_SELF, bricks, courses, friction=Coulomb(friction))
    body = bricks_of_cells(scene)
    tilt, v = fem.Constant(scene.mesh, 0.0), ufl.TestFunction(scene.V)
    upright, level = (
        loads_of(replace(scene, L=-STONE * v[axis] * ufl.dx), body) for axis in (1, 0)
    )
    upper, safe = (
        RigidBlocks.at_nodes(scene, body, part).factor(upright, level)
        for part in (friction, np.sin(np.arctan(friction)))
    )
    assert 0.8 * upper < safe < upper
    with replace(scene, L=scene.L - tilt * STONE * v[0] * ufl.dx).problem() as problem:
        for part in (0.5, 1.0):
            tilt.value = part * safe
            problem.solve(rtol=1e-6).raise_if_failed()
            problem.accept()
        tilt.value = 1.001 * upper
        with pytest.raises(MechanismError, match=named) as caught:
            problem.solve()
    motion = caught.value.motion.x.array.reshape(-1, 2)
    owned = scene.V.dofmap.index_map.size_local
    power = fem.assemble_vector(fem.form(scene.L - tilt * STONE * v[0] * ufl.dx)).array
    assert np.vdot(power[: 2 * owned], motion[:owned]) > 0.0


def bricks_of_cells(scene):
    """Return the brick (cells,) of each cell of a wall, in the order of `data.bodies`."""
    cells = np.arange(scene.mesh.topology.index_map(2).size_local, dtype=np.int32)
    x = mesh.compute_midpoints(scene.mesh, 2, cells)
    data = scene.data
    inside = (data.bodies[:, 0] < x[:, :1]) & (x[:, :1] < data.bodies[:, 1])
    inside &= data.course == np.floor(x[:, 1:2] / HEIGHT)
    return inside.argmax(axis=1)


@pytest.mark.long
def test_a_wall_of_a_thousand_bricks():
    """The floor carries the weight of 1,104 bricks, found by Newton's method in a few steps."""
    scene = wall(MPI.COMM_SELF, 34, 32, one_pair=True)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
    solution.raise_if_failed()
    assert solution.iterations <= 3
    on_floor = solution.pair_resultants[0].force
    weight = scene.data.weights.sum()
    assert on_floor == pytest.approx([0.0, weight], abs=1e5 * EPS * weight)
