"""Obstacles from files of triangles, against the exact shapes."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import Coulomb, InputError, RigidObstacle, RigidPlane, RigidSphere
from scenes.blocks import ABOVE, BELOW, block

pyvista = pytest.importorskip("pyvista")

DOWN = -2e-2


def pressed(comm, obstacle):
    """Return the solution of a block into which an obstacle has been pushed from above."""
    obstacle.move_to(translation=(1e-3, 0, DOWN))
    scene = block(
        comm, (4, 4, 3), load=(0, 0, 0), held=(BELOW,), obstacles=[(ABOVE, obstacle)],
        friction=Coulomb(0.3),
    )  # fmt: skip
    with scene.problem() as problem:
        return problem.solve(rtol=1e-10)


def saved(comm, folder, surface):
    path = comm.bcast(folder) / "obstacle.stl"
    if comm.rank == 0:
        surface.triangulate().save(path)
    comm.barrier()
    return path


@pytest.mark.parallel
def test_a_ball_of_triangles_is_a_ball(comm, tmp_path):
    ball = pyvista.Sphere(
        radius=2.0, center=(0.5, 0.5, 3.0), theta_resolution=200, phi_resolution=200
    )
    obstacle = RigidObstacle.from_file(saved(comm, tmp_path, ball))
    points = np.array([[0.5, 0.3, 1.1], [1.6, 2.6, 2.9], [0.4, 0.5, 1.2]])
    exact = RigidSphere((0.5, 0.5, 3.0), 2.0)
    for computed, wanted in zip(obstacle.at(points), exact.at(points), strict=True):
        assert np.abs(computed - wanted).max() <= 2e-3
    solution, reference = pressed(comm, obstacle), pressed(comm, exact)
    force, wanted = (s.pair_resultants[0].force for s in (solution, reference))
    # the sagitta of the facets, 2.5e-4, is 1.2 % of the depth
    assert np.linalg.norm(force - wanted) <= 0.03 * np.linalg.norm(wanted)


@pytest.mark.parallel
def test_the_flat_side_of_a_box_is_a_plane(comm, tmp_path):
    """Its edges stay sharp, and the force is that of the plane to the accuracy of the file."""
    path = saved(comm, tmp_path, pyvista.Box((-5, 6, -5, 6, 1, 4)))
    box = RigidObstacle.from_file(path)
    points = np.array([[0.1, 0.2, 0.9], [5.9, 0.0, 0.9], [6.5, 0.0, 2.0], [0.3, 0.4, 1.1]])
    distance, normal = box.at(points)
    assert np.allclose(distance, [0.1, 0.1, 0.5, -0.1], atol=1e-6)
    assert np.allclose(normal, [[0, 0, -1], [0, 0, -1], [1, 0, 0], [0, 0, -1]], atol=1e-6)
    plane = RigidPlane((0.5, 0.5, 1.0), (0, 0, -1))
    force, wanted = (pressed(comm, tool).pair_resultants[0].force for tool in (box, plane))
    assert np.linalg.norm(force - wanted) <= 1e-4 * np.linalg.norm(wanted)


@pytest.mark.parallel
def test_a_flat_face_beside_gentle_slopes_is_a_plane(comm, tmp_path):
    """Slopes of 18 and 14 degrees are not sharp: normals turn to them, but near their edges."""
    profile = (-1, 1), (8, 1), (-4, 2), (12, 2), (-4, 4), (12, 4)
    points = np.array([(x, y, z) for x, z in profile for y in (-5.0, 6.0)])
    path = saved(comm, tmp_path, pyvista.PolyData(points).delaunay_3d().extract_surface())
    roof, plane = RigidObstacle.from_file(path), RigidPlane((0.5, 0.5, 1.0), (0, 0, -1))
    force, wanted = (pressed(comm, tool).pair_resultants[0].force for tool in (roof, plane))
    assert np.linalg.norm(force - wanted) <= 1e-4 * np.linalg.norm(wanted)


@pytest.mark.parallel
def test_what_is_no_closed_surface_is_named(comm, tmp_path):
    with pytest.raises(InputError, match=r"the surface in .* is not closed: 4 edges"):
        RigidObstacle.from_file(
            saved(comm, tmp_path, pyvista.Plane(i_resolution=1, j_resolution=1))
        )
    with pytest.raises(InputError, match=r"cannot read 'nowhere\.stl' with pyvista"):
        RigidObstacle.from_file("nowhere.stl")
