"""Gaps between curved surfaces whose meshes were refined."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest
from test_refinement import near

from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Frictionless,
    InputError,
    TaggedMesh,
    read_gmsh,
    refine,
    solve_adaptively,
)
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed

RADIUS, INTERFERENCE = 10.0, 1e-3  # mm
CELLS = 6  # round a quarter of the hole

#: Error of Gmsh's nearest points on the surfaces of its own kernel [mm].
NEAREST = 3e-6 * RADIUS

#: Of the largest facets over the circle [mm].
SAGITTA = RADIUS * (1.0 - np.cos(0.25 * np.pi / CELLS))


def on_cylinder(radius):
    def nearest(x):
        part = radius / np.hypot(x[0], x[1])
        return np.stack([x[0] * part, x[1] * part, x[2]])

    return nearest


SURFACES = {"plate_contact": on_cylinder(RADIUS), "pin_contact": on_cylinder(RADIUS + INTERFERENCE)}


def press_fit(comm, *, of_gmsh=False):
    fit = read_gmsh(
        MESHES / "press_fit.geo", comm, N=CELLS, M=4, Hex=0, Thickness=8, Interference=INTERFERENCE
    )
    if not of_gmsh:
        geometry = {fit.tags[name]: function for name, function in SURFACES.items()}
        fit = dataclasses.replace(fit, geometry=geometry)
    return refine(fit, near(fit, [7, 7, 0]) ** 0.05, 0.4)


def paired(fit, pair, *, degree=1):
    """The pair's operators, with symmetry planes."""
    V = fem.functionspace(fit.mesh, ("Lagrange", degree, (3,)))
    count = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:count]
    prescribed = np.zeros((count, 3), dtype=bool)
    prescribed[:, :2] = np.abs(x[:, :2]) < 1e-9
    return pair_surfaces(V, prescribed.ravel(), pair)


def error_of_gaps(found) -> float:
    """In the root mean square [mm]."""
    error = found.gap + INTERFERENCE
    square, area = reduce_array(MPI.COMM_WORLD, [found.weights @ error**2, found.weights.sum()])
    return float(np.sqrt(square / area))


@pytest.mark.parallel
@pytest.mark.parametrize("names", [("plate", "pin"), ("pin", "plate")])
def test_a_press_fit_keeps_its_interference(comm, names):
    """It is far less than the height of the surfaces over their facets, which must be known well.

    (In the root mean square to 1 %; with the mean of the facets' normals to 3 to 6 %.)
    """
    fit = press_fit(comm)
    secondary, primary = (fit.tags[f"{name}_contact"] for name in names)
    pair = ContactPair(fit.facet_tags, secondary, primary, Frictionless(), geometry={})
    assert error_of_gaps(paired(fit, pair)) <= 0.015 * SAGITTA


@pytest.mark.parallel(names=[("plate", "pin")], degree=[1], of_gmsh=[True])
@pytest.mark.parametrize("names", [("plate", "pin"), ("pin", "plate")])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("of_gmsh", [True, False])
def test_the_geometry_makes_it_exact(comm, names, degree, of_gmsh):
    """To a hundredth of the interference, and of what Gmsh's own kernel takes for nearest."""
    fit = press_fit(comm, of_gmsh=of_gmsh)
    secondary, primary = (fit.tags[f"{name}_contact"] for name in names)
    pair = ContactPair(fit.facet_tags, secondary, primary, Frictionless(), geometry=fit.geometry)
    assert (
        error_of_gaps(paired(fit, pair, degree=degree)) <= 0.01 * INTERFERENCE + of_gmsh * NEAREST
    )


@pytest.mark.parallel(names=[("plate", "pin")], of_gmsh=[True])
@pytest.mark.parametrize("names", [("plate", "pin"), ("pin", "plate")])
@pytest.mark.parametrize("of_gmsh", [True, False])
def test_each_tag_of_a_list_has_its_own_geometry(comm, names, of_gmsh):
    """The interference of one declaration for both bodies is that of the two cylinders."""
    fit = press_fit(comm, of_gmsh=of_gmsh)
    tags = [fit.tags[f"{name}_contact"] for name in names]
    pair = ContactPair(fit.facet_tags, tags, tags, Frictionless(), geometry=fit.geometry)
    pair = dataclasses.replace(pair, name="a copy of the pair")
    assert error_of_gaps(paired(fit, pair)) <= 0.01 * INTERFERENCE + of_gmsh * NEAREST


@pytest.mark.parallel
def test_errors_name_the_tags_of_a_list(comm):
    """Errors blame the tag whose facets or surface are wrong, not the first tag of the list."""
    fit = press_fit(comm)
    plate, pin = fit.tags["plate_contact"], fit.tags["pin_contact"]
    for tags, geometry, message in (
        ([plate, pin], {pin: on_cylinder(1e3 * RADIUS)}, f"facets with tag {pin} are not on"),
        ([pin, plate], {pin: on_cylinder(1e3 * RADIUS)}, f"facets with tag {pin} are not on"),
        ([plate, 99], None, "no facet has the tag 99"),
    ):
        with pytest.raises(InputError, match=message):
            paired(fit, ContactPair(fit.facet_tags, tags, tags, Frictionless(), geometry=geometry))


