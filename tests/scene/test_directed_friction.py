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

X = (1.0, 0.0, 0.0)
LAWS = pytest.mark.parametrize(
    ("law", "name"), [(Tresca, "the slip bound"), (Coulomb, "the coefficient of friction")]
)


@LAWS
def test_two_values_need_a_direction_and_a_direction_needs_two_values(law, name):
    with pytest.raises(InputError, match=f"two values of {name} need a direction"):
        law((0.1, 0.2))
    with pytest.raises(InputError, match=f"a direction needs two values of {name}.*found one: 0.1"):
        law(0.1, direction=X)
    with pytest.raises(InputError, match=f"{name} must be one value, or two.*found 3"):
        law((0.1, 0.2, 0.3), direction=X)


@LAWS
@pytest.mark.parametrize(("value", "text"), [(-math.inf, "-inf"), (math.nan, "nan")])
def test_error_names_the_wrong_one_of_two_values(law, name, value, text):
    for pair, side in (((value, 1.0), "along"), ((1.0, value), "across")):
        with pytest.raises(InputError, match=f"{name} {side} the direction must not .*{text}"):
            law(pair, direction=X)


def test_infinite_coefficient_in_one_direction_is_an_error():
    with pytest.raises(InputError, match="coefficient of friction must be finite"):
        Coulomb((0.3, math.inf), direction=X)


@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ((0.0, 0.0, 0.0), "finite and not zero"),
        ((1.0, math.nan, 0.0), "finite and not zero"),
        ((1.0, math.inf, 0.0), "finite and not zero"),
        ((1.0, 0.0), r"three components, found shape \(2,\)"),
        (1.0, r"three components, found shape \(\)"),
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
