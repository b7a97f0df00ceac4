"""Nodes on the curved surfaces that Gmsh made the mesh of, without a word of the user."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from test_refinement import half_disc, near, nodes_of

from dolfinx_tresca import MESHES, InputError, MeshError, read_gmsh, refine
from dolfinx_tresca.scene.geometry import open_geometry

#: Of Gmsh's projections, absolute; sizes are about 1.
ROUNDING = 1e-8


def worst(comm, values: np.ndarray) -> float:
    return comm.allreduce(np.abs(values).max(initial=0.0), op=MPI.MAX)


@pytest.mark.parallel
def test_a_sphere_of_the_built_in_kernel(comm):
    tagged = read_gmsh(MESHES / "sphere_octant.geo", comm, h=0.15, Zone=0.3, Growth=0.6)
    assert set(tagged.geometry.curved) == {tagged.tags["upper_contact"], tagged.tags["upper_free"]}
    for _ in range(2):
        tagged = refine(tagged, near(tagged, [0, 0, 0]))
    for name in ("upper_contact", "upper_free"):
        x = nodes_of(tagged, name) - [0.0, 0.0, 1.0]
        assert worst(comm, np.linalg.norm(x, axis=1) - 1.0) <= ROUNDING
    for axis, name in enumerate("xy"):
        assert worst(comm, nodes_of(tagged, f"upper_{name}")[:, axis]) <= ROUNDING


@pytest.mark.parallel
def test_a_sphere_of_open_cascade(comm):
    """Where it ends nodes stay on the circle, though the next surface has no tag."""
    R, zone = 2.0, 1.0
    tagged = read_gmsh(MESHES / "ball_on_plate.geo", comm, R=R, h=0.4, Zone=zone, Growth=0.6)
    tagged = refine(tagged, near(tagged, [0, 0, 0]), 1.0)
    x = nodes_of(tagged, "ball_contact")
    r = np.linalg.norm(x - [0.0, 0.0, R], axis=1)
    assert worst(comm, r - R) <= ROUNDING * R
    assert worst(comm, nodes_of(tagged, "symmetry")[:, 1]) <= ROUNDING
    across = np.hypot(x[:, 0], x[:, 1])
    rim = across > 0.96 * zone  # chords are 0.98 from the middle, other nodes 0.9
    assert comm.allreduce(rim.sum()) > 8
    assert worst(comm, across[rim] - zone) <= ROUNDING


@pytest.mark.parallel
def test_cylinders_with_parameters_of_their_own(comm):
    """Their edges stay in the planes that they end in; without geometry nodes stay on chords."""
    fit = read_gmsh(
        MESHES / "press_fit.geo", comm, N=4, M=4, Hex=0, Radius=8, Rim=12, Support=10, Thickness=4
    )
    refined = refine(fit, near(fit, [5, 5, 0]) ** 0.1)
    for name, radius in (("plate_contact", 8.0), ("pin_contact", 8.01)):
        x = nodes_of(refined, name)
        assert worst(comm, np.hypot(x[:, 0], x[:, 1]) - radius) <= ROUNDING * radius
    low = nodes_of(refined, "plate_contact")[:, 2]
    ends = (low < 1e-3) | (low > 4.0 - 1e-3)
    assert worst(comm, low[ends] * (low[ends] - 4.0)) <= ROUNDING * 4.0**2
    other = refine(replace(fit, geometry=None), near(fit, [5, 5, 0]) ** 0.1)
    x = nodes_of(other, "plate_contact")
    assert worst(comm, np.hypot(x[:, 0], x[:, 1]) - 8.0) > 1e-2


def test_a_file_that_is_gone(comm, tmp_path):
    file = tmp_path / "half_disc.geo"
    file.write_text((MESHES / "half_disc.geo").read_text())
    tagged = read_gmsh(file, comm, h=0.3)
    file.unlink()
    with pytest.raises(MeshError, match="there is no file"):
        refine(tagged, near(tagged, [0, 0, 0]))
    refine(replace(tagged, geometry=None), near(tagged, [0, 0, 0]))


@pytest.mark.parallel
def test_a_mesh_that_was_moved(comm):
    tagged = half_disc(comm)
    tagged.mesh.geometry.x[:] += 1e-3
    errors = near(tagged, [0, 0, 0])
    with pytest.raises(InputError, match="moved or scaled"):
        refine(tagged, errors)
    refine(replace(tagged, geometry=None), errors)


def test_a_face_that_goes_on_flat(comm, tmp_path):
    """A physical group may have flat and curved parts: nodes of both are on the surface already."""
    geo = tmp_path / "fillet.geo"
    geo.write_text(
        "Point(1) = {0, 0, 0}; Point(2) = {4, 0, 0}; Point(3) = {5, 1, 0}; Point(4) = {0, 1, 0};"
        "Point(5) = {4, 1, 0}; Line(1) = {1, 2}; Circle(2) = {2, 5, 3}; Line(3) = {3, 4};"
        "Line(4) = {4, 1}; Curve Loop(1) = {1:4}; Plane Surface(1) = {1};"
        'Physical Surface("body", 1) = {1}; Physical Curve("face", 2) = {1, 2};'
        "Mesh.MeshSizeMax = 0.7;\n"
    )
    tagged = read_gmsh(geo, comm)
    x = nodes_of(tagged, "face")
    with open_geometry(tagged.geometry) as surfaces:
        moved = surfaces[tagged.tags["face"]].project(x.T)
    assert worst(comm, moved - x.T) <= ROUNDING
