"""Solving on finer and finer meshes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    AdaptiveStatus,
    ContactPair,
    ContactProblem,
    ConvergenceError,
    Frictionless,
    InputError,
    MeanPressure,
    MeanSlip,
    NormalForce,
    RigidPlane,
    SolverOptions,
    TaggedMesh,
    Tresca,
    read_gmsh,
    solve_adaptively,
)
from scenes.blocks import ABOVE, BELOW, LEFT, block
from scenes.elasticity import elasticity, fixed
from scenes.patches import LOWER, UPPER
from scenes.pressed_blocks import on_blocks, pressed_blocks
from scenes.two_bricks import on_bricks, two_bricks

YOUNG, POISSON = 1000.0, 0.3  # MPa


def forms(tagged, degree, load=0.0, onto=()):
    """Return the space, a and L; a load [MPa] presses down on what has these names."""
    mesh = tagged.mesh
    dim = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tagged.facet_tags)
    force = fem.Constant(mesh, np.append(np.zeros(dim - 1), -load))
    where = ds(tuple(tagged.tags[name] for name in onto)) if onto else ds
    return V, elasticity(V, YOUNG, POISSON), ufl.inner(force, ufl.TestFunction(V)) * where


def held(tagged, V, name, axis=None, value=None):
    """Prescribe the displacement, or one component of it, of facets."""
    return fixed(V, tagged.facet_tags.find(tagged.tags[name]), value, axis)


def cantilever(tagged, degree=1, options=None):
    """A square that is clamped on its left, and pressed on a floor under its right half."""
    V, a, L = forms(tagged, degree, load=10.0, onto=["top"])
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 1, 0))
    pair = ContactPair(tagged.facet_tags, tagged.tags["bottom"], floor, Tresca(1.0))
    bcs = [held(tagged, V, "left")]
    return ContactProblem(a, L, [pair], bcs=bcs, options=options)


def sheet(comm, n=4):
    """The unit square with names for its sides."""
    scene = block(comm, (n, n))
    names = {"bottom": BELOW, "top": ABOVE, "left": LEFT}
    return TaggedMesh(scene.mesh, None, scene.facet_tags, names)


def decay(result):
    """Return the power of 1/n with which the error falls, by a fit over the last four meshes."""
    unknowns, errors = np.log([(one.free_dofs, one.error) for one in result.levels[-4:]]).T
    return -np.polyfit(unknowns, errors, 1)[0]


@pytest.mark.parametrize(("degree", "accuracy", "rate"), [(1, 0.08, 0.45), (2, 0.01, 0.8)])
def test_error_falls_as_fast_as_without_singularities(comm, degree, accuracy, rate):
    """By n^(-p/2) in 2D; uniform meshes have about n^-0.35 of a clamped edge, whatever p."""
    result = solve_adaptively(
        lambda tagged: cantilever(tagged, degree), sheet(comm, 4), accuracy, fraction=0.5
    )
    result.raise_if_failed()
    assert decay(result) >= rate
    assert result.status is AdaptiveStatus.REACHED
    assert result.error <= accuracy
    assert result.solution.discretisation_error == pytest.approx(result.error, rel=0.01)
    assert result.tagged_mesh is result.levels[-1].tagged_mesh


def test_the_table(comm):
    result = solve_adaptively(cantilever, sheet(comm), 0.2)
    lines = str(result).splitlines()
    assert lines[0] == "status         REACHED: accuracy reached"
    assert len(lines) == 5 + len(result.levels)
    assert f"{result.levels[-1].free_dofs} unknowns" in repr(result)


@pytest.mark.parallel
def test_what_ends_it(comm):
    build = cantilever
    coarse = sheet(comm, 2)
    one = solve_adaptively(build, coarse, 0.01, max_levels=1)
    assert one.status is AdaptiveStatus.MAX_LEVELS
    assert len(one.levels) == 1
    unknowns = one.levels[0].free_dofs
    few = solve_adaptively(build, coarse, 0.01, max_dofs=3 * unknowns)
    assert few.status is AdaptiveStatus.MAX_DOFS
    assert few.levels[-1].free_dofs <= 3 * unknowns
    seen = []

    def observer(level):
        seen.append(level.number)
        return level.number == 1 and comm.rank == comm.size - 1

    stopped = solve_adaptively(build, coarse, 0.01, observer=observer)
    assert stopped.status is AdaptiveStatus.STOPPED
    assert seen == [0, 1]
    for result in (one, few, stopped):
        # solved to its end all the same
        assert result.solution.options == SolverOptions()
        with pytest.raises(ConvergenceError, match=f"{result.status.value} after"):
            result.raise_if_failed()


def test_no_problem_is_made_that_is_too_large(comm):
    """A mesh with too many unknowns is not used, whether it is the second one or a later one."""
    for most in (60, 150, 400):
        coarse, sizes = sheet(comm, 4), []

        def build(tagged, sizes=sizes):
            problem = cantilever(tagged)
            sizes.append(problem.free_dofs)
            return problem

        result = solve_adaptively(build, coarse, 1e-3, max_dofs=most)
        assert result.status is AdaptiveStatus.MAX_DOFS
        assert max(sizes[1:], default=0) <= 1.1 * most  # unknowns grow about as cells do
        assert result.levels[-1].free_dofs == sizes[-1]


@pytest.mark.parallel
def test_meshes_grow_by_a_factor(comm):
    """All meshes together have a few times the unknowns of the last, which is hardly too fine."""
    result = solve_adaptively(cantilever, sheet(comm, 4), 0.05)
    assert result.status is AdaptiveStatus.REACHED
    unknowns = [level.free_dofs for level in result.levels]
    assert len(unknowns) > 3
    assert sum(unknowns[:-1]) <= 1.5 * unknowns[-1]
    assert result.error >= 0.6 * 0.05


def test_an_iteration_that_fails(comm):
    options = SolverOptions(method="gimssn", max_iterations=1)
    result = solve_adaptively(lambda t: cantilever(t, options=options), sheet(comm), 0.01)
    assert result.status is AdaptiveStatus.FAILED
    with pytest.raises(ConvergenceError, match="iteration limit reached"):
        result.raise_if_failed()


def test_options_of_the_problem_count_at_the_end(comm):
    options = SolverOptions(rtol=1e-9)
    result = solve_adaptively(lambda t: cantilever(t, options=options), sheet(comm), 0.2)
    assert result.solution.residuals[-1] <= 1e-9
    assert result.error <= 0.2


def test_a_start_that_does_not_fit(comm):
    with cantilever(sheet(comm)) as problem:
        solution = problem.solve()
    bricks = read_gmsh(MESHES / "two_bricks.geo", comm, N=2)
    V, a, L = forms(bricks, 1, load=1.0, onto=["upper_top"])
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
    pair = ContactPair(bricks.facet_tags, bricks.tags["upper_contact"], floor, Frictionless())
    bcs = [held(bricks, V, "upper_fixed"), held(bricks, V, "lower_fixed")]
    with (
        ContactProblem(a, L, [pair], bcs=bcs) as problem,
        pytest.raises(
            InputError, match=r"with 1 pair\(s\) in 3D, found an object of type ContactS"
        ),
    ):
        problem.continue_from(solution)


FAULTS = {
    "build": ({"build": 1}, "build must be a function"),
    "no problem": ({"build": lambda tagged: None}, "must return a ContactProblem, found None"),
    "accuracy": ({"accuracy": 1.5}, r"accuracy must be a number in \(0, 1\), found 1.5"),
    "fraction": ({"fraction": 0}, "fraction must be"),
    "dofs": ({"max_dofs": -1}, "max_dofs must be a positive number, found -1"),
    "levels": ({"max_levels": 0}, "max_levels must be"),
    "half a level": ({"max_levels": 1.5}, "max_levels must be a positive integer, found 1.5"),
    "no level": ({"max_levels": True}, "max_levels must be a positive integer, found True"),
    "all": ({"fraction": True}, r"fraction must be a number in \(0, 1\], found True"),
    "after": ({"after": 1}, "after must be a ContactSolution, found 1. An AdaptiveSolution has"),
    "no dofs": ({"max_dofs": np.nan}, "max_dofs must be a positive number, found nan"),
    "observer": ({"observer": 1}, "observer must be a function of a Level"),
}


@pytest.mark.parallel
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named_on_all_ranks(comm, fault):
    changes, message = FAULTS[fault]
    arguments = {"build": cantilever, "tagged_mesh": sheet(comm, 2), "accuracy": 0.5, **changes}
    with pytest.raises(InputError, match=message):
        solve_adaptively(**arguments)


@pytest.mark.parallel
def test_a_problem_on_another_mesh(comm):
    """Found before it is solved, also if it is on the last mesh, or was destroyed with it."""
    first, problems = sheet(comm, 2), []

    def same(tagged):
        problems.append(problems[0] if problems else cantilever(tagged))
        return problems[-1]

    for build, start in (
        (lambda tagged: cantilever(first), sheet(comm, 2)),
        (lambda tagged: cantilever(first), first),
        (same, first),
    ):
        with pytest.raises(InputError, match="build must return a problem on the mesh that it is"):
            solve_adaptively(build, start, 0.01, max_levels=2)


def test_a_goal_of_another_problem(comm, monkeypatch):
    """Found before anything is solved."""
    monkeypatch.setattr(ContactProblem, "solve", None)
    for goal, message in (
        (NormalForce, "goal must be a NormalForce, ContactForce"),
        (NormalForce(pair=1), "goal belongs to pair 1, but the problem has 1"),
        (MeanPressure(point=(0.0, 0.0, 0.0), radius=1.0), "point of the goal must be 2"),
    ):
        with pytest.raises(InputError, match=message):
            solve_adaptively(cantilever, sheet(comm, 2), 0.5, goal=goal)


PRESSURE = MeanPressure((0.3, 1.0), 0.15)


@pytest.mark.parallel
def test_the_iteration_is_as_good_as_a_number_needs(comm):
    coarse = pressed_blocks(comm, 4).tagged_mesh
    result = solve_adaptively(
        lambda tagged: on_blocks(tagged).problem(), coarse, 1e-3, goal=PRESSURE, max_levels=2
    )
    assert result.error == result.goal_error.relative_error
    assert "of the number" in str(result)
    assert result.goal_error.iteration_error <= 0.1 * result.goal_error.error
    assert result.goal_error.products < result.levels[-1].products


def test_a_patch_that_is_open_says_nothing_of_the_mesh(comm):
    """Its pressure is zero, and so is what the displacement changes of it: the energy counts."""
    coarse = pressed_blocks(comm, 4).tagged_mesh

    def build(tagged):
        scene = on_blocks(tagged)
        lift = fem.Function(scene.V)
        lift.interpolate(lambda x: np.array([0.0 * x[0], 0.01 + 0.01 * x[0] ** 2]))
        top = fem.locate_dofs_topological(scene.V, 1, scene.facets("top"))
        bcs = [fem.dirichletbc(lift, top), scene.fixed("bottom")]
        return scene.problem(bcs=bcs)

    result = solve_adaptively(build, coarse, 0.01, goal=PRESSURE, max_levels=1)
    (level,) = result.levels
    assert level.goal_error.value == 0.0
    assert level.error == level.solution.discretisation_error > 0.0
    assert f"about {level.error:.1e} of the solution's norm" in str(result)


@pytest.mark.parallel
def test_a_patch_without_a_contact_node(comm):
    """Inside the body; beside it; or smaller than the cells of the first mesh."""
    coarse = pressed_blocks(comm, 4).tagged_mesh
    for goal in (
        MeanPressure((0.37, 1.4), 0.1),
        MeanPressure((0.37, 9.0), 0.1),
        MeanSlip((0.37, 1.0), 1e-3, (1, 0)),
    ):
        with pytest.raises(InputError, match="the patch of the goal has no contact node"):
            solve_adaptively(lambda tagged: on_blocks(tagged).problem(), coarse, 0.5, goal=goal)


def test_meshes_for_a_number(comm):
    """A patch is refined for the pressure on it."""
    goal = PRESSURE
    coarse = pressed_blocks(comm, 8).tagged_mesh

    def build(tagged):
        return on_blocks(tagged, degree=2).problem()

    result = solve_adaptively(build, coarse, 5e-3, goal=goal)
    assert result.status is AdaptiveStatus.REACHED
    assert result.error <= 5e-3
    assert len(result.levels) > 1
    with build(result.tagged_mesh) as problem:
        energy_error = problem.solve().discretisation_error
    by_energy = solve_adaptively(build, coarse, energy_error)
    # finer under the patch, and coarser elsewhere
    with build(by_energy.tagged_mesh) as problem:
        problem.solve(accuracy=1e-5)
        assert problem.goal_error(goal).relative_error > result.error
    with pressed_blocks(comm, 20, degree=2).problem() as problem:
        problem.solve(accuracy=1e-5)
        exact = problem.goal_error(goal).value
    # 3.4 if nodes of unequal distances had the weight of the patch at themselves
    assert abs(result.goal_error.value - exact) <= 1.5 * result.goal_error.error


@pytest.mark.parallel
def test_a_stiff_side_is_as_fine_as_the_soft_one_it_holds(comm):
    """It has next to no errors of its own; two facets held seventeen before."""
    narrow, lower = pressed_blocks(comm, 4, narrow=True).tagged_mesh, 0.01
    result = solve_adaptively(
        lambda tagged: on_blocks(tagged, lower=lower).problem(), narrow, 1e-3, max_levels=6
    )
    last = on_blocks(result.tagged_mesh, lower=lower)
    owned = last.mesh.topology.index_map(1).size_local
    stiff, soft = (
        comm.allreduce(int((last.facet_tags.find(tag) < owned).sum())) for tag in (UPPER, LOWER)
    )
    assert soft >= 10
    assert stiff >= soft / 3


@pytest.mark.parallel
def test_iterative_solves_mark_the_same_cells(comm):
    """What they leave is another thing on each number of ranks; also in a second load step."""

    def build(tagged):
        return on_bricks(tagged).problem(stiffness="multigrid")

    def unknowns(ranks) -> list[list[int]]:
        coarse, last, found = two_bricks(ranks, 4).tagged_mesh, None, []
        for _ in range(2):
            step = solve_adaptively(build, coarse, 0.01, max_levels=3, after=last)
            found.append([level.free_dofs for level in step.levels])
            last = step.solution
        return found

    assert unknowns(comm) == unknowns(MPI.COMM_SELF)
