"""A square between two rigid plates, sheared and pressed: four singular corners, no contact."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from scenes.assembled import linear_solution
from scenes.elasticity import elasticity, no_load
from scenes.manufactured import norm


def clamped_square(
    comm: MPI.Comm,
    cell: str,
    n: int,
    degree: int,
    poisson: float = 0.3,
    grading: float = 1.0,
) -> tuple[Any, fem.Function, float]:
    """Return the bilinear form, the displacement, and its energy norm. Collective.

    By Galerkin's orthogonality the squared energy norm of a solution minus the squared norm of the
    exact one is the square of the error.

    Args:
        comm: communicator of the mesh.
        cell: "triangle" or "quadrilateral".
        n: cells along each side.
        degree: degree of the displacement.
        poisson: ratio; Young's modulus is 1.
        grading: exponent with which nodes gather at the sides; 1: a uniform mesh.
    """
    mesh = dolfinx.mesh.create_unit_square(comm, n, n, dolfinx.mesh.CellType[cell])
    x = 2.0 * mesh.geometry.x[:, :2]
    near = np.minimum(x, 2.0 - x)
    mesh.geometry.x[:, :2] = 0.5 * np.where(x < 1.0, near**grading, 2.0 - near**grading)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    a, plates = elasticity(V, 1.0, poisson), fem.Function(V)
    held = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1] * (1.0 - x[1]), 0.0))
    plates.interpolate(lambda x: np.stack([0.5 * x[1], -x[1]]))
    u = linear_solution(a, no_load(V), [fem.dirichletbc(plates, held)])
    return a, u, norm(comm, ufl.action(ufl.action(a, u), u))
