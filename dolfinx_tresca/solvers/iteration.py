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
from dolfinx_tresca.solvers.problem import DualProblem, DualSolution, FrictionDeficit, Point
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

    def __init__(self, problem: DualProblem) -> None:
        """Begin at zero, where no product is needed. Not collective."""
        self._problem = problem
        self._is_exact = problem.compliance.exact
        self.finest, self.learned = 0.0, True
        # the requested error of a gradient is the part `_part` of the last step's `_length`; the
        # solver for K does not reach less than `_least`
        self._part, self._length, self._least = FORCING, 0.0, 0.0
        self.return_to_zero()

    def return_to_zero(self) -> None:
        """Set the point to zero, where the gradient is -b. Not collective."""
        problem = self._problem
        self.x, self.r = np.zeros_like(problem.b), -problem.b
        self.c: Array = np.zeros(len(problem.constraints))
        self.error = problem.b_error

    @property
    def store(self) -> ProductStore | WholeModel:
        """The known products with A, to which each step adds its product. Collective."""
        return self._problem.compliance.known_products()

    @property
    def point(self) -> Point:
        """The point with the gradient A x - b - G c, as the natural residual needs it."""
        return Point(self.x, self.c, self.r - self._problem.constraints.columns @ self.c)

    def move(self, direction: Array, c: Array) -> None:
        """Take a step, or the part of it with the least q. Collective.

        The product of A with the whole step, the `direction` (size,), improves the model of A. The
        multipliers of the constraints become c (k,).
        """
        self.c = c
        problem, store = self._problem, self.store
        if self._is_exact:
            # known products give A times a part of the step; A times what is left is computed, and
            # kept (the product with the whole step, less that part, has rounding errors that grow)
            pairs_before = len(store)
            new, product = store.split(direction)
            if float(problem.inner(new, new)) > 0.0:
                new_product = problem.compliance.apply(new)
                store.add(new, new_product)
                product = product + new_product
            self.learned = len(store) != pairs_before
            error = self.error
        elif float(problem.inner(direction, direction)) == 0.0:
            return
        else:
            image = store.model().apply(direction)
            self._length = float(np.sqrt(float(problem.inner(direction, image))))
            accuracy = max(self._part * self._length, self.finest)
            r, error = self._gradient(self.x + direction, accuracy)
            # the difference of gradients: errors of gradients do not accumulate over the steps
            product = r - self.r
            self.learned = store.add(direction, product, error + self.error)
            if self.learned:
                self._part = FORCING
        # the t <= 1 with the least t d'r + t^2 / 2 d'A d, which is the change of q by the step t d;
        # t = 1 if q need not fall (see `ModelNewton`), or falls by rounding only
        t = 1.0
        if problem.admissible.has_given_bounds and len(problem.constraints) == 0:
            slope = float(problem.inner(direction, self.r))
            curvature = float(problem.inner(direction, product))
            rounding = PRODUCT_ROUNDING * norm(problem, self.x) * norm(problem, self.r)
            is_rounding = -slope <= rounding or curvature <= 0.0
            if not is_rounding:
                t = min(-slope / curvature, 1.0)
        self.x, self.r = self.x + t * direction, self.r + t * product
        self.error = (1.0 - t) * self.error + t * error

    def set_point(self, x: Array) -> None:
        """Set the point to initial multipliers x (size,), and compute the gradient. Collective.

        No product is needed if known ones determine it, as where a former solve has ended at x.
        """
        problem, store, b = self._problem, self.store, self._problem.b
        product, error = store.product(x)
        relative = FULL_ACCURACY if self._is_exact else ROUGH
        energy_norm = float(np.sqrt(float(problem.inner(x, store.model().apply(x)))))
        # with an accuracy below the error of b, products with tiny multipliers would be this error
        wanted = max(relative * energy_norm, self.finest, problem.b_error)
        self.x, self.r, self.error = x, product - b, error + problem.b_error
        if self.error > wanted:
            self.r, self.error = problem.gradient(x, wanted)
            store.add(x, self.r + b, self.error + problem.b_error)

    def _gradient(self, x: Array, accuracy: float) -> tuple[Array, float]:
        """Return A x - b and its error; remember an error that does not get less. Collective."""
        r, error = self._problem.gradient(x, accuracy)
        if error > SLACK * accuracy:
            self._least = max(self._least, error)
        return r, error

    def increase_accuracy(self) -> None:
        """Make gradient and products, or the model of a whole A, more accurate. Collective."""
        if isinstance(self.store, WholeModel):
            self.store.reduce_shift()
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
        compliance, b = self.problem.compliance, self.problem.b
        store = compliance.known_products()
        if isinstance(store, ProductStore):
            store.drop_inaccurate_pairs()
            # an estimate of sigma_max needs a product: that of b with the near field, else with A
            if store.largest_eigenvalue_estimate == 0.0:
                if store.near is not None:
                    store.near.add(b, store.apply_near(b))
                else:
                    store.add(b, compliance.apply(b))
        target = self.choose_start(start)
        iterate, residual = self.iterate, self.residual
        status = self.check_progress(target or iterate.point)
        while status is None:
            if target is None:
                target = self.target()
            iterate.move(target.x - iterate.x, target.c)
            rho = self.options.step_factor / (iterate.store.largest_eigenvalue_estimate or 1.0)
            if rho < residual.rho:  # sigma_max was underestimated
                residual.set_rho(rho)
            progress = PROGRESS * self.history.residual_norms[-1]
            if not (iterate.learned or residual.norm_at(iterate.point) < progress):
                iterate.increase_accuracy()
            status = self.check_progress(target)
            target = None  # the next step needs a new one, as the model has changed
        solution = self.history.solution(iterate.point, status, iterate.error)
        return dataclasses.replace(solution, deficit=self.deficit)

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
        # (1 takes the place of an estimate that is zero)
        rho = self.options.step_factor / (iterate.store.largest_eigenvalue_estimate or 1.0)
        self.residual = residual = NaturalResidual(problem, rho)
        if residual.zero_is_undecided(iterate.error):
            problem.refine_b()
            iterate.return_to_zero()
            self.residual = residual = NaturalResidual(problem, rho, iterate.error)
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
                residual.least_scale = norm(problem, iterate.r + problem.b)  # |A x|
                residual.scale = max(residual.scale, residual.least_scale)
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
        x, r, rho = self.iterate.x, self.iterate.r, self.residual.rho
        y = x - rho * r
        section = self.problem.section_at(x, r)
        z = balance(self.problem.constraints, section, y, 1.0 / rho).shift
        return np.asarray(z / rho)

    def check_progress(self, target: Point) -> ContactStatus | None:
        """Return the status with which the iteration ends at the present point, or None.

        Before an iteration ends without a solution, or if it is slow, A is completed as a matrix.
        If it ends without one and slip bounds depend on the pressure, `deficit` is set if friction
        is too weak at the pressures of `target`, the newest solution of the model. Collective.
        """
        iterate, history, residual = self.iterate, self.history, self.residual
        if not self.problem.compliance.exact:
            # a more accurate gradient is worth its price where the iterate may be the last one
            _, _, may_end = history.reached(iterate.point, 0.0, residual.norm_at(iterate.point))
            accuracy = history.tolerable_error(iterate.point) if may_end else np.inf
            iterate.refine(accuracy)
        if (status := history.check_convergence(iterate.point, iterate.error)) is not None:
            return status
        # nothing moves and nothing is learned, or there is no progress for long
        norms = history.residual_norms[-2:]
        is_same = abs(np.diff(norms)).sum() <= ROUGH * norms[-1]
        is_idle = history.is_idle(PATIENCE, PROGRESS, self.completed_at)
        stalls = is_idle or (is_same and not iterate.learned)
        may_be_rounding = norms[-1] <= EXHAUSTED * max(residual.scale, residual.terms)
        is_slow = history.is_idle(SHORT_PATIENCE, 0.5, self.completed_at) and not may_be_rounding
        model_fails = self.misses >= MISSES
        if (stalls or is_slow or model_fails) and self.complete_products():
            return None
        if not stalls and not (model_fails and isinstance(self.iterate.store, WholeModel)):
            return None
        # without a solution: find the cause, where bounds depend on the pressure
        if self.problem.admissible.has_given_bounds:
            return ContactStatus.STAGNATED
        constraints = self.problem.constraints
        section = self.problem.section_at(target.x, target.r)
        if len(constraints) > 0:
            balanced = balance(constraints, section)
            if not balanced.satisfied:
                # the shift has grown along a rigid motion, with a work e'z of the loads above the
                # sum of g |G z|, the work of friction
                motion = balanced.shift / np.linalg.norm(balanced.shift)
                own_friction = section.dissipation(constraints.columns @ motion)  # on this rank
                friction = float(self.problem.reductions.total(np.array(own_friction)))
                load = float(constraints.values @ motion)
                self.deficit = FrictionDeficit(motion, load, friction)
                return ContactStatus.NO_FIXED_POINT
        return ContactStatus.STAGNATED if may_be_rounding else ContactStatus.NO_FIXED_POINT

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
