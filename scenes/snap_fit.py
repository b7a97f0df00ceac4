"""A snap-fit hook that a rigid block bends down, passes, and lets go; plane stress, mm, MPa.

The hook is a beam whose thickness halves towards its end. There it has a nose with a gentle slope
for the way in and a steep one for the way out. The block has round edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import ContactPair, NonlinearContactProblem, RigidObstacle
from dolfinx_tresca.scene.friction import Friction
from scenes.elasticity import fixed
from scenes.rubber_block import neo_hookean

#: Length of the beam up to the nose's tip, thickness at the root, height and width of the nose's
#: flat end, width of the hook.
LENGTH, ROOT, HEIGHT, FLAT, WIDTH = 19.0, 3.28, 2.4, 1.0, 9.5

#: Slopes of the nose on the way in and on the way out [rad].
IN, OUT = np.pi / 6.0, np.pi / 3.0

#: Young's modulus; Poisson's ratio is zero.
YOUNG = 1815.0

#: Place of the block at the start, its length, and the radius of its edges.
PLACE, BLOCK, EDGE = 24.3, 2.0, 0.3


def distance_from_block(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the signed distance (n,) of points (3, n) from the block, and its gradient (3, n)."""
    middle = PLACE + BLOCK / 2.0
    side = np.where(x[0] >= middle, 1.0, -1.0)
    # beyond the centres of the edges, outwards along x and below
    beyond = np.array([np.abs(x[0] - middle) - (BLOCK / 2.0 - EDGE), EDGE - x[1]])
    outside = np.maximum(beyond, 0.0)
    length = np.hypot(*outside)
    at_edge = (beyond > 0.0).all(axis=0)
    distance = np.where(at_edge, length, beyond.max(axis=0)) - EDGE
    nearest = np.where(beyond[0] > beyond[1], [[1.0], [0.0]], [[0.0], [1.0]])
    outward = np.where(at_edge, outside / np.maximum(length, 1e-30), nearest)
    return distance, np.array([side * outward[0], -outward[1], 0.0 * x[0]])


@dataclass(frozen=True)
class SnapFit:
    """A hook and a block.

    Attributes:
        problem: the contact problem.
        u: its displacement.
        energy: form of the stored energy per width [N].
        push: function that moves the block to a distance [mm] from its first place.
    """

    problem: NonlinearContactProblem
    u: fem.Function
    energy: ufl.Form
    push: Callable[[float], None]


def snap_fit(comm: MPI.Comm, friction: Friction, refined: int = 1) -> SnapFit:
    """Return the problem of a hook of degree 2. Collective.

    Args:
        comm: communicator of the mesh.
        friction: law of friction on the hook.
        refined: factor on the numbers of cells.
    """
    corners = LENGTH + np.array([-HEIGHT / np.tan(OUT), 0.0, FLAT, FLAT + HEIGHT / np.tan(IN)])
    along = np.append(0.0, corners)
    cells = refined * np.array([28, 5, 4, 14])
    parts = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(along, along[1:], cells, strict=False)]
    places = np.append(0.0, np.concatenate(parts))
    counts = (int(cells.sum()), 4 * refined)
    domain = mesh.create_rectangle(
        comm, [(0.0, 0.0), (float(counts[0]), 1.0)], counts, mesh.CellType.quadrilateral
    )
    domain.topology.create_connectivity(1, 2)
    facets = [
        mesh.locate_entities_boundary(domain, 1, lambda x, k=k, at=at: np.isclose(x[k], at))
        for k, at in ((1, 1.0), (0, 0.0))
    ]
    upper, root = (np.sort(found) for found in facets)
    tags = mesh.meshtags(domain, 1, upper, np.ones(len(upper), np.int32))
    number, across = domain.geometry.x[:, :2].T.copy()
    x = np.interp(number, np.arange(len(places)), places)
    above = np.interp(x, along, [0.0, 0.0, HEIGHT, HEIGHT, 0.0])
    below = -ROOT * np.maximum(1.0 - 0.5 * x / LENGTH, 0.5)
    domain.geometry.x[:, 0], domain.geometry.x[:, 1] = x, below + across * (above - below)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u = fem.Function(V)
    energy = neo_hookean(u, YOUNG / 2.0, 0.0) * ufl.dx(degree=4)
    F = ufl.derivative(energy, u, ufl.TestFunction(V))
    block = RigidObstacle(distance_from_block, name="block")
    pair = ContactPair(tags, 1, block, friction, sliding="finite")
    problem = NonlinearContactProblem(F, u, [pair], [fixed(V, root)])
    return SnapFit(problem, u, energy, lambda distance: block.move_to((-distance, 0.0)))
