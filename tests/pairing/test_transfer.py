"""Fields and loads from one side to the other."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints

from dolfinx_tresca import InputError, RigidPlane, Tresca
from dolfinx_tresca.pairing.facet_means import facet_means
from dolfinx_tresca.pairing.transfer import SideTransfer
from scenes.nodal import nodal, node_function
from scenes.patches import LOWER, UPPER, patch
from scenes.scene import EPS

pytestmark = pytest.mark.parallel

KINDS = [("quadrilateral", 1), ("triangle", 2), ("tetrahedron", 1), ("tetrahedron", 2)]

#: Sums over some hundred facets, of integrals over their overlaps.
ROUNDING = 1e4 * EPS


def sides(scene):
    """Return the owned nodes of degree 1 on the secondary and the primary side."""
    V = fem.functionspace(scene.mesh, ("Lagrange", 1))
    dim, owned = scene.mesh.topology.dim - 1, V.dofmap.index_map.size_local
    found = [fem.locate_dofs_topological(V, dim, scene.facet_tags.find(t)) for t in (UPPER, LOWER)]
    return [np.unique(nodes[nodes < owned]) for nodes in found]


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_values_of_the_primary_side(comm, kind, degree):
    """What is linear arrives as it is; the upper body has something else, and the rest nothing."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    across = scene.mesh.geometry.dim - 1
    f = node_function(scene.mesh, lambda x: 2.0 + x[0] - 0.5 * x[1] + 100.0 * (x[across] > 1.001))
    found = SideTransfer(scene.V, scene.operators(), scene.pair).values(f, to="secondary")
    secondary, _ = sides(scene)
    x = found.function_space.tabulate_dof_coordinates()[secondary]
    expected = 2.0 + x[:, 0] - 0.5 * x[:, 1]
    assert np.abs(nodal(found)[secondary] - expected).max(initial=0.0) <= ROUNDING
    others = np.delete(nodal(found), secondary)
    assert np.abs(others).max(initial=0.0) == 0.0


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_what_leaves_one_side_enters_the_other(comm, kind, degree):
    """The sum of loads, scalars and vectors, is kept to rounding, and so is P' the transpose."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    transfer = SideTransfer(scene.V, scene.operators(), scene.pair)
    secondary, primary = sides(scene)
    load = node_function(scene.mesh, lambda x: 1.0 + np.sin(7.0 * x[0]))
    taken = transfer.loads(load)
    total, arrived = comm.allreduce(
        np.array([nodal(load)[secondary].sum(), nodal(taken)[primary].sum()])
    )
    assert arrived == pytest.approx(total, rel=ROUNDING)
    f = node_function(scene.mesh, lambda x: np.cos(3.0 * x[0] + x[1]))
    work = comm.allreduce(nodal(taken) @ nodal(f))
    values = nodal(transfer.values(f, to="secondary"))
    assert work == pytest.approx(comm.allreduce(nodal(load)[secondary] @ values[secondary]))

    dim = scene.mesh.geometry.dim
    vector = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1, (dim,))))
    vector.interpolate(lambda x: np.outer(np.arange(1, 1 + dim), 1.0 + x[0]))
    taken = transfer.loads(vector)
    sums = [nodal(vector)[secondary].sum(axis=0), nodal(taken)[primary].sum(axis=0)]
    total, arrived = comm.allreduce(np.array(sums))
    np.testing.assert_allclose(arrived, total, rtol=ROUNDING)


@pytest.mark.parametrize(("kind", "degree"), [("triangle", 2), ("tetrahedron", 1)])
def test_fields_on_the_mesh(comm, kind, degree):
    """The pressure on both sides, in forms: one constant, with the force as integral."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
    p = solution.on_mesh("pressure")
    assert p.name == "pressure" and p.function_space.mesh == scene.mesh
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    for side in (UPPER, LOWER):
        force = comm.allreduce(fem.assemble_scalar(fem.form(p * ds(side))))
        assert force == pytest.approx(solution.normal_force, rel=1e-8)
    gap = solution.on_mesh("gap")
    assert np.abs(gap.x.array).max() <= 1e-8
    normal = solution.on_mesh("normal")
    axis = scene.mesh.geometry.dim - 1
    secondary, primary = sides(scene)
    for side in (secondary, primary):
        assert np.abs(nodal(normal)[side, axis] + 1.0).max(initial=0.0) <= ROUNDING
    for name in ("state", "traction", "temperature", 3):
        with pytest.raises(InputError, match="can be carried over, but displacement, pressure"):
            solution.on_mesh(name)


