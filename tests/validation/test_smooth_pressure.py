"""No checkerboard: where the exact pressure is smooth, the computed one does not oscillate.

The criterion: let e be the error of the pressure at the nodes and H the size of the coarser cells.
Along each line of nodes the second difference of e is at most a part of H^2 |p''|, what a smooth
error of second order has. An oscillation of amplitude c from node to node would add 4 c to it. The
nodes at the ends of the lines are left out: there the dual basis is of first order.
"""

from __future__ import annotations

import numpy as np
import pytest

from scenes.hertz import compare, cylinder_on_plane
from scenes.manufactured import YOUNG, blocks_scene
from scenes.nodal import global_vector, surface_nodes_of
from scenes.patches import KINDS as CELLS
from scenes.patches import dim_of

#: Second differences of the error over H^2 |p''|, and those of the coarse side's kinks (see below).
SMOOTH, KINKS = 0.6, 1.0

#: The same on the graded mesh of a cylinder, with displacements of degree 2.
CYLINDER = 0.15


def second_differences(values):
    """The largest one along any axis."""
    return max(np.abs(np.diff(values, 2, axis=i)).max() for i in range(values.ndim))


@pytest.mark.parametrize("ratio", ["2:3", "1:3", "3:1"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_no_oscillation_on_meshes_that_do_not_match(comm, cell, degree, ratio):
    """Against a known solution.

    With degree 1 the surface of a primary side three times as coarse is a polygon, which a fine
    secondary side feels: its pressure follows the kinks, where the slope changes by H |w''|. That
    is the stress E H |w''|, repeats with the coarse cells, and does not alternate from node to
    node.
    """
    dim = dim_of(cell)
    divisions = {"2:3": (8, 12), "1:3": (6, 18), "3:1": (12, 4)}[ratio]
    if dim == 3:
        divisions = {"2:3": (4, 6), "1:3": (4, 12), "3:1": (6, 2)}[ratio]
    scene = blocks_scene(comm, cell, degree, divisions)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-8)
    solution.raise_if_failed()
    points, fields = surface_nodes_of(solution)
    pressure = global_vector(comm, points, fields["pressure"])
    points = global_vector(comm, points, points)
    exact = 1.0 + 0.2 * np.cos(2.0 * points[:, : dim - 1] + 1.0).sum(axis=1)
    error = (pressure - exact).reshape((divisions[0] + 1,) * (dim - 1))
    error = error[(slice(1, -1),) * (dim - 1)]

    H = 1.0 / min(divisions)
    curvature = 0.2 * 2.0**2  # of p
    allowed = SMOOTH * H**2 * curvature
    if degree == 1 and ratio == "3:1":
        signs = (-1.0) ** np.indices(error.shape).sum(axis=0)
        assert abs((signs * error).mean()) <= allowed
        allowed = KINKS * YOUNG[0] * H * (5e-4 * 1.8**2)  # of the height of the surface
    assert second_differences(error) <= allowed


@pytest.mark.parametrize("quadrilaterals", [False, True])
@pytest.mark.parametrize("h", [0.12, 0.06, 0.03])
def test_no_oscillation_on_an_obstacle(comm, h, quadrilaterals):
    """Degree 2 on a rigid plane, against Hertz, but for the outer part of the contact.

    (With degree 1 the pressure has the noise of the mesh, a percent of the peak.) The solver's
    tolerance is well below H^2: at the default one, its error is as large as the second differences
    of the finest mesh.
    """
    scene = cylinder_on_plane(comm, h, degree=2, quadrilaterals=quadrilaterals)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-9)
    solution.raise_if_failed()
    found = compare(scene, solution)
    theory = found.theory
    order = np.argsort(found.r)
    r, p = found.r[order], found.p[order]
    middle = r < 0.7 * theory.contact_radius
    assert middle.sum() >= 7
    error = (p - theory.pressure(r))[middle]
    curvature = theory.peak / theory.contact_radius**2 * (1.0 - 0.7**2) ** -1.5
    assert second_differences(error) <= CYLINDER * h**2 * curvature
