"""The compliance of what is near the contact, against A."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from test_operator import local_random

from dolfinx_tresca.dual.products import near_field
from scenes.assembled import dual_program
from scenes.two_bricks import two_bricks

#: Rounding of solves with K.
SOLVE = 1e-9


@pytest.mark.parallel
def test_it_is_A_when_all_is_near(comm, monkeypatch):
    monkeypatch.setattr(near_field, "LAYERS", 10)
    with dual_program(two_bricks(comm, 4)) as dual:
        x = local_random(comm, len(dual.b), 0)
        size = np.sqrt(dual.inner(dual.b, dual.b))
        difference = dual.compliance.near_field.apply(x) - dual.operator.apply(x)
        assert np.abs(difference).max(initial=0.0) <= SOLVE * size


@pytest.mark.parallel
def test_it_is_less_than_A_and_close_to_it_for_rough_tractions(comm):
    """What is clamped gives way less; most of what alternating tractions do is near."""
    with dual_program(two_bricks(comm, 8)) as dual:
        for seed in range(3):
            x = local_random(comm, len(dual.b), seed)
            y = local_random(comm, len(dual.b), seed + 10)
            near, whole = (
                dual.inner(x, dual.compliance.near_field.apply(x)),
                dual.inner(x, dual.operator.apply(x)),
            )
            assert 0.2 * whole <= near <= whole
            left, right = (
                dual.inner(y, dual.compliance.near_field.apply(x)),
                dual.inner(x, dual.compliance.near_field.apply(y)),
            )
            assert abs(left - right) <= SOLVE * whole
        pressure = np.zeros_like(dual.b)
        pressure[dual.admissible.normal] = 1.0  # smooth
        near = dual.inner(pressure, dual.compliance.near_field.apply(pressure))
        assert 0.0 < near < 0.25 * dual.inner(pressure, dual.operator.apply(pressure))


@pytest.mark.parallel(degree=[1])
@pytest.mark.parametrize("degree", [1, 2])
def test_with_multigrid_it_knows_smooth_tractions_too(comm, degree, monkeypatch):
    """Less than A all the same, and symmetric; of a pressure cells nearby alone tell a tenth."""
    monkeypatch.setattr(near_field, "MOST_UNKNOWNS", 250)  # a level of such a mesh, not K
    with dual_program(two_bricks(comm, 8 // degree, degree=degree), "multigrid") as dual:
        pressure = np.zeros_like(dual.b)
        pressure[dual.admissible.normal] = 1.0
        for x in (pressure, local_random(comm, len(dual.b), 1)):
            y = local_random(comm, len(dual.b), 2)
            near, whole = (
                dual.inner(x, dual.compliance.near_field.apply(x)),
                dual.inner(x, dual.operator.apply(x)),
            )
            assert 0.4 * whole <= near <= (1.0 + SOLVE) * whole
            left, right = (
                dual.inner(y, dual.compliance.near_field.apply(x)),
                dual.inner(x, dual.compliance.near_field.apply(y)),
            )
            assert abs(left - right) <= SOLVE * max(
                near, dual.inner(y, dual.compliance.near_field.apply(y))
            )


def test_a_contact_solve_takes_few_times_the_iterations_of_a_linear_one():
    """Before there was a coarse level in it: 97 for 20. Products then had a tenth of the error."""
    scene = two_bricks(MPI.COMM_SELF, 8)
    with dual_program(scene, "multigrid") as dual:
        solver = dual.compliance.operator.solver
        before = solver.krylov_iterations
        u = dual.jump.matrix.createVecRight()
        solver.improve(dual.jump.system.f.x.petsc_vec, u, rtol=1e-8, accuracy=0.0)
        linear = solver.krylov_iterations - before
        u.destroy()
    with scene.problem(stiffness="multigrid") as problem:
        assert problem.solve(accuracy=1e-3).krylov_iterations <= 3 * linear
