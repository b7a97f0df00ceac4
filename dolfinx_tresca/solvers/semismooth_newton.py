"""The semismooth Newton method for the laws of contact and friction with a model of A."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.tolerances import (
    FORCING,
    MOST_STEPS,
    PATIENCE,
    PROGRESS,
    ROUGH,
    SHORT_PATIENCE,
)
from dolfinx_tresca.solvers.convergence import NaturalResidual
from dolfinx_tresca.solvers.interior_point import interior_point
from dolfinx_tresca.solvers.problem import DualProblem, Model, Point
from dolfinx_tresca.solvers.products import NodalMaps, ProductStore, WholeModel

#: Product of the step length rho in the active sets (38.12), (38.13) and the diagonal of the model.
#: With the value 1, as for convex problems, each node would take the state that minimises q for
#: fixed multipliers of all other nodes; with a smaller value, states change less often.
RHO_DIAGONAL = 0.2

#: Limit on the number of times that a step is divided by four until it reduces the residual enough.
#: Steps of bodies that hardly anything holds are too long by orders of magnitude. (With halves,
#: pellets in a tube take a third more time.)
MOST_CUTS = 7

#: Softness of the constraints in the first step, times the compliance of the multipliers. The
#: softness is multiplied by `SOFTER` after each step that reduces the residual too little, and
#: divided by it after all other steps. With 1e-10 in place of 1e-4, stones of a pile drift away.
#: With `SOFTER` = 3, piles of stones take a third more steps.
PROXIMAL, SOFTER = 1e-4, 10.0

#: Newton's method ends if the residual is at most `FORCING` times that at the start; where bodies
#: float, or A is known whole, `SOLVED` times that, or, if A is known whole, `PRECISE` times that of
#: the loads. (It goes on there while steps succeed, until the residual is rounding: else pellets in
#: a tube take 12 iterations in place of 8, and a disc spring that is pressed flat and returns takes
#: 64 Newton steps in place of 5. With 1e-3, one of 300 piles ends with STAGNATED. Without
#: `PRECISE`, walls of 490 and 1,104 bricks take 24 and 32 steps to carry their weight, in place of
#: 9 and 16; with 1e-9, forces on a block a millionth below the limit of friction are out of balance
#: by 6e-13.) The model counts as solved then; if A is known whole, at `FORCING` times the start's.
SOLVED, PRECISE = 1e-6, 1e-10

#: Number of points of the interior-point method from which Newton's method may begin, see
#: `interior_guesses`. With one, pile 206 is not solved (`tests/validation/test_random_piles.py`).
GUESSES = 5


@dataclass(frozen=True)
class NewtonPoint(Point):
    """A point with its residual in the equations of `SemismoothNewton`.

    Attributes:
        residual: the residual, as the norm `SemismoothNewton.energy`.
        is_solved: whether the model counts as solved, from `newton_solution` or `solve_model`.
    """

    residual: float
    is_solved: bool = False


class SemismoothNewton:
    """Newton's method for multipliers x and c of the contact problem with a model M of A.

    The equations are those of Alart and Curnier (1991), with the equilibrium of floating bodies:

        x = P_g(x - rho r),  r = M x - b - G c,  G'x + S c = e,

    where P_g projects onto the section of the friction cones at the pressures of x; for Tresca's
    law this is Lambda. The step length rho of each node follows from the diagonal D of M. A step
    takes the face of the active sets (38.12), (38.13) at x - rho r, the end of a gradient step. On
    this face, multipliers of slipping nodes only move along the circles that bound their discs. At
    the solution on the face, they satisfy r + kappa x = 0, kappa = |r| / g, with the bound g. Hence

        (P M P + diag(kappa)) s - P G c = -P r

    is the exact Newton system of the face, with the projector P onto the face. For Tresca's law the
    system is symmetric. The convergence is quadratic once the active sets stay the same
    (docs/theory/algorithms.md). If slip bounds grow with the pressure, the multiplier of a slipping
    node also moves outwards with its pressure: s is replaced by P s + Q s on the left-hand side,
    where Q contains the slope of g (`NodalMaps.on_face`). The slip v is the radial component of -r.
    If g depends on it, the radial component of s solves s = Q s + h (change of v) with h = dg/dv.

    Residuals are energy norms: those of multipliers are multiplied by the root of D, those of a
    constraint divided by the root of the sum of G^2 / D. A step is divided by four until it reduces
    the residual by a tenth of what it promises. If no part of a step does, contact on this face
    holds some bodies only weakly, or not at all: then S is softened for the steps that follow, as
    in the method of Levenberg and Marquardt. After good steps, S is stiffened again. Methods are
    collective, and need no product with A.

    Attributes:
        mean_diagonal: (size,) D, with its mean in each friction disc.
        rho: (size,) step lengths of the active sets.
        softness: number by which the first step softens S, see `step`.
        constraint_scale: (k,) sums of G^2 / D, by which `energy` divides squared residuals of the
            constraints; 1 for a constraint without multipliers.
        load: the norm `energy` of the loads: of rho b, the change of zero multipliers by a gradient
            step, and of e. It is the measure of accuracies that do not depend on a guess.
        rounding: residual that counts as rounding, `ROUNDING` times the load.
        goes_on: whether A is known whole, or bodies float: then steps go on to rounding (`SOLVED`).
    """

    def __init__(self, problem: DualProblem, model: Model) -> None:
        """Compute step lengths, and the scales of softness, residuals and rounding. Collective."""
        self.problem, self.model = problem, model
        self.mean_diagonal = problem.admissible.mean_over_discs(model.model_diagonal)
        self.rho = np.asarray(RHO_DIAGONAL / self.mean_diagonal)
        # `PROXIMAL`, divided by the mean of D over all ranks
        ones = np.ones_like(self.mean_diagonal)
        total = float(problem.inner(ones, self.mean_diagonal))
        size = float(problem.inner(ones, ones))
        self.softness = PROXIMAL * size / total if total > 0.0 else 0.0
        G = problem.constraints.columns
        scale = problem.inner(G * G, 1.0 / self.mean_diagonal)
        self.constraint_scale = np.where(scale > 0.0, scale, 1.0)
        # (`energy` uses the scale of the constraints)
        self.load = self.energy(self.rho * problem.b, problem.constraints.values)
        self.rounding = ROUNDING * self.load
        self.goes_on = isinstance(model, WholeModel) or len(problem.constraints) > 0

    def energy(self, change: Array, unbalanced: Array) -> float:
        """Return the norm [energy^(1/2)] of residuals `change` (size,) and `unbalanced` (k,)."""
        square = float(self.problem.inner(change, self.mean_diagonal * change))
        return float(np.sqrt(square + unbalanced @ (unbalanced / self.constraint_scale)))

    def point(self, x: Array, c: Array, r: Array) -> NewtonPoint:
        """Return the point (x, c, r); its `residual` is that at the projection onto the cones."""
        admissible, rho = self.problem.admissible, self.rho
        projected = admissible.at_point(x, r).project(x)
        gradient = r + self.model.apply(projected - x)
        target = projected - rho * gradient
        section = admissible.at_point(projected, gradient, target).section(projected)
        change = projected - section.project(target)
        unbalanced = self.problem.constraints.residual(projected, c)
        return NewtonPoint(x, c, r, self.energy(change, unbalanced))

    def step(self, point: NewtonPoint, softness: float) -> tuple[Array, Array]:
        """Return the changes of x and c by a whole Newton step from a point.

        The number `softness` is added to S for the change of c only (`softness_with`), as in a
        proximal point method: solutions of the problem remain solutions.
        """
        x, r, constraints = point.x, point.r, self.problem.constraints
        target = x - self.rho * r
        admissible = self.problem.admissible.at_point(x, r, target)
        section = admissible.section(x)
        face = section.face(target)
        # the step begins at the point of the face
        settled = section.on_face(x, face)
        r = r + self.model.apply(settled - x)
        stiffness = section.circle_stiffness(r, face)
        maps = NodalMaps.on_face(admissible, settled, face, self.model.diagonal, stiffness)
        right = -r - admissible.slip_along(face)  # such that L multiplies the change of slip
        S = constraints.softness_with(softness)
        missing = constraints.residual(settled, point.c)
        change, change_c = self.model.solve_on_face(maps, right, constraints.columns, S, missing)
        return settled + change - x, change_c

    def solve(
        self, start: NewtonPoint, tolerance: float, most_steps: int = MOST_STEPS
    ) -> NewtonPoint:
        """Take steps from the start, and return the point with the least residual.

        A point with at most the residual `tolerance` counts as a solution. The method ends

        - at a solution; but if A is known whole or there are constraints, only once a step from it
          makes no progress, or the residual is rounding; or
        - after `PATIENCE` steps without progress, or after `most_steps` steps.

        Of each step, the longest part 4^-n is taken with which the residual falls enough; if there
        is none with n <= `MOST_CUTS`, the part with the least residual is taken.
        """
        point = best = start
        softness, idle = self.softness, 0
        # the residual at which steps end even while they make progress
        least = ROUNDING * start.residual if self.goes_on else tolerance
        # whole steps reach the solution sooner if supports hold the bodies
        whole_steps = 0 if self.goes_on else SHORT_PATIENCE
        for _ in range(most_steps):
            if best.residual <= (tolerance if idle else least) or idle == PATIENCE:
                break
            # a watchdog: from time to time a whole step, even if the residual grows
            is_whole = idle < whole_steps or (idle + 1) % SHORT_PATIENCE == 0
            dx, dc = self.step(point, softness)
            # the step promises the residual that would be left if the face did not change: that of
            # the constraints, which are soft in this step, while all other residuals would vanish
            unbalanced = self.problem.constraints.residual(point.x + dx, point.c + dc)
            promised = self.energy(np.zeros_like(dx), unbalanced)
            # a tenth of the promised decrease, as PROGRESS is 0.9
            wanted = PROGRESS * point.residual + (1.0 - PROGRESS) * promised + self.rounding
            # the end of the longest part with the wanted residual, else that with the least one
            dr = self.model.apply(dx) - self.problem.constraints.columns @ dc
            trials = []
            for cuts in range(1 if is_whole else MOST_CUTS + 1):
                t = 0.25**cuts
                trial = self.point(point.x + t * dx, point.c + t * dc, point.r + t * dr)
                trials.append(trial)
                if trial.residual <= wanted:
                    break
            else:
                trial = min(trials, key=lambda candidate: candidate.residual)
            point = trial
            softness *= SOFTER if point.residual > wanted else 1.0 / SOFTER
            idle = 0 if point.residual < PROGRESS * best.residual else idle + 1
            if point.residual < best.residual:
                best = point
        return best


def newton_solution(problem: DualProblem, model: Model, start: Point) -> NewtonPoint:
    """Return an approximate solution of the contact problem with a model of A. Collective.

    Newton's method begins at the start. Where A is known whole, it begins again at points of the
    interior-point method if the residual stays too large, or all tractions of Coulomb's law vanish.
    """
    newton = SemismoothNewton(problem, model)
    guess = newton.point(start.x, start.c, start.r)
    # the residual at which steps end, and the residual with which the model counts as solved
    relative = SOLVED if newton.goes_on else FORCING
    tolerance = enough = max(relative * guess.residual, newton.rounding)
    if not isinstance(model, WholeModel):
        point = newton.solve(guess, tolerance)
    else:
        # a tenth is enough, since the next iteration has the same model, and goes on
        enough = max(FORCING * guess.residual, newton.rounding)
        tolerance = max(tolerance, min(PRECISE * newton.load, enough))
        # far from the solution, no more steps than the interior-point method takes
        is_far = guess.residual > ROUGH * newton.load
        point = newton.solve(guess, tolerance, 2 * PATIENCE if is_far else MOST_STEPS)
        # zero solves Coulomb's law without loads, and draws steps to itself where friction locks:
        # then a solution from an interior point is taken, even if its residual is larger
        vanishes = problem.inner(point.x, point.x) < ROUGH**2 * problem.inner(start.x, start.x)
        is_lost = vanishes and not problem.admissible.has_given_bounds
        if is_lost or point.residual > (tolerance if is_far else enough):
            for interior in interior_guesses(newton, model, guess):
                end = newton.solve(interior, tolerance)
                accepted = max(point.residual, enough) if is_lost else point.residual
                if end.residual < accepted:
                    point = end
                newest = end if is_lost else point
                if newest.residual <= enough:
                    break
    # the point in the cones to which the residual belongs (`SemismoothNewton.point`)
    x = problem.admissible.at_point(point.x, point.r).project(point.x)
    r = point.r + model.apply(x - point.x)
    return NewtonPoint(x, point.c, r, point.residual, point.residual <= enough)


def interior_guesses(
    newton: SemismoothNewton, model: WholeModel, start: NewtonPoint
) -> Iterator[NewtonPoint]:
    """Yield points of `interior_point`, and zero, from which Newton's method begins. Collective.

    The first point is near a solution of the problem. If slip bounds depend on the pressure, each
    further point is near the solution of Tresca's problem with the bounds at the point before.
    """
    problem, G = newton.problem, newton.problem.constraints.columns
    r_at_zero = start.r - model.apply(start.x) + G @ start.c  # -b, in the model
    x, r = start.x, np.zeros_like(start.r)
    for number in range(1 if problem.admissible.has_given_bounds else GUESSES):
        admissible = problem.admissible.at_point(x, r)
        cones = admissible.section(x) if number > 0 else admissible
        x, c = interior_point(problem, model, cones, r_at_zero, newton.softness)
        x = cones.project(x)
        r = r_at_zero + model.apply(x) - G @ c
        yield newton.point(x, c, r)
    yield newton.point(0.0 * x, start.c, r_at_zero - G @ start.c)


def solve_model(
    problem: DualProblem, start: Point, residual: NaturalResidual, tolerance: float
) -> NewtonPoint:
    """Return an approximate solution of the dual problem with M in place of A. Collective.

    Without a near field, this is `newton_solution`. With a near field D, and known products Y = A
    W, M = Y Y' + (I - Y W') D (I - W Y') contains D where the basic model has a diagonal. The error
    of M is then smaller by an order of magnitude, but there is no formula for the inverse of M on a
    face. Hence D is itself approximated by D~, a low-rank model made of known products with D. Each
    iteration solves the problem for M with D~ in place of D. It then computes a product with D,
    which gives the residual for M and improves D~: one solve with a small matrix, none with K.
    Products with D are kept as long as those with A. Iterations end where the `residual` for M is
    at most `FORCING` times the `tolerance`, where Newton's method fails (else rolling with friction
    takes four times the time), or after `SHORT_PATIENCE`, where a product with A helps as well.
    The model counts as solved unless Newton's method has failed at the point that is returned.
    """
    store = problem.compliance.known_products()
    if not isinstance(store, ProductStore) or store.near is None:
        return newton_solution(problem, store.model(), start)
    # a smaller tolerance costs no product with A, and saves some, since the model is accurate
    tolerance *= FORCING
    G, initial = problem.constraints.columns, residual.norm_at(start)
    best, least = None, float("inf")
    for _ in range(SHORT_PATIENCE):
        point = best if best is not None and least < initial else start
        end = newton_solution(problem, store.model(store.near.model()), point)
        step = end.x - point.x
        if float(problem.inner(step, step)) == 0.0:
            break
        # M times the step: with its part v that is A-orthogonal to W, A (step - v) + (I - Y W') D v
        v, product = store.split(step)
        near_product = store.apply_near(v)
        store.near.add(v, near_product)
        product = product + near_product - store.Y @ problem.inner(store.W, near_product)
        end = replace(end, r=point.r + (product - G @ (end.c - point.c)))
        if (reached := residual.norm_at(end)) < least:
            best, least = end, reached
        if least <= tolerance or not end.is_solved:
            break
    # without a step, the diagonal is the base; a product with A then checks the step
    return best or newton_solution(problem, store.model(), start)
