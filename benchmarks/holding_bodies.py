"""Ways to hold bodies that only contact holds: sparse equations, SMALBE, and springs.

    tools/fenicsx python3 benchmarks/holding_bodies.py --json benchmarks/data/holding_bodies.json

The dual problem of dry walls (`scenes/wall.py`) is to minimise 1/2 x'A x - b'x over Lambda subject
to the equilibrium G'x = e. All ways solve it until the relative natural residual and
|G'x - e| / |e| are at most 1e-6:

    newton   this package: projected Newton method with G'x = e as sparse equations
    smalbe   augmented Lagrangians with the Hessian P A P + rho Q, where Q = G (G'G)^-1 G' and
             P = I - Q are the projectors of Total-FETI, and rho = |P A P|; MPGP is the inner
             solver, and SMALBE-M decides its accuracy. Dostal: "Optimal Quadratic Programming
             Algorithms" (2009), and Dostal, Kozubek (2012), see `peer_solvers/gradients.py`;
             PERMON has both algorithms.
    springs  proximal point method (Rockafellar 1976): springs of stiffness s tie each rigid motion
             to its last place, so that the Hessian is A + G G' / s; inner solver as in smalbe

The slip bounds are either given, namely the bounds of Coulomb's solution for the same wall, or they
follow Coulomb's law. The package then solves for the fixed point directly; smalbe and springs solve
a sequence of problems with given bounds (sweeps). All begin without known multipliers and products.
Seconds are the processor's, from B and the factors of K to the multipliers. Products with A are
solves with K for 2 bricks; for more bricks all ways use 32 solves to compute A as a sparse matrix,
and smalbe and springs multiply by it.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from assemblies import SIZES
from harness import Benchmark, Column, Comm, Row, Table
from harness.timing import timed
from peer_solvers.gradients import proportioning
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, eigsh

from dolfinx_tresca import SolverOptions
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.solvers import iteration
from dolfinx_tresca.solvers.balance import balance
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.solvers.residual import NaturalResidual
from dolfinx_tresca.solvers.sparse_factors import factored
from dolfinx_tresca.solvers.whole_model import WholeModel
from scenes.wall import HEIGHT, wall

#: Relative residual; and residual of a sweep, divided by the residual of Coulomb's law before it.
RTOL, SWEEP = 1e-6, 0.1

#: Number of products with A after which smalbe and springs give up.
MOST = 10_000

#: Stiffness of the springs, divided by the stiffness of a contact node.
STIFFNESS = 1e-2


class AugmentedLagrangian:
    """An iterate of smalbe or springs.

    Attributes:
        x: (size,) multipliers in Lambda.
        products: number of products with A.
        outer: number of outer iterations, each of which corrects the rigid motions.
    """

    def __init__(self, program: DualProgram, residual: NaturalResidual, springs: bool) -> None:
        """Begin at the multipliers of least norm that satisfy the equilibrium.

        Args:
            program: A, b, G and e.
            residual: step length and scale of natural residuals.
            springs: whether springs are used in place of projectors.
        """
        store, G = program.known_products(), program.constraints.columns
        e, transposed = program.constraints.values, csr_array(G.T)
        factors = factored(csr_array(transposed @ G))
        assert factors is not None
        self.products, self.outer, self._residual = 0, 0, residual

        def apply(x: np.ndarray) -> np.ndarray:
            self.products += 1
            return (
                store.product(x)[0] if isinstance(store, WholeModel) else program.operator.apply(x)
            )

        def Q(x: np.ndarray) -> np.ndarray:
            return G @ factors.solve(transposed @ x)

        def P(x: np.ndarray) -> np.ndarray:
            return x - Q(x)

        origin = G @ factors.solve(e)  # G'origin = e
        slope = apply(origin) - program.b
        if springs:
            weight = float((1.0 / program.compliance.nodal_stiffness).mean()) / STIFFNESS
            self.penalty = lambda x: weight * (G @ (transposed @ x - e))
            self.hessian = lambda x: apply(x) + weight * (G @ (transposed @ x))
            self.norm = largest_eigenvalue(self.hessian, len(origin))
        else:
            slope = P(slope)
            self.norm = rho = largest_eigenvalue(lambda x: P(apply(P(x))), len(origin))
            self.penalty = lambda x: rho * (Q(x) - origin)
            self.hessian = lambda x: P(apply(P(x))) + rho * Q(x)
        self._missing = lambda x: float(np.linalg.norm(transposed @ x - e) / np.linalg.norm(e))
        self._distance = lambda x: float(np.linalg.norm(Q(x) - origin))
        self._origin, self._slope = origin, slope
        self.x, self._gradient = origin, slope

    def move_to(self, x: np.ndarray) -> None:
        """Continue from other multipliers (size,)."""
        self._gradient = self._gradient + self.hessian(x - self.x)
        self.x = x

    def residual(self, bounds: FeasibleSet) -> float:
        """Return the larger one of the two relative residuals."""
        natural = self._natural(bounds, self.x, self._gradient)
        return max(self._residual.relative(natural), self._missing(self.x))

    def _natural(self, bounds: FeasibleSet, x: np.ndarray, r: np.ndarray) -> float:
        rho = self._residual.rho
        return float(np.linalg.norm(x - bounds.project(x - rho * r))) / rho

    def minimise(self, bounds: FeasibleSet, tolerance: float) -> None:
        """Solve for given slip bounds to a relative residual.

        The inner solver ends when the natural residual is at most M times the distance from
        equilibrium; M is halved if the augmented Lagrangian has not increased enough.
        """
        M, energy = self.norm, -np.inf
        self.move_to(bounds.project(self.x))

        def done(x: np.ndarray, r: np.ndarray) -> bool:
            natural = self._natural(bounds, x, r)
            return (
                self.products > MOST
                or natural <= M * self._distance(x)
                or max(self._residual.relative(natural), self._missing(x)) <= tolerance
            )

        while True:
            self.x, self._gradient, _ = proportioning(
                self.hessian, self.x, self._gradient, bounds, 1.9 / self.norm, done
            )
            self.outer += 1
            if self.products > MOST or self.residual(bounds) <= tolerance:
                return
            force, step = self.penalty(self.x), self.x - self._origin
            before, energy = energy, 0.5 * step @ (self._gradient + self._slope)
            if energy < before + 0.5 * step @ force:
                M *= 0.5
            # the multipliers c of the equilibrium: the gradient contains G c
            self._slope, self._gradient = self._slope + force, self._gradient + force


def largest_eigenvalue(hessian: Callable[[np.ndarray], np.ndarray], size: int) -> float:
    """Return the largest eigenvalue of a Hessian (size, size), to 1 %."""
    operator = LinearOperator((size, size), matvec=hessian, dtype=np.float64)
    start = np.ones(size)
    (value,) = eigsh(operator, 1, which="LA", v0=start, return_eigenvectors=False, tol=0.01)
    return 1.01 * float(value)


def solve(program: DualProgram, residual: NaturalResidual, springs: bool) -> tuple[np.ndarray, Row]:
    """Solve by augmented Lagrangians; for Coulomb's law in sweeps with fixed slip bounds."""
    at = AugmentedLagrangian(program, residual, springs)
    admissible, tolerance, sweeps = program.admissible, RTOL, 0
    bounds = admissible.section(at.x)
    if not isinstance(admissible, FeasibleSet):  # in the first sweep all nodes stick
        bounds = dataclasses.replace(bounds, radius=np.full_like(bounds.radius, np.inf))
        tolerance = SWEEP**2
    while True:
        at.minimise(bounds, tolerance)
        sweeps += 1
        bounds = admissible.section(at.x)
        left = at.residual(bounds)
        if left <= RTOL or at.products > MOST:
            break
        tolerance = max(0.5 * RTOL, min(tolerance, SWEEP * left))
    figures = {"sweeps": sweeps, "outer": at.outer, "products": at.products}
    return at.x, {**figures, "converged": left <= RTOL}


