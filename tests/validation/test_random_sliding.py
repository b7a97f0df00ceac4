"""Random scenes with finite sliding, against the loop of solves and updates of the geometry.

Linear and hyperelastic bodies in 2D and 3D: two blocks, as a pair or as one surface that touches
itself, or a block over a ball that moves and turns; rings; friction ellipses.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest
from rotations import rotation

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactStatus,
    Coulomb,
    Frictionless,
    NewtonOptions,
    NonlinearContactProblem,
    RigidSphere,
    SolverOptions,
    Tresca,
)
from scenes.blocks import ABOVE, BELOW, POISSON, YOUNG, block
from scenes.elasticity import fixed, lame_constants, no_load
from scenes.patches import BOTTOM, KINDS, LOWER, TOP, UPPER, patch
from scenes.revolution import ring_elasticity
from scenes.rubber_block import neo_hookean
from scenes.scene import Scene

#: Accuracy of the configuration, of the contact problems and of Newton's method.
GEOMETRY, RTOL, NEWTON = 1e-5, 1e-9, 1e-8
OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Degree of the quadrature of the energy of hyperelastic bodies.
QUADRATURE = 4

#: Change of the forces in a round at which the loop ends, and the most rounds: in the slowest scene
#: (199) forces alternate from round to round, and changes are multiplied by -0.96.
LOOP, ROUNDS = 0.1 * GEOMETRY, 400

#: Width and height of the upper one of two blocks; the lower one has the width and height 1.
SIZE = 0.4

#: Random scenes of `make test`, and of `make test-long`.
FEW, MANY = 8, 200
FEW_OTHERS, MANY_OTHERS = 1, 50

#: Radial coordinate at which the bodies of revolution begin; the blocks are 1 wide.
BORE = 10.0


@dataclass(frozen=True)
class RandomScene:
    """A scene with small sliding; `way` is how its obstacle, the ball, has moved since a problem.

    With hyperelastic bodies u is their displacement; `ring` says if bodies are of revolution.
    """

    scene: Scene
    u: fem.Function | None
    ring: bool
    ball: RigidSphere | None = None
    way: tuple[np.ndarray, np.ndarray] = (np.zeros(3), np.zeros(3))

    @contextmanager
    def problem(self, sliding):
        """Yield a problem whose obstacle has moved since it was made."""
        with self.obstacle_at_start():
            pairs = self.scene.but(sliding=sliding).pairs
            if self.u is None:
                problem = self.scene.problem(pairs=pairs, options=OPTIONS, axisymmetric=self.ring)
            else:
                points = ufl.dx(degree=QUADRATURE)  # UFL takes far more points
                energy = neo_hookean(self.u, *lame_constants(YOUNG, POISSON)) * points
                problem = NonlinearContactProblem(
                    ufl.derivative(energy, self.u, ufl.TestFunction(self.scene.V)),
                    self.u, pairs, self.scene.bcs,
                    options=OPTIONS, newton=NewtonOptions(accuracy=NEWTON),
                )  # fmt: skip
        with problem:
            yield problem

    @contextmanager
    def obstacle_at_start(self):
        """Move the obstacle back to the start inside the block."""
        if self.ball is None:
            yield
            return
        self.ball.move_to()
        yield
        self.ball.move_to(*self.way)

    def after_a_round(self, problem, u):
        """Return the solution of the loop that follows a displacement."""
        problem.update_geometry(u)
        with self.obstacle_at_start():  # the slip counts from there, with present partners
            problem.set_slip_origin(None)
        return problem.solve()


def scene_of(comm, seed, shape="block"):
    """Return a random scene of blocks, of linear rings, or in 3D with friction ellipses."""
    draw = np.random.default_rng(seed)
    dim, degree, hyperelastic, boxes = (int(k) for k in draw.integers([2, 1, 0, 0], [4, 3, 2, 2]))
    ring = shape == "ring"
    if ring:
        dim, hyperelastic = 2, 0
    elif shape == "ellipse":
        dim = 3
    coefficient = draw.uniform(0.05, 0.5)
    laws = (Frictionless(), Coulomb(coefficient), Tresca(100.0 * coefficient))
    law = laws[draw.integers(3)]
    way = np.append(draw.uniform(-0.4, 0.4, dim - 1), -draw.uniform(0.02, 0.06))
    turn, shift = np.eye(3), np.array([BORE, 0.0, 0.0])
    if not ring:
        turn[:dim, :dim] = rotation(seed, dim)
        shift = draw.uniform(-5.0, 5.0, 3) * [1.0, 1.0, dim - 2.0]
    if shape == "ellipse":
        angle, second = draw.uniform(0.0, np.pi), coefficient * draw.uniform(0.1, 0.9)
        along = tuple(turn @ [np.cos(angle), np.sin(angle), 0.0])
        law = (
            Coulomb((coefficient, second), direction=along),
            Tresca((100.0 * coefficient, 100.0 * second), direction=along),
        )[draw.integers(2)]
    make = over_a_ball if draw.integers(2) else two_blocks
    scene, held, *ball = make(comm, draw, way, bool(boxes), turn, shift, degree, law)
    if ring:
        a = ring_elasticity(scene.V, scene.data.young, scene.data.poisson)
        scene = replace(scene, a=a, L=no_load(scene.V))
    tags = scene.facet_tags
    bcs = [fixed(scene.V, tags.find(k), turn[:dim, :dim] @ value) for k, value in held.items()]
    u = fem.Function(scene.V) if hyperelastic else None
    return RandomScene(replace(scene, bcs=bcs), u, ring, *ball)


def over_a_ball(comm, draw, way, boxes, turn, shift, degree, law):
    """Return a block, the displacement of its top, a ball below it and the ball's motion.

    The block moves by `way` relative to the ball, which makes a part of this motion, and ends above
    the ball.
    """
    dim = len(way)
    radius = draw.uniform(1.5, 4.0)  # so that the ball meets a node of the block
    centre = np.append(way[:-1] + draw.uniform(0.1, 0.9, dim - 1), -radius)
    part, turning = draw.uniform(0.0, 1.0), draw.uniform(-0.2, 0.2, 3) * draw.integers(2)
    turning[:2] *= dim - 2.0
    ball = RigidSphere(turn[:, :dim] @ centre + shift, radius)
    n = [int(draw.integers(3, 8)), 2] if dim == 2 else [*[int(draw.integers(3, 5))] * 2, 1]
    scene = block(
        comm, n, size=[*[1.0] * (dim - 1), 0.5], degree=degree, boxes=boxes, load=np.zeros(3),
        friction=law, obstacles=[(BELOW, ball)],
    ).moved(lambda x: x @ turn.T + shift)  # fmt: skip
    return scene, {ABOVE: (1.0 - part) * way}, ball, (-part * turn[:, :dim] @ way, turning)


def two_blocks(comm, draw, way, boxes, turn, shift, degree, law):
    """Return two blocks, as a pair or as a surface that touches itself, and how their ends move."""
    dim = len(way)
    start = draw.uniform(0.0, 0.2, dim - 1) - np.minimum(0.0, way[:-1])
    upper, lower = (int(k) for k in draw.integers([1, 2], [4, 6] if dim == 2 else [3, 4]))

    def placed(x):  # of height 1, as in `patch`, the upper block would buckle
        x[:, dim - 1] -= (1.0 - SIZE) * np.maximum(x[:, dim - 1] - 1.0, 0.0)
        return x @ turn.T + shift

    scene = patch(
        comm, KINDS[2 * dim - 4 + boxes], degree, upper=(upper, 1), lower=(lower, 4 - dim),
        span=[(x, x + SIZE) for x in start], warp=placed, friction=law,
    )  # fmt: skip
    if draw.integers(2):
        scene = scene.but(secondary=[UPPER, LOWER], primary=[UPPER, LOWER])
    return scene, {TOP: way, BOTTOM: np.zeros(dim)}


def force_of(solution):
    """Return the force on the secondary side, in random scenes that may leave linear theory."""
    if solution.status is not ContactStatus.OUTSIDE_THEORY:
        solution.raise_if_failed()
    return solution.pair_resultants[0].force


def seeds(few, many, *also):
    """Return parameters, of which the first few and some others run with `make test`."""
    short = {*range(few), *also}
    return [pytest.param(k, marks=[pytest.mark.long] * (k not in short)) for k in range(many)]


@pytest.mark.parametrize("seed", seeds(FEW, MANY, 183))  # facets at a rim begin to bend
def test_as_the_loop_of_updates(comm, seed):
    compare(scene_of(comm, seed))


@pytest.mark.parallel
@pytest.mark.parametrize("shape", ["ring", "ellipse"])
@pytest.mark.parametrize("seed", seeds(FEW_OTHERS, MANY_OTHERS))
def test_rings_and_ellipses_as_the_loop_of_updates(comm, seed, shape):
    compare(scene_of(comm, seed, shape))


def compare(scene):
    """Both end at the same forces, and a round of the loop from there changes nothing."""
    with scene.problem("finite") as problem:
        solution = problem.solve()
        found, u = force_of(solution), solution.u.copy()
    assert found.any()
    atol = 10 * GEOMETRY * np.linalg.norm(found)
    with scene.problem("small") as problem:
        after = force_of(scene.after_a_round(problem, u))
        assert np.allclose(after, found, rtol=0.0, atol=atol)
    if scene.u is not None:
        scene.u.x.array[:] = 0.0
    with scene.problem("small") as problem:
        solution = problem.solve()
        for _ in range(ROUNDS):
            last, solution = force_of(solution), scene.after_a_round(problem, solution.u.copy())
            change = np.linalg.norm(force_of(solution) - last)
            if change <= LOOP * np.linalg.norm(last):
                assert np.allclose(last, found, rtol=0.0, atol=atol)
                return
    pytest.fail(f"in {ROUNDS} rounds the forces of the loop do not settle")
