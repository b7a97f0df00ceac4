"""Random dense problems (38.4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, issparse
from scipy.sparse.linalg import spsolve

from dolfinx_tresca import Iteration, SolverOptions
from dolfinx_tresca.floating.equilibrium import FloatingBodies
from dolfinx_tresca.options import Method
from dolfinx_tresca.solvers.constraints import EqualityConstraints
from dolfinx_tresca.solvers.feasible_set import FeasibleSet, FrictionCones
from dolfinx_tresca.solvers.iteration import solve
from dolfinx_tresca.solvers.problem import DualSolution, KnownProducts
from dolfinx_tresca.solvers.products import ProductStore, WholeModel

METHODS = get_args(Method)


class OneRank:
    """The reductions over one rank."""

    def from_first_rank(self, x: np.ndarray) -> np.ndarray:
        """Return x."""
        return x

    def total(self, x: np.ndarray) -> np.ndarray:
        """Return x."""
        return x

    def inner(self, x: np.ndarray, y: np.ndarray) -> npt.NDArray[np.float64]:
        """Return x'y."""
        product = x.T @ y
        return product.toarray() if issparse(product) else product

    def largest(self, value: float) -> float:
        """Return the value."""
        return value

    def sparse_inner(self, x: csr_array, y: csr_array) -> csr_array:
        """Return x'y."""
        return csr_array(x.T @ y)

    def stacked(self, rows: csr_array) -> csr_array:
        """Return the rows."""
        return rows


