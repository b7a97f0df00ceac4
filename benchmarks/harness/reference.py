"""Errors of solutions against a reference on a fine mesh, which need not be nested in theirs.

Gradients of the displacement are compared at the points of a quadrature rule on the reference mesh.
At each point the gradient is taken from the cell of the same body that contains the point, or, near
curved boundaries, from the nearest cell. Pressure and slip are compared in the same way on the
contact surface. All functions run on one rank.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

import basix
import ufl
from dolfinx import fem, geometry

from dolfinx_tresca import ContactSolution
from dolfinx_tresca._base.compat import geometry_dofmap, interpolation_points
from scenes.elasticity import lame_constants
from scenes.hertz_theory import HertzSphere
from scenes.scene import Scene

Array = np.ndarray

#: Degree and type of the quadrature rule in cells of the reference. The rule is exact for squares
#: of the reference's strains, and has no points on faces, where gradients jump.
RULE = (2, basix.QuadratureType.default)


@dataclass(frozen=True)
class Samples:
    """Points and weights of a quadrature rule on all or some cells of a mesh."""

    mesh: Any
    cells: Array

    def values(self, expression: Any) -> Array:
        """Return the values of a UFL expression (points, ...)."""
        compiled = fem.Expression(expression, self._rule[0])
        values = compiled.eval(self.mesh, self.cells)
        return np.asarray(values).reshape(len(self.cells) * len(self._rule[1]), -1)

    @property
    def _rule(self) -> tuple[Array, Array]:
        kind = basix.CellType[self.mesh.topology.cell_name()]
        degree, rule = RULE
        return basix.make_quadrature(kind, degree, rule)

    @property
    def points(self) -> Array:
        """Positions (n, 3) of the points."""
        places = self.values(ufl.SpatialCoordinate(self.mesh))
        return np.pad(places, [(0, 0), (0, 3 - places.shape[1])])

    @property
    def weights(self) -> Array:
        """Quadrature weights (n,) of the points."""
        jacobian = np.abs(self.values(ufl.JacobianDeterminant(self.mesh))[:, 0])
        return jacobian * np.tile(self._rule[1], len(self.cells))


def depth(mesh: Any, cells: Array, points: Array) -> Array:
    """Return the depth of points (n, 3) inside affine cells (n,), one for each; negative outside.

    The depth is the least distance from a face, in the coordinates of the reference cell.
    """
    nodes = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
    simplices = mesh.topology.cell_name() == "tetrahedron"
    edges = nodes[:, [1, 2, 3] if simplices else [1, 2, 4]] - nodes[:, :1]
    X = np.linalg.solve(edges.transpose(0, 2, 1), (points - nodes[:, 0])[:, :, None])[:, :, 0]
    opposite = 1 - X.sum(axis=1) if simplices else (1 - X).min(axis=1)
    return np.minimum(X.min(axis=1), opposite)


def cells_at(mesh: Any, points: Array, allowed: Array) -> Array:
    """Return for each point the cell in `allowed` that contains it or is nearest to it."""
    dim = mesh.topology.dim
    tree = geometry.bb_tree(mesh, dim, entities=allowed)
    cells = np.full(len(points), -1, dtype=np.int32)
    if dim == 3:  # compute_colliding_cells also returns neighbours, where gradients differ
        near = geometry.compute_collisions_points(tree, points)
        owner = np.repeat(np.arange(len(points)), np.diff(near.offsets))
        order = np.argsort(depth(mesh, near.array, points[owner]))  # deepest last
        cells[owner[order]] = near.array[order]
    outside = cells < 0
    if outside.any():
        middles = geometry.create_midpoint_tree(mesh, dim, allowed)
        cells[outside] = geometry.compute_closest_entity(tree, middles, mesh, points[outside])
    return cells


def all_cells(mesh: Any) -> Array:
    """Return the numbers of all cells."""
    return np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)


def gradient_at(scene: Scene, u: Any, points: Array, cells: Array) -> Array:
    """Return grad u (n, d * d) at points in cells."""
    degree = scene.V.element.basix_element.degree
    simplices = scene.mesh.topology.cell_name() in ("triangle", "tetrahedron")
    dim = scene.mesh.geometry.dim
    space = fem.functionspace(scene.mesh, ("DG", degree - simplices, (dim, dim)))
    gradient = fem.Function(space)
    gradient.interpolate(fem.Expression(ufl.grad(u), interpolation_points(space.element)))
    return np.asarray(gradient.eval(points, cells)).reshape(len(points), dim**2)


class Reference:
    """A solution on a fine mesh, with which solutions on coarser meshes are compared.

    Attributes:
        own: estimated relative error of the reference itself in the energy norm. Its square is
            added to the square of a solution's difference from the reference, as the squares of
            errors add up for Galerkin's method on nested meshes.
    """

    def __init__(self, scene: Scene, solution: ContactSolution, own: float = 0.0) -> None:
        self.own = own
        self._numbers, theory = numbers(solution), theory_of(scene, solution)
        mesh, surface = scene.mesh, solution.surface
        self._volumes = {}
        mu_and_lame = lame_constants(scene.data.young, scene.data.poisson)
        for name in scene.data.bodies:
            if not len(scene.cell_tags.find(scene.tags[name])):
                continue
            samples = Samples(mesh, np.sort(scene.cell_tags.find(scene.tags[name])))
            gradient, mu, lame = (
                samples.values(expression)
                for expression in (ufl.grad(solution.u), *map(ufl.as_ufl, mu_and_lame))
            )
            self._volumes[name] = samples.points, samples.weights, gradient, mu[:, 0], lame[:, 0]
        samples = Samples(surface.mesh, all_cells(surface.mesh))
        self._points, self._weights = samples.points, samples.weights
        self._fields = {"pressure": samples.values(surface.pressure)}
        if theory is not None:
            r = np.linalg.norm(self._points[:, :2], axis=1)
            self._fields["pressure"] = theory.pressure(r)[:, None]
            self._numbers["peak"] = theory.peak
        if surface.slip is not None:
            self._fields["slip"] = samples.values(surface.slip)

    def errors(self, scene: Scene, solution: ContactSolution) -> dict[str, float]:
        """Return relative errors: in the energy norm, in L2 of the contact, and of numbers."""
        square = whole = 0.0
        for name, (points, weights, wanted, mu, lame) in self._volumes.items():
            body = np.sort(scene.cell_tags.find(scene.tags[name]))
            gradient = gradient_at(scene, solution.u, points, cells_at(scene.mesh, points, body))
            square += float(weights @ density(gradient - wanted, mu, lame))
            whole += float(weights @ density(wanted, mu, lame))
        result = {"energy": (square / whole + self.own**2) ** 0.5}
        for name, value in numbers(solution).items():
            result[name] = abs(value / self._numbers[name] - 1.0)
        mesh = solution.surface.mesh
        cells = cells_at(mesh, self._points, all_cells(mesh))
        for name, wanted in self._fields.items():
            function = getattr(solution.surface, name)
            values = np.asarray(function.eval(self._points, cells)).reshape(wanted.shape)
            squares = ((values - wanted) ** 2, wanted**2)
            difference, total = (float(self._weights @ square.sum(axis=1)) for square in squares)
            result[name] = (difference / total) ** 0.5
        return result


def theory_of(scene: Scene, solution: ContactSolution) -> HertzSphere | None:
    """Return Hertz's theory for the force of the ball; None for other scenes.

    The relative error of the theory is about (a/R)^2.
    """
    if not hasattr(scene.data, "theory"):
        return None
    theory: HertzSphere = scene.data.theory(scene.data.share * solution.normal_force)
    return theory


def numbers(solution: ContactSolution) -> dict[str, float]:
    """Return the numbers that are compared."""
    return {"peak": solution.peak_pressure, "force": solution.normal_force}


def density(gradient: Array, mu: Array, lame: Array) -> Array:
    """Return twice the elastic energy density (n,) of gradients (n, d * d)."""
    dim = math.isqrt(gradient.shape[1])
    G = gradient.reshape(-1, dim, dim)
    strain = 0.5 * (G + G.transpose(0, 2, 1))
    trace = np.trace(strain, axis1=1, axis2=2)
    result: Array = 2 * mu * np.einsum("nij,nij->n", strain, strain) + lame * trace**2
    return result