def test_facets_that_jut_out(comm):
    """Times areas the force is the same on both sides; in forms times the part that touches."""
    span = [(0.25, 1.4)] * 2
    scene = patch(comm, "tetrahedron", upper=(2, 1), lower=(2, 1), span=span)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
        areas, part = problem.operators[0].areas(), problem.operators[0].area_fraction()
    p = solution.on_mesh("pressure")
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    assert comm.allreduce(((part.x.array > 0.1) & (part.x.array < 0.9)).any(), op=MPI.LOR)
    assert -ROUNDING <= part.x.array.min() and part.x.array.max() <= 1.0 + ROUNDING
    load = p.copy()
    load.x.array[:] *= part.x.array
    for side, nodes in zip((UPPER, LOWER), sides(scene), strict=True):
        force = comm.allreduce(nodal(p)[nodes] @ nodal(areas)[nodes])
        assert force == pytest.approx(solution.normal_force, rel=ROUNDING)
        force = comm.allreduce(fem.assemble_scalar(fem.form(load * ds(side))))
        assert force == pytest.approx(solution.normal_force, rel=ROUNDING)


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_whole_facets_touch(comm, kind, degree):
    """All of each area where a side is before the whole of the other one; nothing elsewhere."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    part = SideTransfer(scene.V, scene.operators(), scene.pair).area_fraction()
    assert (part.name, part.ufl_shape) == ("area_fraction", ())
    touching = np.concatenate(sides(scene))
    assert np.abs(nodal(part)[touching] - 1.0).max(initial=0.0) <= ROUNDING
    assert np.abs(np.delete(nodal(part), touching)).max(initial=0.0) == 0.0


def test_the_part_of_a_body_that_touches_an_obstacle(comm):
    """Of the secondary side alone, since there is no other one."""
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1))
    floor = RigidPlane(point=(0.0, 1.0), normal=(0.0, 1.0))
    pair = dataclasses.replace(scene.pair, primary=floor)
    part = SideTransfer(scene.V, scene.operators(pair), pair).area_fraction()
    secondary, _ = sides(scene)
    assert np.abs(nodal(part)[secondary] - 1.0).max(initial=0.0) <= ROUNDING
    assert np.abs(np.delete(nodal(part), secondary)).max(initial=0.0) == 0.0


@pytest.mark.parametrize(("kind", "degree"), [("triangle", 2), ("tetrahedron", 1)])
def test_fields_that_jump_between_cells(comm, kind, degree):
    """A node takes the cells of its facets, by area, and not one of those that meet in it.

    With degree 0 on blocks of several layers: the cells of the side have its number there.
    """
    scene = patch(comm, kind, degree, upper=(3, 2), lower=(2, 2))
    mesh, dim = scene.mesh, scene.mesh.topology.dim
    transfer = SideTransfer(scene.V, scene.operators(), scene.pair)
    Q = fem.functionspace(mesh, ("DG", 0))
    cells_of = mesh.topology.connectivity(dim - 1, dim)
    values, expected = fem.Function(Q), {}
    values.x.array[:] = 1e6  # of all cells that only touch a side with a node
    for tag, side in ((UPPER, "primary"), (LOWER, "secondary")):
        cells = cells_of.array[cells_of.offsets[scene.facet_tags.find(tag)]]
        values.x.array[cells] = expected[side] = float(tag)
    values.x.scatter_forward()
    secondary, primary = sides(scene)
    for to, nodes in (("secondary", secondary), ("primary", primary)):
        found = nodal(transfer.values(values, to=to))
        assert np.abs(found[nodes] - expected[to]).max(initial=0.0) <= ROUNDING * expected[to]

    # linear in each cell, and continuous: what a field of degree 1 gives; of vectors, too
    def linear(x):
        return np.array([2.0 + x[0], x[0] - 3.0 * x[1], x[-1] + 1.0])[:dim]

    one, other = (
        fem.Function(fem.functionspace(mesh, (family, 1, (dim,)))) for family in ("DG", "Lagrange")
    )
    for function in (one, other):
        function.interpolate(linear)
    for to in ("secondary", "primary"):
        found, wanted = (transfer.values(function, to=to).x.array for function in (one, other))
        assert np.abs(found - wanted).max(initial=0.0) <= 10.0 * ROUNDING


@pytest.mark.parametrize("kind", ["quadrilateral", "tetrahedron", "hexahedron"])
def test_any_element_whose_functions_jump(comm, kind):
    """Whatever the element: of higher degree, a part of a mixed one, a component of a vector."""
    scene = patch(comm, kind, upper=(2, 2), lower=(2, 2))
    mesh, dim = scene.mesh, scene.mesh.topology.dim
    transfer = SideTransfer(scene.V, scene.operators(), scene.pair)
    cells_of = mesh.topology.connectivity(dim - 1, dim)
    cells = cells_of.array[cells_of.offsets[scene.facet_tags.find(LOWER)]].astype(np.int32)
    cell, (nodes, _) = mesh.basix_cell(), sides(scene)
    u = basix.ufl.element("Lagrange", cell, 2, shape=(dim,))
    elements = [
        (basix.ufl.element("Lagrange", cell, 1, discontinuous=True), None),
        (basix.ufl.element("DG", cell, 2), None),
        (basix.ufl.mixed_element([u, basix.ufl.element("DG", cell, 0)]), 1),
        (basix.ufl.element("DG", cell, 0, shape=(dim,)), 0),
    ]
    for element, part in elements:
        whole = fem.Function(fem.functionspace(mesh, element))
        field = whole if part is None else whole.sub(part)
        whole.x.array[:] = 1e6
        field.interpolate(lambda x: np.full(x.shape[1], 7.0), cells)
        whole.x.scatter_forward()
        found = nodal(transfer.values(field, to="secondary"))
        assert np.abs(found[nodes] - 7.0).max(initial=0.0) <= 100 * ROUNDING


def test_values_of_facets_are_weighed_by_area(comm):
    """A node between two facets of unequal size has their mean by area."""
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(2, 1), distort=0.6)
    values = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
    facets = scene.facet_tags.find(LOWER)
    cells_of = scene.mesh.topology.connectivity(1, 2)
    cells = cells_of.array[cells_of.offsets[facets]]
    middles = compute_midpoints(scene.mesh, 1, facets)[:, 0]
    right = middles > 0.5
    values.x.array[cells[right]] = 1.0
    values.x.scatter_forward()
    Q = fem.functionspace(scene.mesh, ("Lagrange", 1))
    found = facet_means(values, Q, scene.facet_tags, LOWER)
    x = Q.tabulate_dof_coordinates()
    _, primary = sides(scene)
    x, found = x[primary, 0], nodal(found)[primary]
    inner = (x > 0.1) & (x < 0.9)
    assert comm.allreduce(inner.sum()) == 1
    assert np.abs(x[inner] - 0.5).min(initial=1.0) > 0.01
    np.testing.assert_allclose(found[inner], 1.0 - x[inner], rtol=ROUNDING)
    np.testing.assert_allclose(found[~inner], np.round(x[~inner]), atol=ROUNDING)


def test_a_slip_bound_from_the_pressure_of_another_solution(comm):
    """What is on the mesh goes into a law, and is changed in place; the surface's does not."""
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1))
    with scene.problem() as problem:
        pressed = problem.solve(rtol=1e-10)
    p = pressed.on_mesh("pressure")
    with scene.but(friction=Tresca(0.3 * p)).problem() as problem:
        assert problem.solve(rtol=1e-8).counts.stick == pressed.counts.nodes
        p.x.array[:] = 0.0
        assert problem.solve(rtol=1e-8).counts.idle + problem.solve().counts.slip > 0
    with pytest.raises(InputError, match=r"another mesh .* take solution.on_mesh\("):
        scene.but(friction=Tresca(pressed.pressure)).problem()


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_conductance_takes_what_it_gives(comm, kind, degree):
    """A constant drives no flux; else it is h (T - P T) on one side, P' of it on the other."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    transfer = SideTransfer(scene.V, scene.operators(), scene.pair)
    across = scene.mesh.geometry.dim - 1
    T = node_function(scene.mesh, lambda x: 20.0 + np.sin(9.0 * x[0]) + 5.0 * (x[across] > 1.001))
    h = node_function(scene.mesh, lambda x: 1.0 + x[0] ** 2)
    C = transfer.conductance(h)
    flow, nothing = fem.Function(T.function_space), C.createVecLeft()
    C.mult(T.x.petsc_vec, flow.x.petsc_vec)
    flow.x.scatter_forward()
    ones = C.createVecRight()
    ones.set(1.0)
    C.mult(ones, nothing)
    assert nothing.norm() <= ROUNDING * C.norm()
    secondary, primary = sides(scene)
    load, before, areas = transfer.areas(), transfer.values(T, "secondary"), transfer.areas()
    load.x.array[:] = h.x.array * areas.x.array * (T.x.array - before.x.array)
    size = comm.allreduce(np.abs(load.x.array).max(), op=MPI.MAX)
    taken = nodal(transfer.loads(load))[primary]
    for side, wanted in ((secondary, nodal(load)[secondary]), (primary, -taken)):
        found = nodal(flow)[side]
        assert np.abs(found - wanted).max(initial=0.0) <= ROUNDING * size
        assert comm.allreduce(len(side)) > 0
    for owned in (C, ones, nothing):
        owned.destroy()
    with pytest.raises(InputError, match="must be a scalar Function of degree 1"):
        transfer.conductance(fem.Function(fem.functionspace(scene.mesh, ("DG", 0))))


def test_what_cannot_be_carried(comm):
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1))
    other = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1))
    transfer = SideTransfer(scene.V, scene.operators(), scene.pair)
    with pytest.raises(InputError, match="must be a Function on the mesh"):
        transfer.loads(node_function(other.mesh, lambda x: x[0]))
    points = basix.ufl.quadrature_element("quadrilateral", (), degree=2)
    with pytest.raises(InputError, match=r"found the Function 'heat' of shape \(\) .* quadrature"):
        transfer.loads(fem.Function(fem.functionspace(scene.mesh, points), name="heat"))
    for element in (("DG", 0), ("Lagrange", 2)):  # whose sum would be lost
        with pytest.raises(InputError, match=r"loads of nodes must be .* degree 1, assembled"):
            transfer.loads(fem.Function(fem.functionspace(scene.mesh, element)))
    with pytest.raises(InputError, match='to must be "secondary" or "primary", found \'left\''):
        transfer.values(node_function(scene.mesh, lambda x: x[0]), to="left")
