"""Processes of nonlinear bodies with finite sliding that users have reported; mm, MPa."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactPair,
    Coulomb,
    Frictionless,
    NonlinearContactProblem,
    RigidPlane,
)
from dolfinx_tresca.scene.friction import Friction
from scenes.elasticity import fixed, lame_constants
from scenes.metal import Metal
from scenes.rubber_block import neo_hookean

#: Width of the rubber roller [mm].
ROLLER_WIDTH = 28.0


@dataclass(frozen=True)
class Process:
    """A scene and what moves it.

    Attributes:
        problem: the contact problem.
        move: function that sets the place [mm], or the time, of the next load step.
    """

    problem: NonlinearContactProblem
    move: Callable[[float], None]


def facets_at(domain: Any, axis: int, value: float) -> np.ndarray:
    """Return the facets in the plane where a coordinate has a value, in order. Collective."""
    dim = domain.topology.dim - 1
    facets = mesh.locate_entities_boundary(domain, dim, lambda x: np.isclose(x[axis], value))
    return np.sort(facets)


def tagged(domain: Any, places: dict[int, tuple[int, float]]) -> Any:
    """Return the facets of a box's sides: tag -> (coordinate, its value). Collective."""
    dim = domain.topology.dim - 1
    domain.topology.create_connectivity(dim, dim + 1)
    sides = {tag: facets_at(domain, *place) for tag, place in places.items()}
    facets = np.concatenate(list(sides.values()))
    values = np.repeat(np.array(list(sides), np.int32), [len(f) for f in sides.values()])
    order = np.argsort(facets)
    return mesh.meshtags(domain, dim, facets[order], values[order])


