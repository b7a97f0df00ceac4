"""Slip bounds of every kind: their values at nodes, changes in place, rounding."""

from __future__ import annotations

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb, InputError, Tresca
from dolfinx_tresca._base import compat
from dolfinx_tresca.dual.nodal_values import NodalValues, inputs_of
from dolfinx_tresca.dual.slip_bounds import BOUND_ROUNDING, SlipBounds
from dolfinx_tresca.scene import user_fields
from scenes.nodal import node_function
from scenes.patches import patch
from scenes.scene import EPS


def space(comm, degree: int = 1):
    mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2)
    return fem.functionspace(mesh, ("Lagrange", degree, (3,)))


def owned_nodes(V) -> np.ndarray:
    return np.arange(V.dofmap.index_map.size_local, dtype=np.int32)


def linear(x: np.ndarray) -> np.ndarray:
    return 0.1 + x[0] + 2.0 * x[2]


def bounds_of(V) -> dict[str, tuple[object, object]]:
    """Name -> a bound, and its values as a function of points (3, n) -> (n,)."""
    mesh = V.mesh
    x = ufl.SpatialCoordinate(mesh)
    c, p = fem.Constant(mesh, 0.3), node_function(mesh, linear)
    quadratic = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    quadratic.interpolate(lambda x: x[1] ** 2)
    vector = fem.Function(V)
    vector.interpolate(lambda x: np.vstack([x[0], linear(x), 0.0 * x[0]]))
    points = compat.interpolation_points(quadratic.function_space.element)

    def constant(value: float):
        return lambda x: np.full(x.shape[1], value)

    return {
        "number": (0.2, constant(0.2)),
        "Constant": (c, constant(0.3)),
        "Function": (p, linear),
        "quadratic Function": (quadratic, lambda x: x[1] ** 2),
        "component": (vector.sub(1), linear),
        "numbers in UFL": (ufl.as_ufl(0.2), constant(0.2)),
        "of a Function": (c * p, lambda x: 0.3 * linear(x)),
        "of a component": (2.0 * vector[1], lambda x: 2.0 * linear(x)),
        "conditional": (
            ufl.conditional(ufl.gt(x[0], 0.7), 0.1, p),
            lambda x: np.where(x[0] > 0.7, 0.1, linear(x)),
        ),
        "Expression": (
            fem.Expression(c * quadratic + x[0], points),
            lambda x: 0.3 * x[1] ** 2 + x[0],
        ),
        "function": (linear, linear),
        "function, one number": (lambda x: 0.1, constant(0.1)),
        "function, one row": (lambda x: linear(x)[None, :], linear),
        "function, a list": (lambda x: list(linear(x)), linear),
        "function, integers": (lambda x: np.ones(x.shape[1], dtype=int), constant(1.0)),
    }


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_values_at_nodes(comm, degree):
    V = space(comm, degree)
    every_third = owned_nodes(V)[::3]
    points = V.tabulate_dof_coordinates()[every_third].T
    for name, (bound, expected) in bounds_of(V).items():
        values = SlipBounds(V).nodal_bounds(Tresca(bound), every_third).constant
        assert values.shape == every_third.shape and values.dtype == np.float64, name
        assert np.abs(values - expected(points)).max(initial=0.0) <= 10 * EPS, name


@pytest.mark.parallel
def test_an_expression_is_compiled_once_and_read_anew(comm, monkeypatch):
    V = space(comm)
    nodes, p, c = owned_nodes(V), node_function(V.mesh, linear), fem.Constant(V.mesh, 1.0)
    compiled = []

    class Counted(fem.Expression):
        def __init__(self, *arguments):
            compiled.append(arguments)
            super().__init__(*arguments)

    monkeypatch.setattr(user_fields.fem, "Expression", Counted)
    values = NodalValues(V)
    points = V.tabulate_dof_coordinates()[nodes].T
    for factor in (1.0, 2.0):
        for scale in (1.0, 3.0):
            p.interpolate(lambda x, factor=factor: factor * linear(x))
            c.value = scale
            found = values.scalars_at(c * p, nodes, "the bound")
            expected = scale * factor * linear(points)
            assert np.abs(found - expected).max(initial=0.0) <= 100 * EPS
    assert len(compiled) == 1


@pytest.mark.parallel
def test_derivatives_of_an_expression_are_those_of_its_ufl(comm):
    """With a Constant and with a Function, of `fem.Expression` as of what it was made of."""
    V = space(comm)
    nodes, p, c = owned_nodes(V), node_function(V.mesh, linear), fem.Constant(V.mesh, 2.0)
    bound = fem.Expression(c * p**2, compat.interpolation_points(p.function_space.element))
    assert set(inputs_of(bound)) == {c, p}
    values, x = NodalValues(V), V.tabulate_dof_coordinates()[nodes].T
    of_c = values.pushed_forward(bound, c, 3.0, nodes, "the bound")
    of_p = values.pushed_forward(bound, p, p, nodes, "the bound")
    assert np.abs(of_c - 3.0 * linear(x) ** 2).max(initial=0.0) <= 100 * EPS
    assert np.abs(of_p - 4.0 * linear(x) ** 2).max(initial=0.0) <= 100 * EPS


