"""Bonded pairs: two blocks behave like one body under any load."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import Bonded, ContactState, ContactStatus
from scenes.assembled import linear_solution
from scenes.patches import KINDS, UPPER, patch
from scenes.scene import Scene

RTOL = 1e-8

#: Relative error of displacements: a multiple of the residual, to which jumps are accurate.
TOLERANCE = 1e3 * RTOL


def loaded(scene: Scene):
    """Return a load that bends, shears and pulls, without a plane of symmetry."""
    dim = scene.mesh.geometry.dim
    x = ufl.SpatialCoordinate(scene.mesh)
    force = [3.0 * x[0] * x[dim - 1], 2.0 - x[0], 5.0 * (x[0] - 0.3)][-dim:]
    return ufl.inner(ufl.as_vector(force), ufl.TestFunction(scene.V)) * ufl.dx


def by_point(comm, scene: Scene, u: fem.Function) -> dict[tuple, np.ndarray]:
    """Return point -> displacement of a node at this point, for the nodes of all ranks."""
    dim, count = scene.mesh.geometry.dim, scene.V.dofmap.index_map.size_local
    points = np.round(scene.V.tabulate_dof_coordinates()[:count], 6) + 0.0
    values = u.x.array.reshape(-1, dim)[:count]
    rows = np.concatenate(comm.allgather(np.column_stack([points, values])))
    return {tuple(row[:3]): row[3:] for row in rows}


@pytest.mark.parallel(kind=["triangle", "hexahedron"])
@pytest.mark.parametrize("kind", KINDS)
def test_bonded_blocks_equal_a_body_meshed_as_one(comm, kind):
    blocks = {"upper": (3, 2), "lower": (3, 3), "distort": 0.0, "young": (1000.0, 300.0)}
    single = patch(comm, kind, **blocks, merge=lambda x: np.ones(len(x), dtype=bool))
    assert comm.allreduce(len(single.facet_tags.find(UPPER))) == 0
    alone = linear_solution(single.a, loaded(single), single.bcs)
    expected = by_point(comm, single, alone)
    scene = patch(comm, kind, **blocks, friction=Bonded())
    with scene.problem(L=loaded(scene)) as problem:
        assert "bonded" in str(problem)
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    found = by_point(comm, scene, solution.u)
    assert found.keys() == expected.keys()
    size = max(np.abs(value).max() for value in expected.values())
    assert max(np.abs(found[x] - expected[x]).max() for x in found) <= TOLERANCE * size


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_jumps_are_zero_on_meshes_that_do_not_match(comm, kind, degree):
    """Some pressures are negative."""
    scene = patch(comm, kind, degree, friction=Bonded(), pressure=0.0)
    with scene.problem(L=loaded(scene)) as problem:
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    size = comm.allreduce(np.abs(solution.u.x.array).max(), op=MPI.MAX)
    assert np.abs(solution.slip.x.array).max(initial=0.0) <= TOLERANCE * size
    assert np.abs(solution.gap.x.array).max(initial=0.0) <= TOLERANCE * size
    least = comm.allreduce(solution.pressure.x.array.min(initial=0.0), op=MPI.MIN)
    assert least < 0.0
    state = solution.state.x.array
    assert set(np.unique(state)) <= {ContactState.OUTSIDE, ContactState.BONDED}
    counts = solution.counts
    assert counts.bonded == counts.nodes == problem.contact_nodes
    assert counts.contact == counts.stick == 0
    assert solution.primal_energy == pytest.approx(solution.dual_energy, rel=TOLERANCE)


@pytest.mark.parallel(gap=[0.05])
@pytest.mark.parametrize("gap", [0.05, -0.02])
def test_initial_gap_stays(comm, gap):
    """The blocks move as if they touched each other."""
    scene = patch(comm, "tetrahedron", gap=gap, friction=Bonded())
    exact = scene.data.exact.x.array.reshape(-1, 3)
    upper = scene.V.tabulate_dof_coordinates()[:, 2] > 1.0 + 0.5 * gap
    if gap < 0.0:
        upper = np.zeros(len(exact), dtype=bool)
        upper[scene.V.dofmap.list[scene.cell_tags.find(1)]] = True
    exact[upper, 2] += gap
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    size = comm.allreduce(np.abs(exact).max(), op=MPI.MAX)
    assert np.abs(solution.u.x.array - exact.ravel()).max(initial=0.0) <= TOLERANCE * size
    assert np.abs(solution.gap.x.array).max(initial=0.0) <= TOLERANCE * size