def newton(program: DualProgram, residual: NaturalResidual) -> tuple[np.ndarray, Row]:
    """Solve by the package's method."""
    products, start = program.operator.products, np.zeros_like(program.b)
    found = iteration.solve(program, start, SolverOptions(rtol=RTOL), lambda point: False)
    figures = {"outer": found.iterations, "products": program.operator.products - products}
    return found.multipliers, {**figures, "converged": found.status.name == "CONVERGED"}


#: Name -> function that returns the multipliers, and figures.
WAYS: dict[str, Callable[[DualProgram, NaturalResidual], tuple[np.ndarray, Row]]] = {
    "newton": newton,
    "smalbe": partial(solve, springs=False),
    "springs": partial(solve, springs=True),
}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield walls, loads and laws of friction."""
    loops = arguments.bricks, arguments.pushes, arguments.laws
    for bricks, push, law in itertools.product(*loops):
        yield {"bricks": bricks, "push": push, "law": law}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the figures of all ways."""
    courses = SIZES[case["bricks"]]
    scene = wall(comm, *courses, one_pair=case["bricks"] > 1)
    scene.data.push.value = case["push"] * scene.data.weights.sum() / courses[1] / HEIGHT
    with scene.problem() as problem:
        problem.solve(rtol=RTOL)
        solved = problem._contact.solved
        program, x = solved.dual, solved.multipliers
        forces = program.jump.contact_force
        expected = forces(x).array.copy()
        if case["law"] == "given":
            program = dataclasses.replace(program, admissible=program.admissible.section(x))
        rho = 1.0 / program.known_products().largest_ritz_value()
        softness = program.constraints.softness / rho
        residual = NaturalResidual(program, rho)
        balanced = balance(program.constraints, program.admissible, rho * program.b, softness)
        residual.set_constraint_multipliers(balanced.shift / rho)
        row: Row = {}
        for name, way in WAYS.items():
            program.compliance.forget()
            seconds, (x, figures) = timed(comm, partial(way, program, residual))
            error = np.linalg.norm(forces(x).array - expected) / np.linalg.norm(expected)
            figures |= {"seconds": seconds, "error": float(error)}
            figures["ratio"] = seconds / row.get("newton_seconds", seconds)
            row |= {f"{name}_{key}": value for key, value in figures.items()}
        converged = all(row[f"{name}_converged"] for name in WAYS)
        yield row | {"status": "CONVERGED" if converged else "not all converged"}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--bricks", nargs="+", type=int, default=[2, 52, 490], choices=SIZES)
    parser.add_argument(
        "--pushes", nargs="+", type=float, default=[0.0, 0.2, 0.6], help="over a course's weight"
    )
    laws = ["given", "Coulomb"]
    parser.add_argument("--laws", nargs="+", default=laws, choices=laws)


