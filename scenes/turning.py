"""Bodies that turn: a drum under its shoe, a roller bearing, two gears; plane strain, mm, MPa.

Each scene is of linear bodies; `saint_venant_kirchhoff` has the same problem with bodies that are
right for large rotations by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactSolution,
    Coulomb,
    Frictionless,
    NonlinearContactProblem,
    read_gmsh,
)
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity, fixed, lame_constants, no_load
from scenes.scene import Scene

POISSON = 0.3


def saint_venant_kirchhoff(scene: Scene) -> NonlinearContactProblem:
    """Return the problem of a scene with nonlinear bodies. Collective."""
    u = fem.Function(scene.V)
    mu, lame = lame_constants(scene.data.young, POISSON)
    F = ufl.Identity(2) + ufl.grad(u)
    E = (F.T * F - ufl.Identity(2)) / 2
    energy = (mu * ufl.inner(E, E) + lame / 2 * ufl.tr(E) ** 2) * ufl.dx
    residual = ufl.derivative(energy, u, ufl.TestFunction(scene.V)) - scene.L
    return NonlinearContactProblem(residual, u, scene.pairs, scene.bcs)


def turned(angle: float, centre: tuple[float, float] = (0.0, 0.0)) -> Callable[[Any], np.ndarray]:
    """Return the displacement (2, n) at points (3, n) that turns a plane body.

    Args:
        angle: angle of the turn [rad], from the first axis to the second.
        centre: point [mm] about which the body turns.
    """
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) - np.eye(2)
    return lambda x: R @ (x[:2] - np.array(centre)[:, None])


def polar(x: np.ndarray) -> np.ndarray:
    """Return points (n, 2) at given angles [rad] and radii (n, 2)."""
    return np.asarray(x[:, 1:] * np.column_stack([np.cos(x[:, 0]), np.sin(x[:, 0])]))


#: Radii of the drum's bore and rim; half angle [rad] and outer radius of the shoe; friction.
BORE, RIM, SHOE, BACK, BRAKE = 60.0, 100.0, 0.2, 120.0, 0.3


def drum(comm: MPI.Comm, cells: int = 4) -> Scene:
    """Return a drum under a shoe that is held 0.05 mm too deep. Collective.

    `data.turn(angle)` turns the drum's bore [rad].

    Args:
        comm: communicator of the mesh.
        cells: cells across the drum.
    """
    top, round_the_drum = np.pi / 2.0, 16 * cells
    made = boxes(
        comm,
        "quadrilateral",
        [
            Body((round_the_drum, cells), [(0.0, 2.0 * np.pi), (BORE, RIM)], move=polar),
            Body((2 * cells, cells), [(top - SHOE, top + SHOE), (RIM, BACK)], move=polar),
        ],
    )
    tags = made.tags(
        (1, [0], near(1, RIM)),
        (2, [0], near(1, BORE)),
        (3, [1], near(1, RIM)),
        (4, [1], near(1, BACK)),
    )
    V, held = made.V, fem.Function(made.V)
    bore = fem.locate_dofs_topological(V, 1, tags.find(2))
    bcs = [fem.dirichletbc(held, bore), fixed(V, tags.find(4), (0.0, -0.05))]
    pair = ContactPair(
        tags, 3, 1, Coulomb(BRAKE), sliding="finite", geometry={1: on_the_rim, 3: on_the_rim}
    )
    data = SimpleNamespace(young=2.08e4, turn=lambda angle: held.interpolate(turned(angle)))
    return Scene(V, elasticity(V, data.young, POISSON), no_load(V), bcs, [pair], tags, data=data)


def on_the_rim(x: np.ndarray) -> np.ndarray:
    """Return the points (3, n) of the drum's rim next to points (3, n)."""
    return np.asarray(x * RIM / np.hypot(x[0], x[1]))


#: Radii of the bearing: bore, inner raceway, outer raceway, housing; friction.
BEARING, ROLLING = (20.0, 26.0, 34.0, 40.0), 0.1


