"""Linear equations that multipliers must satisfy besides Lambda, and a search for such multipliers.

The page begins with sums over ranks and ends with factors of sparse matrices. Numpy and scipy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, ROUNDING, Array
from dolfinx_tresca._base.tolerances import MOST_STEPS
from dolfinx_tresca.solvers.feasible_set import FeasibleSet


class InnerProduct(Protocol):
    """The inner product of distributed vectors."""

    def inner(self, x: Array | csr_array, y: Array | csr_array) -> Array:
        """Return x'y over all ranks, dense; x and y are (size,) or (size, k). Collective."""


class Reductions(InnerProduct, Protocol):
    """Sums, largest values and rows of all ranks, the same on each. All methods are collective."""

    def total(self, x: Array) -> Array:
        """Return the sum of the ranks' x, entry by entry; x has the same shape on all ranks."""

    def largest(self, value: float) -> float:
        """Return the largest `value` of all ranks."""

    def sparse_inner(self, x: csr_array, y: csr_array) -> csr_array:
        """Return x'y over all ranks, equal on all ranks, for sparse x and y of shape (size, k)."""

    def stacked(self, rows: csr_array) -> csr_array:
        """Return the rows (size, k) of all ranks below each other, (sum of sizes, k)."""

    def from_first_rank(self, x: Array) -> Array:
        """Return the first rank's x: ranks whose x differ by rounding would take other branches."""


def norm(space: InnerProduct, v: Array) -> float:
    """Return the Euclidean norm of v (size,) over all ranks. Collective."""
    return float(np.sqrt(space.inner(v, v)))


@dataclass(frozen=True)
class EqualityConstraints:
    """The k equations G'x + S c = e for multipliers x in Lambda and multipliers c of the equations.

    Equations with S = 0 are exact, and c are their Lagrange multipliers. Equations with S > 0 are
    soft: the term (e - G'x)'S^-1 (e - G'x) / 2 is added to q, and c = S^-1 (e - G'x). In both
    cases, the gradient in x is A x - b - G c. With k = 0, `along` does not communicate.

    The equations express the equilibrium of floating bodies (`floating/equilibrium.py`); this
    module does not depend on that meaning. Methods are collective.

    Attributes:
        columns: G (size, k), sparse.
        softness: (k, k) S, symmetric; its eigenvalues may be negative (see `balance`).
        values: (k,) e.
        term_sums: (k,) sizes of the terms that add up to e; its rounding is relative to them.
    """

    columns: csr_array
    softness: csr_array
    values: Array
    term_sums: Array
    reductions: Reductions

    @classmethod
    def none(cls, size: int, reductions: Reductions) -> EqualityConstraints:
        """Return an empty set of equations."""
        none = np.empty(0)
        return cls(csr_array((size, 0)), csr_array((0, 0)), none, none, reductions)

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def absolute(self) -> csr_array:
        """The absolute values of G."""
        return abs(self.columns)

    def along(self, x: Array) -> Array:
        """Return G'x (k,), summed over all ranks."""
        return self.reductions.total(self.columns.T @ x) if len(self) else np.empty(0)

    def softness_with(self, added: float) -> csr_array:
        """Return S + s E, E = `_exact_projector`, s = `added` >= 0: Newton systems are regular."""
        if added == 0.0 or len(self) == 0:
            return self.softness
        return csr_array(self.softness + added * self._exact_projector)

    @cached_property
    def _exact_projector(self) -> csr_array:
        """The projector E = I - V V' (k, k) onto exact equations, with the `soft_directions` V."""
        vectors = self.soft_directions[1]
        return csr_array(eye_array(len(self)) - vectors @ vectors.T)

    def residual(self, x: Array, c: Array) -> Array:
        """Return e - G'x - S c, (k,)."""
        return np.asarray(self.values - self.along(x) - self.softness @ c)

    def imbalance(self, x: Array, c: Array) -> float:
        """Return the larger of two relative residuals: of the exact and of the soft equations.

        Each is the norm of the residual, divided by the norm of the terms of all k equations. The
        terms S c, which may be larger than the loads by any factor, count for soft equations only.
        """
        if len(self) == 0:
            return 0.0
        missing = self.residual(x, c)
        exact_terms = self.reductions.total(self.absolute.T @ np.abs(x)) + self.term_sums
        soft_terms = exact_terms + abs(self.softness) @ np.abs(c)
        exact = self._exact_projector @ missing
        exact_size = max(float(np.linalg.norm(exact_terms)), LEAST_DIVISOR)
        soft_size = max(float(np.linalg.norm(soft_terms)), LEAST_DIVISOR)
        exact_ratio = float(np.linalg.norm(exact)) / exact_size
        soft_ratio = float(np.linalg.norm(missing - exact)) / soft_size
        return max(exact_ratio, soft_ratio)

    def soft_violation(self, x: Array, c: Array) -> float:
        """Return sqrt(d'S d) for the change d of c with which the soft equations hold at x.

        With `soft_directions` s and V, V'd is V'(e - G'x - S c) / s. For softly held bodies, the
        result is the energy norm of the rigid displacements that equilibrium still lacks.
        """
        eigenvalues, vectors = self.soft_directions
        missing = vectors.T @ self.residual(x, c)
        return float(np.sqrt(missing @ (missing / eigenvalues)))

    @cached_property
    def soft_directions(self) -> tuple[Array, csr_array]:
        """The positive eigenvalues s of S above rounding, and their eigenvectors V (k, number)."""
        if not self.softness.nonzero()[0].size:
            return np.empty(0), csr_array((len(self), 0))
        values, vectors = eigenpairs(self.softness)
        values = self.reductions.from_first_rank(values)
        vectors.data = self.reductions.from_first_rank(vectors.data)
        kept = values > ROUNDING * values.max()
        return values[kept], vectors[:, kept]