def strip_grid(
    number_along: int, number_across: int, map_to_plane: Callable[..., Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (n, 2) and cells (m, 4) of a strip of quadrilaterals.

    Args:
        number_along: number of cells along the strip.
        number_across: number of cells across it.
        map_to_plane: function from positions along and across, both in [0, 1], to coordinates.
    """
    along, across = np.meshgrid(
        np.linspace(0.0, 1.0, number_along + 1),
        np.linspace(0.0, 1.0, number_across + 1),
        indexing="ij",
    )
    x = np.column_stack(map_to_plane(along.ravel(), across.ravel()))
    corner = (np.arange(number_along)[:, None] * (number_across + 1)) + np.arange(number_across)
    corner = corner.ravel()
    step = number_across + 1
    return x, np.column_stack([corner, corner + 1, corner + step, corner + step + 1])


def two_strips_of_cells(comm: MPI.Comm, strips: list[tuple[np.ndarray, np.ndarray]]) -> Any:
    """Return a mesh of several strips. Collective."""
    starts = np.cumsum([0, *(len(x) for x, _ in strips)])
    x = np.concatenate([x for x, _ in strips])
    cells = np.concatenate([c + start for (_, c), start in zip(strips, starts, strict=False)])
    if comm.rank > 0:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    cells = np.asarray(cells, dtype=np.int64)
    return mesh.create_mesh(comm, cells=cells, e=element, x=x)


def curved_beams(comm: MPI.Comm, friction: Friction, cells: tuple[int, int]) -> Process:
    """Return two elastoplastic half rings, of which the upper one is pushed over the lower one.

    The scene is that of a published example of large sliding. Collective.

    Args:
        comm: communicator of the mesh.
        friction: law of friction.
        cells: numbers of cells along a ring and across it.
    """

    def ring(centre: tuple[float, float], radius: float, start: float) -> Any:
        def polar(along: np.ndarray, across: np.ndarray) -> Any:
            angle, r = start + np.pi * along, radius + 2.0 * across
            return centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle)

        return strip_grid(*cells, polar)

    domain = two_strips_of_cells(
        comm, [ring((12.0, 0.0), 10.0, 0.0), ring((-1.964, 17.0), 8.0, np.pi)]
    )
    domain.topology.create_connectivity(1, 2)
    facets = np.sort(mesh.exterior_facet_indices(domain.topology))
    middle = mesh.compute_midpoints(domain, 1, facets)
    radii = [np.hypot(middle[:, 0] - x, middle[:, 1] - y) for x, y in ((12.0, 0.0), (-1.964, 17.0))]
    is_lower = radii[0] < 12.01
    values = np.zeros(len(facets), np.int32)
    values[is_lower & (radii[0] > 11.9)] = 1
    values[~is_lower & (radii[1] > 9.9)] = 2
    values[is_lower & np.isclose(middle[:, 1], 0.0)] = 3
    values[~is_lower & np.isclose(middle[:, 1], 17.0)] = 4
    tags = mesh.meshtags(domain, 1, facets[values > 0], values[values > 0])
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, motion = fem.Function(V), fem.Constant(domain, np.zeros(2))
    metal = Metal(u, 689.56, 0.32, lambda strain: (31.0 + 261.2 * strain, 261.2 + 0.0 * strain))
    problem = NonlinearContactProblem(
        ufl.derivative(metal.energy, u, ufl.TestFunction(V)),
        u,
        [ContactPair(tags, 2, 1, friction, sliding="finite")],
        [fixed(V, tags.find(3)), fixed(V, tags.find(4), motion)],
        on_accept=metal.accept,
    )

    def move(place: float) -> None:
        motion.value[0] = place

    return Process(problem, move)


def pipe(comm: MPI.Comm, cells: tuple[int, int]) -> Process:
    """Return a quarter of a steel pipe that hardly hardens, crushed by a plate. Collective.

    Args:
        comm: communicator of the mesh.
        cells: numbers of cells around and across the wall.
    """
    inner, outer = 48.28, 57.15
    corners = [(0.0, inner), (np.pi / 2.0, outer)]
    domain = mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    tags = tagged(domain, {1: (1, outer), 2: (0, 0.0), 3: (0, np.pi / 2.0)})
    angle, radius = domain.geometry.x[:, :2].T.copy()
    domain.geometry.x[:, 0], domain.geometry.x[:, 1] = (
        radius * np.sin(angle),
        radius * np.cos(angle),
    )
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, plate = fem.Function(V), RigidPlane((0.0, outer), (0.0, -1.0))
    metal = Metal(u, 186_000.0, 0.3, lambda strain: (241.32 + 20.0 * strain, 20.0 + 0.0 * strain))
    problem = NonlinearContactProblem(
        ufl.derivative(metal.energy, u, ufl.TestFunction(V)),
        u,
        [ContactPair(tags, 1, plate, Frictionless(), sliding="finite")],
        [fixed(V, tags.find(2), component=0), fixed(V, tags.find(3), component=1)],
        on_accept=metal.accept,
    )
    return Process(problem, lambda depth: plate.move_to((0.0, -depth)))


def billet(comm: MPI.Comm, friction: Friction, cells: tuple[int, int]) -> Process:
    """Return a round billet of steel that is upset until its side folds onto the die. Collective.

    Args:
        comm: communicator of the mesh.
        friction: law of friction on the die.
        cells: numbers of cells along the radius and the axis.
    """
    domain = mesh.create_rectangle(
        comm, [(0.0, 0.0), (10.0, 15.0)], cells, mesh.CellType.quadrilateral
    )
    tags = tagged(domain, {1: (1, 15.0), 2: (0, 0.0), 3: (1, 0.0), 4: (0, 10.0)})
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, die = fem.Function(V), RigidPlane((0.0, 15.0), (0.0, -1.0))
    metal = Metal(
        *(u, 200_000.0, 0.3, lambda strain: (700.0 + 300.0 * strain, 300.0 + 0.0 * strain)),
        axisymmetric=True,
    )
    problem = NonlinearContactProblem(
        ufl.derivative(metal.energy, u, ufl.TestFunction(V)),
        u,
        [ContactPair(tags, [1, 4], die, friction, sliding="finite")],
        [fixed(V, tags.find(2), component=0), fixed(V, tags.find(3), component=1)],
        on_accept=metal.accept,
        axisymmetric=True,
    )
    return Process(problem, lambda depth: die.move_to((0.0, -depth)))


def roller(comm: MPI.Comm, cells: tuple[int, int]) -> Process:
    """Return half of a rubber ring that its hub presses on a plane, in plane strain. Collective.

    Args:
        comm: communicator of the mesh.
        cells: numbers of cells around the ring and across it.
    """
    inner, outer, young, poisson = 17.5, 35.0, 0.275, 0.475
    corners = [(0.0, 0.0), (1.0, 1.0)]
    domain = mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    tags = tagged(domain, {1: (1, 1.0), 2: (1, 0.0), 3: (0, 0.0), 4: (0, 1.0)})
    along, across = domain.geometry.x[:, :2].T.copy()
    angle, radius = np.pi * (0.35 * along + 0.65 * along**2), inner + (outer - inner) * across
    domain.geometry.x[:, 0], domain.geometry.x[:, 1] = (
        radius * np.sin(angle),
        -radius * np.cos(angle),
    )
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u, hub = fem.Function(V), fem.Constant(domain, 0.0)
    plane = RigidPlane((0.0, -outer), (0.0, 1.0))
    F = ufl.Identity(2) + ufl.grad(u)
    J, mu = ufl.det(F), lame_constants(young, poisson)[0]
    bulk = young / 3.0 / (1.0 - 2.0 * poisson)
    energy = mu / 2.0 * (J ** (-2.0 / 3.0) * (ufl.inner(F, F) + 1.0) - 3.0)
    energy += bulk / 2.0 * (J - 1.0) ** 2
    sides = np.union1d(tags.find(3), tags.find(4)).astype(np.int32)
    problem = NonlinearContactProblem(
        ufl.derivative(energy * ufl.dx(degree=4), u, ufl.TestFunction(V)),
        u,
        [ContactPair(tags, 1, plane, Frictionless(), sliding="finite")],
        [
            fixed(V, tags.find(2), component=0),
            fixed(V, tags.find(2), hub, component=1),
            fixed(V, sides, component=0),
        ],
    )

    def move(depth: float) -> None:
        hub.value = -depth

    return Process(problem, move)


def hopping_block(comm: MPI.Comm) -> Process:
    """Return a block that hops along a plank, with a coefficient of friction of 0.1. Collective.

    The place of the process is the time: the block goes along the plank at a speed of 1, and comes
    down four times in 2 pi.
    """

    def box(x: tuple[float, float], y: tuple[float, float]) -> Any:
        return lambda along, across: (
            x[0] + (x[1] - x[0]) * along,
            y[0] + (y[1] - y[0]) * across,
        )

    domain = two_strips_of_cells(
        comm,
        [
            strip_grid(2, 67, box((-0.3, 0.3), (-10.0, 10.0))),
            strip_grid(3, 4, box((0.31, 0.91), (7.7, 8.5))),
        ],
    )
    sides = {1: (0, 0.3), 2: (0, 0.31), 3: (0, -0.3), 4: (1, -10.0), 5: (0, 0.91)}
    tags = tagged(domain, sides)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, place = fem.Function(V), [fem.Constant(domain, 0.0) for _ in range(2)]
    energy = neo_hookean(u, *lame_constants(1e9, 0.3)) * ufl.dx(degree=4)
    held = [fixed(V, tags.find(5), value, component=k) for k, value in enumerate(place)]
    problem = NonlinearContactProblem(
        ufl.derivative(energy, u, ufl.TestFunction(V)),
        u,
        [ContactPair(tags, 2, 1, Coulomb(0.1), sliding="finite")],
        [fixed(V, tags.find(3), component=0), fixed(V, tags.find(4), component=1), *held],
    )

    def move(time: float) -> None:
        place[0].value, place[1].value = -0.04 * np.sin(4.0 * (time + 1.5)) + 0.02, -time

    return Process(problem, move)