def bearing(
    comm: MPI.Comm, rollers: int = 16, cells: int = 16, fit: float = 0.02, press: float = 0.005
) -> Scene:
    """Return a bearing whose inner ring is pressed onto a shaft. Collective.

    Contact and friction alone hold the rollers. `data.turn(angle)` turns the shaft [rad], which
    is pressed downwards; `data.centres` (rollers, 2) are the undeformed centres of the rollers.

    Args:
        comm: communicator of the mesh.
        rollers: number of rollers.
        cells: cells along the side of the square that is bent to a roller; rings have cells of
            about the same size.
        fit: growth of the bore's radius [mm].
        press: displacement of the shaft downwards [mm]; if it is larger than the fit, rollers above
            the shaft are loose.
    """
    bore, inner, outer, housing = BEARING
    radius, middle = (outer - inner) / 2.0, (outer + inner) / 2.0
    size = np.pi / 2.0 * radius / cells

    def roller(angle: float, phase: float) -> Callable[[np.ndarray], np.ndarray]:
        centre = middle * np.array([np.cos(angle), np.sin(angle)])
        c, s = np.cos(phase), np.sin(phase)
        return lambda x: centre + radius * disc(x) @ np.array([[c, s], [-s, c]])

    spans = [(bore, inner), (outer, housing)]
    rings = [
        Body(
            (rollers * round(2.0 * np.pi * raceway / size / rollers) + 1, 4),
            [(0.0, 2.0 * np.pi), span],
            move=polar,
        )
        for raceway, span in zip((inner, outer), spans, strict=True)
    ]
    angles = 2.0 * np.pi / rollers * np.arange(rollers) - np.pi / 2.0
    square = [(-1.0, 1.0), (-1.0, 1.0)]
    # nodes of the rollers, and of the rings, touch one after the other, and not all at once
    phases = np.pi / 2.0 / cells * np.arange(rollers) / rollers
    balls = [
        Body((cells, cells), square, move=roller(angle, phase))
        for angle, phase in zip(angles, phases, strict=True)
    ]
    made = boxes(comm, "quadrilateral", [*rings, *balls])
    tags = made.tags(
        (1, [0], near(1, bore)),
        (2, [1], near(1, housing)),
        (3, [0], near(1, inner)),
        (3, [1], near(1, outer)),
        (4, range(2, 2 + rollers), None),
    )
    V, shaft = made.V, fem.Function(made.V)
    bcs = [
        fem.dirichletbc(shaft, fem.locate_dofs_topological(V, 1, tags.find(1))),
        fixed(V, tags.find(2)),
    ]

    def turn(angle: float) -> None:
        def displacement(x: np.ndarray) -> np.ndarray:
            c, s = np.cos(angle), np.sin(angle)
            grown = (1.0 + fit / bore) * np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])
            return np.asarray(grown - x[:2] - np.array([[0.0], [press]]))

        shaft.interpolate(displacement)

    def on_raceways(x: np.ndarray) -> np.ndarray:
        distance = np.hypot(x[0], x[1])
        return np.asarray(x * np.where(distance < middle, inner, outer) / distance)

    def on_rollers(x: np.ndarray) -> np.ndarray:
        nearest = np.round((np.arctan2(x[1], x[0]) - angles[0]) * rollers / (2.0 * np.pi))
        angle = angles[0] + 2.0 * np.pi / rollers * nearest
        centres = middle * np.array([np.cos(angle), np.sin(angle), 0.0 * angle])
        arm = x - centres
        return np.asarray(centres + radius * arm / np.hypot(arm[0], arm[1]))

    pair = ContactPair(
        tags,
        4,
        3,
        Coulomb(ROLLING),
        sliding="finite",
        search_distance=0.5,
        geometry={3: on_raceways, 4: on_rollers},
    )
    centres = middle * np.column_stack([np.cos(angles), np.sin(angles)])
    data = SimpleNamespace(young=208e3, turn=turn, centres=centres)
    return Scene(V, elasticity(V, data.young, POISSON), no_load(V), bcs, [pair], tags, data=data)


#: Angle by which rollers roll on while the inner ring turns by 1.
RATIO = BEARING[1] / (BEARING[1] + BEARING[2])


def rolled(scene: Scene, solution: ContactSolution) -> float:
    """Return the mean angle [degrees] by which centres of rollers have gone round. Collective."""
    owned = scene.V.dofmap.index_map.size_local
    X = scene.V.tabulate_dof_coordinates()[:owned, :2]
    x = X + solution.u.x.array.reshape(-1, 2)[:owned]
    far = np.linalg.norm(X[:, None] - scene.data.centres, axis=2).min(axis=1)
    X, x = X[far < 1e-6], x[far < 1e-6]
    angles = np.arctan2(X[:, 0] * x[:, 1] - X[:, 1] * x[:, 0], np.einsum("ni,ni->n", X, x))
    total, number = scene.mesh.comm.allreduce(np.array([angles.sum(), len(angles)]))
    return float(np.degrees(total / number))


