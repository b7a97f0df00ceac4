"""A crack inside one body: its lips share the nodes of its front and touch from the beginning."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    NonlinearContactProblem,
    PairingError,
    SolverOptions,
)
from scenes.elasticity import elasticity, fixed, no_load
from scenes.patches import KINDS, block, dim_of
from scenes.rubber_block import neo_hookean

LOWER, UPPER, BOTTOM, TOP = 1, 2, 3, 4
PRESSURE = 0.02  # Young's modulus is 1


def crack(comm, kind, *, degree=1, shift=0.0, angle=0.0, scale=1.0, shear=0.0, poisson=0.0):
    """Return a block with a crack at mid height, whose front is inside of it, pressed at its top.

    The nodes of the upper lip are moved along the lip by up to `shift`, and the whole block is
    turned by `angle`.
    """
    dim, across = dim_of(kind), 10 if dim_of(kind) == 2 else 6
    x, cells = block(kind, (across, 4), [(0.0, 1.0)] * dim, 0.0, 0)
    on_plane = np.abs(x[:, -1] - 0.5) < 1e-9
    within = on_plane & (np.abs(x[:, :-1] - 0.5) < 0.3 - 1e-9).all(axis=1)
    above = x[cells].mean(axis=1)[:, -1] > 0.5
    copies = np.full(len(x), -1)
    copies[within] = len(x) + np.arange(within.sum())
    cells = np.where(above[:, None] & within[cells], copies[cells], cells)
    x = np.concatenate([x, x[within]])
    lift = np.arange(len(x)) >= len(within)
    x[lift, 0] += shift * np.sin(np.pi * (x[lift, 0] - 0.2) / 0.6)
    turn = np.eye(dim)
    c, s = np.cos(angle), np.sin(angle)
    turn[np.ix_([0, -1], [0, -1])] = [[c, -s], [s, c]]
    rows = slice(None) if comm.rank == 0 else slice(0)
    made = dolfinx.mesh.create_mesh(
        comm=comm, cells=cells.astype(np.int64)[rows], x=scale * (x @ turn.T)[rows],
        e=ufl.Mesh(basix.ufl.element("Lagrange", kind, 1, shape=(dim,))),
    )  # fmt: skip
    made.topology.create_connectivity(dim - 1, dim)
    facets = dolfinx.mesh.exterior_facet_indices(made.topology)
    to_cell = made.topology.connectivity(dim - 1, dim)
    cell = to_cell.array[to_cell.offsets[facets]]
    height, middle = (
        dolfinx.mesh.compute_midpoints(made, d, entities)[:, :dim] @ turn[:, -1] / scale
        for d, entities in ((dim - 1, facets), (dim, cell))
    )
    values = np.where(middle > 0.5, UPPER, LOWER)
    values = np.select([height < 1e-9, height > 1 - 1e-9], [BOTTOM, TOP], values)
    kept = np.isin(values, [BOTTOM, TOP]) | (np.abs(height - 0.5) < 1e-9)
    kept &= ~np.isin(values, [LOWER, UPPER]) | (np.abs(height - middle) < 0.25)
    tags = dolfinx.mesh.meshtags(made, dim - 1, facets[kept], values[kept].astype(np.int32))
    V = fem.functionspace(made, ("Lagrange", degree, (dim,)))
    push = scale * (shear * turn[:, 0] - PRESSURE * turn[:, -1])
    bcs = [fixed(V, tags.find(BOTTOM)), fixed(V, tags.find(TOP), push)]
    a, L = elasticity(V, 1.0, poisson), no_load(V)
    return SimpleNamespace(V=V, tags=tags, a=a, L=L, bcs=bcs, comm=comm, dim=dim, scale=scale)


def nodes(scene, secondary, primary):
    """Return rows of all nodes in a fixed order: position, pressure, traction and relative slip."""
    pair = ContactPair(scene.tags, secondary, primary, Coulomb(0.3))
    with ContactProblem(scene.a, scene.L, [pair], scene.bcs) as problem:
        solution = problem.solve(rtol=1e-11)
        solution.raise_if_failed()
        surface = solution.surface
        fields = (surface.pressure, surface.traction, surface.slip)
        rows = [
            field.x.array.reshape(len(surface.points), size)
            for field, size in zip(fields, (1, scene.dim, scene.dim), strict=True)
        ]
        rows[-1] = rows[-1] / scene.scale
        found = np.column_stack([surface.points / scene.scale, *rows])[surface.weights > 0.0]
    found = np.concatenate(scene.comm.allgather(found))
    order = np.lexsort(np.round(found[:, :3], 9).T)
    return found[order]


@pytest.mark.parallel(kind=["triangle", "tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_crack_across_uniaxial_pressure_bears_this_pressure_at_each_node(comm, kind):
    scene = crack(comm, kind, angle=0.35)
    both = [LOWER, UPPER]
    pressure = nodes(scene, both, both)[:, 3]
    assert len(pressure) == (5 if dim_of(kind) == 2 else 9)
    assert pressure == pytest.approx(PRESSURE, rel=1e-8)


@pytest.mark.parallel(kind=["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize("kind", ["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize(
    ("degree", "shift", "scale"), [(1, 0.0, 1.0), (1, 0.03, 1e3), (2, 0.0, 1e-3)]
)
def test_a_crack_with_one_tag_is_a_crack_with_two(comm, kind, degree, shift, scale):
    scene = crack(
        comm, kind, degree=degree, shift=shift, angle=0.35, scale=scale, shear=0.015, poisson=0.3
    )
    both = [LOWER, UPPER]
    found = nodes(scene, both, both)
    by_hand = [nodes(scene, *sides) for sides in ((LOWER, UPPER), (UPPER, LOWER))]
    differences = [np.abs(found - one).max() for one in by_hand if len(one) == len(found)]
    assert min(differences) < 1e-8 * PRESSURE


@pytest.mark.parallel
@pytest.mark.parametrize("angle", [0.0, 0.35])
def test_a_crack_that_moves_closes_and_just_touches_with_one_tag_as_with_two(comm, angle):
    """A crack with one tag has the forces of a crack with two, open, pressed and at rest."""
    scene = crack(comm, "quadrilateral", degree=2, angle=angle)
    up = np.array([-np.sin(angle), np.cos(angle)])
    options = SolverOptions(rtol=1e-9, geometry_accuracy=1e-8)
    forces = []
    for secondary, primary in (([LOWER, UPPER],) * 2, (LOWER, UPPER), (UPPER, LOWER)):
        u, push = fem.Function(scene.V), fem.Constant(scene.V.mesh, np.zeros(2))
        F = ufl.derivative(neo_hookean(u) * ufl.dx, u, ufl.TestFunction(scene.V))
        ends = (fixed(scene.V, scene.tags.find(BOTTOM)), fixed(scene.V, scene.tags.find(TOP), push))
        pair = ContactPair(scene.tags, secondary, primary, Frictionless(), sliding="finite")
        forces.append([])
        with NonlinearContactProblem(F, u, [pair], ends, options=options) as problem:
            for depth in (-PRESSURE, PRESSURE, 0.0):  # open, pressed, at rest
                push.value[:] = -depth * up
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                forces[-1].append(solution.normal_force)
    assert forces[1][1] > 0.03 and np.abs(forces)[:, [0, 2]].max() < 1e-9
    assert np.abs(np.subtract(forces[0], forces[1:])).max(axis=1).min() < 1e-8


@pytest.mark.parametrize("slope", [0.06, 0.09, 0.5])
def test_the_two_faces_of_a_blade_do_not_meet_at_its_edge(slope):
    """Facets that share the node of an edge do not touch if the body is between them."""
    along = np.linspace(1.0, 1.15, 4)
    upper = np.column_stack([along, slope * along])
    x = np.concatenate([[[0.0, 0.0]], upper * [1.0, -1.0], upper])
    low, high = np.arange(1, 4), np.arange(5, 8)
    cells = [[[0, 1, 5]], np.column_stack([low, low + 1, high])]
    cells.append(np.column_stack([low + 1, high + 1, high]))
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    blade = dolfinx.mesh.create_mesh(
        comm=MPI.COMM_SELF, cells=np.concatenate(cells), x=x, e=ufl.Mesh(element)
    )
    blade.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(blade.topology)
    tags = dolfinx.mesh.meshtags(blade, 1, facets, np.full(len(facets), 7, dtype=np.int32))
    V = fem.functionspace(blade, ("Lagrange", 1, (2,)))
    pair = ContactPair(tags, 7, 7, Coulomb(0.3))
    with pytest.raises(PairingError, match="no part of the surface"):
        ContactProblem(elasticity(V, 1.0), no_load(V), [pair], [])
