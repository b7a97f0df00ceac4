"""Random scenes with finite sliding, against the loop of solves and updates of the geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rotations import in_plane

from dolfinx_tresca import Coulomb, Frictionless, RigidSphere, SolverOptions, Tresca
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import fixed, no_load
from scenes.patches import BOTTOM, TOP, patch
from scenes.revolution import ring_elasticity

#: Accuracy of the configuration and of the contact problems.
GEOMETRY, RTOL = 1e-5, 1e-9
OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Change of the forces in a round at which the loop ends, and the most rounds.
LOOP, ROUNDS = 1e-7, 80

#: Random scenes of `make test`, and of `make test-long`.
FEW, MANY = 6, 200
FEW_OTHERS, MANY_OTHERS = 1, 50


def scene_of(comm, seed, shape):
    """Return a random scene, its conditions and pairs with finite sliding.

    Blocks are plane, of revolution ("ring"), or in 3D with another friction across the motion
    ("ellipse").
    """
    draw = np.random.default_rng(seed)
    coefficient = draw.uniform(0.05, 0.5)
    laws = (Frictionless(), Coulomb(coefficient), Tresca(100.0 * coefficient))
    law, degree = laws[draw.integers(3)], int(draw.integers(1, 3))
    way = np.array([draw.uniform(-0.4, 0.4), -draw.uniform(0.01, 0.06)])
    radius_of_ring = 10.0 * (shape == "ring")
    if shape == "ellipse":
        return slanting_block(comm, draw, way)
    if draw.integers(2):  # a block over a ball
        radius = draw.uniform(0.5, 3.0)
        ball = RigidSphere((radius_of_ring + draw.uniform(0.3, 0.7), -radius), radius)
        scene = block(
            comm, (int(draw.integers(3, 8)), 2), size=(1.0, 0.5), degree=degree,
            boxes=bool(draw.integers(2)), load=(0.0, 0.0, 0.0), friction=law,
            obstacles=[(BELOW, ball)],
        )  # fmt: skip
        bcs = [fixed(scene.V, scene.facet_tags.find(ABOVE), way)]
    else:  # two blocks, turned and shifted
        angle = draw.uniform(0.0, 2.0 * np.pi)
        start = draw.uniform(0.0, 0.2) - min(0.0, way[0])
        kind = ("triangle", "quadrilateral")[draw.integers(2)]
        scene = patch(
            comm, kind, degree, upper=(int(draw.integers(1, 4)), 1),
            lower=(int(draw.integers(2, 6)), 2), span=[(start, start + 0.4)], friction=law,
            turn=in_plane(angle), shift=draw.uniform(-5.0, 5.0, 3) * [1.0, 1.0, 0.0],
        )  # fmt: skip
        tags = scene.facet_tags
        top = fixed(scene.V, tags.find(TOP), in_plane(angle) @ way)
        bcs = [top, fixed(scene.V, tags.find(BOTTOM))]
    if shape == "ring":
        scene.mesh.geometry.x[:, 0] += radius_of_ring
        a = ring_elasticity(scene.V, scene.data.young, scene.data.poisson)
        scene = replace(scene, a=a, L=no_load(scene.V))
    return scene, bcs, scene.but(sliding="finite").pairs


def slanting_block(comm, draw, way):
    """Return a block over a ball in 3D, with a friction ellipse that is not along the motion."""
    first, angle, radius = draw.uniform(0.05, 0.5), draw.uniform(0.0, np.pi), draw.uniform(1.0, 3.0)
    pair = (first, first * draw.uniform(0.1, 0.9))
    direction = (np.cos(angle), np.sin(angle), 0.0)
    limit = (100.0 * pair[0], 100.0 * pair[1])
    laws = (Coulomb(pair, direction=direction), Tresca(limit, direction=direction))
    ball = RigidSphere((*draw.uniform(0.3, 0.7, 2), -radius), radius)
    scene = block(
        comm, (int(draw.integers(2, 5)), 3, 2), size=(1.0, 1.0, 0.5), boxes=bool(draw.integers(2)),
        load=(0.0, 0.0, 0.0), friction=laws[draw.integers(2)], obstacles=[(BELOW, ball)],
    )  # fmt: skip
    across = draw.uniform(-0.3, 0.3)
    bcs = [fixed(scene.V, scene.facet_tags.find(ABOVE), (way[0], across, way[1]))]
    return scene, bcs, scene.but(sliding="finite").pairs


def force_of(solution):
    """Return the force on the secondary side."""
    solution.raise_if_failed()
    return solution.pair_resultants[0].force


def seeds(few, many):
    """Return parameters, of which the first few run with `make test`."""
    return [pytest.param(k, marks=[pytest.mark.long] * (k >= few)) for k in range(many)]


@pytest.mark.parametrize("seed", seeds(FEW, MANY))
def test_as_the_loop_of_updates(comm, seed):
    compare(comm, seed, "plane")


@pytest.mark.parallel
@pytest.mark.parametrize("shape", ["ring", "ellipse"])
@pytest.mark.parametrize("seed", seeds(FEW_OTHERS, MANY_OTHERS))
def test_rings_and_ellipses_as_the_loop_of_updates(comm, seed, shape):
    compare(comm, seed, shape)


def compare(comm, seed, shape):
    """Both end at the same forces, and a round of the loop from there changes nothing.

    Where forces alternate from round to round, on the coarsest meshes (3 of the 200), the loop has
    no end, and only the round is judged.
    """
    scene, bcs, pairs = scene_of(comm, seed, shape)
    ring = shape == "ring"
    with scene.problem(bcs=bcs, pairs=pairs, options=OPTIONS, axisymmetric=ring) as problem:
        solution = problem.solve()
        found = force_of(solution)
    atol = 10 * GEOMETRY * np.linalg.norm(found)
    with scene.problem(bcs=bcs, options=OPTIONS, axisymmetric=ring) as problem:
        assert np.allclose(force_of(after_a_round(problem, solution)), found, rtol=0.0, atol=atol)
    with scene.problem(bcs=bcs, options=OPTIONS, axisymmetric=ring) as problem:
        solution = problem.solve()
        for _ in range(ROUNDS):
            last, solution = force_of(solution), after_a_round(problem, solution)
            change = np.linalg.norm(force_of(solution) - last)
            if change <= LOOP * np.linalg.norm(last):
                assert np.allclose(last, found, rtol=0.0, atol=atol)
                break


def after_a_round(problem, solution):
    """Return the next solution of the loop."""
    problem.update_geometry(solution.u)
    problem.set_slip_origin(None)  # the slip counts from the start, with present partners
    return problem.solve()
