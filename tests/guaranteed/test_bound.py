"""The guaranteed bound against errors that are known."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem
from dolfinx.mesh import (
    compute_midpoints,
    create_unit_cube,
    create_unit_square,
    exterior_facet_indices,
    locate_entities_boundary,
    meshtags,
)

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca.dual.accuracy import total
from dolfinx_tresca.guaranteed.bound import Bodies
from dolfinx_tresca.guaranteed.cells import MeshCells
from dolfinx_tresca.guaranteed.forms import loads
from scenes.assembled import linear_solution
from scenes.elasticity import elasticity, fixed
from scenes.known_contact import HELD, block_on_plane
from scenes.manufactured import blocks_scene, norm
from scenes.two_bricks import two_bricks

ROUNDING = 1e-9


@pytest.mark.parametrize("kind", ["lifts", "slips"])
@pytest.mark.parallel(kind=["lifts", "slips"])
def test_known_solutions_on_a_plane(comm, kind):
    """The bound is above the error, and near it as the oscillation of the loads falls with h^2."""
    ratios, oscillations = [], []
    for n in (8, 16):
        scene = block_on_plane(comm, "triangle", 1, n, kind, distort=0.4, seed=n)
        with scene.problem() as problem:
            solution = problem.solve(accuracy=1e-6)
            bound = problem.guaranteed_error()
        error = scene.data.error(solution.u)
        ratios.append(bound.error / error)
        oscillations.append(bound.oscillation)
        assert bound.complementarity >= -ROUNDING * error**2
        assert bound.friction >= -ROUNDING * error**2
        assert bound.lift <= 1e-6 * error
        assert bound.relative_error == pytest.approx(bound.error / scene.data.norm, rel=0.05)
        assert bound.error <= total(bound.cell_errors) <= 1.02 * bound.error
    assert min(ratios) >= 1.0
    assert ratios[1] <= 1.15
    assert oscillations[1] <= 0.3 * oscillations[0]


@pytest.mark.parametrize("kind", ["lifts", "slips"])
def test_load_steps(comm, kind):
    """Slip counts from the last step: the same loads again are bounded as no new slip."""
    scene = block_on_plane(comm, "triangle", 1, 8, kind)
    with scene.problem() as problem:
        problem.solve(rtol=1e-9)
        bound = problem.guaranteed_error()
        problem.accept()
        problem.solve(rtol=1e-9)
        again = problem.guaranteed_error()
    assert again.stress == pytest.approx(bound.stress, rel=1e-3)
    assert abs(again.friction) <= abs(bound.friction) + ROUNDING * bound.error**2


@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(6, 20))]
)
def test_never_below_the_error_on_random_scenes(seed, comm):
    rng = np.random.default_rng(seed)
    for kind in ("lifts", "slips"):
        scene = block_on_plane(
            comm,
            "triangle",
            int(rng.integers(1, 3)),
            2 * int(rng.integers(1, 5)),
            kind,
            poisson=rng.uniform(0.0, 0.45),
            size=rng.uniform(0.1, 1.0),
            distort=rng.uniform(0.0, 0.7),
            seed=seed,
        )
        with scene.problem() as problem:
            solution = problem.solve(rtol=float(10.0 ** -rng.uniform(0.5, 8.0)))
            bound = problem.guaranteed_error(gain=float(rng.choice([0.01, 0.1, 1.0])))
        assert bound.error >= scene.data.error(solution.u)


@pytest.mark.parametrize("kind", ["lifts", "slips"])
def test_any_displacement_and_admissible_multipliers(comm, kind):
    """As at the end of an iteration that stops early: nodes penetrate, and forces are wrong."""
    scene = block_on_plane(comm, "triangle", 1, 8, kind)
    with scene.problem() as problem:
        problem.solve(rtol=1e-8)
        solved, linear = problem._contact.solved, problem._contact.linear
        bodies = Bodies(linear, solved.dual)
        rng = np.random.default_rng(1)
        for size in (1e-3, 1e-2):
            u = solved.fields.u.copy()
            u.x.array[~linear.prescribed] += size * rng.standard_normal((~linear.prescribed).sum())
            for factor in (0.7, 1.0):
                multipliers = factor * solved.multipliers
                bound = bodies.error(solved.dual, multipliers, u)
                error = scene.data.error(u)
                assert error <= bound.error
                assert bound.lift > 0.01 * error
                if factor == 1.0:
                    assert bound.error <= 2.0 * error


@pytest.mark.parallel
def test_two_bodies_whose_meshes_match(comm):
    ratios = []
    for n in (4, 8):
        scene = blocks_scene(comm, "triangle", 1, (n, n))
        with scene.problem() as problem:
            solution = problem.solve(accuracy=1e-6)
            bound = problem.guaranteed_error()
        ratios.append(bound.error / norm(comm, scene.data.energy(solution.u - scene.data.exact)))
    assert min(ratios) >= 1.0
    assert ratios[1] <= 1.1


def test_tetrahedra(comm):
    """Curved loads on a coarse mesh."""
    scene = blocks_scene(comm, "tetrahedron", 1, (3, 3))
    with scene.problem(stiffness="multigrid") as problem:
        solution = problem.solve(accuracy=1e-6)
        bound = problem.guaranteed_error()
    error = norm(comm, scene.data.energy(solution.u - scene.data.exact))
    assert error <= bound.error <= 1.3 * error


@pytest.mark.parallel(end=["free_end_2"])
@pytest.mark.parametrize("end", ["free_end_1", "free_end_2"])
def test_bricks_held_at_opposite_ends(comm, end):
    """Nodes where a prescribed node faces a free one, and tetrahedra with uniform loads."""
    energies, bounds = [], []
    for N in (3, 6):
        with two_bricks(comm, N, end=end).problem() as problem:
            energies.append(problem.solve(rtol=1e-8).primal_energy)
            bounds.append(problem.guaranteed_error())
    assert bounds[0].oscillation <= 1e-6 * bounds[0].error
    squares = [total(bound.cell_errors) ** 2 for bound in bounds]
    assert 0.1 * squares[0] <= 2.0 * (energies[0] - energies[1]) <= squares[0]
    assert squares[1] < 0.7 * squares[0]


@pytest.mark.parametrize("degree", [1, 2])
def test_degree_2_and_planes(comm, degree):
    """The bound contains what the displacement penetrates between nodes."""
    scene = block_on_plane(comm, "triangle", degree, 8, "slips")
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-8)
        bound = problem.guaranteed_error()
    error = scene.data.error(solution.u)
    assert error <= bound.error <= (1.2 if degree == 1 else 1.8) * error
    assert (bound.lift > 1e-3 * error) == (degree == 2)


@pytest.mark.parametrize("load", ["volume", "traction"])
def test_oscillating_loads(comm, load):
    """A load that the mesh does not see: the displacement is zero, the error is not.

    The load is orthogonal to linear functions on each cell, and the exact energy is from below
    |u|^2 >= L(w)^2 / |w|^2 for w in a finer space.
    """
    scene = block_on_plane(comm, "triangle", 1, 4, "lifts")
    fine = fem.functionspace(scene.mesh, ("Lagrange", 2, (2,)))
    x = ufl.SpatialCoordinate(scene.mesh)
    wave = 1e-3 * ufl.sin(8.0 * ufl.pi * x[0])
    v = ufl.TestFunction(scene.V)
    top = ufl.conditional(ufl.gt(x[1], 0.5 - 1e-9), 1.0, 0.0)

    def form(w):
        direction = ufl.as_vector((wave, 0.0))
        if load == "volume":
            return ufl.inner(direction, w) * ufl.dx(metadata={"quadrature_degree": 10})
        return top * ufl.inner(direction, w) * ufl.ds(metadata={"quadrature_degree": 10})

    bcs = [fixed(scene.V, scene.facet_tags.find(HELD))]
    with scene.but(gap=1.0).problem(L=form(v), bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-8)
        bound = problem.guaranteed_error()
    u, w = ufl.TrialFunction(fine), ufl.TestFunction(fine)
    a = ufl.replace(scene.a, dict(zip(scene.a.arguments(), (w, u), strict=True)))
    held = fem.locate_dofs_geometrical(fine, lambda x: np.isclose(x[0], 0.0))
    better = linear_solution(a, form(w), [fem.dirichletbc(fem.Function(fine), held)])
    difference = better - solution.u
    error = norm(
        comm, ufl.replace(scene.a, dict(zip(scene.a.arguments(), (difference,) * 2, strict=True)))
    )
    assert 0.0 < error <= bound.error
    assert bound.oscillation > 0.1 * error


@pytest.mark.parametrize("quadratic", [0.0, 0.3, 10.0])
@pytest.mark.parametrize("cubic", [0.0, 1.0])
def test_oscillation_of_tractions(quadratic, cubic):
    """Tractions on an edge are linear, with Legendre's polynomials of degree 2 and 3 of norm 1."""
    mesh = create_unit_square(MPI.COMM_SELF, 1, 1)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    x, y = ufl.SpatialCoordinate(mesh)
    z = 2.0 * x - 1.0
    load = 0.7 - x + quadratic * 5**0.5 * (3.0 * z**2 - 1.0) / 2.0
    load += cubic * 7**0.5 * (5.0 * z**3 - 3.0 * z) / 2.0
    on_edge = ufl.conditional(ufl.lt(y, 1e-9), 1.0, 0.0)
    L = on_edge * load * ufl.TestFunction(V)[1] * ufl.ds
    cells = MeshCells(V)
    loading, oscillation = loads(L, cells, np.ones((2, 4)), None)
    assert oscillation.sum() == pytest.approx(np.hypot(quadratic, cubic), abs=1e-9)
    points = cells.points[:, [[1, 2], [0, 2], [0, 1]]]
    tractions = np.where(np.abs(points[..., 1]) < 1e-9, 0.7 - points[..., 0], 0.0)
    below = (np.abs(points[..., 1]) < 1e-9).all(axis=2)
    assert np.allclose(loading[:, :, :2, 1], tractions * below[:, :, None])


