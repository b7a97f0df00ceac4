"""Linear equations that multipliers must satisfy besides Lambda, exactly or softly. Numpy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, eye_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices
from dolfinx_tresca.solvers.nodal_maps import NodalPattern
from dolfinx_tresca.solvers.reductions import Reductions
from dolfinx_tresca.solvers.sparse_factors import eigenpairs


@dataclass(frozen=True)
class EqualityConstraints:
    """The k equations G'x + S c = e for multipliers x in Lambda and multipliers c of the equations.

    Equations with S = 0 are exact, and c are their Lagrange multipliers. Equations with S > 0 are
    soft: the term (e - G'x)'S^-1 (e - G'x) / 2 is added to q, and c = S^-1 (e - G'x). In both
    cases, the gradient in x is A x - b - G c. With k = 0, there are no equations, and no method
    communicates.

    The equations express the equilibrium of floating bodies (`floating/equilibrium.py`); this
    module does not depend on that meaning.

    Methods are collective.

    Attributes:
        columns: G (size, k), with columns of length 1 or less. Each row has entries for few bodies
            only.
        softness: (k, k) S, symmetric and positive semidefinite.
        values: (k,) e.
        sizes: (k,) sums of the absolute values of the terms of e, from which rounding errors are
            estimated.
        reductions: sums over the ranks.
        nodes: (size,) the node of each multiplier.
    """

    columns: csr_array
    softness: csr_array
    values: Array
    sizes: Array
    reductions: Reductions
    nodes: Indices

    @classmethod
    def none(cls, nodes: Indices, reductions: Reductions) -> EqualityConstraints:
        """Return an empty set of equations for multipliers of the nodes (size,)."""
        G, none = csr_array((len(nodes), 0)), np.empty(0)
        return cls(G, csr_array((0, 0)), none, none, reductions, nodes)

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def absolute(self) -> csr_array:
        """The absolute values of G."""
        return abs(self.columns)

    @cached_property
    def _rows(self) -> csr_array:
        """G', which SciPy would otherwise transpose at every product."""
        return csr_array(self.columns.T)

    def along(self, x: Array) -> Array:
        """Return G'x (k,)."""
        return self.reductions.total(self._rows @ x) if len(self) else np.empty(0)

    def along_absolute(self, x: Array) -> Array:
        """Return |G|'x, (k,) or (k, columns), with the absolute values of G."""
        return self.reductions.total(abs(self._rows) @ x)

    def hessian(self, derivative: Callable[[Array], Array]) -> csr_array:
        """Return G'D G, (k, k), the same on all ranks.

        Args:
            derivative: function that applies D to an array (size, columns); D is symmetric and
                couples only multipliers of the same node.
        """
        D = self._pattern.matrix(derivative)
        return self.reductions.sparse_inner(self.columns, csr_array(D @ self.columns))

    @cached_property
    def _pattern(self) -> NodalPattern:
        """The pattern of matrices that couple only multipliers of the same node."""
        return NodalPattern(self.nodes)

    def softness_with(self, added: float) -> csr_array:
        """Return S + s (I - V V'), with the `soft_directions` V and a number s >= 0: (k, k)."""
        return csr_array(self.softness + added * self._exact_directions) if added else self.softness

    @cached_property
    def _exact_directions(self) -> csr_array:
        """The projector I - V V' onto the directions of equations that are not soft."""
        vectors = self.soft_directions[1]
        return csr_array(eye_array(len(self)) - vectors @ vectors.T)

    def residual(self, x: Array, c: Array) -> Array:
        """Return e - G'x - S c, (k,)."""
        return np.asarray(self.values - self.along(x) - self.softness @ c)

    def imbalance(self, x: Array, c: Array) -> float:
        """Return the norm of the residual of the equations, divided by that of their terms."""
        if len(self) == 0:
            return 0.0
        terms = self.along_absolute(np.abs(x)) + abs(self.softness) @ np.abs(c) + self.sizes
        size = float(np.linalg.norm(terms))
        return float(np.linalg.norm(self.residual(x, c))) / size if size > 0.0 else 0.0

    def violation(self, x: Array, c: Array) -> float:
        """Return sqrt(d'S d) for the change d of c with which the soft equations hold at x.

        For floating bodies, the result is the energy norm of the rigid displacements that are
        missing for equilibrium.
        """
        values, vectors = self.soft_directions
        missing = vectors.T @ self.residual(x, c)
        return float(np.sqrt(missing @ (missing / values)))

    @cached_property
    def soft_directions(self) -> tuple[Array, csr_array]:
        """The eigenvalues of S that exceed rounding errors, and their eigenvectors (k, number)."""
        if not self.softness.nonzero()[0].size:
            return np.empty(0), csr_array((len(self), 0))
        values, vectors = eigenpairs(self.softness)
        values = self.reductions.from_first_rank(values)
        vectors.data = self.reductions.from_first_rank(vectors.data)
        kept = values > ROUNDING * values.max()
        return values[kept], vectors[:, kept]
