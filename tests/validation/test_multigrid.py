"""Multigrid where it is hard for it: nearly incompressible bodies, contrasts, what just touches."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from test_energy_bound import relative_error

from dolfinx_tresca import (
    ContactSolution,
    ContactStatus,
    Coulomb,
    Frictionless,
    StiffnessError,
    Tresca,
)
from scenes.blocks import BELOW, LEFT, YOUNG, block, floor, rubbing_blocks
from scenes.scene import EPS, Scene
from scenes.two_bricks import two_bricks

#: Residual of a reference, and the relative error in the energy norm that it may leave.
TIGHT, REFERENCE = 1e-10, 1e-6


def plate(comm: MPI.Comm, size: tuple[float, ...] = (1.0, 1.0, 1.0), **arguments: Any) -> Scene:
    """A plate that is clamped at one side, pressed on the floor and dragged."""
    given = {"n": (6, 6, 3), "friction": Frictionless(), "load": (0.3, 0.0, -1.0), **arguments}
    return block(comm, size=size, held=(LEFT,), boxes=True, **given)


def reference(model: Scene) -> ContactSolution:
    with model.problem(stiffness="cholesky") as problem:
        solution = problem.solve(rtol=TIGHT)
    assert solution.status is ContactStatus.CONVERGED
    return solution


def contrast(ratio: float):
    """Young's modulus at points (3, n): the upper half is so many times as stiff."""
    return lambda x: np.where(x[2] < 0.5, 1e3, 1e3 * ratio)


@pytest.mark.parametrize(
    ("size", "arguments"),
    [
        ((1.0, 1.0, 1.0), {"young": contrast(1e3), "friction": Tresca(0.1)}),
        ((3.0, 3.0, 1.0), {"poisson": 0.49}),
        ((1.0, 1.0, 1.0), {"poisson": 0.499}),
    ],
    ids=["contrast 1e3", "poisson 0.49", "poisson 0.499"],
)
def test_poor_preconditioners(comm, size, arguments):
    """The bound holds for what is returned, and not only for the iterate that was judged."""
    model = plate(comm, size, **arguments)
    exact = reference(model)
    with model.problem(stiffness="multigrid") as problem:
        for asked in ({"accuracy": 1e-2}, {"accuracy": 1e-3}, {}):
            problem.forget()
            solution = problem.solve(**asked)
            assert solution.status is ContactStatus.CONVERGED
            error = relative_error(model.a, solution.u, exact.u)
            assert error <= solution.energy_error_bound + REFERENCE


@pytest.mark.parametrize("ratio", [1e6, 1e9, 1e12])
def test_layers_of_any_contrast(comm, ratio):
    """Where rounding spoils the hierarchy no wrong answer is called CONVERGED."""
    model = plate(comm, n=(6, 6, 4), young=lambda x: np.where(x[2] % 0.5 < 0.25, 1.0, ratio))
    exact = reference(model)
    try:
        with model.problem(stiffness="multigrid") as problem:
            solution = problem.solve()
    except StiffnessError as error:
        assert ratio == 1e12
        assert "rounding" in str(error)
        return
    error = relative_error(model.a, solution.u, exact.u)
    converged = solution.status is ContactStatus.CONVERGED
    assert converged or ratio == 1e12
    assert not converged or error <= solution.energy_error_bound + REFERENCE


def test_the_dual_energy_is_a_lower_bound(comm):
    """The bound holds with rough solves of K; the primal energy is none, as bodies penetrate."""
    scene = two_bricks(comm, 6)
    exact = reference(scene)
    # of the reference: the square of its error, and rounding
    hidden = REFERENCE**2 * abs(exact.primal_energy) + 1e3 * EPS * abs(exact.primal_energy)
    with scene.problem(stiffness="multigrid") as problem:
        for accuracy in (0.3, 1e-1, 1e-2, 1e-4):
            problem.forget()
            solution = problem.solve(accuracy=accuracy)
            assert solution.dual_energy <= exact.primal_energy + hidden


@pytest.mark.parallel
@pytest.mark.parametrize("gap", [1e-6, 1e-9, 1e-12, 1e-15])
@pytest.mark.parametrize(
    "friction", [Frictionless(), Coulomb(10.0, limit=1.0), Coulomb(0.3)], ids=str
)
def test_what_just_does_not_touch(comm, friction, gap):
    """A bar is pulled along the floor and keeps its distance: what an error of b closes is open.

    Gaps are so many times its displacement; the least is less than rounding of that.
    """
    model = block(
        comm,
        (3, 2, 2),
        held=(LEFT,),
        load=(0.0, 0.0, 0.0),
        pull=YOUNG,
        poisson=0.0,
        friction=friction,
        obstacles=[(BELOW, floor(3, -gap))],
    )
    with model.problem(stiffness="multigrid", petsc_options={"pc_type": "jacobi"}) as problem:
        for asked in ({}, {"accuracy": 1e-4}, {"rtol": 1e-3}, {"rtol": 1e-6}, {"rtol": 1e-10}):
            problem.forget()
            solution = problem.solve(**asked)
            assert solution.status is ContactStatus.CONVERGED
            assert not solution.multipliers.any()


def test_rough_products_do_not_hide_a_fixed_point():
    """Friction that depends on the pressure converges with multigrid."""
    law = Coulomb(10.0, limit=1.0)
    model = rubbing_blocks(
        MPI.COMM_SELF, "hexahedron", upper=(4, 2), lower=(3, 2), young=(1e4, 1.0), friction=law
    )
    with model.problem(stiffness="multigrid") as problem:
        assert problem.solve().status is ContactStatus.CONVERGED
