"""Random dense problems for hypothesis, and a reference that shares no code with the solvers."""

from __future__ import annotations

import clarabel
import numpy as np
from conic import conic_minimum
from hypothesis import strategies as st

from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from scenes.dense import DenseProblem, random_problem


@st.composite
def problems(draw: st.DrawFn, most_nodes: int = 12, most_decades: float = 3.0) -> DenseProblem:
    return random_problem(
        draw(st.integers(0, 10**6)),
        draw(st.integers(1, most_nodes)),
        draw(st.floats(0.0, most_decades)),
        draw(st.sampled_from([0.1, 1.0, 10.0])),
    )


def clarabel_minimum(
    A: np.ndarray, b: np.ndarray, lam: FeasibleSet, tolerance: float = 1e-10
) -> np.ndarray:
    """The minimiser of q over Lambda by an interior-point method with second-order cones."""
    size = np.linalg.norm(b)  # the solver's absolute tolerances are for numbers of size 1
    identity, normal = np.eye(lam.size), len(lam.normal)
    rows, right = [-identity[lam.normal]], [np.zeros(normal)]
    cones: list[object] = [clarabel.NonnegativeConeT(normal)]
    for node, g in enumerate(lam.radius):
        own = lam.tangential[lam.node == node]
        if len(own) == 0:
            continue
        if g == 0.0:
            rows.append(identity[own])
            right.append(np.zeros(len(own)))
            cones.append(clarabel.ZeroConeT(len(own)))
        else:
            rows.append(np.vstack([np.zeros(lam.size), -identity[own]]))
            right.append(np.r_[g / size, np.zeros(len(own))])
            cones.append(clarabel.SecondOrderConeT(len(own) + 1))
    solution = conic_minimum(A, -b / size, rows, right, cones, tolerance)
    assert str(solution.status) in ("Solved", "AlmostSolved"), solution.status
    return size * np.array(solution.x)
