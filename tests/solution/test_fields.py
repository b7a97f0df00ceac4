"""Fields on the secondary surface, and forces and moments as a whole."""

from __future__ import annotations

import json

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import (
    Bonded,
    ContactProblem,
    ContactState,
    Frictionless,
    InputError,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca.output.files import STATE_COLOURS
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.solution.forces import Resultant
from scenes.nodal import nodal
from scenes.patches import patch
from scenes.scene import EPS
from scenes.two_bricks import two_bricks

pytestmark = pytest.mark.parallel


def states(comm: MPI.Comm, friction: Friction, sign: float) -> set[int]:
    """Return the states of the nodes of two blocks that are pressed, or pulled apart (-1)."""
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(3, 1), friction=friction)
    scene.data.exact.x.array[:] *= sign  # which the ends are moved by
    with scene.problem() as problem:
        state = nodal(problem.solve(rtol=1e-6).state)
    return set().union(*comm.allgather(set(state.tolist())))


@pytest.mark.parametrize(
    ("friction", "together", "apart"),
    [
        (Frictionless(), ContactState.PRESSED, ContactState.OPEN),
        (Tresca(10.0), ContactState.STICK, ContactState.OPEN_STICK),
        (Bonded(), ContactState.BONDED, ContactState.BONDED),
    ],
)
def test_states(comm, friction, together, apart):
    assert states(comm, friction, 1.0) == {together}
    assert states(comm, friction, -1.0) == {apart}


def test_states_and_counts_agree(comm: MPI.Comm) -> None:
    """With friction all four occur, and each is counted."""
    scene = two_bricks(comm, 6)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        solution = problem.solve(rtol=1e-6)
    state, counts = nodal(solution.state), solution.counts

    def number(*wanted: ContactState) -> int:
        return int(comm.allreduce(int(np.isin(state, wanted).sum())))

    assert number(ContactState.STICK, ContactState.SLIP) == counts.contact > 0
    assert number(ContactState.STICK, ContactState.OPEN_STICK) == counts.stick > 0
    assert number(ContactState.SLIP, ContactState.OPEN_SLIP) == counts.slip > 0
    assert number(ContactState.STICK) == counts.contact_stick
    assert number(ContactState.OPEN_STICK) > 0 and number(ContactState.OPEN_SLIP) > 0
    carries = number(*(state for state in ContactState if state is not ContactState.OUTSIDE))
    assert carries == counts.nodes


def test_counts_with_friction_along_one_direction(comm: MPI.Comm) -> None:
    """Across this direction a row of T has no friction, but its node counts once."""
    scene = two_bricks(comm, 4)
    law = Tresca((0.1, 0.0), direction=(1.0, 0.0, 0.0))
    with scene.but(friction=law).problem() as problem:
        counts = problem.solve(rtol=1e-6).counts
        assert (counts.nodes, counts.idle) == (problem.contact_nodes, 0)


def test_normals(comm: MPI.Comm) -> None:
    """Outwards of the secondary side; before an obstacle they are the obstacle's."""
    scene = patch(comm, "hexahedron", upper=(2, 1), lower=(3, 1))
    floor = RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    for pair in (scene.pair, scene.but(primary=floor).pair):
        with scene.problem(pairs=[pair]) as problem:
            solution = problem.solve(rtol=1e-6)
        carries = nodal(solution.state) > ContactState.OUTSIDE
        normals = nodal(solution.surface.normal)
        np.testing.assert_allclose(
            normals, carries[:, None] * np.array([0.0, 0.0, -1.0]), atol=64 * EPS
        )


def test_arrays_have_the_order_of_functions(comm: MPI.Comm) -> None:
    """The force is `weights @ pressure`, and ghosts count once."""
    scene = two_bricks(comm, 4)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-8)
    fields = solution.surface
    force = comm.allreduce(fields.weights @ fields.pressure.x.array)
    assert force == pytest.approx(solution.normal_force, rel=64 * EPS)
    drag = comm.allreduce(fields.weights @ fields.traction.x.array.reshape(-1, 3))
    assert np.linalg.norm(drag) == pytest.approx(solution.tangential_force, rel=1e4 * EPS)
    owned = fields.pressure.function_space.dofmap.index_map.size_local
    assert comm.allreduce(int(fields.touching[:owned].sum())) == solution.counts.contact
    assert comm.allreduce(int(fields.sticking[:owned].sum())) == solution.counts.stick
    assert (fields.weights[fields.state.x.array == ContactState.OUTSIDE] == 0.0).all()


def test_each_state_has_a_name_and_a_colour() -> None:
    (preset,) = json.loads(STATE_COLOURS.read_text())
    assert [int(value) for value in preset["Annotations"][::2]] == sorted(ContactState)
    names = preset["Annotations"][1::2]
    colours = np.reshape(preset["IndexedColors"], (-1, 3))
    assert len(set(names)) == len(np.unique(colours, axis=0)) == len(ContactState)
    assert colours.min() >= 0.0 and colours.max() <= 1.0


def test_moments_about_other_points():
    """About (0, 0, 1) a force of 2 along x at the origin turns by -2 about y."""
    force = np.array([2.0, 0.0, 0.0])
    one = Resultant(force, np.zeros(3), np.zeros(3)).about((0, 0, 1))
    np.testing.assert_array_equal(one.moment, [0.0, -2.0, 0.0])
    np.testing.assert_array_equal(one.about([0.0, 0.0, 0.0]).moment, np.zeros(3))
    flat = Resultant(np.array([0.0, 3.0]), np.zeros(1), np.zeros(2)).about((-2.0, 5.0))
    np.testing.assert_array_equal(flat.moment, [6.0])
    for wrong in ((1.0, 2.0), "x", (np.nan, 0.0, 0.0), None):
        with pytest.raises(InputError, match="3 finite numbers"):
            one.about(wrong)
