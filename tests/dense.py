"""Random dense problems for hypothesis, and a reference that shares no code with the solvers."""

from __future__ import annotations

import clarabel
import numpy as np
from conic import conic_minimum
from hypothesis import strategies as st

from dolfinx_tresca.solvers.constraints import EqualityConstraints
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from scenes.dense import DenseProblem, OneRank, random_problem


@st.composite
def problems(draw: st.DrawFn, most_nodes: int = 12, most_decades: float = 3.0) -> DenseProblem:
    return random_problem(
        draw(st.integers(0, 10**6)),
        draw(st.integers(1, most_nodes)),
        draw(st.floats(0.0, most_decades)),
        draw(st.sampled_from([0.1, 1.0, 10.0])),
    )


def clarabel_minimum(
    A: np.ndarray,
    b: np.ndarray,
    lam: FeasibleSet,
    tolerance: float = 1e-10,
    constraints: EqualityConstraints | None = None,
) -> np.ndarray:
    """The minimiser of q over Lambda by an interior-point method with second-order cones.

    With constraints: that of q + c'S c / 2, with G'lambda + S c = e.
    """
    if constraints is None:
        constraints = EqualityConstraints.none(np.arange(lam.size), OneRank())
    # the solver's absolute tolerances are for numbers of size 1
    size = np.linalg.norm(np.append(b, constraints.values))
    rows, right, cones = [], [], []
    k, G, S = len(constraints), constraints.columns.toarray(), constraints.softness.toarray()
    A = np.block([[A, np.zeros_like(G)], [np.zeros_like(G.T), S]])
    b = np.append(b, np.zeros(k))

    def add(block: np.ndarray, rhs: np.ndarray, cone: object, soft: np.ndarray | None = None):
        rows.append(np.hstack([block, np.zeros((len(block), k)) if soft is None else soft]))
        right.append(rhs)
        cones.append(cone)

    identity = np.eye(lam.size)
    if k:
        add(G.T, constraints.values / size, clarabel.ZeroConeT(k), soft=S)
    add(
        -identity[lam.normal], np.zeros(len(lam.normal)), clarabel.NonnegativeConeT(len(lam.normal))
    )
    for node, g in enumerate(lam.radius):
        own = lam.tangential[lam.node == node]
        if len(own) == 0:
            continue
        if g == 0.0:
            add(identity[own], np.zeros(len(own)), clarabel.ZeroConeT(len(own)))
        else:
            block = np.vstack([np.zeros(lam.size), -identity[own]])
            add(block, np.r_[g / size, np.zeros(len(own))], clarabel.SecondOrderConeT(len(own) + 1))
    solution = conic_minimum(A, -b / size, rows, right, cones, tolerance)
    assert str(solution.status) in ("Solved", "AlmostSolved"), solution.status
    return size * np.array(solution.x)[: lam.size]
