"""Conversion of arguments to numbers, and the errors for other values."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import (
    ContactPair,
    Coulomb,
    Frictionless,
    InputError,
    MeanPressure,
    NewtonOptions,
    NormalForce,
    RigidPlane,
    RigidSphere,
    SolverOptions,
    Tresca,
    refine,
)
from dolfinx_tresca._base.arguments import checked_integer
from dolfinx_tresca._base.arrays import integer, real
from dolfinx_tresca.stiffness.choice import SolverRequest
from scenes.blocks import block

REALS = [1, 1.0, Fraction(1), np.array(1.0), np.array(1)]
REALS += [kind(1) for kind in (np.float16, np.float32, np.float64, np.longdouble)]
INTEGERS = [kind(1) for kind in (np.int8, np.uint8, np.int32, np.int64, np.uint64)]


def test_real_and_integer():
    for value in REALS + INTEGERS:
        assert (type(real(value)), real(value)) == (float, 1.0)
    for value in [1, np.array(1), *INTEGERS]:
        assert (type(integer(value)), integer(value)) == (int, 1)
    for value in (True, np.True_, np.array(True), "1", None, 1j, Decimal(1), [1], np.ones(1), int):
        assert real(value) is None and integer(value) is None
    assert integer(1.0) is None and integer(Fraction(1)) is None


def _square():
    return block(MPI.COMM_SELF, (1, 1)).tagged_mesh


def _pair(**arguments):
    given = {"secondary": 1, "primary": 2, "friction": Frictionless(), **arguments}
    return ContactPair(_square().facet_tags, **given)


#: Name -> a call with a public argument that is a real number in (0, 1).
ARGUMENTS = {
    **{
        name: lambda value, name=name: SolverOptions(**{name: value})
        for name in ("rtol", "accuracy", "local_accuracy", "mesh_part", "rho_sigma", "r_tol")
    },
    "newton": lambda value: NewtonOptions(accuracy=value),
    "fraction": lambda value: refine(_square(), np.ones(2), fraction=value),
    "bound": Tresca,
    "coefficient": Coulomb,
    "search distance": lambda value: _pair(search_distance=value),
    "radius": lambda value: RigidSphere((0, 0, 0), value),
    "patch": lambda value: MeanPressure((0, 0, 0), value),
}

#: Name -> a call with a public argument that is an integer.
WHOLE = {
    "iterations": lambda value: SolverOptions(max_iterations=value),
    "steps": lambda value: NewtonOptions(max_iterations=value),
    "halvings": lambda value: NewtonOptions(max_halvings=value),
    "levels": lambda value: checked_integer("max_levels", value),
    "pair": NormalForce,
    "tag": lambda value: _pair(secondary=value, primary=RigidPlane((0, 0), (0, 1))),
    "solves": lambda value: SolverRequest(expected_solves=value),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_real_arguments(name):
    for value in (Fraction(1, 2), np.float16(0.5), np.longdouble(0.5), np.array(0.5)):
        ARGUMENTS[name](value)
    for value in (True, np.True_, np.array(False), "0.5"):
        with pytest.raises(InputError, match="found"):
            ARGUMENTS[name](value)


@pytest.mark.parametrize("name", WHOLE)
def test_integer_arguments(name):
    for value in (1, np.uint8(1), np.array(1)):
        WHOLE[name](value)
    for value in (True, np.True_, 1.5, "1"):
        with pytest.raises(InputError, match="found"):
            WHOLE[name](value)


def test_options_store_python_numbers():
    """Numpy numbers of lower precision would reduce the precision of later results."""
    options = SolverOptions(rtol=np.float32(1e-6), max_iterations=np.int8(100))
    assert (type(options.rtol), type(options.max_iterations)) == (float, int)
    assert type(MeanPressure((0, 0), Fraction(1, 2)).radius) is float
    assert type(NewtonOptions(np.float16(0.01)).accuracy) is float
    assert SolverOptions().accuracy == "balanced" and SolverOptions().rho_sigma is None