def ratio(way: str) -> Callable[[list[Row]], str]:
    """Return a function that writes the seconds of a way divided by the seconds of newton."""

    def text(rows: list[Row]) -> str:
        row = rows[-1]
        if f"{way}_ratio" not in row:
            return ""
        return f"{row[f'{way}_ratio']:.2f}" if row[f"{way}_converged"] else "not solved"

    return text


COLUMNS = [
    Column("bricks", "{bricks}"),
    Column("push", "{push}"),
    Column("slip bounds", "{law}"),
    Column("newton: iterations / products", "{newton_outer} / {newton_products}"),
    Column("seconds", "{newton_seconds:.2f}"),
    *itertools.chain.from_iterable(
        (
            Column(
                f"{way}: sweeps / outer iterations / products",
                f"{{{way}_sweeps}} / {{{way}_outer}} / {{{way}_products}}",
            ),
            Column("times newton's seconds", ratio(way)),
        )
        for way in ("smalbe", "springs")
    ),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("bricks", "push", "law"),
    cases=cases,
    measure=measure,
    options=options,
    small={"bricks": 2},
    shown=COLUMNS,
    tables=[Table("holding_bodies", COLUMNS, line=["bricks", "push", "law"])],
)

if __name__ == "__main__":
    BENCHMARK.main()
