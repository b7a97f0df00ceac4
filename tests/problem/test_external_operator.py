"""A material by dolfinx-external-operator, whose operators are evaluated before each assembly."""

from __future__ import annotations

import dataclasses
import itertools

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    Coulomb,
    Frictionless,
    NewtonOptions,
    NonlinearContactProblem,
    RigidSphere,
    SolverOptions,
)
from scenes.blocks import ABOVE, BELOW, LEFT, RIGHT, block
from scenes.elasticity import fixed, strain
from scenes.plastic_block import (
    HARDENING,
    POISSON,
    QUADRATURE,
    YIELD,
    YOUNG,
    plastic_block,
    radial_return,
)

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


#: Radii of a tube and of the hole around it [mm], cells round a quarter of it, and the inner
#: pressure [MPa] that it carries if it is fully plastic without hardening.
INNER, OUTER, HOLE, CELLS = 1.0, 1.3, 1.31, 8
LIMIT = 2 / np.sqrt(3) * YIELD * np.log(OUTER / INNER)


def strain_in_3d(u):
    """Return the strain of plane strain as a matrix of three rows."""
    return ufl.as_tensor([[*strain(u)[i, :], 0] for i in (0, 1)] + [[0, 0, 0]])


def mises(stress):
    """Return von Mises' equivalent of stresses (n, 3, 3)."""
    deviator = stress - np.einsum("nii,jk->njk", stress, np.eye(3)) / 3
    return np.sqrt(1.5 * np.einsum("nij,nij->n", deviator, deviator))


def test_the_von_mises_demo_with_contact():
    """A tube that yields under inner pressure until a rigid hole holds it.

    The steps are those of the package's demo of von Mises' plasticity, whose unknown is the
    increment of displacement in a load step; the gap begins at the displacement before it. Oracle:
    a fully plastic tube carries the integral of 2 / sqrt(3) (yield stress + hardening) over ln r,
    and the hole the remainder of the pressure.
    """
    square = block(MPI.COMM_SELF, (2, CELLS), degree=2)
    mesh, V, tags = square.mesh, square.V, square.facet_tags
    r, angle = INNER + (OUTER - INNER) * mesh.geometry.x[:, 0], np.pi / 2 * mesh.geometry.x[:, 1]
    mesh.geometry.x[:, :2] = np.column_stack((r * np.cos(angle), r * np.sin(angle)))
    bcs = [fixed(V, tags.find(BELOW), component=1), fixed(V, tags.find(ABOVE), component=0)]

    metadata = {"quadrature_degree": QUADRATURE, "quadrature_scheme": "default"}
    dx = ufl.Measure("dx", domain=mesh, metadata=metadata)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags, metadata=metadata)
    u, increment = fem.Function(V), fem.Function(V)
    cell = mesh.basix_cell()
    of_tensors, of_scalars = (
        fem.functionspace(
            mesh, basix.ufl.quadrature_element(cell, value_shape=shape, degree=QUADRATURE)
        )
        for shape in ((3, 3), ())
    )
    stress = external.FEMExternalOperator(strain_in_3d(increment), function_space=of_tensors)
    old_stress, old_hardening = fem.Function(of_tensors), fem.Function(of_scalars)
    loading, v = fem.Constant(mesh, 0.0), ufl.TestFunction(V)
    F = ufl.inner(stress, strain_in_3d(v)) * dx
    F += loading * ufl.inner(ufl.FacetNormal(mesh), v) * ds(LEFT)

    def tangent_and_stress(strains):
        before = old_stress.x.array.reshape(-1, 3, 3)
        elastic = (1 + POISSON) * before
        elastic -= POISSON * np.einsum("nii,jk->njk", before, np.eye(3))
        strains = strains.reshape(-1, 3, 3) + elastic / YOUNG
        found, tangent = radial_return(strains, 0.0 * before, old_hardening.x.array)
        return tangent.ravel(), found.ravel()

    stress.external_function = {(1,): tangent_and_stress}.get
    J = ufl.algorithms.expand_derivatives(ufl.derivative(F, increment, ufl.TrialFunction(V)))
    F_replaced, of_F = external.replace_external_operators(F)
    J_replaced, of_J = external.replace_external_operators(J)

    def update():
        operands = external.evaluate_operands(of_F)
        ((_, new_stress),) = external.evaluate_external_operators(of_J, operands)
        stress.ref_coefficient.x.array[:] = new_stress

    x = ufl.SpatialCoordinate(mesh)
    moved = -ufl.inner(u, x) / ufl.sqrt(ufl.inner(x, x))
    hole = RigidSphere((0.0, 0.0), HOLE, hollow=True)
    pair = ContactPair(tags, RIGHT, hole, Frictionless(), gap=moved)
    with NonlinearContactProblem(
        F_replaced, increment, [pair], bcs, J=J_replaced, before_assembly=update, **OPTIONS
    ) as problem:
        for pressure in LIMIT * np.linspace(0.0, 2.25, 6) ** 0.5:
            loading.value = pressure
            increment.x.array[:] = 0.0

            solution = problem.solve()
            solution.raise_if_failed()

            u.x.array[:] += increment.x.array
            old_stress.x.array[:] = stress.ref_coefficient.x.array
            equivalent = mises(old_stress.x.array.reshape(-1, 3, 3))
            old_hardening.x.array[:] = np.maximum(
                old_hardening.x.array, (equivalent - YIELD) / HARDENING
            )
    strength = 2 / np.sqrt(3) * (YIELD + HARDENING * old_hardening)
    carried = 2 / np.pi * fem.assemble_scalar(fem.form(strength / ufl.inner(x, x) * dx))
    contact = solution.normal_force / (np.pi / 2 * OUTER)
    assert old_hardening.x.array.min() > 0.0
    assert contact > 0.1 * pressure
    # what the polygon of facets makes of the circle
    assert contact == pytest.approx(pressure - carried, abs=(np.pi / 2 / CELLS) ** 2 * pressure)
    points = V.tabulate_dof_coordinates()
    ends = np.isclose(np.linalg.norm(points, axis=1), OUTER, rtol=1e-12)
    radii = np.linalg.norm(points[ends, :2] + u.x.array.reshape(-1, 2)[ends], axis=1)
    assert np.abs(radii - HOLE).max() <= 0.01 * (HOLE - OUTER)  # with facets for arcs
    residuals = [step.residual for step in solution.newton.steps]
    assert all(b <= 10 * a**2 for a, b in itertools.pairwise(residuals[1:]) if b > 1e-12)
