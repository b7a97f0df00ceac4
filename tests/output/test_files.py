"""Files are read back and compared with the Functions."""

from __future__ import annotations

import dataclasses
import resource
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactState,
    InputError,
    SolutionWriter,
    Tresca,
)
from scenes.patches import patch
from scenes.two_bricks import two_bricks

pytestmark = pytest.mark.parallel

N = 4
NODES, CELLS = 2 * (N + 1) * N**2, 2 * 6 * N * (N - 1) ** 2
SURFACE_NODES, SURFACE_CELLS = (N + 1) * N, 2 * N * (N - 1)
CONTACT = ("displacement", "pressure", "traction", "slip", "gap", "state", "normal")
EPS = 64 * np.finfo(float).eps


class Read(NamedTuple):
    """A grid in a file."""

    points: np.ndarray
    cells: np.ndarray
    values: dict[str, np.ndarray]  # at points
    cell_values: dict[str, np.ndarray]


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
    """Check that points and values of a file are those of the Functions, in pieces or not."""
    points, values = read.points, read.values
    assert list(values) == [f.name for f in functions]
    found = np.hstack([column.reshape(len(points), -1) for column in values.values()])
    wanted = at_points(functions)
    scale = np.abs(found).max(axis=0)
    seen = set()
    for point, value in zip(points, found, strict=True):
        place = tuple(np.round(point, 8) + 0.0)
        match = [i for i, w in enumerate(wanted[place]) if np.all(np.abs(w - value) <= EPS * scale)]
        assert match, (point, value, wanted[place])
        seen |= {(place, i) for i in match}
    assert len(seen) == sum(map(len, wanted.values()))


def moments(read: Read) -> np.ndarray:
    """Return the integrals of 1, x, y, z over tetrahedra or triangles."""
    points, cells = read.points, read.cells
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    if cells.shape[1] == 3:
        size = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    else:
        size = np.abs(np.linalg.det(edges)) / 6
    return np.append(size.sum(), size @ points[cells].mean(axis=1))


