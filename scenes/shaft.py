"""A shaft in a hub with clearance, pressed and turned, in plane strain; lengths in mm, MPa."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactSolution, Coulomb
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity, fixed
from scenes.scene import Scene

BORE, RADIUS, RIM, CLEARANCE = 5.0, 10.0, 20.0, 0.01  # mm
YOUNG, POISSON, FRICTION = 2e5, 0.3, 0.3

#: Tags of facets.
LOADED, SHAFT, HUB, HELD = range(1, 5)


def shaft_in_hub(comm: MPI.Comm, n: int = 96) -> Scene:
    """Return the scene; contact alone holds the shaft. Collective.

    `data.weight` [N/mm] presses the bore of the shaft downwards, `data.moment` [N] turns it.

    Args:
        comm: communicator of the mesh.
        n: cells round the shaft, a multiple of 12; the hub has a third more.
    """
    spans = [(BORE, RADIUS), (RADIUS + CLEARANCE, RIM)]

    def polar(x: np.ndarray) -> np.ndarray:
        return x[:, 1:] * np.column_stack([np.cos(x[:, 0]), np.sin(x[:, 0])])

    bodies = [
        Body((cells, n // 12), [(0.0, 2 * np.pi), span], move=polar)
        for cells, span in zip((n, 4 * n // 3), spans, strict=True)
    ]
    made = boxes(comm, "quadrilateral", bodies)
    marks = zip((LOADED, SHAFT, HUB, HELD), (0, 0, 1, 1), (*spans[0], *spans[1]), strict=True)
    tags = made.tags(*((tag, [body], near(1, radius)) for tag, body, radius in marks))
    V, mesh = made.V, made.mesh
    weight, moment = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    (x, y), v = ufl.SpatialCoordinate(mesh), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(LOADED)
    turning = (x * v[1] - y * v[0]) / BORE**2
    L = (moment * turning - weight * v[1]) / (2 * np.pi * BORE) * ds
    pairs = [ContactPair(tags, SHAFT, HUB, Coulomb(FRICTION))]
    a, data = elasticity(V, YOUNG, POISSON), SimpleNamespace(weight=weight, moment=moment)
    return Scene(V, a, L, [fixed(V, tags.find(HELD))], pairs, tags, data=data)


def greatest_moment(solution: ContactSolution) -> float:
    """Return the moment [N] about the axis if all nodes slipped under the pressures of a solution.

    Pressures change with the moment, so this is the limit only when the shaft is near it.
    """
    return FRICTION * RADIUS * solution.normal_force
