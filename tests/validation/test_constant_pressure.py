"""The patch test: a constant pressure passes an interface where the meshes do not match."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest
from patches import KINDS, POISSON, patch
from scenes import nodal, rotation, surface_nodes_of

from dolfinx_tresca import ContactStatus, Frictionless, Tresca

#: Of the solver, and relative of pressure and displacement at every node. A multiplier errs by the
#: residual times the condition number of A, which is below 1e3 on these meshes.
RTOL, EXACT = 1e-12, 1e-9

BOUND = 0.7  # below the pressure of 2.5, so that friction could act


def turned(kind):
    """A rotation, of the plane in 2D."""
    dim = 2 if kind in ("triangle", "quadrilateral") else 3
    if dim == 3:
        return rotation(5)
    return np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])


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
        np.abs(fields["pressure"] - scene.pressure).max(initial=0.0) / scene.pressure,
        np.abs(nodal(solution.u) - nodal(scene.exact)).max(initial=0.0),
        np.abs(fields.get("traction", np.zeros(1))).max(initial=0.0) / scene.pressure,
        np.abs(nodal(scene.exact)).max(initial=0.0),
    ]
    pressure, displacement, traction, size = (comm.allreduce(e, op=MPI.MAX) for e in found)
    return pressure, displacement / size, traction


@pytest.mark.parametrize("geometry", [1, 2])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_constant_pressure(comm, kind, degree, geometry):
    """On distorted meshes, turned, of two materials, without friction: the blocks slide freely."""
    scene = patch(
        comm,
        kind,
        degree,
        upper=(3, 1),
        lower=(4, 2),
        turn=turned(kind),
        geometry=geometry,
        young=(1000.0, 3000.0),
        friction=Frictionless(),
    )
    assert max(errors(scene)) <= EXACT


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_constant_pressure_with_friction(comm, kind, degree):
    """Of one material nothing slides, so friction has nothing to do; finer above than below."""
    scene = patch(
        comm, kind, degree, upper=(4, 2), lower=(3, 1), turn=turned(kind), friction=Tresca(BOUND)
    )
    assert max(errors(scene)) <= EXACT


@pytest.mark.parametrize("kind", KINDS)
def test_constant_pressure_in_curved_cells(comm, kind):
    """Cells of order 2 that are curved inside the blocks; displacements of degree 2 can follow."""
    dim = 2 if kind in ("triangle", "quadrilateral") else 3

    def bend(x):
        x = x.copy()
        # nothing at the faces of the blocks that are not parallel to the first axis
        x[:, 0] += 0.08 * np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, dim - 1])
        return x

    shape = {"upper": (3, 1), "lower": (4, 2), "geometry": 2}
    straight, scene = patch(comm, kind, 2, **shape), patch(comm, kind, 2, warp=bend, **shape)
    # the exact displacement is linear in the coordinates, of which some have changed
    strain = straight.pressure / 1000.0
    along, across = (1.0, POISSON) if dim == 3 else (1.0 - POISSON**2, POISSON * (1.0 + POISSON))
    slopes = np.array([across * strain] * (dim - 1) + [-along * strain])
    linear = [
        (slopes * one.V.tabulate_dof_coordinates()[:, :dim]).ravel() for one in (straight, scene)
    ]
    assert np.allclose(linear[0], straight.exact.x.array, atol=1e-14)
    assert not np.allclose(linear[1], linear[0], atol=1e-5)
    scene.exact.x.array[:] = linear[1]
    assert max(errors(dataclasses.replace(scene, pressure=straight.pressure))) <= EXACT
