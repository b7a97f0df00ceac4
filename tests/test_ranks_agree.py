"""A wrong or different argument on one rank: one error on all ranks, and no rank waits for ever."""

from __future__ import annotations

import ast
import faulthandler
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem, mesh

import dolfinx_tresca
from dolfinx_tresca import (
    MESHES,
    ContactError,
    ContactPair,
    ContactProblem,
    ContactTangent,
    Coulomb,
    InputError,
    MeanPressure,
    NewtonOptions,
    NonlinearContactProblem,
    NormalForce,
    RigidObstacle,
    RigidPlane,
    SolutionWriter,
    SolverOptions,
    TaggedMesh,
    Tresca,
    Units,
    contacts,
    read_gmsh,
    refine,
    refinement_indicators,
    solve_adaptively,
)

pytestmark = [
    pytest.mark.parallel,
    pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="one rank agrees with itself"),
]

#: Seconds after which a call that hangs ends the run; each takes a small part of one.
HANGS = 120.0


@pytest.fixture(autouse=True)
def no_hang() -> Iterator[None]:
    faulthandler.dump_traceback_later(HANGS, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


def square() -> TaggedMesh:
    block = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
    facets = [
        mesh.locate_entities_boundary(block, 1, lambda x, y=y: abs(x[1] - y) < 1e-9)
        for y in (0.0, 1.0)
    ]
    values = np.repeat(np.array([1, 2], dtype=np.int32), list(map(len, facets)))
    indices = np.concatenate(facets)
    order = np.argsort(indices)
    tags = mesh.meshtags(block, 1, indices[order], values[order])
    return TaggedMesh(block, None, tags, {"bottom": 1, "top": 2})


def arguments(block: TaggedMesh, nonlinear: bool = False, **of_pair: Any) -> dict[str, Any]:
    """Return arguments of a problem: a square that is pressed on a floor."""
    V = fem.functionspace(block.mesh, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    load = fem.Constant(block.mesh, (0.0, -0.1))
    top = fem.locate_dofs_topological(V, 1, block.facet_tags.find(2))
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 1, 0))
    of_pair = {"secondary": 1, "primary": floor, "friction": Tresca(0.01)} | of_pair
    given: dict[str, Any] = {
        "pairs": [ContactPair(block.facet_tags, **of_pair)],
        "bcs": [fem.dirichletbc(np.array([0.0, -1e-3]), top, V)],
    }
    if nonlinear:
        u = fem.Function(V)
        F = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
        return given | {"F": F, "u": u}
    a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
    return given | {"a": a, "L": ufl.inner(load, v) * ufl.dx}


def _has_last_contact_node(problem: ContactProblem) -> bool:
    """Return whether this rank is the last with a contact node, where functions are called."""
    nodes = MPI.COMM_WORLD.allgather(len(problem.operators[0].nodes))
    return MPI.COMM_WORLD.rank == int(np.flatnonzero(nodes)[-1])


@pytest.fixture(scope="module")
def scene() -> Iterator[SimpleNamespace]:
    block = square()
    given = arguments(block)
    with (
        ContactProblem(**given) as problem,
        NonlinearContactProblem(**arguments(block, nonlinear=True)) as nonlinear,
    ):
        solution = problem.solve()
        with problem.record() as tape:
            pass
        V = solution.u.function_space
        quadratic = fem.Function(fem.functionspace(block.mesh, ("Lagrange", 2, (2,))))
        scalar = fem.Function(fem.functionspace(block.mesh, ("Lagrange", 1)))
        yield SimpleNamespace(
            block=block,
            given=given,
            problem=problem,
            nonlinear=nonlinear,
            solution=solution,
            tape=tape,
            load=given["L"].constants()[0],
            other=fem.Function(V),
            quadratic=quadratic,
            scalar=scalar,
            writer=SolutionWriter("never.pvd"),
            wrong=_has_last_contact_node(problem),
        )


