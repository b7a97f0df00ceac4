"""Forms with Functions on surfaces."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution, InputError, SurfaceFields
from scenes.patches import UPPER, patch
from scenes.scene import EPS, Scene

pytestmark = pytest.mark.parallel


@pytest.fixture(scope="module")
def solved() -> tuple[Scene, ContactSolution]:
    scene = patch(MPI.COMM_WORLD, "quadrilateral", upper=(3, 2), lower=(4, 1))
    with scene.problem() as problem:
        return scene, problem.solve(rtol=1e-10)


def pushed(scene: Scene, fields: SurfaceFields) -> Any:
    """Return the load of the pressure on the upper body's contact surface."""
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    (v,) = scene.L.arguments()
    return fields.pressure * ufl.inner(scene.data.push, v) * ds(UPPER)


def test_a_surface_function_in_a_form(comm, solved):
    """With the map of its surface a form integrates it, as one and as the load of a problem."""
    scene, solution = solved
    fields = solution.surface
    scene.data.push = ufl.as_vector(np.eye(2)[1])
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    form = fem.form(fields.pressure * ds(UPPER), entity_maps=fields.entity_maps)
    total = comm.allreduce(fem.assemble_scalar(form))
    assert total == pytest.approx(solution.normal_force, rel=64 * EPS)
    L = scene.L + pushed(scene, fields)
    with scene.problem(L=L, entity_maps=fields.entity_maps) as problem:
        moved = problem.solve(rtol=1e-10)
    # the ends are held: what lifts the upper body off comes off the contact force
    assert 0.0 < moved.normal_force < solution.normal_force


def test_without_a_map_the_problem_says_so(solved):
    scene, solution = solved
    scene.data.push = ufl.as_vector(np.eye(2)[1])
    with pytest.raises(InputError, match=r"the form L holds the Function 'pressure'.*on_mesh"):
        scene.problem(L=scene.L + pushed(scene, solution.surface))
