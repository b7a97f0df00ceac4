"""The displacement as a component of a mixed space, which has further unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca._base.arrays import LocalNumbers, Mask
from dolfinx_tresca._base.compat import collapse
from dolfinx_tresca._base.functions import zero_like
from dolfinx_tresca._base.petsc import sparse_matrix


class Component:
    """One sub-space of a mixed space, in a numbering of its own.

    A node on the border of two ranks may have one owner in the sub-space, and another owner in the
    mixed space. So `of` needs ghost values.

    Attributes:
        V: the collapsed sub-space, on which Functions can be created.
        mask: (owned degrees of freedom of the mixed space,) whether each is in the component.
    """

    def __init__(self, space: Any, index: int) -> None:
        """Collapse the sub-space, which gives its degrees of freedom other numbers. Collective.

        Args:
            space: the mixed space.
            index: index of the sub-space in the mixed space.
        """
        self._space, self._index = space, index
        self.comm = space.mesh.comm
        self.V, self._dofs = collapse(space.sub(index))
        self._original = fem.Function(self.V)
        own, whole = self.V.dofmap, space.dofmap.index_map
        flags = fem.Function(space)
        flags.x.array[self._dofs] = 1.0
        self.mask: Mask = flags.x.array[: whole.size_local] > 0.0
        owned = own.index_map.size_local * own.index_map_bs
        entries = np.ones(owned), whole.local_to_global(self._dofs[:owned]), np.arange(owned + 1)
        rows = csr_array(entries, shape=(owned, whole.size_global))
        self._parts = sparse_matrix(rows, (whole.size_local, whole.size_global), space.mesh.comm)

    def extract(self, w: fem.Function) -> fem.Function:
        """Return this component of a Function w on the mixed space. Not collective.

        The ghost values of w must be up to date.
        """
        component = zero_like(self._original, w.name)
        component.x.array[:] = w.x.array[self._dofs]
        return component

    @cached_property
    def _others(self) -> list[tuple[Any, LocalNumbers]]:
        """The other sub-spaces, each in a numbering of its own. Collective."""
        number = len(self._space.ufl_element().sub_elements)
        return [collapse(self._space.sub(i)) for i in range(number) if i != self._index]

    def other_parts(self, w: fem.Function) -> list[fem.Function]:
        """Return the other components of a Function on the mixed space. Collective."""
        functions = [fem.Function(Q) for Q, _ in self._others]
        for function, (_, dofs) in zip(functions, self._others, strict=True):
            function.x.array[:] = w.x.array[dofs]
        return functions

    def compose(self, w: fem.Function, u: fem.Function, remaining: Sequence[fem.Function]) -> None:
        """Set this component of w to u, and its other components to `remaining`. Collective.

        The order of `remaining` is that of `other_parts`.
        """
        w.x.array[self._dofs] = u.x.array
        for component, (_, dofs) in zip(remaining, self._others, strict=True):
            w.x.array[dofs] = component.x.array

    def columns(self, B: PETSc.Mat) -> PETSc.Mat:
        """Convert a matrix B from the columns of V to the columns of the mixed space. Collective.

        The caller owns the new matrix.
        """
        return B.matMult(self._parts)

    def block(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return the component's block of K, numbered like V; the caller owns it. Collective."""
        columns = self._parts.copy().transpose()
        return K.ptap(columns)
