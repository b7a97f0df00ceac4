"""Checks of a scene and its solution: likely mistakes, and the limits of linear theory."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, dots, in_space
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.functions import owned_values
from dolfinx_tresca._base.parallel import RankReductions, largest_abs, reduce_array, warn
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import shown_place
from dolfinx_tresca.pairing.facets import FACING_COSINE
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pieces import Pieces, near_lines
from dolfinx_tresca.pairing.undeformed import straightened
from dolfinx_tresca.scene.obstacle import RigidMotion, RigidPlane
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solvers.feasible_set import FrictionCones


class Limit(NamedTuple):
    """Limits of a measure: above `noticed` the log warns of it, above `largest` theory ends."""

    noticed: float
    largest: float


#: Limits of the rotation of a linear body [rad]. A rotation r turns contact forces by r, and linear
#: theory strains the body by r^2 / 2: at 0.05 rad by 0.1 %, as much as the yield strain of steel.
ROTATION = Limit(0.01, 0.05)

#: Limits of the displacement of a linear body beyond its best-fit rigid motion, relative to the
#: body's diagonal. Strains have about this size; with doubled limits they are twice as large.
DEFORMATION = Limit(0.5, 1.0)

#: Limits of the slip relative to the size of the contact. With small sliding, forces stay at this
#: fraction of the contact from where they act; with doubled limits, twice as far.
SLIP = Limit(0.2, 1.0)

#: Limits of the part of the contact force at nodes that have left the other side: they are farther
#: from it than the size of their own area. Forces act on both bodies where nothing touches; with
#: doubled limits, twice as much of them, and a body leaves the other one before the theory ends.
FORCE_BEYOND_PARTNER = Limit(0.2, 0.5)

ADVICE_TO_BODIES = (
    "Look for a force that should be a prescribed displacement, for missing supports, and at the "
    "units of moduli and loads; or take NonlinearContactProblem, which has no limit on rotations, "
    'or ContactPair(..., sliding="finite"), with which linear bodies have frames that turn if no '
    "single components of their displacement are prescribed on a face"
)
ADVICE_TO_TOOLS = "Take smaller load steps, with accept() after each"
ADVICE_TO_PAIRS = (
    "Prescribe the displacement in place of a force that friction cannot carry, or take "
    'ContactPair(..., sliding="finite")'
)


class Departure(NamedTuple):
    """A measure of how far a solution is from the assumptions of linear theory, with its limits.

    The text names the body or the pair and its motion; the advice is a change of the scene.
    """

    value: float
    limit: Limit
    text: str
    advice: str


def reason_outside(comm: MPI.Comm, departures: Sequence[Departure], noticed: set[Limit]) -> str:
    """Return why a solution is outside of the theory, or "" if it is within it. Collective.

    If it is within, the log warns of departures above their `noticed` limit, each kind only once:
    limits of which the user has been told are added to the set `noticed`.
    """
    # the first rank decides, since values of ranks may differ by rounding
    notable = comm.bcast([each for each in departures if each.value > each.limit.noticed])
    outside = [each for each in notable if each.value > each.limit.largest]
    told = outside or [each for each in notable if each.limit not in noticed]
    if not told:
        return ""
    noticed.update(each.limit for each in told)
    texts = "; ".join(each.text for each in told)
    advice = ". ".join(dict.fromkeys(each.advice for each in told))  # each advice once
    if outside:
        return f"{texts}. {advice}"
    warn(comm, "near the end of linear theory: %s", f"{texts}. {advice}")
    return ""


def motions_of_bodies(u: fem.Function, bodies: Bodies) -> Iterator[Departure]:
    """Yield the departures of the body that turns most and of the body that deforms most.

    Collective. A body turns by the rotation of the rigid motion that is nearest to u. It deforms by
    the largest displacement beyond this motion, which divided by its diagonal is its strain.
    """
    sums = RankReductions(u.function_space.mesh.comm)
    values, dim = owned_values(u), u.function_space.dofmap.index_map_bs
    diagonal = np.linalg.norm(bodies.bounds[:, 3:] - bodies.bounds[:, :3], axis=1)
    # the rigid motion of each body by least squares; a rotation has the angle 1 / diagonal
    modes = bodies.rigid_modes(dim)
    normal_equations = sums.sparse_inner(modes, modes).tocsc()
    amounts = spsolve(normal_equations, sums.inner(modes, values.ravel()))
    angle = np.linalg.norm(amounts.reshape(bodies.count, -1)[:, dim:], axis=1) / diagonal
    beyond = np.linalg.norm(values - (modes @ amounts).reshape(-1, dim), axis=1)
    own_strain = np.zeros(bodies.count)
    np.maximum.at(own_strain, bodies.label, beyond / diagonal[bodies.label])
    strain = reduce_array(sums.comm, own_strain, MPI.MAX)
    # a sheared body turns on average, too, by about 1.5 times its strain; a stout beam by more
    angle[angle <= 2.0 * strain] = 0.0
    body = int(angle.argmax())
    ends = 0.5 * angle[body] * diagonal[body]
    text = f"{bodies.describe(body)} turns by {angle[body]:.3g} rad: its ends move by some "
    text += f"{ends:.3g}, and linear theory, which allows {ROTATION.largest} rad, swells it by "
    text += f"{angle[body] * ends:.2g} and leaves its stresses in their first directions"
    yield Departure(float(angle[body]), ROTATION, text, ADVICE_TO_BODIES)
    body = int(strain.argmax())
    text = f"{bodies.describe(body)} deforms by {strain[body] * diagonal[body]:.3g} beyond its "
    text += f"rigid motion, {strain[body]:.3g} times its diagonal"
    yield Departure(float(strain[body]), DEFORMATION, text, ADVICE_TO_BODIES)


def motions_of_pairs(
    jump: JumpOperator,
    pairs: Sequence[ContactPair],
    solution: Evaluation,
    geometry: fem.Function,
    motions: Array,
) -> Iterator[Departure]:
    """Yield the departures of obstacles that turn, and of pairs whose nodes slide. Collective.

    Of a pair these are the slip of pressed nodes, and the force beyond the other side. Slip is no
    departure with finite sliding, on a rigid plane, which has the same normal everywhere, and where
    surfaces are bonded. In a solve, obstacles turn only if forces hold them.

    Pairs with small sliding were paired at the displacement `geometry`. In the solution, obstacles
    have the `motions` (pairs, 3, 4), as in `RigidMotion.matrix`.
    """
    V, since_pairing = solution.u.function_space, solution.u.copy()
    since_pairing.x.array[:] -= geometry.x.array
    vectors, stresses = jump.vectors(since_pairing), jump.nodal_vectors(solution.multipliers)
    straight_u = straightened(V, geometry.x.array.reshape(-1, V.dofmap.index_map_bs))
    per_pair = zip(pairs, jump.pairs, vectors, stresses, motions, strict=True)
    for pair, operators, jumps, stress, motion in per_pair:
        if pair.obstacle is not None:
            start, end = pair.obstacle.motion, RigidMotion.from_matrix(motion)
            angle = float(Rotation.from_matrix(end.rotation @ start.rotation.T).magnitude())
            text = f"{pair.obstacle} turns by {angle:.3g} rad in a load step, of which linear "
            text += f"theory allows {ROTATION.largest}"
            yield Departure(angle, ROTATION, text, ADVICE_TO_TOOLS)
            jumps -= _carried(operators.places, start, end)
        if pair.sliding == "finite" or operators.bonded or isinstance(pair.obstacle, RigidPlane):
            continue
        # the largest values of all pressed nodes: size, slip, slip divided by size; and their box
        force = operators.weights * np.maximum(stress[:, 0], 0.0)
        pressed = force > 0.0
        slips = jumps - dots(jumps, operators.normals)[:, None] * operators.normals
        length = np.linalg.norm(slips, axis=1)[pressed]
        places, sizes = operators.places[pressed], operators.sizes[pressed]
        lengths = np.column_stack([sizes, length, length / sizes])
        corners = np.hstack([places, -places]).max(axis=0, initial=-np.inf)
        extremes = np.append(lengths.max(axis=0, initial=0.0), corners)
        size, slip, slip_by_size, *bounds = reduce_array(V.mesh.comm, extremes, MPI.MAX)
        if slip == 0.0:
            continue
        highest, negated_lowest = np.split(np.array(bounds), 2)  # coordinates, (d,)
        extent = float(np.linalg.norm(highest + negated_lowest)) + size
        text = f"contact pair {pair}: pressed nodes have slid by {slip:.3g}"
        relative = f"{text}, {slip / extent:.2g} times the size {extent:.3g} of the contact, but "
        relative += "keep their normals and partners"
        yield Departure(slip / extent, SLIP, relative, ADVICE_TO_PAIRS)
        # nodes that slide by less than their own size cannot be farther from the other side
        if slip_by_size > 1.0 and pair.obstacle is None:
            # has a node, where the jumps take it, an opposed primary facet within its size?
            primary = operators.undeformed.displaced(V, straight_u)[-1]
            points, normals = in_space(operators.places + jumps), in_space(operators.normals)
            pieces = Pieces(near_lines(V.mesh.comm, primary, points, normals, operators.sizes, 0.0))
            point, piece = pieces.near(points, operators.sizes)
            opposed = dots(normals[point], pieces.normals[piece]) < -FACING_COSINE
            beyond = np.isin(np.arange(len(points)), point[opposed], invert=True)
            left, total = reduce_array(V.mesh.comm, np.array([force @ beyond, force.sum()]))
            text += f", and {100.0 * left / total:.0f} % of the contact force is at nodes that "
            text += "have left the other side, but keep their normals and partners"
            yield Departure(left / total, FORCE_BEYOND_PARTNER, text, ADVICE_TO_PAIRS)


def _carried(places: Array, start: RigidMotion, end: RigidMotion) -> Array:
    """Return displacements (n, d) of an obstacle's points at places (n, d), from start to end."""
    points = in_space(places).T
    return (end.applied_to(start.reversed_from(points)) - points).T[:, : places.shape[1]]


