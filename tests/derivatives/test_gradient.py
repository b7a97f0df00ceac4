"""Derivatives of goals: at the edges of states, with functions of Python, and what is refused.

`test_taylor.py` compares derivatives with differences.
"""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
import pytest
from logged import logged
from rubbing_controls import RTOL, Rubbing, solved, values_of
from test_taylor import taylor

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactForce,
    ContactProblem,
    Coulomb,
    Frictionless,
    InputError,
    NormalForce,
    RigidObstacle,
    RigidPlane,
    Tresca,
)
from scenes.blocks import ABOVE, block
from scenes.two_bricks import two_bricks

#: Error of central differences that the solves' residuals and the step allow, over the derivative.
ACCURACY = 1e-6


def test_inexact_products(comm):
    """With multigrid derivatives are as accurate as the adjoint's products."""
    model = Rubbing(comm, "hexahedron")
    with ContactProblem(*model.arguments, stiffness="cholesky") as problem:
        solved(problem)
        exact = problem.gradient(model.goals[0], model.controls)
    with ContactProblem(*model.arguments, stiffness="multigrid") as problem:
        problem.solve(rtol=1e-9).raise_if_failed()
        found = problem.gradient(model.goals[0], model.controls)
    for one, other, control in zip(exact, found, model.controls, strict=True):
        one, other = (getattr(each, "x", each) for each in (one, other))
        one, other = (np.ravel(getattr(each, "array", each)) for each in (one, other))
        # derivatives by the load are small differences of large numbers here
        assert np.linalg.norm(one - other) <= 1e-3 * np.linalg.norm(one), control


def test_what_nothing_depends_on(comm, caplog):
    """Its derivative is zero, and the log says so."""
    model = Rubbing(comm, "triangle")
    with ContactProblem(*model.arguments) as problem:
        problem.solve()
        other = fem.Function(model.profile.function_space, name="other")
        constant = fem.Constant(other.function_space.mesh, 1.0)
        with caplog.at_level(logging.INFO):
            found = problem.gradient(NormalForce(), [other, constant])
        assert not found[0].x.array.any() and found[1] == 0.0
        assert "no goal depends on the control other" in logged(caplog)


class Weakening:
    """A coefficient of friction that reads a Constant which no variable of a function has."""

    def __init__(self, coefficient):
        self.data = {"coefficient": coefficient}

    def __call__(self, p, v):
        """Return the coefficient."""
        return float(self.data["coefficient"].value) / (1.0 + p) + 0.0 * v


@pytest.mark.parallel(law=["hidden"])
@pytest.mark.parametrize("law", ["closure", "hidden", "points"])
@pytest.mark.parametrize("offset", [0.0, 5e-17])
def test_python_functions_that_read_constants(comm, law, offset):
    """Functions of points, of pressure and slip, and gaps, also with values that are rounding."""
    model = Rubbing(comm, "triangle")
    mesh = model.end.function_space.mesh
    c, d = fem.Constant(mesh, 0.3), fem.Constant(mesh, (offset, 1e-4))
    laws = {
        "closure": lambda p, v: float(c.value) / (1.0 + p) + 0.0 * v,
        "hidden": Weakening(c),
        "points": lambda x: float(c.value) ** 2 * (2.0 + x[0]),
    }
    a, L, [pair], bcs = model.arguments
    pair = dataclasses.replace(
        pair, friction=Coulomb(laws[law]), gap=lambda x: d.value[0] + d.value[1] * x[0]
    )
    with ContactProblem(a, L, [pair], bcs, stiffness="cholesky") as problem:
        taylor(lambda: solved(problem), problem, [c, d], model.goals)
        c.value = 0.31
        with pytest.raises(ContactError, match="have changed since the solution"):
            problem.gradient(NormalForce(), [c])


def test_python_functions_that_read_functions(comm):
    """Derivatives with respect to Functions that a law or an obstacle reads are refused."""
    scene = block(comm, (3, 3), held=[ABOVE])
    height = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)), name="height")
    height.x.array[:] = 0.3
    read = height.x.array

    def ground(x):
        return x[1] - 0.01 * read.max(), np.tile([[0.0], [1.0], [0.0]], x.shape[1])

    plane = RigidPlane((0.0, 0.003), (0.0, 1.0))
    for primary, friction, name in (
        (RigidObstacle(ground), Coulomb(0.3), "an obstacle"),
        (plane, Coulomb(lambda p, v: read.max() / (1.0 + p)), "the coefficient of friction"),
    ):
        pair = dataclasses.replace(scene.pairs[0], primary=primary, friction=friction)
        with ContactProblem(scene.a, scene.L, [pair], scene.bcs) as problem:
            problem.solve()
            for differentiate in (
                lambda: problem.gradient(NormalForce(), [height]),
                lambda: problem.tangent([height], [height]),
            ):
                with pytest.raises(InputError, match=f"{name}.* is a Python function that reads"):
                    differentiate()


