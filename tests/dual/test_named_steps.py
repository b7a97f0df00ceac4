"""K is solved in named steps: constructing and reading properties solves nothing."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import SolverOptions
from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.response import DirectResponse, ElasticResponse, IterativeResponse
from dolfinx_tresca.solvers.iterate import InexactIterate, Iterate
from dolfinx_tresca.solvers.iteration import ModelNewton
from scenes.assembled import dual_program
from scenes.two_bricks import two_bricks

POLICIES = {
    "cholesky": (DirectResponse, Iterate),
    "multigrid": (IterativeResponse, InexactIterate),
}


@pytest.mark.parametrize("stiffness", POLICIES)
def test_each_solve_is_in_a_step_of_its_own(stiffness):
    """And the classes for products are those of the solver for K."""
    scene = two_bricks(MPI.COMM_SELF, 2)
    with dual_program(scene, stiffness) as dual, InitialGuess(dual.jump) as guess:
        solver, compliance = dual.compliance.operator.solver, dual.compliance
        origin = np.zeros(len(dual.jump.gap))
        before = solver.solves
        response = ElasticResponse.of(compliance, guess, origin)
        newton = ModelNewton(dual, SolverOptions(), lambda iteration: False)
        assert solver.solves == before

        response.solve_load()
        assert solver.solves == before + 1
        assert np.allclose(response.b, dual.b, rtol=1e-5, atol=1e-5 * np.abs(dual.b).max())
        newton.compute_first_products()
        first = solver.solves
        newton.compute_first_products()  # they are known now
        assert solver.solves == first
        newton.begin_at(origin)  # zero, where no product is needed
        assert solver.solves == first
        assert (type(response), type(newton.at)) == POLICIES[stiffness]
