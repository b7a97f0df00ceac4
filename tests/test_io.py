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

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactState,
    InputError,
    _compat,
    io,
)

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
        return problem.solve()


def at_points(functions: Sequence[Any]) -> dict[tuple[float, ...], list[np.ndarray]]:
    """Return point -> the values there, of all ranks; where bodies touch, those of both."""
    space = functions[0].function_space
    owned = space.dofmap.index_map.size_local
    points = space.tabulate_dof_coordinates()[:owned]
    blocks = [f.x.array.reshape(-1, f.function_space.dofmap.bs)[:owned] for f in functions]
    values = np.hstack(blocks)
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
    (cells,) = grid.cells_dict.values()
    return (
        np.asarray(grid.points),
        cells,
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


@pytest.mark.skipif(not _compat.has_adios2, reason="DOLFINx without ADIOS2")
def test_vtx(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    solution.write(folder / "bricks.bp")
    comm.barrier()
    for name, functions in (
        ("bricks", [solution.u]),
        ("bricks_contact", solution.surface.functions),
    ):
        files = sorted((folder / f"{name}.bp").iterdir())
        # ADIOS2 has no reader in Python everywhere, but stores arrays as they are in memory
        content = b"".join(file.read_bytes() for file in files)
        assert b"VTKFile" in content
        for function in functions:
            assert f'Name="{function.name}"'.encode() in content
            assert function.x.array.tobytes() in content


def test_without_adios2(
    comm: MPI.Comm, folder: Path, solution: ContactSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_compat, "has_adios2", False)
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
    if suffix == ".bp" and not _compat.has_adios2:
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
