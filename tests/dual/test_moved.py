"""Gaps of surfaces that a displacement has moved and bent."""

from __future__ import annotations

import gc
import logging

from mpi4py import MPI

import numpy as np
import pytest
from logged import logged

from dolfinx import fem

from dolfinx_tresca import RigidSphere
from scenes.blocks import BELOW, block
from scenes.patches import patch

#: Divisions of the faces, and the gap between them.
UPPER, LOWER, GAP = 3, 4, 0.05

#: Slope of a surface that a displacement bends.
SLOPE = 0.1


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
@pytest.mark.parametrize("bent", ["secondary", "primary"])
def test_bending_counts_once(comm, kind, bent):
    """A face becomes a parabola, k x^2 / 2 high, which N u and the moved surface both know of.

    So an update at that displacement changes no gap d - N u: on the secondary side but for what
    tilted normals do, k times the height of the parabola over an edge. Of the primary side heights
    are those of a smooth surface through the nodes, right but for what is missing at rims.
    """
    k = 1e-3
    across = 1 if kind == "triangle" else 2
    span = [(0.2, 0.8)] * across
    scene = patch(comm, kind, 2, upper=(UPPER, 1), lower=(LOWER, 1), gap=GAP, span=span)
    u = fem.Function(scene.V)
    x = scene.V.tabulate_dof_coordinates()
    body = x[:, across] > 1.0 + 0.5 * GAP
    if bent == "primary":
        body = ~body
    # both ways the distance falls with x ever faster: no mean is less than the least distance
    curvature = -k if bent == "secondary" else k
    u.x.array.reshape(-1, across + 1)[body, across] = 0.5 * curvature * x[body, 0] ** 2
    with scene.problem() as problem:
        before = gap_at(problem, u)
        problem.update_geometry(u)
        change = np.abs(gap_at(problem, u) - before).max(initial=0.0)
    edge = 0.6 / UPPER if bent == "secondary" else 1.0 / LOWER
    height = k * edge**2 / 8.0
    allowed = 5.0 * k if bent == "secondary" else 0.5
    assert comm.allreduce(change, op=MPI.MAX) <= allowed * height


def test_no_vector_is_left_to_the_garbage_collector():
    """Ranks would free it at different times, which is collective, and wait for each other."""
    scene = block(MPI.COMM_SELF, (2, 2), obstacles=[(BELOW, RigidSphere((0.5, -1.0), 1.0))])
    gc.collect()
    gc.disable()
    try:
        with scene.problem() as problem:
            u = fem.Function(scene.V)
            u.x.array[:] = 1e-3
            problem.update_geometry(u)
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        functions = [one for one in gc.garbage if isinstance(one, fem.Function)]
        assert not [one for one in functions if getattr(one.x, "_petsc_x", None) is not None]
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()


def test_displaced_surfaces_have_no_warnings_of_the_mesh(comm, caplog):
    """A displacement bends flat faces, which overlap by a 30th of the height over an edge.

    The overlap is an error of the displacement, and no press fit. The surface is torn, which the
    log says once, when the undeformed surfaces are paired.
    """
    height = SLOPE / (4.0 * LOWER**2)
    divisions = {"upper": (LOWER + 2, 1), "lower": (LOWER, 1)}
    scene = patch(comm, "triangle", **divisions, gap=GAP, tear=lambda x: x[:, 0] > 0.5)
    x = scene.V.tabulate_dof_coordinates()
    u = fem.Function(scene.V)
    down = np.where(x[:, 1] > 1.0 + 0.5 * GAP, GAP + height / 30.0, 0.0)
    u.x.array.reshape(-1, 2)[:, 1] = SLOPE * x[:, 0] ** 2 - down
    with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"), scene.problem() as problem:
        assert ("at the place of another one" in logged(caplog)) == (comm.rank == 0)
        caplog.clear()
        problem.update_geometry(u)
    assert logged(caplog) == ""


def gap_at(problem, u: fem.Function) -> np.ndarray:
    """Return d - N u."""
    (one,) = problem.operators
    closed = one.N * u.x.petsc_vec
    gap: np.ndarray = one.gap - closed.array
    closed.destroy()
    return gap
