"""Newton's method, which applies the load in parts if it fails for the whole load."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arguments import checked_integer, checked_number
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import collapse
from dolfinx_tresca._base.functions import with_owned_values
from dolfinx_tresca._base.parallel import largest_abs, log, reduce_array
from dolfinx_tresca._base.tolerances import FORCING
from dolfinx_tresca.contact.finite_sliding import FiniteSliding, add_cost
from dolfinx_tresca.dual.nodal_values import replaced
from dolfinx_tresca.errors import PairingError, StiffnessError
from dolfinx_tresca.monitor import Iteration, NewtonProgress
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.problem.tangent_problem import TangentProblem
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.table import Units

#: A residual within rounding is accepted if it is at least this fraction of the residual before it.
#: (With twice the value, a body that returns to rest takes 100 steps.)
STALLED = 0.5

#: With added stiffness, whose springs make the energy of u large, the residual is relative to at
#: most this multiple of the contact forces, in the same norm. Without this limit, forces that
#: contact alone balances stay unbalanced by 1e-4 to 1e-2; doubled, the imbalance doubles.
BALANCE = 100.0

#: Newton's method may take up to this multiple of `max_iterations` while its error falls fast
#: enough: with added stiffness it converges linearly, and steps cost less than a smaller load.
MAX_ITERATIONS_FACTOR = 4

#: The entries of `ADDED` with springs alone, which do not change the iterates as long as nodes stay
#: in contact. The entries after them slow Newton's method down.
SPRINGS_ALONE = ((0.0, 0.0), (10.0, 0.0), (1000.0, 0.0))

#: Stiffness that is added to a tangent which is not positive definite, in the order of trial: the
#: stiffness of springs in the contact, relative to that of a single node, and the factor of the
#: undeformed bodies' stiffness (arguments of `factor`). Blocks of rubber compressed by 40 % buckle
#: with springs of 1; springs of 10,000 almost prevent sliding. The least factor that suffices takes
#: the fewest steps: with 0.1 and 1 only, an arch that a ball pushes through takes 404, not 57.
ADDED = SPRINGS_ALONE + tuple((10.0, factor) for factor in (0.01, 0.03, 0.1, 0.3, 1.0))

#: Bodies have snapped if they release more than `SNAP` times the energy that they exchange with
#: contact or store, whichever is larger, and move more than `FAR` times as far as obstacles and
#: prescribed values do. (Where an edge passes from node to node, a step seems to release up to 0.6
#: of this energy, which the next step takes back.)
SNAP, FAR = 0.5, 3.0

#: Advice about elements that are unstable since they keep their volume.
UNSTABLE_ELEMENTS = (
    ". Only in bodies that hardly change their volume (Poisson's ratio from 0.45 on): elements "
    "with displacements alone become unstable early: take a pressure as a further unknown, a mixed "
    "space. Elements with a pressure wrinkle under large compression: keep a part of the energy of "
    "the volume in the displacement. See 'Nearly incompressible rubber' in the docs"
)


@dataclass(frozen=True)
class NewtonOptions:
    """Options of Newton's method.

    Attributes:
        accuracy: requested residual |R(u) + B'lambda|_{K^-1}, where R(u) are internal minus
            external forces, B'lambda contact forces and K is the last tangent. It is relative to
            the larger of |u|_K and |u - u_0|_K, where u_0 is u at the start of the solve; if
            stiffness was added to the tangent, which makes these norms large, to 100
            |B'lambda|_{K^-1} if that is smaller. A larger residual is accepted if it does not halve
            any more and has the size of its rounding errors, as after a rigid motion, which has no
            energy. The residual of the contact conditions has its own accuracy in `SolverOptions`.
        max_iterations: largest number of Newton steps for a part of the load. Up to four times this
            number are taken while the error (with finite sliding also the error of the
            configuration) falls fast enough to reach the requested error within these steps.
        max_halvings: largest number of halvings of the part of the load that is applied at once.
    """

    accuracy: float = 1e-6
    max_iterations: int = 15
    max_halvings: int = 6

    def __post_init__(self) -> None:
        """Check every value."""
        vars(self).update(
            accuracy=checked_number("accuracy of Newton's method", self.accuracy, "(0, 1)"),
            max_iterations=checked_integer("max_iterations", self.max_iterations),
            max_halvings=checked_integer("max_halvings", self.max_halvings, least=0),
        )


@dataclass(frozen=True)
class NewtonStep:
    """One step of Newton's method: one contact problem.

    Attributes:
        number: number of the step, from 1 for each part of the load.
        fraction: fraction of the whole change of load at which the step seeks the equilibrium.
        correction: |u_{k+1} - u_k|_K, the length of the step, relative to the norm to which
            `NewtonOptions.accuracy` is relative.
        residual: |R(u_{k+1}) + B'lambda - h|_{K^-1} with the forces h that take back what of the
            load is not applied yet, relative to the same norm; NaN if it cannot be computed.
        contact_residual: natural residual of the contact problem, relative to that at lambda = 0.
        iterations: iterations of the contact solver.
        products: products with A in this step.
        pressed: number of nodes with pressure, of all pairs and ranks.
        added: stiffness that was added to the tangent, in words; empty if there was none.
    """

    number: int
    fraction: float
    correction: float
    residual: float
    contact_residual: float
    iterations: int
    products: int
    pressed: int
    added: str

    @property
    def is_proximal(self) -> bool:
        """Whether the stiffness of the undeformed bodies was added, as where bodies snap."""
        return "proximal" in self.added


@dataclass(frozen=True)
class NewtonRecord:
    """The steps of Newton's method in one `solve`, shown as a table.

    Attributes:
        steps: all steps, including the steps of parts of the load that failed.
        fraction: part of the change of load that was solved for: 1, or less after a failure.
        message: the failure, and advice; empty after a success.
        released: energy that is neither stored nor dissipated by friction between the displacement
            from which the solve started and the solution [energy]: the work of loads, prescribed
            values and obstacles, minus the changes of the stored energy and of `dissipation`. Where
            bodies snap, it becomes motion and heat; in smooth steps it is small, of third order in
            the size of the step. NaN if it cannot be computed, or after a failure.
        snaps: whether most of the energy that the bodies exchange in this step is released: they
            jump to another equilibrium, or the step is too large to follow them.
        unbalanced: after a failure the forces R(u) + B'lambda - h [force], as in
            `NewtonStep.residual`, after its last Newton step, zero where prescribed; else None.
        flips: after a failure, at each node the number of Newton steps in which contact began or
            ended there, for the last part of the load that was tried; else None.
    """

    steps: tuple[NewtonStep, ...]
    fraction: float
    message: str
    released: float = math.nan
    snaps: bool = False
    unbalanced: fem.Function | None = None
    flips: fem.Function | None = None

    @property
    def residual(self) -> float:
        """The residual of the last step."""
        return self.steps[-1].residual if self.steps else math.nan

    def __repr__(self) -> str:
        return f"<NewtonRecord: {len(self.steps)} steps, {self.fraction:.4g} of the load>"

    def __str__(self) -> str:
        lines = ["   load  step  correction  residual  contact  pressed  products  added to K"]
        for step in self.steps:
            lines.append(
                f"{step.fraction:7.4f}  {step.number:4d}  {step.correction:10.1e}  "
                f"{step.residual:8.1e}  {step.contact_residual:7.0e}  {step.pressed:7d}  "
                f"{step.products:8d}  {step.added}".rstrip()
            )
        return "\n".join([*lines, self.message] if self.message else lines)


class EnergyBalance:
    """Energy that bodies release in a solve, by which `NonlinearContactProblem` sees them snap.

    The work of loads, prescribed values and obstacles is that of forces which change linearly with
    the motion (the trapezoidal rule). The change of the stored energy is the integral of the
    internal forces R over the straight path from u_0 to u_1. The energy that remains is released:

        1/2 (R_0 + R_1)'(u_1 - u_0) - integral of R'du + 1/2 (C_0 + C_1)'(u_1 - u_0 - v) - D

    with the contact forces C = B'lambda, the displacement v of obstacles at the nodes in the whole
    solve, and the dissipation D in it. In a smooth step it is small, of third order in the step.
    """

    def __init__(self, problem: TangentProblem) -> None:
        """Note u_0 and C_0, before the solve moves u or pairs surfaces anew. Collective."""
        state = problem.state
        self._problem, self._start = problem, problem.u.x.array.copy()
        self._motions = state.motions, problem.obstacles.motions
        end = state.accepted.unknowns if state.end is None else state.end
        end = np.zeros_like(self._start) if end is None else end  # zero before the first solve
        self._begins_at_end, self._dissipation = np.array_equal(self._start, end), state.dissipation
        self._forces_at_start, self._work_at_start, _ = self._contact_work()

    def _contact_work(self) -> tuple[Array, float, float]:
        """Return C at owned unknowns now, and on this rank C'v and the largest v. Collective."""
        problem, multipliers = self._problem, self._problem.state.multipliers
        jumps, largest = problem.obstacles.jumps(problem.state, *self._motions)
        forces = np.array(problem.jump.whole_force(multipliers).array)
        return forces, float(multipliers @ jumps), largest

    def released(self, start: Array) -> tuple[float, bool]:
        """Return the released energy up to the present u, and whether bodies snap. Collective.

        The energy is NaN if Newton's method began at a `start` where the last solve did not end; if
        internal forces are unknown; or if a user's function computes them and no body moves `FAR`.
        """
        problem, tangent = self._problem, self._problem.tangent
        forces, work, driven = self._contact_work()
        change = problem.u.x.array - self._start
        owned = change[: len(forces)]
        starts_there = self._begins_at_end and np.array_equal(start, self._start)
        # the largest motions of bodies and of what drives them, and 1 if any rank starts elsewhere
        free, held, driven, elsewhere = largest_abs(
            problem.comm, owned[tangent.moves], owned[tangent.prescribed], driven, not starts_there
        )
        is_far = free > FAR * max(held, driven)
        # a load that is solved for again moves bodies, too, by what the accuracies have left
        is_far = is_far and problem.is_large(problem.energy_norm(change), problem.u.x.array)
        if elsewhere or (tangent.has_material and not is_far):
            return np.nan, False
        # R'(u_1 - u_0) at the points of Lobatto's rule: the ends, with the weights 1/12, and two
        # inner ones, with 5/12
        powers, inner = [], 0.5 * np.sqrt(0.2)
        try:
            for fraction in (0.0, 1.0, 0.5 - inner, 0.5 + inner):
                with replaced([problem.u], [problem.u.x.array - fraction * change]):
                    powers.append(float(tangent.all_forces() @ owned))
        except StiffnessError:
            return np.nan, False
        at_ends = 0.5 * sum(powers[:2])
        stored = (sum(powers[:2]) + 5.0 * sum(powers[2:])) / 12.0
        contact = 0.5 * float((self._forces_at_start + forces) @ owned)
        local = [at_ends, stored, contact, 0.5 * (self._work_at_start + work)]
        at_ends, stored, contact, work = reduce_array(problem.comm, local)
        released = at_ends - stored + contact - work - problem.state.dissipation + self._dissipation
        return released, bool(released > SNAP * max(abs(stored), abs(contact)) and is_far)


