"""Extremes of meshes and gaps, of contact areas, and of constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import (
    ContactPair,
    ContactStatus,
    Frictionless,
    InputError,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    Tresca,
)
from dolfinx_tresca.scene.friction import Friction
from scenes.blocks import ABOVE, BELOW, FRONT, LEFT, RIGHT, YOUNG, block, floor, rubbing_blocks
from scenes.extremes.cases import (
    LAWS,
    Cases,
    Check,
    Outcome,
    equal,
    judged,
    lawful,
    refused,
    solve,
    yes,
)
from scenes.nodal import global_vector, surface_nodes_of
from scenes.patches import dim_of
from scenes.scene import EPS, Scene

CASES = Cases()
case = CASES.case


def shift(*values: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a displacement that is the same at all points."""
    return lambda x: np.repeat(np.array(values)[:, None], x.shape[1], axis=1)


# -- Meshes ---------------------------------------------------------------------------------------

CELLS = "shape of cells"


@case(CELLS, "as wide as high", 1.0)
@case(CELLS, "1e4 times as wide as high", 1e-4)
@case(CELLS, "1e4 times as wide as high, multigrid", 1e-4, stiffness="multigrid")
def flat(comm: MPI.Comm, height: float, stiffness: str = "cholesky") -> Outcome:
    """A plate that is pressed on the floor and dragged."""
    pressed = 1e-2 * height
    model = block(
        comm,
        (4, 4, 2),
        size=(1.0, 1.0, height),
        held=(ABOVE,),
        moved=lambda x: np.stack([pressed + 0 * x[0], 0 * x[0], -pressed * (1.0 - 2.0 * x[0])]),
    )
    return lawful(model, options={"stiffness": stiffness})


@case(CELLS, "as wide as high, a clamped edge", 1.0)
@case(CELLS, "1e4 times as wide as high, a clamped edge", 1e-4)
def flap(comm: MPI.Comm, height: float) -> Outcome:
    """Bending is softer than pressing by the cube of the ratio: balance is less accurate."""
    return lawful(block(comm, (4, 4, 2), size=(1.0, 1.0, height), held=(LEFT,)), soft=height < 1.0)


@case(CELLS, "1e4 times as high as wide", 1e4)
def column(comm: MPI.Comm, height: float) -> Outcome:
    """Bending is softer than local pressing by 1e12 and more: the solve may not converge."""
    model = block(
        comm, (3, 2), size=(1.0, height), held=(ABOVE,), moved=shift(1e-2, -1e-2), load=(0, 0, 0)
    )
    found = lawful(model, max_iterations=60)
    if found.status == "CONVERGED":
        return found
    return Outcome(
        found.status,
        found.iterations,
        found.products,
        found.checks[:1],
        ("MAX_ITERATIONS", "STAGNATED"),
    )


RATIO = "cells of the secondary side over those of the primary side"


@case(RATIO, "4:3, triangles", "triangle", 4, 3)
@case(RATIO, "1:50, triangles", "triangle", 1, 50)
@case(RATIO, "50:1, triangles", "triangle", 50, 1)
@case(RATIO, "1:50, quadrilaterals", "quadrilateral", 1, 50)
@case(RATIO, "50:1, quadrilaterals", "quadrilateral", 50, 1)
@case(RATIO, "1:50, hexahedra", "hexahedron", 1, 50)
@case(RATIO, "15:1, hexahedra", "hexahedron", 15, 1)
@case(RATIO, "10:1, tetrahedra", "tetrahedron", 10, 1)
def mortar(comm: MPI.Comm, kind: str, upper: int, lower: int) -> Outcome:
    layers = 2 if dim_of(kind) == 2 else 1
    return lawful(rubbing_blocks(comm, kind, upper=(upper, layers), lower=(lower, layers)))


# -- Gaps -----------------------------------------------------------------------------------------

GAP = "gap over the size of the body"


@case(GAP, "0", 0.0)
@case(GAP, "1e-14", 1e-14)
@case(GAP, "-1e-14", -1e-14)
def nearly_no_gap(comm: MPI.Comm, gap: float) -> Outcome:
    model, touching = (
        block(comm, (4, 3, 3), held=(LEFT,), obstacles=[(BELOW, floor(3, -g))]) for g in (gap, 0.0)
    )
    solution, usual = solve(model), solve(touching)
    return judged(model, solution).and_also(
        equal("force", solution.normal_force, usual.normal_force, LAWS)
    )


@case(GAP, "1e3: never closes", 1e3)
def far(comm: MPI.Comm, gap: float) -> Outcome:
    model = block(comm, (4, 3, 3), held=(LEFT,), obstacles=[(BELOW, floor(3, -gap))])
    solution = solve(model)
    return judged(model, solution).and_also(yes("nothing is pressed", solution.counts.contact == 0))


@case(GAP, "1e3, two bodies", 1e3)
def far_bodies(comm: MPI.Comm, gap: float) -> Outcome:
    model = rubbing_blocks(comm, "tetrahedron", upper=(4, 2), lower=(3, 2), gap=gap)
    solution = solve(model)
    return judged(model, solution).and_also(yes("nothing is pressed", solution.counts.contact == 0))


