"""Known products with A, or A as a matrix, and the models of A that follow. Numpy and scipy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.sparse import block_array, csr_array, diags_array, eye_array, issparse
from scipy.sparse.linalg import eigsh

from dolfinx_tresca._base.arrays import ROUNDING, Array, Matrix, dense
from dolfinx_tresca._base.tolerances import FORCING, MOST_STEPS
from dolfinx_tresca.solvers.constraints import Reductions
from dolfinx_tresca.solvers.feasible_set import Face, FeasibleSet

#: Softness times the compliance of the multipliers, added to S of the equality constraints
#: G'lambda + S c = e: linear systems then have a solution even if the constraints have none.
LEAST_SOFTNESS = 1e-10

#: Largest stiffness C in `NodalMaps.on_face`, divided by the diagonal of the model: a larger one,
#: where a slip bound is nearly zero, would hide the node's other equations. (1e150 overflows.)
STIFFEST = 1e8


@dataclass(frozen=True)
class NodalMaps:
    """The maps T and R in the equations T M s + R s - T G c = T a and G's + S c = e.

    Here M is the model of A, G and S belong to equality constraints, and a and e are given. The
    equations, which `solve_on_face` of a model solves, give Newton steps s on a face, and steps to
    derivatives of solutions. All maps are sparse, and couple only multipliers of the same node.

    Attributes:
        test: T, applied to both sides of the first equation.
        added: R: curvature at slipping nodes, and D at multipliers that do not move.
        inverse: (T D + R)^-1 T with the diagonal D of the model.
    """

    test: csr_array
    added: csr_array
    inverse: csr_array

    @classmethod
    def on_face(
        cls, cones: FeasibleSet, x: Array, face: Face, diagonal: Array, stiffness: Array
    ) -> NodalMaps:
        """Return the maps for Newton steps s on a face. Not collective.

        With the projector P onto the face, the diagonal C of curvatures, and the changes Q and L of
        slip bounds with the pressure and with the slip, s solves

            P (M s + C s - G c) = P a,  s - (I + Q) P s = L (a - M s + G c).

        Let n be the unit vector in the normal row of a slipping node, t its unit vector `radial`,
        and g' and h the derivatives of its bound at x (size,) by pressure and slip. Then Q is the
        sum of g' t n', and L that of h t t', over all nodes: multipliers follow their bounds. The
        first equation plus D times the second has T = P + D L and R = P C + D (I - P - Q P).

        The `diagonal` (size,) is D; `inverse` is exact if D is the same for all degrees of freedom
        of a friction disc. The `stiffness` (size,) is C >= 0, the same for all degrees of freedom
        of a disc. If bounds are given, `cones` are Lambda, and Q and L are zero.
        """
        stiffness = np.minimum(stiffness, STIFFEST * diagonal)
        weight = np.reciprocal(diagonal + stiffness)
        radial, free = face.radial, face.free
        slope, by_slip = cones.slopes(x, face.slip)
        # `inverse`: with D for M, P s = P a / (D + C), and t's = (g' n's + h t'a) / (1 + h D)
        damping = 1.0 + by_slip * cones.disc_means(diagonal)
        damping[damping == 0.0] = 1.0
        by_pressure = free * cones.at_normals(slope)
        damped = weight * free * cones.at_normals(slope / damping)
        damped += face.along_radius(by_slip / damping)
        # P is the diagonal `free` less t t'; each pair (v, w) of vectors adds v w'
        matrix, on_radius = cones.nodal_matrix, diagonal * radial
        along_slip = on_radius, face.along_radius(by_slip)
        fixed = on_radius, radial - by_pressure
        return cls(
            test=matrix(np.where(free, 1.0, 0.0), (radial, -radial), along_slip),
            added=matrix(np.where(free, stiffness, diagonal), (stiffness * radial, -radial), fixed),
            inverse=matrix(weight * free, (weight * radial, -radial), (radial, damped)),
        )


def solve_or_fit(matrix: Array, right: Array) -> Array:
    """Return matrix^-1 right; for a singular matrix, the least-squares solution of least norm."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right)[0], dtype=np.float64)


