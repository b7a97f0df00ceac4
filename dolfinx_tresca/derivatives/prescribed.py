"""The dependence of prescribed values on the Constants and Functions of Dirichlet conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Indices
from dolfinx_tresca.dual.nodal_values import replaced, values_of


def sources_of_prescribed(bcs: Sequence[Any], control: Any, size: int) -> Indices:
    """Return for each degree of freedom which value of a control is prescribed there.

    Not collective.

    Args:
        bcs: Dirichlet conditions; the last condition that prescribes a value counts.
        control: a Constant or a Function.
        size: number of this rank's degrees of freedom, in local order: owned degrees of freedom
            come first.

    Returns:
        (size,) position in the control's values; -1 where no value of the control is prescribed.
    """
    result = np.full(size, -1, dtype=np.intp)
    numbers = np.arange(values_of(control).size, dtype=np.float64)
    for bc in bcs:
        # DOLFINx does not say which value a condition takes: the effect of its bc.set shows it
        marked, numbered = np.zeros(size), np.full(size, -1.0)
        with replaced([control], [np.full(numbers.size, np.nan)]):
            bc.set(marked)
        with replaced([control], [numbers]):
            bc.set(numbered)
        dofs = bc.dof_indices()[0]
        dofs = dofs[dofs < size]
        result[dofs] = np.where(np.isnan(marked[dofs]), numbered[dofs], -1.0).astype(np.intp)
    return result