@case(GAP, "-0.5: half of it penetrates", -0.5)
def deep(comm: MPI.Comm, gap: float) -> Outcome:
    """Uniaxial stress: the pressure is Young's modulus times the penetration, for the height 1."""
    model = block(
        comm,
        (3, 3, 2),
        load=(0.0, 0.0, 0.0),
        across=(ABOVE, LEFT, FRONT),
        friction=Frictionless(),
        obstacles=[(BELOW, floor(3, -gap))],
    )
    solution = solve(model)
    return judged(model, solution).and_also(
        equal("force", solution.normal_force, -gap * YOUNG, LAWS),
        yes("all is pressed", solution.counts.contact == solution.counts.nodes),
    )


# -- What touches ---------------------------------------------------------------------------------

TOUCHING = "what touches"


@case(TOUCHING, "a part of the face")
def some_nodes(comm: MPI.Comm) -> Outcome:
    return lawful(block(comm, (4, 3, 3), held=(ABOVE,), moved=tilted))


def tilted(x: np.ndarray) -> np.ndarray:
    """Return displacements (3, n) of the face: down at one end, up at the other."""
    return np.stack([1e-3 + 0 * x[0], 0 * x[0], -1e-3 + 2e-3 * x[0]])


@case(TOUCHING, "one contact node, 2D", (1, 1), (LEFT,))
@case(TOUCHING, "one contact node, 3D", (1, 1, 1), (LEFT, FRONT))
def one_contact_node(comm: MPI.Comm, n: tuple[int, ...], held: tuple[int, ...]) -> Outcome:
    model = block(comm, n, held=held)
    solution = solve(model)
    return judged(model, solution).and_also(yes("one node", solution.counts.nodes == 1))


@case(TOUCHING, "nothing, friction drags", Tresca(0.1))
@case(TOUCHING, "nothing, no friction", Frictionless())
def nothing(comm: MPI.Comm, friction: Friction) -> Outcome:
    model = block(comm, held=(LEFT,), load=(0.3, 0.1, 1.0), friction=friction)
    solution = solve(model)
    return judged(model, solution).and_also(yes("nothing is pressed", solution.counts.contact == 0))


@case(TOUCHING, "the whole face")
def everything(comm: MPI.Comm) -> Outcome:
    """The pressure under a block that stands on the floor equals the load everywhere."""
    model = block(comm, load=(0.0, 0.0, -1.0), across=(LEFT, FRONT), friction=Frictionless())
    solution = solve(model)
    _, fields = surface_nodes_of(solution)
    error = comm.allreduce(np.abs(fields["pressure"] - 1.0).max(initial=0.0), op=MPI.MAX)
    return judged(model, solution, held=False).and_also(Check("pressure", error, LAWS))


@case(TOUCHING, "a point, pressed by 1e-3", 1e-3)
@case(TOUCHING, "a point, pressed by 1e-6", 1e-6)
@case(TOUCHING, "a point, pressed by 1e-12", 1e-12)
def point(comm: MPI.Comm, pressed: float) -> Outcome:
    """A ball touches the node in the middle of the face."""
    model = block(
        comm,
        (4, 4, 2),
        held=(ABOVE,),
        moved=shift(0.1 * pressed, 0.0, -pressed),
        load=(0, 0, 0),
        friction=Tresca(0.1 * pressed * YOUNG),
        obstacles=[(BELOW, RigidSphere((0.5, 0.5, -10.0), 10.0))],
    )
    solution = solve(model)
    # at the neighbours of the middle node the gap is 3e-3, with a rounding error of 1e-15
    return judged(model, solution, allowed=LAWS + 1e3 * EPS / pressed).and_also(
        yes("one node is pressed", solution.counts.contact == 1)
    )


@case(TOUCHING, "nodes that slip to opposite sides", 3, 1e-3)
@case(TOUCHING, "nodes that slip to opposite sides, and stick between", 4, 0.5)
def twisted(comm: MPI.Comm, n: int, bound: float) -> Outcome:
    """A twist about the middle of the face."""
    model = block(
        comm,
        (n, n, 2),
        load=(0, 0, 0),
        held=(ABOVE,),
        moved=lambda x: np.stack([-1e-3 * (x[1] - 0.5), 1e-3 * (x[0] - 0.5), -1e-3 + 0 * x[0]]),
        friction=Tresca(bound),
    )
    solution = solve(model)
    points, fields = surface_nodes_of(solution)
    slip = global_vector(comm, points, fields["slip"])
    size = np.linalg.norm(slip, axis=1)
    sliding = slip[size > 1e-3 * size.max()]
    cosines = sliding @ sliding.T / np.linalg.norm(sliding, axis=1)[:, None]
    cosines /= np.linalg.norm(sliding, axis=1)
    # opposite by the symmetry of the block under a half turn, which the mesh has only roughly
    return judged(model, solution).and_also(yes("opposite slips", cosines.min() < -0.9))