def disc(x: np.ndarray) -> np.ndarray:
    """Return points (n, 2) of the square [-1, 1]^2 moved to the disc of radius 1.

    Nodes on the rim are at equal angles, so that the mesh has the symmetry of a quarter turn.
    """
    size = np.abs(x).max(axis=1)
    across = np.abs(x[:, 0]) >= np.abs(x[:, 1])
    along, beside = np.where(across, x[:, 0], x[:, 1]), np.where(across, x[:, 1], x[:, 0])
    slope = beside / np.where(along == 0.0, 1.0, along)
    angle = np.where(across, 0.0, np.pi / 2.0) + np.where(across, 1.0, -1.0) * np.pi / 4.0 * slope
    angle = angle + np.where(along < 0.0, np.pi, 0.0)
    circle = size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(size[:, None] * circle + (1.0 - size[:, None]) * 0.8 * x)


#: Gears: module, pressure angle, backlash along a pitch circle, teeth, radii of the bores.
MODULE, PRESSURE, BACKLASH, TEETH, BORES = 4.0, np.radians(20.0), 0.05, (20, 30), (25.0, 45.0)

#: Names of the gears, and the places of their axes.
NAMES, AXES = ("pinion", "gear"), (0.0, MODULE * sum(TEETH) / 2.0)

#: Angle [rad] by which the gear is turned against the pinion.
TWIST = np.radians(0.05)


@dataclass(frozen=True)
class Teeth:
    """Seven teeth of a gear, with flanks that are involutes.

    Attributes:
        teeth: number of teeth of the whole gear.
        axis: place of its axis [mm].
        angles: (7,) angles of the middles of the teeth [rad].
    """

    teeth: int
    axis: float
    angles: np.ndarray

    @property
    def pitch(self) -> float:
        """Radius of the pitch circle [mm]."""
        return MODULE * self.teeth / 2.0

    @property
    def base(self) -> float:
        """Radius of the base circle [mm], where flanks begin."""
        return float(self.pitch * np.cos(PRESSURE))

    @property
    def half(self) -> float:
        """Half the angle of a tooth on the base circle [rad]."""
        return (np.pi * MODULE - BACKLASH) / 4.0 / self.pitch + np.tan(PRESSURE) - PRESSURE

    def outline(self, size: float) -> np.ndarray:
        """Return angles and radii (n, 2) of points along the teeth, about `size` apart."""
        tip, root = self.pitch + MODULE, self.pitch - 1.25 * MODULE
        radii = np.linspace(self.base, tip, round((tip - self.base) / size) + 1)
        slope = np.arccos(np.minimum(self.base / radii, 1.0))
        flank = self.half - (np.tan(slope) - slope)
        land = np.linspace(-flank[-1], flank[-1], max(2, int(flank[-1] * tip / size) + 1))[1:-1]
        along = np.concatenate([[-self.half], -flank, land, flank[::-1], [self.half]])
        heights = np.concatenate([[root], radii, tip + 0.0 * land, radii[::-1], [root]])
        return np.concatenate([np.column_stack([angle + along, heights]) for angle in self.angles])

    def on_flank(self, x: np.ndarray) -> np.ndarray:
        """Return the points (3, n) of the nearest flanks next to points (3, n)."""
        radius, angle = np.hypot(x[0] - self.axis, x[1]), np.arctan2(x[1], x[0] - self.axis)
        from_middle = (angle[:, None] - self.angles + np.pi) % (2.0 * np.pi) - np.pi
        tooth = np.abs(from_middle).argmin(axis=1)
        from_middle = np.take_along_axis(from_middle, tooth[:, None], axis=1)[:, 0]
        # the normal of an involute is tangent to the base circle
        roll = self.half - np.abs(from_middle) + np.arccos(np.minimum(self.base / radius, 1.0))
        nearest = np.sign(from_middle) * (self.half - roll + np.arctan(roll)) + self.angles[tooth]
        length = self.base * np.hypot(1.0, roll)
        return np.array(
            [self.axis + length * np.cos(nearest), length * np.sin(nearest), 0.0 * length]
        )


