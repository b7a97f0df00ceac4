"""The default method: Newton's method on a model of A that every product improves."""

from __future__ import annotations

import dataclasses

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.tolerances import (
    FORCING,
    FULL_ACCURACY,
    PATIENCE,
    PROGRESS,
    ROUGH,
    SHORT_PATIENCE,
    SLACK,
)
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers import paper
from dolfinx_tresca.solvers.constraints import balance, norm
from dolfinx_tresca.solvers.convergence import EXHAUSTED, History, NaturalResidual, Observe
from dolfinx_tresca.solvers.problem import (
    DualProblem,
    DualSolution,
    FrictionDeficit,
    KnownProducts,
    Point,
)
from dolfinx_tresca.solvers.products import PRODUCT_ROUNDING, ProductStore, WholeModel
from dolfinx_tresca.solvers.semismooth_newton import NewtonPoint, solve_model
from dolfinx_tresca.status import ContactStatus

#: A is computed as a matrix, unless it is too large (`ContactCompliance.complete_products`), if
#: Newton's method does not solve the model in so many consecutive iterations, if the residual is
#: not halved in `SHORT_PATIENCE` iterations, or before `ModelNewton` ends without a solution.
MISSES = 2


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Solve a problem of Tresca or Coulomb friction by the method of the options. Collective.

    The default method is `ModelNewton`. For Coulomb's law, it finds multipliers x that solve
    Tresca's problem with the slip bounds at the pressures of x (Haslinger 1983).

    Raises:
        InputError: a method of the paper was chosen for slip bounds that depend on the pressure.
    """
    if options.method in paper.ALGORITHMS:
        if problem.admissible.has_given_bounds:
            return paper.ALGORITHMS[options.method](paper.Run(problem, start, options, observe))
        raise InputError(
            f"method={options.method!r} needs slip bounds that are given: here they depend on the "
            "pressure. Leave out `method`, or give the friction as Tresca, Bonded or Frictionless."
        )
    return ModelNewton(problem, options, observe).run(start)


class Iterate:
    """The present point of `ModelNewton` with its gradient; each step's product improves the model.

    With a direct solver for K, products are exact to rounding. With an iterative one, the error of
    the gradient in the norm sqrt(e'A^-1 e) is limited to a part of the energy norm of the steps; a
    product is then the difference of two gradients, and contains the errors of both.

    Attributes:
        x: (size,) multipliers of the point.
        c: (k,) multipliers of the constraints.
        r: (size,) A x - b, the gradient at the point, without the term -G c of constraints.
        error: estimated error of r in the norm sqrt(e'A^-1 e); 0 for exact products.
        finest: lower bound on the errors that are requested of gradients.
        learned: whether the newest step has changed the model of A, or accuracies; True at first.
    """

    x: Array
    c: Array
    r: Array
    error: float

    def __init__(self, problem: DualProblem) -> None:
        """Begin at zero, where no product is needed. Not collective."""
        self._problem, self.finest, self.learned = problem, 0.0, True
        self._is_exact = problem.compliance.exact
        # the requested error of a gradient is the part `_part` of the last step's `_length`; the
        # solver for K does not reach less than `_least`
        self._part, self._length, self._least = FORCING, 0.0, 0.0
        self.return_to_zero()

    def return_to_zero(self) -> None:
        """Set the point to zero, where the gradient is -b. Not collective."""
        b = self._problem.b
        self.x, self.c, self.r = np.zeros_like(b), np.zeros(len(self._problem.constraints)), -b
        self.error = self._problem.b_error

    @property
    def store(self) -> KnownProducts:
        """The known products with A, to which each step adds its product. Collective."""
        return self._problem.compliance.known_products()

    @property
    def point(self) -> Point:
        """The point with the gradient A x - b - G c, as the natural residual needs it."""
        return Point(self.x, self.c, self.r - self._problem.constraints.columns @ self.c)

    def move(self, direction: Array, c: Array) -> None:
        """Take a step, or the part of it with the least q (`_part_to_take`). Collective.

        The product of A with the whole step, the `direction` (size,), improves the model of A. The
        multipliers of the constraints become c (k,).
        """
        self.c = c
        if self._is_exact:
            product, error = self._new_product(direction), self.error
        elif float(self._problem.inner(direction, direction)) == 0.0:
            return
        else:
            self._length = self._energy_norm(direction)
            accuracy = max(self._part * self._length, self.finest)
            r, error = self._gradient(self.x + direction, accuracy)
            # the difference of gradients: errors of gradients do not accumulate over the steps
            product = r - self.r
            self.learned = self.store.add(direction, product, error + self.error)
            self._part = FORCING if self.learned else self._part
        taken = self._part_to_take(direction, product)
        self.x, self.r = self.x + taken * direction, self.r + taken * product
        self.error = (1.0 - taken) * self.error + taken * error

    def _new_product(self, direction: Array) -> Array:
        """Return A times a step (size,), exact to rounding; set `learned`. Collective.

        Known products give A times a part of the step; A times what is left is computed, and kept.
        """
        before, (new, product) = len(self.store), self.store.split(direction)
        # (the product with the whole step, less the known part, has rounding errors that grow)
        if float(self._problem.inner(new, new)) > 0.0:
            added = self._problem.compliance.apply(new)
            self.store.add(new, added)
            product = product + added
        self.learned = len(self.store) != before
        return product

    def _part_to_take(self, direction: Array, product: Array) -> float:
        """Return the t <= 1 for which t d'r + t^2 / 2 d'A d, the change of q, is least. Collective.

        A d is the `product`; t is 1 if q need not fall (`ModelNewton`) or falls by rounding only.
        """
        problem = self._problem
        if not problem.admissible.has_given_bounds or len(problem.constraints) > 0:
            return 1.0
        slope = float(problem.inner(direction, self.r))
        curvature = float(problem.inner(direction, product))
        rounding = PRODUCT_ROUNDING * norm(problem, self.x) * norm(problem, self.r)
        if -slope <= rounding or curvature <= 0.0:
            return 1.0
        return min(-slope / curvature, 1.0)

    def set_point(self, x: Array) -> None:
        """Set the point to initial multipliers x (size,), and compute the gradient. Collective.

        No product is needed if known ones determine it, as where a former solve has ended at x.
        """
        problem, b = self._problem, self._problem.b
        product, error = self.store.product(x)
        relative = FULL_ACCURACY if self._is_exact else ROUGH
        # with an accuracy below the error of b, products with tiny multipliers would be this error
        wanted = max(relative * self._energy_norm(x), self.finest, problem.b_error)
        self.x, self.r, self.error = x, product - b, error + problem.b_error
        if self.error > wanted:
            self.r, self.error = problem.gradient(x, wanted)
            self.store.add(x, self.r + b, self.error + problem.b_error)

    def _energy_norm(self, x: Array) -> float:
        """Return sqrt(x'M x) for x (size,), with the model M of A. Collective."""
        return float(np.sqrt(float(self._problem.inner(x, self.store.model().apply(x)))))

    def _gradient(self, x: Array, accuracy: float) -> tuple[Array, float]:
        """Return A x - b and its error; remember an error that does not get less. Collective."""
        r, error = self._problem.gradient(x, accuracy)
        if error > SLACK * accuracy:
            self._least = max(self._least, error)
        return r, error

    def increase_accuracy(self) -> None:
        """Make gradient and products, or the model of a whole A, more accurate. Collective."""
        store = self.store
        if isinstance(store, WholeModel):
            store.reduce_shift()
        elif not self._is_exact and self._part >= FULL_ACCURACY:
            self._part *= FORCING
            self.finest *= FORCING
            self.learned = True
            self.refine(max(self._part * self._length, self.finest))

    def refine(self, accuracy: float) -> None:
        """Compute r again if its error exceeds `accuracy` and can be reduced. Collective."""
        if self.error > max(accuracy, SLACK * self._least):
            self.r, self.error = self._gradient(self.x, accuracy)


class ModelNewton:
    """The default method, as the state of one solve.

    Each iteration solves the problem with the model M of A, without products (`solve_model`), and
    takes the step d to its solution. The product A d is computed, and M is updated with (d, A d).
    With constraints, `choose_start` has already solved the model of the first iteration.

    For Tresca's law and bodies held by supports, the part of the step with the least q is taken, so
    that q decreases in each step. Otherwise no quantity is guaranteed to decrease, and the whole
    step is taken.

    Attributes:
        iterate: the present point; set, as are `residual` and `history`, by `choose_start`.
        residual: the natural residual of this solve.
        history: the residuals of all iterates, and the criteria of convergence.
        misses: number of consecutive iterations in which Newton's method did not solve the model.
        deficit: motion that friction was found too weak to stop, without a solution; else None.
        completed_at: number of iterates when A was completed as a matrix; 0 before.
    """

    deficit: FrictionDeficit | None = None

    def __init__(self, problem: DualProblem, options: SolverOptions, observe: Observe) -> None:
        """Keep the arguments; `run` solves. Not collective."""
        self.problem, self.options, self.observe = problem, options, observe
        self.misses, self.completed_at = 0, 0

    def run(self, start: Array) -> DualSolution:
        """Iterate until a status ends the iteration. Collective."""
        self.compute_first_products()
        solved_at_start = target = self.choose_start(start)
        iterate = self.iterate
        while (status := self.check_progress(target or iterate.point)) is None:
            target, solved_at_start = solved_at_start or self.target(), None
            iterate.move(target.x - iterate.x, target.c)
            if (rho := self.proposed_rho()) < self.residual.rho:  # sigma_max was underestimated
                self.residual.set_rho(rho)
            progress = PROGRESS * self.history.residual_norms[-1]
            if not (iterate.learned or self.residual.norm_at(iterate.point) < progress):
                iterate.increase_accuracy()
        solution = self.history.solution(iterate.point, status, iterate.error)
        return dataclasses.replace(solution, deficit=self.deficit)

    def compute_first_products(self) -> None:
        """Drop inaccurate products; if none is known, compute one, to estimate sigma_max of A.

        It is the product of b with the near field, if there is one, else with A. Collective.
        """
        store, b = self.problem.compliance.known_products(), self.problem.b
        if isinstance(store, ProductStore):
            store.drop_inaccurate_pairs()
            if store.largest_eigenvalue_estimate == 0.0 and store.near is not None:
                store.near.add(b, store.apply_near(b))
            elif store.largest_eigenvalue_estimate == 0.0:
                store.add(b, self.problem.compliance.apply(b))

    def choose_start(self, start: Array) -> NewtonPoint | None:
        """Set `iterate`, `residual`, `history`; return what `find_constraint_multipliers` returns.

        The iterate is the start, moved into equilibrium, or zero if the residual is smaller there.
        A load step with bounds that depend on the pressure never begins at zero: of several fixed
        points, a process continues with the nearest. For example, friction keeps a wedge in place
        after the force that pushed it in is removed; zero tractions obey the law, too. Collective.
        """
        problem, constraints = self.problem, self.problem.constraints
        # the scale of residuals, at zero; b is computed again if its error might hide a pressure
        self.iterate = iterate = Iterate(problem)
        self.residual = residual = NaturalResidual(problem, self.proposed_rho())
        if residual.zero_is_undecided(iterate.error):
            problem.refine_b()
            iterate.return_to_zero()
            self.residual = residual = NaturalResidual(problem, residual.rho, iterate.error)
        self.history = History(problem, self.options, self.observe, residual)
        # the start moves to the nearest feasible multipliers that balance the loads e; soft springs
        # keep the forces S c that they have at the start
        start, carried = problem.admissible.project(start), constraints
        if constraints.softness.count_nonzero() > 0:
            iterate.set_point(start)
            e = constraints.values - constraints.softness @ self.constraint_guess()
            carried = dataclasses.replace(constraints, values=e)
        if len(constraints) > 0:
            shift = balance(carried, problem.admissible, start, 1.0 / residual.rho).shift
            start = problem.admissible.project(start + constraints.columns @ shift)
        iterate.set_point(start)
        target = self.find_constraint_multipliers()
        if self.options.rtol:  # gradients need not be more accurate than the requested residual
            iterate.finest = FORCING * self.history.residual_error
        # a start whose residual is larger than that of zero
        if residual.norm_at(iterate.point) > residual.scale:
            if problem.is_load_step and not problem.admissible.has_given_bounds:
                residual.raise_scale(iterate.r + problem.b)  # the scale is at least |A x|
            else:
                iterate.return_to_zero()
                residual.set_constraint_multipliers(iterate.c)
                target = self.find_constraint_multipliers()
        return target

    def find_constraint_multipliers(self) -> NewtonPoint | None:
        """Set the multipliers c of the constraints at the present point from a solve of the model.

        They enter the gradient A x - b - G c at the point, and that at zero, from which the scale
        of residuals follows. For floating bodies, c are rigid motions. The result is the solution
        of the model; None without constraints, or at a point zero that is a solution. Collective.
        """
        iterate, constraints = self.iterate, self.problem.constraints
        is_at_rest = self.residual.zero_is_solution and norm(self.problem, iterate.x) == 0.0
        if len(constraints) == 0 or is_at_rest:
            return None
        iterate.c = self.constraint_guess()
        target = self.target()
        iterate.c = target.c
        self.residual.set_constraint_multipliers(iterate.c)
        return target

    def constraint_guess(self) -> Array:
        """Return c (k,) such that a gradient projection step satisfies the constraints. Collective.

        The step leads to P(x - rho (r - G c)) = P(y + G z), with y = x - rho r and z = rho c.
        """
        problem, x, r, rho = self.problem, self.iterate.x, self.iterate.r, self.residual.rho
        y, section = x - rho * r, problem.section_at(x, r)
        return np.asarray(balance(problem.constraints, section, y, 1.0 / rho).shift / rho)

    def proposed_rho(self) -> float:
        """Return rho of the natural residual from the estimate of sigma_max, or 1 for sigma_max."""
        return self.options.step_factor / (self.iterate.store.largest_eigenvalue_estimate or 1.0)

    def check_progress(self, target: Point) -> ContactStatus | None:
        """Return the status with which the iteration ends at the present point, or None.

        Before an iteration ends without a solution, or if it is slow, A is completed as a matrix.
        If it ends without one and slip bounds depend on the pressure, `deficit` is set if friction
        is too weak at the pressures of `target`, the newest solution of the model. Collective.
        """
        iterate, history, residual = self.iterate, self.history, self.residual
        if not self.problem.compliance.exact:
            # a more accurate gradient is worth its price where the iterate may be the last one
            *_, may_end = history.reached(iterate.point, 0.0, residual.norm_at(iterate.point))
            iterate.refine(history.tolerable_error(iterate.point) if may_end else np.inf)
        if (status := history.check_convergence(iterate.point, iterate.error)) is not None:
            return status
        # nothing moves and nothing is learned, or there is no progress for long
        norms = history.residual_norms[-2:]
        is_same = abs(np.diff(norms)).sum() <= ROUGH * norms[-1]
        stalls = (is_same and not iterate.learned) or history.is_idle(
            PATIENCE, PROGRESS, self.completed_at
        )
        may_be_rounding = norms[-1] <= EXHAUSTED * max(residual.scale, residual.terms)
        is_slow = history.is_idle(SHORT_PATIENCE, 0.5, self.completed_at) and not may_be_rounding
        model_fails = self.misses >= MISSES
        if (stalls or is_slow or model_fails) and self.complete_products():
            return None
        if not stalls and not (model_fails and isinstance(self.iterate.store, WholeModel)):
            return None
        # without a solution: find the cause, where bounds depend on the pressure
        if not self.problem.admissible.has_given_bounds:
            self.deficit = friction_deficit(self.problem, target)
            if self.deficit is not None or not may_be_rounding:
                return ContactStatus.NO_FIXED_POINT
        return ContactStatus.STAGNATED

    def complete_products(self) -> bool:
        """Compute A unless it is known or too large; return whether it was computed. Collective."""
        is_known = isinstance(self.iterate.store, WholeModel)
        if is_known or not self.problem.compliance.complete_products():
            return False
        self.misses, self.completed_at = 0, len(self.history.residuals)
        self.iterate.learned = True
        return True

    def target(self) -> NewtonPoint:
        """Return an approximate solution with the model for A, and count `misses`. Collective."""
        tolerance = self.options.r_tol * self.residual.norm_at(self.iterate.point)
        target = solve_model(self.problem, self.iterate.point, self.residual, tolerance)
        self.misses = 0 if target.is_solved else self.misses + 1
        return target


def friction_deficit(problem: DualProblem, point: Point) -> FrictionDeficit | None:
    """Return the rigid motion that friction is too weak to stop, for an error message. Collective.

    The slip bounds g are those of the point. The result is None if no body floats, or if some
    multipliers with these bounds satisfy the constraints. Otherwise the shift z of `balance` grows
    along a rigid motion whose work of loads e'z exceeds the sum of g |G z|, the work of friction.
    """
    constraints, section = problem.constraints, problem.section_at(point.x, point.r)
    if len(constraints) == 0:
        return None
    balanced = balance(constraints, section)
    if balanced.satisfied:
        return None
    motion = balanced.shift / np.linalg.norm(balanced.shift)
    friction = problem.reductions.total(np.array(section.dissipation(constraints.columns @ motion)))
    return FrictionDeficit(motion, float(constraints.values @ motion), float(friction))
