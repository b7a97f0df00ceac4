"""Every product that was paid for, kept as A-orthonormal pairs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.far_field import FarField
from dolfinx_tresca.optimise.reductions import Reductions

#: Part of the energy x'A x of a vector that must be new for its product to be kept: rounding of a
#: pair grows by one over its root.
NEW_ENERGY = 1e-10

#: Rayleigh quotient x'A x / x'x of what is new, over the largest so far, that is rounding: where
#: constraints are dependent A is singular.
NULL_ENERGY = 1e-12

#: Energy norm of what is new in a product over its error, from which on it is worth keeping.
RESOLVED = 1.5

#: Factor between errors, in the norm sqrt(e'A^-1 e), that makes a difference: of a pair over that
#: of a new one in its place; of a pair, as a product finds it, over what was expected.
WORSE_ERROR = 2.0

#: Error of a pair, in that norm and over the pair's own energy norm, up to which it is of use to
#: later solves: worse ones spoil the model more than they save products (17 instead of 10 a step,
#: over 400 random load steps).
LASTING_ERROR = 0.3

#: Part along the pairs, over what is new of a vector, that is rounding; and passes of Gram and
#: Schmidt at most to come so far. Exact pairs need two.
KNOWN_ROUNDING, MOST_PASSES = 1e3 * float(np.finfo(float).eps), 20

#: Relative error of a product by rounding.
PRODUCT_ROUNDING = 4 * float(np.finfo(float).eps)


class ProductStore:
    """Pairs W, Y = A W with W'A W = I, from all products of a problem so far.

    A does not change between Newton steps, load steps or slip bounds, so the pairs stay valid. When
    the stiffness changes they are not; but most of what they say of A still is: see `successor`.

    Attributes:
        W: (size, k) the vectors.
        Y: (size, k) their products.
        errors: (k,) errors of Y, in the norm |e| = sqrt(e'A^-1 e).
        scale: the energy of what was new in the newest pair over what diag(A) makes of it, or 1 if
            that is less: what is left becomes rougher, and diag(A) too large for it.
        far: what an earlier A had beyond the diagonal, or what else stands in for A where no pair
            is known; None: nothing is known of one.
        capacity: number of pairs kept; when there are more, half of that stays: those combinations
            that hold the largest eigenvalues of A.
    """

    def __init__(self, reductions: Reductions, diagonal: Array, capacity: int = 120) -> None:
        """Begin without pairs.

        Args:
            reductions: over the ranks.
            diagonal: (size,) an estimate of diag(A) > 0, the same for all degrees of freedom of a
                friction disc. It steers speed, not results.
            capacity: see the class.
        """
        self._reductions, self._diagonal = reductions, diagonal
        self.capacity = capacity
        self.W: Array = np.empty((len(diagonal), 0))
        self.Y: Array = np.empty((len(diagonal), 0))
        self.errors: Array = np.empty(0)
        self.scale = 1.0
        self.far: FarField | None = None
        self._largest = 0.0  # Rayleigh quotient of what was new

    def successor(self, change: Array, ground: BlockBFGSModel | None = None) -> ProductStore:
        """Return a store for another A, without pairs but with the far field of this one.

        Collective.

        Args:
            change: (size,) diag(A) of the other one over that of this one, the same for all degrees
                of freedom of a friction disc.
            ground: model that stands in for this A in place of the diagonal; the other one has one
                of its own.
        """
        diagonal = self.scale * self._diagonal * change
        result = ProductStore(self._reductions, diagonal, self.capacity)
        W = self.W if self.far is None else np.column_stack([self.W, self.far.W])
        if W.shape[1] > 0:
            ground = self._plain() if ground is None else ground
            rest = self.model(ground).apply(W) - ground.apply(W)
            result.far = FarField(self._reductions, W, rest, self.capacity // 2)
        return result

    def __len__(self) -> int:
        return int(self.W.shape[1])

    def add(self, x: Array, product: Array, error: float = 0.0) -> bool:
        """Add a pair x, A x of shape (size,), unless it holds nothing new. Collective.

        A pair whose error would hide what is new in this one makes room for it.

        Args:
            x: the vector.
            product: A x.
            error: of the product, in the norm sqrt(e'A^-1 e), besides rounding.

        Returns:
            whether the error lets one see if there is anything new.
        """
        inner = self._reductions.inner
        energy = float(inner(x, product))
        error = float(np.hypot(error, PRODUCT_ROUNDING * np.sqrt(max(energy, 0.0))))
        if energy > 0.0:
            self._probe(x, product, error, np.sqrt(energy))
        while energy > 0.0:
            parts, new, new_product = self._without_known(x, product)
            doubts = self.errors * np.abs(parts)
            hidden = float(np.hypot(error, np.linalg.norm(doubts)))
            rest = float(inner(new, new_product))
            if rest > (RESOLVED * hidden) ** 2:
                length = float(inner(new, new))
                self._largest = max(self._largest, rest / length)
                if rest > NEW_ENERGY * energy and rest > NULL_ENERGY * self._largest * length:
                    self._append(new, new_product, hidden, rest)
                return True
            if not (doubts > WORSE_ERROR * error).any():
                break
            self._remove(int(np.argmax(doubts)))
        return False

    def _probe(self, x: Array, product: Array, error: float, length: float) -> None:
        """Correct the errors of pairs that a product contradicts; drop those that are too large.

        For exact pairs W'A x and Y'x are the same. Errors e_j of Y, and that of the product,
        explain a difference of |e_j| |x| and of `error` in the energy norm.
        """
        found = np.abs(self._reductions.inner(self.W, product) - self._reductions.inner(self.Y, x))
        wrong = found > WORSE_ERROR * (error + self.errors * length)
        self.errors[wrong] = found[wrong] / length
        for pair in np.flatnonzero(wrong & (RESOLVED * self.errors > 1.0))[::-1]:
            self._remove(int(pair))

    def split(self, x: Array) -> tuple[Array, Array]:
        """Return the part of x that is A-orthogonal to all pairs, and the product of the rest."""
        known = np.zeros_like(x)
        for _ in range(2):  # the second pass removes what rounding left in the first
            coefficients = self._reductions.inner(self.Y, x)
            x = x - self.W @ coefficients
            known = known + self.Y @ coefficients
        return x, known

    def empty(self, capacity: int) -> ProductStore:
        """Return a store of that capacity, without pairs, and with the present scale."""
        return ProductStore(self._reductions, self.scale * self._diagonal, capacity)

    def product(self, x: Array) -> tuple[Array, float]:
        """Return A x as far as it is known, and the error of that. Collective.

        Returns:
            the product (size,) of what in x belongs to pairs, and its error in the norm
            sqrt(e'A^-1 e): that of the pairs, and all of what is new, by diag(A).
        """
        new, known = self.split(x)
        inner = self._reductions.inner
        error = np.linalg.norm(self.errors * inner(self.Y, x))
        energy = self.scale * float(inner(new, self._diagonal * new))
        return known, float(np.hypot(error, np.sqrt(energy)))

    def _without_known(self, x: Array, product: Array) -> tuple[Array, Array, Array]:
        """Return c (k,), x - W c without a part along the pairs, and its product.

        Passes of Gram and Schmidt: two for exact pairs, of which the second removes what rounding
        left in the first, and more for pairs with errors, which are not orthonormal. What two
        passes leave of x along these would look new, and be added once more (47 pairs of 10
        unknowns, and as many steps of one load step).
        """
        inner = self._reductions.inner
        parts: Array = np.zeros(len(self))
        for number in range(MOST_PASSES):
            c = inner(self.Y, x)
            rest = max(float(inner(x, product)), 0.0)
            if number >= 2 and np.linalg.norm(c) <= KNOWN_ROUNDING * np.sqrt(rest):
                break
            x, product, parts = x - self.W @ c, product - self.Y @ c, parts + c
        return parts, x, product

    def _append(self, x: Array, product: Array, error: float, energy: float) -> None:
        inner = self._reductions.inner
        if self.far is None:
            self.scale = min(1.0, energy / float(inner(x, self._diagonal * x)))
        length = np.sqrt(energy)
        self.W = np.column_stack([self.W, x / length])
        self.Y = np.column_stack([self.Y, product / length])
        self.errors = np.append(self.errors, error / length)
        self._cut()

    def _cut(self) -> None:
        """Keep half of what there is room for, where there is more."""
        if len(self) > self.capacity:
            _, vectors = eigh(self._reductions.inner(self.Y, self.Y))
            kept = self._reductions.from_first_rank(vectors[:, -(self.capacity // 2) :])
            self.W, self.Y = self.W @ kept, self.Y @ kept
            self.errors = np.sqrt(np.square(kept).T @ np.square(self.errors))

    def keep_lasting(self) -> None:
        """Drop the pairs that were good enough for the solve that they come from, but no other."""
        for pair in np.flatnonzero(self.errors > LASTING_ERROR)[::-1]:
            self._remove(int(pair))

    def forget(self) -> None:
        """Drop all pairs, and the far field."""
        self.far = None
        self.W, self.Y, self.errors = self.W[:, :0], self.Y[:, :0], self.errors[:0]
        self.scale = 1.0

    def _remove(self, pair: int) -> None:
        self.W, self.Y = np.delete(self.W, pair, axis=1), np.delete(self.Y, pair, axis=1)
        self.errors = np.delete(self.errors, pair)

    def largest_ritz_value(self) -> float:
        """Return a lower bound of sigma_max; 0 without pairs. Collective."""
        known = 0.0 if self.far is None else self.far.largest_eigenvalue
        if len(self) == 0:
            return known
        # the eigenvalues of Y'Y are the Ritz values of A on the span of A^(1/2) W
        values, vectors = eigh(self._reductions.inner(self.Y, self.Y))
        # but for errors: Y v = A W v + e has |Y v|^2 <= sigma_max (|W v| + |e|)^2 in energy norms,
        # and 1 = v'W'Y v tells |W v| <= 1 + |e|. Errors of pairs have much in common: they add up
        errors = self.errors @ np.abs(vectors)
        least = self._reductions.from_first_rank(values / np.square(1.0 + 2.0 * errors))
        return max(float(least.max()), known)

    def fit_far(self, ground: BlockBFGSModel | None = None) -> None:
        """Scale what is kept of an earlier A so that it fits the pairs. Collective.

        Args:
            ground: see `model`.
        """
        if self.far is not None and len(self) > 0:
            self.far.fit(self.W, self._plain() if ground is None else ground)

    def apply(self, x: Array, ground: Callable[[Array], Array]) -> Array:
        """Return M x, (size,), with a function in place of A outside the known pairs. Collective.

        Args:
            x: (size,).
            ground: applies D to (size,), which is called once.
        """
        new, known = self.split(x)
        image = ground(new)
        if self.far is not None:
            image = image + self.far.apply(new)
        return known + image - self.Y @ self._reductions.inner(self.W, image)

    def model(self, ground: BlockBFGSModel | None = None) -> BlockBFGSModel:
        """Return the model of A that the pairs give, on what is known else. Collective.

        Args:
            ground: another model, in place of the diagonal.
        """
        if self.far is not None:
            ground = (self._plain() if ground is None else ground).plus(self.far.root)
        return BlockBFGSModel(self._reductions, self.scale * self._diagonal, self.W, self.Y, ground)

    def _plain(self) -> BlockBFGSModel:
        """Return the diagonal as a model."""
        none = np.empty((len(self._diagonal), 0))
        return BlockBFGSModel(self._reductions, self.scale * self._diagonal, none, none)
