"""How much farther than a half-space the bodies of Cattaneo's scene are shifted by a force."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from scenes.assembled import linear_solution
from scenes.boxes import Body, boxes
from scenes.cattaneo import FAR, POISSON, WIDTH, YOUNG
from scenes.elasticity import elasticity, fixed

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: How much smaller cells are at the disc than at the ends, and its radius [mm].
GRADING, RADIUS = 3.0, 0.1

LOADED, HELD, FRONT = 1, 2, 3


def shift(n: int, end: float) -> float:
    """Return the mean shift of a disc by a unit force, with the weights of its traction [mm/N].

    Args:
        n: cells along the body of the scene.
        end: where the body ends before cells are graded; 1: the body of the scene.
    """
    cells = round(n * end)
    body = Body(
        (cells, cells // 2),
        [(-end, end), (0.0, end), (-end, 0.0)],
        move=lambda x: WIDTH * np.sinh(GRADING * x) / np.sinh(GRADING),
    )
    made = boxes(MPI.COMM_SELF, "hexahedron", [body], 2)
    V = made.V
    tags = made.tags(
        (LOADED, [0], lambda x: np.abs(x[:, 2]) < 1e-9),
        (HELD, [0], lambda x: np.abs(x[:, 2] + end) < 1e-9),
        (FRONT, [0], lambda x: np.abs(x[:, 1]) < 1e-9),
    )
    x = ufl.SpatialCoordinate(made.mesh)
    inside = 1.0 - (x[0] ** 2 + x[1] ** 2) / RADIUS**2
    traction = ufl.sqrt(ufl.conditional(ufl.gt(inside, 0.0), inside, 0.0))
    ds = ufl.Measure(
        "ds", domain=made.mesh, subdomain_data=tags, metadata={"quadrature_degree": 10}
    )(LOADED)
    L = traction * ufl.TestFunction(V)[0] * ds
    bcs = [fixed(V, tags.find(HELD)), fixed(V, tags.find(FRONT), 0.0, 1)]
    u = linear_solution(elasticity(V, YOUNG, POISSON[3]), L, bcs)
    work = fem.assemble_scalar(fem.form(ufl.action(L, u)))
    half = fem.assemble_scalar(fem.form(traction * ds))
    return float(work / half**2) / 2.0  # the half with y < 0 bears the other half of the force


@pytest.mark.long
def test_far_compliance():
    """What a body adds falls with its size: the rest comes from that of a larger one.

    Cells near the disc are the same, so that their errors cancel.
    """
    n, end = 8, 1.5
    size = np.sinh(GRADING * end) / np.sinh(GRADING)
    found = (shift(n, 1.0) - shift(n, end)) / (1.0 - 1.0 / size)
    assert found == pytest.approx(FAR, rel=0.05)
