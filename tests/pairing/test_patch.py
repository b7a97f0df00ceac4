"""Patch tests: two blocks with meshes that do not match transfer a uniform stress exactly."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from rotations import rotation

from dolfinx import fem

from dolfinx_tresca import Bonded, ContactStatus, PairingError, Tresca
from scenes.patches import KINDS, SIDES, UPPER, dim_of, patch
from scenes.scene import EPS, Scene

RTOL = 1e-12

#: Relative error of stresses and displacements: the residual times the condition number of A.
TOLERANCE = 1e3 * RTOL

TURNS = {dim: rotation(11, dim) for dim in (2, 3)}


def largest(comm, values) -> float:
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def check_patch(comm, scene: Scene, tolerance: float = TOLERANCE, kind: str = "mortar") -> None:
    """Solve and compare pressure, displacement and force with the exact solution."""
    with scene.problem() as problem:
        assert kind in str(problem)
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    size = largest(comm, scene.data.exact.x.array)
    assert largest(comm, solution.u.x.array - scene.data.exact.x.array) <= tolerance * size
    state = solution.state.x.array
    pressure = solution.pressure.x.array[state >= 0]
    assert largest(comm, pressure - scene.data.pressure) <= tolerance * abs(scene.data.pressure)
    assert solution.normal_force == pytest.approx(
        scene.data.pressure * scene.data.overlap, rel=tolerance
    )
    if solution.traction is not None:
        assert largest(comm, solution.traction.x.array) <= tolerance * abs(scene.data.pressure)


@pytest.mark.parallel(kind=["triangle", "hexahedron"], degree=[2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"gap": 0.01, "young": (1000.0, 3000.0)},
        {"gap": -0.001, "friction": Tresca(0.5)},
        {"turned": True, "scale": 100.0, "shift": (3.0, -2.0, 0.0)},
        {"turned": True, "mirrored": True, "geometry": 2, "split": True, "friction": Tresca(0.5)},
        {"friction": Bonded(), "pressure": -2.5},
        {"symmetry": True, "reverse": True, "upper": (2, 1), "lower": (5, 2)},
    ],
    ids=lambda options: "-".join(options) or "plain",
)
def test_a_uniform_stress_passes(comm, kind, degree, options):
    """The blocks have a gap or overlap, are rotated or mirrored, rub, or are bonded in tension."""
    options = dict(options)
    dim = dim_of(kind)
    if options.pop("turned", False):
        options["turn"] = TURNS[dim]
        if options.pop("mirrored", False):
            options["turn"] = TURNS[dim] @ np.diag([-1.0] + [1.0] * (dim - 1))
    check_patch(comm, patch(comm, kind, degree, pairing="mortar", **options))


@pytest.mark.parallel(kind=["tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_matching_meshes_pass_too(comm, kind):
    scene = patch(comm, kind, upper=(3, 2), lower=(3, 2), distort=0.0, pairing="nodes")
    check_patch(comm, scene)


@pytest.mark.parametrize("kind", KINDS)
def test_very_narrow_overlap_is_an_error(comm, kind):
    """With a width of 1e-5 cells no node carries a multiplier."""
    dim = dim_of(kind)
    scene = patch(comm, kind, span=[(1.0 - 1e-5, 2.0)] * (dim - 1), pairing="mortar")
    with pytest.raises(PairingError, match="do not face each other"):
        scene.operators()


@pytest.mark.parallel(kind=["triangle", "tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_nodes_just_beyond_the_edge_of_a_stiff_body(comm, kind):
    """With multipliers their pressures would be those at the edge times h / sliver."""
    dim = dim_of(kind)
    peaks = []
    for sliver in (0.0, 0.01):
        scene = patch(
            comm,
            kind,
            upper=(4, 1),
            lower=(3, 1),
            distort=0.0,
            span=[(sliver - 0.25, sliver + 0.75)] * (dim - 1),
            young=(10.0, 1000.0),
        )
        with scene.problem() as problem:
            area = comm.allreduce(problem.operators[0].weights.sum())
            assert area == pytest.approx(scene.data.overlap, rel=1e4 * EPS)
            peaks.append(problem.solve(rtol=1e-6).peak_pressure)
    assert peaks[1] < 1.2 * peaks[0]


@pytest.mark.parallel(kind=["hexahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_held_nodes_of_the_secondary_side_take_no_part(comm, kind):
    """The displacement is prescribed on the edge where the first coordinate is least."""
    scene = patch(comm, kind)
    dim = dim_of(kind)
    edge = fem.locate_dofs_topological(scene.V, dim - 1, scene.facet_tags.find(SIDES[0]))
    bcs = [*scene.bcs, fem.dirichletbc(scene.data.exact, edge)]
    with scene.problem() as problem, scene.problem(bcs=bcs) as with_fixed_edge:
        number = 1 if dim == 2 else 4
        assert with_fixed_edge.contact_nodes == problem.contact_nodes - number
        solution = with_fixed_edge.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED


@pytest.mark.parallel(kind=["tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_facet_without_area_is_an_error(comm, kind):
    """A node of the upper face is moved onto another node."""
    scene = patch(comm, kind, distort=0.0)
    x = scene.mesh.geometry.x
    line = np.isclose(x[:, dim_of(kind) - 1], 1.0) & np.isclose(x[:, 0], 1 / 3)
    x[line, 0] = 0.0
    message = r"facets of tag 1 \(secondary side\) have no area.*Repair the mesh"
    with pytest.raises(PairingError, match=message):
        scene.problem()


@pytest.mark.parallel(kind=["hexahedron"])
@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_prescribed_secondary_side_is_an_error(comm, kind):
    scene = patch(comm, kind)
    dofs = fem.locate_dofs_topological(scene.V, scene.facet_tags.dim, scene.facet_tags.find(UPPER))
    with pytest.raises(PairingError, match="can carry a multiplier"):
        scene.problem(bcs=[*scene.bcs, fem.dirichletbc(scene.data.exact, dofs)])


@pytest.mark.parallel
@pytest.mark.parametrize("kind", KINDS)
def test_solution_does_not_depend_on_the_number_of_ranks(comm, kind):
    """The stress is not uniform; the reference is solved by each rank on a mesh of its own."""
    results = []
    for one in (comm, MPI.COMM_SELF):
        scene = patch(one, kind, span=[(0.3, 1.3)] * (dim_of(kind) - 1), friction=Tresca(0.3))
        with scene.problem() as problem:
            solution = problem.solve(rtol=1e-9)
            results.append((solution.q[-1], solution.normal_force, solution.tangential_force,
                            problem.contact_nodes))  # fmt: skip
    assert results[0] == pytest.approx(results[1], rel=1e-6)
    assert results[0][2] > 1e-3 * results[0][1] > 0.0  # with friction and pressure
