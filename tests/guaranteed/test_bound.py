"""The guaranteed bound against errors that are known."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactProblem, Frictionless
from dolfinx_tresca.dual.bounds.estimate import total
from dolfinx_tresca.guaranteed.bound import guaranteed_error
from scenes.assembled import linear_solution
from scenes.known_contact import block_on_plane
from scenes.manufactured import blocks_scene, norm

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


@pytest.mark.parametrize("seed", range(20))
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
            bound = problem.guaranteed_error(steps=int(rng.integers(0, 4)))
        assert bound.error >= scene.data.error(solution.u)


@pytest.mark.parametrize("kind", ["lifts", "slips"])
def test_any_displacement_and_admissible_multipliers(comm, kind):
    """As at the end of an iteration that stops early: nodes penetrate, and forces are wrong."""
    scene = block_on_plane(comm, "triangle", 1, 8, kind)
    with scene.problem() as problem:
        problem.solve(rtol=1e-8)
        solved, linear = problem._contact.solved, problem._contact.linear
        rng = np.random.default_rng(1)
        for size in (1e-3, 1e-2):
            u = solved.fields.u.copy()
            u.x.array[~linear.prescribed] += size * rng.standard_normal((~linear.prescribed).sum())
            for factor in (0.7, 1.0):
                multipliers = factor * solved.multipliers
                bound = guaranteed_error(linear, problem.pairs, solved.dual, multipliers, u)
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
    """Loads oscillate: the constant of Korn's inequality in 3D makes their term large."""
    scene = blocks_scene(comm, "tetrahedron", 1, (3, 3))
    with scene.problem() as problem:
        solution = problem.solve(accuracy=1e-6)
        bound = problem.guaranteed_error()
    error = norm(comm, scene.data.energy(solution.u - scene.data.exact))
    assert error <= bound.error
    assert bound.stress <= 1.15 * error


@pytest.mark.parametrize("degree", [1, 2])
def test_degree_2_and_planes(comm, degree):
    """The bound contains what the displacement penetrates between nodes."""
    scene = block_on_plane(comm, "triangle", degree, 8, "slips")
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-8)
        bound = problem.guaranteed_error()
    error = scene.data.error(solution.u)
    assert error <= bound.error <= (1.3 if degree == 1 else 5.0) * error
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

    zero = fem.Function(scene.V)
    dofs = scene.bcs[0].dof_indices()[0] // 2
    bcs = [fem.dirichletbc(zero, np.unique(dofs).astype(np.int32))]
    pair = scene.pair
    pair = type(pair)(scene.facet_tags, pair.secondary, pair.primary, Frictionless(), gap=1.0)
    with ContactProblem(scene.a, form(v), [pair], bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-8)
        bound = problem.guaranteed_error()
    u, w = ufl.TrialFunction(fine), ufl.TestFunction(fine)
    a = ufl.replace(scene.a, dict(zip(scene.a.arguments(), (w, u), strict=True)))
    held = fem.locate_dofs_geometrical(fine, lambda x: np.isclose(x[0], 0.0))
    better = linear_solution(a, form(w), [fem.dirichletbc(fem.Function(fine), held)])
    difference = better - solution.u
    error = norm(
        comm,
        ufl.replace(scene.a, dict(zip(scene.a.arguments(), (difference,) * 2, strict=True))),
    )
    assert 0.0 < error <= bound.error
    assert bound.oscillation > 0.1 * error
