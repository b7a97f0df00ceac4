"""Newton's method, and how the load is brought on where it fails."""

from __future__ import annotations

import math
from dataclasses import replace

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.observers import agreed_observer
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.monitor import Iteration, NewtonProgress, Observer
from dolfinx_tresca.nonlinear.linearised import LinearisedProblem
from dolfinx_tresca.nonlinear.record import NewtonOptions, NewtonStep
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.status import ContactStatus

#: Growth of what is out of balance from which on Newton's method counts as diverging. Not from the
#: first step to the second: that of the first step may be small only since nothing had moved yet.
#: Nor in a step with the undeformed bodies' stiffness added, nor in the first step without it: such
#: steps go down in energy, away from an equilibrium that has become unstable, and forces grow
#: before they fall at the stable one. (A block of degree 2 with 8 x 8 cells and Coulomb's 0.3 snaps
#: at a strain of 0.4335: residuals 7e-4, 4e-3 with the stiffness, 2e-2 without, 5e-4, 7e-5, ...)
GROWTH = 1.0

#: Steps over `max_iterations` to which Newton's method goes on as long as what is out of balance
#: falls fast enough to end by then: with the undeformed bodies' stiffness added it falls by some
#: factor in each, which takes fewer steps than parts of the load would.
MOST_STEPS = 4

#: Accuracy of a step's contact problem over that of Newton's method where springs are in the
#: contact: what the one leaves the other has times their stiffness.
WITH_SPRINGS = 0.1

#: What may be added to a tangent that is not positive definite, one after the other: springs in
#: the contact, over the stiffness of a node that moves alone, and how much of the undeformed
#: bodies' stiffness. Blocks of rubber compressed by 40 % buckle with springs of 1; with 10,000
#: nodes that ought to slide hardly do.
ADDED = ((0.0, 0.0), (10.0, 0.0), (1000.0, 0.0), (10.0, 0.1), (10.0, 1.0))

#: The first of these that slows Newton's method down: what comes before has no say in the answer of
#: a step as long as nodes stay in contact.
FIRST_SLOW = 3


