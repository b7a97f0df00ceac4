"""Published figures of other programs and of theory: cases of `docs/validation.md`."""

from __future__ import annotations

import importlib
import itertools
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from scenes.scene import EPS

#: Scripts of the cases in `docs/validation.md`.
CASES = Path(__file__).parents[2] / "benchmarks" / "published_cases"


@pytest.mark.parametrize(
    ("name", "size", "close"),
    [
        ("moose_cylinder", 0.012, 0.006),
        ("kratos_cylinder", 0.1, 0.02),
        ("bulk_tension", 48, 0.03),
        ("triangle", 2, 1e-6),
        ("getfem_disc", 1.0, 0.01),
        ("beam_gap", 16, 0.02),
        ("pushed_block", 32, 0.04),
        ("plate", 32, 0.001),
        ("tilted_punch", 0.032, 0.03),
        pytest.param("twisting", 24, 0.05, marks=pytest.mark.long),
    ],
)
def test_values_of_others(monkeypatch, name, size, close):
    """Cases of `docs/validation.md` on coarse meshes, whose error is most of what is allowed."""
    monkeypatch.syspath_prepend(str(CASES))
    case = importlib.import_module(name).CASE
    found = case.solve(MPI.COMM_SELF, size).values
    for quantity, known in case.published.items():
        assert (1 - close) * known.low <= found[quantity] <= (1 + close) * known.high, quantity


def pressures_of_all_solutions(one, pull, friction):
    """Return the mean pressure over N of each solution of the triangle, for all states of nodes.

    Unknowns are the displacements of contact nodes from those that stick, of which the forces are
    known; a state is open, stick, or slip along the pull or against it.
    """
    x = one.V.tabulate_dof_coordinates()
    held = np.flatnonzero(
        np.isin(np.arange(len(x)), fem.locate_dofs_topological(one.V, 1, one.tags.find(2)))
    )
    touching = np.setdiff1d(np.flatnonzero(np.abs(x[:, 1]) < 1e-9), held)
    inner = np.setdiff1d(np.arange(len(x)), np.concatenate([held, touching]))
    K = fem.assemble_matrix(fem.form(one.a)).to_dense()
    at, others = (np.add.outer(2 * nodes, [0, 1]).ravel() for nodes in (touching, inner))
    S = K[np.ix_(at, at)]
    S = S - K[np.ix_(at, others)] @ np.linalg.solve(
        K[np.ix_(others, others)], K[np.ix_(others, at)]
    )
    weights = np.where(np.isclose(x[touching, 0], 1.0), 0.5, 1.0) / len(touching)
    sticking = np.outer(weights, [-pull, 1.0])  # forces of the plane
    zero = 1e6 * EPS * weights.max()
    found = []
    for states in itertools.product(range(-1, 3), repeat=len(touching)):
        A, b = np.eye(2 * len(touching)), np.zeros(2 * len(touching))
        for i, state in enumerate(states):
            tangent, normal = 2 * i, 2 * i + 1
            if state == 2:  # open
                A[[tangent, normal]], b[[tangent, normal]] = S[[tangent, normal]], -sticking[i]
            elif state:  # slips
                A[tangent] = S[tangent] + state * friction * S[normal]
                b[tangent] = -sticking[i] @ [1.0, state * friction]
        u = np.linalg.solve(A, b)
        force = sticking + (S @ u).reshape(-1, 2)
        u = u.reshape(-1, 2)
        held_by_friction = np.abs(force[:, 0]) <= friction * force[:, 1] + zero
        allowed = [
            u[i, 1] >= -zero
            if state == 2
            else force[i, 1] >= -zero
            and (state * u[i, 0] >= -zero if state else held_by_friction[i])
            for i, state in enumerate(states)
        ]
        if all(allowed):
            found.append(force[:, 1].sum() / weights.sum())
    return sorted(found)


def test_number_of_solutions_of_the_triangle(monkeypatch):
    """Below the critical coefficient there is one solution, beyond it there are up to three."""
    monkeypatch.syspath_prepend(str(CASES))
    triangle = importlib.import_module("triangle")
    one = triangle.scene(MPI.COMM_SELF, 4)
    slipping = triangle.slipping(triangle.THREE, triangle.BEYOND)
    for friction, pull, pressures in (
        (triangle.BELOW, triangle.SLIPS, [triangle.slipping(triangle.SLIPS, triangle.BELOW)]),
        (triangle.BELOW, triangle.THREE, [0.0]),
        (triangle.BEYOND, triangle.SLIPS, [1.0]),
        (triangle.BEYOND, triangle.THREE, [0.0, slipping, 1.0]),
        (triangle.BEYOND, triangle.JUMP, [0.0]),
    ):
        found = pressures_of_all_solutions(
            one, pull * triangle.CRITICAL, friction * triangle.CRITICAL
        )
        assert found == pytest.approx(pressures, abs=1e6 * EPS)
