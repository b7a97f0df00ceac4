"""Solve the pinched beams of Abaqus, as thin strips.

At each gap one node of each beam may touch: at all other nodes a gap of 1 is added. A load is
spread over two cells. The last quantity is the number of gaps that are open or closed as in the
table, of 50.
"""

from __future__ import annotations

import itertools

from mpi4py import MPI

import numpy as np
from case import Case, Result, next_step

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Frictionless
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed
from scenes.nodal import node_function

#: Gap, bending stiffness and thickness; the unit of length is a fifth of a beam.
GAP, STIFFNESS, THICKNESS = 0.01, 2163.0, 0.02

#: Length of the beams, and position of the loads.
LENGTH, LOADED = 5, 2.0

#: For each gap the numbers of the beams above and below it, from the top, and its position.
GAPS = ((0, 1, 1.0), (0, 1, 3.0), (0, 1, 5.0), (1, 2, 1.0), (1, 2, 3.0))

#: Load -> force in each gap; zero if the gap is open.
TABLE = {
    20.0: (0.0, 6.5, 0.732, 0.0, 7.97),
    40.0: (0.0, 18.3, 0.0, 0.0, 18.3),
    60.0: (0.0, 28.7, 0.0, 0.0, 28.7),
    80.0: (0.0, 39.1, 0.0, 0.0, 39.1),
    100.0: (0.0, 49.5, 0.0, 0.0, 49.5),
    120.0: (0.0, 59.8, 0.0, 0.0, 59.8),
    140.0: (10.7, 68.6, 0.0, 10.7, 68.6),
    160.0: (31.6, 75.9, 0.0, 31.6, 75.9),
    180.0: (52.5, 83.2, 0.0, 52.5, 83.2),
    200.0: (73.4, 90.4, 0.0, 73.4, 90.4),
}

#: Forces that are compared: for each the load, and the number of the gap, counted from zero; the
#: last quantity is the number of gaps that are open or closed as in the table, of 50.
SHOWN = ((20.0, 1), (20.0, 2), (20.0, 4), (120.0, 1), (140.0, 0), (200.0, 0), (200.0, 1))

#: Tags of the first gap's sides and the clamped ends; of the loads, with beam and side.
UPPER, LOWER, CLAMPED, PUSHED_DOWN, PUSHED_UP = 10, 20, 1, (2, 0, 0), (3, 2, 3)


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along a fifth of the length. Collective."""
    cells = int(n)
    heights = THICKNESS * np.arange(3, -1, -1)  # without the added gaps the beams touch
    beams = [
        Body((LENGTH * cells, 1), [(0.0, LENGTH), (low, high)])
        for high, low in itertools.pairwise(heights)
    ]
    made = boxes(comm, "quadrilateral", beams, degree=2)

    def around(side: int, place: float):
        """Return a function that says which points are near a position on a side of a beam."""
        return lambda x: np.isclose(x[:, 1], heights[side]) & (abs(x[:, 0] - place) < 1.0 / cells)

    marks = [(CLAMPED, [0, 1, 2], lambda x: np.isclose(x[:, 0], 0.0))]
    marks += [(tag, [beam], around(side, LOADED)) for tag, beam, side in (PUSHED_DOWN, PUSHED_UP)]
    for gap, (upper, lower, place) in enumerate(GAPS):
        for tag, beam in ((UPPER, upper), (LOWER, lower)):
            marks.append((tag + gap, [beam], around(lower, place)))
    tags = made.tags(*marks)
    V, mesh = made.V, made.mesh
    ds, v = ufl.Measure("ds", mesh, subdomain_data=tags), ufl.TestFunction(V)
    pinch = fem.Constant(mesh, 0.0)
    L = 0.5 * cells * pinch * (v[1] * ds(PUSHED_UP[0]) - v[1] * ds(PUSHED_DOWN[0]))
    pairs = []
    for gap, (_, _, place) in enumerate(GAPS):
        far = node_function(mesh, lambda x, at=place: np.where(np.isclose(x[0], at), GAP, 1.0))
        pairs.append(ContactPair(tags, UPPER + gap, LOWER + gap, Frictionless(), gap=far))
    a = elasticity(V, 12.0 * STIFFNESS / THICKNESS**3, 0.0)
    bcs = [fixed(V, tags.find(CLAMPED))]
    found = {0.0: np.zeros(len(GAPS))}
    with ContactProblem(a, L, pairs, bcs) as problem:
        for load in TABLE:
            pinch.value = load
            resultants = next_step(problem).pair_resultants
            found[load] = np.array([resultant.force[1] for resultant in resultants])
    right = sum(((found[load] > 0.0) == (np.array(TABLE[load]) > 0.0)).sum() for load in TABLE)
    values = CASE.named(*(found[load][gap] for load, gap in SHOWN), right)
    return Result(values, V, np.array(list(found)), np.array([one[1] for one in found.values()]))


FORCES = [forces[1] for forces in TABLE.values()]
CASE = Case.read(__file__, solve, marks=(list(TABLE), FORCES))