#: `balance`, whose docstring explains G, z, C and phi, ends without a solution if the rounding of
#: G z, relative to the terms of the equation, exceeds this number: z goes to infinity if the
#: equation has no solution, or if all its solutions are on the boundary of Lambda.
LOST = 1e-6

#: First value of the damping, which is the fraction of the diagonal of the majorant G'G + C that is
#: added to the Hessian. After a whole step, the damping is multiplied by `RELAXATION`, since the
#: next step may be longer where phi is flat; after a part of a step, it is divided by this part. In
#: a step in which rounding makes the matrix indefinite, it is multiplied by `MORE_DAMPING`.
DAMPING, RELAXATION, MORE_DAMPING = 1e-4, 1e-3, 10.0

#: Relative accuracy of the part of a step that minimises phi, whose kinks may be at tiny parts.
PART_ACCURACY = 1e-6

#: The search ends without a solution if all multipliers that satisfy the equations have a norm
#: above this multiple of the norm of `EqualityConstraints.term_sums`.
LARGEST_REACTION = 1e4


@dataclass(frozen=True)
class Balance:
    """The result of `balance`.

    Attributes:
        shift: (k,) z; the multipliers are P(y + G z). Without a solution, z is a motion that
            neither contact nor friction stops.
        excess: (k,) residual of the equation, its left side minus e.
        satisfied: whether the residual is at most the rounding of its terms, without that of G z.
        unbounded: whether it is proven that no solution is below the limit `LARGEST_REACTION`.
    """

    shift: Array
    excess: Array
    satisfied: bool
    unbounded: bool = False