def hint_at_scene(
    V: Any, pairs: Sequence[ContactPair], operators: Sequence[PairOperators], bodies: Bodies
) -> None:
    """Warn of initial overlaps as deep as a body, and of pairs within a single body. Collective."""
    comm, dim = V.mesh.comm, V.mesh.geometry.dim
    thickness = (bodies.bounds[:, 3:] - bodies.bounds[:, :3])[:, :dim].min(axis=1)
    for pair, paired in zip(pairs, operators, strict=True):
        counts = []
        sides = (pair.secondary, pair.primary) if pair.obstacle is None else (pair.secondary,)
        for tag in sides:
            nodes = fem.locate_dofs_topological(V, dim - 1, pair.facet_tags.find(tag))
            nodes = nodes[nodes < V.dofmap.index_map.size_local]
            counts.append(np.bincount(bodies.label[nodes], minlength=bodies.count))
        touches = reduce_array(comm, counts) > 0  # (sides, bodies)
        touched = touches.any(axis=0)  # (bodies,)
        if len(sides) == 2 and touched.sum() == 1 and not pair.touches_itself:
            warn(
                comm,
                "both sides of %s are on body %d: it touches itself. If these should be two "
                "bodies, they share nodes: mesh them without merging nodes",
                *(pair, 1 + int(touches[0].argmax())),
            )
        depth = comm.allreduce(float((-paired.gap).max(initial=0.0)), op=MPI.MAX)
        if depth >= thickness[touched].min(initial=np.inf):
            warn(
                comm,
                "%s overlaps by %.3g before anything moves, as deep as a body is thick: are the "
                "bodies where they should be, and the tags on the sides that face each other?",
                *(pair, depth),
            )


