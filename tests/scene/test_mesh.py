"""Reading Gmsh files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dolfinx

from dolfinx_tresca import MESHES, InputError, MeshError, read_gmsh

pytestmark = pytest.mark.parallel

BOX = """
SetFactory("OpenCASCADE");
DefineConstant[ size = {0.5, Name "cells"} ];
Box(1) = {0, 0, 0, 1, 1, 1};
MeshSize{ PointsOf{ Volume{1}; } } = size;
"""
GROUPS = 'Physical Volume("body", 7) = {1}; Physical Surface("left", 3) = {1};\n'
BRICKS = MESHES / "two_bricks.geo"


def write_file(comm, folder: Path, name: str, text: str) -> Path:
    """Write a file on the first rank and return its path."""
    if comm.rank == 0:
        (folder / name).write_text(text)
    comm.barrier()
    return folder / name


def cell_count(bricks) -> int:
    return bricks.mesh.topology.index_map(3).size_global


def test_names_tags_and_numbers(comm):
    bricks = read_gmsh(BRICKS, comm, N=3)
    assert bricks.tags == {
        "lower": 1, "upper": 2, "lower_fixed": 11, "lower_contact": 12, "lower_free_end": 13,
        "upper_fixed": 21, "upper_contact": 22, "upper_free_end": 23, "upper_top": 24,
    }  # fmt: skip
    assert bricks.facet_tags.dim == 2 and bricks.cell_tags.dim == 3
    assert bricks.mesh.topology.cell_type == dolfinx.mesh.CellType.tetrahedron
    assert cell_count(bricks) % (2 * 3 * 2 * 2) == 0
    owned = bricks.mesh.topology.index_map(3).size_local
    marked = [comm.allreduce(int((bricks.cell_tags.find(t) < owned).sum())) for t in (1, 2)]
    assert marked[0] == marked[1] == cell_count(bricks) // 2


def test_msh_file_gives_the_same_mesh_as_its_geo_file(comm, folder):
    if comm.rank == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(BRICKS))
        gmsh.model.mesh.generate(3)
        gmsh.write(str(folder / "bricks.msh"))
        gmsh.finalize()
    comm.barrier()
    from_msh, from_geo = read_gmsh(folder / "bricks.msh", comm), read_gmsh(BRICKS, comm)
    assert from_msh.tags == from_geo.tags
    assert cell_count(from_msh) == cell_count(from_geo)


def test_unnamed_groups_are_listed_by_number(comm, folder):
    text = BOX + "Physical Volume(7) = {1}; Physical Surface(3) = {1};\n"
    assert read_gmsh(write_file(comm, folder, "box.geo", text), comm).tags == {"7": 7, "3": 3}


def test_parameters_change_the_mesh(comm, folder):
    path = write_file(comm, folder, "box.geo", BOX + GROUPS)
    assert cell_count(read_gmsh(path, comm, size=0.2)) > cell_count(read_gmsh(path, comm)) > 0
    assert np.isclose(
        cell_count(read_gmsh(path, comm, size=0.5)), cell_count(read_gmsh(path, comm))
    )


@pytest.mark.parametrize("name", ["a b; $(touch x)", '"quoted"', "it's"])
def test_special_characters_in_the_path(comm, folder, name):
    if comm.rank == 0:
        (folder / name).mkdir()
    comm.barrier()
    path = write_file(comm, folder / name, "box & .geo", BOX + GROUPS)
    assert cell_count(read_gmsh(path, comm, size=0.9)) > 0


#: Two triangles with gaps between the node numbers; the first and the last node have no triangle.
TRIANGLES = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
6
5 9 9 0
10 0 0 0
20 1 0 0
30 1 1 0
40 0 1 0
50 5 5 0
$EndNodes
$Elements
3
1 1 2 1 1 30 40
2 2 2 2 1 10 20 30
3 2 2 2 1 10 30 40
$EndElements
"""


def test_node_numbers_with_gaps(comm, folder):
    square = read_gmsh(write_file(comm, folder, "square.msh", TRIANGLES), comm)
    points = np.concatenate(comm.allgather(square.mesh.geometry.x))
    assert np.array_equal(np.unique(points, axis=0), [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]])
    owned = square.mesh.topology.index_map(1).size_local
    assert comm.allreduce(int((square.facet_tags.find(1) < owned).sum())) == 1


def test_facets_off_the_cells_are_an_error(comm):
    """Gmsh merges a node of foot and clay here, and facets keep the node that is dropped."""
    with pytest.raises(MeshError, match=r"facets of group clay_contact .* not faces of a cell"):
        read_gmsh(MESHES / "floating_block.geo", comm, N=4, M=4, Hex=0)