def build(block: TaggedMesh) -> ContactProblem:
    return ContactProblem(**arguments(block))


def fails(*_: Any) -> Any:
    raise InputError("fails on the last rank")


def tangent_by_load(scene: SimpleNamespace) -> ContactTangent:
    scene.problem.solve()
    return scene.problem.tangent([scene.load], [scene.load.value])


def changed(scene: SimpleNamespace, **changes: Any) -> ContactProblem:
    return ContactProblem(**(scene.given | changes))


def on_pair(scene: SimpleNamespace, **changes: Any) -> ContactProblem:
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 1, 0))
    of_pair = {"secondary": 1, "primary": floor, "friction": Tresca(0.01)} | changes
    return changed(scene, pairs=[ContactPair(scene.block.facet_tags, **of_pair)])


def nonlinear_problem(given: dict[str, Any], wrong: tuple[int, ...] | None) -> Any:
    """Return a nonlinear problem of arguments that all ranks have made, or of wrong ones."""
    return NonlinearContactProblem(*wrong) if wrong else NonlinearContactProblem(**given)


def accept_nonlinear(scene: SimpleNamespace, on_accept: Callable[[], None]) -> None:
    with NonlinearContactProblem(
        **arguments(scene.block, nonlinear=True), on_accept=on_accept
    ) as problem:
        problem.solve().raise_if_failed()
        problem.accept()


def plane(height: float) -> RigidPlane:
    return RigidPlane(point=(0, height, 0), normal=(0, 1, 0))


FORCE, OTHER_FORCE = NormalForce(), NormalForce(1)


