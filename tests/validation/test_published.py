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
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import ContactStatus, Coulomb
from scenes.blocks import LEFT, block
from scenes.nodal import nodal, surface_nodes_of

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
    """At once, and in load steps: loads grow together, so that nothing slips back.

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
    ],
)
def test_values_of_others(monkeypatch, name, size, close):
    """Cases of `docs/validation.md` on coarse meshes, whose error is most of what is allowed."""
    monkeypatch.syspath_prepend(str(CASES))
    case = importlib.import_module(name).CASE
    found = case.solve(MPI.COMM_SELF, size).values
    for quantity, known in case.published.items():
        assert (1 - close) * known.low <= found[quantity] <= (1 + close) * known.high, quantity
