"""What the guaranteed bound does not cover is refused, with the reason."""

from __future__ import annotations

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactPair,
    ContactProblem,
    Frictionless,
    InputError,
    RigidSphere,
)
from scenes.elasticity import elasticity, fixed
from scenes.known_contact import CONTACT, block_on_plane
from scenes.manufactured import blocks_scene
from scenes.patches import patch
from scenes.scene import Scene


def refusal(scene: Scene, **changes: object) -> str:
    """Return the message with which the bound is refused."""
    with scene.problem(**changes) as problem:
        problem.solve(rtol=1e-6)
        with pytest.raises(InputError) as caught:
            problem.guaranteed_error()
    return str(caught.value)


@pytest.fixture
def scene(comm):
    return block_on_plane(comm, "triangle", 1, 4, "lifts")


def test_cells_that_are_no_simplices(comm):
    assert "triangles or tetrahedra" in refusal(patch(comm, "quadrilateral"))


def test_curved_obstacles(scene):
    ball = RigidSphere((0.5, -1.0, 0.0), 1.0)
    pairs = [ContactPair(scene.facet_tags, CONTACT, ball, Frictionless())]
    assert "rigid planes, or of bodies of degree 1" in refusal(scene, pairs=pairs)


def test_meshes_that_do_not_match(comm):
    assert "whose meshes match" in refusal(blocks_scene(comm, "triangle", 1, (4, 6)))


def test_two_bodies_of_degree_2(comm):
    assert "whose meshes match" in refusal(blocks_scene(comm, "triangle", 2, (4, 4)))


def test_bodies_that_contact_holds(scene, comm):
    top = dolfinx.mesh.locate_entities_boundary(scene.mesh, 1, lambda x: x[1] > 0.5 - 1e-9)
    bcs = [fixed(scene.V, top, 0.0, 0)]
    push = ufl.inner(fem.Constant(scene.mesh, (0.0, -0.1)), ufl.TestFunction(scene.V)) * ufl.dx
    assert "contact alone" in refusal(scene, bcs=bcs, L=push)


def test_stiffnesses_that_vary_in_cells(scene):
    x = ufl.SpatialCoordinate(scene.mesh)
    assert "constant in each cell" in refusal(scene, a=elasticity(scene.V, 1.0 + x[0]))


@pytest.mark.parallel
def test_a_stiffness_that_varies_in_cells_of_one_rank(scene):
    """All ranks refuse it, though the cells of others have none of it."""
    x = ufl.SpatialCoordinate(scene.mesh)
    there = ufl.conditional(ufl.lt(x[0], 0.25), x[0], 0.0)
    assert "constant in each cell" in refusal(scene, a=elasticity(scene.V, 1.0 + there))


def test_stiffnesses_of_more_than_the_strain(scene):
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    spring = 0.1 * ufl.inner(u, v)
    plain = elasticity(scene.V, 1.0)
    assert "integrals over facets" in refusal(scene, a=plain + spring * ufl.ds)
    assert "displacement itself" in refusal(scene, a=plain + spring * ufl.dx)
    laplace = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    assert "rotations" in refusal(scene, a=laplace)


def test_initial_stresses(scene):
    v = ufl.TestFunction(scene.V)
    assert "gradient" in refusal(scene, L=0.01 * ufl.div(v) * ufl.dx)


def test_forces_at_points(scene):
    """A node that is prescribed without its facets, and holds a force."""
    point = fem.locate_dofs_geometrical(
        scene.V, lambda x: np.isclose(x[0], 1.0) & np.isclose(x[1], 0.25)
    )
    held = fem.dirichletbc(np.array([0.01, 0.0]), point, scene.V)
    with ContactProblem(scene.a, scene.L, scene.pairs, bcs=[*scene.bcs, held]) as problem:
        problem.solve(rtol=1e-6)
        with pytest.raises(ContactError, match="prescribed at a point"):
            problem.guaranteed_error()


def test_loads_that_have_changed(scene):
    load = fem.Constant(scene.mesh, (0.0, -0.01))
    L = ufl.inner(load, ufl.TestFunction(scene.V)) * ufl.dx
    with ContactProblem(scene.a, L, scene.pairs, bcs=scene.bcs) as problem:
        with pytest.raises(ContactError, match="no solution"):
            problem.guaranteed_error()
        problem.solve(rtol=1e-6)
        load.value[1] = -0.02
        with pytest.raises(ContactError, match="have changed"):
            problem.guaranteed_error()
        problem.solve(rtol=1e-6)
        with pytest.raises(InputError, match="gain"):
            problem.guaranteed_error(gain=0.0)
        assert problem.guaranteed_error().relative_error > 0.0
