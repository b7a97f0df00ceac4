"""Load steps whose slip counts from the last one: against closed forms, and balances of energy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from test_load_steps import GROWTH, reversals, strip

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactStatus,
    ConvergenceError,
    Coulomb,
    InputError,
    Tresca,
)
from dolfinx_tresca._base.parallel import reduce_array
from scenes.blocks import ABOVE, POISSON, YOUNG, block, floor
from scenes.nodal import global_vector, nodal, surface_nodes_of
from scenes.patches import BOTTOM, TOP, UPPER_BLOCK, dim_of
from scenes.rubbing import moved_end, rubbing
from scenes.scene import Scene
from scenes.two_bricks import ENDS, two_bricks

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
    """Any path of the spring's end: the traction returns to its circle along the radius."""
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


def test_hysteresis_loop(comm):
    """A cycle encloses 4 g A u_slip, which is what friction dissipates in it."""
    model = column(comm, 3, held=(ABOVE,))
    ends = 3.0 * G / SHEAR
    # one end to the other and back; it sticks for the first third of each way
    way = np.concatenate([np.linspace(ends, -ends, 4), np.linspace(-ends, ends, 4)[1:]])
    with model.problem() as problem:
        step_to(problem, model, np.array([ends, 0.0]))
        forces, work = [G], 0.0
        for place in way[1:]:
            solution = step_to(problem, model, np.array([place, 0.0]))
            forces.append(along(comm, solution.traction)[:, 0].mean())
            work += solution.dissipation
    enclosed = np.trapezoid(forces, way)
    slip = ends - G / SHEAR  # on either side of the middle
    assert enclosed == pytest.approx(4.0 * G * slip, rel=DIGITS)
    assert work == pytest.approx(4.0 * G * slip, rel=DIGITS)


def test_a_sliding_block_is_not_driven_backwards(comm):
    """Thrown, it slows down by g A / m, and stops for good; total slip would drive it back."""
    mass, dt, speed = 2.0, 0.1, 0.23
    model = column(comm, 3)
    V, inertia = model.V, fem.Constant(model.V.mesh, mass / dt**2)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    before, last = fem.Function(V), fem.Function(V)
    a = model.a + inertia * ufl.inner(u, v) * ufl.dx
    L = inertia * ufl.inner(2.0 * last - before, v) * ufl.dx
    mean = fem.form(last[0] * ufl.dx)

    def thrown(accepts: bool) -> tuple[list[float], list[float]]:
        """Return where the block is, and where its foot, after each step of time."""
        places, feet = [0.0], [0.0]
        last.x.array[:] = 0.0
        before.x.array.reshape(-1, 3)[:] = [-dt * speed, 0.0, 0.0]
        with ContactProblem(a, L, model.pairs, bcs=model.bcs) as problem:
            for _ in range(12):
                solution = problem.solve(rtol=RTOL)
                if accepts:
                    problem.accept()
                before.x.array[:] = last.x.array
                last.x.array[:] = solution.u.x.array
                places.append(comm.allreduce(fem.assemble_scalar(mean)))
                feet.append(along(comm, solution.slip)[:, 0].mean())
        return places, feet

    (places, feet), velocity, wanted = thrown(True), speed, [0.0]
    while velocity > dt * G / mass:
        velocity -= dt * G / mass
        wanted.append(wanted[-1] + dt * velocity)
    np.testing.assert_allclose(places[: len(wanted)], wanted, rtol=DIGITS)
    assert min(np.diff(feet)) >= -DIGITS * feet[-1]
    assert min(places[len(wanted) :]) > wanted[-1] - G / SHEAR  # it sways on its foot
    assert thrown(False)[0][-1] < 0.5 * wanted[-1]


# Against a static problem of the difference


