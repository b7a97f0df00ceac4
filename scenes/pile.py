"""Random stacks and piles of stones, held by contact alone, in 2D; units: m, MPa."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb, RigidPlane
from scenes.boxes import Body, Map, boxes
from scenes.elasticity import elasticity
from scenes.scene import Scene
from scenes.wall import POISSON, WEIGHT, YOUNG

#: Tags of the sides on the floor, and of all others.
FLOOR, SIDES = 1, 7

#: Largest gap [m] of sides that may touch; stones that stand apart have at least four times this.
SEARCH = 5e-3

#: Largest size of cells [m].
CELL = 0.03

#: Largest angle by which a single stone is turned, which opens its joints by less than `SEARCH`.
TURN = 5e-4

#: Most stones in a pile, and loose ones among them.
MOST, MOST_LOOSE = 12, 2

#: Largest length of loose stones [m].
LOOSE_LENGTH = 0.2


@dataclass(frozen=True)
class Pile:
    """Stones, which of them stand on the floor, their loads, and the coefficient of friction.

    Attributes:
        corners: (n, 4, 2) corners of the stones, counter-clockwise [m]; the first two are below.
        on_floor: (n,) whether a stone stands on the floor, y = 0.
        loads: (n, 2) force per volume [MN/m^3].
        friction: coefficient of friction.
    """

    corners: np.ndarray
    on_floor: np.ndarray
    loads: np.ndarray
    friction: float

    def scene(self) -> Scene:
        """Return the scene, with one pair for all sides and one for the floor."""
        sizes = np.linalg.norm(self.corners[:, 1:3] - self.corners[:, :2], axis=2)
        divisions = [(int(n), int(m)) for n, m in np.ceil(sizes / CELL)]
        bodies = [
            Body(cells, [(0, 1), (0, 1)], move=_bilinear(one))
            for cells, one in zip(divisions, self.corners, strict=True)
        ]
        made = boxes(MPI.COMM_SELF, "quadrilateral", bodies)
        below = [int(k) for k in np.flatnonzero(self.on_floor)]
        every = range(len(bodies))
        tags = made.tags((SIDES, every, None), (FLOOR, below, lambda x: x[:, 1] < 1e-9))
        law = Coulomb(self.friction)
        pairs = [ContactPair(tags, FLOOR, RigidPlane((0.0, 0.0), (0.0, 1.0)), law)]
        if len(bodies) > 1:
            pairs.append(ContactPair(tags, SIDES, SIDES, law, search_distance=SEARCH))
        load = fem.Function(fem.functionspace(made.mesh, ("DG", 0, (2,))))
        cells = np.asarray(made.mesh.topology.original_cell_index)
        body = np.repeat(np.arange(len(bodies)), np.prod(divisions, axis=1))[cells]
        load.x.array[:] = self.loads[body].ravel()
        L = ufl.inner(load, ufl.TestFunction(made.V)) * ufl.dx
        a, data = elasticity(made.V, YOUNG, POISSON), SimpleNamespace(body_of_cell=body)
        return Scene(made.V, a, L, [], pairs, tags, data=data)


def _bilinear(corners: np.ndarray) -> Map:
    """Return the map of the unit square onto the quadrilateral with these corners (4, 2)."""

    def move(x: np.ndarray) -> np.ndarray:
        s, t = x.T[:, :, None]
        a, b, c, d = corners
        result: np.ndarray = (1 - s) * ((1 - t) * a + t * d) + s * ((1 - t) * b + t * c)
        return result

    return move


def random_pile(seed: int) -> Pile:
    """Return a stack or a pile of 1 to `MOST` stones.

    Courses lie between straight lines that may be inclined. Stones of a course touch each other or
    stand apart. Loose stones lean against the end of a course, with nothing below them. Some loose
    stones, and some of the uppermost stones, have no weight. The weights act along a direction that
    may be inclined, and a horizontal force may push one of the stones.
    """
    rng = np.random.default_rng(seed)
    number = int(rng.integers(1, MOST + 1))
    is_stack, steep = rng.random() < 0.4, rng.random() < 0.5
    loose = int(rng.integers(1, MOST_LOOSE + 1)) if rng.random() < 0.4 else 0
    line = np.zeros(2)  # height at x = 0, slope
    corners: list[np.ndarray] = []
    on_floor, light = [], []
    from_, to = 0.0, 0.3 if is_stack else rng.uniform(0.3, 1.2)  # of the course below
    while len(corners) < number:
        first = not corners
        height, incline = rng.uniform(0.05, 0.15), rng.uniform(-1.0, 1.0) * steep
        left = min(number - len(corners), 1 if is_stack else int(rng.integers(2, 5)))
        widths = rng.uniform(0.08, 0.3, left)
        apart = np.where(rng.random(left) < 0.2, 4.0 * SEARCH, 0.0) * (np.arange(left) > first)
        starts = np.cumsum(widths + apart) - widths
        some = starts + widths < 1.2 * (to - from_)
        some[0] = True
        widths, starts = widths[some], starts[some]
        shift = (to - from_ - starts[-1] - widths[-1]) * rng.uniform(0.2, 0.8)
        starts += 0.0 if first else from_ + shift
        from_, to = starts[0], starts[-1] + widths[-1]
        # limit the slope: a course is everywhere at least half as high as in its middle
        incline *= min(0.2, 0.5 * height / (0.5 * (to - from_) + LOOSE_LENGTH))
        above = line + np.array([height - incline * 0.5 * (from_ + to), incline])
        for x, width in zip(starts, widths, strict=True):
            corners.append(_stone(x, x + width, line, above))
            on_floor.append(first)
            light.append(False)
        if not first and loose and len(corners) < number:
            loose -= 1
            corners.append(_stone(from_ - rng.uniform(0.05, LOOSE_LENGTH), from_, line, above))
            on_floor.append(False)
            light.append(rng.random() < 0.8)
        line = above
    number = len(corners)
    turned = np.array([_turned(one, rng.uniform(-TURN, TURN)) for one in corners])
    flat = np.array(on_floor)
    turned[flat] = np.array(corners)[flat]  # not turned: facets with y = 0 get a tag
    weightless = np.array(light) | ((np.arange(number) == number - 1) & (rng.random() < 0.2))
    angle = rng.uniform(-0.3, 0.3) if rng.random() < 0.5 else 0.0
    loads = WEIGHT * np.tile([np.sin(angle), -np.cos(angle)], (number, 1))
    loads[weightless] = 0.0
    if rng.random() < 0.3:
        loads[rng.integers(number), 0] += WEIGHT * rng.uniform(-0.5, 0.5)
    friction = 0.0 if rng.random() < 0.05 else float(rng.uniform(0.0, 1.0))
    return Pile(turned, flat, loads, friction)


def _stone(from_: float, to: float, below: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Return corners (4, 2) between two lines, given by the height at x = 0 and the slope."""
    return np.array(
        [
            [x, height + slope * x]
            for x, (height, slope) in ((from_, below), (to, below), (to, above), (from_, above))
        ]
    )


def _turned(corners: np.ndarray, angle: float) -> np.ndarray:
    """Return corners (4, 2), turned about their mean."""
    centre, (c, s) = corners.mean(axis=0), (np.cos(angle), np.sin(angle))
    turned: np.ndarray = centre + (corners - centre) @ np.array([[c, s], [-s, c]])
    return turned
