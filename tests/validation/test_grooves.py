"""Bodies in grooves and corners: several smooth patches in contact meet in the nodes of an edge."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from rotations import rotation

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, Frictionless, RigidObstacle, Tresca
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity
from scenes.patches import KINDS, dim_of

RTOL = 1e-8
TOLERANCE = 100 * RTOL

#: Pressures on the two faces; without Poisson's ratio each is that of its own load.
FIRST, SECOND = 1.0, 2.0

LOADED, GROOVE = (3, 4), 5


def angle(x: np.ndarray) -> np.ndarray:
    """An L of three by three cells of half the size, its inner corner in the origin."""
    result = 1.5 * x
    result[:, [0, -1]] -= 0.5
    if x.shape[1] == 3:
        result[:, 1] = x[:, 1]
    return result


def block_in_groove(comm, kind: str, divisions: int, turns: bool = True):
    """A unit block that two loads press into the groove, whole boundaries tagged 1 and 2."""
    dim = dim_of(kind)
    turn = rotation(8, dim) if turns else np.eye(dim)
    lower = Body((3, 3), [(0.0, 1.0)] * dim,
                 keep=lambda x: (x[:, 0] < 1 / 3) | (x[:, -1] < 1 / 3), move=angle)  # fmt: skip
    upper = Body((divisions, divisions), [(0.0, 1.0)] * dim)
    both = boxes(comm, kind, [lower, upper], turn=turn)
    ends = [near(i, 1.0) for i in (0, -1)]
    loads = both.tags((LOADED[0], [1], ends[0]), (LOADED[1], [1], ends[1]), (GROOVE, [0], None))
    ds = ufl.Measure("ds", domain=both.mesh, subdomain_data=loads)
    u, v = ufl.TrialFunction(both.V), ufl.TestFunction(both.V)
    load = -ufl.inner(ufl.FacetNormal(both.mesh), v)
    L = FIRST * load * ds(LOADED[0]) + SECOND * load * ds(LOADED[1])
    a = elasticity(both.V, 1000.0, 0.0)
    if dim == 3:  # something must hold the block along the groove, where there is no friction
        along = ufl.as_vector(turn[:, 1])
        a += 1.0 * ufl.inner(u, along) * ufl.inner(v, along) * ds(LOADED[1])
    held = fem.locate_dofs_topological(both.V, dim - 1, loads.find(GROOVE))
    bcs = [fem.dirichletbc(np.zeros(dim), held, both.V)]
    tags = both.tags((1, [1], None), (2, [0], None))
    return both, turn, a, L, bcs, tags


def pressures(comm, turn: np.ndarray, solution):
    """Return pressures on both faces at nodes that are not on the edge."""
    carries = solution.state.x.array >= 0
    points = solution.pressure.function_space.tabulate_dof_coordinates()[: len(carries)]
    x, p = points[carries, : len(turn)] @ turn, solution.pressure.x.array[carries]
    return p[x[:, -1] > 1e-6], p[x[:, 0] > 1e-6]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("divisions", [1, 2, 3])
def test_a_groove_passes_a_constant_pressure_on_each_face(comm, kind, divisions):
    """Each face of a groove has its pressure, also on meshes that do not match."""
    _, turn, a, L, bcs, tags = block_in_groove(comm, kind, divisions)
    with ContactProblem(a, L, [ContactPair(tags, 1, 2, Frictionless())], bcs=bcs) as problem:
        solution = problem.solve(rtol=RTOL)
    assert solution.status.name == "CONVERGED"
    for values, wanted in zip(pressures(comm, turn, solution), (FIRST, SECOND), strict=True):
        assert np.abs(values - wanted).max(initial=0.0) <= TOLERANCE
    assert solution.normal_force == pytest.approx(FIRST + SECOND, rel=TOLERANCE)
    assert solution.counts.nodes == 2 * (divisions + 1) ** (len(turn) - 1)
    assert comm.allreduce(solution.surface.weights.sum()) == pytest.approx(2.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [Frictionless(), Tresca(0.1)])
def test_a_corner_of_a_rigid_box(comm, kind, law):
    """Both walls of a corner carry their loads, though a node of the edge has one normal."""
    _, turn, a, L, bcs, tags = block_in_groove(comm, kind, 3)
    dim = len(turn)

    def walls(x: np.ndarray):
        y = turn.T @ x[:dim]
        first = y[0] < y[-1]
        normal = np.zeros_like(x)
        normal[:dim] = np.where(first, turn[:, :1], turn[:, -1:])
        return np.where(first, y[0], y[-1]), normal

    with ContactProblem(a, L, [ContactPair(tags, 1, RigidObstacle(walls), law)], bcs) as problem:
        solution = problem.solve(rtol=RTOL) if isinstance(law, Frictionless) else problem.solve()
    assert solution.status.name == "CONVERGED"
    if isinstance(law, Frictionless):
        assert solution.normal_force == pytest.approx(FIRST + SECOND, rel=TOLERANCE)
        for values, wanted in zip(pressures(comm, turn, solution), (FIRST, SECOND), strict=True):
            error = np.abs(values - wanted).max(initial=0.0)
            assert comm.allreduce(error, op=MPI.MAX) <= TOLERANCE * wanted


def test_an_edge_that_is_prescribed_along_one_normal_is_pressed(comm, caplog):
    """The other side gives way there as if it were secondary, and no overlap is warned of."""
    both, _, a, L, _, tags = block_in_groove(comm, "quadrilateral", 2, turns=False)
    held = both.tags((3, [0], lambda x: x.min(axis=1) < 1e-9), (4, [1], near(0, 0.0)))
    bcs, forces = [], []
    for tag, axis, value in ((3, 0, 0.0), (3, 1, 0.0), (4, 1, -0.02)):
        dofs = fem.locate_dofs_topological(both.V.sub(axis), 1, held.find(tag))
        bcs.append(fem.dirichletbc(value, dofs, both.V.sub(axis)))
    for sides in ((1, 2), (2, 1)):
        with ContactProblem(a, L, [ContactPair(tags, *sides, Frictionless())], bcs) as problem:
            forces.append(problem.solve(rtol=RTOL).pair_resultants[0].force)
    assert forces[0] == pytest.approx(-forces[1], rel=TOLERANCE)
    assert "overlaps" not in caplog.text


def test_paths_of_nodes_whose_larger_patch_is_open(comm):
    """A block one cell wide slides on the bottom of a slot, whose walls its higher sides face."""
    slot = Body((3, 3), [(0.0, 1.0)] * 2, move=lambda x: x * [3.6, 3.0] - [1.3, 1.0],
                keep=lambda x: (np.abs(x[:, 0] - 0.5) > 0.2) | (x[:, 1] < 0.3))  # fmt: skip
    both = boxes(comm, "quadrilateral", [slot, Body((1, 1), [(0.0, 1.0), (0.0, 1.5)])])
    ends, push = both.tags((3, [0], near(1, 0.0)), (4, [1], near(1, 1.5))), fem.Function(both.V)
    dofs = [fem.locate_dofs_topological(both.V, 1, ends.find(tag)) for tag in (3, 4)]
    bcs = [fem.dirichletbc(np.zeros(2), dofs[0], both.V), fem.dirichletbc(push, dofs[1])]
    pair = ContactPair(both.tags((1, [1], None), (2, [0], None)), 1, 2, Coulomb(0.1))
    with ContactProblem(elasticity(both.V, 1000.0, 0.0), None, [pair], bcs) as problem:
        for step in (1, 2):
            push.x.array.reshape(-1, 2)[:] = 0.01 * step, -0.001
            solution = problem.solve()
            problem.accept()
    assert solution.greatest_total_slip > 1.9 * solution.greatest_slip > 0.018