@case(TOUCHING, "a wall that slip closes", 0.01, True)
@case(TOUCHING, "a wall that friction keeps open", 1e3, False)
def wall(comm: MPI.Comm, bound: float, closes: bool) -> Outcome:
    """The lower edge reaches the wall beside it only if friction on the floor is small."""
    base = block(comm, (4, 3, 3), held=(ABOVE,), moved=shift(1e-3, 0.0, -1e-3), load=(0, 0, 0))
    tags = base.pairs[0].facet_tags
    beside = RigidPlane((1.0006, 0.0, 0.0), (-1.0, 0.0, 0.0))
    pairs = pairs_of(tags, [(BELOW, floor(3), Tresca(bound)), (RIGHT, beside, Frictionless())])
    model = replace(base, pairs=pairs)
    solution = solve(model)
    points, wanted = solution.surfaces[1].points, solution.surfaces[1].touching
    low = wanted & (points[:, 2] < 0.1)
    touches = bool(comm.allreduce(int(low.sum()), op=MPI.SUM))
    return judged(model, solution).and_also(
        yes("the lower edge " + ("touches" if closes else "does not touch"), touches == closes)
    )


def pairs_of(tags: object, sides: list[tuple[int, RigidObstacle, Friction]]) -> list[ContactPair]:
    """Return pairs of faces with obstacles."""
    return [ContactPair(tags, tag, obstacle, law) for tag, obstacle, law in sides]


@case(TOUCHING, "nodes of a clamped edge, pushed into the floor")
def clamped_edge(comm: MPI.Comm) -> Outcome:
    """Prescribed nodes penetrate as prescribed; the nodes beside them obey the laws."""
    return lawful(block(comm, (4, 3, 3), held=(LEFT,), moved=shift(1e-3, 0.0, -1e-3)))


@case(TOUCHING, "nodes of an edge that cannot move across")
def guided_edge(comm: MPI.Comm) -> Outcome:
    return lawful(block(comm, (4, 3, 3), held=(RIGHT,), across=(LEFT, FRONT)))


# -- Constraints ----------------------------------------------------------------------------------

REPEATED = "repeated constraints"


def dragged(comm: MPI.Comm, bound: float, obstacles: list[tuple[int, object]]) -> Scene:
    """A block that is pressed and dragged by its upper face."""
    law = Tresca(bound)
    return block(
        comm, (4, 3, 3), held=(ABOVE,), moved=shift(1e-3, 0.0, -1e-3), load=(0, 0, 0),
        friction=law, obstacles=obstacles,
    )  # fmt: skip


@case(REPEATED, "none", 0.01, 1)
@case(REPEATED, "two pairs on the same facets, slipping", 0.01, 2)
@case(REPEATED, "two pairs on the same facets, sticking", 1.0, 2)
@case(
    REPEATED, "two pairs on the same facets, multigrid", 1.0, 2, options={"stiffness": "multigrid"}
)
@case(REPEATED, "two pairs on the same facets, default accuracy", 1.0, 2, accuracy="balanced")
def same_facets(comm: MPI.Comm, bound: float, times: int, **asked: Any) -> Outcome:
    """Multipliers are not unique; displacement and forces are as with one pair and both bounds."""
    model = dragged(comm, bound, [(BELOW, floor(3)) for _ in range(times)])
    # on the same mesh: a new mesh may be distributed otherwise over the ranks
    single = replace(model.pairs[0], friction=Tresca(times * bound))
    solution, once = solve(model, **asked), solve(replace(model, pairs=[single]))
    # without an error bound the residual is 1e-6; an iteration that is too slow does not converge
    rough = 1e3 if "accuracy" in asked else 1.0
    if solution.status is not ContactStatus.CONVERGED:
        rough = 1e3
    difference = np.abs(solution.u.x.array - once.u.x.array).max(initial=0.0)
    size = np.abs(once.u.x.array).max(initial=0.0)
    error, most = (comm.allreduce(float(v), op=MPI.MAX) for v in (difference, size))
    balance = LAWS if "options" in asked else 1e3 * EPS
    found = judged(model, solution, allowed=rough * LAWS, balance=balance).and_also(
        Check("displacement", error / most, rough * LAWS),
        equal("force", solution.normal_force, once.normal_force, rough * LAWS),
    )
    # A is singular: the residual may stop falling early, or fall slowly
    return replace(found, wanted=("CONVERGED", "STAGNATED", "MAX_ITERATIONS"))


@case(REPEATED, "two pairs that share an edge, slipping", 0.01)
@case(REPEATED, "two pairs that share an edge, sticking", 1.0)
def shared_edge(comm: MPI.Comm, bound: float) -> Outcome:
    """A block in a corner: the normal of the wall is tangential to the floor."""
    beside = RigidPlane((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    return lawful(dragged(comm, bound, [(BELOW, floor(3)), (RIGHT, beside)]))


@case(REPEATED, "two pairs between the same bodies")
def same_bodies(comm: MPI.Comm) -> Outcome:
    model = rubbing_blocks(comm, "triangle")
    twice = replace(model, pairs=model.pairs * 2)
    return refused(twice.problem, InputError, ["two pairs", "Give one pair"])
