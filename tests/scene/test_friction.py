"""Friction laws: texts, terms, and checks of the arguments."""

from __future__ import annotations

import math
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
from dolfinx import fem

from dolfinx_tresca import Coulomb, InputError, Tresca
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction
from scenes.blocks import block
from scenes.nodal import node_function
from scenes.patches import patch


def test_str_and_repr(comm):
    mesh = dolfinx.mesh.create_unit_square(comm, 1, 1)
    c = fem.Constant(mesh, 0.25)
    p = node_function(mesh, lambda x: x[0])
    p.name = "p"
    for law, text in (
        (Coulomb(0.3), "coefficient of friction 0.3"),
        (Coulomb(0), "coefficient of friction 0"),
        (Coulomb(0.3, limit=40), "coefficient of friction 0.3, slip bound at most 40"),
        (
            Coulomb(c, limit=p),
            "coefficient of friction Constant, now 0.25, slip bound at most Function 'p'",
        ),
        (Coulomb(0.3, adhesion=2), "coefficient of friction 0.3, adhesion 2"),
        (
            Coulomb((0.3, 0.1), 40, (1, 0, 0), c),
            "coefficient of friction along (1, 0, 0) and across: 0.3 and 0.1, slip bound at most "
            "40 beside the adhesion Constant, now 0.25",
        ),
        (Coulomb(2 * p), "coefficient of friction 2 * p"),
        (Tresca(0.5), "slip bound 0.5"),
    ):
        assert (repr(law), str(law)) == (f"<{type(law).__name__}: {text}>", text)


@pytest.mark.parametrize("value", [math.nan, "0.3", 1j, [0.3], None, (0.1, 0.2)])
def test_invalid_numbers_are_errors(value):
    with pytest.raises(InputError, match="the coefficient of friction"):
        Coulomb(value)
    with pytest.raises(InputError, match="the adhesion must"):
        Coulomb(0.3, adhesion=value)
    if value is not None:
        with pytest.raises(InputError, match="the limit of the slip bound"):
            Coulomb(0.3, limit=value)


def test_infinite_limits_are_no_limits():
    assert Coulomb(0.3, limit=math.inf).terms.limit == math.inf


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("law", "message"),
    [
        (lambda bad: Coulomb(bad(-1.0)), "the coefficient of friction must not be negative"),
        (lambda bad: Coulomb(bad(np.nan)), "the coefficient of friction must not be NaN"),
        (lambda bad: Coulomb(bad(np.inf)), "the coefficient of friction must be finite"),
        (lambda bad: Coulomb(0.3, bad(-1.0)), "the limit of the slip bound must not be negative"),
        (lambda bad: Coulomb(-math.inf), "the coefficient of friction must not be negative"),
        (lambda bad: Coulomb(math.inf), "the coefficient of friction must be finite"),
        (lambda bad: Coulomb(0.3, -1.0), "the limit of the slip bound must not be negative"),
        (lambda bad: Coulomb(0.3, adhesion=bad(-1.0)), "the adhesion must not be negative"),
        (lambda bad: Coulomb(0.3, adhesion=-1.0), "the adhesion must not be negative"),
        (lambda bad: Coulomb(lambda x: x), "the function for the coefficient of friction must"),
    ],
)
def test_invalid_nodal_value_raises_on_all_ranks(comm, law, message):
    """A single node of each rank has an invalid value."""
    value: dict[str, Any] = {}

    def bad(other: float) -> Any:
        value["bad"] = other
        return lambda x: np.where(np.arange(x.shape[1]) == 0, value["bad"], 0.3)

    model = block(comm, (2, 2), load=(0.1, 0.0, -1.0))
    with pytest.raises(InputError, match=message):
        with model.but(friction=law(bad)).problem() as problem:
            problem.solve()


def test_user_defined_law():
    """A subclass of DryFriction with `terms` is a law, such as Mohr-Coulomb's."""

    class Sticky(DryFriction):
        """Coulomb friction with adhesion: the bound is c + F p."""

        @property
        def terms(self) -> BoundTerms:
            return BoundTerms(constant=0.05, coefficient=0.3)

    model = block(MPI.COMM_SELF, (3, 2), load=(0.34, 0.0, -1.0), friction=Sticky())
    same = model.but(friction=Coulomb(0.3, adhesion=0.05))
    with model.problem() as problem, same.problem() as other:
        one, two = problem.solve(rtol=1e-8), other.solve(rtol=1e-8)
        assert one.tangential_force == two.tangential_force


@pytest.mark.parametrize("scale", [1.0, 1e9])
def test_bounds_that_are_negative_by_rounding_are_zero(comm, scale):
    """As those of a pressure between bodies that do not touch; their measure is the stiffness."""
    scene = patch(comm, "quadrilateral", young=(scale, scale), upper=(2, 1), lower=(3, 1))
    for zero in (Tresca(-1e-18 * scale), Coulomb(-1e-18, limit=-1e-18 * scale)):
        with scene.but(friction=zero).problem() as problem:
            assert problem.solve().tangential_force == 0.0
    beside_others = Tresca(lambda x: scale * np.where(x[0] < 0.1, -5e-7, 1e6))
    with scene.but(friction=beside_others).problem() as problem:
        problem.solve().raise_if_failed()
    bound = fem.Constant(scene.mesh, -1e-18 * scale)
    with scene.but(friction=Tresca(bound)).problem() as problem:
        assert problem.solve().counts.slip + problem.solve().counts.idle > 0
        bound.value = -1e-6 * scale
        with pytest.raises(InputError, match="must not be negative"):
            problem.solve()
