"""Matching meshes: N, T, weights, gap, overlap, prescribed components, and errors."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import dolfinx
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactStatus, PairingError, Tresca
from scenes.assembled import points_of
from scenes.nodal import nodal
from scenes.patches import KINDS, LOWER_BLOCK, UPPER_BLOCK, dim_of, patch
from scenes.scene import EPS, Scene
from scenes.two_bricks import two_bricks


def total(comm, value) -> float:
    return comm.allreduce(float(np.sum(value)))


@pytest.mark.parametrize("offset", [0.0, 1e-6, 0.02, -0.001, 2.0])
def test_gap_is_the_signed_distance(comm, offset):
    """Gaps may be zero, smaller than cells, larger, or negative (initial penetration)."""
    operators = two_bricks(comm, 4, Offset=offset).but(pairing="nodes").operators()
    assert np.allclose(operators.gap, offset, atol=100 * EPS)


def refused(scene: Scene, message: str, pair: ContactPair | None = None) -> str:
    with pytest.raises(PairingError, match=message) as caught:
        scene.operators(pair)
    return str(caught.value)


def node_to_node(scene: Scene) -> ContactPair:
    return dataclasses.replace(scene.pair, pairing="nodes")


MISMATCHES = pytest.mark.parametrize("shift", [0.3, 0.5, 1.25])


@pytest.mark.parallel(shift=[0.3])
@MISMATCHES
def test_meshes_that_do_not_match_are_an_error(comm, shift):
    """The message has the number of nodes, and the position of the worst one."""
    scene = two_bricks(comm, 5, Shift=shift / 4, hexahedra=True)
    rows = 5 - int(np.ceil(shift))  # rows of five nodes that carry multipliers
    message = refused(scene, rf'pairing="nodes".*: {5 * rows} nodes', node_to_node(scene))
    where = re.search(r"at \(([-\d.]+), ([-\d.]+), ([-\d.]+)\)", message)
    assert where is not None
    x, y, z = (float(value) for value in where.groups())
    assert 0 <= x <= 2 and 0 <= y <= 1 and z == 1.0


@pytest.mark.parallel
def test_facets_inside_a_body_are_an_error(comm):
    scene = two_bricks(comm, 4)
    mesh = scene.mesh
    inside = dolfinx.mesh.locate_entities(
        mesh, 2, lambda x: np.isclose(x[0], 1.0) & (x[2] > 1.0 - 1e-9)
    )
    lower = scene.facet_tags.find(scene.tags["lower_contact"])
    facets = np.concatenate([inside, lower]).astype(np.int32)
    values = np.concatenate([np.full(len(inside), 5), np.full(len(lower), 6)]).astype(np.int32)
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, 2, facets[order], values[order])
    message = refused(scene, "inside a", ContactPair(tags, 5, 6, Tresca(0.1)))
    assert "tag 5" in message and "secondary" in message
    message = refused(scene, "inside a", ContactPair(tags, 6, 5, Tresca(0.1)))
    assert "tag 5" in message and "primary" in message


@pytest.mark.parallel
def test_prescribed_primary_side_acts_as_an_obstacle(comm):
    """All secondary nodes keep their multipliers."""
    scene = two_bricks(comm, 4)
    scene = dataclasses.replace(scene, bcs=[*scene.bcs, scene.fixed("lower_contact")])
    assert total(comm, len(scene.operators().nodes)) == 16
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.normal_force > 0.0


@pytest.mark.parallel(component=[0])
@pytest.mark.parametrize(("component", "rows"), [(0, (16, 31)), (1, (16, 31)), (2, (12, 32))])
def test_prescribed_components(comm, component, rows):
    """One component of the N = 4 secondary nodes on the edge y = 0 is prescribed.

    For a tangential component friction acts on the lower brick alone, except at the node where that
    is fixed, too.
    """
    scene = two_bricks(comm, 4)
    sub = scene.V.sub(component)
    upper = scene.cell_tags.find(scene.tags["upper"])
    mesh = scene.mesh
    mesh.topology.create_connectivity(2, 3)
    side = dolfinx.mesh.locate_entities_boundary(
        mesh, 2, lambda x: np.isclose(x[1], 0.0) & (x[2] > 1.0 - 1e-9)
    )
    cells = mesh.topology.connectivity(2, 3)
    side = np.array([f for f in side if np.isin(cells.links(f), upper).all()], dtype=np.int32)
    dofs = fem.locate_dofs_topological(sub, 2, side)
    bc = fem.dirichletbc(dolfinx.default_scalar_type(0.0), dofs, sub)
    scene = dataclasses.replace(scene, bcs=[*scene.bcs, bc])
    operators = scene.operators()
    assert total(comm, len(operators.nodes)) == 16
    assert (total(comm, operators.N.shape[0]), total(comm, operators.T.shape[0])) == rows
    single = np.bincount(operators.tangent_node, minlength=1)[operators.tangent_node] == 1
    assert np.abs(operators.tangents[single, component]).max(initial=0.0) <= 100 * EPS
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.counts.nodes == 16


def bump(x: np.ndarray) -> np.ndarray:
    """Bend space by a smooth function of x and y, so that matching surfaces still match."""
    x[:, 2] += 0.15 * np.sin(2.0 * x[:, 0]) * np.cos(3.0 * x[:, 1])
    return x


def ring(x: np.ndarray) -> np.ndarray:
    """Map plane blocks to a quarter of two rings, the upper block outside."""
    radius, angle = 1.0 + x[:, 1], 1.5 * x[:, 0]
    return np.column_stack([radius * np.sin(angle), radius * np.cos(angle), x[:, 2]])


def barrel(x: np.ndarray) -> np.ndarray:
    """Map blocks to a part of two tubes, the upper block outside."""
    return ring(x[:, [0, 2, 1]])[:, [0, 2, 1]]


@pytest.mark.parallel(kind=["triangle", "hexahedron"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("start", [0.0, 0.2])
def test_rings_that_match_have_the_jumps_of_opposite_nodes(comm, kind, degree, start):
    """The gap is zero, also at the rim of the outer ring, to which the inner one is no rim.

    Rows have the entries of the node and its opposite node alone, times the normal.
    """
    d = dim_of(kind)
    scene = patch(comm, kind, degree, upper=(5, 2), lower=(5, 2), distort=0.0, pairing="nodes",
                  span=[(start, 1.0 + start)] * (d - 1))  # fmt: skip
    scene = scene.moved(ring if d == 2 else barrel)
    found = scene.operators()
    assert total(comm, len(found.nodes)) == (6 if start == 0.0 else 5) ** (d - 1)
    assert np.abs(found.gap).max(initial=0.0) <= 100 * EPS
    if degree == 2:
        return
    V = scene.V
    u = fem.Function(V)
    rng = np.random.default_rng(1)
    scale, phase = rng.normal(size=(2, d, 3))
    u.interpolate(lambda x: np.sin(scale @ x + phase[:, :1]))
    upper, lower = (scene.cell_tags.find(tag) for tag in (UPPER_BLOCK, LOWER_BLOCK))
    points = V.tabulate_dof_coordinates()[found.nodes]
    wanted = np.sin(scale @ points.T + phase[:, :1]).T
    for cells, sign in ((upper, 1.0), (lower, 0.0)):
        u.interpolate(lambda x, s=sign: s * np.sin(scale @ x + phase[:, :1]), cells)
    everywhere = np.concatenate(comm.allgather(nodal(u)))
    jumps = found.N @ everywhere.ravel()
    assert np.allclose(jumps, np.einsum("ni,ni->n", wanted, found.normals), atol=1e3 * EPS)


@pytest.mark.parallel(hexahedra=[False])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_normals_of_a_curved_pair_lie_in_a_symmetry_plane(comm, hexahedra):
    """Means of facet normals are tilted out of the plane, where T has one row at each node."""
    scene = two_bricks(comm, 3, hexahedra=hexahedra).moved(bump)
    V = scene.V.sub(1)
    side = fem.locate_dofs_geometrical((V, V.collapse()[0]), lambda x: np.isclose(x[1], 0.0))
    still = fem.Function(V.collapse()[0])
    scene = dataclasses.replace(scene, bcs=[*scene.bcs, fem.dirichletbc(still, side, V)])
    operators = scene.operators()
    on_plane = np.isclose(points_of(scene, operators)[:, 1], 0.0)
    assert total(comm, on_plane) == 3
    assert np.abs(operators.normals[on_plane, 1]).max(initial=0.0) <= EPS
    assert total(comm, on_plane[operators.tangent_node]) == 3
    with scene.problem() as problem:
        assert problem.solve(rtol=1e-8).status is ContactStatus.CONVERGED
