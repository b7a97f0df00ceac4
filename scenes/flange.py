"""A flange with 12 preloaded bolts: two rings and 12 bolts, held together by contact alone."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import Bonded, ContactPair, Coulomb, Frictionless
from dolfinx_tresca.scene.friction import Friction
from scenes.boxes import Body, Where, boxes
from scenes.elasticity import elasticity, fixed, lame_constants
from scenes.scene import Scene

#: Number of bolts; inner and outer radius and thickness of a ring, thickness of a bolt head [mm].
BOLTS, INNER, OUTER, THICKNESS, HEAD = 12, 60.0, 130.0, 40.0, 15.0

#: Young's modulus [MPa] and Poisson's ratio of steel; coefficient of friction.
YOUNG, POISSON, FRICTION = 2.1e5, 0.3, 0.2

#: Cells along the circumference for each bolt: the hole is the second one, the head has three.
CELLS = 4

#: Cells along the radius: the hole is the third one, the head has three. A bolt has the same number
#: of cells along its axis: the nut has one, the shank three, the head one.
ACROSS = 5


def flange(comm: MPI.Comm) -> Scene:
    """Return two rings that 12 bolts press together; the lower one is fixed. Collective.

    Bolts are prisms of the section `data.section` [mm^2] in holes of the same shape, whose walls
    the bolts do not touch. The nuts are bonded to the lower ring. The bolts shrink by
    `data.shrinkage`, a strain along their axis. The traction `data.load` [MPa] lifts the upper
    ring: it acts on the part of the upper face away from the heads, of the area `data.area` [mm^2].
    """
    width, sector = (OUTER - INNER) / ACROSS, 2.0 * np.pi / BOLTS
    hole = INNER + 2.0 * width, INNER + 3.0 * width

    def place(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells of points (radius, height, angle) along the radius and in a sector."""
        radial = np.floor((x[:, 0] - INNER) / width)
        return radial, np.floor((x[:, 2] % sector) / (sector / CELLS))

    def in_hole(x: np.ndarray) -> np.ndarray:
        radial, angular = place(x)
        return (radial == 2) & (angular == 1)

    def near_head(x: np.ndarray) -> np.ndarray:
        radial, angular = place(x)
        return (radial >= 1) & (radial <= 3) & (angular < 3)

    def bent(x: np.ndarray) -> np.ndarray:
        r, z, angle = x.T
        return np.column_stack([r * np.cos(angle), -r * np.sin(angle), z])

    def bolt(x: np.ndarray) -> np.ndarray:
        end = THICKNESS + HEAD
        layers = [-end, -THICKNESS, -THICKNESS / 3.0, THICKNESS / 3.0, THICKNESS, end]
        return bent(np.column_stack([x[:, 0], np.interp(x[:, 1], range(6), layers), x[:, 2]]))

    rings = [
        Body(
            (ACROSS, BOLTS * CELLS),
            [(INNER, OUTER), heights, (0.0, 2.0 * np.pi)],
            keep=lambda x: ~in_hole(x),
            move=bent,
        )
        for heights in ((-THICKNESS, 0.0), (0.0, THICKNESS))
    ]
    bolts = [
        Body(
            (ACROSS, 3),
            [(INNER, OUTER), (0.0, 5.0), (k * sector, (k + 0.75) * sector)],
            keep=lambda x: near_head(x) & (in_hole(x) | (np.abs(x[:, 1] - 2.5) > 1.5)),
            move=bolt,
        )
        for k in range(BOLTS)
    ]
    made = boxes(comm, "hexahedron", [*rings, *bolts])

    def at(height: float) -> Where:
        return lambda x: np.isclose(x[:, 1], height)

    def end(height: float, near: bool) -> Where:
        return lambda x: at(height)(x) & (near_head(x) == near)

    all_bolts = range(2, 2 + BOLTS)
    tags = made.tags(
        (1, [1], at(0.0)), (2, [0], at(0.0)),
        (3, all_bolts, at(4.0)), (4, [1], end(THICKNESS, True)),
        (5, all_bolts, at(1.0)), (6, [0], end(-THICKNESS, True)),
        (7, [1], end(THICKNESS, False)), (8, [0], end(-THICKNESS, False)),
    )  # fmt: skip
    V, mesh = made.V, made.mesh
    is_shank = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    is_shank.interpolate(
        lambda x: (
            1.0
            * in_hole(
                np.column_stack(
                    [np.hypot(x[0], x[1]), x[2], np.arctan2(-x[1], x[0]) % (2.0 * np.pi)]
                )
            )
            * (np.abs(x[2]) < THICKNESS)
        )
    )
    shrinkage, load = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    v, ds = ufl.TestFunction(V), ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    mu, lame = lame_constants(YOUNG, POISSON)
    pull = 2.0 * mu * ufl.grad(v)[2, 2] + lame * ufl.div(v)
    L = load * v[2] * ds(7) - shrinkage * is_shank * pull * ufl.dx
    laws: list[Friction] = [Frictionless(), Coulomb(FRICTION), Bonded()]
    pairs = [ContactPair(tags, 2 * k + 1, 2 * k + 2, law) for k, law in enumerate(laws)]
    area = comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * ds(7))))
    chords = 2.0 * np.sin(0.5 * sector / CELLS) * np.array(hole)
    section = width * np.cos(0.5 * sector / CELLS) * chords.mean()
    data = SimpleNamespace(shrinkage=shrinkage, load=load, area=area, section=section)
    bcs = [fixed(V, tags.find(8))]
    return Scene(V, elasticity(V, YOUNG, POISSON), L, bcs, pairs, tags, data=data)
