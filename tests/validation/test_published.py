"""Published figures of other programs and of theory.

Coulomb's law: a square plate of 40 mm, in plane strain, lies on a rigid plane; a pressure of 150
MPa from the side pushes it towards its plane of symmetry, one of 50 MPa from above holds it down,
F = 1. It opens at the loaded corner, slips in the middle, and sticks near the plane of symmetry.
The problem is that of a French working group (GRECO), in the special issue on contact with friction
of J. Méc. Théor. Appl. 7, suppl. 1, 1988 (M. Raous, P. Chabrand, F. Lebon; R. A. Feijóo, H. J. C.
Barbosa, N. Zouain). Figures are those of the Code_Aster validation manual, V6.04.128 (SSNV128 A):
displacements are means of several programs, to three digits, which Code_Aster itself meets within
5 %; the force is its own, with quadrilaterals of 1.25 mm, after the mesh has moved.
"""

from __future__ import annotations

import importlib
import itertools
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import ContactStatus, Coulomb
from scenes.blocks import LEFT, block
from scenes.nodal import nodal, surface_nodes_of
from scenes.scene import EPS

#: Scripts of the cases in `docs/validation.md`.
CASES = Path(__file__).parents[2] / "benchmarks" / "published_cases"

SIDE = 40.0  # mm
YOUNG, POISSON, COEFFICIENT = 130e3, 0.2, 1.0  # MPa, -, -
ABOVE_PRESSURE, SIDE_PRESSURE = 50.0, 150.0  # MPa

#: Cells along a side, those of the published force.
N = 32

#: Distances from the loaded corner [mm], and the displacements there [mm] towards the plane of
#: symmetry. Of the last one finer meshes and degree 2 have 1.54.
PLACES = (0.0, 1.25, 5.0, 7.5, 11.25)
DISPLACEMENTS = (2.86e-2, 2.72e-2, 2.28e-2, 1.98e-2, 1.50e-2)
CLOSE = (0.005, 0.005, 0.005, 0.005, 0.03)

#: Normal force [N per mm of thickness] of the node a cell away from the plane of symmetry, and how
#: far the motion of the mesh may change it: the largest strain.
FORCE, STRAIN = 104.864, SIDE_PRESSURE / YOUNG


@pytest.mark.parametrize("steps", [1, 4])
def test_compressed_plate(steps):
    """Displacements and a force of the plate are the published ones, in one step and in four.

    The scene is mirrored: the plate is pushed from the right.
    """
    scene = block(
        MPI.COMM_SELF,
        (N, N),
        size=(SIDE, SIDE),
        load=(0.0, 0.0, 0.0),
        across=[LEFT],
        young=YOUNG,
        poisson=POISSON,
        friction=Coulomb(COEFFICIENT),
        boxes=True,
    )
    with scene.problem(stiffness="cholesky") as problem:
        for part in np.arange(1, steps + 1) / steps:
            scene.data.load.value[1] = -part * ABOVE_PRESSURE
            scene.data.pull.value = -part * SIDE_PRESSURE
            solution = problem.solve(rtol=1e-8)
            assert solution.status is ContactStatus.CONVERGED
            problem.accept()

    x, u = scene.V.tabulate_dof_coordinates(), nodal(solution.u)
    below = np.flatnonzero(np.abs(x[:, 1]) < 1e-9)
    below = below[np.argsort(-x[below, 0])]
    found = np.interp(PLACES, SIDE - x[below, 0], -u[below, 0])
    assert (np.abs(found / DISPLACEMENTS - 1.0) <= CLOSE).all()

    points, fields = surface_nodes_of(solution)
    cell = SIDE / N
    (beside,) = np.flatnonzero(np.abs(points[:, 0] - cell) < 1e-9)
    assert fields["pressure"][beside] * cell == pytest.approx(FORCE, rel=STRAIN)
    counts = solution.counts
    assert counts.idle > 0 and counts.contact > counts.contact_stick > 0  # all three zones


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
