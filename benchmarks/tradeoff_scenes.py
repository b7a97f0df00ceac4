"""The scenes of benchmarks/tradeoff.py on any mesh, and errors against a fine reference.

Meshes of a scene need not be nested. Gradients of the displacement are compared at the points of a
quadrature rule on the reference mesh, each in the cell of the same body that holds the point (or is
next to it, where boundaries are curved); pressure and slip likewise, on the contact surface. It
runs on one rank.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
import ufl
from dolfinx import fem, geometry

sys.path.insert(0, str(Path(__file__).parents[1] / "demos"))
import demo_hertz
import demo_implant
import demo_two_bricks

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ContactSolution,
    Frictionless,
    RigidPlane,
    TaggedMesh,
    read_gmsh,
)
from dolfinx_tresca._base.compat import geometry_dofmap, interpolation_points

Array = np.ndarray

#: Rule on the reference mesh: no point of it is on a face, where gradients jump.
RULE = (4, basix.QuadratureType.gauss_jacobi)

#: Rate with which the energy error of references falls, for the guess of their own error.
RATE = 1.5


@dataclass(frozen=True)
class Case:
    """A scene on a mesh: what a contact problem is made of, and the material."""

    bodies: TaggedMesh
    volumes: tuple[str, ...]  # names of the bodies
    V: Any
    mu: Any
    lame: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    dx: Any = ufl.dx

    @property
    def a(self) -> Any:
        """The bilinear form of linear elasticity."""
        u, v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        strain = ufl.sym(ufl.grad(u))
        stress = 2 * self.mu * strain + self.lame * ufl.tr(strain) * ufl.Identity(3)
        return ufl.inner(stress, ufl.sym(ufl.grad(v))) * self.dx

    def energy_norm(self, u: Any) -> float:
        """Return |u|_K of a displacement on this mesh."""
        return float(fem.assemble_scalar(fem.form(ufl.action(ufl.action(self.a, u), u)))) ** 0.5


def lame_constants(young: Any, poisson: Any) -> tuple[Any, Any]:
    """Return mu and lambda [MPa]."""
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def two_bricks(N: float, cell: str, degree: int, grading: float = 1.0) -> Case:
    """Return the two bricks, loaded at the free end of the upper one; N cells along each.

    With a grading g, the distances of nodes from the nearest face of their brick go with the power
    g of what they were: singularities are at the edges.
    """
    comm = MPI.COMM_SELF
    scene = demo_two_bricks.two_bricks(comm, int(N), hexahedra=cell == "hexahedra")
    bodies = scene.bricks
    if grading != 1.0:
        x, size = bodies.mesh.geometry.x, np.array([2.0, 1.0, 1.0])
        upper = np.zeros(len(x))
        cells = bodies.cell_tags.find(bodies.tags["upper"])
        upper[geometry_dofmap(bodies.mesh)[cells]] = 1.0
        start = np.outer(upper, [0.0, 0.0, 1.0])
        t = (2 * (x - start) / size).clip(0, 2)
        moved = np.where(t < 1, t**grading, 2 - (2 - t) ** grading)
        x[:] = start + 0.5 * size * moved
    V = fem.functionspace(bodies.mesh, ("Lagrange", degree, (3,)))
    poisson = fem.Function(fem.functionspace(bodies.mesh, ("DG", 0)))
    for name, value in demo_two_bricks.POISSON.items():
        poisson.x.array[bodies.cell_tags.find(bodies.tags[name])] = value
    ds = ufl.Measure("ds", domain=bodies.mesh, subdomain_data=bodies.facet_tags)
    loaded = (bodies.tags["upper_top"], bodies.tags["upper_free_end"])
    return Case(
        bodies,
        ("upper", "lower"),
        V,
        *lame_constants(demo_two_bricks.YOUNG, poisson),
        ufl.inner(scene.load, ufl.TestFunction(V)) * ds(loaded),
        [
            demo_hertz.fix(V, bodies, name, component)
            for name in ("upper_fixed", "lower_fixed")
            for component in range(3)
        ],
        scene.pair,
    )


def hertz(h: float, cell: str, degree: int, grading: float = 1.0) -> Case:
    """Return the ball on a plane with cells of size h [mm] at the contact.

    Unlike those of the demo, cells elsewhere shrink along with h.
    """
    approach = 0.144
    bodies = read_gmsh(
        MESHES / "sphere_octant.geo",
        MPI.COMM_SELF,
        R=demo_hertz.RADIUS,
        h=h,
        Zone=1.4 * (demo_hertz.RADIUS * approach) ** 0.5,
        Growth=2.5 * h / degree,
    )
    V, _, L = demo_hertz.elasticity(bodies, degree, {})
    constants = fem.functionspace(bodies.mesh, ("DG", 0))
    young, poisson = fem.Function(constants), fem.Function(constants)
    young.x.array[:], poisson.x.array[:] = demo_hertz.YOUNG, demo_hertz.POISSON
    held = (("upper_x", 0, 0.0), ("upper_y", 1, 0.0), ("upper_cut", 2, -approach))
    pair = ContactPair(
        bodies.facet_tags,
        secondary=bodies.tags["upper_contact"],
        primary=RigidPlane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)),
        friction=Frictionless(),
    )
    bcs = [demo_hertz.fix(V, bodies, *condition) for condition in held]
    return Case(bodies, ("upper",), V, *lame_constants(young, poisson), L, bcs, pair)


def implant(N: float, cell: str, degree: int, grading: float = 1.0) -> Case:
    """Return the stem in bone after the whole motion, N cells round the half hole.

    Unlike in the demo, the modulus is a function of the place inside a cell as well, and cells far
    from the stem are smaller and shrink along with the others: else the outer walls of the bone,
    where the modulus rises by a factor of 15 within a cell, would have most of the error.
    """
    scene = demo_implant.implant(MPI.COMM_SELF, int(N), Growth=min(0.35, 4.0 / N))
    bodies = scene.hip
    V = fem.functionspace(bodies.mesh, ("Lagrange", degree, (3,)))
    is_bone = fem.Function(fem.functionspace(bodies.mesh, ("DG", 0)))
    is_bone.x.array[bodies.cell_tags.find(bodies.tags["bone"])] = 1.0
    x, y, _ = ufl.SpatialCoordinate(bodies.mesh)
    depth = demo_implant.WIDTH / 2 - ufl.max_value(abs(x), abs(y))
    wall = 0.5 * (1 - ufl.tanh((depth - demo_implant.SHELL) / 1.5))
    soft, hard = demo_implant.CANCELLOUS, demo_implant.CORTICAL
    bone = soft + (hard - soft) * wall
    young = is_bone * bone + (1 - is_bone) * demo_implant.TITANIUM
    held = [("bone_fixed", component, 0.0) for component in range(3)]
    held += [("stem_joint", component, u) for component, u in enumerate(demo_implant.MOTION)]
    held += [("bone_symmetry", 1, 0.0), ("stem_symmetry", 1, 0.0)]
    zero = fem.Constant(bodies.mesh, np.zeros(3))
    return Case(
        bodies,
        ("bone", "stem"),
        V,
        *lame_constants(young, demo_implant.POISSON),
        ufl.inner(zero, ufl.TestFunction(V)) * ufl.dx,
        [demo_hertz.fix(V, bodies, *condition) for condition in held],
        scene.pair,
        ufl.dx(metadata={"quadrature_degree": 2 * degree}),
    )


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
        return self.values(ufl.SpatialCoordinate(self.mesh))

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


def gradient_at(case: Case, u: Any, points: Array, cells: Array) -> Array:
    """Return grad u (n, 9) at points in cells."""
    degree = case.V.element.basix_element.degree
    simplices = case.bodies.mesh.topology.cell_name() == "tetrahedron"
    space = fem.functionspace(case.bodies.mesh, ("DG", degree - simplices, (3, 3)))
    gradient = fem.Function(space)
    gradient.interpolate(fem.Expression(ufl.grad(u), interpolation_points(space.element)))
    return np.asarray(gradient.eval(points, cells)).reshape(len(points), 9)


class Reference:
    """A solution on a fine mesh, with which others are compared."""

    def __init__(self, case: Case, solution: ContactSolution) -> None:
        mesh, surface = case.bodies.mesh, solution.surface
        self._volumes = {}
        for name in case.volumes:
            samples = Samples(mesh, np.sort(case.bodies.cell_tags.find(case.bodies.tags[name])))
            gradient, mu, lame = (
                samples.values(expression)
                for expression in (ufl.grad(solution.u), *map(ufl.as_ufl, (case.mu, case.lame)))
            )
            self._volumes[name] = samples.points, samples.weights, gradient, mu[:, 0], lame[:, 0]
        samples = Samples(surface.mesh, all_cells(surface.mesh))
        self._points, self._weights = samples.points, samples.weights
        self._fields = {"pressure": samples.values(surface.pressure)}
        if surface.slip is not None:
            self._fields["slip"] = samples.values(surface.slip)

    def errors(self, case: Case, solution: ContactSolution) -> dict[str, float]:
        """Return relative errors: energy norm, pressure and slip in L2 of the contact surface."""
        square = whole = 0.0
        for name, (points, weights, wanted, mu, lame) in self._volumes.items():
            cells = case.bodies.cell_tags.find(case.bodies.tags[name])
            at = cells_at(case.bodies.mesh, points, np.sort(cells))
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
    """Return twice the elastic energy density (n,) of gradients (n, 9)."""
    G = gradient.reshape(-1, 3, 3)
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
class Scene:
    """How to build a scene, on which meshes, and what it is compared with."""

    build: Callable[..., Case]
    meshes: list[Mesh]
    base: tuple[Mesh, ...]  # on which accuracy, algorithm and K-solver are varied
    references: tuple[Mesh, ...]  # fine to coarse: the second one tells the error of the first one

    def coarsest(self, count: int) -> list[Mesh]:
        """Return so many meshes of each kind, and those on which settings are varied."""
        kinds = itertools.groupby(self.meshes, key=lambda mesh: mesh.family)
        chosen = {mesh for _, kind in kinds for mesh in itertools.islice(kind, count)}
        return [mesh for mesh in self.meshes if mesh in chosen or mesh in self.base]

    def case(self, mesh: Mesh) -> Case:
        """Return the scene on a mesh."""
        return self.build(mesh.size, mesh.cell, mesh.degree, mesh.grading)


SCENES = {
    "two_bricks": Scene(
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
    "hertz": Scene(
        hertz,
        [
            *family("tetrahedra", 1, 0.4, 0.24, 0.16, 0.12, 0.08, 0.06),
            *family("tetrahedra", 2, 0.8, 0.56, 0.4, 0.28, 0.2, 0.09),
        ],
        (Mesh("tetrahedra", 1, 0.12), Mesh("tetrahedra", 2, 0.28)),
        tuple(family("tetrahedra", 2, 0.11, 0.2, 0.4)),
    ),
    "implant": Scene(
        implant,
        [
            *family("tetrahedra", 1, 8, 12, 16, 20, 28, 36),
            *family("tetrahedra", 2, 6, 8, 12, 16),
        ],
        (Mesh("tetrahedra", 1, 20), Mesh("tetrahedra", 2, 12)),
        tuple(family("tetrahedra", 2, 26, 16, 10)),
    ),
}


def solved(case: Case) -> tuple[ContactSolution, ContactProblem]:
    """Return a solution for reference, and the problem, destroyed."""
    with ContactProblem(case.a, case.L, [case.pair], bcs=case.bcs, stiffness="cholesky") as problem:
        solution = problem.solve(rtol=1e-6)
    solution.raise_if_failed()
    return solution, problem