FAULTS = {
    "unknown parameter": ("box.geo", BOX + GROUPS, {"sise": 1.0}, InputError, "no parameter sise"),
    "parameter not a number": ("box.geo", BOX + GROUPS, {"size": np.nan}, InputError, "size.*nan"),
    "parameter overwritten": (
        "box.geo",
        BOX + "size = 0.4;\n" + GROUPS,
        {"size": 0.3},
        InputError,
        "sets size = 0.4 itself",
    ),
    "parameter of a finished mesh": (
        "box.msh",
        TRIANGLES,
        {"size": 0.3},
        InputError,
        "no parameters",
    ),
    "no facets": (
        "box.geo",
        BOX + 'Physical Volume("body") = {1};\n',
        {},
        MeshError,
        "no physical group of facets",
    ),
    "no cells": (
        "box.geo",
        BOX + 'Physical Surface("left") = {1};\n',
        {},
        MeshError,
        "no physical group of cells",
    ),
    "no groups": ("box.geo", BOX, {}, MeshError, "no physical group"),
    "one name for two groups": (
        "box.geo",
        BOX + 'Physical Volume("a", 7) = {1}; Physical Surface("a", 3) = {1};\n',
        {},
        MeshError,
        "name a for two groups",
    ),
    "a face that two bodies share": (
        "box.geo",
        BOX
        + "Box(2) = {1, 0, 0, 1, 1, 1}; Coherence;\n"
        + 'Physical Volume("bodies") = {1, 2};\n'
        + 'Physical Surface("upper") = {2}; Physical Surface("lower") = {2};\n',
        {},
        MeshError,
        r"facets in .* are in two groups, upper and lower: .* between two bodies that share",
    ),
    "a face in two groups": (
        "box.geo",
        BOX + GROUPS + 'Physical Surface("also_left") = {1};\n',
        {},
        MeshError,
        r"are in two groups, left and also_left: a facet has one tag",
    ),
    "body in no group": (
        "box.geo",
        BOX + "Box(2) = {2, 0, 0, 1, 1, 1};\n" + GROUPS.replace("= {1};", "= {2};", 1),
        {},
        MeshError,
        r"facets of group left in .* are not faces of a cell",
    ),
    "not a geometry": ("box.geo", "Box(1 = {;\n", {}, MeshError, "Gmsh cannot use"),
    "not a mesh": ("box.msh", "nonsense\n", {}, MeshError, "box.msh"),
    "unknown kind of file": ("box.stl", "", {}, InputError, r"\.geo, \.msh, \.step"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_file_raises_on_all_ranks(comm, folder, fault):
    name, text, parameters, kind, message = FAULTS[fault]
    path = write_file(comm, folder, name, text)
    with pytest.raises(kind, match=message) as caught:
        read_gmsh(path, comm, **parameters)
    assert name in str(caught.value) or fault == "unknown kind of file"


def test_unknown_parameter_names_those_that_can_be_set(comm):
    """The file has 21 variables, of which it declares 4."""
    with pytest.raises(InputError, match="no parameter Size") as caught:
        read_gmsh(MESHES / "two_bricks.geo", comm, N=2, Size=1.0)
    assert str(caught.value).endswith("its parameters are Hex, N, Offset, Shift.")


def test_missing_file_is_named(comm, folder):
    with pytest.raises(MeshError, match=r"no file '.*absent\.geo'"):
        read_gmsh(folder / "absent.geo", comm)


def test_gmsh_session_of_the_user_stays_open(comm):
    gmsh = None
    if comm.rank == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
    try:
        read_gmsh(BRICKS, comm, N=2)
        if gmsh is not None:
            assert gmsh.isInitialized()
    finally:
        if gmsh is not None:
            gmsh.finalize()


def test_arguments_of_wrong_types(comm):
    for path in (None, 3, b"two_bricks.geo", [BRICKS]):
        with pytest.raises(
            InputError, match=r"path must be the path of a file, gmsh\.model, or .*, found"
        ):
            read_gmsh(path, comm)
    for wrong in (None, 3, "world"):
        with pytest.raises(InputError, match="comm must be an MPI communicator"):
            read_gmsh(BRICKS, wrong)
    for value in (None, "4", 1j, [4]):
        with pytest.raises(InputError, match=r"parameter N .*must be a finite number, found"):
            read_gmsh(BRICKS, comm, N=value)
