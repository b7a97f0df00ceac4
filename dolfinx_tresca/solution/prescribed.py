"""The dependence of prescribed values on the Constants and Functions of Dirichlet conditions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices


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


def values_of(control: fem.Constant | fem.Function) -> Array:
    """Return the values of a control, as a flat array that shares their memory."""
    found = control.value if hasattr(control, "value") else control.x.array
    return np.asarray(found).reshape(-1)


@contextmanager
def replaced(
    controls: Sequence[fem.Constant | fem.Function], values: Sequence[Array]
) -> Iterator[None]:
    """Replace the values of controls inside the block."""
    present = [values_of(control) for control in controls]
    before = [one.copy() for one in present]
    for one, value in zip(present, values, strict=True):
        one[:] = value
    try:
        yield
    finally:
        for one, value in zip(present, before, strict=True):
            one[:] = value