@pytest.mark.parallel
def test_a_function_of_points_sees_contact_nodes_only(comm):
    V = space(comm)
    nodes = owned_nodes(V)[:2]
    seen = []

    def bound(x):
        seen.append(x.copy())
        x[:] = np.nan  # its own copy
        return 0.1

    values = NodalValues(V)
    for _ in range(2):
        assert (values.scalars_at(bound, nodes, "the bound") == 0.1).all()
    assert all((x == V.tabulate_dof_coordinates()[nodes].T).all() for x in seen)
    assert len(seen) == (2 if len(nodes) else 0)


def one_value(comm, value: float, others: float):
    """Bounds with another value at one node of the first rank."""

    def values(x):
        result = np.full(x.shape[1], others)
        if comm.rank == 0:
            result[0] = value
        return result

    return Tresca(values)


@pytest.mark.parametrize("value", [-1e-18, -0.9 * BOUND_ROUNDING * 0.1])
def test_rounding_below_zero_is_zero(comm, value):
    V = space(comm)
    found = SlipBounds(V).nodal_bounds(one_value(comm, value, 0.1), owned_nodes(V)).constant
    assert (found[1:] == 0.1).all()
    assert comm.rank > 0 or found[0] == 0.0


@pytest.mark.parametrize("scale", [1.0, 1e9])
def test_rounding_below_zero_everywhere_is_zero(comm, scale):
    """As that of a pressure between bodies that do not touch; its measure is the stiffness."""
    scene = patch(comm, "quadrilateral", young=(scale, scale), upper=(2, 1), lower=(3, 1))
    for zero in (Tresca(-1e-18 * scale), Coulomb(-1e-18, limit=-1e-18 * scale)):
        with scene.but(friction=zero).problem() as problem:
            assert problem.solve().tangential_force == 0.0
    bound = fem.Constant(scene.mesh, -1e-18 * scale)
    with scene.but(friction=Tresca(bound)).problem() as problem:
        assert problem.solve().counts.slip + problem.solve().counts.idle > 0
        bound.value = -1e-6 * scale
        with pytest.raises(InputError, match="must not be negative"):
            problem.solve()


@pytest.mark.parametrize(
    ("value", "others"),
    [
        (-2.0 * BOUND_ROUNDING * 0.1, 0.1),
        (-1e-18, 0.0),  # beside nothing it is no rounding
        (-1.0, np.inf),  # infinite bounds are no measure
        (-np.inf, 0.1),
        (np.nan, 0.1),
    ],
)
def test_what_is_below_zero_is_refused(comm, value, others):
    V = space(comm)
    with pytest.raises(InputError, match=f"must not be (negative|NaN), found {value:g} at 1 of"):
        SlipBounds(V).nodal_bounds(one_value(comm, value, others), owned_nodes(V))


def test_numbers_are_judged_once(comm):
    """Those that nobody can change, by what is rounding; constants only where they are used."""
    V, x = space(comm), (1.0, 0.0, 0.0)
    bounds, nodes = SlipBounds(V), owned_nodes(V)
    for law in (Tresca((-0.5, 1.0), direction=x), Coulomb(10.0, limit=-0.5)):
        with pytest.raises(InputError, match=r"bound.* must not be negative, found -0.5 at"):
            bounds.check_numbers(law, nodes, 0.4)
        bounds.check_numbers(law, nodes, 0.6)
    bounds.check_numbers(Tresca(fem.Constant(V.mesh, -0.5)), nodes, 0.0)


def test_infinite_bounds_are_kept(comm):
    V = space(comm)
    found = SlipBounds(V).nodal_bounds(one_value(comm, np.inf, 0.1), owned_nodes(V)).constant
    assert (found[1:] == 0.1).all()
    assert comm.rank > 0 or found[0] == np.inf


def test_bounds_say_what_they_are(comm):
    mesh = space(comm).mesh
    p = node_function(mesh, linear)
    p.name = "p"
    c = fem.Constant(mesh, 0.25)
    for bound, text in (
        (0.5, "0.5"), (c, "Constant, now 0.25"), (p, "Function 'p'"), (2 * p, "2 * p"),
        (linear, "a function of points"),
    ):  # fmt: skip
        assert str(Tresca(bound)) == f"slip bound {text}"


