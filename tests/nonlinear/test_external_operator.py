"""A material by dolfinx-external-operator, whose operators are evaluated before each assembly."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ufl

from dolfinx_tresca import Coulomb, NewtonOptions, SolverOptions
from scenes.elasticity import strain
from scenes.plastic_block import QUADRATURE, YIELD, YOUNG, plastic_block, radial_return

external = pytest.importorskip(
    "dolfinx_external_operator", reason="it is for DOLFINx 0.11: FENICSX_SUITE=wheels"
)

#: Accuracy of Newton's method, and of contact.
RTOL = 1e-9
OPTIONS = {"newton": NewtonOptions(accuracy=RTOL), "options": SolverOptions(rtol=RTOL)}


def by_external_operator(metal):
    """Return a plastic block whose stress is an external operator of the strain.

    As in the demo of von Mises' plasticity there: the derivative is replaced by coefficients, which
    are evaluated before assemblies, and the same call returns the stress.
    """
    u, (plastic, hardening) = metal.u, metal.history
    v, du = ufl.TestFunction(u.function_space), ufl.TrialFunction(u.function_space)
    dx = ufl.dx(metadata={"quadrature_degree": QUADRATURE, "quadrature_scheme": "default"})
    stress = external.FEMExternalOperator(strain(u), function_space=plastic.function_space)

    def tangent_and_stress(strains):
        state = plastic.x.array.reshape(-1, 3, 3), hardening.x.array
        found, tangent = radial_return(strains.reshape(-1, 3, 3), *state)
        return tangent.ravel(), found.ravel()

    stress.external_function = {(1,): tangent_and_stress}.get
    F = ufl.inner(stress, strain(v)) * dx
    J = ufl.algorithms.expand_derivatives(ufl.derivative(F, u, du))
    F, of_F = external.replace_external_operators(F)
    J, of_J = external.replace_external_operators(J)

    def before_assembly():
        operands = external.evaluate_operands(of_F)
        ((_, found),) = external.evaluate_external_operators(of_J, operands)
        stress.ref_coefficient.x.array[:] = found

    return dataclasses.replace(metal, F=F, J=J, before_assembly=before_assembly)


@pytest.mark.parallel
def test_von_mises_with_contact(comm):
    """A block that rubs on a plane yields as it does where numpy computes the stress; order 2."""
    forces = []
    for make in (lambda metal: metal, by_external_operator):
        metal = make(
            plastic_block(comm, (3, 1, 1), numeric=True, clamped=True, friction=Coulomb(0.2))
        )
        residuals = []
        with metal.problem(**OPTIONS) as problem:
            for down, along in ((3.0, 0.5), (2.5, -0.5)):
                metal.push.value[:] = YIELD / YOUNG * np.array([along, 0.0, -down])
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                residuals.append([step.residual for step in solution.newton.steps])
        forces.append(solution.pair_resultants[0].force)
        large = [r for r in residuals[0] if r > 1e-12]  # beside rounding
        assert large[-1] <= 1e2 * large[-2] ** 2
    assert comm.allreduce(metal.history[1].x.array.max(initial=0.0)) > 0.0
    wanted, found = np.array(forces)
    assert np.abs(found - wanted).max() <= 1e3 * RTOL * np.abs(wanted).max()
