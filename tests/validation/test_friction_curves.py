"""Coefficients of friction that depend on pressure and slip, against analysis."""

from __future__ import annotations

import dataclasses
import logging
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactForce, Coulomb, InputError
from scenes.blocks import ABOVE, LEFT, RIGHT, block
from scenes.elasticity import fixed
from scenes.nodal import surface_nodes_of
from scenes.scene import Scene

#: Young's modulus [MPa] of a square of 1 mm without lateral contraction, compression of its height,
#: pressure [MPa], and shift of its top [mm].
YOUNG, DEPTH, SHIFT = 1000.0, 0.01, 0.02
SHEAR, PRESSURE = 0.5 * YOUNG, YOUNG * DEPTH

#: Accuracy of the requested residual, after the factor of a few cells.
EXACT = 1e-7

LAWS: dict[str, Coulomb] = {
    "pressure": Coulomb(lambda p, v: 0.5 / (1 + p / PRESSURE)),
    "more pressure": Coulomb(lambda p, v: 0.1 + 0.1 * p / PRESSURE),
    "a power of the pressure": Coulomb(lambda p, v: 0.3 * (p / PRESSURE) ** (-1 / 3)),
    "Stribeck": Coulomb(lambda p, v: 0.1 + 0.2 * np.exp(-v / 0.01) + 5 * v),
    "weakening": Coulomb(lambda p, v: 0.2 + 0.2 * np.exp(-v / 0.008)),
    "viscous": Coulomb(lambda p, v: 30 * v),
    "steep": Coulomb(lambda p, v: 3e4 * v),
    "adhesion": Coulomb(lambda p, v: 0.2 + 5 * v, adhesion=0.1 * PRESSURE),
    "limit": Coulomb(lambda p, v: 0.2 + 0.1 * v / SHIFT, limit=0.22 * PRESSURE),
}


def bound(law: Coulomb, slip: float, pressure: float = PRESSURE) -> float:
    """Return the slip bound of a law [MPa]."""
    curve = law.terms.curve
    assert curve is not None
    of_pressure = float(curve.values(np.array([pressure]), np.array([slip]))[0]) * pressure
    limit = np.inf if law.limit is None else law.limit
    return law.adhesion + min(of_pressure, limit)


def slip_of(law: Coulomb, shift: float) -> float:
    """Return the slip v with the shear stress G (shift - v), which is the bound at v."""
    return brentq(lambda v: SHEAR * (shift - v) - bound(law, v), 0.0, shift, xtol=1e-16)


def square(comm: MPI.Comm, law: Coulomb) -> Scene:
    """A square on a rigid plane whose top is moved, in a state of uniform stress."""
    scene = block(comm, (4, 3), young=YOUNG, poisson=0.0, friction=law)
    top, shear = fem.Constant(scene.mesh, (SHIFT, -DEPTH)), fem.Constant(scene.mesh, 0.0)
    ds = ufl.Measure("ds", scene.mesh, subdomain_data=scene.facet_tags)
    moved = shear * ufl.TestFunction(scene.V)[1]
    L = moved * ds(RIGHT) - moved * ds(LEFT)
    bcs = [fixed(scene.V, scene.facet_tags.find(ABOVE), top)]
    data = SimpleNamespace(top=top, shear=shear)
    return dataclasses.replace(scene, L=L, bcs=bcs, data=data)


def check(solution: Any, shear: float, slip: float, accuracy: float = EXACT) -> None:
    """Check uniform pressure, traction and slip at the contact nodes."""
    solution.raise_if_failed()
    _, fields = surface_nodes_of(solution)
    assert np.abs(fields["pressure"] - PRESSURE).max(initial=0.0) <= accuracy * PRESSURE
    traction = np.linalg.norm(fields["traction"], axis=1)
    assert np.abs(traction - shear).max(initial=0.0) <= accuracy * PRESSURE
    slips = np.linalg.norm(fields["slip"], axis=1)
    assert np.abs(slips - slip).max(initial=0.0) <= accuracy * SHIFT


