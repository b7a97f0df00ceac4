"""Quadratic programmes over cones, by an interior-point method that shares no code with ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import clarabel
import numpy as np
from scipy.sparse import csc_array, triu, vstack


def conic_minimum(
    P: Any,
    q: np.ndarray,
    rows: Sequence[Any],
    right: Sequence[np.ndarray],
    cones: Sequence[Any],
    tolerance: float,
) -> Any:
    """Return Clarabel's solution, with the minimiser `x`, the cones' multipliers `z` and `status`.

    It minimises x'P x / 2 + q'x with right - rows x in the product of the cones, such as
    `clarabel.NonnegativeConeT(m)`, each with rows (m, n) and right (m,). P (n, n) and rows may be
    sparse. The tolerance is that of the gap and of feasibility.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return clarabel.DefaultSolver(
        csc_array(triu(csc_array(P))),
        q,
        csc_array(vstack([csc_array(block) for block in rows])),
        np.concatenate(right),
        list(cones),
        settings,
    ).solve()
