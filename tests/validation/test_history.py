"""Load steps whose slip counts from the last one: against closed forms, and balances of energy."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from test_load_steps import strip

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactStatus,
    ConvergenceError,
    InputError,
    Tresca,
)
from dolfinx_tresca._base.parallel import reduce_array
from scenes.blocks import ABOVE, POISSON, YOUNG, block
from scenes.nodal import nodal, surface_nodes_of
from scenes.patches import BOTTOM, TOP
from scenes.rubbing import moved_end, rubbing
from scenes.scene import Scene
from scenes.two_bricks import two_bricks

#: Requested residual, and what it and rounding leave of other figures, over their size.
RTOL, DIGITS = 1e-10, 1e-7

#: What the stiffness of a column 1 high and 1 wide makes of a motion of its top.
SHEAR = YOUNG / (2.0 * (1.0 + POISSON))

G = 1.0  # slip bound


def column(comm: MPI.Comm, dim: int, **arguments: Any) -> Scene:
    """Return a column that shears between its top, which is moved, and a floor that it rubs.

    Nothing moves upwards, and with one cell across the shear is the same everywhere: it is a block
    of area 1 on a spring `SHEAR`.
    """
    model = block(
        comm,
        (*(1,) * (dim - 1), 3),
        load=(0.0, 0.0, 0.0),
        boxes=True,
        friction=Tresca(G),
        **arguments,
    )
    model.V.mesh.topology.create_connectivity(dim, dim)
    upwards = model.V.sub(dim - 1)
    every = dolfinx.mesh.locate_entities(model.V.mesh, dim, lambda x: x[0] > -1.0)
    dofs = fem.locate_dofs_topological(upwards, dim, every)
    model.bcs.append(fem.dirichletbc(dolfinx.default_scalar_type(0.0), dofs, upwards))
    return model


def step_to(problem: ContactProblem, model: Scene, place: np.ndarray) -> ContactSolution:
    """Move the top of the column there, and accept what results."""
    held = model.data.held.x.array.reshape(-1, model.V.mesh.geometry.dim)
    held[:, : len(place)] = place
    solution = problem.solve(rtol=RTOL)
    problem.accept()
    return solution


def along(comm: MPI.Comm, function: fem.Function | None) -> np.ndarray:
    """Return a vector field (n, dim - 1) along the floor, at all of its nodes."""
    assert function is not None
    return np.concatenate(comm.allgather(nodal(function)))[:, :-1]


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
def test_a_block_on_springs(comm, dim):
    """Traction, slip and dissipation are those of a closed form, on any path of the end."""
    rng = np.random.default_rng(dim)
    model = column(comm, dim, held=(ABOVE,))
    slip, total = np.zeros(dim - 1), 0.0
    with model.problem() as problem:
        for _ in range(12):
            place = rng.uniform(-3.0, 3.0, dim - 1) * G / SHEAR
            solution = step_to(problem, model, place)
            trial = SHEAR * (place - slip)
            traction = trial * min(1.0, G / np.linalg.norm(trial))
            increment = (trial - traction) / SHEAR
            slip = slip + increment
            total += traction @ increment
            size = DIGITS * G / SHEAR
            np.testing.assert_allclose(along(comm, solution.slip) - slip, 0.0, atol=size)
            np.testing.assert_allclose(
                along(comm, solution.slip_increment) - increment, 0.0, atol=size
            )
            np.testing.assert_allclose(
                along(comm, solution.traction) - traction, 0.0, atol=DIGITS * G
            )
            assert solution.dissipation == pytest.approx(traction @ increment, abs=G * size)
            assert solution.total_dissipation == pytest.approx(total, abs=12 * G * size)


@pytest.mark.parallel(kind=["triangle", "hexahedron"])
@pytest.mark.parametrize(
    ("kind", "degree"),
    [("triangle", 2), ("quadrilateral", 1), ("tetrahedron", 1), ("hexahedron", 1)],
)
def test_energy_balance_of_each_step(comm, kind, degree):
    """Work is stored or dissipated, but for terms of the implicit method that are given here.

    Two blocks are pressed, tilted and dragged to and fro, so that nodes open and close again. From
    K u = f - B'lambda at both ends of a step, with D = lambda_tau'(T u - T u_0):

        f'(u - u_0) = E - E_0 + D + 1/2 |u - u_0|_K^2 + lambda_nu'(d - N u_0),

    forces of supports being part of f: the method is implicit, and the last two terms, which are
    not negative, vanish with the square of the step.
    """
    scene = rubbing(comm, kind, degree, upper=(4, 1), lower=(3, 1))
    V, dim = scene.V, scene.mesh.geometry.dim
    points = V.tabulate_dof_coordinates()
    upper = points[:, dim - 1] > 1.5
    x = points[upper, :dim]
    ends = np.concatenate([scene.facet_tags.find(tag) for tag in (TOP, BOTTOM)])
    held = fem.locate_dofs_topological(V, dim - 1, np.sort(ends))
    held = held[held < V.dofmap.index_map.size_local]
    u, u_0, change = (fem.Function(V) for _ in range(3))
    forces_form = fem.form(ufl.action(scene.a, u))
    energy, energy_0, of_change = (
        fem.form(0.5 * ufl.action(ufl.action(scene.a, w), w)) for w in (u, u_0, change)
    )
    works, missing, dissipated, closed = [], [], [], []
    fields_0 = None
    with scene.problem() as problem:
        for time in np.linspace(0.0, 1.0, 9):
            motion = moved_end(x)
            motion[:, :-1] *= 4.0 * np.sin(2.0 * np.pi * time)
            motion[:, -1] += 4e-3 * np.sin(2.0 * np.pi * time) * x[:, 0]
            scene.data.exact.x.array.reshape(-1, dim)[upper] = motion
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            problem.accept()
            u.x.array[:] = solution.u.x.array
            change.x.array[:] = u.x.array - u_0.x.array
            forces = fem.assemble_vector(forces_form)
            forces.scatter_reverse(dolfinx.la.InsertMode.add)
            at_held = forces.array.reshape(-1, dim)[held]
            _, fields = surface_nodes_of(solution)
            if fields_0 is not None:
                closing = (fields["weights"] * fields["pressure"]) @ fields_0["gap"]
                kept, before, lost = (
                    fem.assemble_scalar(form) for form in (energy, energy_0, of_change)
                )
                work, kept, lost, closing = reduce_array(
                    comm, [(nodal(change)[held] * at_held).sum(), kept - before, lost, closing]
                )
                works.append(work)
                missing.append(work - kept - solution.dissipation - lost - closing)
                dissipated.append(solution.dissipation)
                closed.append(closing)
            fields_0 = fields
            u_0.x.array[:] = u.x.array
    size = np.abs(works).max()
    assert np.abs(missing).max() <= DIGITS * size
    assert min(closed) >= -DIGITS * size
    assert max(closed) > 1e-3 * size and max(dissipated) > 1e-3 * size


def test_what_slipped_stays_when_the_load_is_taken_away(comm):
    """Half of what slipped is left when the load is taken away, as in shear lag.

    Where the pull P meets friction g a length P / g slips, by P^2 / (2 E A g) at the end, and
    dissipates P^3 / (6 E A g). Without P half of that length slips back, by half as much.
    """
    cells = 50
    model = strip(comm, cells)
    force, area = 5.0, 0.1
    model.data.pull.value = force / area
    slip = force**2 / (2.0 * YOUNG * area * G)
    work = force**3 / (6.0 * YOUNG * area * G)
    cell = (10.0 / cells) / (force / G)  # over the length that slips
    with model.problem() as problem, model.problem() as total:
        for part, dissipated in ((1.0, work), (0.5, work / 4.0)):
            solution, static = problem.solve(), total.solve()
            problem.accept()
            end = comm.allreduce(np.abs(nodal(solution.slip)).max(initial=0.0), op=MPI.MAX)
            assert end == pytest.approx(part * slip, rel=cell)
            assert solution.dissipation == pytest.approx(dissipated, rel=2.0 * cell)
            model.data.pull.value = 0.0
    assert static.greatest_slip <= 1e-3 * slip


def test_a_single_solve_is_as_before(comm):
    """Slips are total until a step is accepted, and again after it is forgotten."""
    model = block(comm, (3, 3, 2))
    with model.problem() as problem:
        first = problem.solve(rtol=RTOL)
        again = problem.solve(rtol=RTOL)
        assert again.products == 0  # what the last solve ended with is known
        assert first.slip_increment is first.slip
        assert "slip_increment" not in [f.name for f in first.surface.functions]
        assert first.dissipation == first.total_dissipation > 0.0
        assert again.dissipation == pytest.approx(first.dissipation, rel=DIGITS)
        problem.accept()
        problem.forget()
        rest = problem.solve(rtol=RTOL)
        assert "slip_increment" in [f.name for f in rest.surface.functions]
        assert rest.dissipation <= DIGITS * first.dissipation
        assert rest.total_dissipation == pytest.approx(first.dissipation, rel=DIGITS)
        size = np.abs(nodal(first.u)).max(initial=0.0)
        np.testing.assert_allclose(nodal(rest.u), nodal(first.u), atol=DIGITS * size)
        problem.set_slip_origin(first.u)
        restarted = problem.solve(rtol=RTOL)
        np.testing.assert_allclose(nodal(restarted.u), nodal(first.u), atol=DIGITS * size)
        assert restarted.total_dissipation <= DIGITS * first.dissipation
        problem.set_slip_origin(None)
        last = problem.solve(rtol=RTOL)
        assert last.slip_increment is last.slip
        assert last.dissipation == pytest.approx(first.dissipation, rel=DIGITS)


@pytest.mark.parallel
def test_what_cannot_be_accepted(comm):
    model = block(comm, (3, 3, 2))
    with model.problem() as problem:
        with pytest.raises(ContactError, match="no solution to accept"):
            problem.accept()
        failed = problem.solve(rtol=RTOL, max_iterations=1)
        assert failed.status is ContactStatus.MAX_ITERATIONS
        with pytest.raises(ConvergenceError, match="MAX_ITERATIONS"):
            problem.accept()
        problem.accept(unconverged=True)
        with pytest.raises(ContactError, match="no solution to accept"):
            problem.accept()
        problem.solve()
        model.data.load.value[0] = np.nan
        with pytest.raises(InputError):
            problem.solve()
        with pytest.raises(ContactError, match="no solution to accept"):
            problem.accept()
        other = fem.Function(fem.functionspace(model.V.mesh, ("Lagrange", 1)))
        for wrong in (other, 0.0):
            with pytest.raises(InputError, match=r"space of solution.u"):
                problem.set_slip_origin(wrong)
        u = fem.Function(model.V)
        if comm.rank == comm.size - 1:
            u.x.array[:1] = np.nan
        with pytest.raises(InputError, match="NaN"):
            problem.set_slip_origin(u)


@pytest.mark.parametrize("accepts", [False, True])
def test_a_step_costs_few_products(comm, accepts):
    """A change of the load by a tenth costs at most eight products, there and back."""
    scene = two_bricks(comm, 8)
    load = scene.data.load.value.copy()
    products = []
    with scene.problem() as problem:
        for factor in (1.0, 1.1, 1.0, 1.1, 1.2, 1.1):
            scene.data.load.value[:] = factor * load
            solution = problem.solve(rtol=1e-6)
            assert solution.status is ContactStatus.CONVERGED
            products.append(solution.products)
            if accepts:
                problem.accept()
    assert max(products[1:]) <= 8
    assert np.mean(products[1:]) <= 5.0