@pytest.mark.parallel(
    kind=["triangle", "tetrahedron", "hexahedron"], pairing=["mortar"], degree=[1]
)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("pairing", ["mortar", "node", "obstacle"])
def test_a_step_is_a_static_problem_of_the_difference(comm, kind, pairing, degree):
    """From a displacement w that does not move nodes across the surface: u - w is a static one."""
    dim = dim_of(kind)
    lower = (3, 1) if pairing == "node" else (2, 1)
    scene = rubbing(
        comm, kind, degree, upper=(3, 1), lower=lower, distort=0.0, friction=Tresca(3.0 * G)
    )
    if pairing == "obstacle":
        scene = scene.but(primary=floor(dim, 1.0))
        scene.data.exact.x.array[dim - 1 :: dim] *= 0.4
    x = scene.V.tabulate_dof_coordinates()
    scene.data.exact.x.array[dim - 1 :: dim] += 4e-3 * (x[:, dim - 1] > 1.5) * x[:, 0] ** 2
    w = fem.Function(scene.V)
    upper = scene.cell_tags.find(UPPER_BLOCK)
    w.interpolate(lambda x: np.stack([3e-3 * np.cos(3.0 * x[0]), *0.0 * x[1:dim]]), upper)
    w.x.scatter_forward()
    with scene.problem() as problem:
        problem.set_slip_origin(w)
        moved = problem.solve(rtol=RTOL)
    counts = moved.counts
    assert 0 < counts.contact < counts.nodes and 0 < counts.stick < counts.nodes
    scene.data.exact.x.array[:] -= w.x.array
    L = scene.L - ufl.replace(scene.a, {scene.a.arguments()[1]: w})
    with scene.problem(L=L) as problem:
        static = problem.solve(rtol=RTOL)
    assert moved.counts == static.counts

    def close(one: np.ndarray, other: np.ndarray) -> None:
        size = comm.allreduce(np.abs(other).max(initial=0.0), op=MPI.MAX)
        np.testing.assert_allclose(one, other, atol=DIGITS * size)

    close(nodal(moved.u) - nodal(w), nodal(static.u))
    (_, there), (_, here) = surface_nodes_of(moved), surface_nodes_of(static)
    for name, other in (
        ("pressure", "pressure"),
        ("traction", "traction"),
        ("slip_increment", "slip"),
        ("gap", "gap"),
        ("state", "state"),
    ):
        close(there[name], here[other])
    assert moved.greatest_slip == pytest.approx(static.greatest_slip, rel=DIGITS)
    assert moved.dissipation == pytest.approx(static.dissipation, rel=DIGITS)
    assert moved.energy_error_bound < 1e-6 and static.energy_error_bound < 1e-6
    assert moved.primal_energy == pytest.approx(moved.dual_energy, rel=DIGITS)


# Energy


@dataclass
class Balance:
    """What a load step does, from the outside.

    Attributes:
        elastic: energy of the bodies at its end.
        ends: work of loads and supports, with their forces at the end of the step.
        mean: the same with the mean of those at its beginning and end.
        change: 1/2 |u - u_before|_K^2.
        dissipation: as it is reported.
        closing: pressure times the gap that was there before.
        opening: pressure that was there before, times the gap.
    """

    elastic: float
    ends: float
    mean: float
    change: float
    dissipation: float
    closing: float
    opening: float


def pressed_on(comm: MPI.Comm, one: ContactSolution, other: ContactSolution) -> float:
    """Return the sum of pressures of one solution times gaps of the other [energy]."""
    (points, fields), (_, others) = surface_nodes_of(one), surface_nodes_of(other)
    weights, pressure, gap = (
        global_vector(comm, points, values)
        for values in (fields["weights"], fields["pressure"], others["gap"])
    )
    return float(weights @ (pressure * gap))


class Rubbing:
    """Two blocks that are pressed, tilted and dragged to and fro: nodes open and close again."""

    def __init__(self, comm: MPI.Comm, kind: str, degree: int) -> None:
        self.scene = rubbing(comm, kind, degree, upper=(4, 1), lower=(3, 1))
        self.V, dim = self.scene.V, self.scene.mesh.geometry.dim
        points = self.V.tabulate_dof_coordinates()
        self._upper = points[:, dim - 1] > 1.5
        self._x = points[self._upper, :dim]
        held = [
            fem.locate_dofs_topological(self.V, dim - 1, self.scene.facet_tags.find(tag))
            for tag in (TOP, BOTTOM)
        ]
        owned = self.V.dofmap.index_map.size_local
        self._held = np.unique(np.concatenate(held))
        self._held = self._held[self._held < owned]
        self.problem = self.scene.problem()
        self._u = fem.Function(self.V)
        self._energy = fem.form(0.5 * ufl.action(ufl.action(self.scene.a, self._u), self._u))
        self._forces = fem.form(ufl.action(self.scene.a, self._u))

    def move(self, time: float) -> None:
        """Set the motion of the upper end: a cycle takes a time of one."""
        u = moved_end(self._x)
        u[:, :-1] *= 4.0 * np.sin(2.0 * np.pi * time)
        u[:, -1] += 4e-3 * np.sin(2.0 * np.pi * time) * self._x[:, 0]
        self.scene.data.exact.x.array.reshape(-1, u.shape[1])[self._upper] = u

    def energy(self, u: fem.Function) -> float:
        """Return a(u, u) / 2."""
        self._u.x.array[:] = u.x.array
        return float(self.V.mesh.comm.allreduce(fem.assemble_scalar(self._energy)))

    def forces(self, u: fem.Function) -> np.ndarray:
        """Return K u at this rank's held nodes: there are no loads."""
        self._u.x.array[:] = u.x.array
        vector = fem.assemble_vector(self._forces)
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        return vector.array.reshape(-1, self.V.mesh.geometry.dim)[self._held]

    def steps(self, times: Sequence[float]) -> list[Balance]:
        """Solve and accept at these times; the first step only begins."""
        comm, found = self.scene.mesh.comm, []
        before: ContactSolution | None = None
        for time in times:
            self.move(time)
            now = self.problem.solve(rtol=RTOL)
            assert now.status is ContactStatus.CONVERGED
            self.problem.accept()
            if before is not None:
                change = fem.Function(self.V)
                change.x.array[:] = now.u.x.array - before.u.x.array
                way = nodal(change)[self._held]
                there, here = self.forces(before.u), self.forces(now.u)
                closing = pressed_on(comm, now, before)
                opening = pressed_on(comm, before, now)
                at_end, at_begin = reduce_array(comm, [(way * here).sum(), (way * there).sum()])
                found.append(
                    Balance(
                        elastic=self.energy(now.u) - self.energy(before.u),
                        ends=at_end,
                        mean=0.5 * (at_end + at_begin),
                        change=self.energy(change),
                        dissipation=now.dissipation,
                        closing=closing,
                        opening=opening,
                    )
                )
            before = now
        return found


