"""Patch tests: two blocks with meshes that do not match transfer a uniform stress exactly."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from rotations import rotation

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactStatus,
    Frictionless,
    PairingError,
    RigidPlane,
    Tresca,
)
from scenes.patches import KINDS, LOWER, SIDES, TOP, UPPER, dim_of, patch
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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("upper", "lower"), [(2, 4), (4, 2), (1, 3)])
def test_nested_meshes_pass_too(comm, kind, upper, lower):
    """Every node of the coarse side coincides with one of the fine side, but not the reverse."""
    check_patch(comm, patch(comm, kind, upper=(upper, 2), lower=(lower, 2), distort=0.0))


@pytest.mark.parallel(kind=["tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_matching_meshes_pass_too(comm, kind):
    scene = patch(comm, kind, upper=(3, 2), lower=(3, 2), distort=0.0, pairing="nodes")
    check_patch(comm, scene)


@pytest.mark.parametrize("friction", [Frictionless(), Tresca(0.5), Bonded()])
def test_rtol_below_rounding(comm, friction):
    """The solve stagnates at the attainable accuracy, or converges; nothing overflows."""
    scene = patch(comm, "tetrahedron", pairing="mortar", friction=friction)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-14)
    assert solution.status in (ContactStatus.CONVERGED, ContactStatus.STAGNATED)
    pressure = solution.pressure.x.array[solution.state.x.array >= 0]
    assert largest(comm, pressure - scene.data.pressure) <= TOLERANCE * scene.data.pressure


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_exchange_of_secondary_and_primary(comm, kind, degree):
    scene = patch(comm, kind, degree)
    check_patch(comm, scene.but(secondary=LOWER, primary=UPPER))


@pytest.mark.parametrize("kind", KINDS)
def test_small_scenes_far_from_the_origin(comm, kind):
    """The rounding of coordinates is EPS times the distance, relative to the displacement."""
    distance, scale = 10.0, 1e-3
    scene = patch(comm, kind, scale=scale, shift=(distance, distance, 0.0))
    check_patch(comm, scene, 1e3 * EPS * distance / largest(comm, scene.data.exact.x.array))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_block_on_the_middle_of_a_larger_face(comm, kind, degree):
    """A load with the same pressure acts on the rest of the larger face."""
    start, end, p = 0.25, 0.75, 2.5
    scene = patch(
        comm, kind, degree, upper=(3, 2), lower=(4, 2), distort=0.0,
        span=[(start, end)] * (dim_of(kind) - 1),
    )  # fmt: skip
    x = ufl.SpatialCoordinate(scene.mesh)
    covered = 1.0
    for i in range(dim_of(kind) - 1):
        covered *= ufl.conditional(abs(x[i] - 0.5) < 0.25, 1.0, 0.0)
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    v = ufl.TestFunction(scene.V)
    L = scene.L - p * (1.0 - covered) * ufl.inner(ufl.FacetNormal(scene.mesh), v) * ds(LOWER)
    for secondary, primary in ((UPPER, LOWER), (LOWER, UPPER)):
        with scene.but(secondary=secondary, primary=primary).problem(L=L) as problem:
            solution = problem.solve(rtol=RTOL)
        assert solution.status is ContactStatus.CONVERGED
        assert solution.normal_force == pytest.approx(p * scene.data.overlap, rel=TOLERANCE)
        if secondary == UPPER:
            pressure = solution.pressure.x.array[solution.state.x.array >= 0]
            assert largest(comm, pressure - p) <= TOLERANCE * p
            size = largest(comm, scene.data.exact.x.array)
            assert largest(comm, solution.u.x.array - scene.data.exact.x.array) <= TOLERANCE * size


@pytest.mark.parallel(kind=["triangle", "tetrahedron"], shift=[0.9])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shift", [0.4, 0.9, -0.77])
def test_blocks_that_overlap_in_part(comm, kind, shift):
    """Weights sum to the overlap, and the jump of translations is zero."""
    dim = dim_of(kind)
    scene = patch(comm, kind, span=[(shift, 1.0 + shift)] * (dim - 1), gap=0.001)
    operators = scene.operators()
    # nodes with a very small covered part give it to their neighbours
    area = comm.allreduce(operators.weights.sum())
    assert area == pytest.approx(scene.data.overlap, rel=1e4 * EPS)
    assert largest(comm, operators.gap - 0.001) <= 1e4 * EPS
    assert largest(comm, operators.N.sum(axis=1)) <= 1e3 * EPS
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-9)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.normal_force > 0.0


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


@pytest.mark.parametrize("kind", KINDS)
def test_number_of_multipliers_of_each_law(comm, kind):
    """A node has one multiplier without friction, and d multipliers with friction."""
    dim = dim_of(kind)
    for friction, number in ((Frictionless(), 1), (Tresca(0.1), dim), (Bonded(), dim)):
        with patch(comm, kind, friction=friction).problem() as problem:
            solution = problem.solve(rtol=1e-6)
            size = comm.allreduce(len(solution.multipliers))
            assert size == number * problem.contact_nodes
            assert str(friction) in str(problem)
        assert (solution.traction is None) == (number == 1)
        assert (solution.slip is None) == (number == 1)
        names = {function.name for function in solution.surface.functions}
        assert names >= {"displacement", "pressure", "gap", "state", "normal"}
        assert ({"traction", "slip"} <= names) == (number > 1)
        if number > 1:
            assert solution.traction.ufl_shape == (dim,)
    assert solution.counts.bonded == solution.counts.nodes


@pytest.mark.parametrize("kind", ["quadrilateral", "tetrahedron"])
def test_traction_of_a_sliding_block_equals_its_bound(comm, kind):
    """The upper block is pushed along the first axis; the force is the bound times the area."""
    bound, dim = 0.1, dim_of(kind)
    scene = patch(comm, kind, friction=Tresca(bound), turn=TURNS[dim])
    push = np.zeros(dim)
    push[0] = 0.05
    u = fem.Function(scene.V)
    u.x.array[:] = scene.data.exact.x.array + np.tile(
        TURNS[dim] @ push, len(scene.data.exact.x.array) // dim
    )
    dofs = fem.locate_dofs_topological(scene.V, dim - 1, scene.facet_tags.find(TOP))
    bcs = [fem.dirichletbc(u, dofs), scene.bcs[1]]
    with scene.problem(bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-9)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.counts.slip == solution.counts.nodes
    assert solution.tangential_force == pytest.approx(bound * scene.data.overlap, rel=1e-6)
    traction = solution.traction.x.array.reshape(-1, dim)
    assert np.allclose(traction, bound * TURNS[dim] @ (push / 0.05), atol=2e-2 * bound)


@pytest.mark.parallel(kind=["tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [Frictionless(), Tresca(0.2)])
def test_block_in_two_pairs(comm, kind, law):
    """A rigid wall also touches the side of a block, without pressure."""
    scene = patch(comm, kind)
    normal = np.eye(3)[0]
    wall = ContactPair(scene.facet_tags, SIDES[0], RigidPlane((0.0, 0.0, 0.0), normal), law)
    with scene.problem(pairs=[scene.pair, wall]) as problem:
        assert str(problem).count("  pair") == 2
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    first, second = solution.surfaces
    state = first.state.x.array >= 0
    if isinstance(law, Frictionless):
        assert (
            largest(comm, first.pressure.x.array[state] - scene.data.pressure)
            <= TOLERANCE * scene.data.pressure
        )
        assert largest(comm, second.pressure.x.array) <= TOLERANCE * scene.data.pressure
        assert second.traction is None
    else:
        assert second.traction is not None and first.traction is None
    assert second.gap.x.array.min(initial=0.0) >= -1e-9


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "hexahedron"])
def test_one_face_in_two_pairs(comm, kind):
    """Each half of the upper face is paired with the lower block."""
    scene = patch(comm, kind, upper=(4, 2), distort=0.0)
    tags = scene.facet_tags
    values = tags.values.copy()
    upper = tags.indices[tags.values == UPPER]
    middle = dolfinx.mesh.compute_midpoints(scene.mesh, tags.dim, upper).reshape(-1, 3)
    values[tags.values == UPPER] = np.where(middle[:, 0] > 0.5, 11, 12)
    split = dolfinx.mesh.meshtags(scene.mesh, tags.dim, tags.indices, values)
    pairs = [ContactPair(split, one, LOWER, Frictionless()) for one in (11, 12)]
    with scene.problem(pairs=pairs) as problem:
        solution = problem.solve(rtol=1e-9)
    assert solution.status is ContactStatus.CONVERGED
    assert solution.normal_force == pytest.approx(
        scene.data.pressure * scene.data.overlap, rel=1e-6
    )


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


@pytest.mark.parallel(kind=["hexahedron"])
@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_prescribed_secondary_side_is_an_error(comm, kind):
    scene = patch(comm, kind)
    dofs = fem.locate_dofs_topological(scene.V, scene.facet_tags.dim, scene.facet_tags.find(UPPER))
    with pytest.raises(PairingError, match="can carry a multiplier"):
        scene.problem(bcs=[*scene.bcs, fem.dirichletbc(scene.data.exact, dofs)])


@pytest.mark.parallel(kind=["triangle", "tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_nodes_shared_by_both_sides_carry_no_multiplier(comm, kind):
    """The contact surface is a crack; the blocks share nodes beyond the crack tip."""
    n = 4
    scene = patch(
        comm, kind, upper=(n, 2), lower=(n, 2), distort=0.0, merge=lambda x: x[:, 0] < 0.51
    )
    operators = scene.operators()
    assert comm.allreduce(len(operators.nodes)) == (2 if dim_of(kind) == 2 else 2 * (n + 1))
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    size = largest(comm, scene.data.exact.x.array)
    assert largest(comm, solution.u.x.array - scene.data.exact.x.array) <= TOLERANCE * size


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
