"""Rigid motions that supports leave to contact: of bodies with few free degrees of freedom."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, RigidPlane
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.rigid_modes import weakly_resisted_modes
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity

#: Sides of a slab along the axes [m], its weight [MN/m^3], and Young's modulus [MPa].
SIDES, WEIGHT, YOUNG = (1.0, 0.5, 0.25), 0.02, 1e3


@pytest.mark.parallel
@pytest.mark.parametrize("sag", [0.0, -1e-3])
def test_a_slab_in_plane_strain_beside_a_body_that_is_wholly_prescribed(comm, sag):
    """The slab moves in its plane only: it floats, and the floor carries its weight.

    A motion across the plane, and all motions of the other body, move no free degree of freedom.
    """
    box = [(0.0, side) for side in SIDES]
    beside = [(2.0, 3.0), *box[1:]]
    made = boxes(comm, "hexahedron", [Body((4, 2, 1), box), Body((1, 1, 1), beside)])
    V, tags = made.V, made.tags((1, [0], lambda x: np.isclose(x[:, 1], 0.0)))
    across = fem.locate_dofs_geometrical(
        (V.sub(2), V.sub(2).collapse()[0]), lambda x: np.isfinite(x[0])
    )[0]
    rigid, clamp = fem.locate_dofs_geometrical(V, lambda x: x[0] > 1.5), fem.Function(V)
    clamp.interpolate(lambda x: np.vstack([0.0 * x[0], sag + 0.0 * x[0], 0.0 * x[0]]))
    bcs = [fem.dirichletbc(0.0, across, V.sub(2)), fem.dirichletbc(clamp, rigid)]
    floor = ContactPair(tags, 1, RigidPlane((0, 0, 0), (0, 1, 0)), Coulomb(0.5))
    L = -WEIGHT * ufl.TestFunction(V)[1] * ufl.dx
    with ContactProblem(elasticity(V, YOUNG), L, [floor], bcs) as problem:
        assert "2, 1 of them held by contact alone" in str(problem)
        solution = problem.solve(rtol=1e-8)
    solution.raise_if_failed()
    force = solution.pair_resultants[0].force
    assert force == pytest.approx([0.0, WEIGHT * np.prod(SIDES), 0.0], abs=1e-12)


@pytest.mark.parallel
def test_a_mesh_that_is_wholly_prescribed_has_no_motions(comm):
    V = boxes(comm, "quadrilateral", [Body((2, 2), [(0.0, 1.0), (1.0, 2.0)])]).V
    clamp = fem.locate_dofs_geometrical(V, lambda x: np.isfinite(x[0]))
    bcs = [fem.dirichletbc(fem.Function(V), clamp)]
    with LinearSystem(elasticity(V, YOUNG), None, bcs) as system:
        system.assemble_stiffness()
        modes = weakly_resisted_modes(system, Bodies.from_space(V))
    assert len(modes) == 0
    assert modes.summary == ""


@pytest.mark.parallel
@pytest.mark.parametrize("softness", [0.0, 1e-6])
def test_a_body_of_one_cell(comm, softness):
    """The floor and soft springs carry its weight; on several ranks, some have no node of it."""
    made = boxes(comm, "quadrilateral", [Body((1, 1), [(0.0, 1.0), (0.0, 1.0)])])
    tags = made.tags((1, [0], lambda x: np.isclose(x[:, 1], 0.0)))
    u, v = ufl.TrialFunction(made.V), ufl.TestFunction(made.V)
    spring = fem.Constant(made.mesh, softness * YOUNG)
    a = elasticity(made.V, YOUNG) + spring * ufl.inner(u, v) * ufl.dx
    floor = ContactPair(tags, 1, RigidPlane((0, 0, 0), (0, 1, 0)), Coulomb(0.5))
    with ContactProblem(a, -WEIGHT * v[1] * ufl.dx, [floor]) as problem:
        solution = problem.solve(rtol=1e-9)
    solution.raise_if_failed()
    carried = comm.allreduce(fem.assemble_scalar(fem.form(spring * solution.u[1] * ufl.dx)))
    force = solution.pair_resultants[0].force
    assert force == pytest.approx([0.0, WEIGHT + carried], abs=1e-9 * WEIGHT)
