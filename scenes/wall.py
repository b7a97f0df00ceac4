"""Dry walls and towers, held by contact alone, in 2D; lengths in m, stresses in MPa."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb, RigidPlane
from dolfinx_tresca.scene.friction import Friction
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity
from scenes.scene import Scene

#: Length and height of a brick [m].
LENGTH, HEIGHT = 0.25, 0.1

#: Stone: Young's modulus [MPa], Poisson's ratio, weight [MN/m^3], coefficient of friction.
YOUNG, POISSON, WEIGHT, FRICTION = 5e3, 0.2, 0.02, 0.6


def wall(
    comm: MPI.Comm,
    bricks: int,
    courses: int,
    *,
    loose: int = 0,
    divisions: tuple[int, int] = (4, 1),
    friction: Friction | None = None,
    one_pair: bool = False,
) -> Scene:
    """Return a wall in running bond on a rigid floor, under its weight. Collective.

    Args:
        comm: communicator of the mesh.
        bricks: number of bricks in a course; every second course has half a brick at each end.
        courses: number of courses.
        loose: number of stones in a row beside the second course, see `assembly`.
        divisions: numbers of cells along the length and the height of a brick.
        friction: law of friction; None: `Coulomb(FRICTION)`.
        one_pair: see `assembly`.
    """
    whole = LENGTH * np.arange(bricks + 1.0)
    halves = np.concatenate([whole[:1], whole[:-1] + 0.5 * LENGTH, whole[-1:]])
    rows = [halves if course % 2 else whole for course in range(courses)]
    if loose:
        rows[1] = np.concatenate([LENGTH * np.arange(-loose, 0.0), rows[1]])
    return assembly(
        comm, rows, loose=loose, divisions=divisions, friction=friction, one_pair=one_pair
    )


def tower(comm: MPI.Comm, blocks: int, width: float, friction: Friction | None = None) -> Scene:
    """Return a tower of blocks [width in m] on a rigid floor, under their weight. Collective."""
    return assembly(comm, [np.array([0.0, width])] * blocks, friction=friction)


def assembly(
    comm: MPI.Comm,
    rows: Sequence[np.ndarray],
    *,
    loose: int = 0,
    divisions: tuple[int, int] = (4, 1),
    friction: Friction | None = None,
    one_pair: bool = False,
) -> Scene:
    """Return courses of blocks on a rigid floor, under their weight. Collective.

    `data.push` is the traction [MPa] against the right end of the uppermost course.
    `data.bodies` has both ends (n, 2) of each block along the x axis, course by course;
    `data.course` has the course of each block, `data.weights` its weight [MN/m].

    Args:
        comm: communicator of the mesh.
        rows: for each course the ends of its blocks along the x axis, ascending.
        loose: number of blocks at the beginning of the second course that have nothing below
            them; their weight is `data.loose_weight`, zero at first.
        divisions: numbers of cells along the length and the height of a block as long as a brick;
            other blocks have cells of about the same length.
        friction: law of friction; None: `Coulomb(FRICTION)`.
        one_pair: whether one pair of all sides with themselves replaces a pair for each joint.
    """
    ends = [np.column_stack([row[:-1], row[1:]]) for row in rows]
    course = np.repeat(np.arange(len(rows)), [len(one) for one in ends])
    bodies = np.concatenate(ends)
    is_loose = np.zeros(len(bodies), dtype=np.bool_)
    is_loose[len(ends[0]) : len(ends[0]) + loose] = True
    cells = np.maximum(np.round(divisions[0] * np.diff(bodies)[:, 0] / LENGTH).astype(int), 1)
    made = boxes(
        comm,
        "quadrilateral",
        [
            Body((int(n), divisions[1]), [tuple(x), (HEIGHT * k, HEIGHT * (k + 1))])
            for x, n, k in zip(bodies, cells, course, strict=True)
        ],
    )
    number = len(rows)
    law = Coulomb(FRICTION) if friction is None else friction
    if one_pair:
        pushed = [len(bodies) - 1]
        tags = made.tags(
            (2, range(len(bodies)), None), (1, range(len(ends[0])), near(1, 0.0)),
            (3, pushed, near(0, bodies[-1, 1])),
        )  # fmt: skip
        pairs, end = [ContactPair(tags, 2, 2, law)], 3
    else:
        marks = []
        for k in range(number):
            some = [int(one) for one in np.flatnonzero((course == k) & ~is_loose)]
            marks += [(1 + 2 * k + side, some, near(1, HEIGHT * (k + side))) for side in (0, 1)]
        head = 2 * number + 1 + 2 * np.arange(len(bodies))
        for b, x in enumerate(bodies):
            marks += [(int(head[b]) + side, [b], near(0, x[side])) for side in (0, 1)]
        tags = made.tags(*marks)
        pairs = [ContactPair(tags, 1 + 2 * k, 2 * k, law) for k in range(1, number)]
        pairs += [
            ContactPair(tags, int(head[b]), int(head[b - 1]) + 1, law)
            for b in range(1, len(bodies))
            if course[b] == course[b - 1]
        ]
        end = int(head[-1]) + 1
    pairs.insert(0, ContactPair(tags, 1, RigidPlane((0.0, 0.0), (0.0, 1.0)), law))
    mesh, V = made.mesh, made.V
    push, loose_weight = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    v, x = ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
    weight = ufl.conditional(x[0] < 0.0, loose_weight, WEIGHT)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    L = -weight * v[1] * ufl.dx - push * v[0] * ds(end)
    data = SimpleNamespace(
        push=push,
        loose_weight=loose_weight,
        bodies=bodies,
        course=course,
        is_loose=is_loose,
        weights=WEIGHT * HEIGHT * np.diff(bodies)[:, 0] * ~is_loose,
    )
    return Scene(V, elasticity(V, YOUNG, POISSON), L, [], pairs, tags, data=data)