def test_facets_that_are_curved_themselves(comm, tmp_path):
    """Only what is left between them and the surface counts then."""
    geo = tmp_path / "curved.geo"
    geo.write_text(f'Include "{MESHES / "press_fit.geo"}"; Mesh.ElementOrder = 2;')
    fit = read_gmsh(geo, comm, N=CELLS, M=4, Hex=0, Thickness=8, Interference=INTERFERENCE)
    secondary, primary = fit.tags["plate_contact"], fit.tags["pin_contact"]
    pair = ContactPair(fit.facet_tags, secondary, primary, Frictionless(), geometry=fit.geometry)
    assert error_of_gaps(paired(fit, pair, degree=2)) <= 0.01 * INTERFERENCE + NEAREST


@pytest.mark.parallel
def test_close_fits_without_it_are_warned_of(comm, caplog):
    fit = press_fit(comm)
    secondary, primary = fit.tags["plate_contact"], fit.tags["pin_contact"]
    for geometry, count in ((fit.geometry, 0), ({}, int(comm.rank == 0))):
        pair = ContactPair(fit.facet_tags, secondary, primary, Frictionless(), geometry=geometry)
        paired(fit, pair)
        assert caplog.text.count("ContactPair(geometry=...)") == count


def test_bodies_that_touch_are_no_close_fit(comm, caplog):
    """A pin that lies in its hole: some nodes overlap by an error of the height over the facets."""
    play = 0.5  # mm
    pin_in_hole = {"N": CELLS, "M": 4, "Hex": 1, "Thickness": 8, "Interference": -play}
    fit = read_gmsh(MESHES / "press_fit.geo", comm, **pin_in_hole)
    pin = np.unique(geometry_dofmap(fit.mesh)[fit.cell_tags.find(fit.tags["pin"])])
    fit.mesh.geometry.x[pin, :2] += (play + 0.02 * SAGITTA) * np.sqrt(0.5)
    secondary, primary = fit.tags["plate_contact"], fit.tags["pin_contact"]
    pair = ContactPair(fit.facet_tags, secondary, primary, Frictionless(), geometry={})
    found = paired(fit, pair)
    assert -0.5 * SAGITTA < found.gap.min() < 0.0
    assert "ContactPair(geometry=...)" not in caplog.text


def test_an_adaptive_run_warns_once(comm, caplog, monkeypatch):
    """Of each pair that fits closely, and of K, not on each mesh; the next run warns again."""
    monkeypatch.setattr("dolfinx_tresca._base.parallel.RECENT_WARNINGS", warned := [])
    radii, rough = (1, 2, 3), {"stiffness": "multigrid", "petsc_options": {"ksp_max_it": 2}}
    bodies = [Body((1, 2 + r), [(r, r + 1.001), (0.0, 1.0)], move=quarter) for r in radii]
    rings = boxes(comm, "triangle", bodies)
    ends, inside, outside = 1, 10, 20
    marks = [(ends, [0, 1, 2], lambda x: abs(x[:, 1] - 0.5) > 0.5 - 1e-9)]
    for k, r in enumerate(radii):
        marks.append((inside + k, [k], lambda x, at=r: abs(x[:, 0] - at) < 1e-9))
        marks.append((outside + k, [k], lambda x, at=r + 1.001: abs(x[:, 0] - at) < 1e-9))
    first = TaggedMesh(rings.mesh, None, rings.tags(*marks), {})

    def build(tagged):
        V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
        tags = tagged.facet_tags
        pairs = [ContactPair(tags, inside + k, outside + k - 1, Frictionless()) for k in (1, 2)]
        return ContactProblem(elasticity(V, 1.0), None, pairs, [fixed(V, tags.find(ends))], **rough)

    for run in (1, 2):
        result = solve_adaptively(build, first, 1e-3, max_levels=3)
        assert len(result.levels) == 3
        for text in (caplog.text, "".join(warned)):
            assert text.count("ContactPair(geometry=...)") == 2 * run * (comm.rank == 0)
            assert text.count("the multigrid solver") == run * (comm.rank == 0)


def quarter(x):
    """Map radius and part of a quarter of a circle to the plane."""
    angle = -0.5 * np.pi * x[:, 1]
    return x[:, :1] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parallel
def test_geometry_that_is_not_that_of_the_facets(comm):
    fit = press_fit(comm)
    pin, plate = fit.tags["pin_contact"], fit.tags["plate_contact"]
    for geometry, message in (
        (7, "geometry must be read_gmsh"),
        ({"pin_contact": on_cylinder(RADIUS)}, "geometry must be read_gmsh"),
        ({pin: lambda x: x[:2]}, r"geometry\[2\d\] must give real points of shape \(3, "),
        ({plate: lambda x: np.nan * x}, r"geometry\[1\d\] gives no finite point next to"),
        ({plate: on_cylinder(1e3 * RADIUS)}, "not on their surface in `geometry`"),
    ):
        with pytest.raises(InputError, match=message):
            paired(fit, ContactPair(fit.facet_tags, pin, plate, Frictionless(), geometry=geometry))
