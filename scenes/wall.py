"""A dry-stone wall in running bond, 2D: only contact holds its bricks; in m and Pa."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import ContactPair, Coulomb, RigidPlane
from dolfinx_tresca.scene.friction import Friction
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity
from scenes.scene import Scene

#: Width and height of a brick.
WIDTH, HEIGHT = 0.25, 0.1

#: Young's modulus, Poisson's ratio, specific weight [N/m^3], coefficient of friction.
YOUNG, POISSON, SPECIFIC_WEIGHT, FRICTION = 5e9, 0.2, 2000 * 9.81, 0.6

#: Tags of faces, plus the number of the course, 0, 1, ...; the tag of the pushed one.
BELOW, ABOVE, LEFT, RIGHT, PUSHED = 1000, 2000, 3000, 4000, 1


def wall(
    comm: MPI.Comm,
    bricks: int = 4,
    courses: int = 5,
    *,
    loose: int = 0,
    cells: tuple[int, int] = (2, 1),
    friction: Friction | None = None,
) -> Scene:
    """Return a wall on a rigid plane, under its weight. Collective.

    Args:
        comm: of the mesh.
        bricks: in the first, third, ... course; the others have a half brick at either end.
        courses: their number.
        loose: number of stones on the bricks of the topmost course, from the left.
        cells: of a brick, along and across it; a half brick has half of the former.
        friction: `Coulomb(FRICTION)` if not given.

    Returns:
        the scene. In `data`: `push` [N/m], force to the left on the right end of the topmost
        course; `lift` [N/m], upwards on each loose stone, which have no weight: nothing presses
        them; `course_weight` [N/m]; `number` of bricks and stones.
    """
    rows = []
    for course in range(courses):
        joints = np.arange(1.0, bricks) if course % 2 == 0 else np.arange(0.5, bricks)
        ends = WIDTH * np.array([0.0, *joints, bricks])
        rows.append(np.column_stack([ends[:-1], ends[1:]]))
    rows.append(rows[-1][:loose] + 0.1 * WIDTH * np.array([1.0, -1.0]))
    course_of = np.repeat(np.arange(courses + 1), [len(row) for row in rows])
    sides = np.concatenate(rows)
    lower = HEIGHT * course_of
    bodies = [
        Body((max(1, round(cells[0] * (b - a) / WIDTH)), cells[1]), [(a, b), (y, y + HEIGHT)])
        for (a, b), y in zip(sides, lower, strict=True)
    ]
    made = boxes(comm, "quadrilateral", bodies)

    body, (x, y) = made.body, made.middles.T
    rounding = 1e-6 * HEIGHT
    first = np.isin(body, np.searchsorted(course_of, np.arange(courses)))
    last = np.isin(body, np.searchsorted(course_of, np.arange(courses), side="right") - 1)
    stone = course_of[body] == courses
    values = course_of[body].astype(np.int32)
    right = np.abs(x - sides[body, 1]) < rounding
    values += np.select(
        [
            np.abs(y - lower[body]) < rounding,
            np.abs(y - lower[body] - HEIGHT) < rounding,
            (np.abs(x - sides[body, 0]) < rounding) & ~first & ~stone,
            right & ~last & ~stone,
        ],
        [BELOW, ABOVE, LEFT, RIGHT],
    ).astype(np.int32)
    values[right & last & (course_of[body] == courses - 1)] = PUSHED
    tags = mesh.meshtags(made.mesh, 1, made.facets, values)

    law = Coulomb(FRICTION) if friction is None else friction
    ground = RigidPlane((0.0, 0.0), (0.0, 1.0))
    beds: list[Any] = [ground, *(ABOVE + course for course in range(courses - (loose == 0)))]
    pairs = [ContactPair(tags, BELOW + course, below, law) for course, below in enumerate(beds)]
    pairs += [
        ContactPair(tags, LEFT + course, RIGHT + course, law)
        for course in range(courses)
        if len(rows[course]) > 1
    ]

    V = made.V
    v, height = ufl.TestFunction(V), ufl.SpatialCoordinate(made.mesh)[1]
    push, lift = (fem.Constant(made.mesh, 0.0) for _ in range(2))
    of_stones = lift / (0.8 * WIDTH * HEIGHT)
    vertical = ufl.conditional(ufl.gt(height, courses * HEIGHT), of_stones, -SPECIFIC_WEIGHT)
    ds = ufl.Measure("ds", domain=made.mesh, subdomain_data=tags)
    L = vertical * v[1] * ufl.dx - push / HEIGHT * v[0] * ds(PUSHED)
    data = SimpleNamespace(
        push=push,
        lift=lift,
        course_weight=SPECIFIC_WEIGHT * bricks * WIDTH * HEIGHT,
        number=len(bodies),
    )
    return Scene(V, elasticity(V, YOUNG, POISSON), L, [], pairs, tags, data=data)