class BlockBFGSModel:
    """The model M = Y Y' + (I - Y W') D (I - W Y') of A: symmetric and positive definite.

    The columns of Y are the known products A w with the columns w of W, and W'Y = I. M equals A on
    all combinations of these vectors (M W = Y); on other vectors, it has the magnitude of D, an
    approximation of diag(A). M is the block BFGS update of D with W and Y; the term Y Y' alone is a
    Nystroem approximation of A. Applying or inverting M needs no product with A. D may be replaced
    by another model, such as a model of the near field; M is then the update of that model.

    Attributes:
        diagonal: (size,) D, the same for all degrees of freedom of a friction disc.
    """

    def __init__(
        self,
        reductions: Reductions,
        diagonal: Array,
        W: Array,
        Y: Array,
        base: BlockBFGSModel | None = None,
    ) -> None:
        """Update D with known products. Collective.

        W and Y (size, pairs) satisfy W'Y = I. D is the `diagonal` (size,), or a model given as
        `base`, which is not changed; its diagonal then replaces `diagonal`.
        """
        self._inner, self._agreed = reductions.inner, reductions.from_first_rank
        self.diagonal: Array = diagonal if base is None else base.diagonal
        # multiplied out, M = D + U E U' with U = (Y, D W) and E = (I + W'D W, -I; -I, 0)
        image = diagonal[:, None] * W if base is None else base.apply(W)
        identity = np.eye(W.shape[1])
        zero = np.zeros_like(identity)
        gram = identity + self._inner(W, image)
        self._U = np.column_stack([Y, image])
        self._E = np.block([[gram, -identity], [-identity, zero]])
        self._E_inverse = np.block([[zero, -identity], [-identity, -gram]])
        if base is not None:
            self._U = np.column_stack([base._U, self._U])
            self._E = block_diag(base._E, self._E)
            self._E_inverse = block_diag(base._E_inverse, self._E_inverse)
        # square root of the mean of D, weighted by D: it scales the constraints so that all rows of
        # the matrix that Woodbury's formula inverts have a similar size
        total = float(self._inner(self.diagonal, np.ones_like(self.diagonal)))
        square = float(self._inner(self.diagonal, self.diagonal))
        self._unit = float(np.sqrt(square / total)) if total > 0.0 else 1.0

    @property
    def model_diagonal(self) -> Array:
        """diag(M) (size,), from which `SemismoothNewton` takes its step lengths."""
        return np.asarray(self.diagonal + ((self._U @ self._E) * self._U).sum(axis=1))

    def apply(self, x: Array) -> Array:
        """Return M x for x of shape (size,) or (size, columns). Collective."""
        result: Array = (self.diagonal * x.T).T + self._U @ (self._E @ self._inner(self._U, x))
        return result

    def solve_on_face(
        self, maps: NodalMaps, right: Array, G: csr_array, softness: csr_array, missing: Array
    ) -> tuple[Array, Array]:
        """Return s (size,) and c (k,), which solve the equations of `NodalMaps`. Collective.

        The right-hand sides are a = `right` (size,) and e = `missing` (k,). The matrix Z = (U, G)
        has the unknown coefficients y = (E U's, -c): with J = `maps.inverse`, s = J a - J Z y, and

            (Z'J Z + (E^-1, 0; 0, S)) y = Z'J a - (0, e)     (Woodbury's formula).

        In the code, G and e are multiplied by `_unit`, and S by its square. `LEAST_SOFTNESS` is
        added, so that the system has a solution even if the second equation has none.
        """
        unit = self._unit
        Z = np.column_stack([self._U, unit * G.toarray()])
        scaled, without_pairs = maps.inverse @ Z, maps.inverse @ right
        capacitance = self._inner(Z, scaled)
        k = len(missing)
        count = len(capacitance) - k  # of the columns of U
        capacitance[:count, :count] += self._E_inverse
        capacitance[count:, count:] += LEAST_SOFTNESS * np.eye(k) + unit**2 * softness.toarray()
        wanted = self._inner(Z, without_pairs) - np.append(np.zeros(count), unit * missing)
        coefficients = self._agreed(solve_or_fit(capacitance, wanted))
        return without_pairs - scaled @ coefficients, -unit * coefficients[count:]


