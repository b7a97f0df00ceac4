"""What the default returns, and many solves of one problem: reversals, changing loads, bounds."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from test_energy_bound import relative_error

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution, ContactStatus, RigidSphere, SolverOptions, Tresca
from scenes.blocks import block
from scenes.hertz import sphere_on_plane, two_spheres
from scenes.patches import BOTTOM, TOP, patch
from scenes.scene import Scene
from scenes.two_bricks import ENDS, two_bricks

#: How a user may ask: the default, an error in the energy norm, a residual, a smaller error.
ASKED: list[dict[str, Any]] = [{}, {"accuracy": 1e-3}, {"rtol": 1e-8}, {"accuracy": 1e-5}]

#: Residual of a reference, and the relative error in the energy norm that it may leave.
TIGHT, REFERENCE = 1e-10, 1e-6


#: By how much products of later steps may exceed those of earlier ones: loads are random.
GROWTH = 1.5


def strip(comm: MPI.Comm, cells: int, height: float = 0.1) -> Scene:
    """Return a slender strip on a plane, pressed down, pulled at its end, held by friction alone.

    It slips as a whole from a pull of 100 on.
    """
    return block(
        comm,
        (cells, 2),
        size=(10.0, height),
        load=(0.0, 0.0, -2.0),
        poisson=0.0,
        friction=Tresca(1.0),
        boxes=True,
    )


def reversals(comm: MPI.Comm, cells: int, steps: int, *, accepts: bool) -> list[int]:
    """Pull a strip to and fro, with or without a history; return the products of each step."""
    model = strip(comm, cells)
    amplitudes = np.random.default_rng(0).uniform(10.0, 90.0, steps)
    products, dissipated = [], 0.0
    with model.problem() as problem:
        for step, amplitude in enumerate(amplitudes):
            model.data.pull.value = (-1) ** step * amplitude
            solution = problem.solve()
            assert solution.status is ContactStatus.CONVERGED, step
            products.append(solution.products)
            if accepts:
                problem.accept()
                dissipated += solution.dissipation
                assert solution.dissipation >= 0.0
                assert solution.total_dissipation == pytest.approx(dissipated, rel=1e-12)
    return products


@pytest.mark.parametrize(
    ("cells", "steps", "accepts"),
    [
        (20, 12, True),
        *(pytest.param(150, 200, accepts, marks=pytest.mark.long) for accepts in (False, True)),
    ],
)
def test_many_reversals(comm, cells, steps, accepts):
    """Later steps need no more products than the first ones."""
    products = reversals(comm, cells, steps, accepts=accepts)
    part = max(4, steps // 4)
    assert np.mean(products[-part:]) <= GROWTH * np.mean(products[:part])


class RandomLoads:
    """Two blocks whose meshes do not match; traction, prescribed values and slip bounds change."""

    def __init__(self, comm: MPI.Comm, stiffness: str, divisions: int, seed: int) -> None:
        scene = patch(
            comm, "tetrahedron", upper=(divisions + 1, 2), lower=(divisions, 2), young=(1e3, 1e3)
        )
        V, mesh = scene.V, scene.mesh
        self.a = scene.a
        self._traction = fem.Constant(mesh, np.zeros(3))
        self._held = fem.Function(V)
        self._bound = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
        self._rng = np.random.default_rng(seed)
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=scene.facet_tags)
        L = ufl.inner(self._traction, ufl.TestFunction(V)) * ds(TOP)
        side = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0) & (x[2] > 1.25))
        bottom = fem.locate_dofs_topological(V, 2, scene.facet_tags.find(BOTTOM))
        bcs = [fem.dirichletbc(np.zeros(3), bottom, V), fem.dirichletbc(self._held, side)]
        scene = scene.but(friction=Tresca(self._bound))
        self.problem = scene.problem(L=L, bcs=bcs, stiffness=stiffness)
        self._reference = scene.problem(L=L, bcs=bcs, stiffness="cholesky")

    def __enter__(self) -> RandomLoads:
        return self

    def __exit__(self, *_: object) -> None:
        self.problem.destroy()
        self._reference.destroy()

    def steps(self):
        """Yield solutions for random loads, without end, each asked for in another way."""
        rng = self._rng
        while True:
            for asked in ASKED:
                self._traction.value[:] = rng.uniform((-0.5, -0.5, -1.5), (0.5, 0.5, 0.5))
                drag = rng.uniform(-1e-4, 1e-4, 3)
                self._held.interpolate(lambda x, drag=drag: np.outer(drag, np.cos(5.0 * x[1])))
                size, phase = rng.uniform(0.0, 0.5), rng.uniform(0.0, 6.0)
                self._bound.interpolate(
                    lambda x, size=size, phase=phase: (
                        size * (1.0 + np.cos(6.0 * x[0] + phase)) * (np.sin(5.0 * x[1]) > -0.7)
                    )
                )
                yield self.problem.solve(**asked)

    def check(self, solution: ContactSolution) -> None:
        """Compare the error with its bound."""
        self._reference.forget()
        reference = self._reference.solve(rtol=TIGHT)
        assert reference.status is ContactStatus.CONVERGED
        error = relative_error(self.a, solution.u, reference.u)
        assert error <= solution.energy_error_bound + REFERENCE


@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_random_steps(comm, stiffness):
    with RandomLoads(comm, stiffness, 3, seed=0) as loads:
        for step, solution in enumerate(islice(loads.steps(), 6)):
            assert solution.status is ContactStatus.CONVERGED, step
            loads.check(solution)


@pytest.mark.long
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_a_thousand_random_steps(comm, stiffness):
    """Recycled products stay right, and steps do not become dearer."""
    products = []
    with RandomLoads(comm, stiffness, 8, seed=1) as loads:
        for step, solution in enumerate(islice(loads.steps(), 1000)):
            assert solution.status is ContactStatus.CONVERGED, step
            products.append(solution.products)
            if step % 20 == 19:
                loads.check(solution)
    assert np.mean(products[-200:]) <= GROWTH * np.mean(products[50:250])


#: Residual of a reference: its own errors are far below what is compared.
EXACT = 1e-9

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
        exact = problem.solve(rtol=EXACT)
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
