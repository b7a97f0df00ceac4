"""Overlaps whose rim cuts secondary facets: pressures at the rim, forces and moments."""

from __future__ import annotations

import numpy as np
import pytest
from rotations import rotation

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    ContactState,
    ContactStatus,
    Coulomb,
    Frictionless,
)
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity, no_load
from scenes.patches import KINDS, LOWER, UPPER, UPPER_BLOCK, dim_of, patch
from scenes.scene import EPS

ROUNDING = 1e4 * EPS

SECONDARY, PRIMARY, SECOND, TOP, BOTTOM, SIDE = 1, 2, 3, 4, 5, 6


@pytest.mark.parallel(kind=["triangle", "tetrahedron"], degree=[1])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_peak_pressures_from_either_side(comm, kind, degree):
    """Peak pressures are means over cells at the rim, whose sizes differ by a factor of up to 3.

    The pressure is singular like r^-0.23 with the distance r from the rim, in corners in 3D about
    like r^-0.46. So means over three times the length are 3^-0.23 = 0.78 times as large, and 0.6
    times in corners. The mesh error is a tenth.
    """
    dim = dim_of(kind)
    least = 0.7 if dim == 2 else 0.54
    for shift in (0.01, 0.1, 0.3, 0.55, 0.9)[:: dim - 1]:
        cells = 8 if dim == 2 else 4
        block_on_plate = patch(
            comm, kind, degree, upper=(cells // 2, 2), lower=(cells, 2), distort=0.0,
            span=[(0.25 + shift / cells, 0.75 + shift / cells)] * (dim - 1), pairing="mortar",
        )  # fmt: skip
        peaks = []
        for secondary, primary in ((UPPER, LOWER), (LOWER, UPPER)):
            scene = block_on_plate.but(secondary=secondary, primary=primary)
            with scene.problem() as problem:
                peaks.append(problem.solve(rtol=1e-4).peak_pressure)
        assert least < peaks[1] / peaks[0] < 1.0 / least


@pytest.mark.parametrize("kind", KINDS)
def test_the_jump_at_a_node_is_its_own_where_facets_are_covered_in_part(comm, kind):
    """The secondary side alone moves; of its facets at one end 31/32 are covered."""
    dim = dim_of(kind)
    scene = patch(
        comm, kind, upper=(4, 1), lower=(3, 1), distort=0.0, pairing="mortar",
        span=[(-1 / 128, 1 - 1 / 128)] * (dim - 1),
    )  # fmt: skip
    operators = scene.operators()
    assert len(operators.nodes) == 5 ** (dim - 1)
    u = np.zeros((len(scene.V.tabulate_dof_coordinates()), dim))
    moved = np.unique(scene.V.dofmap.list[scene.cell_tags.find(UPPER_BLOCK)])
    u[moved] = np.cos(np.arange(dim * len(moved))).reshape(-1, dim)
    jumps = np.einsum("ni,ni->n", u[operators.nodes], operators.normals)
    assert np.abs(operators.N @ u.ravel() - jumps).max() <= ROUNDING


@pytest.mark.parallel(kind=["quadrilateral"], degree=[2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cut", [0.37, 0.499, 0.61])
def test_a_uniform_stress_passes_where_facets_are_cut(comm, kind, degree, cut):
    """Two blocks stand side by side on a third one; the seam cuts its facets."""
    dim, p, poisson = dim_of(kind), 2.5, 0.3
    rest = [(0.0, 1.0)] * (dim - 2)
    bodies = [
        Body((2 if dim == 3 else 4, 2), [(0.0, 1.0), *rest, (-1.0, 0.0)]),
        Body((2, 1), [(0.0, cut), *rest, (0.0, 1.0)]),
        Body((3, 1), [(cut, 1.0), *rest, (0.0, 1.0)]),
    ]
    both = boxes(comm, kind, bodies, degree)
    V, face = both.V, near(dim - 1, 0.0)
    tags = both.tags(
        (SECONDARY, [0], face), (PRIMARY, [1], face), (SECOND, [2], face),
        (TOP, [1, 2], near(dim - 1, 1.0)), (BOTTOM, [0], near(dim - 1, -1.0)),
    )  # fmt: skip
    along, across = (1.0, poisson) if dim == 3 else (1.0 - poisson**2, poisson * (1.0 + poisson))
    young = 1000.0

    def uniform(x):
        return np.vstack([across * x[: dim - 1], -along * x[dim - 1 : dim]]) * p / young

    exact = fem.Function(V)
    exact.interpolate(uniform)
    bcs = [
        fem.dirichletbc(exact, fem.locate_dofs_topological(V, dim - 1, tags.find(tag)))
        for tag in (TOP, BOTTOM)
    ]
    E = fem.Function(fem.functionspace(both.mesh, ("DG", 0)))
    E.x.array[:] = young
    pairs = [
        ContactPair(tags, SECONDARY, other, Frictionless(), pairing="mortar")
        for other in (PRIMARY, SECOND)
    ]
    with ContactProblem(elasticity(V, E, poisson), no_load(V), pairs, bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-12)
    size = np.abs(exact.x.array).max(initial=1e-3)
    assert np.abs(solution.u.x.array - exact.x.array).max(initial=0.0) <= 1e-9 * size
    assert solution.normal_force == pytest.approx(p, rel=1e-9)
    for surface in solution.surfaces:
        carries = surface.state.x.array > ContactState.OUTSIDE
        assert np.abs(surface.pressure.x.array[carries] - p).max(initial=0.0) <= 1e-9 * p


def hole(x: np.ndarray) -> np.ndarray:
    return np.abs(x[:, :-1] - 0.5).max(axis=1) > 0.13


def chamfer(x: np.ndarray) -> np.ndarray:
    return x[:, :-1].sum(axis=1) > 0.6 * (x.shape[1] - 1)


def step(x: np.ndarray) -> np.ndarray:
    return (x[:, 0] < 0.4) | (x[:, -1] > 0.6)


@pytest.mark.parallel(kind=["tetrahedron"], shape=[chamfer])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [hole, chamfer, step])
def test_forces_and_moments_balance_whatever_the_shape(comm, kind, shape):
    """The rows of N of rigid motions are zero for holes, chamfers and steps on a rotated mesh."""
    dim = dim_of(kind)
    plate = Body((3, 1), [(-0.1, 1.1)] * (dim - 1) + [(-1.0, 0.0)])
    above = Body((5, 3), [(0.0, 1.0)] * (dim - 1) + [(0.0, 1.0)], keep=shape)
    both = boxes(comm, kind, [plate, above], turn=rotation(9, dim))
    tags = both.tags((SECONDARY, [0], near(dim - 1, 0.0)), (PRIMARY, [1], near(dim - 1, 0.0)))
    found = both.operators(ContactPair(tags, SECONDARY, PRIMARY, Frictionless(), "mortar"))
    ds = ufl.Measure("ds", domain=both.mesh, subdomain_data=tags)
    one = fem.Constant(both.mesh, 1.0)
    area = comm.allreduce(fem.assemble_scalar(fem.form(one * ds(PRIMARY))))
    assert comm.allreduce(found.weights.sum()) == pytest.approx(area, rel=ROUNDING)
    owned = both.V.tabulate_dof_coordinates()[: both.V.dofmap.index_map.size_local]
    points = np.concatenate(comm.allgather(owned))
    for i in range(dim):
        motion = np.zeros((len(points), dim))
        motion[:, i] = 1.0
        assert np.abs(found.N @ motion.ravel()).max(initial=0.0) <= ROUNDING
        for j in range(i):
            motion = np.zeros((len(points), dim))
            motion[:, i], motion[:, j] = points[:, j], -points[:, i]
            assert np.abs(found.N @ motion.ravel()).max(initial=0.0) <= ROUNDING


@pytest.mark.parallel(kind=["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("degree", "cells", "plate"), [(1, 4, 8), (1, 3, 5), (1, 4, 3), (2, 3, 2), (2, 2, 3)]
)
def test_friction_of_a_block_with_prescribed_sides(comm, kind, degree, cells, plate):
    """The whole block slides, with F times the pressure as traction."""
    dim, F = dim_of(kind), 0.3
    rest = [(0.0, 1.0)] * (dim - 2)
    bodies = [
        Body((plate, 1), [(-0.5, 1.5), *[(-0.1, 1.1)] * (dim - 2), (-0.5, 0.0)]),
        Body((cells, 1), [(0.0, 1.0), *rest, (0.0, 0.5)]),
    ]
    both = boxes(comm, kind, bodies, degree)
    V, face = both.V, near(dim - 1, 0.0)
    tags = both.tags(
        (SECONDARY, [1], face), (PRIMARY, [0], face), (BOTTOM, [0], near(dim - 1, -0.5)),
        (TOP, [1], near(dim - 1, 0.5)), (SIDE, [1], lambda x: near(0, 0.0)(x) | near(0, 1.0)(x)),
    )  # fmt: skip
    E = fem.Function(fem.functionspace(both.mesh, ("DG", 0)))
    E.x.array[:] = 1.0

    def fixed(tag, component, value):
        part = V.sub(component)
        dofs = fem.locate_dofs_topological(part, dim - 1, tags.find(tag))
        return fem.dirichletbc(np.float64(value), dofs, part)

    bcs = [fixed(BOTTOM, i, 0.0) for i in range(dim)] + [fixed(TOP, dim - 1, -0.02)]
    bcs += [fixed(SIDE, 0, 0.02), *(fixed(TOP, i, 0.0) for i in range(1, dim - 1))]
    pair = ContactPair(tags, SECONDARY, PRIMARY, Coulomb(F))
    with ContactProblem(elasticity(V, E, 0.3), no_load(V), [pair], bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-9)
    surface = solution.surface
    size = np.linalg.norm(surface.traction.x.array.reshape(-1, dim), axis=1)
    owned = surface.traction.function_space.dofmap.index_map.size_local
    force = comm.allreduce((surface.weights * size)[:owned].sum())
    assert solution.counts.stick == 0
    assert force == pytest.approx(F * solution.normal_force, rel=1e-9)
    assert solution.status is ContactStatus.CONVERGED
