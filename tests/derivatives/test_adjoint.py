"""Adjoints that the iteration does not find."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import ConvergenceError
from dolfinx_tresca.derivatives.adjoint import LinearisedContact, adjoint
from scenes.two_bricks import two_bricks


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_an_adjoint_that_is_not_found_is_an_error(comm, monkeypatch, unit):
    """In whatever unit the number is."""
    with two_bricks(comm, 3).problem(stiffness="multigrid") as problem:
        solution = problem.solve()
        solved = problem._contact.solved
        dual, x = solved.dual, solved.multipliers
        r = dual.response.gradient_of(solution.u.x.petsc_vec)
        state = LinearisedContact.of(dual, x, r)
        on_jump, on_x = unit * np.random.default_rng(1).standard_normal((2, len(x)))
        monkeypatch.setattr("dolfinx_tresca.derivatives.adjoint.MOST_STEPS", 1)
        with pytest.raises(ConvergenceError, match="no adjoint"):
            adjoint(dual, state, on_jump, on_x)
        monkeypatch.undo()
        adjoint(dual, state, on_jump, on_x)
