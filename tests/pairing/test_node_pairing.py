"""Matching meshes: N, T, weights, gap, overlap, prescribed components, and errors."""

from __future__ import annotations

import dataclasses
import logging
import re

import numpy as np
import pytest
from logged import logged
from rotations import rotation

import dolfinx
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactStatus, PairingError, Tresca
from dolfinx_tresca.pairing.operators import PairOperators, assemble_B
from scenes.assembled import dual_program, points_of
from scenes.patches import KINDS, LOWER_BLOCK, UPPER_BLOCK, dim_of, patch
from scenes.scene import EPS, Scene
from scenes.two_bricks import two_bricks


def jumps(comm, scene: Scene, operators: PairOperators, u: fem.Function):
    """Return N u and T u without weights, from the assembled B."""
    B = assemble_B(scene.V, [operators])
    left = B.createVecLeft()
    B.mult(u.x.petsc_vec, left)
    values = left.array / np.sqrt(operators.weights[operators.row_node])
    left.destroy()
    B.destroy()
    return np.split(values, [len(operators.normal_node)])


def total(comm, value) -> float:
    return comm.allreduce(float(np.sum(value)))


@pytest.mark.parallel
@pytest.mark.parametrize("hexahedra", [False, True])
def test_bricks_have_the_sizes_of_the_paper(comm, hexahedra):
    """N has N^2 rows, T twice as many; nodes on the fixed end carry no multiplier."""
    N = 4
    operators = two_bricks(comm, N, hexahedra=hexahedra).operators()
    assert total(comm, len(operators.nodes)) == N**2
    assert total(comm, operators.N.shape[0]) == N**2
    assert total(comm, operators.T.shape[0]) == 2 * N**2
    if hexahedra:
        # the area without that of the fixed nodes, half a cell of the length
        area = total(comm, operators.weights)
        assert area == pytest.approx(2.0 - 1.0 / N, rel=1e-12)
    assert (operators.weights > 0.0).all()


@pytest.mark.parallel
@pytest.mark.parametrize("hexahedra", [False, True])
def test_jumps_of_known_displacements(comm, hexahedra):
    """The jump of a rigid motion of both bricks is zero; the jump of the identity is -gap."""
    scene = two_bricks(comm, 4, hexahedra=hexahedra, Offset=0.01)
    operators = scene.operators()
    u = fem.Function(scene.V)
    u.interpolate(lambda x: np.array([0 * x[0] + 1.0, 0 * x[0] - 2.0, 0 * x[0] + 3.0]))
    for jump in jumps(comm, scene, operators, u):
        assert np.abs(jump).max(initial=0.0) <= 100 * EPS
    u.interpolate(lambda x: np.array([x[0], x[1], x[2]]))
    normal, tangential = jumps(comm, scene, operators, u)
    assert np.allclose(normal, -operators.gap, atol=100 * EPS)
    assert np.allclose(tangential, 0.0, atol=100 * EPS)
    # the upper brick goes down by 0.25 and to the right by 2
    u.interpolate(lambda x: np.array([2.0 * (x[2] > 1.005), 0 * x[0], -0.25 * (x[2] > 1.005)]))
    normal, tangential = jumps(comm, scene, operators, u)
    assert np.allclose(normal, 0.25, rtol=100 * EPS)
    vectors = np.zeros((len(operators.nodes), 3))
    np.add.at(vectors, operators.tangent_node, tangential[:, None] * operators.tangents)
    assert np.allclose(vectors, [2.0, 0.0, 0.0], atol=100 * EPS)


def test_normals_point_outward_and_tangents_are_orthonormal_to_them(comm):
    R = rotation(3)
    scene = two_bricks(comm, 4).moved(lambda x: x @ R.T, turn=R)
    operators = scene.operators()
    assert np.allclose(operators.normals, R @ [0.0, 0.0, -1.0], atol=1e3 * EPS)
    n = operators.normals[operators.tangent_node]
    assert np.abs(np.einsum("ni,ni->n", operators.tangents, n)).max(initial=0.0) <= 1e3 * EPS
    T = operators.tangents.reshape(-1, 2, 3)
    assert np.allclose(np.einsum("nai,nbi->nab", T, T), np.eye(2), atol=1e3 * EPS)


@pytest.mark.parametrize("offset", [0.0, 1e-6, 0.02, -0.001, 2.0])
def test_gap_is_the_signed_distance(comm, offset):
    """It may be zero, small compared with the cells or large, or negative: initial penetration."""
    operators = two_bricks(comm, 4, Offset=offset).but(pairing="nodes").operators()
    assert np.allclose(operators.gap, offset, atol=100 * EPS)


@pytest.mark.parallel
def test_only_nodes_in_the_overlap_carry_multipliers(comm):
    """The upper brick is shifted by two of four cells: three of five rows of nodes overlap."""
    N = 5
    scene = two_bricks(comm, N, Shift=2 / (N - 1))
    operators = scene.operators()
    assert total(comm, len(operators.nodes)) == N * (N - 2)
    y = points_of(scene, operators)[:, 1]
    assert ((y >= 0.5 - 1e-9) & (y <= 1.0 + 1e-9)).all()
    with scene.problem() as problem:
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


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