class Newton:
    """One `solve`: the change of load since the last one, in as few parts as go.

    Attributes:
        steps: all Newton steps so far.
        fraction: of the change of load that has been brought on.
        found: the solution there; that of the last step where nothing has been, None without one.
        failure: why the last part of the load came to nothing; empty where it did not.
        timings: seconds of each phase of all steps.
        krylov_iterations: of all steps.
        level: which of `ADDED` the last tangent took.
        stopped: whether the observer stopped it.
        stuck: whether there is no way on from the present displacement, with no part of the load.
    """

    def __init__(
        self,
        problem: LinearisedProblem,
        options: NewtonOptions,
        contact: SolverOptions,
        observer: Observer | None,
        level: int,
    ) -> None:
        self.problem, self.options = problem, options
        self._observe = agreed_observer(
            problem.comm, observer, "an Iteration, such as a ProgressBar"
        )
        self._iteration: Iteration | None = None  # that was observed last
        self.contact = contact
        self.steps: list[NewtonStep] = []
        self.fraction = 0.0
        self.found: ContactSolution | None = None
        self.failure = ""
        self.level = level
        self.timings: dict[str, float] = {}
        self.krylov_iterations = 0
        self.stopped = False
        self.stuck = False
        self._unstable = False  # whether a step of the present part took a slow one of `ADDED`
        self._last_change: Array | None = None  # of u in the last step but first ones of parts

    def run(self) -> None:
        """Bring on the load. Collective.

        Raises:
            InputError: an input is wrong; or nothing holds a body against its loads.
        """
        problem = self.problem
        problem.tangent.begin(problem.contact_forces())
        self._start = problem.u.x.array.copy()
        part = 1.0
        while self.fraction < 1.0:
            state = problem.state
            problem.tangent.fraction = min(1.0, self.fraction + part)
            self.failure = self._equilibrium()
            if not self.failure:
                self.fraction = problem.tangent.fraction
                part *= 2.0
                if self._iteration is not None and self.fraction == 1.0:
                    self._observe(replace(self._iteration, newton=self._progress(ended=True)))
                continue
            log(problem.comm, "Newton's method: %s", self.failure)
            problem.state = state
            part *= 0.5
            if self.stopped or self.stuck or part < 0.5**self.options.max_halvings:
                self.failure += self._diagnosis()
                return

    def _diagnosis(self) -> str:
        """Return what the last steps say about why there is no way on. Collective."""
        if self.stopped or self._last_change is None:
            return ""
        place = self.problem.place_of_largest(self._last_change)
        shown = ", ".join(f"{x:.4g}" for x in place)
        found = f". Last the displacement changed most at ({shown}) of the undeformed bodies"
        if self._unstable:
            found += ", and the tangent is indefinite even with the contact held: they are unstable"
        return found

    def _equilibrium(self) -> str:
        """Find the displacement for the present part of the load; return why not. Collective."""
        problem, last = self.problem, math.inf
        number, slow = 0, False
        self._unstable = False
        while True:
            number += 1
            before = problem.u.x.array.copy()
            where = f"Newton step {number} with {problem.tangent.fraction:.4g} of the load"
            try:
                solution = self._step()
            except StiffnessError as error:
                self.stuck = number == 1
                return f"{where}: {str(error).rstrip('.')}"
            way = problem.energy_norm(solution.u.x.array - self._start)
            size = max(problem.energy_norm(solution.u.x.array), way) or 1.0  # u may go back to zero
            change = problem.energy_norm(solution.u.x.array - before)
            if number > 1:  # the first one moves all of the bodies
                self._last_change = solution.u.x.array - before
            problem.u.x.array[:] = solution.u.x.array
            # sums may differ between ranks in the last digit, verdicts must not
            correction, residual = problem.comm.bcast(
                (change / size, problem.residual_norm() / size)
            )
            self._count(solution)
            if self.fraction == 0.0 or residual <= self.options.accuracy:
                self.found = solution
            self.steps.append(
                NewtonStep(
                    number=number,
                    fraction=problem.tangent.fraction,
                    correction=correction,
                    residual=residual,
                    contact_residual=solution.residuals[-1],
                    iterations=solution.iterations,
                    products=solution.products,
                    pressed=solution.counts.contact,
                    added=_named(self.level),
                )
            )
            log(problem.comm, "%s: residual %.1e, correction %.1e", where, residual, correction)
            if solution.status is ContactStatus.STOPPED:
                self.stopped = True
                return f"{where} was stopped by the observer"
            if not math.isfinite(residual):
                return f"{where} leads to where forces are NaN or infinite: cells turn inside out"
            if residual <= self.options.accuracy:
                return ""
            was_slow, slow = slow, self.level >= FIRST_SLOW
            if number > 2 and residual > GROWTH * last and not (slow or was_slow):
                return f"{where} diverges: {residual:.1e} is out of balance, after {last:.1e}"
            if not self._may_go_on(number, residual, last):
                return (
                    f"{where} has {residual:.1e} out of balance, after {last:.1e}, and falls too "
                    f"slowly: asked for {self.options.accuracy:.0e}"
                )
            last = residual

    def _progress(self, *, ended: bool = False) -> NewtonProgress:
        """Return how far the steps have come. Not collective."""
        last = self.steps[-1].residual if self.steps else math.inf
        return NewtonProgress(
            len(self.steps) + (not ended), self.problem.tangent.fraction, last, ended
        )

    def _observed(self, iteration: Iteration) -> bool:
        """Show an iteration of a step's contact problem to the user's observer. Collective."""
        self._iteration = replace(iteration, newton=self._progress())
        return self._observe(self._iteration)

    def _may_go_on(self, number: int, residual: float, last: float) -> bool:
        """Return whether there are steps left, or the present rate ends in time. Not collective."""
        most = self.options.max_iterations
        if number < most:
            return True
        rate = residual / last  # 0 after the first step, which says nothing of it
        left = MOST_STEPS * most - number
        return 0.0 < rate < 1.0 and residual * rate**left <= self.options.accuracy

    def _count(self, solution: ContactSolution) -> None:
        """Add what a step took. Not collective."""
        self.krylov_iterations += solution.krylov_iterations
        for name, seconds in solution.timings.items():
            self.timings[name] = self.timings.get(name, 0.0) + seconds

    def _step(self) -> ContactSolution:
        """Solve the contact problem of a step, with as little added to K as goes. Collective.

        Raises:
            StiffnessError: nothing that may be added makes the tangent definite.
        """
        # what is needed once is kept; what slows Newton's method down is given up when it can be
        first = self.level if self.level < FIRST_SLOW else self.level - 1
        for level in range(first, len(ADDED)):
            try:
                self.level = level
                self._unstable |= level >= FIRST_SLOW
                self.problem.factor(*ADDED[level])
                self.problem.options = self.contact.at_least(
                    self.options.accuracy * (WITH_SPRINGS if level > 0 else 1.0)
                )
                return self.problem.solve(observer=self._observed)
            except StiffnessError as error:
                failure = error
        raise failure


def _named(level: int) -> str:
    """Return what was added, for the table."""
    springs, proximal = ADDED[level]
    names = [f"contact {springs:g}"] * (springs > 0.0) + [f"proximal {proximal:g}"] * (proximal > 0)
    return ", ".join(names)