#: The product of a vector x with A is kept if the new part of x, which is A-orthogonal to all
#: vectors with known products, has more than this fraction of the energy x'A x. When the new part
#: is normalised, its rounding errors are divided by the root of the fraction that it has.
NEW_ENERGY = 1e-10

#: The Rayleigh quotient x'A x / x'x of the new part of a vector (see `NEW_ENERGY`) counts as
#: rounding up to this multiple of the largest quotient so far. Quotients of this size occur if rows
#: of B are linearly dependent, since A is then singular.
NULL_ENERGY = 1e-12

#: A product is kept if its new part has an energy norm above this multiple of its error.
RESOLVED = 1.5

#: A pair (w, A w) is kept for later solves if its error, in the norm sqrt(e'A^-1 e), is at most
#: this fraction of its energy norm. Less accurate pairs spoil the model of A: with twice the limit,
#: one of some hundred random load steps with multigrid and rtol=1e-8 ends with STAGNATED.
LASTING_ERROR = 0.15

#: Rounding error of a product, relative to its norm, and of q, relative to |lambda| |r|.
PRODUCT_ROUNDING = 4 * float(np.finfo(float).eps)


class ProductStore:
    """Pairs (w, A w) from all products so far: the columns of W and Y = A W, with W'A W = I.

    Pairs remain valid for all loads and slip bounds, since A stays the same.

    Attributes:
        W: (size, pairs) vectors.
        Y: (size, pairs) products A W.
        errors: (pairs,) errors e of the columns of Y, in the norm sqrt(e'A^-1 e).
        scale: factor on the estimate of diag(A), at most 1: the energy of the new part of the
            newest pair, divided by the energy that this part has with diag(A) in place of A. The
            factor tends to fall, since new parts oscillate more and more, and diag(A) is too large
            for vectors that oscillate. (It matters where there is no near field.)
        capacity: limit on the number of pairs. If it is exceeded, the pairs are replaced by
            capacity / 2 combinations of them, which belong to the largest eigenvalues of A.
        near: store of products with the near field, a cheap operator D, approximately with
            0 < D <= A; None: there is no near field. The better D approximates A for vectors that
            oscillate between nodes, the fewer products with A are needed.
        apply_near: function that applies D to (size,), if there is a near field.
    """

    def __init__(
        self,
        reductions: Reductions,
        diagonal: Array,
        capacity: int = 120,
        apply_near: Callable[[Array], Array] | None = None,
    ) -> None:
        """Create a store without pairs (w, A w).

        The diagonal (size,) estimates diag(A) > 0, equally for all degrees of freedom of a friction
        disc. It affects the number of products, not the result.
        """
        self._reductions, self._diagonal, self.scale = reductions, diagonal, 1.0
        self.near: ProductStore | None = None
        if apply_near is not None:
            # each product with D slows down all algebra with the model; more than 40 save few
            # products with A (slender strip: 4.3 instead of 4.6 per load step)
            self.near = ProductStore(reductions, diagonal, capacity=40)
            self.apply_near = apply_near
        self.capacity = capacity
        self.W: Array = np.empty((len(diagonal), 0))
        self.Y: Array = np.empty((len(diagonal), 0))
        self.errors: Array = np.empty(0)
        self._largest = 0.0  # largest Rayleigh quotient of new parts so far

    def __len__(self) -> int:
        """Return the number of pairs."""
        return int(self.W.shape[1])

    def add(self, x: Array, product: Array, error: float = 0.0) -> bool:
        """Add a pair (x, A x), unless its new part is smaller than errors or rounding. Collective.

        The new part is what is left of the pair without its parts along known pairs. The `error` of
        A x is given in the norm sqrt(e'A^-1 e), without rounding errors. The result is True if the
        new part exceeds its error; the pair was then added, unless its new part may be rounding.
        """
        inner = self._reductions.inner
        energy = float(inner(x, product))
        error = float(np.hypot(error, PRODUCT_ROUNDING * np.sqrt(max(energy, 0.0))))
        if energy <= 0.0:
            return False
        # the new part, A-orthogonal to W: exact pairs need two passes of the Gram-Schmidt process;
        # the second removes the rounding errors of the first. Pairs with errors are not orthonormal
        # and need more passes: else parts along known pairs would remain and be added as new pairs,
        # until there are more pairs than unknowns
        new, new_product = x, product
        coefficients: Array = np.zeros(len(self))
        for number in range(MOST_STEPS):
            along = inner(self.Y, new)
            energy_left = max(float(inner(new, new_product)), 0.0)
            if number >= 2 and np.linalg.norm(along) <= 16.0 * ROUNDING * np.sqrt(energy_left):
                break
            new, new_product = new - self.W @ along, new_product - self.Y @ along
            coefficients = coefficients + along
        error = float(np.hypot(error, np.linalg.norm(self.errors * coefficients)))
        new_energy = float(inner(new, new_product))
        if new_energy <= (RESOLVED * error) ** 2:
            return False
        square = float(inner(new, new))
        self._largest = max(self._largest, new_energy / square)
        least = max(NEW_ENERGY * energy, NULL_ENERGY * self._largest * square)
        if new_energy > least:
            self._append(new, new_product, error, new_energy)
        return True

    def split(self, x: Array) -> tuple[Array, Array]:
        """Return the part of x that is A-orthogonal to W, and A (x - this part). Collective."""
        product = np.zeros_like(x)
        for _ in range(2):  # the second pass removes rounding errors of the first
            coefficients = self._reductions.inner(self.Y, x)
            x = x - self.W @ coefficients
            product = product + self.Y @ coefficients
        return x, product

    def product(self, x: Array) -> tuple[Array, float]:
        """Return an approximation of A x from the pairs, and its error. Collective.

        The approximation is A times the part of x in the span of W. The error, in the norm
        sqrt(e'A^-1 e), contains the errors of the pairs, and the energy of the other part of x,
        computed with diag(A) in place of A.
        """
        new, product = self.split(x)
        inner, diagonal = self._reductions.inner, self.scale * self._diagonal
        error = np.linalg.norm(self.errors * inner(self.Y, x))
        return product, float(np.hypot(error, np.sqrt(inner(new, diagonal * new))))

    def _append(self, new: Array, product: Array, error: float, energy: float) -> None:
        """Keep the new part of a pair, divided by the root of its energy. Collective.

        If there are too many pairs, their number is reduced to half the capacity.
        """
        self.scale = min(1.0, energy / float(self._reductions.inner(new, self._diagonal * new)))
        root = np.sqrt(energy)
        self.W = np.column_stack([self.W, new / root])
        self.Y = np.column_stack([self.Y, product / root])
        self.errors = np.append(self.errors, error / root)
        if len(self) > self.capacity:
            # eigenvectors of the largest eigenvalues of Y'Y, with which W stays A-orthonormal
            _, vectors = eigh(self._reductions.inner(self.Y, self.Y))
            kept = self._reductions.from_first_rank(vectors[:, -(self.capacity // 2) :])
            self.W, self.Y = self.W @ kept, self.Y @ kept
            self.errors = np.sqrt(np.square(kept).T @ np.square(self.errors))

    def drop_inaccurate_pairs(self) -> None:
        """Drop pairs whose errors exceed `LASTING_ERROR`, before a new solve. Not collective."""
        kept = self.errors <= LASTING_ERROR
        self.W, self.Y, self.errors = self.W[:, kept], self.Y[:, kept], self.errors[kept]

    @property
    def largest_eigenvalue_estimate(self) -> float:
        """An estimate of sigma_max of A from below, a Ritz value; 0 without pairs. Collective."""
        near_estimate = 0.0 if self.near is None else self.near.largest_eigenvalue_estimate
        if len(self) == 0:
            return near_estimate
        # for exact pairs, the eigenvalues of Y'Y are the Ritz values of A on the span of A^(1/2) W
        values, vectors = eigh(self._reductions.inner(self.Y, self.Y))
        # an eigenvector v of Y'Y with errors e, Y v = A W v + e, has the value v'Y'Y v, at most
        # sigma_max (sqrt(v'W'A W v) + |e|)^2 with |e| = sqrt(e'A^-1 e); and 1 = v'W'Y v makes the
        # root at most 1 + |e|. Errors of pairs are correlated: their bounds are added
        errors = self.errors @ np.abs(vectors)
        least = self._reductions.from_first_rank(values / np.square(1.0 + 2.0 * errors))
        return max(float(least.max()), near_estimate)

    def model(self, base: BlockBFGSModel | None = None) -> BlockBFGSModel:
        """Return the model of A: the diagonal, updated with all pairs. Collective.

        A model of the near field, given as `base`, takes the place of the diagonal.
        """
        return BlockBFGSModel(self._reductions, self.scale * self._diagonal, self.W, self.Y, base)


#: Shift that `WholeModel` adds to the diagonal of A at first, divided by the compliance of nodes
#: whose neighbours are fixed. (The diagonal of A would be no measure: slender bodies bend a million
#: times as much as their surfaces are pressed in.) With 1e-10, a wall of 52 bricks that is pushed
#: is not solved; with 1e-3, it takes twice as many steps of Newton's method.
SHIFT = 1e-5


class WholeModel:
    """The model M = A + diag(s) of A, whose matrix is known: the exact problem but for the shift s.

    The matrix is sparse for assemblies of many small bodies, since A couples only multipliers of
    the same body; otherwise it is dense. A is singular if rows of B are linearly dependent, as at
    corners of bricks that touch two other bricks; the shift s makes M positive definite. Since
    gradients are computed with A, the iteration with M is a proximal point method (Rockafellar
    1976): its solution is the solution for A, and the error falls by the factor s / (s + sigma) in
    each iteration, where sigma is the least positive eigenvalue of A. A direct solver replaces
    Woodbury's formula of `BlockBFGSModel`. Every rank has the matrix.

    Attributes:
        diagonal: (size,) diag(A).
        model_diagonal: (size,) diag(A), too, as diag(M) differs by the small shift only.
        unit: mean of diag(A) over all ranks.
    """

    def __init__(
        self,
        reductions: Reductions,
        rows: Matrix,
        begin: int,
        local_compliance: Array,
        solve: Callable[[csr_array, Array], Array],
    ) -> None:
        """Prepare products. Collective.

        This rank's `rows` (size, n) of A start at the row `begin` of A. The `local_compliance`
        (size,) is that of nodes whose neighbours are fixed. If A is sparse, every rank calls
        `solve(matrix, right)` to solve systems with sparse matrices that are not symmetric.
        """
        self._reductions, self._solve = reductions, solve
        own, n = rows.shape
        self._mine, self._count = slice(begin, begin + own), int(n)
        self.diagonal: Array = rows[:, self._mine].diagonal()
        self.model_diagonal = self.diagonal
        self.unit = float(reductions.inner(self.diagonal, np.ones(own))) / max(n, 1)
        self._matrix = reductions.stacked(rows) if issparse(rows) else self._gathered(rows)
        self._shift = self._gathered(SHIFT / FORCING * local_compliance)
        self.reduce_shift()

    def reduce_shift(self) -> None:
        """Divide s by ten, so that the error falls faster; s stays above the rounding of A."""
        least = PRODUCT_ROUNDING * self._matrix.diagonal()
        self._shift = np.maximum(FORCING * self._shift, least)
        self._shifted = self._matrix + diags_array(self._shift, format="csr")

    def __len__(self) -> int:
        """Return the number n of multipliers of all ranks: so many products are known."""
        return self._count

    def add(self, x: Array, product: Array, error: float = 0.0) -> bool:
        """Return False: nothing is added, since all products are known."""
        return False

    def split(self, x: Array) -> tuple[Array, Array]:
        """Return zeros and A x, (size,) each, like `ProductStore.split`. Collective."""
        return np.zeros_like(x), self.product(x)[0]

    def product(self, x: Array) -> tuple[Array, float]:
        """Return A x (size,), and its error, which is zero. Collective."""
        return self._matrix[self._mine] @ self._gathered(x), 0.0

    def model(self) -> WholeModel:
        """Return the model itself, like `ProductStore.model`."""
        return self

    def apply(self, x: Array) -> Array:
        """Return M x for x of shape (size,) or (size, columns). Collective."""
        return np.asarray(self._shifted[self._mine] @ self._gathered(x))

    @cached_property
    def largest_eigenvalue_estimate(self) -> float:
        """The largest eigenvalue of A, to 0.1 %. Collective at the first access."""
        matrix = self._matrix
        if matrix.shape[0] <= 2:
            return float(np.linalg.eigvalsh(dense(matrix))[-1])
        start = np.ones(matrix.shape[0])
        values = eigsh(matrix, 1, which="LA", v0=start, return_eigenvectors=False, tol=1e-3)
        return float(self._reductions.from_first_rank(values)[0])

    def solve_on_face(
        self, maps: NodalMaps, right: Array, G: csr_array, softness: csr_array, missing: Array
    ) -> tuple[Array, Array]:
        """Return s and c as `BlockBFGSModel.solve_on_face`, by one linear system. Collective.

        `LEAST_SOFTNESS`, divided by the mean of diag(A), is added to the diagonal of S, so that the
        equations have a solution even if the constraints have none.
        """
        unit, n, k = self.unit, len(self), len(missing)
        T, R = self._whole(maps.test), self._whole(maps.added)
        # all further rows are zero in T and have only a diagonal in R: there s = 0
        moving = np.flatnonzero((np.diff(T.indptr) > 0) | (np.diff(R.indptr) > 1))
        T, R = T[moving], R[moving][:, moving]
        matrix = ((T @ self._shifted)[:, moving] + R) / unit
        G = self._reductions.stacked(G)
        soft = unit * softness + LEAST_SOFTNESS * eye_array(k)
        loaded = 1.0 / unit * self._gathered(maps.test @ right)[moving]
        blocks = [[matrix, -(T @ G)], [G[moving].T, soft]] if k else [[matrix]]
        right = np.append(loaded, missing)
        if issparse(matrix) and len(right) > 0:
            values = self._solve(csr_array(block_array(blocks)), right)
        else:
            equations = np.block([[dense(block) for block in row] for row in blocks])
            values = solve_or_fit(equations, right)
        values = self._reductions.from_first_rank(values)
        change = np.zeros(n)
        change[moving] = values[: len(moving)]
        return change[self._mine], unit * values[len(moving) :]

    def _gathered(self, x: Array) -> Array:
        """Return x (size,) or (size, columns) of all ranks, (n,) or (n, columns). Collective."""
        result = np.zeros((self._count, *x.shape[1:]))
        result[self._mine] = x
        return self._reductions.total(result)

    def _whole(self, own: csr_array) -> csr_array:
        """Return the matrix (n, n) of which each rank has the diagonal block `own`. Collective."""
        own = csr_array(own)
        own.eliminate_zeros()
        columns = own.indices + self._mine.start
        rows = csr_array((own.data, columns, own.indptr), shape=(own.shape[0], len(self)))
        return self._reductions.stacked(rows)