def assert_solution(volume: Read, contact: Read, solution: ContactSolution) -> None:
    """Check both files of a solution: sizes, geometry, numbers."""
    assert (len(volume.cells), len(contact.cells)) == (CELLS, SURFACE_CELLS)
    np.testing.assert_allclose(moments(volume), [4.0, 4.0, 2.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(moments(contact), [2.0, 2.0, 1.0, 2.0], rtol=1e-12)
    for grid in (volume, contact):
        assert set(grid.cells.ravel()) == set(range(len(grid.points)))
    np.testing.assert_allclose(contact.points[:, 2], 1.0, rtol=EPS)
    assert_same(volume, [solution.u])
    assert_same(contact, solution.surface.functions)
    bodies = volume.cell_values["body"].ravel()
    middles = volume.points[volume.cells].mean(axis=1)
    np.testing.assert_array_equal(bodies, np.where(middles[:, 2] < 1.0, 1, 2))


def assert_each_once(volume: Read, contact: Read, solution: ContactSolution) -> None:
    """Check the same of files that have each node once."""
    assert_solution(volume, contact, solution)
    assert (len(volume.points), len(contact.points)) == (NODES, SURFACE_NODES)
    pressed = contact.values["state"] >= ContactState.PRESSED
    assert pressed.sum() == solution.counts.contact > 0
    assert np.all((contact.values["pressure"] > 0.0).ravel() <= pressed.ravel())


def read_vtu(path: Path) -> Read:
    """Return what is in a `.vtu`."""
    pyvista = pytest.importorskip("pyvista")
    return of_pyvista(pyvista.read(path))


def of_pyvista(grid: Any) -> Read:
    return Read(
        np.asarray(grid.points),
        np.asarray(grid.cells).reshape(grid.n_cells, -1)[:, 1:],
        {name: np.asarray(grid.point_data[name]) for name in grid.point_data},
        {name: np.asarray(grid.cell_data[name]) for name in grid.cell_data},
    )


class DataSet(NamedTuple):
    """A grid in a series."""

    time: float
    name: str
    file: str


def read_pvd(path: Path) -> list[DataSet]:
    """Return the grids of a series."""
    return [
        DataSet(float(item.attrib["timestep"]), item.attrib["name"], item.attrib["file"])
        for item in ET.parse(path).iter("DataSet")
    ]


def read_series(path: Path) -> dict[float, dict[str, Read]]:
    """Return time -> name of the block -> what is in its file."""
    steps: dict[float, dict[str, Read]] = {}
    for time, name, file in read_pvd(path):
        steps.setdefault(time, {})[name] = read_vtu(path.parent / file)
    return steps


def times(path: Path) -> list[float]:
    """Return the times of a series, and check that no other files are there. Collective."""
    found = read_pvd(path)
    if MPI.COMM_WORLD.rank == 0:
        assert all((path.parent / data.file).exists() for data in found)
        folders = {Path(data.file).parent.name for data in found}
        there = {folder.name for folder in path.with_suffix("").iterdir()}
        assert there == folders | {"state.json"}
        assert not list(path.parent.glob("*.new*"))
    MPI.COMM_WORLD.barrier()
    return list(dict.fromkeys(data.time for data in found))


def test_pvd(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    """The first rank writes the same grid for any number of ranks."""
    solution.write(folder / "new" / "bricks.pvd")
    ((time, grids),) = read_series(folder / "new" / "bricks.pvd").items()
    assert (time, list(grids)) == (0.0, ["volume", "contact"])
    assert_solution(grids["volume"], grids["contact"], solution)
    assert grids["contact"].values["state"].dtype == np.int32
    assert_each_once(grids["volume"], grids["contact"], solution)


def test_to_pyvista(comm: MPI.Comm, solution: ContactSolution) -> None:
    """The whole model on the first rank, nothing on others."""
    pytest.importorskip("pyvista")
    blocks = solution.to_pyvista(fields=[two_bricks_tags(solution)])
    assert (blocks is None) == (comm.rank > 0)
    if blocks is None:
        blocks = {"volume": None, "contact": None}
    read = comm.bcast([blocks[name] and of_pyvista(blocks[name]) for name in ("volume", "contact")])
    assert_each_once(*read, solution)
    assert set(read[0].cell_values) == {"body", "thirds"}


def two_bricks_tags(solution: ContactSolution) -> Any:
    """Return tags of some cells: 7 in the first third of the length."""
    mesh = solution.u.function_space.mesh
    cells = dolfinx.mesh.locate_entities(mesh, 3, lambda x: x[0] <= 2 / 3 + 1e-9)
    tags = dolfinx.mesh.meshtags(mesh, 3, cells, np.full(len(cells), 7, dtype=np.int32))
    tags.name = "thirds"
    return tags


def test_several_pairs(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    surfaces = [
        dataclasses.replace(solution.surface, name=name) for name in ("rod on hole 1", "volume")
    ]
    twice = dataclasses.replace(solution, surfaces=tuple(surfaces))
    names = ["volume", "rod_on_hole_1", "volume_2"]
    twice.write(folder / "bricks.pvd")
    grids = read_series(folder / "bricks.pvd")[0.0]
    assert list(grids) == names
    for name in names[1:]:
        assert_solution(grids["volume"], grids[name], solution)


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
def test_cells_and_degrees(comm, folder, kind, degree, geometry, rubs):
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

    solution.write(folder / "patch.pvd")
    volume, surface = read_series(folder / "patch.pvd")[0.0].values()
    dim = scene.mesh.geometry.dim
    assert volume.values["displacement"].shape[1] == 3
    if geometry == 2:
        height = surface.points[:, dim - 1]
        np.testing.assert_allclose(height, 1.0 + bow(surface.points), atol=1e-12)
    assert_same(volume, fine)
    assert_same(surface, solution.surface.functions)
    sizes = pyvista.read(folder / "patch" / "0000" / "volume.vtu").compute_cell_sizes()
    assert sizes["Area" if dim == 2 else "Volume"].sum() == pytest.approx(2.0, rel=1e-4)


@pytest.mark.parametrize("name", ["bricks.vtu", "bricks", "bricks.xdmf"])
def test_unknown_suffix(folder: Path, solution: ContactSolution, name: str) -> None:
    with pytest.raises(InputError, match=r"are '.pvd', found .*bricks.*to_pyvista\(\)"):
        solution.write(folder / name)
    with pytest.raises(InputError, match=r"are '\.pvd', found"):
        SolutionWriter(folder / name)


def test_a_folder_in_the_place_of_the_file(comm, folder, solution):
    """A folder in the place of the file, or a file in that of the folder: an error on all ranks."""
    if comm.rank == 0:
        (folder / "taken").touch()
        (folder / "bricks.pvd").mkdir()
    comm.barrier()
    for path in (folder / "taken" / "bricks.pvd", folder / "bricks.pvd"):
        with pytest.raises(InputError, match="cannot write"):
            solution.write(path)


def test_without_pyvista(folder, solution, monkeypatch):
    """Files do not need it, the conversion says so."""
    monkeypatch.setitem(sys.modules, "pyvista", None)  # import fails
    solution.write(folder / "bricks.pvd")
    with pytest.raises(ContactError, match=r"need pyvista.*install"):
        solution.to_pyvista()


def test_steps_are_one_series(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    """After each step what is there can be read; a new series leaves nothing of the old one."""
    path = folder / "new" / "steps.pvd"
    u = solution.u.copy()
    u.name = solution.u.name
    writer = SolutionWriter(path)
    for i, time in enumerate((0.5, 2, 1e3)):
        u.x.array[:] = time * solution.u.x.array
        writer.write(dataclasses.replace(solution, u=u), time)
        assert times(path) == [0.5, 2.0, 1e3][: i + 1]
    for time, grids in read_series(path).items():
        u.x.array[:] = time * solution.u.x.array
        assert_same(grids["volume"], [u])
    comm.barrier()
    SolutionWriter(path).write(solution, 7.0)
    assert times(path) == [7.0]


def test_a_series_goes_on_after_a_restart(comm, folder, solution):
    """Steps before the first new one stay; what a killed run has not finished goes."""
    path = folder / "steps.pvd"
    writer = SolutionWriter(path, append=True)  # of nothing
    for time in (0.0, 1.0, 2.0, 3.0):
        writer.write(solution, time)
    if comm.rank == 0:
        (folder / "steps" / "0004").mkdir()
        (folder / "steps" / "0004" / "volume.vtu").write_text("half")
    comm.barrier()
    writer = SolutionWriter(path, append=True)
    for i, time in enumerate((1.5, 4.0)):
        writer.write(solution, time)
        assert times(path) == [0.0, 1.0, *(1.5, 4.0)[: i + 1]]


def test_other_files_in_the_folder_stay(comm, folder, solution):
    path = folder / "steps.pvd"
    solution.write(path)
    mine = [folder / "steps" / "0000" / "mine.txt", folder / "steps" / "mine" / "0001.vtu"]
    if comm.rank == 0:
        for file in mine:
            file.parent.mkdir(exist_ok=True)
            file.touch()
    comm.barrier()
    comm.barrier()
    solution.write(path)
    comm.barrier()
    assert all(file.exists() for file in mine)
    assert [Path(data.file).parent.name for data in read_pvd(path)] == ["0001", "0001"]


def test_time_must_increase(folder: Path, solution: ContactSolution) -> None:
    writer = SolutionWriter(folder / "steps.pvd")
    with pytest.raises(InputError, match=r"solution must be what .* returned, found 3"):
        writer.write(3, 1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="time must be a number, found nan"):
        writer.write(solution, np.nan)
    writer.write(solution, 1.0)
    wrong: tuple[Any, ...] = (1.0, 0.5, np.nan, np.inf, "2", None, 1j)
    for time in wrong:
        with pytest.raises(InputError, match="time must be a number above 1, the last one, found"):
            writer.write(solution, time)
    assert times(folder / "steps.pvd") == [1.0]


def test_files_that_are_no_series(folder: Path, solution: ContactSolution) -> None:
    for i, text in enumerate(("<nothing", "<a><DataSet file='a.vtu'/></a>")):
        path = folder / f"steps_{i}.pvd"
        path.write_text(text)
        solution.u.function_space.mesh.comm.barrier()
        with pytest.raises(InputError, match="cannot add to"):
            SolutionWriter(path, append=True).write(solution, 1.0)
        assert path.read_text() == text


def test_fields_of_the_user(folder: Path, solution: ContactSolution) -> None:
    """Fields of cells and of nodes, of any degree, and tags of some cells are written."""
    mesh = solution.u.function_space.mesh
    stress = fem.Function(fem.functionspace(mesh, ("DG", 0, (3, 3))), name="stress")
    stress.interpolate(lambda x: np.arange(9.0)[:, None] * x[:1] ** 0)
    hot = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)), name="temperature")
    hot.interpolate(lambda x: x[0] + 10.0 * x[2])
    tags = two_bricks_tags(solution)
    solution.write(folder / "fields.pvd", fields=[stress, hot, tags])
    volume = read_series(folder / "fields.pvd")[0]["volume"]
    np.testing.assert_allclose(
        volume.values["temperature"].ravel(), volume.points @ [1.0, 0.0, 10.0], atol=1e-12
    )
    np.testing.assert_allclose(volume.cell_values["stress"], [np.arange(9.0)] * CELLS, rtol=EPS)
    corners = volume.points[volume.cells[:, :4]]
    first = corners[:, :, 0].max(axis=1) <= 2 / 3 + 1e-9
    np.testing.assert_array_equal(volume.cell_values["thirds"].ravel(), np.where(first, 7, 0))
    assert {volume.cell_values[name].dtype for name in ("thirds", "body")} == {np.dtype("i4")}


def test_fields_that_are_refused(folder: Path, solution: ContactSolution) -> None:
    mesh = solution.u.function_space.mesh
    cases: list[tuple[Any, str]] = [
        (np.zeros(3), "must be Functions.*MeshTags"),
        (fem.Function(solution.u.function_space, name="body"), "a field 'body' already"),
        (fem.Function(fem.functionspace(mesh, ("DG", 1)), name="mine"), "Lagrange.*interpolate"),
        (fem.Function(fem.functionspace(mesh, ("N1curl", 1)), name="mine"), "'mine' must be"),
        (fem.Function(fem.functionspace(mesh, ("DG", 0)), dtype=np.complex128), "be a real"),
        (solution.pressure, "'pressure' lives on another mesh"),
        (dolfinx.mesh.meshtags(mesh, 2, np.arange(0, dtype=np.int32), 1), "no tags of the cells"),
    ]
    for field, message in cases:
        with pytest.raises(InputError, match=message):
            solution.write(folder / "fields.pvd", fields=[field])
    with pytest.raises(InputError, match=r"must be a sequence: write \[field\]"):
        solution.write(folder / "fields.pvd", fields=solution.pressure)
    assert not list(folder.iterdir())


@contextmanager
def full_disk(kilobytes: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size, as a full disk or a quota does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (kilobytes * 1024, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_full_disk(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    """A full disk is one error on all ranks, and the files of an earlier run stay."""
    path = folder / "bricks.pvd"
    solution.write(path)
    comm.barrier()

    def files() -> dict[Path, int]:
        return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}

    before = files()
    with full_disk(kilobytes=4), pytest.raises(InputError, match=f"cannot write '{path}'"):
        solution.write(path)
    comm.barrier()
    assert files() == before


def test_the_error_of_the_mesh_is_a_field_of_cells(comm: MPI.Comm, folder: Path) -> None:
    """The same values as in the Function."""
    with two_bricks(comm, N).problem() as problem:
        solution = problem.solve()
    solution.write(folder / "errors.pvd")
    cells = solution.cell_errors
    assert cells is not None
    topology = cells.function_space.mesh.topology
    owned = topology.index_map(topology.dim).size_local
    wanted = np.sort(np.concatenate(comm.allgather(cells.x.array[:owned])))
    volume = read_series(folder / "errors.pvd")[0.0]["volume"]
    np.testing.assert_allclose(np.sort(volume.cell_values["cell_errors"].ravel()), wanted, EPS)