@pytest.mark.parallel(shift=[0.3])
@MISMATCHES
def test_meshes_need_not_match(comm, shift):
    scene = two_bricks(comm, 5, Shift=shift / 4, hexahedra=True)
    assert np.abs(scene.operators().gap).max(initial=0.0) <= 100 * EPS
    with scene.problem() as problem:
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


@pytest.mark.parallel
def test_log_of_the_pairing(comm, caplog):
    with caplog.at_level(logging.INFO, logger="dolfinx_tresca"):
        two_bricks(comm, 3).operators()
    if comm.rank == 0:
        text = logged(caplog)
        assert "upper_contact on lower_contact: 9 of 12 secondary nodes carry" in text
        assert "3 are prescribed" in text
    else:
        assert not caplog.records


@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_nodes_have_one_tangent_in_2D(comm, kind):
    scene = patch(comm, kind, upper=(4, 2), lower=(4, 2), distort=0.0, friction=Tresca(0.1))
    operators = scene.operators()
    n = len(operators.nodes)
    assert total(comm, n) == 5
    assert operators.N.shape[0] == operators.T.shape[0] == n
    assert operators.normals.shape == operators.tangents.shape == (n, 2)
    assert np.allclose(operators.normals, [0.0, -1.0], atol=100 * EPS)
    assert np.allclose(np.abs(operators.tangents), [1.0, 0.0], atol=100 * EPS)
    assert total(comm, operators.weights) == pytest.approx(1.0, rel=100 * EPS)


@pytest.mark.parallel(beside=[0.1])
@pytest.mark.parametrize("beside", [0.1, 5.0])
def test_surfaces_that_do_not_overlap_are_an_error(comm, beside):
    """Their distance is a tenth of their size, or large."""
    scene = two_bricks(comm, 4, Shift=1.0 + beside)
    for pair in (scene.pair, node_to_node(scene)):
        assert "upper_contact" in refused(scene, "do not face each other", pair)


@pytest.mark.parallel(kind=["hexahedron"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("upper", "lower"), [(2, 4), (4, 2)])
def test_nested_meshes_do_not_match(comm, kind, upper, lower):
    """All nodes of the coarse side match nodes of the fine side, but not the reverse."""
    scene = patch(comm, kind, upper=(upper, 1), lower=(lower, 1), distort=0.0)
    with pytest.raises(PairingError, match="do not match"):
        scene.but(pairing="nodes").operators()


@pytest.mark.parallel
def test_single_coincident_node_is_no_match(comm):
    """Only the last node of the upper face lies on a node of the lower face."""
    scene = patch(
        comm, "quadrilateral", upper=(3, 1), lower=(4, 1), distort=0.0, span=[(-0.75, 0.25)]
    )
    assert total(comm, scene.operators().weights) == pytest.approx(0.25, rel=1e-6)
    with pytest.raises(PairingError, match="do not match"):
        scene.but(pairing="nodes").operators()


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
def test_prescribed_secondary_side_is_an_error(comm):
    scene = two_bricks(comm, 3)
    scene = dataclasses.replace(scene, bcs=[*scene.bcs, scene.fixed("upper_contact")])
    assert "prescribed" in refused(scene, "can carry a multiplier")


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
    normal, _ = jumps(comm, scene, found, u)
    assert np.allclose(normal, np.einsum("ni,ni->n", wanted, found.normals), atol=1e3 * EPS)


@pytest.mark.parallel(hexahedra=[False])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_curved_surfaces_match(comm, hexahedra):
    scene = two_bricks(comm, 5, hexahedra=hexahedra).moved(bump)
    operators = scene.operators()
    assert total(comm, len(operators.nodes)) == 25
    assert np.abs(operators.gap).max(initial=0.0) <= 100 * EPS
    x = points_of(scene, operators)
    slope = np.column_stack(
        [
            0.3 * np.cos(2 * x[:, 0]) * np.cos(3 * x[:, 1]),
            -0.45 * np.sin(2 * x[:, 0]) * np.sin(3 * x[:, 1]),
            -np.ones(len(x)),
        ]
    )
    exact = slope / np.linalg.norm(slope, axis=1)[:, None]
    # the error of averaged normals is O(h), largest at the rim, where facets are on one side only
    assert (np.einsum("ni,ni->n", exact, operators.normals) > 0.97).all()
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.counts.contact > 0


@pytest.mark.parallel(hexahedra=[False])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_curved_pair_at_a_symmetry_plane_has_full_rank(comm, hexahedra):
    """Averaged normals are tilted out of the plane; N and T stay linearly independent."""
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
    with dual_program(scene) as dual:
        size = comm.allreduce(len(dual.b))
        first = comm.exscan(len(dual.b)) or 0
        images = []
        for index in range(size):
            unit = np.zeros(len(dual.b))
            if first <= index < first + len(unit):
                unit[index - first] = 1.0
            images.append(dual.operator.apply(unit))
        A = np.concatenate(comm.allgather(np.column_stack(images)))
    values = np.linalg.eigvalsh(A)
    # the flat scene has 0.01; linearly dependent rows would give rounding
    assert values[0] > 1e-4 * values[-1]
