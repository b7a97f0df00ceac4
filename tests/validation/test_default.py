"""What the default returns is the discrete solution's to what a reader can see."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import pytest
from test_load_steps import strip

from dolfinx_tresca import ContactSolution, ContactStatus, RigidSphere, SolverOptions, Tresca
from scenes.blocks import block
from scenes.hertz import sphere_on_plane, two_spheres
from scenes.scene import Scene
from scenes.two_bricks import ENDS, two_bricks

#: Residual of a reference: its own errors are far below what is compared.
TIGHT = 1e-9

#: What a reader sees, as a part: of forces, of the peak pressure and slip.
SEEN = 0.01


def block_on_ball(comm: MPI.Comm) -> Scene:
    """A block pressed on a rigid ball, with friction."""
    ball = RigidSphere((0.5, 0.5, -2.0), 2.0)
    return block(
        comm,
        (8, 8, 4),
        load=(5.0, 0.0, -60.0),
        held=(),
        spring=1.0,
        friction=Tresca(10.0),
        obstacles=[(1, ball)],
    )


SCENES: dict[str, Callable[[MPI.Comm], Scene]] = {
    **{f"bricks 10, {end}": lambda comm, end=end: two_bricks(comm, 10, end=end) for end in ENDS},
    # two nodes of 169 stick too many or too few
    "bricks 13, free_end_1": lambda comm: two_bricks(comm, 13, end="free_end_1"),
    "ball on plane": lambda comm: sphere_on_plane(comm, 0.3),
    "two balls": lambda comm: two_spheres(comm, 0.3),
    "block on ball": block_on_ball,
}


def seen(comm: MPI.Comm, solution: ContactSolution) -> dict[str, float]:
    """Return peak pressure, greatest slip, and forces."""
    surface = solution.surface
    largest = {"peak pressure": surface.pressure.x.array}
    if surface.slip is not None:
        slip = surface.slip.x.array.reshape(-1, surface.slip.function_space.dofmap.bs)
        largest["greatest slip"] = np.linalg.norm(slip, axis=1)
    return {
        "normal force": solution.normal_force,
        "tangential force": solution.tangential_force,
        **{
            name: comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX)
            for name, values in largest.items()
        },
    }


@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
@pytest.mark.parametrize("name", SCENES)
def test_what_a_reader_sees(comm, name, stiffness):
    model = SCENES[name](comm)
    with model.problem(stiffness=stiffness) as problem:
        found = problem.solve()
    with model.problem(stiffness="cholesky") as problem:
        exact = problem.solve(rtol=TIGHT)
    assert found.status is exact.status is ContactStatus.CONVERGED
    found_values, exact_values = seen(comm, found), seen(comm, exact)
    for key, value in exact_values.items():
        assert abs(found_values[key] - value) <= SEEN * value, key
    assert exact.counts.undecided == 0
    for count in ("contact", "stick", "contact_stick"):
        wrong = abs(getattr(found.counts, count) - getattr(exact.counts, count))
        assert wrong <= found.counts.undecided, count


@pytest.mark.parametrize("rtol", [1e-2, 1e-8])
def test_a_residual_is_no_looser(comm, rtol):
    """A requested residual is reached, and the energy error is no larger than by default."""
    model = strip(comm, 30)
    model.data.pull.value = 50.0
    with model.problem() as problem:
        default = problem.solve()
        problem.forget()
        found = problem.solve(rtol=rtol)
    assert default.status is found.status is ContactStatus.CONVERGED
    assert found.residuals[-1] <= rtol
    assert found.energy_error_bound <= SolverOptions().mesh_part * default.discretisation_error