@pytest.mark.parametrize("law", [Frictionless(), Tresca(0.005), Coulomb(0.2), Bonded()], ids=str)
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("floor", ["free", "half clamped"])
def test_supports_along_axes(comm, law, dim, floor):
    """Nodes that are prescribed along some axes: tractions that lack there stay admissible.

    On a floor that is half clamped the nodes of whole facets lack tractions. The energy above that
    of a finer mesh is below half of the squared bound.
    """
    found = []
    for n in (2, 4):
        divisions = [n] * dim
        mesh = (create_unit_square if dim == 2 else create_unit_cube)(comm, *divisions)
        V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        mesh.topology.create_connectivity(dim - 1, dim)
        sides = [
            locate_entities_boundary(mesh, dim - 1, lambda x, k=k, at=at: np.isclose(x[k], at))
            for k, at in ((0, 0.0), (dim - 1, 1.0), (dim - 1, 0.0), (1, 0.0))
        ]
        bcs = [fixed(V, sides[0], 0.0, 0), fixed(V, sides[1], -0.02, dim - 1)]
        bcs += [fixed(V, sides[3], 0.0, 1)] if dim == 3 else []
        if floor == "half clamped":
            half = sides[2][compute_midpoints(mesh, dim - 1, sides[2])[:, 0] < 0.5]
            bcs += [fixed(V, half, 0.0, axis) for axis in range(dim)]
        tags = meshtags(mesh, dim - 1, np.sort(sides[2]), np.full(len(sides[2]), 7, np.int32))
        a = elasticity(V, 1.0)
        x = ufl.SpatialCoordinate(mesh)
        push = ufl.as_vector([0.05 * x[dim - 1]] + [0.0] * (dim - 1))
        L = ufl.inner(push, ufl.TestFunction(V)) * ufl.dx
        pair = ContactPair(tags, 7, RigidPlane((0, 0, 0), np.eye(3)[dim - 1]), law)
        with ContactProblem(a, L, [pair], bcs=bcs) as problem:
            solution = problem.solve(rtol=1e-8)
            bound = problem.guaranteed_error()
        assert bound.complementarity >= -ROUNDING * bound.error**2
        assert bound.friction >= -ROUNDING * bound.error**2
        assert bound.oscillation <= 1e-6 * bound.error
        u = solution.u
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags, metadata={"quadrature_degree": 6})
        energy = 0.5 * ufl.action(ufl.action(a, u), u) - ufl.action(L, u)
        if isinstance(law, Tresca):
            slip = sum(u[i] ** 2 for i in range(dim - 1))
            energy += law.slip_bound * ufl.sqrt(slip + 1e-30) * ds(7)
        value = comm.allreduce(fem.assemble_scalar(fem.form(energy)))
        found.append((value, total(bound.cell_errors)))
    (coarse, bound_of_coarse), (fine, bound_of_fine) = found
    assert bound_of_fine < bound_of_coarse
    if not isinstance(law, Coulomb):  # whose meshes have different bounds
        assert 0.1 * bound_of_coarse**2 < 2.0 * (coarse - fine) <= bound_of_coarse**2


