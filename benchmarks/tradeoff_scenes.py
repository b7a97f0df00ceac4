"""The scenes of benchmarks/tradeoff.py, their meshes, and errors against a reference.

Errors are differences from a reference on a fine mesh; the meshes of a scene need not be nested.
Gradients of the displacement are compared at the points of a quadrature rule on the reference mesh.
At each point the gradient is taken from the cell of the same body that contains the point, or, near
curved boundaries, from the nearest cell. Pressure and slip are compared in the same way on the
contact surface. All functions run on one rank.
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

from dolfinx_tresca import MESHES, ContactSolution, TaggedMesh, read_gmsh
from dolfinx_tresca._base.compat import geometry_dofmap, interpolation_points
from scenes import floating_block
from scenes import implant as stem
from scenes import two_bricks as bricks
from scenes.elasticity import lame_constants
from scenes.hertz import on_sphere, sphere_on_plane
from scenes.hertz_theory import HertzSphere
from scenes.scene import Scene

Array = np.ndarray

#: Degree and type of the quadrature rule in cells of the reference. The rule is exact for squares
#: of the reference's strains, and has no points on faces, where gradients jump.
RULE = (2, basix.QuadratureType.default)

#: Cells along the foot of the crane on its coarsest mesh, and length of the load on its arm [m].
FOOT_CELLS, TROLLEY = 8, 0.5


def energy_norm(scene: Scene, u: Any) -> float:
    """Return |u|_K of a displacement on the mesh of a scene."""
    return float(fem.assemble_scalar(fem.form(ufl.action(ufl.action(scene.a, u), u)))) ** 0.5


@dataclass(frozen=True)
class Mesh:
    """A mesh with its elements, and the adaptive refinement that starts from it.

    Attributes:
        cell: "tetrahedra" or "hexahedra".
        degree: degree of the displacement.
        size: N, or h [mm] for Hertz.
        grading: exponent of the grading towards the faces of the bricks; 1: no grading.
        accuracy: argument of `solve_adaptively`, which starts from this mesh; 0: the mesh is not
            refined.
        goal: quantity to which `accuracy` refers, "energy" or "force".
    """

    cell: str
    degree: int
    size: float
    grading: float = 1.0
    accuracy: float = 0.0
    goal: str = "energy"

    @property
    def family(self) -> str:
        """Name of the kind of mesh, without the size."""
        name = {"tetrahedra": "P", "hexahedra": "Q"}[self.cell] + str(self.degree)
        if self.accuracy:
            return name + (" adaptive" if self.goal == "energy" else f" for {self.goal}")
        return name + (" graded" if self.grading != 1.0 else "")


def family(cell: str, degree: int, *sizes: float, grading: float = 1.0) -> list[Mesh]:
    """Return meshes of one kind, with the given sizes."""
    return [Mesh(cell, degree, size, grading) for size in sizes]


def adaptive(degree: int, size: float, *accuracies: float, goal: str = "energy") -> list[Mesh]:
    """Return meshes from which adaptive solves start, one for each requested accuracy."""
    return [Mesh("tetrahedra", degree, size, 1.0, asked, goal) for asked in accuracies]


def two_bricks(mesh: Mesh) -> TaggedMesh:
    """Return the two bricks, with N cells along each.

    With a grading g nodes are moved: the distance of a node from the nearest face of its brick, as
    a part of half the brick's size, is raised to the power g, since singularities are at the edges.
    """
    hexahedra = int(mesh.cell == "hexahedra")
    tagged = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_SELF, N=int(mesh.size), Hex=hexahedra)
    if mesh.grading != 1.0:
        x, size = tagged.mesh.geometry.x, np.array([2.0, 1.0, 1.0])
        upper = np.zeros(len(x))
        cells = tagged.cell_tags.find(tagged.tags["upper"])
        upper[geometry_dofmap(tagged.mesh)[cells]] = 1.0
        start = np.outer(upper, [0.0, 0.0, 1.0])
        t = (2 * (x - start) / size).clip(0, 2)
        moved = np.where(t < 1, t**mesh.grading, 2 - (2 - t) ** mesh.grading)
        x[:] = start + 0.5 * size * moved
    return tagged


def hertz(mesh: Mesh) -> TaggedMesh:
    """Return the ball with cells of size h [mm] at the contact; all other cells shrink with h."""
    h, growth = mesh.size, 2.5 * mesh.size / mesh.degree
    return sphere_on_plane(MPI.COMM_SELF, h, Growth=growth).tagged_mesh


def implant(mesh: Mesh) -> TaggedMesh:
    """Return stem and bone, with N cells round the half hole.

    Cells far from the stem shrink as N grows, like the cells near the stem. Otherwise the outer
    walls of the bone, where the modulus rises by a factor of 15 within a cell, would have most of
    the error.
    """
    N = int(mesh.size)
    return stem.implant(MPI.COMM_SELF, N, Growth=min(0.35, 4.0 / N)).tagged_mesh


def on_implant(hip: TaggedMesh, *, degree: int) -> Scene:
    """Return the implant after its whole motion; the modulus also varies within cells."""
    scene = stem.on_implant(hip, degree=degree, smooth=True)
    scene.data.motion.value[:] = stem.MOTION
    return scene


def crane(mesh: Mesh) -> TaggedMesh:
    """Return crane and clay, with N cells along the foot."""
    N, hexahedra = int(mesh.size), int(mesh.cell == "hexahedra")
    M = N + 1 if mesh.accuracy else 9 * N // 4 + 1 - 9 * N // 4 % 2  # odd, see the .geo file
    return floating_block.crane_on_clay(MPI.COMM_SELF, N, M=M, Hex=hexahedra).tagged_mesh


def on_crane(tagged: TaggedMesh, *, degree: int) -> Scene:
    """Return the crane with a load whose length is the same on all meshes."""
    return floating_block.on_crane(tagged, TROLLEY, degree=degree)


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
    last = 1 - X.sum(axis=1) if simplices else (1 - X).min(axis=1)
    return np.minimum(X.min(axis=1), last)


def cells_at(mesh: Any, points: Array, allowed: Array) -> Array:
    """Return for each point the cell in `allowed` that contains it or is nearest to it."""
    dim = mesh.topology.dim
    tree = geometry.bb_tree(mesh, dim, entities=allowed)
    found = np.full(len(points), -1, dtype=np.int32)
    if dim == 3:  # compute_colliding_cells also returns neighbours, where gradients differ
        near = geometry.compute_collisions_points(tree, points)
        owner = np.repeat(np.arange(len(points)), np.diff(near.offsets))
        order = np.argsort(depth(mesh, near.array, points[owner]))  # deepest last
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
    """A solution on a fine mesh, with which other solutions are compared.

    Attributes:
        own: estimated relative error of the reference itself in the energy norm. Its square is
            added to the square of another solution's difference from the reference, as the squares
            of errors add up for Galerkin's method on nested meshes.
    """

    def __init__(self, case: Scene, solution: ContactSolution, own: float = 0.0) -> None:
        self.own = own
        self._numbers, theory = numbers(solution), theory_of(case, solution)
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
        if theory is not None:
            r = np.linalg.norm(self._points[:, :2], axis=1)
            self._fields["pressure"] = theory.pressure(r)[:, None]
            self._numbers["peak"] = theory.peak
        if surface.slip is not None:
            self._fields["slip"] = samples.values(surface.slip)

    def errors(self, case: Scene, solution: ContactSolution) -> dict[str, float]:
        """Return relative errors: in the energy norm, in L2 of the contact, and of numbers."""
        square = whole = 0.0
        for name, (points, weights, wanted, mu, lame) in self._volumes.items():
            cells = case.cell_tags.find(case.tags[name])
            at = cells_at(case.mesh, points, np.sort(cells))
            found = gradient_at(case, solution.u, points, at)
            square += float(weights @ density(found - wanted, mu, lame))
            whole += float(weights @ density(wanted, mu, lame))
        result = {"energy": (square / whole + self.own**2) ** 0.5}
        for name, found in numbers(solution).items():
            result[name] = abs(found / self._numbers[name] - 1.0)
        mesh = solution.surface.mesh
        at = cells_at(mesh, self._points, all_cells(mesh))
        for name, wanted in self._fields.items():
            function = getattr(solution.surface, name)
            found = np.asarray(function.eval(self._points, at)).reshape(wanted.shape)
            squares = ((found - wanted) ** 2, wanted**2)
            difference, total = (float(self._weights @ square.sum(axis=1)) for square in squares)
            result[name] = (difference / total) ** 0.5
        return result


def theory_of(case: Scene, solution: ContactSolution) -> HertzSphere | None:
    """Return Hertz's theory for the force of the ball; None for other scenes.

    The relative error of the theory is about (a/R)^2.
    """
    if not hasattr(case.data, "theory"):
        return None
    theory: HertzSphere = case.data.theory(case.data.share * solution.normal_force)
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


@dataclass(frozen=True)
class Study:
    """A scene, the meshes on which it is solved, and the meshes of its references.

    Attributes:
        tagged: function from the description of a mesh to the `TaggedMesh`.
        on: function from a `TaggedMesh` and the degree to the scene.
        meshes: meshes that are measured.
        base: meshes on which accuracy, algorithm, K-solver and refinement are varied.
        references: meshes of references, from fine to coarse; the error of each reference is
            estimated from the next one.
    """

    tagged: Callable[[Mesh], TaggedMesh]
    on: Callable[..., Scene]
    meshes: list[Mesh]
    base: tuple[Mesh, ...]
    references: tuple[Mesh, ...]

    def coarsest(self, count: int) -> list[Mesh]:
        """Return the `count` coarsest meshes of each kind, and the meshes in `base`."""
        kinds = itertools.groupby(self.meshes, key=lambda mesh: mesh.family)
        chosen = {mesh for _, kind in kinds for mesh in itertools.islice(kind, count)}
        return [mesh for mesh in self.meshes if mesh in chosen or mesh in self.base]


SCENES = {
    "two_bricks": Study(
        two_bricks,
        bricks.on_bricks,
        [
            *family("tetrahedra", 1, 8, 16),
            *adaptive(1, 4, 0.3, 0.2, 0.14),
            *family("tetrahedra", 2, 4, 8),
            *family("hexahedra", 2, 4, 8, 12, 18, grading=2.0),
            *adaptive(2, 4, 0.3, 0.2, 0.14, 0.1, 0.08, 0.05),
            *adaptive(2, 4, 0.03, goal="force"),
        ],
        (Mesh("tetrahedra", 1, 16), Mesh("hexahedra", 2, 8, 2.0), *adaptive(2, 4, 0.14)),
        tuple(adaptive(2, 4, 0.04, 0.08, 0.16)),
    ),
    "hertz": Study(
        hertz,
        on_sphere,
        [
            *family("tetrahedra", 1, 0.4, 0.24, 0.16, 0.12),
            *adaptive(1, 0.4, 0.2, 0.14, 0.1),
            *family("tetrahedra", 2, 0.8, 0.4, 0.28),
            *adaptive(2, 0.8, 0.1, 0.05, 0.03, 0.015),
            *adaptive(2, 0.8, 0.01, goal="force"),
        ],
        (Mesh("tetrahedra", 1, 0.12), Mesh("tetrahedra", 2, 0.28), *adaptive(2, 0.8, 0.05)),
        tuple(adaptive(2, 0.8, 0.0095, 0.02, 0.04)),
    ),
    "implant": Study(
        implant,
        on_implant,
        [
            *family("tetrahedra", 1, 8, 12, 16, 20),
            *adaptive(1, 8, 0.4, 0.3, 0.2),
            *family("tetrahedra", 2, 8, 12),
            *adaptive(2, 8, 0.28, 0.2, 0.14, 0.1, 0.05),
            *adaptive(2, 8, 0.03, goal="force"),
        ],
        (Mesh("tetrahedra", 1, 20), Mesh("tetrahedra", 2, 12), *adaptive(2, 8, 0.2)),
        tuple(adaptive(2, 8, 0.035, 0.07, 0.14)),
    ),
    "crane": Study(
        crane,
        on_crane,
        [
            *family("hexahedra", 1, 8, 16),
            *family("hexahedra", 2, 8),
            *adaptive(1, FOOT_CELLS, 0.3, 0.2),
            *adaptive(2, FOOT_CELLS, 0.2, 0.14, 0.1),
        ],
        (Mesh("hexahedra", 1, 16), *adaptive(2, FOOT_CELLS, 0.2)),
        tuple(adaptive(2, FOOT_CELLS, 0.05, 0.1, 0.14)),
    ),
}
