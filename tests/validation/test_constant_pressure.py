"""The patch test with curved cells; tests/pairing/test_patch.py has those with straight ones."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import ContactStatus
from scenes.nodal import nodal, surface_nodes_of
from scenes.patches import KINDS, POISSON, dim_of, patch

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
    """Cells of order 2 that are curved inside the blocks; displacements of degree 2 can follow."""
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
