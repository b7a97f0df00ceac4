"""The semismooth Newton method for the laws of contact and friction with a model of A."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import diags_array, eye_array

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.tolerances import FORCING, MOST_STEPS, PATIENCE, PROGRESS, SHORT_PATIENCE
from dolfinx_tresca.solvers.convergence import NaturalResidual
from dolfinx_tresca.solvers.problem import DualProblem, Model, Point
from dolfinx_tresca.solvers.products import NodalMaps, ProductStore, WholeModel

#: Product of the step length rho in the active sets (38.12), (38.13) and the diagonal D of the
#: model. With the value 1, as for convex problems, each node would take the state that minimises q
#: for fixed multipliers of the other nodes; with a smaller value, nodes change their states less
#: often.
RHO_DIAGONAL = 0.2

#: Limits on the number of halvings of a step that does not reduce the residual. A step of a body
#: that hardly anything holds is too long by orders of magnitude: with 6 halvings, and other guesses
#: after each run that misses its tolerance, a wall of 2,046 bricks takes six times the time. From
#: softer starts there are fewer, since steps that increase the residual lead away from points at
#: which the method fails: with 8 or more, pile 28 (`tests/validation/test_random_piles.py`) is not
#: solved.
MOST_HALVINGS, FEWER_HALVINGS = 14, 6

#: Softness of the constraints in the first step, times the compliance of the multipliers. The
#: softness is multiplied by `SOFTER` after each step that reduces the residual too little, and
#: divided by it after each other step. With 1e-10 in place of 1e-4, a wall of 1,104 bricks is not
#: solved. With `SOFTER` = 10, piles of stones take 15 % fewer steps, but a wall of 2,046 bricks
#: takes more than 200 steps in place of 127.
PROXIMAL, SOFTER = 1e-4, 3.0

#: Newton's method has solved the model if the residual is at most this part of the residual at the
#: start. (Where A is known whole, or bodies float, it goes on while steps succeed, until the
#: residual is rounding: else pellets in a tube take 12 iterations in place of 8. With 0.1 and no
#: further steps, a disc spring that is pressed flat and returns takes 64 Newton steps in place of
#: 5, since the contact problems are solved by other tractions.)
SOLVED = 1e-6

#: Factors on `PROXIMAL` in runs of Newton's method from other initial guesses: zero (the smaller
#: factor), solutions of convex problems (`ConvexNewton`, the factors in turn), and then those of
#: Tresca problems (the smaller factor), `GUESSES` rounds of each. With factors of 1 and 10,
#: standing piles of stones take twice the steps, and pile 28 is not solved
#: (`tests/validation/test_random_piles.py`); with 100 in the first run, too, a wall of 52 bricks
#: takes 1.3 times the steps. Without zero, two strips that stick along their joint are not solved;
#: without Tresca problems, a sheet whose bounds of friction reach their limit at a tenth of the
#: largest pressure.
SOFTER_STARTS, GUESSES = (1e2, 1e3), 4

#: Softness of the layers (`WholeModel.softened`) on the path to another initial guess. In the first
#: one, nodes hardly feel each other, and Newton's method finds their states in a few steps; each
#: further one changes the states of a few nodes. A slender sheet on a die has 71 nodes that
#: overlap at the start, and two that carry it in the end; from zero, no step reduces the residual.
LAYERS = tuple(10.0**-k for k in range(-1, 6))


@dataclass(frozen=True)
class NewtonPoint(Point):
    """A point with the residual of the equations.

    Attributes:
        residual: residual as an energy.
        is_solved: whether Newton's method has solved the equations.
    """

    residual: float
    is_solved: bool = False


class SemismoothNewton:
    """Newton's method for multipliers x and c of the contact problem with a model M of A.

    The equations are those of Alart and Curnier (1991), with the equilibrium of floating bodies:

        x = P_g(x - rho r),  r = M x - b - G c,  G'x + S c = e,

    where P_g projects onto the section of the friction cones at the pressures of x; for Tresca's
    law this is Lambda. The step length rho of each node follows from the diagonal D of M. A step
    takes the active sets (38.12), (38.13) of the point that a gradient step from x reaches. On this
    face, the multipliers of slipping nodes only move along the circles that bound their friction
    discs. At the solution on the face, slipping nodes satisfy r + kappa x = 0 with kappa = |r| / g,
    where g is the slip bound. Hence

        (P M P + diag(kappa)) s - P G c = -P r

    is the exact Newton system of the face, with the projector P onto the face. For Tresca's law the
    system is symmetric. The convergence is quadratic once the active sets no longer change
    (docs/theory/algorithms.md). If slip bounds grow with the pressure, the multiplier of a slipping
    node also moves outwards with its pressure: s is replaced by P s + Q s on the left-hand side,
    where Q contains the slope of g. If g also depends on the slip v, which is the component of -r
    along the radius of the disc, the radial component of s solves s = Q s + h (change of v) with
    the slope h = dg/dv.

    Residuals are energies: those of multipliers are weighted by the root of D, those of a
    constraint by its compliance, the sum of G^2 / D. A step is halved until it reduces the residual
    by a tenth of what it promises. If no part of a step does, contact on this face holds some
    bodies only weakly, or not at all: then S is softened for the steps that follow, as in the
    method of Levenberg and Marquardt. After good steps, S is stiffened again. Soft constraints
    promise little; a body that nothing holds on this face moves until it touches others, by steps
    that grow while they keep their promises.

    Methods are collective, and need no product with A.
    """

    def __init__(self, problem: DualProblem, model: Model) -> None:
        """Prepare steps."""
        self.problem, self.model = problem, model
        self.size = problem.admissible.mean_over_discs(model.size)
        self.rho = np.asarray(RHO_DIAGONAL / self.size)
        ones, G = np.ones_like(self.size), problem.constraints.columns
        sums = [float(problem.inner(ones, values)) for values in (self.size, ones)]
        self.softness = PROXIMAL * sums[1] / sums[0] if sums[0] > 0.0 else 0.0
        compliance = problem.inner(G * G, 1.0 / self.size)
        self.compliance = np.where(compliance > 0.0, compliance, 1.0)
        self.rounding = ROUNDING * self.energy(self.rho * problem.b, problem.constraints.values)

    def energy(self, change: Array, unbalanced: Array) -> float:
        """Return the residual of all equations, from those of multipliers and of constraints."""
        square = float(self.problem.inner(change, self.size * change))
        return float(np.sqrt(square + unbalanced @ (unbalanced / self.compliance)))

    def point(self, x: Array, c: Array, r: Array) -> NewtonPoint:
        """Return a point with the residual of its projection onto the friction cones."""
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

        The number `softness` is added to S for the change of c only, as in a proximal point method:
        solutions of the problem remain solutions.
        """
        constraints = self.problem.constraints
        settled, maps, right = self.equations(point)
        change, change_c = self.model.solve_between(
            maps,
            right,
            constraints.columns,
            constraints.softness_with(softness),
            constraints.residual(settled, point.c),
        )
        return settled + change - point.x, change_c

    def equations(self, point: NewtonPoint) -> tuple[Array, NodalMaps, Array]:
        """Return the multipliers from which a step begins, its maps, and its right-hand side."""
        x, r = point.x, point.r
        target = x - self.rho * r
        admissible = self.problem.admissible.at_point(x, r, target)
        section = admissible.section(x)
        face = section.face(target)
        settled = section.on_face(x, face)
        r = r + self.model.apply(settled - x)
        diagonal, stiffness = self.model.diagonal, section.circle_stiffness(r, face)
        maps = NodalMaps.on_face(admissible, settled, face, diagonal, stiffness)
        return settled, maps, -r - admissible.slip_along(face)

    def solve(self, start: NewtonPoint, tolerance: float, softer: float = 1.0) -> NewtonPoint:
        """Return the point with the least residual.

        The method ends

        - once the residual is rounding (to the tolerance, with a model that the next product
          improves and without constraints, which are to hold to rounding),
        - once the residual is below the tolerance, and a step has made no progress, or
        - after `PATIENCE` steps without progress.

        `newton_solution` sets `is_solved` of the result.

        The tolerance is the residual of a point that solves the equations. The softness in the
        first step is multiplied by `softer`; if this is not 1, steps are halved `FEWER_HALVINGS`
        times at most.
        """
        point = best = start
        softness, idle = softer * self.softness, 0
        most_halvings = MOST_HALVINGS if softer == 1.0 else FEWER_HALVINGS
        goes_on = isinstance(self.model, WholeModel) or len(self.problem.constraints) > 0
        least = ROUNDING * start.residual if goes_on else tolerance
        for _ in range(MOST_STEPS):
            if best.residual <= (tolerance if idle else least) or idle == PATIENCE:
                break
            # a watchdog: from time to time a whole step, even if the residual grows
            halvings = 0 if (idle + 1) % SHORT_PATIENCE == 0 else most_halvings
            dx, dc = self.step(point, softness)
            # if the face did not change, constraints that are soft in this step would keep a
            # residual, and all other residuals would vanish: this is what the step promises
            unbalanced = self.problem.constraints.residual(point.x + dx, point.c + dc)
            promised = self.energy(np.zeros_like(dx), unbalanced)
            wanted = PROGRESS * point.residual + (1.0 - PROGRESS) * promised + self.rounding
            point = self._part_of_step(point, dx, dc, wanted, halvings)
            softness *= SOFTER if point.residual > wanted else 1.0 / SOFTER
            idle = 0 if point.residual < PROGRESS * best.residual else idle + 1
            best = min(best, point, key=lambda candidate: candidate.residual)
        return best

    def _part_of_step(
        self, point: NewtonPoint, dx: Array, dc: Array, wanted: float, most_halvings: int
    ) -> NewtonPoint:
        """Return the end of the longest part 2^-n of a step whose residual is small enough.

        If there is none, the end with the least residual is returned.
        """
        dr = self.model.apply(dx) - self.problem.constraints.columns @ dc
        trials = []
        for halvings in range(most_halvings + 1):
            t = 0.5**halvings
            trials.append(self.point(point.x + t * dx, point.c + t * dc, point.r + t * dr))
            if trials[-1].residual <= wanted:
                return trials[-1]
        return min(trials, key=lambda trial: trial.residual)


