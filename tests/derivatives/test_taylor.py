"""Taylor's test of tangents and gradients: remainders of order 1 and 2 while no node changes state.

The remainder without a derivative is of order 1 in the change of a control, and that with the
derivative of order 2: for all fields by the tangent, for goals by the gradient.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from rubbing_controls import RTOL, Rubbing, along, direction_of, solved, values_of

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactError,
    ContactForce,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    NewtonOptions,
    NonlinearContactProblem,
    NormalForce,
    PressureNorm,
    RigidCylinder,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    SolverOptions,
    Tresca,
)
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import elasticity
from scenes.patches import BOTTOM, TOP
from scenes.rubber_block import neo_hookean, rubber_block
from scenes.rubbing import rubbing
from scenes.two_bricks import two_bricks

#: Two changes over the largest value of a control.
CHANGES = (1e-3, 5e-4)

#: Factors of the changes, of which the first is taken for which no node changes its state and terms
#: of higher order are small.
SMALLER = (1.0, 0.25, 0.06, 0.015)

#: Least quotient of both remainders of order 2 (4 without terms of higher order), and the range of
#: that of order 1.
SECOND, FIRST = 3.4, (1.8, 2.2)

#: Remainder over the field that is the error of two solves: residuals times some condition.
FLOOR = 2e-10

#: Derivative over the goal and one over the control that is zero: of a force that the control does
#: not change.
ZERO = 1e-3

#: Difference of tangent and gradient over the terms that are summed: both are accurate to 1e-10 in
#: the energy norm. With obstacles their central differences are taken along other directions.
TRANSPOSED, WITH_OBSTACLES = 1e-8, 1e-6


def largest(comm: Any, values: Any) -> float:
    """Return the largest absolute value of an array over all ranks."""
    return float(comm.allreduce(np.abs(values).max(initial=0.0), op=MPI.MAX))


def fields_of(result: Any) -> dict[str, np.ndarray]:
    """Return the values of the fields of a solution or a tangent, by kind of unit."""
    surfaces = result.surfaces
    stresses = [one.pressure for one in surfaces]
    stresses += [one.traction for one in surfaces if one.traction is not None]
    lengths = [result.u, *[one.gap for one in surfaces]]
    lengths += [one.slip for one in surfaces if one.slip is not None]
    named = {"stress": stresses, "length": lengths}
    return {name: np.concatenate([one.x.array for one in some]) for name, some in named.items()}


def states_of(solution: Any) -> np.ndarray:
    """Return the states of all nodes."""
    return np.concatenate([one.state.x.array for one in solution.surfaces])


def values(problem: Any, goals: Sequence[Any]) -> np.ndarray:
    """Return the values of goals and forms at the last solution."""
    return np.array(
        [
            problem.comm.allreduce(fem.assemble_scalar(fem.form(goal)))
            if isinstance(goal, ufl.Form)
            else problem.goal_value(goal)
            for goal in goals
        ]
    )


def taylor(
    solve: Callable[[], Any],
    problem: Any,
    controls: Sequence[Any],
    goals: Sequence[Any],
    transposed: float = TRANSPOSED,
    forms: Callable[[Any], Sequence[Any]] = lambda u: [],
) -> None:
    """Check remainders along a direction of each control, by changes that change no state.

    Args:
        solve: returns the solution for the present controls.
        problem: to be differentiated.
        controls: which are changed one after the other.
        goals: numbers of contact.
        transposed: difference of tangent and gradient.
        forms: from a displacement to further numbers, which are forms of it.
    """
    comm, start = problem.comm, solve()
    found, states = fields_of(start), states_of(start)
    numbers = values(problem, [*goals, *forms(start.u)])
    sizes = {name: largest(comm, field) for name, field in found.items()}
    for control in controls:
        data, direction = values_of(control), direction_of(control)
        step = getattr(direction, "x", None)
        step = direction if step is None else step.array
        at_solution = [*goals, *forms(start.u)]
        tangent = problem.tangent([control], [direction])
        slopes, of_goals = fields_of(tangent), np.array([tangent.of(goal) for goal in at_solution])
        before, scale = data.copy(), largest(comm, data) or 1e-2
        for goal, slope, number in zip(at_solution, of_goals, numbers, strict=True):
            derivative = problem.gradient(goal, [control])[0]
            values_along = getattr(derivative, "x", None)
            terms = derivative if values_along is None else values_along.array
            size = max(abs(slope), largest(comm, terms * step), ZERO * abs(number) / scale)
            assert abs(along(derivative, step) - slope) <= transposed * size, (control, goal)
        fault = ""
        for factor in SMALLER:
            first: dict[Any, list[float]] = {}
            second: dict[Any, list[float]] = {}
            same = True
            for change in CHANGES:
                size = factor * change * scale
                data[...] = before + size * step
                solution = solve()
                same &= comm.allreduce(np.array_equal(states_of(solution), states), op=MPI.LAND)
                for name, now in fields_of(solution).items():
                    difference = now - found[name]
                    first.setdefault(name, []).append(largest(comm, difference))
                    left = largest(comm, difference - size * slopes[name])
                    second.setdefault(name, []).append(left)
                differences = values(problem, [*goals, *forms(solution.u)]) - numbers
                for k, (one, slope) in enumerate(zip(differences, of_goals, strict=True)):
                    first.setdefault(k, []).append(abs(one))
                    second.setdefault(k, []).append(abs(one - size * slope))
            floors = {name: FLOOR * sizes.get(name, np.abs(numbers).max()) for name in first}
            fault = wrong_rates(first, second, floors) if same else "a node changes its state"
            if not fault:
                break
        else:
            pytest.fail(f"{control}: {fault}")
        data[...] = before
        start = solve()
        assert np.array_equal(states_of(start), states)


def wrong_rates(first: Any, second: Any, floors: Any) -> str:
    """Return which remainders have other orders than 1 without and 2 with the derivative."""
    for name, (whole, part) in second.items():
        if part > max(whole / SECOND, floors[name]):
            return f"the remainder of {name} falls from {whole} to {part}"
        before, after = first[name]
        if after > 100.0 * max(whole, floors[name]) and not FIRST[0] <= before / after <= FIRST[1]:
            return f"{name} changes by {before} and {after}"
    return ""


MANY = [
    (kind, degree, law, pairing)
    for kind in ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
    for degree in (1, 2)
    for law in ("tresca", "coulomb", "frictionless")
    for pairing in ("mortar", "nodes")[: 3 - degree]
]


@pytest.mark.parallel(case=[("triangle", 2, "coulomb", "mortar")])
@pytest.mark.parametrize(
    "case",
    [
        ("triangle", 2, "coulomb", "mortar"),
        ("quadrilateral", 1, "curve", "mortar"),
        ("tetrahedron", 1, "tresca", "mortar"),
    ],
)
def test_two_bodies(comm, case):
    """Modulus, Poisson's ratio, load, prescribed values, gap and friction of two blocks.

    Of numbers of each kind, the work of the load and the energy.
    """
    kind, degree, law, pairing = case
    alike = {"upper": (4, 3), "distort": 0.0} if pairing == "nodes" else {}
    model = Rubbing(comm, kind, degree, law, pairing=pairing, **alike)

    def work_and_energy(u):
        energy = 0.5 * ufl.replace(model.a, dict(zip(model.a.arguments(), (u, u), strict=True)))
        return [ufl.action(model.L, u), energy]

    with ContactProblem(*model.arguments, stiffness="cholesky") as problem:
        taylor(lambda: solved(problem), problem, model.controls, model.goals, forms=work_and_energy)


@pytest.mark.long
@pytest.mark.parametrize("case", MANY)
def test_many_pairs_of_bodies(comm, case):
    """All kinds of cells, degrees, laws and pairings."""
    test_two_bodies(comm, case)


@pytest.mark.long
@pytest.mark.parametrize("law", ["tresca", "coulomb"])
def test_load_steps(comm, law):
    """In the second of two load steps, whose slip counts from the first."""
    model = Rubbing(comm, "triangle", 1, law, upper=(8, 2))
    with ContactProblem(*model.arguments, stiffness="cholesky") as problem:
        model.end.x.array[:] *= 0.7
        solved(problem)
        problem.accept()
        model.end.x.array[:] *= 1.2

        def solve():
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            return solution

        controls = [model.load, model.end, model.profile, model.bound, model.coefficient]
        taylor(solve, problem, controls, [NormalForce(), model.goals[1]])


@pytest.mark.parametrize("grooves", [(1.0, 0.4, 0.0)])
def test_ellipses(comm, grooves):
    """Adhesion and limit of orthotropic friction, whose two coefficients stay as they are."""
    scene = two_bricks(comm, 3)
    limit = fem.Constant(scene.mesh, 0.08)
    law = Coulomb((0.1, 0.12), limit=limit, adhesion=0.1 * limit, direction=grooves)
    goals = [NormalForce(), ContactForce((1.0, 0.0, 0.0)), ContactForce((0.0, 1.0, 0.0))]
    with scene.but(friction=law).problem(stiffness="cholesky") as problem:
        taylor(lambda: solved(problem), problem, [limit, scene.data.load], goals)


def obstacle(mesh: Any, shape: str, dim: int) -> tuple[RigidObstacle, list[fem.Constant]]:
    """Return an obstacle below a unit block, and the Constants that place it."""
    across = [0, 2] if dim == 2 else [0, 1, 2]
    # its top is not below a node, so that the nodes next to it are pressed differently
    c = fem.Constant(mesh, np.array([0.56, 0.41, -2.0])[across])
    radius = fem.Constant(mesh, 2.0)
    if shape == "sphere":
        return RigidSphere(c, radius), [c, radius]
    if shape == "cylinder":
        axis = fem.Constant(mesh, (0.2, 1.0, 0.05))
        return RigidCylinder(c, axis, radius), [c, axis, radius]
    if shape == "plane":
        c.value[-1] = 0.0
        normal = fem.Constant(mesh, np.array([0.03, 0.02, 2.0])[across])
        return RigidPlane(c, normal), [c, normal]

    def bowl(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        centre = np.zeros(3)
        centre[: len(c.value)] = c.value
        away = x - centre[:, None]
        length = np.linalg.norm(away, axis=0)
        return length - 2.0, away / length

    return RigidObstacle(bowl, "a ball of one's own"), [c]


OBSTACLES = [
    (shape, dim, degree, law)
    for shape in ("sphere", "plane", "cylinder", "own")
    for dim in (2, 3)
    for degree in (1, 2)
    for law in ("coulomb", "tresca", "frictionless", "ellipse")
    if not (dim == 2 and (shape == "cylinder" or law == "ellipse"))
]


@pytest.mark.parallel(case=[("sphere", 3, 1, "coulomb")])
@pytest.mark.parametrize(
    "case",
    [("sphere", 3, 1, "coulomb"), ("plane", 2, 2, "tresca"), ("own", 2, 1, "coulomb")],
)
def test_obstacles(comm, case, after_slip=False):
    """The place, direction and radius of obstacles that a block is pressed and dragged on."""
    shape, dim, degree, law = case
    way = np.array([0.011, 0.004, -0.05])[[0, 2] if dim == 2 else [0, 1, 2]]
    laws = {
        "coulomb": Coulomb(0.3),
        "tresca": Tresca(3.0),
        "frictionless": Frictionless(),
        "ellipse": Tresca((3.0, 2.0), direction=(1.0, 0.3, 0.0)),
    }
    n = (5, 3) if dim == 2 else (3, 3, 2)
    scene = block(
        comm, n, degree=degree, load=(0.0, 0.0, 0.0), held=[ABOVE],
        moved=lambda x: np.tile(way[:, None], x.shape[1]),
    )  # fmt: skip
    placed, controls = obstacle(scene.mesh, shape, dim)
    pair = ContactPair(scene.facet_tags, BELOW, placed, laws[law])
    goals = [NormalForce(), ContactForce(np.eye(dim)[0]), ContactForce(np.eye(dim)[-1])]
    with ContactProblem(scene.a, scene.L, [pair], scene.bcs, stiffness="cholesky") as problem:
        placed_at = [values_of(one).copy() for one in controls]
        dragged = scene.data.held.x.array.reshape(-1, dim)[:, :-1]
        first_drag = dragged.copy()

        def solve():
            if after_slip:  # of a step at the place before the change
                changed = [values_of(one).copy() for one in controls]
                for control, values in zip(controls, placed_at, strict=True):
                    values_of(control)[...] = values
                dragged[:] = first_drag
                problem.set_slip_origin(None)
                problem.solve(rtol=RTOL).raise_if_failed()
                problem.accept()
                for control, values in zip(controls, changed, strict=True):
                    values_of(control)[...] = values
                dragged[:] = -0.5 * first_drag
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            return solution

        taylor(solve, problem, controls, goals, WITH_OBSTACLES)


@pytest.mark.long
@pytest.mark.parametrize("after_slip", [False, True])
@pytest.mark.parametrize("case", OBSTACLES)
def test_many_obstacles(comm, case, after_slip):
    """All shapes, dimensions, degrees and laws, also after a load step whose slip is accepted."""
    test_obstacles(comm, case, after_slip)


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("law", "degree"), [("coulomb", 1), pytest.param("tresca", 2, marks=pytest.mark.long)]
)
def test_floating_bodies(comm, law, degree):
    """A block that contact alone holds: also of a form, by rigid displacements."""
    scene = rubbing(comm, "quadrilateral", degree)
    mesh, V, facets = scene.mesh, scene.V, scene.facet_tags
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facets)
    load, stiffness = fem.Constant(mesh, (0.1, -1.0)), fem.Constant(mesh, 1000.0)
    profile = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="profile")
    profile.interpolate(lambda x: 1e-4 * x[0] ** 2)
    bound = fem.Constant(mesh, 0.3)
    friction = Coulomb(bound) if law == "coulomb" else Tresca(bound)
    pairs = [
        dataclasses.replace(scene.pair, friction=Bonded()),
        ContactPair(facets, BOTTOM, RigidPlane((0.0, 0.0), (0.0, 1.0)), friction, gap=profile),
    ]
    a, L = elasticity(V, stiffness), ufl.inner(load, ufl.TestFunction(V)) * ds(TOP)
    goals = [NormalForce(pair=0), PressureNorm(8.0, pair=1)]
    with ContactProblem(a, L, pairs, stiffness="cholesky") as problem:
        controls = [load, stiffness, bound, profile]
        taylor(
            lambda: solved(problem), problem, controls, goals, forms=lambda u: [ufl.action(L, u)]
        )


@pytest.mark.parallel(shape=["plane"])
@pytest.mark.parametrize("shape", ["plane", pytest.param("sphere", marks=pytest.mark.long)])
def test_nonlinear_bodies(comm, shape):
    """Rubber: its modulus, what pushes it, the gap, the coefficient, the place of the obstacle.

    Derivatives leave the solution as it was, and are refused when data have changed.
    """
    scene = rubber_block(comm, (4, 3), clamped=True, friction=Frictionless())
    mesh = scene.scene.mesh
    placed, places = obstacle(mesh, shape, 2)
    coefficient, modulus = fem.Constant(mesh, 0.3), fem.Constant(mesh, 1.0)
    profile = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="profile")
    profile.interpolate(lambda x: 0.02 * x[0])
    v = ufl.TestFunction(scene.scene.V)
    F = ufl.derivative(neo_hookean(scene.u, mu=modulus) * ufl.dx, scene.u, v)
    pair = dataclasses.replace(
        scene.scene.pairs[0], primary=placed, friction=Coulomb(coefficient), gap=profile
    )
    scene.push.value[:] = (0.03, -0.15)
    options = SolverOptions(rtol=1e-11)
    with NonlinearContactProblem(F, scene.u, [pair], scene.bcs, options=options) as problem:

        def solve():
            solution = problem.solve(newton=NewtonOptions(accuracy=1e-12))
            solution.raise_if_failed()
            return solution

        controls = [modulus, scene.push, coefficient, profile, *places]
        goals = [NormalForce(), ContactForce((1.0, 0.0)), PressureNorm(8.0)]
        taylor(solve, problem, controls, goals, WITH_OBSTACLES)
        u = scene.u.x.array.copy()
        problem.gradient(goals[0], [modulus])
        assert np.array_equal(u, scene.u.x.array)
        scene.push.value[:] *= 1.1
        with pytest.raises(ContactError, match=r"have changed since the solution"):
            problem.gradient(goals[0], [modulus])
        problem.accept()  # gradients have left the solution as it was
        with pytest.raises(ContactError, match=r"call solve\(\) first, and accept\(\) afterwards"):
            problem.gradient(goals[0], [modulus])
