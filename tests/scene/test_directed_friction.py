"""Friction laws with a direction: checks of the arguments, and their texts."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb, InputError, Tresca
from scenes.blocks import block

X = (1.0, 0.0, 0.0)
LAWS = pytest.mark.parametrize(
    ("law", "name"), [(Tresca, "the slip bound"), (Coulomb, "the coefficient of friction")]
)


@LAWS
def test_two_values_need_a_direction_and_a_direction_needs_two_values(law, name):
    with pytest.raises(InputError, match=f"{name} must be .* found 2 and no direction"):
        law((0.1, 0.2))
    with pytest.raises(InputError, match=f"{name} must be .* found 1 and a direction"):
        law(0.1, direction=X)
    with pytest.raises(InputError, match=f"{name} must be one value, or two.*found 3"):
        law((0.1, 0.2, 0.3), direction=X)


@LAWS
@pytest.mark.parametrize(("value", "text"), [(-math.inf, "-inf"), (math.nan, "nan")])
def test_error_names_the_wrong_one_of_two_values(law, name, value, text):
    scene = block(MPI.COMM_SELF, (2, 2, 2))
    for pair, side in (((value, 1.0), "along"), ((1.0, value), "across")):
        with pytest.raises(InputError, match=f"{name} {side} the direction must .*{text}"):
            scene.but(friction=law(pair, direction=X)).problem()


@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ((1.0, math.nan, 0.0), "three numbers"),
        ((1.0, 0.0), r"three numbers, .*found \(1\.0, 0\.0\)"),
        (1.0, r"three numbers, .*found 1\.0"),
        ("x", "three numbers, .*found 'x'"),
        ((1j, 0, 0), "three numbers"),
    ],
)
def test_invalid_direction_vector_is_an_error(direction, text):
    with pytest.raises(InputError, match=f"the direction of the slip bound must be .*{text}"):
        Tresca((0.1, 0.2), direction=direction)


def test_invalid_direction_field_is_an_error():
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    jumps = fem.Function(fem.functionspace(mesh, ("DG", 0, (3,))))
    scalar = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
    for direction, text in (
        (jumps, "no value at nodes"),
        (ufl.FacetNormal(mesh), "no value at nodes"),
        (scalar, r"found shape \(\)"),
        (ufl.grad(ufl.SpatialCoordinate(mesh)), r"found shape \(3, 3\)"),
        (fem.Constant(mesh, np.zeros(2)), r"found shape \(2,\)"),
    ):
        with pytest.raises(InputError, match=f"the direction of the slip bound.*{text}"):
            Tresca((0.1, 0.2), direction=direction)


def test_str_and_repr_of_laws_with_a_direction():
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    field = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (3,))), name="grooves")
    constant = fem.Constant(mesh, (1.0, 2.0, 0.0))
    for direction, text in (
        ((1, 0, 0), "(1, 0, 0)"),
        (np.array([0.5, 0.0, 0.0]), "(0.5, 0, 0)"),
        (constant, "Constant, now (1, 2, 0)"),
        (field, "Function 'grooves'"),
        (2 * field, "an expression"),
        (lambda x: x, "a function of points"),
    ):
        law = Tresca((0.2, 0.1), direction=direction)
        assert str(law) == f"slip bound along {text} and across: 0.2 and 0.1"
        assert repr(law) == f"<Tresca: {law}>"


@pytest.mark.parallel
def test_what_is_wrong_with_values_at_nodes(comm):
    scene = block(comm, (2, 2, 2))
    elsewhere = fem.Function(block(comm, (2, 2, 2)).V)

    def infinite_at_one(x):
        return np.where(np.arange(x.shape[1]) > 0, 0.1, np.inf)

    for law, text in (
        (Tresca((np.inf, 0.1), direction=X), "slip bound must be finite in both directions"),
        (Tresca((0.1, lambda x: -0.1), direction=X), "slip bound across the direction must not be"),
        (Coulomb((0.3, np.inf), direction=X), "friction across the .* must be finite"),
        (Tresca((0.1, 0.2), direction=(0.0, 0.0, 0.0)), "direction of the slip bound is zero"),
        (Tresca((0.1, 0.2), direction=(1.0, np.inf, 0.0)), "the slip bound is not finite"),
        (Coulomb((infinite_at_one, 0.1), direction=X), "friction along the .* must be finite"),
        (Tresca((0.1, 0.2), direction=elsewhere), "direction of the slip bound is a Function on"),
        (Tresca((0.1, 0.2), direction=2 * elsewhere), "direction .* is an expression on another"),
        (Tresca((0.1, 0.2), direction=lambda x: x[0]), "must return a vector, or one for each"),
        (Tresca((0.1, 0.2), direction=lambda x: x.T), "must return a vector, or one for each"),
        (Tresca((0.1, 0.2), direction=lambda x: 1j * x), "must return a vector, or one for each"),
    ):
        with pytest.raises(InputError, match=text), scene.but(friction=law).problem() as problem:
            problem.solve()
    with pytest.raises(InputError, match="in 2D the surfaces slide along one direction only"):
        block(comm, (2, 2), friction=Tresca((0.1, 0.2), direction=X)).problem()