def test_wrong_arguments(comm):
    """Each error says what may be given, or what to do."""
    model = Rubbing(comm, "triangle")
    u = fem.Function(model.end.function_space)
    with ContactProblem(*model.arguments) as problem:
        with pytest.raises(ContactError, match=r"no solution for a derivative: call solve\(\)"):
            problem.gradient(NormalForce(), [model.young])
        problem.solve()
        for goal, control, message in (
            (NormalForce(), 3.0, r"must be a fem\.Constant or a fem\.Function, found 3"),
            (ufl.inner(u, u) * ufl.dx, model.young, r"write it in terms of solution\.u"),
            (model.L, model.young, "a form with arguments: a number is a form of rank 0"),
        ):
            with pytest.raises(InputError, match=message):
                problem.gradient(goal, [control])
        for control in (model.load, model.bound, model.profile, model.end):
            before = values_of(control).copy()
            values_of(control)[...] *= 1.1
            with pytest.raises(ContactError, match=r"have changed since the solution"):
                problem.gradient(NormalForce(), [model.young])
            values_of(control)[...] = before
        problem.gradient(NormalForce(), [model.young])
        model.young.value *= 1.1
        with pytest.raises(ContactError, match=r"call update_stiffness\(\) and solve\(\)"):
            problem.gradient(NormalForce(), [model.young])
        problem.update_stiffness()
        problem.solve(max_iterations=1, rtol=RTOL)
        with pytest.raises(ContactError, match=r"the last solve ended with MAX_ITERATIONS"):
            problem.gradient(NormalForce(), [model.young])
    far = Rubbing(comm, "triangle", sliding="finite")
    with ContactProblem(*far.arguments) as problem:
        problem.solve()
        with pytest.raises(InputError, match=r"the pairing of their surfaces depends"):
            problem.gradient(NormalForce(), [far.young])


def test_the_axes_of_an_ellipse_are_no_controls(comm):
    """A Constant in the direction or in a bound of orthotropic friction is refused."""
    scene = two_bricks(comm, 2)
    part = fem.Constant(scene.mesh, 0.5)
    law = Tresca((0.1, 0.2), direction=lambda x: (1.0, 0.0, 0.0))
    with scene.but(friction=law).problem() as problem:
        problem.solve()
        assert problem.gradient(NormalForce(), [part])[0] == 0.0
    grooves = fem.Constant(scene.mesh, (1.0, 0.0, 0.0))
    bound = fem.Constant(scene.mesh, 0.1)
    with scene.but(friction=Tresca((bound, 0.2), direction=grooves)).problem() as problem:
        problem.solve()
        for control in (grooves, bound):
            with pytest.raises(InputError, match="part of the direction or the two bounds of"):
                problem.gradient(NormalForce(), [control])
            with pytest.raises(InputError, match="part of the direction or the two bounds of"):
                problem.tangent([control], [control.value])


def test_nodes_at_the_edge_of_contact(comm, caplog):
    """A block that touches the floor without pressure: it is pressed, or lifted."""
    scene = block(comm, (3, 3), load=(0.0, 0.0, 0.0), friction=Frictionless())
    push = fem.Constant(scene.mesh, (0.0, 0.0))
    top = fem.locate_dofs_topological(scene.V, 1, scene.facet_tags.find(ABOVE))
    bcs = [fem.dirichletbc(push, top, scene.V)]
    with ContactProblem(scene.a, scene.L, scene.pairs, bcs, stiffness="cholesky") as problem:

        def force(height):
            push.value[1] = height
            solved(problem)
            return problem.goal_value(NormalForce())

        down = -force(-1e-6) / 1e-6
        assert force(1e-6) == 0.0
        force(0.0)
        with caplog.at_level(logging.INFO):
            derivative = problem.gradient(NormalForce(), [push])[0][1]
        assert min(abs(derivative), abs(derivative - down)) <= ACCURACY * abs(down)
        assert "derivative: 4 node(s) are about to change their state" in logged(caplog)