def towards(x: np.ndarray) -> np.ndarray:
    return np.stack([1.0 + x[1], x[0] - 2.0 * x[2], 0.0 * x[0]])


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_directions_at_nodes(comm, degree):
    V = space(comm, degree)
    every_third = owned_nodes(V)[::3]
    points = V.tabulate_dof_coordinates()[every_third].T
    field, x = fem.Function(V), ufl.SpatialCoordinate(V.mesh)
    field.interpolate(towards)
    in_ufl = ufl.as_vector([1.0 + x[1], x[0] - 2.0 * x[2], 0.0])
    element_points = compat.interpolation_points(V.element)
    constant = np.tile([[1.0], [2.0], [0.5]], (1, len(every_third)))
    for name, direction, expected in (
        ("numbers", (1, 2.0, 0.5), constant),
        ("array", np.array([1.0, 2.0, 0.5]), constant),
        ("Constant", fem.Constant(V.mesh, (1.0, 2.0, 0.5)), constant),
        ("Function", field, towards(points)),
        ("UFL", in_ufl, towards(points)),
        ("of a Function", -2.0 * field, -2.0 * towards(points)),
        ("Expression", fem.Expression(in_ufl, element_points), towards(points)),
        ("function", towards, towards(points)),
        ("function, one vector", lambda x: [1.0, 2.0, 0.5], constant),
    ):
        law = Tresca((0.2, 0.1), direction=direction)
        SlipBounds(V).check(law, every_third)
        ellipses = SlipBounds(V).nodal_bounds(law, every_third).ellipses
        assert ellipses.direction.shape == (len(every_third), 3), name
        assert np.abs(ellipses.direction.T - expected).max(initial=0.0) <= 10 * EPS, name


@pytest.mark.parallel
def test_two_bounds_are_the_longer_semi_axis_and_a_shape(comm):
    V = space(comm)
    nodes = owned_nodes(V)
    for law, name in (
        (lambda pair: Tresca(pair, direction=(1, 0, 0)), "constant"),
        (lambda pair: Coulomb(pair, limit=3.0, direction=(1, 0, 0)), "coefficient"),
    ):
        for pair, longer, shape in (
            ((0.2, 0.1), 0.2, (1.0, 0.5)),
            ((0.0, 0.1), 0.1, (0.0, 1.0)),
            ((0.0, 0.0), 0.0, (1.0, 1.0)),
        ):
            found = SlipBounds(V).nodal_bounds(law(pair), nodes)
            assert (getattr(found, name) == longer).all()
            assert (found.ellipses.shape == shape).all()
            others = {"constant", "coefficient", "limit"} - {name}
            same = SlipBounds(V).nodal_bounds(law((longer, longer)), nodes)
            assert all((getattr(found, one) == getattr(same, one)).all() for one in others)
    found = SlipBounds(V).nodal_bounds(Tresca((np.inf, np.inf), direction=(1, 0, 0)), nodes)
    assert np.isinf(found.constant).all() and (found.ellipses.shape == 1.0).all()


@pytest.mark.parallel
def test_what_is_wrong_with_two_bounds_or_their_direction(comm):
    V = space(comm)
    nodes, x = owned_nodes(V), (1.0, 0.0, 0.0)
    elsewhere = fem.Function(space(comm))

    def infinite_at_one(x):
        return np.where(np.arange(x.shape[1]) > 0, 0.1, np.inf)

    for law, text in (
        (Tresca((np.inf, 0.1), direction=x), "slip bound must be finite in both directions"),
        (Tresca((0.1, lambda x: -0.1), direction=x), "slip bound across the direction must not be"),
        (Coulomb((infinite_at_one, 0.1), direction=x), "friction along the .* must be finite"),
        (
            Tresca((0.1, 0.2), direction=elsewhere),
            "direction of the slip bound is a Function on an",
        ),
        (Tresca((0.1, 0.2), direction=2 * elsewhere), "direction .* is an expression on another"),
        (Tresca((0.1, 0.2), direction=lambda x: x[0]), "must return a vector, or one for each"),
        (Tresca((0.1, 0.2), direction=lambda x: x.T), "must return a vector, or one for each"),
        (Tresca((0.1, 0.2), direction=lambda x: 1j * x), "must return a vector, or one for each"),
    ):
        with pytest.raises(InputError, match=text):
            SlipBounds(V).nodal_bounds(law, nodes)


def test_there_is_no_direction_in_2d(comm):
    mesh = dolfinx.mesh.create_unit_square(comm, 2, 2)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    with pytest.raises(InputError, match="in 2D the surfaces slide along one direction only"):
        SlipBounds(V).check(Tresca((0.1, 0.2), direction=(1, 0, 0)), owned_nodes(V))
