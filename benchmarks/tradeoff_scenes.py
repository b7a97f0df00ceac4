"""The scenes of benchmarks/tradeoff.py on any mesh, and errors against a fine reference.

Meshes of a scene need not be nested. Gradients of the displacement are compared at the points of a
quadrature rule on the reference mesh, each in the cell of the same body that holds the point (or is
next to it, where boundaries are curved); pressure and slip likewise, on the contact surface. It
runs on one rank.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
import ufl
from dolfinx import fem, geometry

from dolfinx_tresca import ContactProblem, ContactSolution
from dolfinx_tresca._base.compat import geometry_dofmap, interpolation_points
from scenes import implant as stem
from scenes import two_bricks as bricks
from scenes.elasticity import lame_constants
from scenes.hertz import sphere_on_plane
from scenes.scene import Scene

Array = np.ndarray

#: Rule on the reference mesh: no point of it is on a face, where gradients jump.
RULE = (4, basix.QuadratureType.gauss_jacobi)

#: Rate with which the energy error of references falls, for the guess of their own error.
RATE = 1.5


def energy_norm(scene: Scene, u: Any) -> float:
    """Return |u|_K of a displacement on the mesh of a scene."""
    return float(fem.assemble_scalar(fem.form(ufl.action(ufl.action(scene.a, u), u)))) ** 0.5


def two_bricks(N: float, cell: str, degree: int, grading: float = 1.0) -> Scene:
    """Return the two bricks, loaded at the free end of the upper one; N cells along each.

    With a grading g, the distances of nodes from the nearest face of their brick go with the power
    g of what they were: singularities are at the edges.
    """
    scene = bricks.two_bricks(MPI.COMM_SELF, int(N), hexahedra=cell == "hexahedra", degree=degree)
    if grading != 1.0:
        x, size = scene.mesh.geometry.x, np.array([2.0, 1.0, 1.0])
        upper = np.zeros(len(x))
        cells = scene.cell_tags.find(scene.tags["upper"])
        upper[geometry_dofmap(scene.mesh)[cells]] = 1.0
        start = np.outer(upper, [0.0, 0.0, 1.0])
        t = (2 * (x - start) / size).clip(0, 2)
        moved = np.where(t < 1, t**grading, 2 - (2 - t) ** grading)
        x[:] = start + 0.5 * size * moved
    return scene


def hertz(h: float, cell: str, degree: int, grading: float = 1.0) -> Scene:
    """Return the ball on a plane with cells of size h [mm] at the contact.

    Cells elsewhere shrink along with h.
    """
    return sphere_on_plane(MPI.COMM_SELF, h, degree=degree, Growth=2.5 * h / degree)


def implant(N: float, cell: str, degree: int, grading: float = 1.0) -> Scene:
    """Return the stem in bone after the whole motion, N cells round the half hole.

    The modulus is a function of the place inside a cell as well, and cells far from the stem are
    smaller and shrink along with the others: else the outer walls of the bone, where the modulus
    rises by a factor of 15 within a cell, would have most of the error.
    """
    scene = stem.implant(
        MPI.COMM_SELF, int(N), degree=degree, smooth=True, Growth=min(0.35, 4.0 / N)
    )
    scene.data.motion.value[:] = stem.MOTION
    return scene


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
        """Their places (n, 3)."""
        places = self.values(ufl.SpatialCoordinate(self.mesh))
        return np.pad(places, [(0, 0), (0, 3 - places.shape[1])])

    @property
    def weights(self) -> Array:
        """Their weights (n,)."""
        jacobian = np.abs(self.values(ufl.JacobianDeterminant(self.mesh))[:, 0])
        return jacobian * np.tile(self._rule[1], len(self.cells))


def depth(mesh: Any, cells: Array, points: Array) -> Array:
    """Return by how much points (n, 3) are inside affine cells (n,): negative where outside.

    It is the least distance from a face, in the coordinates of the reference cell.
    """
    nodes = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
    simplices = mesh.topology.cell_name() == "tetrahedron"
    edges = nodes[:, [1, 2, 3] if simplices else [1, 2, 4]] - nodes[:, :1]
    X = np.linalg.solve(edges.transpose(0, 2, 1), (points - nodes[:, 0])[:, :, None])[:, :, 0]
    last = 1 - X.sum(axis=1) if simplices else (1 - X).min(axis=1)
    return np.minimum(X.min(axis=1), last)


def cells_at(mesh: Any, points: Array, allowed: Array) -> Array:
    """Return for each point the cell that holds it, or is next to it."""
    dim = mesh.topology.dim
    tree = geometry.bb_tree(mesh, dim, entities=allowed)
    found = np.full(len(points), -1, dtype=np.int32)
    if dim == 3:  # compute_colliding_cells also returns neighbours, where gradients differ
        near = geometry.compute_collisions_points(tree, points)
        owner = np.repeat(np.arange(len(points)), np.diff(near.offsets))
        order = np.argsort(depth(mesh, near.array, points[owner]))  # the deepest one comes last
        found[owner[order]] = near.array[order]
    rest = found < 0
    if rest.any():
        middles = geometry.create_midpoint_tree(mesh, dim, allowed)
        found[rest] = geometry.compute_closest_entity(tree, middles, mesh, points[rest])
    return found


def all_cells(mesh: Any) -> Array:
    """Return the numbers of all cells."""
    return np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)


def gradient_at(case: Scene, u: Any, points: Array, cells: Array) -> Array:
    """Return grad u (n, d * d) at points in cells."""
    degree = case.V.element.basix_element.degree
    simplices = case.mesh.topology.cell_name() in ("triangle", "tetrahedron")
    dim = case.mesh.geometry.dim
    space = fem.functionspace(case.mesh, ("DG", degree - simplices, (dim, dim)))
    gradient = fem.Function(space)
    gradient.interpolate(fem.Expression(ufl.grad(u), interpolation_points(space.element)))
    return np.asarray(gradient.eval(points, cells)).reshape(len(points), dim**2)


class Reference:
    """A solution on a fine mesh, with which others are compared."""

    def __init__(self, case: Scene, solution: ContactSolution) -> None:
        mesh, surface = case.mesh, solution.surface
        self._volumes = {}
        mu_and_lame = lame_constants(case.data.young, case.data.poisson)
        for name in case.data.bodies:
            if not len(case.cell_tags.find(case.tags[name])):
                continue
            samples = Samples(mesh, np.sort(case.cell_tags.find(case.tags[name])))
            gradient, mu, lame = (
                samples.values(expression)
                for expression in (ufl.grad(solution.u), *map(ufl.as_ufl, mu_and_lame))
            )
            self._volumes[name] = samples.points, samples.weights, gradient, mu[:, 0], lame[:, 0]
        samples = Samples(surface.mesh, all_cells(surface.mesh))
        self._points, self._weights = samples.points, samples.weights
        self._fields = {"pressure": samples.values(surface.pressure)}
        if surface.slip is not None:
            self._fields["slip"] = samples.values(surface.slip)

    def errors(self, case: Scene, solution: ContactSolution) -> dict[str, float]:
        """Return relative errors: energy norm, pressure and slip in L2 of the contact surface."""
        square = whole = 0.0
        for name, (points, weights, wanted, mu, lame) in self._volumes.items():
            cells = case.cell_tags.find(case.tags[name])
            at = cells_at(case.mesh, points, np.sort(cells))
            found = gradient_at(case, solution.u, points, at)
            square += float(weights @ density(found - wanted, mu, lame))
            whole += float(weights @ density(wanted, mu, lame))
        result = {"energy": (square / whole) ** 0.5}
        mesh = solution.surface.mesh
        at = cells_at(mesh, self._points, all_cells(mesh))
        for name, wanted in self._fields.items():
            function = getattr(solution.surface, name)
            found = np.asarray(function.eval(self._points, at)).reshape(wanted.shape)
            squares = ((found - wanted) ** 2, wanted**2)
            difference, total = (float(self._weights @ square.sum(axis=1)) for square in squares)
            result[name] = (difference / total) ** 0.5
        return result


def density(gradient: Array, mu: Array, lame: Array) -> Array:
    """Return twice the elastic energy density (n,) of gradients (n, d * d)."""
    dim = math.isqrt(gradient.shape[1])
    G = gradient.reshape(-1, dim, dim)
    strain = 0.5 * (G + G.transpose(0, 2, 1))
    trace = np.trace(strain, axis1=1, axis2=2)
    result: Array = 2 * mu * np.einsum("nij,nij->n", strain, strain) + lame * trace**2
    return result


@dataclass(frozen=True)
class Mesh:
    """A kind of mesh and element, and its size: N, or h [mm] for Hertz."""

    cell: str
    degree: int
    size: float
    grading: float = 1.0

    @property
    def family(self) -> str:
        """A name without the size."""
        name = {"tetrahedra": "P", "hexahedra": "Q"}[self.cell] + str(self.degree)
        return name + (" graded" if self.grading != 1.0 else "")


def family(cell: str, degree: int, *sizes: float, grading: float = 1.0) -> list[Mesh]:
    """Return meshes of a kind, coarse to fine."""
    return [Mesh(cell, degree, size, grading) for size in sizes]


@dataclass(frozen=True)
class Study:
    """How to build a scene, on which meshes, and what it is compared with."""

    build: Callable[..., Scene]
    meshes: list[Mesh]
    base: tuple[Mesh, ...]  # on which accuracy, algorithm and K-solver are varied
    references: tuple[Mesh, ...]  # fine to coarse: the second one tells the error of the first one

    def coarsest(self, count: int) -> list[Mesh]:
        """Return so many meshes of each kind, and those on which settings are varied."""
        kinds = itertools.groupby(self.meshes, key=lambda mesh: mesh.family)
        chosen = {mesh for _, kind in kinds for mesh in itertools.islice(kind, count)}
        return [mesh for mesh in self.meshes if mesh in chosen or mesh in self.base]

    def case(self, mesh: Mesh) -> Scene:
        """Return the scene on a mesh."""
        return self.build(mesh.size, mesh.cell, mesh.degree, mesh.grading)


SCENES = {
    "two_bricks": Study(
        two_bricks,
        [
            *family("tetrahedra", 1, 6, 8, 12, 16, 24, 32),
            *family("hexahedra", 1, 6, 8, 12, 16, 24),
            *family("tetrahedra", 2, 4, 6, 8, 12),
            *family("hexahedra", 2, 4, 6, 8, 12),
            *family("hexahedra", 2, 4, 6, 8, 12, 14, grading=2.0),
        ],
        (Mesh("tetrahedra", 1, 16), Mesh("hexahedra", 2, 8, 2.0)),
        tuple(family("hexahedra", 2, 18, 9, 5, grading=3.0)),
    ),
    "hertz": Study(
        hertz,
        [
            *family("tetrahedra", 1, 0.4, 0.24, 0.16, 0.12, 0.08, 0.06),
            *family("tetrahedra", 2, 0.8, 0.56, 0.4, 0.28, 0.2, 0.09),
        ],
        (Mesh("tetrahedra", 1, 0.12), Mesh("tetrahedra", 2, 0.28)),
        tuple(family("tetrahedra", 2, 0.11, 0.2, 0.4)),
    ),
    "implant": Study(
        implant,
        [
            *family("tetrahedra", 1, 8, 12, 16, 20, 28, 36),
            *family("tetrahedra", 2, 6, 8, 12, 16),
        ],
        (Mesh("tetrahedra", 1, 20), Mesh("tetrahedra", 2, 12)),
        tuple(family("tetrahedra", 2, 26, 16, 10)),
    ),
}


def solved(case: Scene) -> tuple[ContactSolution, ContactProblem]:
    """Return a solution for reference, and the problem, destroyed."""
    with ContactProblem(case.a, case.L, [case.pair], bcs=case.bcs, stiffness="cholesky") as problem:
        solution = problem.solve(rtol=1e-6)
    solution.raise_if_failed()
    return solution, problem