def values(value: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function of points (3, n) with this value."""
    return lambda x: np.full(len(x[0]), value)


def misshapen(_: np.ndarray) -> np.ndarray:
    return np.zeros((7, 3))


FLOOR = plane(0.0).signed_distance


def nonlinear(scene: SimpleNamespace, **changes: Any) -> NonlinearContactProblem:
    return NonlinearContactProblem(**(arguments(scene.block, nonlinear=True) | changes))


#: Call, with a value -> what the last rank gives it, what the others do, and a part of the message.
Case = tuple[Callable[[SimpleNamespace, Any], Any], Any, Any, str]
CASES: dict[str, Case] = {
    # ContactProblem
    "a, no form": (lambda s, x: changed(s, a=x or s.given["a"]), 5, None, "a differs"),
    "a, another": (lambda s, x: changed(s, a=x * s.given["a"]), 2.0, 1.0, "a differs"),
    "L": (lambda s, x: changed(s, L=x and s.given["L"]), None, True, "L differs"),
    "V": (lambda s, x: changed(s, V=x), 3, None, "V differs"),
    "pairs": (lambda s, x: changed(s, pairs=x * s.given["pairs"]), 2, 1, "pairs differs"),
    "pairs, none": (lambda s, x: changed(s, pairs=x or s.given["pairs"]), 1.0, None, "pairs"),
    "bcs": (lambda s, x: changed(s, bcs=x * s.given["bcs"]), 2, 1, "bcs differs"),
    "options": (lambda s, x: changed(s, options=x), 3, None, "options differs"),
    "options.rtol": (
        lambda s, x: changed(s, options=SolverOptions(rtol=x)),
        1e-8,
        1e-6,
        r"options.rtol differs between ranks in ContactProblem.__init__: 1e-0\d on rank 0, 1e-0\d",
    ),
    "stiffness": (lambda s, x: changed(s, stiffness=x), "multigrid", "auto", "stiffness differs"),
    "expected_solves": (lambda s, x: changed(s, expected_solves=x), 2, 1, "expected_solves"),
    "petsc_options": (lambda s, x: changed(s, petsc_options=x), {"ksp_rtol": 1e-3}, {}, "petsc_o"),
    "prefix": (lambda s, x: changed(s, petsc_options_prefix=x), "b_", "a_", "prefix differs"),
    "units": (lambda s, x: changed(s, units=x), Units("mm", "MPa"), None, "units differs"),
    "axisymmetric": (lambda s, x: changed(s, axisymmetric=x), True, False, "axisymmetric differs"),
    "keyword": (lambda s, x: changed(s, **x), {"unit": 1}, {}, "unexpected keyword"),
    # ContactPair
    "tag": (lambda s, x: on_pair(s, secondary=x), 2, 1, "secondary differs"),
    "tag without facets": (lambda s, x: on_pair(s, secondary=x), 3, 1, "secondary differs"),
    "obstacle": (lambda s, x: on_pair(s, primary=plane(x)), 0.1, 0.0, "primary.name differs"),
    "friction": (lambda s, x: on_pair(s, friction=x), Coulomb(0.1), Tresca(0.1), "friction"),
    "slip bound": (lambda s, x: on_pair(s, friction=Tresca(x)), 0.2, 0.1, "slip_bound differs"),
    "pairing": (lambda s, x: on_pair(s, pairing=x), "mortar", "auto", "pairing differs"),
    "search_distance": (lambda s, x: on_pair(s, search_distance=x), 1.0, None, "search_distance"),
    "sliding": (lambda s, x: on_pair(s, sliding=x), "finite", "small", "sliding differs"),
    "pair name": (lambda s, x: on_pair(s, name=x), "one", "other", "name differs"),
    "gap": (lambda s, x: on_pair(s, gap=x), 0.1, 0.2, "gap differs"),
    # functions of the user that are called with this rank's points
    "gap NaN": (
        lambda s, x: on_pair(s, gap=x).solve(),
        values(np.nan),
        values(0.0),
        "the gap of contact pair .* NaN or infinite",
    ),
    "bound raises": (
        lambda s, x: on_pair(s, friction=Tresca(x)).solve(),
        fails,
        values(0.1),
        "fails",
    ),
    "bound NaN": (
        lambda s, x: on_pair(s, friction=Tresca(x)).solve(),
        values(np.nan),
        values(0.1),
        ".",
    ),
    "bound, shape": (
        lambda s, x: on_pair(s, friction=Coulomb(x)).solve(),
        misshapen,
        values(0.1),
        ".",
    ),
    "distance raises": (lambda s, x: on_pair(s, primary=RigidObstacle(x)), fails, FLOOR, "fails"),
    "distance NaN": (
        lambda s, x: on_pair(s, primary=RigidObstacle(x)),
        lambda x: (np.full(len(x[0]), np.nan), np.zeros(x.shape)),
        FLOOR,
        ".",
    ),
    "distance, shape": (
        lambda s, x: on_pair(s, primary=RigidObstacle(x)),
        lambda x: (np.zeros((7, 3)), np.zeros(x.shape)),
        FLOOR,
        ".",
    ),
    # methods of ContactProblem
    "solve rtol": (lambda s, x: s.problem.solve(rtol=x), 1e-8, 1e-6, "rtol.* differs"),
    "solve wrong": (lambda s, x: s.problem.solve(rtol=x), -1.0, 1e-6, "rtol.* differs"),
    "solve method": (lambda s, x: s.problem.solve(method=x), "ssn", None, "method.* differs"),
    "solve observer": (lambda s, x: s.problem.solve(observer=x), 3, None, "observer must be"),
    "observer raises": (lambda s, x: s.problem.solve(observer=x), fails, None, "fails"),
    "goal": (lambda s, x: s.problem.goal_error(x), OTHER_FORCE, FORCE, "goal.pair"),
    "goal, patch": (
        lambda s, x: s.problem.goal_error(MeanPressure((0.5, 0.0), x)),
        0.5,
        0.6,
        "radius differs",
    ),
    "goal value": (lambda s, x: s.problem.goal_value(x), OTHER_FORCE, FORCE, "goal.pair"),
    "gradient, goal": (
        lambda s, x: s.problem.gradient(x, [s.load]),
        OTHER_FORCE,
        FORCE,
        "goal.pair",
    ),
    "gradient, controls": (
        lambda s, x: s.problem.gradient(FORCE, x * [s.load]),
        2,
        1,
        "controls differs",
    ),
    "gradient, control": (
        lambda s, x: s.problem.gradient(FORCE, [x or s.load]),
        3,
        None,
        "controls differs",
    ),
    "tangent, controls": (
        lambda s, x: s.problem.tangent(x * [s.load], x * [s.load.value]),
        2,
        1,
        "controls differs",
    ),
    "tangent, directions": (
        lambda s, x: s.problem.tangent([s.load], [x * s.load.value]),
        2.0,
        1.0,
        r"directions\[0\] differs",
    ),
    "tangent of a goal": (lambda s, x: tangent_by_load(s).of(x), OTHER_FORCE, FORCE, "goal.pair"),
    "tape, goals": (lambda s, x: s.tape.gradient({x: FORCE}, [s.load]), 1, 0, "goals"),
    "tape, controls": (
        lambda s, x: s.tape.gradient_by_step({}, x * [s.load]),
        2,
        1,
        "controls differs",
    ),
    "accept": (lambda s, x: s.problem.accept(unconverged=x), True, False, "unconverged differs"),
    "slip origin": (lambda s, x: s.problem.set_slip_origin(x and s.other), None, True, "u differs"),
    "slip origin, space": (
        lambda s, x: s.problem.set_slip_origin(s.quadratic if x else s.other),
        True,
        False,
        "u differs",
    ),
    "geometry": (
        lambda s, x: s.problem.update_geometry(s.quadratic if x else s.other),
        True,
        False,
        "u differs",
    ),
    "continue_from": (
        lambda s, x: s.problem.continue_from(x or s.solution),
        3,
        None,
        "solution differs",
    ),
    "save_state": (lambda s, x: s.problem.save_state("never", step=x), 2, 1, "step differs"),
    "save_state, wrong": (lambda s, x: s.problem.save_state("never", step=x), "2", 1, "step diff"),
    # NonlinearContactProblem
    "F": (lambda s, x: nonlinear(s, **x), {"F": 4}, {}, "F differs"),
    "symmetrize": (lambda s, x: nonlinear(s, symmetrize=x), True, False, "symmetrize differs"),
    "before_assembly raises": (
        lambda s, x: nonlinear(s, before_assembly=x),
        fails,
        lambda: None,
        "fails",
    ),
    "on_accept raises": (accept_nonlinear, fails, lambda: None, "fails"),
    "material": (
        lambda s, x: s.nonlinear.save_state("never", material=x * [s.scalar]),
        2,
        1,
        "material differs",
    ),
    "newton": (
        lambda s, x: s.nonlinear.solve(newton=NewtonOptions(max_halvings=x)),
        3,
        2,
        "newton.max_halvings differs",
    ),
    "nonlinear options": (
        lambda s, x: s.nonlinear.solve(options=SolverOptions(rtol=x)),
        1e-4,
        1e-6,
        "options.rtol differs",
    ),
    "nonlinear observer": (lambda s, x: s.nonlinear.solve(observer=x), fails, None, "fails"),
    "nonlinear geometry": (lambda s, x: s.nonlinear.update_geometry(x), 3, None, "u differs"),
    # ContactSolution, SolutionWriter
    "on_mesh": (lambda s, x: s.solution.on_mesh(x), "slop", "slip", "name differs"),
    "plot scale": (lambda s, x: s.solution.plot(scale=x), -1.0, 1.0, "scale differs"),
    "write": (lambda s, x: s.solution.write("a.pvd", fields=x), [3], [], "fields differs"),
    "write, field": (
        lambda s, x: s.solution.write("a.pvd", fields=[s.quadratic if x else s.scalar]),
        True,
        False,
        "fields\\[0\\] differs",
    ),
    "to_pyvista": (lambda s, x: s.solution.to_pyvista(fields=x), [3], [], "fields differs"),
    "series": (lambda s, x: s.writer.write(s.solution, 1.0, fields=x), [3], [], "fields differs"),
    # what has no communicator
    "series, solution": (
        lambda s, x: s.writer.write(x or s.solution, 1.0),
        3,
        None,
        "solution differs between ranks in SolutionWriter.write: ",
    ),
    "series, no argument": (lambda s, x: s.writer.write(*x), (), (3, 1.0), "missing a required"),
    "refine, nothing": (
        lambda s, x: refine(*(x or (s.block, s.solution.cell_errors))),
        (3, None),
        None,
        "tagged_mesh differs",
    ),
    "indicators, nothing": (
        lambda s, x: refinement_indicators(*(x or (s.problem, s.solution.cell_errors))),
        (3, None),
        None,
        "problem differs",
    ),
    "indicators, problem": (
        lambda s, x: refinement_indicators(x or s.problem, s.solution.cell_errors),
        3,
        None,
        "problem differs",
    ),
    "adaptively, nothing": (
        lambda s, x: solve_adaptively(build, x or s.block),
        3,
        None,
        "tagged_mesh differs",
    ),
    "problem, nothing": (
        lambda s, x: ContactProblem(*x) if x else changed(s),
        (3, 4, 5),
        None,
        "differs between ranks in ContactProblem.__init__",
    ),
    "nonlinear, nothing": (
        lambda s, x: nonlinear_problem(arguments(s.block, nonlinear=True), x),
        (3, 4, 5),
        None,
        "differs between ranks in NonlinearContactProblem.__init__",
    ),
    "read_gmsh, comm": (
        lambda s, x: read_gmsh(MESHES / "two_bricks.geo", x or MPI.COMM_WORLD, N=2),
        3,
        None,
        "comm",
    ),
    "load_state": (lambda s, x: s.problem.load_state(x), 3, "nowhere.npz", "cannot read a state"),
    "series, time": (lambda s, x: s.writer.write(s.solution, x), "t", "t", "time must be"),
    # operators
    "transfer": (lambda s, x: s.problem.operators[0].transfer(s.scalar, x), "up", "primary", "to "),
    "transfer, kind": (
        lambda s, x: s.problem.operators[0].transfer(x or s.scalar),
        3,
        None,
        "function differs",
    ),
    "transfer_loads": (
        lambda s, x: s.problem.operators[0].transfer_loads(s.quadratic if x else s.scalar),
        True,
        False,
        "function differs",
    ),
    "conductance": (
        lambda s, x: s.problem.operators[0].conductance_matrix(s.quadratic if x else s.scalar),
        True,
        False,
        "h differs",
    ),
    "reaction": (lambda s, x: s.problem.reaction(x), 1, 2, "where differs"),
    "guaranteed_error": (lambda s, x: s.problem.guaranteed_error(gain=x), 0.1, 0.2, "gain differs"),
    "guaranteed_goal": (
        lambda s, x: s.problem.guaranteed_goal(NormalForce(), gain=x),
        0.1,
        0.2,
        "gain differs",
    ),
    "contacts": (
        lambda s, x: contacts(s.block, friction=Coulomb(0.3), distance=x),
        0.1,
        0.2,
        "distance differs",
    ),
    # meshes
    "read_gmsh": (
        lambda s, x: read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_WORLD, N=x),
        3,
        2,
        "differs",
    ),
    "read_gmsh, path": (
        # the first rank alone reads the path
        lambda s, x: read_gmsh(x if MPI.COMM_WORLD.rank else 3, MPI.COMM_WORLD),
        MESHES / "two_bricks.geo",
        MESHES / "two_bricks.geo",
        "path must",
    ),
    "refine": (
        lambda s, x: refine(s.block, s.solution.cell_errors, x),
        0.4,
        0.5,
        "fraction differs",
    ),
    "refine, errors": (
        lambda s, x: refine(s.block, None if x else s.solution.cell_errors),
        True,
        False,
        "cell_errors",
    ),
    "refine, mesh": (
        lambda s, x: refine(x or s.block, s.solution.cell_errors),
        3,
        None,
        "tagged_mesh differs",
    ),
    "refine, geometry": (
        lambda s, x: refine(replace(s.block, geometry=x), s.solution.cell_errors),
        {1: lambda x: x},
        None,
        "geometry differs",
    ),
    "indicators": (
        lambda s, x: refinement_indicators(s.problem, x or s.solution.cell_errors),
        3,
        None,
        "cell_errors differs",
    ),
    # solve_adaptively
    "accuracy": (lambda s, x: solve_adaptively(build, s.block, x), 0.2, 0.3, "accuracy differs"),
    "max_levels": (
        lambda s, x: solve_adaptively(build, s.block, max_levels=x),
        2,
        1,
        "max_levels differs",
    ),
    "adaptive goal": (
        lambda s, x: solve_adaptively(build, s.block, goal=x),
        FORCE,
        None,
        "goal differs",
    ),
    "build": (lambda s, x: solve_adaptively(x, s.block), 3, build, "build differs"),
    # one that raises before others are through with DOLFINx's collective calls leaves these waiting
    "build raises": (
        lambda s, x: solve_adaptively(lambda block: x(build(block)), s.block),
        fails,
        lambda problem: problem,
        "fails",
    ),
    "after": (
        lambda s, x: solve_adaptively(build, s.block, after=x or s.solution),
        3,
        None,
        "after differs",
    ),
    "level observer raises": (
        lambda s, x: solve_adaptively(build, s.block, max_levels=1, observer=x),
        fails,
        None,
        "fails",
    ),
}


def test_no_collective_call_is_left_out():
    """Each function and class whose arguments ranks compare is in a case."""
    cases = Path(__file__).read_text()
    for path in Path(dolfinx_tresca.__file__).parent.rglob("*.py"):
        tree = ast.parse(path.read_text())
        classes = [one for one in ast.walk(tree) if isinstance(one, ast.ClassDef)]
        for owner in (tree, *classes):
            for one in owner.body:
                decorators = getattr(one, "decorator_list", [])
                if any(ast.unparse(each).startswith("collective(") for each in decorators):
                    name = one.name if one.name != "__init__" else owner.name
                    assert f"{name}(" in cases, f"{path}: {name}"


def test_obstacles_are_at_the_same_place(scene):
    """An obstacle that was moved on one rank alone is an error on all ranks."""
    floor = plane(0.0)
    pairs = [ContactPair(scene.block.facet_tags, 1, floor, Tresca(0.01))]
    with ContactProblem(**(scene.given | {"pairs": pairs})) as problem:
        floor.move_to((0.0, -1e-3 if scene.wrong else 0.0))
        with pytest.raises(InputError, match="motion differs between ranks"):
            problem.solve()


@pytest.mark.parametrize("name", CASES)
def test_one_rank_is_wrong(scene, name):
    """The same error on all ranks, and the next collective call finds them together."""
    call, wrong, right, message = CASES[name]
    with pytest.raises((ContactError, TypeError), match=message) as caught:
        call(scene, wrong if scene.wrong else right)
    found = MPI.COMM_WORLD.allgather(f"{type(caught.value).__name__}: {caught.value}")
    assert len(set(found)) == 1, found


def test_constants_must_agree(scene):
    """A load that was changed on one rank alone is an error on all ranks."""
    before = scene.load.value.copy()
    scene.load.value = before * (2.0 if scene.wrong else 1.0)
    for call in (lambda: scene.problem.solve(), lambda: scene.problem.update_stiffness()):
        with pytest.raises(InputError, match="L differs between ranks"):
            call()
    scene.load.value = before


def test_one_rank_stops(scene):
    """A solve stops on all ranks where one observer says so."""
    solution = scene.problem.solve(rtol=1e-9, observer=(lambda _: True) if scene.wrong else None)
    assert len(set(MPI.COMM_WORLD.allgather(solution.status))) == 1