def test_a_node_at_the_edge_of_stick(comm):
    """Its traction is the slip bound: it slips if it is dragged more, and sticks if less."""
    scene = block(comm, (3, 3), load=(0.0, 0.0, 0.0))
    bound = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)))
    push = fem.Constant(scene.mesh, (1e-3, -1e-3))
    top = fem.locate_dofs_topological(scene.V, 1, scene.facet_tags.find(ABOVE))
    bcs = [fem.dirichletbc(push, top, scene.V)]
    pair = dataclasses.replace(scene.pairs[0], friction=Tresca(bound))
    goal = ContactForce((1.0, 0.0))
    with ContactProblem(scene.a, scene.L, [pair], bcs, stiffness="cholesky") as problem:

        def force(drag):
            push.value[0] = drag
            solved(problem)
            return problem.goal_value(goal)

        bound.x.array[:] = 1e3
        force(1e-3)
        surface = problem.solve(rtol=RTOL).surfaces[0]
        sizes = np.linalg.norm(surface.traction.x.array.reshape(-1, 2), axis=1)
        one = int(np.argmax(sizes))
        place = np.linalg.norm(scene.mesh.geometry.x - surface.points[one], axis=1)
        bound.x.array[np.argmin(place)] = sizes[one]
        middle = force(1e-3)
        more, less = ((force(1e-3 * (1.0 + h)) - middle) / (1e-3 * h) for h in (1e-3, -1e-3))
        force(1e-3)
        derivative = problem.gradient(goal, [push])[0][0]
        assert min(abs(derivative - side) for side in (less, more)) <= ACCURACY * abs(less)
        assert abs(more - less) > 0.01 * abs(less)


def test_wrong_directions(comm):
    """Each error says what a direction must be."""
    model = Rubbing(comm, "triangle")
    with ContactProblem(*model.arguments) as problem:
        with pytest.raises(ContactError, match=r"no solution for a derivative: call solve\(\)"):
            problem.tangent([model.young], [1.0])
        problem.solve()
        for controls, directions, message in (
            ([model.young], [], "one for each control, found 0 for 1"),
            ([model.load], [1.0], r"must have its shape \(2,\), found 1"),
            ([model.profile], [1.0], "must be a Function on its space, found 1"),
            ([model.young], [np.nan], "is NaN or infinite"),
        ):
            with pytest.raises(InputError, match=message):
                problem.tangent(controls, directions)


def test_places_of_obstacles_that_are_refused(comm):
    """While an obstacle moves, in a process after slip, and what is no Constant."""
    scene = block(comm, (3, 3))
    height = fem.Constant(scene.mesh, (0.0, 0.0))
    plane = RigidPlane(height, (0.0, 1.0))
    pair = dataclasses.replace(scene.pairs[0], primary=plane)
    top = fem.locate_dofs_topological(scene.V, 1, scene.facet_tags.find(ABOVE))
    push = fem.Constant(scene.mesh, (1e-2, -1e-3))
    bcs = [fem.dirichletbc(push, top, scene.V)]
    with ContactProblem(scene.a, scene.L, [pair], bcs, stiffness="cholesky") as problem:
        problem.solve()
        height.value[1] = 1e-4
        with pytest.raises(ContactError, match="have changed since the solution"):
            problem.gradient(NormalForce(), [height])
        problem.solve()
        problem.gradient(NormalForce(), [height])
        with problem.record() as tape:
            problem.accept()
        tape.gradient({0: NormalForce()}, [height])
        plane.move_to((1e-3, 0.0))
        problem.solve()
        with pytest.raises(InputError, match=r"for a load step in which move_to\(\) moves it"):
            problem.gradient(NormalForce(), [height])
        with problem.record() as tape:
            problem.accept()
        with pytest.raises(InputError, match="and recording began without slip"):
            tape.gradient({0: NormalForce()}, [height])
    with pytest.raises(InputError, match=r"constants must be a list of fem\.Constant"):
        RigidObstacle(plane.signed_distance, constants=[1.0])
    height.value[1] = np.nan
    with pytest.raises(InputError, match="point must be 2 or 3 finite numbers"):
        RigidPlane(height, (0.0, 1.0))