@pytest.mark.parallel(kind=["triangle", "hexahedron"])
@pytest.mark.parametrize(
    ("kind", "degree"),
    [("triangle", 2), ("quadrilateral", 1), ("tetrahedron", 1), ("hexahedron", 1)],
)
def test_energy_balance_of_each_step(comm, kind, degree):
    """What the bodies do not keep of the work is dissipated: to the last digit, and by what else.

    From K u = f - B'lambda at both ends of a step, with D = lambda_tau'(T u - T u_0):

        f'(u - u_0) = E - E_0 + D + 1/2 |u - u_0|_K^2 + lambda_nu'(d - N u_0),

    forces of supports being part of f: the method is implicit, and the last two terms, which are
    not negative, vanish with the square of the step.
    """
    rubbing_blocks = Rubbing(comm, kind, degree)
    with rubbing_blocks.problem:
        found = rubbing_blocks.steps(np.linspace(0.0, 1.0, 9))
    work = max(abs(step.ends) for step in found)
    for step in found:
        assert step.change >= 0.0 and step.closing >= -DIGITS * work
        kept = step.elastic + step.dissipation + step.change + step.closing
        assert step.ends == pytest.approx(kept, abs=DIGITS * work)
    for of_all in ("dissipation", "closing", "opening"):
        assert max(getattr(step, of_all) for step in found) > 1e-3 * work


def test_energy_balance_in_the_limit(comm):
    """With the mean of the forces as work, what is missing falls with the step."""
    missing = []
    for number in (8, 16):
        rubbing_blocks = Rubbing(comm, "quadrilateral", 1)
        with rubbing_blocks.problem:
            # from a state that repeats
            found = rubbing_blocks.steps(np.linspace(0.25, 1.25, number + 1))
        work = sum(step.dissipation for step in found)
        missing.append(
            sum(abs(step.mean - step.elastic - step.dissipation) for step in found) / work
        )
    assert missing[1] < 2**-0.8 * missing[0] < 0.1


# Many steps, and the way in


def test_reversals(comm):
    """What a step costs does not grow with their number."""
    products = reversals(comm, 20, 12, accepts=True)
    assert np.mean(products[-4:]) <= GROWTH * np.mean(products[:4])


@pytest.mark.long
def test_many_reversals_with_history(comm):
    """The same with 200, on a finer strip."""
    products = reversals(comm, 150, 200, accepts=True)
    assert np.mean(products[-50:]) <= GROWTH * np.mean(products[:50])


def test_what_slipped_stays_when_the_load_is_taken_away(comm):
    """A strip that is pulled slips from its end on; half of that is left, as in shear lag.

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
@pytest.mark.parametrize("end", ENDS)
def test_a_step_costs_few_products(comm, end, accepts):
    """At most eight for a change of the load by a tenth, there and back; far fewer on the whole."""
    scene = two_bricks(comm, 8, end=end)
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


@pytest.mark.parametrize("end", ENDS)
def test_coulomb_costs_what_tresca_does(comm, end):
    """At most 1.3 times the products, from little friction to much."""
    scene = two_bricks(comm, 8, end=end)
    with scene.problem() as problem:
        tresca = problem.solve(rtol=1e-6).products
    for coefficient in (0.1, 1.0):
        with scene.but(friction=Coulomb(coefficient)).problem() as problem:
            solution = problem.solve(rtol=1e-6)
            assert solution.status is ContactStatus.CONVERGED
            assert solution.products <= 1.3 * tresca