@dataclass
class DenseProblem(OneRank):
    """A dense problem with the protocol of solvers/problem.py; keeps the arguments of `apply`."""

    A: np.ndarray
    b: np.ndarray
    feasible_set: FeasibleSet
    arguments: list[np.ndarray] = field(default_factory=list)
    constraints: EqualityConstraints = None  # type: ignore[assignment]  # none are made below
    cones: FrictionCones | None = None
    is_load_step: bool = False
    is_too_large: bool = False  # to compute A whole
    exact: bool = True
    b_error: float = 0.0
    store: KnownProducts = field(init=False)

    def __post_init__(self) -> None:
        """Begin without products, and without constraints if none are given."""
        if self.constraints is None:
            self.constraints = EqualityConstraints.none(len(self.b), OneRank())
        self.forget()

    @property
    def compliance(self) -> DenseProblem:
        """The problem itself, which has the methods of A."""
        return self

    @property
    def reductions(self) -> OneRank:
        """The problem itself, which has the methods of the reductions."""
        return self

    @property
    def admissible(self) -> FeasibleSet:
        """The cones, if bounds depend on the pressure."""
        return self.feasible_set if self.cones is None else self.cones

    def section_at(self, x: np.ndarray, r: np.ndarray) -> FeasibleSet:
        """Return Lambda with the slip bounds at a point."""
        return self.admissible.at_point(x, r).section(x)

    def known_products(self) -> KnownProducts:
        """Return the store of known products."""
        return self.store

    def complete_products(self) -> bool:
        """Keep A as the store of known products; each column counts as a product."""
        if not self.is_too_large and not isinstance(self.store, WholeModel):
            rows = np.column_stack([self.apply(unit) for unit in np.eye(len(self.b))])
            local = 1.0 / np.diag(np.linalg.inv(self.A))
            self.store = WholeModel(self, rows, 0, local, spsolve)
        return not self.is_too_large

    def forget(self) -> None:
        """Drop the products."""
        diagonal = self.diagonal  # there is no better approximation of A
        self.store = ProductStore(self, diagonal, apply_near=lambda x: diagonal * x)

    @property
    def products(self) -> int:
        """How often A was applied."""
        return len(self.arguments)

    @property
    def diagonal(self) -> np.ndarray:
        """diag(A), with the mean over a node's tangential entries."""
        diagonal = np.diag(self.A).copy()
        lam = self.feasible_set
        number = np.maximum(np.bincount(lam.node, minlength=len(lam.radius)), 1)
        sums = np.bincount(lam.node, diagonal[lam.tangential], minlength=len(lam.radius))
        diagonal[lam.tangential] = (sums / number)[lam.node]
        return diagonal

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return A x."""
        self.arguments.append(x.copy())
        return self.A @ x

    @property
    def b_terms(self) -> np.ndarray:
        """The absolute values of b, which has one term."""
        return np.abs(self.b)

    def refine_b(self) -> None:
        """Do nothing, since b is exact."""

    def gradient(self, x: np.ndarray, accuracy: float) -> tuple[np.ndarray, float]:
        """Return A x - b and its error, which is zero."""
        return self.apply(x) - self.b, 0.0

    def local_error(self, x: np.ndarray, r: np.ndarray) -> float:
        """Largest change of a multiplier by its own projected step, over the largest multiplier."""
        local = 1.0 / self.diagonal
        change = np.abs(x - brute_projection(self.section_at(x, r), x - local * r)).max(initial=0.0)
        largest = np.abs(x).max(initial=0.0)
        return float(change / largest if largest > 0.0 else change > 0.0)

    def energy_bound(self, x: np.ndarray, r: np.ndarray, error: float) -> float:
        """Bound by a displacement with the best gap and slip of each node, the others fixed."""
        lam = self.section_at(x, r)
        inverse = np.linalg.inv(self.A)
        stiffness = np.diag(inverse)
        rest = np.zeros_like(r)
        gap = 0.0
        for i in lam.normal:
            rest[i] = max(0.0, r[i] - x[i] / stiffness[i])
            gap += x[i] * rest[i]
        for node, g in enumerate(lam.radius):
            rows = lam.tangential[lam.node == node]
            if len(rows):
                mean = stiffness[rows].mean()
                slip = x[rows] / mean - r[rows]
                length = np.linalg.norm(slip)
                slip *= max(0.0, length - g / mean) / length if length > 0.0 else 0.0
                rest[rows] = -slip
                gap += g * np.linalg.norm(slip) - x[rows] @ slip
        lift = np.sqrt((r - rest) @ inverse @ (r - rest))
        return float(np.sqrt(2.0 * max(gap, 0.0) + (lift + error) ** 2)) + error

    def energy_norm(self, x: np.ndarray, r: np.ndarray, error: float = 0.0) -> float:
        """|A^-1 b|_A for any x: a norm of the displacement without contact."""
        return float(np.sqrt(self.b @ np.linalg.solve(self.A, self.b)))

    def energy_resolution(self) -> float:
        """Rounding error of energies, taken as zero."""
        return 0.0

    def discretisation_error(self, x: np.ndarray, c: np.ndarray) -> float:
        """Return a fixed number in place of the estimated error of a mesh."""
        return 0.05

    def q(self, x: np.ndarray) -> float:
        """Return 1/2 x'A x - x'b."""
        return float(0.5 * x @ self.A @ x - x @ self.b)

    def natural_residual(self, x: np.ndarray, rho: float) -> float:
        """|x - P(x - rho r)| / rho, divided by its value at zero unless this is zero; not cached.

        Bounds that depend on the pressure are taken at x, and at zero for the divisor.
        """
        here, none = (self.admissible.section(y) for y in (x, np.zeros_like(x)))
        at = np.linalg.norm(x - brute_projection(here, x - rho * (self.A @ x - self.b)))
        zero = np.linalg.norm(brute_projection(none, rho * self.b))
        return float(at / zero if zero > 0.0 else at)


def brute_projection(lam: FeasibleSet, y: np.ndarray) -> np.ndarray:
    """P_Lambda, node by node."""
    z = y.copy()
    for i in lam.normal:
        z[i] = max(0.0, y[i])
    for node, g in enumerate(lam.radius):
        rows = lam.tangential[lam.node == node]
        length = np.linalg.norm(y[rows])
        if length > g:
            z[rows] = y[rows] * (g / length)
    return z


def random_set(rng: np.random.Generator, nodes: int) -> FeasibleSet:
    """Random Lambda: nodes have 0 or 1 normal and 0 to 2 tangential rows; some radii are zero."""
    normal, tangential, node = [], [], []
    size = 0
    for i in range(nodes):
        if i == 0 or rng.random() < 0.9:
            normal.append(size)
            size += 1
        for _ in range(rng.choice([0, 1, 2], p=[0.1, 0.2, 0.7])):
            tangential.append(size)
            node.append(i)
            size += 1
    radius = rng.uniform(0.05, 1.0, nodes) * (rng.random(nodes) < 0.8)
    order = rng.permutation(size)  # positions without any order
    return FeasibleSet(
        size,
        order[np.array(normal, dtype=np.intp)],
        order[np.array(tangential, dtype=np.intp)],
        np.array(node, dtype=np.intp),
        radius,
        np.full(nodes, -1),
    )


def random_problem(seed: int, nodes: int, decades: float, load: float = 1.0) -> DenseProblem:
    """A strictly convex problem with cond(A) = 10^decades."""
    rng = np.random.default_rng(seed)
    lam = random_set(rng, nodes)
    Q, _ = np.linalg.qr(rng.standard_normal((lam.size, lam.size)))
    A = (Q * 10.0 ** -np.linspace(0.0, decades, lam.size)) @ Q.T
    return DenseProblem(0.5 * (A + A.T), load * rng.standard_normal(lam.size), lam)


def random_cone_problem(seed: int, nodes: int, decades: float, coefficient: float) -> DenseProblem:
    """A problem whose bounds are c + min(F p, l), with F up to a coefficient."""
    problem = random_problem(seed, nodes, decades)
    lam = problem.feasible_set
    rng = np.random.default_rng(seed + 2)
    normal_of = np.full(nodes, -1)
    owner = rng.permutation(nodes)[: len(lam.normal)]
    normal_of[owner] = lam.normal[: len(owner)]
    rubs = rng.random(nodes)
    constant = np.where(rubs < 0.2, rng.uniform(0.0, 1.0, nodes), 0.0)
    problem.cones = FrictionCones(
        **vars(dataclasses.replace(lam, radius=constant, normal_of=normal_of)),
        coefficient=np.where(rubs < 0.9, rng.uniform(0.0, coefficient, nodes), 0.0),
        limit=np.where(rng.random(nodes) < 0.3, rng.uniform(0.0, 1.0, nodes), np.inf),
    )
    problem.feasible_set = problem.cones.section(np.zeros(lam.size))
    return problem


def random_dry_problem(seed: int, nodes: int, decades: float, coefficient: float) -> DenseProblem:
    """A problem with the bounds F p and one coefficient F at all nodes."""
    problem = random_cone_problem(seed, nodes, decades, coefficient)
    still = np.zeros(nodes)
    assert problem.cones is not None
    cones = dataclasses.replace(
        problem.cones, radius=still, coefficient=still + coefficient, limit=still + np.inf
    )
    problem.cones, problem.feasible_set = cones, cones.section(np.zeros(cones.size))
    return problem


def random_balanced_problem(
    seed: int, nodes: int, motions: int, decades: float, softness: float
) -> DenseProblem:
    """A strictly convex problem whose equality constraints hold at some point inside Lambda."""
    problem = random_problem(seed, nodes, decades)
    lam = problem.feasible_set
    rng = np.random.default_rng(seed + 1)
    inside = 0.5 * brute_projection(lam, rng.standard_normal(lam.size))
    inside[lam.normal] = rng.uniform(0.1, 1.0, len(lam.normal))
    jumps = rng.standard_normal((lam.size, motions))
    loads, sizes = jumps.T @ inside, np.abs(jumps).T @ np.abs(inside)
    problem.constraints = equilibrium(lam, jumps, loads, sizes, softness)
    return problem


class LoadedBodies(FloatingBodies):
    """Bodies under loads that are given by their resultants and the sizes of their terms."""

    def resultants(self, f: Any) -> Any:
        """The given pair."""
        return f


def equilibrium(
    feasible_set: FeasibleSet,
    jumps: npt.NDArray[np.float64],
    loads: npt.NDArray[np.float64],
    sizes: npt.NDArray[np.float64],
    stiffness: float = 0.0,
    describe: Callable[[npt.NDArray[np.float64]], str] = str,
) -> EqualityConstraints:
    """The equations of equilibrium for jumps (size, k) of k motions, under given resultants."""
    k = jumps.shape[1]
    springs = csr_array(stiffness * np.eye(k))
    springs.eliminate_zeros()
    modes: Any = SimpleNamespace(body=np.zeros(k, dtype=np.int64), describe=describe)
    bodies = LoadedBodies(modes, csr_array(np.eye(k)), springs, csr_array(jumps))
    given: Any = loads, sizes
    return bodies.under(given, feasible_set, OneRank()).constraints


def run(
    problem: DenseProblem,
    method: Method = "projected_newton",
    start: np.ndarray | None = None,
    observe: Callable[[Iteration], bool] = lambda iteration: False,
    *,
    keep: bool = False,
    **options: Any,
) -> DualSolution:
    """Solve from `start` (default zero); `keep`: with the products of earlier runs."""
    if not keep:
        problem.forget()
    start = np.zeros_like(problem.b) if start is None else start
    if "accuracy" not in options:
        options.setdefault("rtol", 1e-6)
    chosen = SolverOptions(method=method, **options)
    return solve(problem, start, chosen, observe)