@pytest.mark.parallel(law=["Stribeck"])
@pytest.mark.parametrize("law", LAWS)
def test_uniform_sliding(comm, law):
    """The slip and the traction solve one scalar equation; the load on the sides belongs to it."""
    scene = square(comm, LAWS[law])
    slip = slip_of(LAWS[law], SHIFT)
    shear = SHEAR * (SHIFT - slip)
    scene.data.shear.value = shear
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
    check(solution, shear, slip)
    assert solution.bound_error <= EXACT
    assert solution.counts.slip == solution.counts.nodes


def test_sticking_is_without_slip():
    """At rest the coefficient is that of no slip, even if it falls steeply with the slip."""
    scene = square(MPI.COMM_SELF, Coulomb(lambda p, v: 0.5 * np.exp(-v / 1e-5)))
    scene.data.top.value[0] = 0.49 * PRESSURE / SHEAR
    scene.data.shear.value = 0.49 * PRESSURE
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
    check(solution, 0.49 * PRESSURE, 0.0)
    assert solution.counts.stick == solution.counts.nodes


def test_the_slip_is_that_of_the_step():
    """In a second step to the same shift a viscous contact creeps on."""
    law = LAWS["viscous"]
    scene, before = square(MPI.COMM_SELF, law), 0.0
    with scene.problem() as problem:
        for _ in range(2):
            slip = slip_of(law, SHIFT - before)
            shear = SHEAR * (SHIFT - before - slip)
            scene.data.shear.value = shear
            solution = problem.solve(rtol=1e-10)
            problem.accept()
            before += slip
            check(solution, shear, before)


def test_derivatives_are_refused_where_friction_depends_on_the_slip():
    """Derivatives by data need a bound that does not depend on the slip."""
    with square(MPI.COMM_SELF, LAWS["viscous"]).problem() as problem:
        problem.solve()
        with pytest.raises(InputError, match="depends on the slip"):
            problem.gradient(ContactForce((1.0, 0.0)), [])


#: A coefficient that falls by less than a tenth if the pressure doubles; the mean pressure is 1.
FALLING = Coulomb(lambda p, v: 0.33 / (1 + 0.1 * p))


def pulled_block(comm: MPI.Comm, law: Coulomb, part: float) -> Any:
    """Return the problem of a block that contact alone holds, pulled by a part of its weight."""
    model = block(comm, (3, 2), size=(2.0, 1.0), friction=law)
    model.data.load.value[:] = part, -1.0
    return model.problem()


@pytest.mark.parallel
def test_floating_blocks(comm):
    """Friction that depends on the pressure bears a load; slip-dependent friction is refused."""
    with pulled_block(comm, FALLING, 0.25) as problem:
        solution = problem.solve(rtol=1e-8)
        solution.raise_if_failed()
    assert solution.tangential_force == pytest.approx(0.5, rel=1e-6)
    with pulled_block(comm, Coulomb(lambda p, v: 0.1 + v), 0.05) as problem:
        with pytest.raises(InputError, match="depends on the slip"):
            problem.solve(rtol=1e-8)


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        (lambda p, v: -1.0 + 0 * p, "not negative, found -1"),
        (lambda p, v: np.where(v > 0.0, np.nan, 0.1), "not negative, found nan"),
        (lambda p, v: np.zeros(7), r"a number or an array of shape \(5,\)"),
        (lambda p, v: 1j + p, "must be real"),
    ],
)
def test_wrong_curves(curve, message):
    with (
        pytest.raises(InputError, match=message),
        square(MPI.COMM_SELF, Coulomb(curve)).problem() as problem,
    ):
        problem.solve()


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (lambda p, v: 0.2 / (0.5 + (p / PRESSURE) ** 2), "decreases with the pressure"),
        (lambda p, v: 0.1 + 0.2 * np.exp(-v / 1e-3), "decreases with the slip"),
        (lambda p, v: 0.3 / (1 + p / PRESSURE) / (1 + v), None),
    ],
)
def test_bounds_that_decrease_are_warned_of(curve, words, caplog):
    """The log says where bounds decrease with the pressure or the slip."""
    scene = square(MPI.COMM_SELF, Coulomb(curve))
    scene.data.shear.value = 0.1 * PRESSURE
    with caplog.at_level(logging.WARNING), scene.problem() as problem:
        for shift in (0.35, 0.29):
            scene.data.top.value[0] = shift * PRESSURE / SHEAR
            problem.solve()
    text = " ".join(caplog.text.split())
    assert (words is None and "decreases" not in text) or (words or "") in text