def balance(
    constraints: EqualityConstraints,
    feasible_set: FeasibleSet,
    start: Array | None = None,
    softness_factor: float = 1.0,
) -> Balance:
    """Search for multipliers in Lambda that satisfy equations: they balance the loads. Collective.

    The result is z with G'P(y + G z) + C z = e, where P projects onto the feasible set. The
    solution z minimises the convex function

        phi(z) = 1/2 |x|^2 - 1/2 |x - P(x)|^2 + 1/2 z'C z - z'e,    x = y + G z,

    whose gradient is the residual of the equation. The method is Newton's with damping, and with
    the part of each step that minimises phi. Where no pressure acts, phi is flat; there the damping
    is reduced from step to step, and steps grow until z has left the flat region. If phi falls
    below -depth for y = 0, with depth = (`LARGEST_REACTION` |term_sums|)^2 / 2, all x in Lambda and
    c with G'x + C c = e have |x|^2 + c'C c > 2 depth (weak duality).

    Args:
        constraints: the equations.
        feasible_set: Lambda, or friction cones.
        start: (size,) y; the multipliers P(y + G z) are the nearest ones to y; None: zero.
        softness_factor: C is S times this number, without the negative eigenvalues that S has if a
            free body under pressure resists its rotation negatively. Without a start, C is the
            projector onto the positive eigenvectors of S: the result does not depend on softness.
    """
    G, target, absolute = constraints.columns, constraints.values, constraints.absolute
    inner, agreed = constraints.reductions.sparse_inner, constraints.reductions.from_first_rank
    term_sums = np.maximum(constraints.term_sums, np.abs(target))
    eigenvalues, vectors = constraints.soft_directions
    if start is None:
        y = np.zeros(G.shape[0])
        weights = np.ones_like(eigenvalues)
        depth = 0.5 * LARGEST_REACTION**2 * float(term_sums @ term_sums)
    else:
        y = start
        weights = softness_factor * eigenvalues
        depth = np.inf
    C: csr_array = vectors @ diags_array(weights) @ vectors.T
    # Newton's unknowns are scaled by the diagonal of the majorant of all Hessians
    scale = 1.0 / np.sqrt((inner(G, G) + C).diagonal())
    scaling = diags_array(scale)

    def excess(z: Array) -> Array:
        """Return the gradient of phi."""
        p = feasible_set.project(y + G @ z)
        return agreed(constraints.along(p) + C @ z - target)

    z = np.zeros_like(target)
    damping, unbounded = DAMPING, False
    for _ in range(MOST_STEPS):
        gradient = excess(z)
        # two rounding errors of the gradient: of its sums, and of G z, which may be much larger
        p = feasible_set.project(y + G @ z)
        shift_terms = np.where(p != 0.0, absolute @ np.abs(z), 0.0)
        local_terms = np.column_stack([np.abs(p), shift_terms])
        sums = constraints.reductions.total(absolute.T @ local_terms)  # (k, 2)
        terms = agreed(sums[:, 0] + abs(C) @ np.abs(z) + term_sums)
        rounding = ROUNDING * terms
        shift_rounding = agreed(np.finfo(float).eps * sums[:, 1])
        # the end: once `unbounded` is proven, one more step has made the direction of z accurate
        if unbounded or shift_rounding.max() > LOST * terms.max():
            break
        if (np.abs(gradient) <= rounding + shift_rounding).all():
            return Balance(z, gradient, bool((np.abs(gradient) <= rounding).all()))
        unbounded = -_dot(z, gradient) > depth  # phi(0) = 0, phi is convex: phi(z) <= z'gradient
        # a damped Newton step
        derivative = feasible_set.projection_derivative(y + G @ z)
        hessian = inner(G, derivative @ G) + C
        scaled = _damped_solution(scaling @ hessian @ scaling, scale * gradient, damping)
        step = -agreed(scale * scaled)

        def slope(length: float, z: Array = z, step: Array = step) -> float:
            return _dot(step, excess(z + length * step))

        length = 1.0  # less, if phi has its least value on the way
        if slope(1.0) > 0.0 > _dot(step, gradient):
            length = brentq(slope, 0.0, 1.0, xtol=1e-30, rtol=PART_ACCURACY, maxiter=1000)
        z = z + length * step
        damping = RELAXATION * damping if length == 1.0 else damping / length
        damping = min(max(damping, np.finfo(float).eps), 1.0)
    return Balance(z, excess(z), satisfied=False, unbounded=unbounded)


def _damped_solution(matrix: csr_array, right: Array, damping: float) -> Array:
    """Return (matrix + d I)^-1 right; d is the damping, or more if rounding needs it."""
    unit = eye_array(len(right))
    while damping < np.inf:
        factors = factored(matrix + damping * unit)
        if factors is not None:
            x: Array = factors.solve(right)
            if _dot(x, right) >= 0.0:  # else rounding made a pivot negative
                return x
        damping *= MORE_DAMPING
    raise np.linalg.LinAlgError("the Hessian of a projection is not finite")


def _dot(x: Array, y: Array) -> float:
    """Return x'y, summed in a fixed order, so that ranks on different processors agree."""
    return float(np.cumsum(x * y)[-1])


def eigenpairs(matrix: csr_array) -> tuple[Array, csr_array]:
    """Return eigenvalues (n,) and eigenvectors, the columns (n, n), of a symmetric matrix.

    Rows that nonzero entries connect, directly or through other rows, are treated as one dense
    block: the cost grows with the sum of the cubes of the blocks' sizes. Eigenpair number j belongs
    to the block of row j; the eigenvalues of a block ascend.
    """
    label = connected_components(matrix, directed=False)[1]
    # the rows of one block after the other, ascending in each block; `position` undoes this order
    order = np.argsort(label, kind="stable")
    blocks = np.split(order, np.cumsum(np.bincount(label))[:-1])
    rows = csr_array(matrix)
    pairs = [np.linalg.eigh(rows[block][:, block].toarray()) for block in blocks]
    values = np.concatenate([eigenvalues for eigenvalues, _ in pairs])
    vectors = csr_array(block_diag([csr_array(eigenvectors) for _, eigenvectors in pairs]))
    position = np.argsort(order)
    return values[position], vectors[position][:, position]


def factored(matrix: csr_array) -> Any | None:
    """Return SciPy's triangular factors of a symmetric matrix; None if it is singular.

    The matrix is factored as L U without pivoting, which for positive definite matrices is as
    stable as Cholesky's method. (Only at a pivot that is exactly zero, SuperLU swaps rows.)
    """
    try:
        return splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return None
