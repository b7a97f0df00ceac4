"""Coulomb friction of small bodies, against statics and itself."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus, Coulomb, Frictionless, InputError, Tresca
from dolfinx_tresca._base import compat
from scenes.blocks import block
from scenes.nodal import node_function
from scenes.rubbing import BOUND, YOUNG, rubbing

RTOL = 1e-8

#: Differences of multipliers over the largest, from residuals of RTOL and condition numbers of A.
CLOSE = 1e-5


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("adhesion", [0.0, 0.2])
def test_a_block_slides_when_it_should(comm, dim, adhesion):
    """A block that is drawn aside slides beyond the force that friction can bear, F N + c A."""
    coefficient, area = 0.3, 2.0
    law = Coulomb(coefficient, adhesion=adhesion)
    model = block(comm, (3, 2, 2)[:dim], size=(area, 1.0, 1.0)[:dim], friction=law)
    greatest = coefficient + adhesion
    with model.problem() as problem:
        for part in (0.99, 1.01, 0.5):
            model.data.load.value[:] = 0.0
            model.data.load.value[0] = part * greatest
            model.data.load.value[-1] = -1.0
            if part > 1.0:
                with pytest.raises(InputError, match=r"no contact forces balance.*along x"):
                    problem.solve(rtol=1e-6)
                continue
            solution = problem.solve(rtol=1e-6)
            assert solution.status is ContactStatus.CONVERGED
            assert solution.tangential_force == pytest.approx(part * greatest * area, rel=1e-6)
            assert solution.normal_force == pytest.approx(area, rel=1e-6)


@pytest.mark.parallel
def test_without_friction(comm):
    """A coefficient of zero, or a limit of zero, gives the answer without friction."""
    scene = rubbing(comm, "triangle")
    found = []
    for law in (Frictionless(), Coulomb(0.0), Coulomb(0.5, limit=0.0), Coulomb(0.5)):
        with scene.but(friction=law).problem() as problem:
            found.append(problem.solve(rtol=RTOL))
    free = found[0].u.x.array
    size = comm.allreduce(np.abs(free).max(), op=MPI.MAX)
    for solution in found[1:3]:
        assert solution.status is ContactStatus.CONVERGED
        assert np.abs(solution.u.x.array - free).max() <= CLOSE * size
        assert solution.tangential_force == 0.0
    assert found[3].tangential_force > 0.0


@pytest.mark.parallel(law=["Coulomb"])
@pytest.mark.parametrize("law", ["Coulomb", "Tresca"])
def test_fields_of_every_kind_changed_in_place(comm, law):
    """Functions of points, Functions, components and expressions give the same answers."""
    model = rubbing(comm, "triangle")
    mesh, stress = model.V.mesh, BOUND * YOUNG
    constant, x = fem.Constant(mesh, 0.2), ufl.SpatialCoordinate(mesh)
    linear = node_function(mesh, lambda x: 0.0 * x[0])
    quadratic = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    vector = fem.Function(model.V)

    def of_points(x):
        return float(constant.value) * (1.0 + 0.5 * x[0])

    in_ufl = constant * (1.0 + 0.5 * x[0])
    at_nodes = compat.interpolation_points(linear.function_space.element)
    kinds: dict[str, Any] = {
        "points": of_points,
        "a list": lambda x: list(of_points(x)),
        "Function": linear,
        "quadratic Function": quadratic,
        "component": vector.sub(1),
        "UFL": in_ufl,
        "conditional": ufl.conditional(ufl.gt(x[0], -1.0), 1.0 * linear, 0.0),
        "Expression": fem.Expression(in_ufl, at_nodes),
    }

    def problem_of(field):
        friction = Coulomb(field, limit=10.0 * stress) if law == "Coulomb" else Tresca(field)
        return model.but(friction=friction).problem()

    def forces_of(field):
        forces = []
        constant.value = 0.2
        with problem_of(field) as problem:
            for constant.value in (0.2, 0.5):
                linear.interpolate(of_points)
                quadratic.interpolate(of_points)
                vector.interpolate(lambda x: np.stack([x[0], of_points(x)]))
                forces.append(problem.solve(rtol=RTOL).tangential_force)
        return forces

    expected = forces_of(kinds["points"])
    assert expected[1] > 1.1 * expected[0]
    for name, field in kinds.items():
        assert forces_of(field) == pytest.approx(expected, rel=CLOSE), name
    with problem_of(constant) as changed, problem_of(0.5) as number:
        constant.value = 0.5
        wanted = number.solve(rtol=RTOL).tangential_force
        assert changed.solve(rtol=RTOL).tangential_force == pytest.approx(wanted, rel=CLOSE)