class ConvexNewton(SemismoothNewton):
    """Newton's method for the convex problem of de Saxcé, whose solution is near a fixed point.

    De Saxcé and Feng (1998, The bipotential method) write Coulomb's law as x = P_K(x - rho (r + s))
    with the projection P_K onto the friction cones and s = F |slip| in normal rows. For a given s,
    this is the minimiser of a convex function in K, which exists whenever multipliers in K balance
    the loads (Cadoux 2009). For Tresca's law s is zero, and the convex problem is the problem
    itself.
    """

    model: WholeModel

    def __init__(
        self, problem: DualProblem, model: WholeModel, x: Array, r: Array, given: bool
    ) -> None:
        """Prepare steps with the slips at a point x (size,) with the gradient r (size,).

        With `given`, slip bounds are those at x: the problem is Tresca's.
        """
        super().__init__(problem, model)
        cones = problem.admissible.at_point(x, r)
        self.cones = cones.section(x) if given else cones
        # the same for all multipliers of a cone
        largest = np.maximum(cones.disc_means(self.size), cones.of_normals(self.size))
        rows = cones.at_normals(largest) + cones.at_tangents(largest)
        self.rho = 1.0 / np.maximum(self.size, rows)
        self.opening = self.cones.dilation(x, r)

    def point(self, x: Array, c: Array, r: Array) -> NewtonPoint:
        """Return a point with its residual."""
        change = x - self.cones.project(x - self.rho * (r + self.opening))
        unbalanced = self.problem.constraints.residual(x, c)
        return NewtonPoint(x, c, r, self.energy(change, unbalanced))

    def equations(self, point: NewtonPoint) -> tuple[Array, NodalMaps, Array]:
        """Return the multipliers from which a step begins, its maps, and its right-hand side.

        With the derivative D of the projection at z, and its result y = P_K(z), the step ends at
        y + v with ((I - D) / rho + D M) v - D G c = D (M (x - y) - (x - y) / rho).
        """
        z = point.x - self.rho * (point.r + self.opening)
        derivative, settled = self.cones.projection_derivative(z), self.cones.project(z)
        residual, identity = point.x - settled, eye_array(len(z))
        added = diags_array(1.0 / self.rho) @ (identity - derivative)
        maps = NodalMaps(test=derivative, added=added, inverse=identity)
        return settled, maps, self.model.apply(residual) - residual / self.rho