def hint_at_overlap(solution: Evaluation, pairs: Sequence[ContactPair], jump: JumpOperator) -> None:
    """Warn where prescribed displacements push the sides of pairs into each other. Collective."""
    comm, points = jump.comm, solution.u.function_space.tabulate_dof_coordinates()
    rounding = ROUNDING * largest_abs(comm, points)[0]
    per_pair = zip(pairs, jump.pairs, jump.closings(solution.u), solution.surfaces, strict=True)
    for pair, operators, closing, surface in per_pair:
        if pair.obstacle is not None and surface.obstacle is not None:
            carried = _carried(operators.places, pair.obstacle.motion, surface.obstacle.motion)
            closing -= dots(carried, operators.normals)
        without_pressure = operators.prescribed & ~operators.has_normal_row
        depth = (closing - operators.gap) * without_pressure
        deepest = comm.allreduce(float(depth.max(initial=0.0)), op=MPI.MAX)
        if deepest <= rounding:
            continue
        count = comm.allreduce(len(np.unique(operators.nodes[depth > rounding])))
        # the least of all equally deep points: the same with any number of ranks
        deepest_points = points[operators.nodes[depth >= deepest - rounding]]
        least_on_rank = min(map(tuple, deepest_points.tolist()), default=(np.inf,))
        place = min(comm.allgather(least_on_rank))
        warn(
            comm,
            "%s overlaps by up to %.3g, at %s: Dirichlet conditions prescribe the displacement "
            "along the normal at %d nodes of the secondary side, which so have no pressure to hold "
            "the sides apart. Prescribe no overlap, or make a side that can give way the secondary "
            "side",
            *(pair, deepest, shown_place(place), count),
            about=str(pair),
        )


def hint_at_weakening(comm: Any, cones: FrictionCones, x: Array, eigenvalue: float) -> None:
    """Log a warning if slip bounds decrease with pressure or slip. Collective.

    With such bounds there may be several solutions. A decrease with the slip is harmless if its
    rate is less than 1 / eigenvalue, both at the present slip and on average from zero to it: with
    the largest `eigenvalue` of A, or a lower bound of it, this is the least traction that elastic
    bodies need for a further unit of slip. The cones have the bounds F(p, v) p at the slips of a
    solution, whose multipliers are x (size,).
    """
    section = cones.section(x)
    face = section.face(2.0 * x)  # nodes on their circles slip
    by_pressure, by_slip = cones.slopes(x, face.slip)
    # the mean decrease of bounds from rest to the present slip
    at_rest = dataclasses.replace(cones, slip=np.zeros_like(cones.slip)).section(x)
    slips = face.slip & (cones.slip > 0.0)
    growth = section.radius - at_rest.radius  # of the bounds
    mean = np.divide(growth, cones.slip, out=np.zeros_like(by_slip), where=slips)
    steepest = min(by_slip.min(initial=0.0), mean.min(initial=0.0))
    least = [by_pressure.min(initial=0.0), eigenvalue * steepest]
    falling, weakening = reduce_array(comm, np.array(least), MPI.MIN)
    if falling < 0.0:
        warn(
            comm,
            "the slip bound F(p, v) p of a contact pair decreases with the pressure at slipping "
            "nodes, by up to %.3g for each unit of pressure: there may be several solutions",
            -falling,
        )
    if weakening < -1.0:
        warn(
            comm,
            "the slip bound of a contact pair decreases with the slip up to %.3g times as fast as "
            "elastic tractions do: there may be several solutions, and sliding may begin suddenly",
            -weakening,
        )
