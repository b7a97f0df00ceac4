"""Pressures and displacements against known smooth solutions: rates, no checkerboard, patch test.

The criterion of no checkerboard: let e be the error of the pressure at the nodes and H the size of
the coarser cells. Along each line of nodes the second difference of e is at most a part of
H^2 |p''|, what a smooth error of second order has. An oscillation of amplitude c from node to node
would add 4 c to it. The nodes at the ends of the lines are left out: there the dual basis is of
first order. The patch test is that of curved cells; tests/pairing has those with straight ones.
"""

from __future__ import annotations

import math
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import ContactStatus
from scenes.manufactured import YOUNG, blocks_scene, errors_of
from scenes.nodal import global_vector, nodal, surface_nodes_of
from scenes.patches import KINDS, POISSON, dim_of, patch
from scenes.patches import KINDS as CELLS

#: Least rates of the error in the energy norm: theory has 1 and 1.5.
ENERGY = {1: 0.9, 2: 1.4}

#: Least rates of pressure and slip in L2. The multipliers are exact for constants only, so their
#: theory has 1 for the pressure; the values at nodes that are measured here do better.
PRESSURE, SLIP = 1.2, 1.3

SIZES = {
    "triangle": (2, 4, 8),
    "quadrilateral": (2, 4, 8),
    "tetrahedron": (1, 2),
    "hexahedron": (1, 2),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", SIZES)
def test_rates(comm, cell, degree):
    """Errors fall at the rates of the elements where all nodes are pressed and slip."""
    errors = []
    for k in SIZES[cell]:
        scene = blocks_scene(comm, cell, degree, (2 * k, 3 * k))
        with scene.problem() as problem:
            solution = problem.solve(rtol=1e-8)
            assert solution.counts.contact == solution.counts.slip == problem.contact_nodes
        errors.append(errors_of(scene, solution))
    least = {"energy": ENERGY[degree], "pressure": PRESSURE, "slip": SLIP}
    for (coarse, fine), (k, finer) in zip(pairwise(errors), pairwise(SIZES[cell]), strict=True):
        for name, rate in least.items():
            assert math.log(coarse[name] / fine[name]) / math.log(finer / k) > rate, (name, finer)


#: Second differences of the error over H^2 |p''|, and those of the coarse side's kinks (see below).
SMOOTH, KINKS = 0.6, 1.0


def second_differences(values):
    """The largest one along any axis."""
    return max(np.abs(np.diff(values, 2, axis=i)).max() for i in range(values.ndim))


@pytest.mark.parametrize("ratio", ["2:3", "1:3", "3:1"])
@pytest.mark.parametrize(
    ("cell", "degree"), [*((cell, 1) for cell in CELLS), *((cell, 2) for cell in CELLS[:3])]
)
def test_no_oscillation_on_meshes_that_do_not_match(comm, cell, degree, ratio):
    """Errors of the pressure do not alternate from node to node.

    With degree 1 a primary side three times as coarse is a polygon, whose kinks the pressure of a
    fine secondary side follows: the stress E H |w''| repeats with the coarse cells.
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


#: Of the solver, and relative of pressure and displacement at every node. A multiplier errs by the
#: residual times the condition number of A, which is below 1e3 on these meshes.
RTOL, EXACT = 1e-12, 1e-9


def errors(scene):
    """Solve; return the largest errors of pressure, displacement and traction, all relative."""
    comm = scene.mesh.comm
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
        nodes = problem.contact_nodes
    assert solution.status is ContactStatus.CONVERGED
    assert solution.counts.contact == solution.counts.nodes == nodes
    points, fields = surface_nodes_of(solution)
    assert comm.allreduce(len(points)) == nodes
    found = [
        np.abs(fields["pressure"] - scene.data.pressure).max(initial=0.0) / scene.data.pressure,
        np.abs(nodal(solution.u) - nodal(scene.data.exact)).max(initial=0.0),
        np.abs(fields.get("traction", np.zeros(1))).max(initial=0.0) / scene.data.pressure,
        np.abs(nodal(scene.data.exact)).max(initial=0.0),
    ]
    pressure, displacement, traction, size = (comm.allreduce(e, op=MPI.MAX) for e in found)
    return pressure, displacement / size, traction


@pytest.mark.parametrize("kind", KINDS)
def test_constant_pressure_in_curved_cells(comm, kind):
    """A constant pressure is exact where cells of order 2 are curved inside the blocks."""
    dim = dim_of(kind)

    def bend(x):
        x = x.copy()
        # nothing at the faces of the blocks that are not parallel to the first axis
        x[:, 0] += 0.08 * np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, dim - 1])
        return x

    shape = {"upper": (3, 1), "lower": (4, 2), "geometry": 2}
    straight, scene = patch(comm, kind, 2, **shape), patch(comm, kind, 2, warp=bend, **shape)
    # the exact displacement is linear in the coordinates, of which some have changed
    strain = straight.data.pressure / 1000.0
    along, across = (1.0, POISSON) if dim == 3 else (1.0 - POISSON**2, POISSON * (1.0 + POISSON))
    slopes = np.array([across * strain] * (dim - 1) + [-along * strain])
    linear = [
        (slopes * one.V.tabulate_dof_coordinates()[:, :dim]).ravel() for one in (straight, scene)
    ]
    assert np.allclose(linear[0], straight.data.exact.x.array, atol=1e-14)
    assert not np.allclose(linear[1], linear[0], atol=1e-5)
    scene.data.exact.x.array[:] = linear[1]
    scene.data.pressure = straight.data.pressure
    assert max(errors(scene)) <= EXACT
