"""Refined meshes: tags, nodes on curved surfaces, ranks, and what is wrong with arguments."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from logged import logged

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import MESHES, InputError, TaggedMesh, read_gmsh, refine
from dolfinx_tresca._base.compat import geometry_dofmap
from scenes.scene import EPS

TOP = 5  #: tag of the top of `square`


def middles(tagged: TaggedMesh) -> np.ndarray:
    """Middles (n, 3) of the cells that this rank owns."""
    mesh = tagged.mesh
    count = mesh.topology.index_map(mesh.topology.dim).size_local
    return mesh.geometry.x[geometry_dofmap(mesh)[:count]].mean(axis=1)


def all_middles(tagged: TaggedMesh) -> np.ndarray:
    """Those of all ranks, sorted."""
    x = np.concatenate(tagged.mesh.comm.allgather(middles(tagged)))
    return x[np.lexsort(np.round(x, 9).T)]


def near(tagged: TaggedMesh, point) -> np.ndarray:
    """Errors of the cells of this rank that are large near a point."""
    return np.exp(-3.0 * np.linalg.norm(middles(tagged) - point, axis=1))


def sizes(tagged: TaggedMesh) -> np.ndarray:
    """Volume and area of all that has a tag, by the name of the tag."""
    mesh = tagged.mesh
    result = []
    for kind, tags in (("dx", tagged.cell_tags), ("ds", tagged.facet_tags)):
        measure = ufl.Measure(kind, domain=mesh, subdomain_data=tags)
        for tag in tagged.tags.values():
            form = fem.form(fem.Constant(mesh, 1.0) * measure(tag))
            result.append(mesh.comm.allreduce(fem.assemble_scalar(form)))
    return np.array(result)


def square(comm, n: int = 4, **options) -> TaggedMesh:
    """The unit square: its left half is tagged, its top, and a line in its middle."""
    mesh = dolfinx.mesh.create_unit_square(comm, n, n, **options)
    mesh.topology.create_connectivity(1, 2)
    left = dolfinx.mesh.locate_entities(mesh, 2, lambda x: x[0] < 0.5 + 1e-9)
    top = dolfinx.mesh.locate_entities(mesh, 1, lambda x: x[1] > 1 - 1e-9)
    line = dolfinx.mesh.locate_entities(mesh, 1, lambda x: np.abs(x[0] - 0.5) < 1e-9)
    facets = np.concatenate([top, line])
    values = np.repeat([5, 6], [len(top), len(line)]).astype(np.int32)
    order = np.argsort(facets)
    return TaggedMesh(
        mesh,
        dolfinx.mesh.meshtags(mesh, 2, left, np.full(len(left), 4, dtype=np.int32)),
        dolfinx.mesh.meshtags(mesh, 1, facets[order], values[order]),
        {"left": 4, "top": 5, "line": 6},
    )


def half_disc(comm, **parameters) -> TaggedMesh:
    return read_gmsh(MESHES / "half_disc.geo", comm, h=0.1, Zone=0.2, Growth=0.5, **parameters)


def bricks(comm, N: int = 3) -> TaggedMesh:
    return read_gmsh(MESHES / "two_bricks.geo", comm, N=N)


@pytest.mark.parallel
def test_volumes_and_areas_of_all_tags_stay(comm):
    before = bricks(comm)
    refined = refine(before, near(before, [0, 0, 1]), 0.2)
    refined = refine(refined, near(refined, [0, 0, 1]), 0.2)
    assert refined.tags == before.tags
    assert len(all_middles(refined)) > len(all_middles(before))
    assert np.allclose(sizes(refined), sizes(before), rtol=1e-12)


@pytest.mark.parallel
def test_lines_inside_and_cells_without_a_tag(comm):
    before = square(comm)
    refined = refine(before, near(before, [0.5, 0.5, 0]), 0.3)
    line = ufl.Measure("dS", domain=refined.mesh, subdomain_data=refined.facet_tags)(6)
    one = fem.Constant(refined.mesh, 1.0)
    length = comm.allreduce(fem.assemble_scalar(fem.form(one("+") * line)))
    assert length == pytest.approx(1.0, rel=1e-12)
    assert np.allclose(sizes(refined), sizes(before), rtol=1e-12)
    left = refined.cell_tags.find(4)
    left = left[left < len(middles(refined))]
    assert np.array_equal(np.sort(left), np.flatnonzero(middles(refined)[:, 0] < 0.5))


@pytest.mark.parallel
@pytest.mark.parametrize("make", [bricks, square, half_disc])
def test_the_same_mesh_on_any_number_of_ranks(comm, make):
    """Up to its numbering; edges of equal length are cut alike."""
    meshes = []
    for ranks in (comm, MPI.COMM_SELF):
        tagged = make(ranks)
        for _ in range(3):
            tagged = refine(tagged, near(tagged, [0.4, 0.3, 0]), 0.3)
        meshes.append(all_middles(tagged))
    assert meshes[0].shape == meshes[1].shape
    assert np.abs(meshes[0] - meshes[1]).max() <= 32 * EPS


@pytest.mark.parallel
def test_marked_cells_are_cut_and_others_are_conforming(comm):
    before = square(comm)
    errors = near(before, [0.1, 0.2, 0])
    refined = refine(before, errors, 0.1)
    largest = comm.allreduce(errors.max(initial=0.0), op=MPI.MAX)
    corners = before.mesh.geometry.x[geometry_dofmap(before.mesh)[: len(errors)]]
    worst = np.concatenate(comm.allgather(corners[errors == largest]))[0, :, :2]
    sides = np.stack([worst[1] - worst[0], worst[2] - worst[0]], axis=1)
    parts = np.linalg.solve(sides, (all_middles(refined)[:, :2] - worst[0]).T)
    inside = (parts.min(axis=0) > 0.0) & (parts.sum(axis=0) < 1.0)
    assert inside.sum() == 4  # all of its edges were cut
    # every inner edge has two cells: the length of the boundary is that of the square
    length = fem.form(fem.Constant(refined.mesh, 1.0) * ufl.ds(domain=refined.mesh))
    assert comm.allreduce(fem.assemble_scalar(length)) == pytest.approx(4.0, rel=1e-12)


@pytest.mark.parallel
def test_ghost_cells_as_before(comm):
    for mode in (dolfinx.mesh.GhostMode.none, dolfinx.mesh.GhostMode.shared_facet):
        before = square(comm, ghost_mode=mode)
        after = refine(before, near(before, [0.5, 0.5, 0]))
        ghosts = [
            comm.allreduce(tagged.mesh.topology.index_map(2).num_ghosts) > 0
            for tagged in (before, after)
        ]
        wanted = comm.size > 1 and mode is dolfinx.mesh.GhostMode.shared_facet
        assert ghosts == [wanted, wanted]
        assert np.allclose(sizes(after), sizes(before), rtol=1e-12)


def test_cells_may_become_very_small(comm):
    """And they stay as round as they are."""
    tagged = square(comm, 2)
    for _ in range(40):
        tagged = refine(tagged, np.linalg.norm(middles(tagged), axis=1) ** -9.0)
    assert np.linalg.norm(all_middles(tagged), axis=1).min() < 2.0**-40
    x = tagged.mesh.geometry.x[geometry_dofmap(tagged.mesh)]
    sides = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2)
    assert (sides.max(axis=1) / sides.min(axis=1)).max() <= 2.0


def on_ball(x: np.ndarray) -> np.ndarray:
    """The sphere of radius 1 around (0, 0, 1)."""
    centre = np.array([[0.0], [0.0], [1.0]])
    return centre + (x - centre) / np.linalg.norm(x - centre, axis=0)


def nodes_of(tagged: TaggedMesh, name: str) -> np.ndarray:
    """Points (n, 3) of the facets with a tag that this rank has."""
    mesh, dim = tagged.mesh, tagged.facet_tags.dim
    mesh.topology.create_connectivity(dim, dim + 1)
    facets = tagged.facet_tags.find(tagged.tags[name])
    if len(facets) == 0:  # DOLFINx 0.9 divides by it
        return np.zeros((0, 3))
    nodes = dolfinx.mesh.entities_to_geometry(mesh, dim, facets)
    return mesh.geometry.x[np.unique(nodes)]


@pytest.mark.parallel
def test_nodes_of_a_snapped_sphere_are_on_it(comm):
    tagged = read_gmsh(MESHES / "sphere_octant.geo", comm, h=0.15, Zone=0.3, Growth=0.6)
    plain = refine(replace(tagged, geometry=None), near(tagged, [0, 0, 0]))
    centre = np.array([0.0, 0.0, 1.0])
    off = np.abs(np.linalg.norm(nodes_of(plain, "upper_contact") - centre, axis=1) - 1.0)
    assert comm.allreduce(off.max(initial=0.0), op=MPI.MAX) > 1e-4
    tagged = replace(tagged, geometry={tagged.tags["upper_contact"]: on_ball})
    for _ in range(2):
        tagged = refine(tagged, near(tagged, [0, 0, 0]))
        off = np.abs(np.linalg.norm(nodes_of(tagged, "upper_contact") - centre, axis=1) - 1.0)
        assert off.max(initial=0.0) <= 32 * EPS  # of coordinates up to 2
        # nodes in the planes of symmetry stay there: their areas differ by slivers at the sphere
        flat = nodes_of(tagged, "upper_x")
        assert np.abs(flat[:, 0]).max(initial=0.0) <= 32 * EPS


@pytest.mark.parallel
def test_cells_that_would_turn_inside_out_keep_their_nodes(comm, caplog):
    """The top of a square is to sag deeper than the cells below it are high."""
    before = square(comm, 2)

    def sagging(x):
        return np.stack([x[0], 1.0 - 0.9 * np.exp(-50.0 * (x[0] - 0.25) ** 2), x[2]])

    with caplog.at_level("WARNING"):
        known = replace(before, geometry={before.tags["top"]: sagging})
        refined = refine(known, np.ones(len(middles(before))))
    if comm.rank == 0:
        assert "nodes were not moved to their curved surface" in logged(caplog)
    x = refined.mesh.geometry.x[geometry_dofmap(refined.mesh)]
    areas = np.abs(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])[:, 2])
    assert areas.min(initial=1.0) > 0.1 * 0.25**2


FAULTS = {
    "too few": (lambda t: np.ones(len(middles(t)) - 1), {}, r"shape \(\d+,\), one for each cell"),
    "matrix": (lambda t: np.ones((len(middles(t)), 1)), {}, "found float64 of shape"),
    "words": (lambda t: np.full(len(middles(t)), "a"), {}, "real numbers"),
    "nan": (lambda t: np.full(len(middles(t)), np.nan), {}, "finite and not negative, found nan"),
    "negative": (lambda t: -np.ones(len(middles(t))), {}, "not negative, found -1"),
    "zero": (lambda t: np.zeros(len(middles(t))), {}, "all zero: there is nothing to refine"),
    "none": (lambda t: None, {}, 'accuracy="balanced"'),
    "fraction 0": (None, {"fraction": 0.0}, r"fraction must be a number in \(0, 1\], found 0"),
    "fraction 2": (None, {"fraction": 2}, r"in \(0, 1\], found 2"),
    "fraction nan": (None, {"fraction": np.nan}, r"in \(0, 1\], found nan"),
    "fraction word": (None, {"fraction": "half"}, r"in \(0, 1\], found 'half'"),
    "geometry": (None, {"geometry": on_ball}, "geometry must be read_gmsh"),
    "geometry name": (None, {"geometry": {"top": on_ball}}, "geometry must be read_gmsh"),
    "geometry number": (None, {"geometry": {17: on_ball}}, "none has the tag 17"),
    "geometry value": (None, {"geometry": {TOP: 1.0}}, "geometry must be read_gmsh"),
    "geometry shape": (None, {"geometry": {TOP: lambda x: x[:2]}}, r"points of shape \(3, "),
    "geometry nan": (None, {"geometry": {TOP: lambda x: np.nan * x}}, "no finite point next to"),
}


@pytest.mark.parallel
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named_on_all_ranks(comm, fault):
    errors, options, message = FAULTS[fault]
    options = dict(options)
    tagged = square(comm)
    tagged = replace(tagged, geometry=options.pop("geometry", None))
    with pytest.raises(InputError, match=message):
        refine(tagged, (errors or (lambda t: np.ones(len(middles(t)))))(tagged), **options)


@pytest.mark.parallel
def test_what_fails_on_one_rank_fails_on_all(comm):
    tagged = square(comm)
    errors = np.ones(len(middles(tagged)))
    if comm.rank == comm.size - 1:
        errors[:1] = np.inf
    with pytest.raises(InputError, match="finite"):
        refine(tagged, errors)

    def fails(x):
        raise ZeroDivisionError("of the user's")

    with pytest.raises(ZeroDivisionError, match="of the user's"):
        refine(replace(tagged, geometry={TOP: fails}), np.ones(len(errors)))


def test_what_is_no_mesh_with_tags(comm):
    tagged = square(comm)
    for wrong in (tagged.mesh, None):
        with pytest.raises(InputError, match=r"tagged_mesh must be .*\(mesh, cell_tags,"):
            refine(wrong, np.ones(1))
    for name, wrong, message in (
        ("facet_tags", None, "dimension 1, found None"),
        ("facet_tags", tagged.cell_tags, "dimension 1, found those of dimension 2"),
        ("cell_tags", tagged.facet_tags, "dimension 2, found those of dimension 1"),
    ):
        with pytest.raises(InputError, match=f"{name} must be MeshTags of {message}"):
            refine(dataclasses.replace(tagged, **{name: wrong}), np.ones(len(middles(tagged))))


def test_functions_of_other_spaces(comm):
    tagged = square(comm)
    other = fem.Function(fem.functionspace(square(comm).mesh, ("DG", 0)))
    with pytest.raises(InputError, match="belong to another mesh"):
        refine(tagged, other)
    with pytest.raises(InputError, match="one value in each cell"):
        refine(tagged, fem.Function(fem.functionspace(tagged.mesh, ("Lagrange", 1))))


def test_cells_that_cannot_be_bisected(comm):
    boxes = read_gmsh(MESHES / "two_bricks.geo", comm, N=2, Hex=1)
    with pytest.raises(InputError, match="type hexahedron in 3D"):
        refine(boxes, np.ones(len(middles(boxes))))
    curved = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 2, shape=(2,)))
    x = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0, 0.5], [0.5, 0]], dtype=float)
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells=np.arange(6)[None], x=x, e=curved)
    none = dolfinx.mesh.meshtags(mesh, 1, np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    tagged = TaggedMesh(mesh, none, none, {})
    with pytest.raises(InputError, match="found 6 nodes in each"):
        refine(tagged, np.ones(1))