def newton_solution(problem: DualProblem, model: Model, start: Point) -> NewtonPoint:
    """Return an approximate solution of the contact problem with a model of A. Collective.

    Needs no product with A.
    """
    newton = SemismoothNewton(problem, model)
    guess = newton.point(start.x, start.c, start.r)
    tolerance = max(SOLVED * guess.residual, newton.rounding)
    point = newton.solve(guess, tolerance)
    enough = tolerance
    if isinstance(model, WholeModel):
        # after more progress than this, Newton's method goes on in the next iteration
        enough = max(FORCING * guess.residual, newton.rounding)
        if point.residual > enough:
            point = solve_from_other_guesses(newton, model, guess, point, tolerance)
    x = problem.admissible.at_point(point.x, point.r).project(point.x)
    r = point.r + model.apply(x - point.x)
    return NewtonPoint(x, point.c, r, point.residual, point.residual <= enough)


def solve_from_other_guesses(
    newton: SemismoothNewton,
    model: WholeModel,
    start: NewtonPoint,
    best: NewtonPoint,
    tolerance: float,
) -> NewtonPoint:
    """Return the best point of Newton's method from other guesses than the start. Collective.

    The first guess is the end of a path of problems in which each node touches through a soft
    layer, which becomes stiffer from problem to problem. The next guess is zero; the others are
    solutions of convex problems, the first without slip, each other one with the slips of the
    solution before.

    Newton's method has failed from the start; its result is `best`.
    """
    problem, G = newton.problem, newton.problem.constraints.columns
    r = start.r - model.apply(start.x) + G @ start.c
    zero = guess = newton.point(np.zeros_like(start.x), np.zeros_like(start.c), r)
    for softness in (*LAYERS, 0.0):
        layered = SemismoothNewton(problem, model.softened(softness)) if softness else newton
        gradient = r + layered.model.apply(guess.x) - G @ guess.c
        guess = layered.solve(layered.point(guess.x, guess.c, gradient), tolerance)
    best = min(best, guess, key=lambda candidate: candidate.residual)
    if best.residual <= tolerance:
        return best
    guess = zero
    pressed, slip = start.x, np.zeros_like(r)
    soft = SOFTER_STARTS[0]
    convex_runs = [(softer, False) for softer in GUESSES * SOFTER_STARTS]
    for softer, given in [(soft, None), *convex_runs, *GUESSES * [(soft, True)]]:
        if given is not None:
            convex = ConvexNewton(newton.problem, model, pressed, slip, given)
            guess = convex.solve(convex.point(guess.x, guess.c, guess.r), tolerance, softer)
            pressed, slip = guess.x, guess.r
        point = newton.solve(newton.point(guess.x, guess.c, guess.r), tolerance, softer)
        best = min(best, point, key=lambda candidate: candidate.residual)
        if best.residual <= tolerance:
            break
    return best


