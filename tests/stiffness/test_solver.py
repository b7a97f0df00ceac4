"""Solves with K: first guesses, what is left of the error, and breakdowns."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

import ufl

from dolfinx_tresca import StiffnessError
from dolfinx_tresca.stiffness.solver import cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.two_bricks import YOUNG, two_bricks


@contextmanager
def loaded(comm, springs: float | None = None) -> Iterator[LinearSystem]:
    """The two bricks, with springs of this stiffness at every point."""
    scene = two_bricks(comm, 3)
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    a = scene.a if springs is None else scene.a + springs * ufl.inner(u, v) * ufl.dx
    with LinearSystem(a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        yield system


def energy_norm(system: LinearSystem, u) -> float:
    Ku = u.duplicate()
    system.K.mult(u, Ku)
    return float(np.sqrt(u.dot(Ku)))


@pytest.fixture
def system(comm) -> Iterator[LinearSystem]:
    with loaded(comm) as system:
        yield system


@pytest.fixture
def exact(system):
    """K^-1 f."""
    u = system.f.x.petsc_vec.duplicate()
    with cholesky(system.K, {}, None) as solver:
        assert solver.solve(system.f.x.petsc_vec, u) == 0.0
    return u


@pytest.mark.parametrize("of", [multigrid, cholesky])
def test_an_approximate_solve_without_iteration_is_an_error(system, exact, of):
    """It would be taken for exact, and its error for zero."""
    options = {"ksp_type": "preonly", "pc_type": "gamg"}
    arguments = (system.V, system.prescribed) if of is multigrid else ()
    with (
        of(system.K, *arguments, options, None) as solver,
        pytest.raises(StiffnessError, match="no exact solve, and errors would not be known"),
    ):
        solver.solve(system.f.x.petsc_vec, exact.duplicate())


@pytest.mark.parallel
def test_a_missed_tolerance_is_no_exception(system, exact, caplog):
    f, u = system.f.x.petsc_vec, exact.duplicate()
    whole = energy_norm(system, exact)
    with (
        multigrid(system.K, system.V, system.prescribed, {"ksp_max_it": 2}, None) as solver,
        caplog.at_level(logging.WARNING, logger="dolfinx_tresca"),
    ):
        left = solver.solve(f, u)
        assert 1e-10 * whole < left < whole
        assert left == pytest.approx(solver.error(f, u), rel=1e-10)
        # from there it goes on
        assert solver.improve(f, u, rtol=1e-12, accuracy=0.0) < left
    assert len(caplog.messages) == (1 if system.comm.rank == 0 else 0)
    assert all("after 2 iterations" in message for message in caplog.messages)


@pytest.mark.parametrize(
    ("preconditioner", "message"),
    [
        ("jacobi", "reason -10 .*negative strain energy: K is not positive definite"),
        ("gamg", "reason -8 .*preconditioner is not positive definite. Either K is not.*cholesky"),
    ],
)
def test_breakdowns_say_what_broke_down(comm, preconditioner, message):
    """Springs that push: K has negative eigenvalues, though its diagonal is positive."""
    with loaded(comm, -YOUNG) as system:
        u, options = system.f.x.petsc_vec.duplicate(), {"pc_type": preconditioner}
        with (
            multigrid(system.K, system.V, system.prescribed, options, None) as solver,
            pytest.raises(StiffnessError, match=message),
        ):
            solver.solve(system.f.x.petsc_vec, u)
