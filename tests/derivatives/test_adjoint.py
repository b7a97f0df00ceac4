"""Adjoints that the iteration does not find."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import ConvergenceError
from dolfinx_tresca.derivatives.linearised import ADJOINT_ACCURACY, LinearisedContact
from scenes.two_bricks import two_bricks


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_an_adjoint_that_is_not_found_is_an_error(comm, monkeypatch, unit):
    """In whatever unit the number is."""
    with two_bricks(comm, 3).problem(stiffness="multigrid") as problem:
        problem.solve()
        contact = LinearisedContact.of_last_solve(problem._contact)
        size = len(contact.multipliers)
        on_jump, on_x = unit * np.random.default_rng(1).standard_normal((2, size))
        monkeypatch.setattr("dolfinx_tresca.derivatives.linearised.MOST_STEPS", 1)
        with pytest.raises(ConvergenceError, match="no adjoint"):
            contact.adjoint(on_jump, on_x, accuracy=ADJOINT_ACCURACY)
        monkeypatch.undo()
        contact.adjoint(on_jump, on_x, accuracy=ADJOINT_ACCURACY)