def solve_model(
    problem: DualProblem, start: Point, residual: NaturalResidual, tolerance: float
) -> NewtonPoint:
    """Return an approximate solution of the dual problem with the model M in place of A.

    With known products Y = A W, M = Y Y' + (I - Y W') D (I - W Y') contains the near field D where
    the basic model has a diagonal. The error of M is then smaller by an order of magnitude, but
    there is no formula for the inverse of M on a face. Hence D is itself approximated by D~, a
    low-rank model made of known products with D. Each iteration solves the problem for M with D~ in
    place of D. It then computes a product with D, which gives the residual for M and improves D~. A
    product with D costs one solve with a small matrix, and no solve with K. Products with D are
    kept until the products with A are dropped. Collective.

    The tolerance is a natural residual, with the model in place of A.
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
        target = newton_solution(problem, store.model(store.near.model()), point)
        step = target.x - point.x
        if float(problem.inner(step, step)) == 0.0:
            break
        r = point.r + store.apply_with_near(step) - G @ (target.c - point.c)
        target = replace(target, r=r)
        if (reached := residual.norm_at(target)) < least:
            best, least = target, reached
        if least <= tolerance:
            break
    # without a step, the diagonal is the base; a product with A then checks the step
    return best or newton_solution(problem, store.model(), start)
