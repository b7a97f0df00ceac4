"""A disc spring between two plates, which contact alone holds; its section, mm, MPa."""

from __future__ import annotations

from typing import Literal

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import ContactPair, NonlinearContactProblem, RigidPlane
from dolfinx_tresca.scene.friction import Friction
from scenes.rubber_block import neo_hookean

#: Radii of the hole and of the rim, thickness, and height of the cone [mm].
INNER, OUTER, THICKNESS, HEIGHT = 10.0, 20.0, 1.0, 0.4

#: Young's modulus [MPa] and Poisson's ratio of steel.
YOUNG, POISSON = 206e3, 0.3


def disc_spring(
    comm: MPI.Comm,
    friction: Friction,
    sliding: Literal["small", "finite"],
    cells: tuple[int, int] = (10, 2),
    unit: float = 1.0,
    height: float = HEIGHT,
) -> tuple[NonlinearContactProblem, RigidPlane]:
    """Return the problem of a spring on its rim under a plate, and this plate. Collective.

    Args:
        comm: communicator of the mesh.
        friction: law of friction on both plates.
        sliding: "small" or "finite".
        cells: numbers of cells along and across the section.
        unit: length of a millimetre in the units of the mesh.
        height: height of the cone [mm].
    """
    corners = [(0.0, 0.0), (1.0, 1.0)]
    domain = mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    along, across = domain.geometry.x[:, :2].T.copy()
    width = np.sqrt(np.hypot(OUTER - INNER, height + THICKNESS) ** 2 - THICKNESS**2)
    angle = np.arctan2(height + THICKNESS, OUTER - INNER) - np.arctan2(THICKNESS, width)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    section = np.column_stack([(along - 1.0) * width, across * THICKNESS])
    domain.geometry.x[:, :2] = unit * (section @ turn + [OUTER, 0.0])
    domain.topology.create_connectivity(1, 2)
    facets = np.sort(mesh.exterior_facet_indices(domain.topology))
    tags = mesh.meshtags(domain, 1, facets, np.ones(len(facets), np.int32))
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u = fem.Function(V)
    radius = ufl.SpatialCoordinate(domain)[0]
    stretch = ufl.ln(1.0 + u[0] / radius)
    mu, lam = YOUNG / 2.0 / (1.0 + POISSON), YOUNG * POISSON / (1.0 + POISSON) / (1 - 2 * POISSON)
    log_J = ufl.ln(ufl.det(ufl.Identity(2) + ufl.grad(u)))
    energy = neo_hookean(u, mu, lam) + mu / 2.0 * (ufl.exp(2.0 * stretch) - 1.0 - 2.0 * stretch)
    energy += lam / 2.0 * (2.0 * log_J * stretch + stretch**2)
    F = ufl.derivative(energy * 2.0 * np.pi * radius * ufl.dx(degree=4), u, ufl.TestFunction(V))
    lower = RigidPlane((0.0, 0.0), (0.0, 1.0))
    upper = RigidPlane((0.0, unit * (height + THICKNESS)), (0.0, -1.0))
    pairs = [ContactPair(tags, 1, plate, friction, sliding=sliding) for plate in (lower, upper)]
    return NonlinearContactProblem(F, u, pairs, axisymmetric=True), upper
