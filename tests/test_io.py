"""Files are read back and compared with the Functions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from demo_two_bricks import two_bricks
from patches import patch

import dolfinx
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactState,
    InputError,
    Tresca,
    io,
)
from dolfinx_tresca._base import compat

pytestmark = pytest.mark.parallel

N = 4
NODES, CELLS = 2 * (N + 1) * N**2, 2 * 6 * N * (N - 1) ** 2
SURFACE_NODES, SURFACE_CELLS = (N + 1) * N, 2 * N * (N - 1)
CONTACT = ("pressure", "traction", "slip", "gap", "state")
EPS = 64 * np.finfo(float).eps

Read = tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]


@pytest.fixture(scope="module")
def solution() -> ContactSolution:
    scene = two_bricks(MPI.COMM_WORLD, N)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        return problem.solve(rtol=1e-6)


def values_of(function: Any) -> np.ndarray:
    """Return the values (n, 1) or (n, 3) of this rank, with ghosts, as they are in files."""
    size = function.function_space.dofmap.bs
    return np.pad(function.x.array.reshape(-1, size), ((0, 0), (0, 3 - size if size > 1 else 0)))


def at_points(functions: Sequence[Any]) -> dict[tuple[float, ...], list[np.ndarray]]:
    """Return point -> the values there, of all ranks; where bodies touch, those of both."""
    space = functions[0].function_space
    owned = space.dofmap.index_map.size_local
    points = space.tabulate_dof_coordinates()[:owned]
    values = np.hstack([values_of(function)[:owned] for function in functions])
    result: dict[tuple[float, ...], list[np.ndarray]] = {}
    for part in space.mesh.comm.allgather(list(zip(points, values, strict=True))):
        for point, value in part:
            result.setdefault(tuple(np.round(point, 8) + 0.0), []).append(value)
    return result


def assert_same(read: Read, functions: Sequence[Any]) -> None:
    """Check that points and values of a file are those of the Functions, each once."""
    points, _, values = read
    assert list(values) == [f.name for f in functions]
    found = np.hstack([column.reshape(len(points), -1) for column in values.values()])
    wanted = at_points(functions)
    assert len(points) == sum(map(len, wanted.values()))
    scale = np.abs(found).max(axis=0)
    for point, value in zip(points, found, strict=True):
        candidates = wanted[tuple(np.round(point, 8) + 0.0)]
        match = [i for i, w in enumerate(candidates) if np.all(np.abs(w - value) <= EPS * scale)]
        assert match, (point, value, candidates)
        candidates.pop(match[0])
    assert not any(wanted.values())


def moments(read: Read) -> np.ndarray:
    """Return the integrals of 1, x, y, z over tetrahedra or triangles."""
    points, cells, _ = read
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    if cells.shape[1] == 3:
        size = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    else:
        size = np.abs(np.linalg.det(edges)) / 6
    return np.append(size.sum(), size @ points[cells].mean(axis=1))


def assert_solution(volume: Read, contact: Read, solution: ContactSolution) -> None:
    """Check both files of a solution: sizes, geometry, numbers."""
    assert (len(volume[0]), len(volume[1])) == (NODES, CELLS)
    assert (len(contact[0]), len(contact[1])) == (SURFACE_NODES, SURFACE_CELLS)
    np.testing.assert_allclose(moments(volume), [4.0, 4.0, 2.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(moments(contact), [2.0, 2.0, 1.0, 2.0], rtol=1e-12)
    for points, cells, _ in (volume, contact):
        assert set(cells.ravel()) == set(range(len(points)))
    np.testing.assert_allclose(contact[0][:, 2], 1.0, rtol=EPS)
    assert_same(volume, [solution.u])
    assert_same(contact, solution.surface.functions)
    pressed = contact[2]["state"] >= ContactState.STICK
    assert pressed.sum() == solution.counts.contact > 0
    assert np.all((contact[2]["pressure"] > 0.0) <= pressed.reshape(contact[2]["pressure"].shape))


def read_xdmf(path: Path) -> dict[str, Read]:
    """Return name of the grid -> points, cells, values."""
    h5py = pytest.importorskip("h5py")

    def data(item: ET.Element | None) -> np.ndarray:
        assert item is not None and item.text is not None
        file, dataset = item.text.split(":")
        with h5py.File(path.parent / file) as h5:
            values = np.asarray(h5[dataset])
        assert list(values.shape) == [int(n) for n in item.attrib["Dimensions"].split()]
        assert item.get("Precision") == str(values.dtype.itemsize)
        assert item.get("NumberType") == {"f": "Float", "i": "Int"}[values.dtype.kind]
        return values

    grids = ET.parse(path).getroot().findall("Domain/Grid")
    assert all(grid.get("GridType") == "Uniform" for grid in grids)
    return {
        grid.attrib["Name"]: (
            data(grid.find("Geometry/DataItem")),
            data(grid.find("Topology/DataItem")),
            {a.attrib["Name"]: data(a.find("DataItem")) for a in grid.findall("Attribute")},
        )
        for grid in grids
    }


def read_vtu(path: Path) -> Read:
    """Return points, cells, values."""
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(path)
    return (
        np.asarray(grid.points),
        np.asarray(grid.cells).reshape(grid.n_cells, -1)[:, 1:],
        {name: np.asarray(grid[name]) for name in grid.array_names},
    )


def test_xdmf(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    before = solution.u.function_space.mesh.name
    solution.write(folder / "new" / "bricks.xdmf")  # makes the folder
    assert solution.u.function_space.mesh.name == before
    grids = read_xdmf(folder / "new" / "bricks.xdmf")
    assert list(grids) == ["volume", "contact"]
    assert_solution(grids["volume"], grids["contact"], solution)


def test_vtu(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    solution.write(folder / "new" / "bricks.vtu")
    comm.barrier()
    volume = read_vtu(folder / "new" / "bricks.vtu")
    assert_solution(volume, read_vtu(folder / "new" / "bricks_contact.vtu"), solution)


def test_several_pairs(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    io.write(folder / "bricks.xdmf", solution.u, solution.surfaces * 2)
    io.write(folder / "bricks.vtu", solution.u, solution.surfaces * 2)
    comm.barrier()
    grids = read_xdmf(folder / "bricks.xdmf")
    assert list(grids) == ["volume", "contact_1", "contact_2"]
    for i in (1, 2):
        assert_solution(grids["volume"], grids[f"contact_{i}"], solution)
        file = read_vtu(folder / f"bricks_contact_{i}.vtu")
        assert_solution(grids["volume"], file, solution)


def assert_in_vtx(path: Path, functions: Sequence[Any]) -> None:
    """Check that names and values of Functions are in a file."""
    files = sorted(path.iterdir())
    # ADIOS2 has no reader in Python everywhere, but stores arrays as they are in memory
    content = b"".join(file.read_bytes() for file in files)
    assert b"VTKFile" in content
    for function in functions:
        assert f'Name="{function.name}"'.encode() in content
        assert values_of(function).tobytes() in content


@pytest.mark.skipif(not compat.has_adios2, reason="DOLFINx without ADIOS2")
def test_vtx(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    solution.write(folder / "bricks.bp")
    comm.barrier()
    assert_in_vtx(folder / "bricks.bp", [solution.u])
    assert_in_vtx(folder / "bricks_contact.bp", solution.surface.functions)


def arch(points: np.ndarray) -> np.ndarray:
    """Bend blocks along the first axis to parabolas; lines across stay straight, and the size."""
    bent = points.copy()
    axis = 2 if np.ptp(points[:, 2]) > 0.0 else 1
    bent[:, axis] += bow(points)
    return bent


def bow(points: np.ndarray) -> np.ndarray:
    return 0.4 * points[:, 0] * (1.0 - points[:, 0])


def in_degree(function: Any, degree: int) -> Any:
    """Return a Function interpolated to a degree."""
    V = fem.functionspace(function.function_space.mesh, ("Lagrange", degree, function.ufl_shape))
    result = fem.Function(V, name=function.name)
    result.interpolate(function)
    result.x.scatter_forward()
    return result


@pytest.mark.parametrize(
    ("kind", "degree", "geometry", "rubs"),
    [
        ("triangle", 1, 1, True),
        ("triangle", 2, 2, False),
        ("quadrilateral", 2, 1, False),
        ("quadrilateral", 1, 2, True),
        ("tetrahedron", 2, 1, True),
        ("hexahedron", 2, 2, False),
    ],
)
def test_cells_and_degrees(
    comm: MPI.Comm, folder: Path, kind: str, degree: int, geometry: int, rubs: bool
) -> None:
    """2D and 3D, degrees 1 and 2, straight and curved, with friction and without."""
    pyvista = pytest.importorskip("pyvista")
    scene = patch(
        comm,
        kind,
        degree,
        upper=(2, 1),
        lower=(3, 1),
        geometry=geometry,
        warp=arch if geometry == 2 else None,
        friction=Tresca(0.1) if rubs else None,
    )
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
    names = [name for name in CONTACT if rubs or name not in ("traction", "slip")]
    assert [f.name for f in solution.surface.functions] == names
    fine = [in_degree(solution.u, max(degree, geometry))]
    contact = [in_degree(function, geometry) for function in solution.surface.functions]

    solution.write(folder / "patch.xdmf")
    solution.write(folder / "patch.vtu")
    if compat.has_adios2:
        solution.write(folder / "patch.bp")
    comm.barrier()
    grids = read_xdmf(folder / "patch.xdmf")
    dim = scene.mesh.geometry.dim
    volume, surface = (
        (np.pad(points, ((0, 0), (0, 3 - dim))), cells, values)
        for points, cells, values in grids.values()
    )
    assert_same(volume, [in_degree(solution.u, geometry)])
    assert_same(surface, contact)
    assert volume[2]["displacement"].shape[1] == 3
    if geometry == 2:
        np.testing.assert_allclose(surface[0][:, dim - 1], 1.0 + bow(surface[0]), atol=1e-12)

    assert_same(read_vtu(folder / "patch.vtu"), fine)
    assert_same(read_vtu(folder / "patch_contact.vtu"), contact)
    sizes = pyvista.read(folder / "patch.vtu").compute_cell_sizes()
    assert sizes["Area" if dim == 2 else "Volume"].sum() == pytest.approx(2.0, rel=1e-4)

    if compat.has_adios2:
        assert_in_vtx(folder / "patch.bp", fine)
        assert_in_vtx(folder / "patch_contact.bp", contact)


def test_without_adios2(
    comm: MPI.Comm, folder: Path, solution: ContactSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compat, "has_adios2", False)
    with pytest.raises(InputError, match=r"ADIOS2.*write .xdmf or .vtu"):
        solution.write(folder / "bricks.bp")
    assert not (folder / "bricks.bp").exists()


@pytest.mark.parametrize("name", ["bricks.vtk", "bricks", "bricks.XDMF"])
def test_unknown_suffix(folder: Path, solution: ContactSolution, name: str) -> None:
    with pytest.raises(InputError, match=r"\.xdmf, \.vtu, \.bp.*bricks"):
        solution.write(folder / name)


@pytest.mark.parametrize("suffix", [".xdmf", ".vtu", ".bp"])
def test_folder_is_a_file(
    comm: MPI.Comm, folder: Path, solution: ContactSolution, suffix: str
) -> None:
    if suffix == ".bp" and not compat.has_adios2:
        pytest.skip("DOLFINx without ADIOS2")
    (folder / "taken").touch()
    comm.barrier()
    with pytest.raises(InputError, match="cannot write"):  # on all ranks, or the run hangs
        solution.write(folder / "taken" / f"bricks{suffix}")


@pytest.mark.parametrize("suffix", [".xdmf", ".vtu"])
def test_file_is_a_folder(
    comm: MPI.Comm, folder: Path, solution: ContactSolution, suffix: str
) -> None:
    (folder / f"bricks{suffix}").mkdir(exist_ok=True)
    comm.barrier()
    with pytest.raises(InputError, match="cannot write"):
        solution.write(folder / f"bricks{suffix}")


def test_vtu_without_pyvista(
    folder: Path, solution: ContactSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyvista", None)  # import fails
    with pytest.raises(ContactError, match="pyvista"):
        solution.write(folder / "bricks.vtu")


@pytest.mark.parametrize("suffix", [".xdmf", ".vtu", ".bp"])
def test_the_error_of_the_mesh_is_a_field_of_cells(
    comm: MPI.Comm, folder: Path, suffix: str
) -> None:
    """The same values as in the Function, each in its cell; VTX has no place for it."""
    if suffix == ".bp" and not compat.has_adios2:
        pytest.skip("this DOLFINx has no ADIOS2")
    scene = two_bricks(comm, N)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        solution = problem.solve()
    cells = solution.cell_errors
    assert cells is not None
    solution.write(folder / f"errors{suffix}")
    topology = scene.V.mesh.topology
    owned = topology.index_map(topology.dim).size_local
    here = dolfinx.mesh.compute_midpoints(
        scene.V.mesh, topology.dim, np.arange(owned, dtype=np.int32)
    )
    parts = comm.gather((here, cells.x.array[:owned]), root=0)
    if parts is None or suffix == ".bp":
        return
    file = folder / f"errors{suffix}"
    nodes, tetrahedra, fields = read_vtu(file) if suffix == ".vtu" else read_xdmf(file)["volume"]
    middles, found = nodes[tetrahedra].mean(axis=1), fields["discretisation_error"].ravel()
    if suffix == ".xdmf":
        attribute = ET.parse(file).find(".//Attribute[@Name='discretisation_error']")
        assert attribute is not None
        assert attribute.get("Center") == "Cell"
    points, values = (np.concatenate(column) for column in zip(*parts, strict=True))
    order, there = (np.lexsort(np.round(x, 9).T) for x in (points, middles))
    assert np.allclose(middles[there], points[order], atol=1e-12)
    assert np.allclose(found[there], values[order], rtol=EPS, atol=0.0)