@dataclass
class Newton:
    """Newton's method for one `solve`: the change of load in as few parts as possible.

    Attributes:
        start: values of u at which the solve starts.
        fraction: fraction of the change of load that has been applied.
        solution: the solution for `fraction` of the change of load; if no part was solved, the
            solution of the last step; None if no step could be made.
        failure: why the last part of the load failed; empty after a success.
        cost: iterations, products and seconds of all steps; see `add_cost`.
        level: index into `ADDED` of the last tangent, at first of the solve before.
        stuck: whether no step is possible from the present displacement, with any part of the load.
        unbalanced, flips: the attributes of `NewtonRecord`.
    """

    problem: TangentProblem
    options: NewtonOptions
    contact_options: SolverOptions
    units: Units | None
    observe: Callable[[Iteration], bool]
    level: int
    steps: list[NewtonStep] = field(default_factory=list)
    fraction: float = 0.0
    solution: ContactSolution | None = None
    failure: str = ""
    cost: dict[str, Any] = field(default_factory=dict)
    stopped: bool = False
    stuck: bool = False
    unbalanced: fem.Function | None = None
    flips: fem.Function | None = None
    _iteration: Iteration | None = None  # the last observed iteration
    _sliding: FiniteSliding | None = None  # of the present part of the load

    def __post_init__(self) -> None:
        """Begin at the present displacement. Not collective."""
        self.start = self.problem.u.x.array.copy()

    def run(self) -> None:
        """Apply the change of load in parts, halved after a failure, then doubled. Collective."""
        problem, tangent, increment = self.problem, self.problem.tangent, 1.0
        while self.fraction < 1.0:
            state, fraction = problem.state, min(1.0, self.fraction + increment)
            try:
                problem.apply_load(fraction)
                self.failure = self._equilibrium()
            except PairingError as error:
                self.failure = f"{fraction:.4g} of the load: {str(error).rstrip('.')}"
            if not self.failure:
                self.fraction, self.unbalanced, self.flips = fraction, None, None
                increment *= 2.0
                if self._iteration is not None and self.fraction == 1.0:
                    self._observed(self._iteration, ended=True)
                continue
            log(problem.comm, "Newton's method: %s", self.failure)
            # for users: forces out of balance, and how often contact began or ended at each node
            try:
                residual = tangent.residual(problem.contact_forces())
            except StiffnessError:  # the user's function has no stresses here
                residual = np.full(len(tangent.prescribed), np.nan)
            forces = with_owned_values(tangent.space, residual)
            self.unbalanced = tangent.displacement(forces, "unbalanced")
            space, dofs = collapse(tangent.V.sub(0))
            owned = dofs[: space.dofmap.index_map.size_local] // tangent.V.dofmap.bs
            self.flips = with_owned_values(space, self._flips[owned], "flips")
            problem.return_to(state)
            increment *= 0.5
            if self.stopped or self.stuck:
                return
            if increment >= 0.5**self.options.max_halvings:
                continue
            # no smaller part is allowed: add to the failure what the steps of this part show
            text = ". `newton.unbalanced` and `newton.flips` of the solution show where it fails"
            # nodes at which contact began or ended in three Newton steps or more
            (nodes,) = reduce_array(problem.comm, [int((self._flips > 2.0).sum())])
            if nodes:
                text += f"; contact at {int(nodes)} node(s) begins and ends again and again"
            if "unstable" not in self.failure and any(step.is_proximal for step in self.steps):
                text += ", and the tangent is indefinite even with fixed contact: they are unstable"
                text += UNSTABLE_ELEMENTS
            self.failure += text
            return

    def _equilibrium(self) -> str:
        """Take Newton steps with the present load; return why they failed, or "". Collective."""
        problem, norm_before, number = self.problem, math.inf, 0
        errors: list[float] = []  # after each step, divided by the requested error
        pressed = problem.normal_forces_at_nodes() > 0.0
        self._flips = np.zeros(pressed.shape[1])
        if problem.slides_far:
            self._sliding = FiniteSliding(problem)
            self.level = 0  # springs would hold the partners of another configuration
            with suppress(StiffnessError):  # the steps will add stiffness
                problem.factor()
                self._sliding.pair_first_configuration()
        while True:
            # Solve the contact problem of a step, and move to its displacement.
            number += 1
            where = f"Newton step {number} with {problem.tangent.fraction:.4g} of the load"
            try:
                solution = self._step()
            except StiffnessError as error:
                self.stuck = number == 1
                return f"{where}: {str(error).rstrip('.')}"
            scale, correction, residual, fault = self._move_to(solution, number)
            pressed_before, pressed = pressed, problem.normal_forces_at_nodes() > 0.0
            if number > 1:
                self._flips += (pressed != pressed_before).any(axis=0)
            # Is this part of the load in equilibrium, or does the residual grow or stall?
            norm = residual * scale
            # The residual of the first step may be small only because nothing had moved yet. Steps
            # with added stiffness lead from an unstable equilibrium to a stable one, and on the way
            # the residual grows before it falls: from 7e-4 to 2e-2 to 7e-5 in a block that snaps.
            grows = number > 2 and norm >= norm_before and self.level == 0
            stalls = number > 2 and norm >= STALLED * norm_before
            reached = residual <= self.options.accuracy
            if stalls and not reached:
                reached = problem.comm.bcast(norm <= problem.rounding_norm())
            if self.fraction == 0.0 or reached:
                self.solution = solution
            log(problem.comm, "%s: residual %.1e, correction %.1e", where, residual, correction)
            if solution.status is ContactStatus.STOPPED:
                self.stopped = True
                return f"{where} was stopped by the observer"
            if not math.isfinite(residual):
                return f"{where}: {fault}"
            # the larger error, of equilibrium or of the configuration, divided by the requested one
            excess = 1.0 if reached else residual / self.options.accuracy
            if self._sliding is not None:
                self._sliding.observe(problem.displacement)
                excess = max(excess, self._sliding.error / self.contact_options.geometry_accuracy)
            if reached and excess <= 1.0:
                return ""
            errors.append(excess)
            # Is a further step worth while?
            if self._sliding is not None:
                self._sliding.pair_next_configuration()
            elif grows:  # residuals in two configurations would not be comparable
                return f"{where} diverges: residual {residual:.1e}, after {norm_before / scale:.1e}"
            if not self._may_continue(errors):
                failure = (
                    f"{where} converges too slowly: residual {residual:.1e}, after "
                    f"{norm_before / scale:.1e}; requested {self.options.accuracy:.0e}"
                )
                if self._sliding is not None:
                    failure += f"; the error of forces or gaps is about {self._sliding.error:.0e}"
                return failure
            norm_before = norm

    def _move_to(self, solution: ContactSolution, number: int) -> tuple[float, float, float, str]:
        """Make a step's displacement the present u, measure the step, and add it to `steps`.

        Collective.

        Returns:
            scale: the norm to which errors are relative, see `NewtonOptions.accuracy`.
            correction, residual: numbers of `NewtonStep`, relative to the scale.
            fault: reason why the residual is NaN, if it is.
        """
        problem, values = self.problem, solution.w.x.array
        from_start = problem.energy_norm(values - self.start)  # u may go back to zero
        scale = problem.comm.bcast(max(problem.energy_norm(values), from_start))
        change = problem.energy_norm(values - problem.u.x.array)
        problem.u.x.array[:] = values
        fault = "forces are NaN or infinite, as cells turn inside out"
        try:
            residual = problem.residual_norm()
        except StiffnessError as error:
            residual, fault = math.nan, str(error).rstrip(".")
        if self.level > 0:
            balance = BALANCE * problem.norm_of_correction(problem.contact_forces())
            scale = min(scale, balance) if balance > 0.0 else scale
        scale = scale or problem.rounding_norm() / self.options.accuracy
        # sums may differ between ranks in the last digit, verdicts must not
        scale, correction, residual = problem.comm.bcast((scale, change / scale, residual / scale))
        springs, proximal = ADDED[self.level]  # proximal stiffness is added to springs only
        added = f"contact {springs:g}" if springs > 0.0 else ""
        if proximal > 0.0:
            added += f", proximal {proximal:g}"
        # for users: the step and its cost
        fraction, contact_residual = problem.tangent.fraction, solution.residuals[-1]
        counts = solution.iterations, solution.products, solution.counts.contact
        step = NewtonStep(number, fraction, correction, residual, contact_residual, *counts, added)
        self.steps.append(step)
        add_cost(self.cost, solution)
        return scale, correction, residual, fault

    def _observed(self, iteration: Iteration, *, ended: bool = False) -> bool:
        """Show an iteration of a contact solve to the user; return whether to stop. Collective."""
        residual = self.steps[-1].residual if self.steps else math.inf
        number = len(self.steps) + (not ended)
        progress = NewtonProgress(number, self.problem.tangent.fraction, residual, ended)
        self._iteration = replace(iteration, newton=progress)
        return self.observe(self._iteration)

    def _may_continue(self, errors: list[float]) -> bool:
        """Return whether Newton's method may take another step. Not collective.

        The `errors` are those after each step, divided by the requested error. Allowed are
        `max_iterations` steps, and `MAX_ITERATIONS_FACTOR` times as many if bodies snap (steps have
        the stiffness of the undeformed bodies), or if the error, at its mean rate in the second
        half of the steps, becomes 1 within as many. Rates are those of the least error so far,
        since Anderson's acceleration makes errors of the configuration jump up and down.
        """
        most, number = self.options.max_iterations, len(errors)
        snaps = any(step.is_proximal for step in self.steps[-number:])
        snaps |= self._sliding is not None and self._sliding.snaps
        if number < most or (snaps and number < MAX_ITERATIONS_FACTOR * most):
            return True
        middle = (number - 1) // 2
        least, least_before = min(errors), min(errors[: middle + 1])
        if number == 1 or not 0.0 < least < least_before < math.inf:
            return False
        rate = (least / least_before) ** (1.0 / (number - 1 - middle))
        return bool(least * rate ** (MAX_ITERATIONS_FACTOR * most - number) <= 1.0)

    def _step(self) -> ContactSolution:
        """Solve a contact problem with the least of `ADDED` that makes K definite. Collective."""
        # Springs that were needed once are kept; after a slow level, the level below is tried.
        lowest = self.level - 1 if self.level >= len(SPRINGS_ALONE) else self.level
        for level in range(lowest, len(ADDED)):
            try:
                self.level = level
                self.problem.factor(*ADDED[level])
                # in the Newton residual, the contact residual is multiplied by the added stiffness
                forcing = FORCING if level > 0 else 1.0
                options = self.contact_options.at_least(self.options.accuracy * forcing)
                return self.problem.solve(options, self.units, self._observed, self.contact_options)
            except StiffnessError as error:
                failure = error
        if failure.evidence:
            raise StiffnessError(
                "the bodies are unstable, however contact holds them: in the tangent with springs "
                f"at the contact and the undeformed bodies' stiffness, {failure.evidence}. Bodies "
                f"buckle or fold here, or cells are almost inside out{UNSTABLE_ELEMENTS}"
            )
        raise failure
