"""Transfer of fields and loads between the sides of a pair."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import ufl
from dolfinx import fem

from dolfinx_tresca import InputError, Tresca
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from scenes.nodal import nodal, node_function
from scenes.patches import LOWER, UPPER, patch
from scenes.scene import EPS

pytestmark = pytest.mark.parallel

KINDS = [("quadrilateral", 1), ("triangle", 2), ("tetrahedron", 1), ("tetrahedron", 2)]

#: Rounding of sums of integrals over some hundred facets.
ROUNDING = 1e4 * EPS


def sides(scene):
    """Return the owned nodes of degree 1 on the secondary side, and those on the primary side."""
    V = fem.functionspace(scene.mesh, ("Lagrange", 1))
    dim, owned = scene.mesh.topology.dim - 1, V.dofmap.index_map.size_local
    found = [fem.locate_dofs_topological(V, dim, scene.facet_tags.find(t)) for t in (UPPER, LOWER)]
    return [np.unique(nodes[nodes < owned]) for nodes in found]


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_transfer_to_the_secondary_side_is_exact_for_linear_fields(comm, kind, degree):
    """The field differs on the upper body; the result is zero off the secondary side."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    across = scene.mesh.geometry.dim - 1
    f = node_function(scene.mesh, lambda x: 2.0 + x[0] - 0.5 * x[1] + 100.0 * (x[across] > 1.001))
    found = ContactOperators(scene.V, scene.operators(), scene.pair).transfer(f, to="secondary")
    secondary, _ = sides(scene)
    x = found.function_space.tabulate_dof_coordinates()[secondary]
    expected = 2.0 + x[:, 0] - 0.5 * x[:, 1]
    assert np.abs(nodal(found)[secondary] - expected).max(initial=0.0) <= ROUNDING
    others = np.delete(nodal(found), secondary)
    assert np.abs(others).max(initial=0.0) == 0.0


@pytest.mark.parametrize(("kind", "degree"), KINDS)
def test_transfer_of_loads_conserves_their_sum(comm, kind, degree):
    """The transfer of loads is the transpose of that of values, for scalars and vectors."""
    scene = patch(comm, kind, degree, upper=(3, 1), lower=(2, 1))
    transfer = ContactOperators(scene.V, scene.operators(), scene.pair)
    secondary, primary = sides(scene)
    load = node_function(scene.mesh, lambda x: 1.0 + np.sin(7.0 * x[0]))
    taken = transfer.transfer_loads(load)
    total, arrived = comm.allreduce(
        np.array([nodal(load)[secondary].sum(), nodal(taken)[primary].sum()])
    )
    assert arrived == pytest.approx(total, rel=ROUNDING)
    f = node_function(scene.mesh, lambda x: np.cos(3.0 * x[0] + x[1]))
    work = comm.allreduce(nodal(taken) @ nodal(f))
    values = nodal(transfer.transfer(f, to="secondary"))
    assert work == pytest.approx(comm.allreduce(nodal(load)[secondary] @ values[secondary]))

    dim = scene.mesh.geometry.dim
    vector = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1, (dim,))))
    vector.interpolate(lambda x: np.outer(np.arange(1, 1 + dim), 1.0 + x[0]))
    taken = transfer.transfer_loads(vector)
    sums = [nodal(vector)[secondary].sum(axis=0), nodal(taken)[primary].sum(axis=0)]
    total, arrived = comm.allreduce(np.array(sums))
    np.testing.assert_allclose(arrived, total, rtol=ROUNDING)


@pytest.mark.parametrize(("kind", "degree"), [("triangle", 2), ("tetrahedron", 1)])
def test_pressure_on_the_mesh_integrates_to_the_force_on_both_sides(comm, kind, degree):
    """The gap is zero, and the normal points down on both sides."""
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
        with pytest.raises(InputError, match="to transfer; its fields are displacement, pressure"):
            solution.on_mesh(name)


def test_force_on_both_sides_of_a_partial_overlap(comm):
    """The force is the sum of p times areas, and the integral of p times `area_fraction`."""
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


def test_slip_bound_from_the_pressure_of_another_solution(comm):
    """A field on the mesh may be part of a law and be changed in place; surface fields may not."""
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


def test_functions_that_cannot_be_transferred(comm):
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1))
    other = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1))
    transfer = ContactOperators(scene.V, scene.operators(), scene.pair)
    with pytest.raises(InputError, match="must be a Function of Lagrange elements of degree 1 on"):
        transfer.transfer_loads(node_function(other.mesh, lambda x: x[0]))
    points = basix.ufl.quadrature_element("quadrilateral", (), degree=2)
    with pytest.raises(InputError, match=r"found the Function 'heat' of shape \(\) .* quadrature"):
        transfer.transfer_loads(fem.Function(fem.functionspace(scene.mesh, points), name="heat"))
    for element in (("DG", 0), ("Lagrange", 2)):  # their sum would not be conserved
        for method in (transfer.transfer, transfer.transfer_loads):
            with pytest.raises(InputError, match="Interpolate or project it into such a space"):
                method(fem.Function(fem.functionspace(scene.mesh, element)))
    with pytest.raises(InputError, match='to must be "secondary" or "primary", found \'left\''):
        transfer.transfer(node_function(scene.mesh, lambda x: x[0]), to="left")
