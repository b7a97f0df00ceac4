"""A block of degree 1 on a plane by an interior-point method, with operators of its own.

Nodes of the lower face move down and along the axes of the coordinates, and their areas are
integrals of their shape functions: nothing of this comes from the package.
"""

from __future__ import annotations

import math
from typing import Any

import clarabel
import numpy as np
from conic import conic_minimum

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution, Frictionless
from scenes.blocks import BELOW
from scenes.nodal import surface_nodes_of
from scenes.scene import Scene

#: Of Clarabel; and what it leaves of displacements, since energies grow with their square. Where
#: bodies are much softer somewhere, it leaves more.
TOLERANCE = 1e-12
REFERENCE, SPREAD = 9.0 * math.sqrt(TOLERANCE), 1e3

#: Gaps over the largest displacement, beyond which an interior-point method has trouble with them.
WIDE = 1e6


class BlockOnFloor:
    """K (n, n) and f (n,) of a scene on one rank, and nodes (m,) of the lower face.

    These have heights `gap` over the floor and `areas`, of rings if the block is one.
    """

    def __init__(self, scene: Scene, height: float, *, ring: bool) -> None:
        """Assemble."""
        self.V, self.law = scene.V, scene.pair.friction
        dim = self.dim = scene.mesh.geometry.dim
        self.K = fem.assemble_matrix(fem.form(scene.a)).to_dense()
        self.f = fem.assemble_vector(fem.form(scene.L)).array
        self.held, self.value = np.zeros(len(self.f), dtype=bool), np.zeros(len(self.f))
        for bc in scene.bcs:
            self.held[bc.dof_indices()[0]] = True
            bc.set(self.value)
        Q = fem.functionspace(scene.mesh, ("Lagrange", 1))
        radius = ufl.SpatialCoordinate(scene.mesh)[0]
        ds = ufl.Measure("ds", scene.mesh, subdomain_data=scene.facet_tags)
        size = 2 * np.pi * radius if ring else ufl.as_ufl(1.0)
        areas = fem.assemble_vector(fem.form(size * ufl.TestFunction(Q) * ds(BELOW))).array
        self.nodes = fem.locate_dofs_topological(Q, dim - 1, scene.facet_tags.find(BELOW))
        self.points = Q.tabulate_dof_coordinates()[self.nodes]
        self.areas = areas[self.nodes]
        self.gap = self.points[:, dim - 1] - height

    @property
    def spread(self) -> float:
        """The largest stiffness of a degree of freedom over the least."""
        diagonal = np.diag(self.K)[~self.held]
        return float(diagonal.max() / diagonal.min())

    def error(self, solution: ContactSolution) -> float:
        """Return the largest difference of a solution from the displacement of least energy.

        It is relative to the largest displacement. Slip bounds are those of the solution's
        pressures.
        """
        u = solution.u.x.array
        size = np.abs(u).max()
        if size == 0.0:
            return 0.0
        return float(np.abs(u - self._displacement(solution, size)).max() / size)

    def _ellipses(self, solution: ContactSolution) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return slip bounds (m,), semi-axes (m, d - 1) over them, and axes (d - 1, d - 1).

        Bounds are those of the pressures and the slips of the solution.
        """
        along = self.dim - 1
        ones, axes = np.ones((len(self.nodes), along)), np.eye(along)
        if isinstance(self.law, Frictionless):
            return np.zeros(len(self.nodes)), ones, axes
        terms = self.law.terms
        if terms.direction is not None:
            first = np.array(terms.direction[:2]) / np.linalg.norm(terms.direction[:2])
            axes = np.array([first, [-first[1], first[0]]])

        def values(field: Any) -> np.ndarray:
            pair = field if isinstance(field, tuple) else (field,) * along
            found = [one(self.points.T) if callable(one) else one * ones[:, 0] for one in pair]
            return np.stack(found, axis=1)

        constant, coefficient, limit = map(values, (terms.constant, terms.coefficient, terms.limit))
        shape = ones
        for found in (constant, coefficient, limit):
            if (found != found[:, :1]).any():
                shape = found / found.max(axis=1, keepdims=True)
        pressure, slip = self._pressure_and_slip(solution)
        F = coefficient.max(axis=1) if terms.curve is None else terms.curve.values(pressure, slip)
        grown = np.minimum(F * pressure, limit.max(axis=1))
        return constant.max(axis=1) + grown, shape, axes

    def _pressure_and_slip(self, solution: ContactSolution) -> tuple[np.ndarray, np.ndarray]:
        """Return those of a solution at the nodes; zero at held nodes, which have none."""
        points, fields = surface_nodes_of(solution)
        mine = np.linalg.norm(points[:, None] - self.points, axis=2).argmin(axis=1)
        pressure, slip = np.zeros((2, len(self.nodes)))
        pressure[mine] = np.maximum(fields["pressure"], 0.0)
        if "slip" in fields:  # else friction acts at no node
            slip[mine] = np.linalg.norm(fields["slip"], axis=1)
        return pressure, slip

    def _displacement(self, solution: ContactSolution, unit: float) -> np.ndarray:
        """Return u (n,) of least energy, which is about as large as `unit`."""
        n, m, along = len(self.f), len(self.nodes), self.dim - 1
        stiff = np.abs(np.diag(self.K)).max()
        bound, shape, axes = self._ellipses(solution)
        P, q = np.zeros((n + m, n + m)), np.zeros(n + m)
        P[:n, :n], q[:n] = self.K / stiff, -self.f / (stiff * unit)
        q[n:] = bound * self.areas / (stiff * unit)
        identity = np.eye(n + m)
        own = self.nodes[:, None] * self.dim + np.arange(self.dim)
        presses = ~self.held[own[:, -1]]
        rows = [identity[:n][self.held], -identity[own[presses, -1]]]
        right = [self.value[self.held] / unit, np.minimum(self.gap[presses] / unit, WIDE)]
        cones: list[Any] = [
            clarabel.ZeroConeT(int(self.held.sum())),
            clarabel.NonnegativeConeT(int(presses.sum())),
        ]
        for node in range(m):
            slips = shape[node, :, None] * (axes @ identity[own[node, :-1]])
            rows.append(-np.vstack([identity[n + node], slips]))
            right.append(np.zeros(1 + along))
            cones.append(clarabel.SecondOrderConeT(1 + along))
        found = conic_minimum(P, q, rows, right, cones, TOLERANCE)
        assert str(found.status) in ("Solved", "AlmostSolved"), found.status
        return unit * np.array(found.x)[:n]
