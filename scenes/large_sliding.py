"""Bodies that slide far over each other: the cases of the literature, as processes of load steps.

Lengths in mm, stresses in MPa, forces in N for a thickness of 1 mm. The bodies are neo-Hookean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    Coulomb,
    NonlinearContactProblem,
    NonlinearContactSolution,
    RigidSphere,
    read_gmsh,
)
from dolfinx_tresca.scene.friction import Friction
from scenes.boxes import Body, boxes
from scenes.elasticity import by_body, fixed, lame_constants
from scenes.hertz import POISSON as HERTZ_POISSON
from scenes.hertz import RADIUS, YOUNG, Comparison, compare, cylinder_on_plane
from scenes.hertz_theory import HertzLine, plane_strain_modulus
from scenes.rubber_block import neo_hookean

#: Mesh of half of a hemisphere over half of a block.
HEMISPHERE = Path(__file__).parents[1] / "benchmarks" / "hemisphere.geo"

#: Shallow ironing: Poisson's ratio, depth and length of the way; coefficient of friction.
IRONING_POISSON, IRONING_DEPTH, IRONING_WAY, IRONING_FRICTION = 0.32, 1.0, 10.0, 0.3

#: Half ring: inner radius and thickness of both layers together, distance from the block.
RING_RADIUS, RING_THICKNESS, RING_GAP = 90.0, 10.0, 20.0

#: Half of the length, and height of the block under the half ring.
BLOCK_HALF, BLOCK_HEIGHT = 125.0, 50.0

#: Young's modulus of the inner layer, of the outer layer and of the block.
RING_YOUNG = (1e5, 1e3, 300.0)

#: Tags of the half ring's scene.
RING, ENDS, TOP, BOTTOM = 1, 2, 3, 4


@dataclass
class Process:
    """A body that is moved in load steps, each of which is accepted.

    Attributes:
        problem: the contact problem.
        motion: displacement of the body that is moved, changed in place.
        u: the displacement.
        energy: the elastic energy, a compiled form.
        sign: 1 if the secondary side belongs to the body that is moved, otherwise -1.
        newton_steps: Newton steps of each load step.
    """

    problem: NonlinearContactProblem
    motion: fem.Constant
    u: fem.Function
    energy: Any
    sign: float = 1.0
    newton_steps: list[int] = field(default_factory=list)

    def move(self, *to: float) -> NonlinearContactSolution:
        """Move the body to a displacement in one load step, and return the solution. Collective."""
        self.motion.value[:] = to
        solution = self.problem.solve()
        solution.raise_if_failed()
        self.problem.accept()
        self.newton_steps.append(len(solution.newton.steps))
        return solution

    def force(self, solution: NonlinearContactSolution) -> np.ndarray:
        """Return the force on the body that is moved. Not collective."""
        return np.asarray(self.sign * solution.pair_resultants[0].force)

    def elastic_energy(self) -> float:
        """Return the elastic energy. Collective."""
        return float(self.problem.comm.allreduce(fem.assemble_scalar(self.energy), op=MPI.SUM))


def process(
    V: Any,
    young: Any,
    poisson: float,
    pair: ContactPair,
    clamped: tuple[np.ndarray, np.ndarray],
    symmetry: np.ndarray | None = None,
    sign: float = 1.0,
) -> Process:
    """Return neo-Hookean bodies with finite sliding. Collective.

    Args:
        V: space of the displacement.
        young: Young's modulus.
        poisson: Poisson's ratio.
        pair: the surfaces that touch.
        clamped: facets of the surface that is moved, and of the fixed one.
        symmetry: facets of a plane of symmetry, normal to the second axis; None: there is none.
        sign: see `Process`.
    """
    dim = V.mesh.geometry.dim
    u, v = fem.Function(V), ufl.TestFunction(V)
    density = neo_hookean(u, *lame_constants(young, poisson))
    motion = fem.Constant(V.mesh, np.zeros(dim))
    bcs = [fixed(V, clamped[0], motion), fixed(V, clamped[1])]
    if symmetry is not None:
        bcs.append(fixed(V, symmetry, component=1))
    problem = NonlinearContactProblem(
        ufl.derivative(density * ufl.dx, u, v),
        u,
        [replace(pair, sliding="finite")],
        bcs,
    )
    return Process(problem, motion, u, fem.form(density * ufl.dx), sign)


def _from_file(
    comm: MPI.Comm,
    path: Path,
    moduli: dict[str, float],
    sides: tuple[str, str],
    clamped: tuple[str, str],
    friction: Friction,
    exchanged: bool = False,
    **parameters: float,
) -> Process:
    """Return the process of a mesh file with names of bodies and surfaces. Collective."""
    bodies = read_gmsh(path, comm, **parameters)
    facets, tags = bodies.facet_tags, bodies.tags
    V = fem.functionspace(bodies.mesh, ("Lagrange", 1, (bodies.mesh.geometry.dim,)))
    moved, still = (facets.find(tags[name]) for name in clamped)
    secondary, primary = (tags[name] for name in (sides[::-1] if exchanged else sides))
    return process(
        V,
        by_body(bodies, moduli),
        IRONING_POISSON,
        ContactPair(facets, secondary, primary, friction),
        (moved, still),
        facets.find(tags["symmetry"]) if "symmetry" in tags else None,
        -1.0 if exchanged else 1.0,
    )


def ironing(
    comm: MPI.Comm,
    n: int,
    friction: Friction | None = None,
    *,
    exchanged: bool = False,
) -> Process:
    """Return the block on the foundation of shallow ironing. Collective.

    K. A. Fischer and P. Wriggers, Comput. Methods Appl. Mech. Eng. 195, 2006.

    Args:
        comm: communicator of the mesh.
        n: cells along the foundation, a multiple of 20.
        friction: law of friction; None: Coulomb's with 0.3.
        exchanged: whether the foundation is the secondary side.
    """
    return _from_file(
        comm,
        MESHES / "ironing.geo",
        {"foundation": 689.6, "block": 6896.0},
        ("block_arc", "foundation_top"),
        ("block_top", "foundation_bottom"),
        Coulomb(IRONING_FRICTION) if friction is None else friction,
        exchanged,
        N=n,
    )


def hemisphere(
    comm: MPI.Comm,
    size: float,
    friction: Friction | None = None,
) -> Process:
    """Return half of a hemisphere on half of a block, cells of the size 1 / `size`. Collective."""
    return _from_file(
        comm,
        HEMISPHERE,
        {"block": 1.0, "hemisphere": 10.0},
        ("hemisphere_round", "block_top"),
        ("hemisphere_cut", "block_bottom"),
        Coulomb(IRONING_FRICTION) if friction is None else friction,
        h=1.0 / size,
    )


def half_ring(
    comm: MPI.Comm,
    n: int,
    friction: Friction,
    *,
    exchanged: bool = False,
) -> Process:
    """Return a half ring of two layers whose ends are moved to press it on a block. Collective.

    Code_Aster, manual of validation V6.03.165; K. Poulios and Y. Renard, Comput. Struct. 153, 2015.
    Plane strain, degree 2.

    Args:
        comm: communicator of the mesh.
        n: cells along the ring; the block has cells of about the same size.
        friction: law of friction.
        exchanged: whether the block is the secondary side.
    """
    middle = RING_GAP + RING_RADIUS + RING_THICKNESS

    def bend(x: np.ndarray) -> np.ndarray:
        angle, radius = 0.5 * np.pi * x[:, 0], RING_RADIUS + RING_THICKNESS * x[:, 1]
        return np.column_stack([radius * np.sin(angle), middle - radius * np.cos(angle)])

    ring = Body((n, 2), [(-1.0, 1.0), (0.0, 1.0)], move=bend)
    box = [(-BLOCK_HALF, BLOCK_HALF), (-BLOCK_HEIGHT, 0.0)]
    made = boxes(comm, "quadrilateral", [ring, Body((4 * n // 5, max(n // 6, 1)), box)], 2)
    tags = made.tags(
        (RING, [0], lambda x: x[:, 1] > 1.0 - 1e-6),
        (ENDS, [0], lambda x: abs(x[:, 0]) > 1.0 - 1e-6),
        (TOP, [1], lambda x: x[:, 1] > -1e-6),
        (BOTTOM, [1], lambda x: x[:, 1] < 1e-6 - BLOCK_HEIGHT),
    )
    young = fem.Function(fem.functionspace(made.mesh, ("DG", 0)))
    x = young.function_space.tabulate_dof_coordinates()
    inner = np.hypot(x[:, 0], x[:, 1] - middle) < RING_RADIUS + 0.5 * RING_THICKNESS
    young.x.array[:] = np.choose(np.where(x[:, 1] < 0.0, 2, ~inner), RING_YOUNG)
    sides = (TOP, RING) if exchanged else (RING, TOP)
    return process(
        made.V,
        young,
        0.3,
        ContactPair(tags, *sides, friction),
        (tags.find(ENDS), tags.find(BOTTOM)),
        sign=-1.0 if exchanged else 1.0,
    )


def press(ring: Process, depths: Sequence[float]) -> NonlinearContactSolution:
    """Press the ends of the half ring down to each depth below the first contact. Collective."""
    ring.move(0.0, -RING_GAP)
    for depth in depths:
        solution = ring.move(0.0, -RING_GAP - depth)
    return solution


def iron(block: Process, steps: int, end: float = 2.0) -> dict[float, np.ndarray]:
    """Press the block of shallow ironing down and pull it along. Collective.

    Args:
        block: from `ironing`.
        steps: load steps for the indentation, and for each 5 mm of the way.
        end: time at the end, a multiple of 0.5; from time 1 to time 2 the block moves by 10 mm.

    Returns:
        vertical and horizontal force (2,) at the times 1, 1.5 and 2 up to the end.
    """
    forces = {}
    for time in np.linspace(0.0, 1.0, steps + 1)[1:]:
        solution = block.move(0.0, -IRONING_DEPTH * time)
    forces[1.0] = abs(block.force(solution))[::-1]
    along = round((end - 1.0) / 0.5) * steps
    for k, time in enumerate(np.linspace(1.0, end, along + 1)[1:], 1):
        solution = block.move(IRONING_WAY * (time - 1.0), -IRONING_DEPTH)
        if k % steps == 0:
            forces[round(2.0 * time) / 2.0] = abs(block.force(solution))[::-1]
    return forces


def there_and_back(
    body: Process, corners: Sequence[Sequence[float]], step: float
) -> dict[str, float]:
    """Move a body along a closed path; return what has changed at its end. Collective.

    Args:
        body: from `ironing` or `hemisphere`, without friction.
        corners: displacements at the corners of the path; the path ends at the first corner.
        step: approximate length of a load step.

    Returns:
        largest change of the displacement divided by the largest displacement, and change of the
        elastic energy divided by the elastic energy.
    """
    body.move(*corners[0])
    u, energy = body.u.x.array.copy(), body.elastic_energy()
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        a, b = np.asarray(start), np.asarray(end)
        number = max(round(float(np.linalg.norm(b - a)) / step), 1)
        for part in np.arange(1, number + 1) / number:
            body.move(*(a + part * (b - a)))
    largest = [
        body.problem.comm.allreduce(float(np.abs(one).max(initial=0.0)), op=MPI.MAX)
        for one in (body.u.x.array - u, u)
    ]
    return {
        "displacement": largest[0] / largest[1],
        "energy": abs(body.elastic_energy() / energy - 1.0),
    }


def hertz_far_away(comm: MPI.Comm, h: float, distance: float) -> Comparison:
    """Compare an elastic cylinder on a rigid one, far from where both were meshed. Collective.

    A quarter of the section of the elastic cylinder is moved in one load step by a distance, and
    pressed there on a rigid cylinder of twice its radius. Linear elasticity.

    Args:
        comm: communicator of the mesh.
        h: size of the cells at the contact.
        distance: along the first axis.
    """
    scene = cylinder_on_plane(comm, h)
    rigid = RigidSphere((distance, -2.0 * RADIUS), 2.0 * RADIUS)
    pairs = [replace(pair, primary=rigid, sliding="finite") for pair in scene.pairs]
    facets, tags = scene.facet_tags, scene.tags
    bcs = [
        fixed(scene.V, facets.find(tags["symmetry"]), distance, 0),
        fixed(scene.V, facets.find(tags["cut"]), -scene.data.approach, 1),
    ]
    modulus = plane_strain_modulus(YOUNG, HERTZ_POISSON)
    scene.data.theory = lambda force: HertzLine(force, RADIUS / 1.5, modulus)
    with scene.problem(bcs=bcs, pairs=pairs) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
        return compare(scene, solution)
