"""A sheet that a round punch bends into a die (NAFEMS R0094); half of it, plane strain; mm, MPa."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Literal

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactPair,
    Frictionless,
    NonlinearContactProblem,
    RigidObstacle,
    RigidSphere,
)
from scenes.elasticity import elasticity, fixed, no_load
from scenes.metal import Metal
from scenes.scene import Scene

#: Half the length of the sheet, and its thickness.
LENGTH, THICKNESS = 60.0, 1.0

#: Radius of the punch; radius of the die's shoulder and the place where its flat part begins.
PUNCH, SHOULDER, FLAT = 23.5, 4.0, 29.0

#: Young's modulus and Poisson's ratio.
YOUNG, POISSON = 70_500.0, 0.342

#: Tags of the lower face, of the upper face, and of the symmetry plane.
BELOW, ABOVE, MIDDLE = 1, 2, 3


def distance_from_die(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the signed distance (n,) of points (3, n) from the die, and its gradient (3, n).

    The die is flat, and ends in a shoulder that is a quarter of a circle. Below it is a round
    cavity, in which the sheet has room for the punch.
    """
    centre = np.array([[FLAT], [-SHOULDER]])
    from_shoulder = x[:2] - centre
    from_cavity = x[:2] - [[0.0], [-SHOULDER]]
    radii = [np.maximum(np.hypot(*v), 1e-12) for v in (from_shoulder, from_cavity)]
    regions = [x[0] >= FLAT, x[1] >= -SHOULDER]
    distance = np.select(regions, [x[1], radii[0] - SHOULDER], FLAT - SHOULDER - radii[1])
    up = np.array([[0.0], [1.0]]) + 0.0 * x[:2]
    gradient = np.select(regions, [up, from_shoulder / radii[0]], -from_cavity / radii[1])
    return distance, np.vstack([gradient, 0.0 * distance])


#: Stroke of the punch at which the sheet is bent.
STROKE = 28.5


def hardening(strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the yield stress [MPa] of aluminium 6111-T4 and its slope, at a plastic strain."""
    shifted = np.maximum(0.0093 + strain, 1e-6)
    stress = 550.4 * shifted**0.223
    return stress, 0.223 * stress / shifted


@dataclass(frozen=True)
class PlasticSheet:
    """A sheet of metal in the die.

    Attributes:
        problem: the contact problem.
        punch: the punch.
        u: displacement.
        history: Functions of the metal's history.
    """

    problem: NonlinearContactProblem
    punch: RigidSphere
    u: fem.Function
    history: list[fem.Function]

    def angle(self) -> float:
        """Return the angle between the two halves of the sheet, 15 mm at its ends. Collective."""
        V = self.u.function_space
        places, moved = V.tabulate_dof_coordinates(), self.u.x.array.reshape(-1, 2)
        owned = V.dofmap.index_map.size_local
        ends = np.zeros((2, 2))
        for end, at in zip(ends, (LENGTH - 15.0, LENGTH), strict=True):
            here = np.isclose(places[:owned, :2], [at, THICKNESS / 2.0]).all(axis=1)
            end[:] = (places[:owned, :2] + moved[:owned])[here].sum(axis=0)
        ends = V.mesh.comm.allreduce(ends)
        return 180.0 - 2.0 * float(np.degrees(np.arctan2(*(ends[1] - ends[0])[::-1])))


def plastic_sheet(comm: MPI.Comm, cells: tuple[int, int]) -> PlasticSheet:
    """Return a sheet of aluminium in the die, with finite sliding. Collective.

    Args:
        comm: communicator of the mesh.
        cells: numbers of cells along the sheet and across it.
    """
    scene = bent_sheet(comm, cells, sliding="finite")
    u = fem.Function(scene.V)
    metal = Metal(u, YOUNG, POISSON, hardening)
    F = ufl.derivative(metal.energy, u, ufl.TestFunction(scene.V))
    problem = NonlinearContactProblem(F, u, scene.pairs, scene.bcs, on_accept=metal.accept)
    return PlasticSheet(problem, scene.data.punch, u, metal.history)


def bent_sheet(
    comm: MPI.Comm,
    cells: tuple[int, int],
    *,
    degree: int = 2,
    sliding: Literal["small", "finite"] = "small",
) -> Scene:
    """Return an elastic sheet that lies on the die, under the punch. Collective.

    The punch is `data.punch`.

    Args:
        comm: communicator of the mesh.
        cells: numbers of cells along the sheet and across it.
        degree: degree of the displacement.
        sliding: see `ContactPair`.
    """
    corners = [(0.0, 0.0), (LENGTH, THICKNESS)]
    domain = mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    domain.topology.create_connectivity(1, 2)
    marked = {
        tag: mesh.locate_entities_boundary(domain, 1, lambda x, k=k, at=at: np.isclose(x[k], at))
        for tag, k, at in ((BELOW, 1, 0.0), (ABOVE, 1, THICKNESS), (MIDDLE, 0, 0.0))
    }
    facets = np.concatenate(list(marked.values()))
    values = np.repeat(np.array(list(marked), np.int32), [len(f) for f in marked.values()])
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, 1, facets[order], values[order])
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    punch = RigidSphere((0.0, THICKNESS + PUNCH), PUNCH)
    die = RigidObstacle(distance_from_die, name="die")
    pairs = [
        ContactPair(tags, tag, obstacle, Frictionless(), sliding=sliding, name=name)
        for tag, obstacle, name in ((BELOW, die, "die"), (ABOVE, punch, "punch"))
    ]
    bcs = [fixed(V, tags.find(MIDDLE), component=0)]
    a = elasticity(V, YOUNG, POISSON)
    return Scene(V, a, no_load(V), bcs, pairs, tags, data=SimpleNamespace(punch=punch))
