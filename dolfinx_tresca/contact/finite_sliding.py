"""Finite sliding: surfaces are paired where the solution displaces them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.parallel import largest_abs, log, reduce_array
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.table import Units

#: Largest number of differences of iterates that Anderson's acceleration uses.
ANDERSON_DEPTH = 3

#: Anderson's acceleration uses the Gram matrix of differences of residuals u - w, each divided by
#: its length. Eigenvectors with an eigenvalue below this fraction of the largest one are ignored,
#: since they are noise of dependent differences. (With 1e-12, the half ring of
#: benchmarks/finite_sliding.py takes 187 Newton steps in place of 160.)
DEPENDENT = 1e-3

#: Two configurations are alike, and their difference tells how u changes with w, if at most this
#: part of the normal forces is at nodes that are open in one of them.
ALIKE = 0.1

#: Least distance from 0 and from 1 of two estimated fractions: the part of a step between
#: configurations that are not alike at which the next one lies, and the ratio of a change of forces
#: or gaps to the previous one. (Without the least ratio, the error of 3 of 140 random scenes is 1
#: to 2 times the requested one.)
LEAST_FRACTION = 0.1

#: Number of successive configurations in which |u - w| grows, as where bodies snap. With 1, folds
#: of a bellows whose contact moves on do not converge; with 3, an edge that slides off a corner.
GROWING = 2

#: Advice to users if the configurations do not converge.
ADVICE = "Take smaller load steps: surfaces may slide by a few cells in one"

#: Free bodies begin a load step with at most this multiple of their last motion, or -1 times it.
MOST_CONTINUED = 2.0

#: Configurations after which a solve gives up; most take 5 to 12, coarse roller bearings over 40.
MAX_CONFIGURATIONS = 60

#: Changes of gaps are divided by the displacement since the last accepted step, or by this fraction
#: of the whole displacement if the fraction is larger. If a wheel turns on a body that rests, the
#: displacement of a step is only rounding, and relative to rounding no gap is accurate.
SMALL_STEP = 1e-2


@dataclass(frozen=True)
class Configuration:
    """A configuration of the surfaces, and the solution of its contact problem.

    Attributes:
        w: displacement of the surfaces [length], with ghosts.
        u: displacement of the solution [length], with ghosts.
        normal_forces: (pairs, owned nodes) normal forces of the solution [force]; 0 at open nodes.
        forces: (owned unknowns,) contact forces of the solution [force], in frames of bodies.
        gaps: (pairs, owned nodes) gaps of the solution [length], NaN without multipliers.
        square: |u - w|^2 [length^2].
    """

    w: Array
    u: Array
    normal_forces: Array
    forces: Array
    gaps: Array
    square: float


class FiniteSliding:
    """The fixed-point iteration u(w) = w for the displacement w at which surfaces are paired.

    u(w) is the solution of the contact problem whose normals, partners and areas are those of the
    surfaces displaced by w. The iteration w <- u(w) converges linearly where friction acts, because
    the directions of the forces are those of the last configuration. With Anderson's acceleration
    (type II; Walker and Ni 2011, SIAM J. Numer. Anal. 49), the iteration converges about as fast as
    Newton's method for nonlinear bodies, so one Newton step in each configuration is enough.

    u(w) has kinks where the contact passes from node to node: only differences of configurations
    that are `ALIKE` are used, and where a step crosses a kink and should not have, the next
    w lies between both solutions u. Where bodies snap, u(w) = w has an unstable solution, or none:
    residuals u - w grow, and the accelerated step would go against them. Then the step w <- u(w) is
    taken, until bodies reach another equilibrium, and earlier configurations are forgotten. If it
    leads back to where such a step led before, the equilibrium is stable, and bodies do not snap.

    Attributes:
        error: estimate of the larger relative error, of contact forces or of gaps.
        configurations: number of configurations so far.
        snaps: whether a step has followed growing residuals, as where bodies snap.
    """

    def __init__(self, contact: ContactSystem) -> None:
        """Begin with the configuration in which the surfaces are paired. Not collective."""
        self._contact = contact
        self._path: list[Configuration] = []
        self._followed: Array | None = None  # u to which the last step of a snap has gone
        self._grows = 0  # number of successive configurations in which |u - w| has grown
        self.configurations, self.snaps, self.error = 1, False, math.inf

    def observe(self, u: fem.Function) -> None:
        """Record the solution u in the present configuration; estimate its error. Collective.

        Forces are compared in the Euclidean norm, gaps by their largest change (see `SMALL_STEP`).
        Changes within the rounding of stresses and positions count as zero.
        """
        contact, w = self._contact, self._contact.state.configuration.x.array.copy()
        forces, gaps = contact.contact_forces(), contact.gaps_at_nodes(u)
        residual = u.x.array - w
        (square,) = self._products(residual, [residual])
        self.error = math.inf
        if self._path:
            former = self._path[-1]
            self._grows = self._grows + 1 if square > former.square else 0
            # forces: squares of the norms of their change, of themselves, and of their rounding
            multiplier_rounding = contact.compliance.stress_rounding / contact.jump.stress_scale
            force_rounding = contact.contact_forces(np.asarray(multiplier_rounding))
            vectors = forces - former.forces, forces, force_rounding
            squares = reduce_array(contact.comm, [float(values @ values) for values in vectors])
            force_change = _root_of_ratio(*squares)
            # gaps: their largest change, the displacement it is divided by, and its rounding
            changes = np.nan_to_num(gaps - former.gaps)  # 0 at nodes without a multiplier
            accepted = contact.state.accepted.displacement
            moved = u.x.array - (0.0 if accepted is None else accepted.x.array)
            largest, length, displaced = largest_abs(contact.comm, changes, moved, u.x.array)
            length = max(length, SMALL_STEP * displaced)
            resolution = ROUNDING * (contact.obstacles.extent + displaced)
            gap_change = _root_of_ratio(largest**2, length**2, resolution**2)
            # the ratio of |u - w| to the last step of w, which has caused the change; it is large
            # if Anderson's acceleration hardly moves w
            step = w - former.w
            (step_square,) = self._products(step, [step])
            ratio = _root_of_ratio(square, max(step_square, ROUNDING**2 * square))
            ratio = max(ratio, LEAST_FRACTION)
            # the sum of all further changes, change (ratio + ratio^2 + ...)
            change = max(force_change, gap_change)
            self.error = change * ratio / (1.0 - min(ratio, 1.0 - LEAST_FRACTION))
        normal_forces = contact.normal_forces_at_nodes()
        self._path.append(Configuration(w, u.x.array.copy(), normal_forces, forces, gaps, square))
        text = "finite sliding: configuration %d, error of forces or gaps about %.0e"
        log(contact.comm, text, self.configurations, self.error)

    def pair_first_configuration(self) -> None:
        """Pair the surfaces in the first configuration of a load step. Collective.

        Its displacement is the present one plus the response to the change of the prescribed
        values, with the present K and unchanged contact forces. Bodies with frames keep their
        deformation v. Held bodies turn with the prescribed values, and free ones go on as they have
        moved in the last step, like the rollers of a bearing.
        """
        contact, state = self._contact, self._contact.state
        linear, at_rest, frames = contact.linear, contact.frames_at_rest, contact.jump.frames
        v = origin = state.configuration
        if at_rest is not None:
            linear.frames = None  # for prescribed values in space
            values, held = linear.prescribed_values(), origin.copy()
            accepted, before = state.accepted.displacement, state.accepted.before
            if accepted is not None and before is not None:
                # the multiple of their last motion by which free bodies go on is that of the
                # prescribed values: their change, projected on their last change
                begin = before.x.array[: len(linear.prescribed)][linear.prescribed]
                reached = accepted.x.array[: len(linear.prescribed)][linear.prescribed]
                last_step, present_step = reached - begin, values - reached
                rounding = ROUNDING * np.abs(reached).max(initial=0.0)
                present_step[np.abs(present_step) <= rounding] = 0.0
                products = [float(last_step @ last_step), float(last_step @ present_step)]
                square, product = reduce_array(contact.comm, products)
                multiple = product / square if square > 0.0 else 0.0
                multiple = float(np.clip(multiple, -1.0, MOST_CONTINUED))
                if multiple != 0.0:
                    held = at_rest.continued(before, accepted, multiple)
            held.x.array[: len(linear.prescribed)][linear.prescribed] = values
            held.x.scatter_forward()
            # the frames in which the response is computed, until B has them by a new pairing
            linear.frames = at_rest.moved_with(held)
            v = origin if frames is None else frames.deformation(origin)
        try:
            w = linear.response_to_prescribed_values(contact.compliance.solver, v)
            w.x.array[:] += v.x.array
            w = w if linear.frames is None else linear.frames.displacement(w)
        finally:
            linear.frames = frames
        step, displaced = largest_abs(contact.comm, w.x.array - origin.x.array, w.x.array)
        if step > ROUNDING * (contact.obstacles.extent + displaced):
            contact.pair_where_changed(w)

    def pair_next_configuration(self) -> None:
        """Pair the surfaces in the next configuration. Collective."""
        w = fem.Function(self._contact.linear.V)
        w.x.array[:] = self._next()
        self._contact.pair_where_changed(w)
        self.configurations += 1

    def _next(self) -> Array:
        """Return the next displacement w, with ghosts; the class explains the cases. Collective."""
        earlier, newest = self._path[:-1], self._path[-1]
        u, w, residual = newest.u, newest.w, newest.u - newest.w
        # configurations that are `ALIKE` the newest; not the first of all, whose w is a guess,
        # without the new contact forces, or lies before a snap
        alike: list[Configuration] = []
        for configuration in earlier[1:]:
            differs = (newest.normal_forces > 0.0) != (configuration.normal_forces > 0.0)
            forces = newest.normal_forces + configuration.normal_forces
            sums = [float(forces[differs].sum()), float(forces.sum())]
            changed_force, whole_force = reduce_array(self._contact.comm, sums)
            if changed_force <= ALIKE * whole_force:
                alike.append(configuration)
        if len(earlier) > 1 and (not alike or alike[-1] is not earlier[-1]):
            # the last step has crossed a kink: do the residuals u - w at its ends point at each
            # other? A positive product with the step points on along it, a negative one back.
            before = earlier[-1]
            onwards, backwards = self._products(w - before.w, [before.u - before.w, residual])
            if onwards > 0.0 > backwards:
                fraction = onwards / (onwards - backwards)  # where u - w crosses zero
                fraction = min(max(fraction, LEAST_FRACTION), 1.0 - LEAST_FRACTION)
                return np.asarray((1.0 - fraction) * before.u + fraction * u)
        if not alike:
            return u
        accelerated = self._accelerated([*alike[-ANDERSON_DEPTH:], newest])
        # does the accelerated step go against the residual, and the residual to where a snap went?
        followed = w if self._followed is None else self._followed
        against, back = self._products(residual, [w - accelerated, followed - w]) > 0.0
        if self._grows >= GROWING and against and not back:
            self.snaps, self._path, self._followed = True, [newest], u
            return u
        return accelerated

    def _accelerated(self, path: list[Configuration]) -> Array:
        """Return the next w by Anderson's acceleration from like configurations. Collective.

        With r = u - w of the last configuration, and the changes dr and du of r and u between
        successive ones as columns, it is u - du a. Here dr'dr a = dr'r: a minimises |r - dr a|.
        """
        newest, successive = path[-1], list(pairwise(path))
        residual_changes = np.array([b.u - b.w - (a.u - a.w) for a, b in successive])  # rows: dr'
        displacement_changes = np.array([b.u - a.u for a, b in successive])  # rows: du'
        vectors = [*residual_changes, newest.u - newest.w]
        products = np.array([self._products(change, vectors) for change in residual_changes])
        matrix, right = products[:, :-1], products[:, -1]  # dr'dr and dr'r
        # equations for changes that are divided by their lengths, see `DEPENDENT`
        lengths = np.sqrt(np.diag(matrix))
        lengths[lengths == 0.0] = 1.0
        scaled = matrix / np.outer(lengths, lengths)
        factors = np.linalg.lstsq(scaled, right / lengths, rcond=DEPENDENT)[0] / lengths
        return np.asarray(newest.u - displacement_changes.T @ factors)

    def _products(self, x: Array, vectors: list[Array]) -> Array:
        """Return inner products of x with `vectors`, displacements with ghosts. Collective."""
        owned = len(self._contact.linear.prescribed_displacements)
        return reduce_array(self._contact.comm, [float(x[:owned] @ y[:owned]) for y in vectors])


def solve_with_finite_sliding(
    contact: ContactSystem,
    options: SolverOptions,
    units: Units | None,
    observe: Callable[[Iteration], bool],
) -> ContactSolution:
    """Repeat `ContactSystem.solve` of linear bodies until configurations converge. Collective.

    The result is the solution in the last configuration, with the iterations, products and seconds
    of all of them; its text `sliding` says why configurations did not converge, if so.
    """
    sliding = FiniteSliding(contact)
    sliding.pair_first_configuration()
    cost: dict[str, Any] = {}
    failure = ""
    observed: list[Iteration] = []  # the newest one only

    def in_configuration(iteration: Iteration) -> bool:
        observed[:] = [replace(iteration, configuration=sliding.configurations)]
        return observe(observed[0])

    while True:
        solution = contact.solve(options, units, in_configuration)
        add_cost(cost, solution)
        number = f"configuration {sliding.configurations} of the surfaces"
        if solution.status is not ContactStatus.CONVERGED:
            if solution.status in (ContactStatus.NO_FIXED_POINT, ContactStatus.STAGNATED):
                failure = f"{solution.sliding}. " * bool(solution.sliding)
                failure += f"This happened in {number}. {ADVICE}"
            break
        sliding.observe(solution.u)
        if sliding.error <= options.geometry_accuracy:
            if observed:
                observe(replace(observed[0], ended=True))
            break
        if sliding.configurations == MAX_CONFIGURATIONS:
            status = ContactStatus.MAX_ITERATIONS
            contact.state = contact.state.with_status(status)
            solution = replace(solution, status=status)
            failure = f"In {number} forces or gaps are off by about {sliding.error:.0e}. {ADVICE}"
            break
        try:
            sliding.pair_next_configuration()
        except PairingError as error:
            raise PairingError(f"{error} This happened after {number}. {ADVICE}.") from error
    return replace(solution, sliding=failure or solution.sliding, **cost)


def add_cost(total: dict[str, Any], solution: ContactSolution) -> None:
    """Add iterations, products and seconds of a solution to a total, by the names of its fields."""
    for name in ("iterations", "products", "krylov_iterations"):
        total[name] = total.get(name, 0) + getattr(solution, name)
    timings = total.setdefault("timings", {})
    for phase, seconds in solution.timings.items():
        timings[phase] = timings.get(phase, 0.0) + seconds


def _root_of_ratio(square: float, reference: float, rounding: float = 0.0) -> float:
    """Return sqrt(square / reference) of two squares, or 0 if `square` is at most `rounding`."""
    if square <= rounding:
        return 0.0
    return math.sqrt(square / reference) if reference > 0.0 else math.inf