@pytest.mark.parametrize("law", [Frictionless(), Tresca(0.003)], ids=str)
def test_a_body_with_an_edge_on_a_plane(comm, law):
    """Its facets are not parallel to the plane; the energy on a finer mesh is from above."""
    energies, bounds = [], []
    for n in (4, 8):
        mesh = create_unit_square(comm, n, n)
        x = mesh.geometry.x
        x[:, 1] += 0.2 * np.abs(x[:, 0] - 0.5) * (1.0 - x[:, 1])
        V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
        mesh.topology.create_connectivity(1, 2)
        exterior = exterior_facet_indices(mesh.topology)
        middle = compute_midpoints(mesh, 1, exterior)
        bottom = exterior[(middle[:, 1] < 0.15) & (np.abs(middle[:, 0] - 0.5) < 0.499)]
        top = exterior[middle[:, 1] > 1.0 - 1e-9]
        tags = meshtags(mesh, 1, bottom, np.full(len(bottom), 7, np.int32))
        a = elasticity(V, 1.0)
        L = ufl.inner(fem.Constant(mesh, (0.02, 0.0)), ufl.TestFunction(V)) * ufl.dx
        pair = ContactPair(tags, 7, RigidPlane((0, 0, 0), (0, 1, 0)), law)
        bcs = [fixed(V, top, 0.0, 0), fixed(V, top, -0.04, 1)]
        with ContactProblem(a, L, [pair], bcs=bcs) as problem:
            u = problem.solve(rtol=1e-9).u
            bounds.append(problem.guaranteed_error())
        energy = 0.5 * ufl.action(ufl.action(a, u), u) - ufl.action(L, u)
        if isinstance(law, Tresca):
            ds = ufl.Measure("ds", subdomain_data=tags, metadata={"quadrature_degree": 6})
            energy += law.slip_bound * ufl.sqrt(u[0] ** 2 + 1e-30) * ds(7)
        energies.append(comm.allreduce(fem.assemble_scalar(fem.form(energy))))
    square = total(bounds[0].cell_errors) ** 2
    assert 0.1 * square <= 2.0 * (energies[0] - energies[1]) <= square
    assert bounds[1].error < bounds[0].error
    assert bounds[0].oscillation <= 1e-6 * bounds[0].error


@pytest.mark.parallel
def test_all_ranks_together_bound_as_one_rank_does(comm):
    """All parts of the bound, with loads that are curved in cells and on facets."""
    parts = []
    for ranks in (comm, MPI.COMM_SELF):
        scene = block_on_plane(ranks, "triangle", 2, 8, "slips", distort=0.4)
        with scene.problem() as problem:
            problem.solve(rtol=1e-10)
            bound = problem.guaranteed_error()
        parts.append([bound.error, bound.stress, bound.oscillation, bound.lift])
    assert parts[0] == pytest.approx(parts[1], rel=1e-6)