#: Teeth of the pinion and of the gear that mesh while the pinion turns by 27 degrees.
PINION = Teeth(TEETH[0], AXES[0], 2.0 * np.pi / TEETH[0] * np.arange(-4, 3))
GEAR = Teeth(TEETH[1], AXES[1], np.pi + 2.0 * np.pi / TEETH[1] * (np.arange(-2, 5) + 0.5))


def gears(comm: MPI.Comm, size: float = 0.4) -> Scene:
    """Return sectors of seven teeth of a pinion and a gear. Collective.

    `data.turn(angle)` turns the pinion's bore [rad], and the gear's bore by 2/3 of it, against the
    pressed flanks. The flanks of the pinion are the secondary side. The primary side is the whole
    outline of the gear, since tips touch first below the flanks.

    Args:
        comm: communicator of the mesh.
        size: size of the cells on the teeth.
    """
    with gear_model(size) if comm.rank == 0 else nullcontext() as model:
        bodies = read_gmsh(model, comm)
    facets, tags = bodies.facet_tags, bodies.tags
    V = fem.functionspace(bodies.mesh, ("Lagrange", 1, (2,)))
    bores = [fem.Function(V), fem.Function(V)]
    bcs = [
        fem.dirichletbc(bore, fem.locate_dofs_topological(V, 1, facets.find(tags[f"{name} bore"])))
        for bore, name in zip(bores, NAMES, strict=True)
    ]

    def turn(angle: float) -> None:
        bores[0].interpolate(turned(angle))
        bores[1].interpolate(turned(TWIST - TEETH[0] / TEETH[1] * angle, (AXES[1], 0.0)))

    flanks = [tags[f"{name} flanks"] for name in NAMES]
    pair = ContactPair(
        facets,
        flanks[0],
        [flanks[1], tags["gear outline"]],
        Frictionless(),
        sliding="finite",
        geometry={flanks[0]: PINION.on_flank, flanks[1]: GEAR.on_flank},
    )
    a, data = elasticity(V, 210e3, POISSON), SimpleNamespace(young=210e3, turn=turn)
    return Scene(V, a, no_load(V), bcs, [pair], facets, bodies.cell_tags, tags, data)


def torques(solution: ContactSolution) -> np.ndarray:
    """Return the moments (2,) [N] of contact about the axes of both gears."""
    on_pinion = solution.pair_resultants[0]
    return np.array([float(np.ravel(on_pinion.about((x, 0.0)).moment)[-1]) for x in AXES])


@contextmanager
def gear_model(size: float) -> Iterator[Any]:
    """Open Gmsh's model of the gears, with cells of a size [mm] on the teeth."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("gears")
    geo = gmsh.model.geo
    for name, gear, bore in zip(NAMES, (PINION, GEAR), BORES, strict=True):

        def points(
            angles: np.ndarray, radii: np.ndarray, h: float, axis: float = gear.axis
        ) -> list[int]:
            places = np.column_stack([axis + radii * np.cos(angles), radii * np.sin(angles)])
            return [geo.addPoint(x, y, 0.0, h) for x, y in places]

        def lines(ids: list[int]) -> list[int]:
            return [geo.addLine(a, b) for a, b in pairwise(ids)]

        angles, radii = gear.outline(size).T
        ends = gear.angles[[0, -1]] + np.pi / gear.teeth * np.array([-1.0, 1.0])
        start, stop = (points(ends[[k]], radii[[0]], 2.0) for k in (0, 1))
        inside = np.linspace(ends[1], ends[0], 13)
        shaft = points(inside, np.full(13, bore), 4.0)
        rim = lines([*start, *points(angles, radii, size), *stop])
        bored = lines(shaft)
        loop = [*rim, *lines([stop[0], shaft[0]]), *bored, *lines([shaft[-1], start[0]])]
        surface = geo.addPlaneSurface([geo.addCurveLoop(loop)])
        geo.synchronize()
        heights = np.array([radii[0], *radii, radii[-1]])
        lower = np.minimum(heights[:-1], heights[1:])
        is_flank = (lower >= gear.base - 1e-9) & (np.diff(heights) != 0.0)
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
        for group, numbers in (
            ("flanks", np.array(rim)[is_flank]),
            ("outline", np.array(rim)[~is_flank]),
            ("bore", np.array(bored)),
        ):
            gmsh.model.addPhysicalGroup(1, numbers.tolist(), name=f"{name} {group}")
    gmsh.model.mesh.generate(2)
    try:
        yield gmsh.model
    finally:
        gmsh.finalize()
