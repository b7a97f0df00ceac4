"""Evaluation of multipliers: displacement, surface fields, energies, forces and counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, dots
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.functions import owned_values, zero_like
from dolfinx_tresca._base.parallel import largest_abs, log, reduce_array
from dolfinx_tresca._base.tolerances import SLACK
from dolfinx_tresca.dual.accuracy import total
from dolfinx_tresca.dual.load_steps import SlipHistory
from dolfinx_tresca.dual.program import DualProgram, relative_change
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.solution.fields import ContactState, Surface, SurfaceFields
from dolfinx_tresca.solution.forces import (
    Resultant,
    nodal_resultants,
    resultants_between,
    resultants_on,
)
from dolfinx_tresca.solvers.convergence import BALANCED, energy_norm, relative_error
from dolfinx_tresca.solvers.problem import DualSolution, Point
from dolfinx_tresca.status import ContactStatus

#: The state of a node is undecided if a change of its traction by this part of the largest traction
#: may change it, even if the solution is more accurate: rounding decides then.
EDGE = 1e-9


@dataclass(frozen=True)
class NodeCounts:
    """Numbers of contact nodes in each state, over all pairs and ranks.

    Tresca friction acts on open nodes, too.

    Attributes:
        nodes: nodes that carry multipliers.
        contact: nodes with pressure.
        stick: nodes with a tangential traction below the slip bound, pressed or not.
        contact_stick: nodes that are pressed and stick.
        idle: open nodes whose slip bound is zero, as without pressure in Coulomb's law.
        bonded: nodes of bonded pairs, which are counted in no other state.
        undecided: nodes whose state is uncertain: a change of tractions by `local_error`, or by
            1e-9 of the largest one, may put them in another state. The other counts are exact up to
            these nodes, and derivatives are one-sided there.
    """

    nodes: int
    contact: int
    stick: int
    contact_stick: int
    idle: int = 0
    bonded: int = 0
    undecided: int = field(default=0, compare=False)

    @property
    def slip(self) -> int:
        """Number of nodes with a traction at the slip bound, of pressed nodes also at a bound 0."""
        return self.nodes - self.stick - self.idle - self.bonded


class PairState(NamedTuple):
    """How many `nodes` of a pair are `pressed`, and its `opening`; see `ContactSolution`."""

    pressed: int
    nodes: int
    opening: float


@dataclass(frozen=True)
class Evaluation:
    """The results of a solve; see `ContactSolution` for the attributes."""

    u: fem.Function
    w: fem.Function
    deformation: fem.Function
    axisymmetric: bool
    surfaces: tuple[SurfaceFields, ...]
    contact_force: fem.Function
    multipliers: Array
    primal_energy: float
    dual_energy: float
    dissipation: float
    total_dissipation: float
    energy_error_bound: float
    bound_is_rigorous: bool
    local_error: float
    cell_errors: fem.Function | None
    discretisation_error: float | None
    counts: NodeCounts
    normal_force: float
    tangential_force: float
    bound_error: float
    pair_resultants: tuple[Resultant, ...]
    pair_states: tuple[PairState, ...]
    body_resultants: tuple[Resultant, ...]
    between_bodies: dict[tuple[int, int], Resultant]
    body_names: tuple[str, ...]
    peak_pressure: float
    greatest_slip: float
    greatest_total_slip: float
    reactions: dict[str, Resultant]

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.u.function_space.mesh.comm


def evaluate(
    dual: DualProgram,
    surfaces: Sequence[Surface],
    bodies: Bodies,
    solution: DualSolution,
    *,
    estimate: bool,
) -> tuple[Evaluation, SlipHistory]:
    """Compute fields, forces, energies and errors of a dual solution, for the user. Collective.

    This takes at most two solves with K. With `estimate`, the mesh's error is estimated, too.

    Returns:
        the results; and the slip history that follows if this solution becomes a load step.
    """
    # the displacement that belongs to the multipliers x and c, the gradient r, and their errors
    B, comm, x, c = dual.jump, dual.jump.comm, solution.multipliers, solution.c
    in_frames = zero_like(B.system.f, "w")  # with frames of bodies, v in them; else w itself
    solved = in_frames.x.petsc_vec
    error = dual.compute_displacement(x, solved, solution.displacement_tolerance)
    r, missing = dual.in_equilibrium(x, solved, c)
    in_frames.x.scatter_forward()
    w = in_frames if B.frames is None else B.frames.displacement(in_frames)
    u = B.system.displacement(w, "displacement")
    deformation = u if B.frames is None else B.system.displacement(in_frames, "deformation")

    # `increment`: slip of the step in rows of T, minus the gap in rows of N; `closing`: by how much
    # gaps have closed at nodes; both include the motion of tools, which moves primary sides, not u
    by_tools, pairs = dual.jump_of_tools(c), B.by_pair
    increment = B.of_unknowns(solved) + by_tools - dual.offset
    closing = np.concatenate(B.closings(u))
    if dual.equilibrium is not None:
        areas = np.concatenate([pair.weights for pair in B.pairs])
        amounts = (dual.equilibrium.factors * c)[dual.of_tools]
        for motion, amount in zip(dual.equilibrium.bodies.tool_motions, amounts, strict=True):
            for number in motion.pairs:
                operators, nodes = pairs[number].operators, pairs[number].nodes
                opening = dots(motion.displacement(operators.places), operators.normals)
                closing[nodes] -= amount * opening * operators.weights / areas[nodes]
    states, steps, before, slip, nodal_results = node_values(dual, solution, r, increment)
    pressed = states >= ContactState.PRESSED
    paths = before[:, -1] + steps[:, -1]  # lengths of the paths over all steps
    dissipation = float(dual.inner(x, slip))

    # fields, openings and nodal forces of each pair, in physical units
    stress, moved = x * B.stress_scale, increment * B.length_scale
    fields, openings, forces = [], [], []
    numbers = np.array([(len(p.nodes), pressed[p.nodes].sum(), len(p.tangential)) for p in pairs])
    node_counts, pressed_counts, tangential_counts = reduce_array(comm, numbers).T.tolist()
    for pair, surface, tangential_count in zip(pairs, surfaces, tangential_counts, strict=True):
        operators, nodes = pair.operators, pair.nodes
        tractions = pair.nodal_vectors(stress)
        values = {
            "pressure": tractions[:, 0],
            "gap": operators.gap - closing[nodes],
            "initial_gap": operators.gap,
            "state": states[nodes],
            "normal": operators.normals,
        }
        if tangential_count > 0:  # on any rank
            slips = pair.nodal_vectors(moved)[:, 1:]  # of the step
            values["traction"] = tractions[:, 1:]
            values["slip"] = before[nodes, :-1] + slips
            values["slip_path"] = paths[nodes]
            if dual.history.begun:
                values["slip_increment"] = slips
        fields.append(surface.fields(operators, u, values))
        openings.append((values["gap"] - np.maximum(operators.gap, 0.0)).max(initial=0.0))
        forces.append(operators.weights[:, None] * tractions)
    pair_openings = largest_abs(comm, *openings)

    # results of the whole scene
    origin = dual.history.origin.copy()  # the next step starts from where tools have moved
    origin[B.discs.tangential] -= by_tools[B.discs.tangential]
    history = replace(dual.history, origin=origin)
    history = history.after(B, slip, [steps[nodes] for nodes in B.nodes], dissipation)
    lengths = np.linalg.norm(steps[:, :-1], axis=1)
    pressures = np.maximum(stress[~B.is_tangential], 0.0)
    peak, greatest, longest = largest_abs(comm, pressures, lengths[pressed], paths[pressed])
    primal, dual_energy = dual.energies(x, solved, c, error)
    if B.frames is not None:  # the work of loads on the rigid motions of the frames
        work = B.frames.work(B.system.assemble_forces())
        primal, dual_energy = primal - work, dual_energy - work
    estimated = deformation if estimate else None
    evaluation = Evaluation(
        u=u,
        w=w,
        deformation=deformation,
        axisymmetric=B.system.axisymmetric,
        surfaces=tuple(fields),
        multipliers=stress,
        primal_energy=primal,
        dual_energy=dual_energy,
        dissipation=dissipation,
        total_dissipation=history.dissipation,
        pair_states=tuple(map(PairState, pressed_counts, node_counts, pair_openings)),
        body_names=bodies.names,
        peak_pressure=peak,
        greatest_slip=greatest,
        greatest_total_slip=longest,
        reactions={},
        **nodal_results,
        **energy_errors(dual, Point(x, c, r), error + missing, estimated),
        **forces_on(dual, x, u, bodies, [pair.operators for pair in pairs], forces),
    )
    return evaluation, history


def energy_errors(
    dual: DualProgram, point: Point, error: float, estimated: fem.Function | None
) -> dict[str, Any]:
    """Return the fields of an `Evaluation` that tell its errors in the energy norm. Collective.

    The `point` has multipliers and gradient, and `error` [energy^(1/2)] is that of their computed
    displacement. The error of the mesh is estimated from `estimated`, a displacement; None: not.
    """
    bound = dual.energy_bound(point.x, point.r, error)
    # from energies, not as u'K u: if bodies fall through wide gaps, K u is only rounding
    norm = energy_norm(dual, point, error)
    if norm <= dual.energy_resolution():
        norm = 0.0
        log(
            dual.jump.comm,
            "the displacement is zero to rounding: the contact carries all loads, and an accuracy "
            "in the energy norm has nothing to refer to",
        )
    cells = None if estimated is None else dual.compliance.estimator.cell_errors(estimated)
    return {
        "energy_error_bound": relative_error(dual, bound, norm),
        "bound_is_rigorous": dual.compliance.exact,
        "cell_errors": cells,
        "discretisation_error": None if cells is None else total(cells) / (norm or 1.0),
    }


def forces_on(
    dual: DualProgram,
    x: Array,
    u: fem.Function,
    bodies: Bodies,
    operators: Sequence[PairOperators],
    forces: Sequence[Array],
) -> dict[str, Any]:
    """Return the fields of an `Evaluation` with contact forces and their resultants. Collective.

    For each pair with its `operators`, `forces` (n, 1 + d) [force] are the normal force and the
    tangential force vector at each node. The multipliers are x (size,), the displacement is u.
    """
    B, comm, V = dual.jump, dual.jump.comm, u.function_space
    in_space = zero_like(B.system.f, "f")
    owned = -B.whole_force(x).array
    in_space.x.array[: len(owned)] = owned if B.frames is None else B.frames.into_space(owned)
    in_space.x.scatter_forward()
    on_nodes = B.system.displacement(in_space, "contact_force")
    # on linear bodies without frames, forces act at the undeformed places
    displaced = u if B.frames is not None or B.system.is_tangent else None
    on_bodies = nodal_resultants(V, owned_values(on_nodes), displaced, bodies.label, bodies.count)
    on_secondary = []
    for pair, force in zip(operators, forces, strict=True):
        on_secondary.append(-force[:, :1] * pair.normals - force[:, 1:])
    places = np.vstack([pair.places for pair in operators])
    index = np.repeat(np.arange(len(forces)), [len(force) for force in forces])
    all_forces, point = np.vstack(on_secondary), on_bodies[0].point
    normal_force, *tangential = reduce_array(comm, np.vstack(forces).sum(axis=0))
    return {
        "contact_force": on_nodes,
        "normal_force": float(normal_force),
        "tangential_force": float(np.linalg.norm(tangential)),
        "pair_resultants": resultants_on(comm, places, all_forces, index, len(forces), point),
        "body_resultants": on_bodies,
        "between_bodies": resultants_between(V, bodies.label, operators, on_secondary),
    }


def node_values(
    dual: DualProgram, solution: DualSolution, r: Array, increment: Array
) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
    """Return states and slips of the nodes of all pairs, and results about them. Collective.

    The gradient at the multipliers is r (size,), and `increment` (size,) the jump in B's rows less
    `DualProgram.offset`, divided by `JumpOperator.length_scale`: in rows of T the slip of the step.

    Returns:
        states: (n,) values of `ContactState`.
        steps: (n, d + 1) slip vectors of this step, and what it adds to the slip paths [length].
        before: (n, d + 1) slip vectors and slip paths of all earlier steps [length].
        slip: (size,) the increment in tangential rows of nodes that slip, else exactly zero.
        results: the fields `counts`, `local_error` and `bound_error` of an `Evaluation`.
    """
    B, x = dual.jump, solution.multipliers
    # nodes are in the state that they would take if their neighbours were fixed
    section = dual.section_at(x, solution.gradient)  # Lambda with the slip bounds of x
    target = dual.local_minimiser(x, r)  # the multipliers in these states, not yet projected
    target_section = dual.admissible.at_point(x, r).section(target)
    stick = target_section.face(target).stick
    slip = np.zeros_like(increment)
    slipping = section.tangential[~stick[section.node]]
    slip[slipping] = increment[slipping]
    # errors: the largest changes of tractions and of slip bounds from x to these states
    change, largest, rounding = dual.local_change(x, r)
    is_finite = np.isfinite(section.radius)
    bounds = section.radius[is_finite]
    bound_changes = target_section.radius[is_finite] - bounds
    bound_change, largest_bound = largest_abs(B.comm, bound_changes, bounds)

    # which nodes (n,) are bonded, have friction, stick, have a positive slip bound, are pressed
    normal = np.flatnonzero(~B.is_tangential)
    node_of_row = B.row_nodes[normal]
    numbers = [len(pair.nodes) for pair in B.pairs]
    bonded = np.repeat([pair.bonded for pair in B.pairs], numbers)
    tangential_rows = reduce_array(B.comm, [len(pair.tangent_node) for pair in B.pairs])
    has_friction = np.repeat(tangential_rows > 0, numbers)
    nodes = slice(len(bonded))  # the discs of nodes; further discs belong to frictionless rows
    sticks, rubs = stick[nodes], target_section.radius[nodes] > 0.0
    pressed = np.zeros(len(bonded), dtype=np.bool_)
    # strict inequality: a node without gap and without load is not pressed
    pressed[node_of_row] = bonded[node_of_row] | (target[normal] > 0.0)

    # nodes are undecided if a change of tractions by `limit` may change their state: if the
    # traction is so near to the edge of its friction disc, or the pressure so near to 0
    limit = max(change, EDGE * largest)
    scale = np.ones(len(stick))  # stress per multiplier of each disc
    scale[target_section.node] = B.stress_scale[target_section.tangential]
    has_circle = np.isfinite(target_section.radius) & (target_section.radius > 0.0)
    radius = np.where(has_circle, target_section.radius, 0.0)
    from_edge = np.abs(target_section.norms(target) - radius) * scale
    undecided = (has_circle & (from_edge <= limit))[nodes]
    undecided[node_of_row] |= np.abs(target * B.stress_scale)[normal] <= limit

    # the first condition that a node meets is its state
    conditions = {
        ContactState.BONDED: bonded,
        ContactState.STICK: has_friction & pressed & sticks,
        ContactState.SLIP: has_friction & pressed,
        ContactState.PRESSED: pressed,
        ContactState.OPEN_STICK: has_friction & rubs & sticks,
        ContactState.OPEN_SLIP: has_friction & rubs,
    }
    values = [float(state) for state in conditions]
    states = np.select(list(conditions.values()), values, float(ContactState.OPEN))
    vectors = np.vstack(B.nodal_vectors(slip * B.length_scale))[:, 1:]
    slips_before = zip(B.pairs, dual.history.slipped, strict=True)
    before = np.vstack([slipped[pair.nodes] for pair, slipped in slips_before])
    path = np.where(pressed | rubs, np.linalg.norm(vectors, axis=1), 0.0)
    for pair, own in zip(B.pairs, B.nodes, strict=True):  # on edges the longest of all patches
        _, start, row = np.unique(pair.nodes, return_index=True, return_inverse=True)
        path[own] = np.maximum.reduceat(path[own], start)[row]
    # numbers in the order of `NodeCounts`; bonded nodes are counted in no other state
    kinds = np.array([pressed, sticks, pressed & sticks, ~pressed & ~rubs]) & ~bonded
    counts = [len(bonded), *kinds.sum(axis=1), bonded.sum(), (undecided & ~bonded).sum()]
    results = {
        "counts": NodeCounts(*map(int, reduce_array(B.comm, counts))),
        "local_error": relative_change(change, largest, rounding),
        "bound_error": relative_change(bound_change, largest_bound),
    }
    return states, np.column_stack([vectors, path]), before, slip, results


def status_of_fields(
    dual: DualProgram,
    solution: DualSolution,
    evaluation: Evaluation,
    options: SolverOptions,
    requested: SolverOptions,
) -> ContactStatus:
    """Return the status of a solve from the error bound of its fields. Collective.

    The `evaluation` is what the user gets. Its bound may be larger than that with which the
    iteration has converged: then the solve has stagnated, since rounding prevents the accuracy. Or
    it is small enough for the accuracy that the user `requested` although the iteration, whose
    `options` may ask for more, has ended early: then the solve has converged.
    """
    if solution.status is ContactStatus.STOPPED:
        return ContactStatus.STOPPED
    error = evaluation.energy_error_bound
    ended_early = solution.status is not ContactStatus.CONVERGED
    if not ended_early and not error > SLACK * solution.wanted:
        return ContactStatus.CONVERGED

    # the bound of the error presumes equilibrium of floating bodies
    balanced = dual.constraints.imbalance(solution.multipliers, solution.c) <= BALANCED
    if requested.rtol is not None:
        as_requested = solution.residuals[-1] <= requested.rtol and requested != options
    else:  # a balanced accuracy follows from the mesh's error, by which the iteration has judged
        as_requested = not requested.balanced and error <= SLACK * float(requested.accuracy)
    if balanced and as_requested:
        return ContactStatus.CONVERGED
    return solution.status if ended_early else ContactStatus.STAGNATED
