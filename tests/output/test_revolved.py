"""Files and pictures of bodies of revolution, turned about their axis."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
from dolfinx import fem

from dolfinx_tresca import Frictionless, InputError
from dolfinx_tresca.output.grid import gather_grid
from dolfinx_tresca.output.revolved import revolved
from scenes.boxes import Body
from scenes.revolution import two_rings

pyvista = pytest.importorskip("pyvista")

HOLE, RIM, HEIGHT = 1.0, 2.0, 0.5


def rings(comm, kind="quadrilateral", degree=1):
    """Return a solution of two rings, one on the other, compressed; 2D cells have either sense."""
    bodies = (Body((2, 1), [(HOLE, RIM), (1, 1.5)]), Body((3, 1), [(HOLE, RIM), (0.5, 1.0)]))
    held = [(0, lambda x: np.isclose(x[:, 1], 1.5), 1, -0.01)]
    held += [(1, lambda x: np.isclose(x[:, 1], 0.5), 1, 0.0)]
    sides = (lambda x: np.isclose(x[:, 1], 1.0),) * 2
    scene = two_rings(comm, bodies, sides, held, Frictionless(), kind=kind, degree=degree)
    with scene.problem(axisymmetric=True) as problem:
        return problem.solve()


@pytest.mark.parametrize("angle", [100.0, 360.0])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_cells_have_the_volume_of_the_ring(kind, angle):
    """Cells have VTK's order of nodes; a circle of chords has the area of its polygon.

    VTK 9.3 counts the volume of wedges with the other sign than 9.7.
    """
    blocks = rings(MPI.COMM_SELF, kind, degree=2).to_pyvista(revolve=angle)
    layers = math.ceil(angle / 6.0)
    section = 0.5 * layers * math.sin(math.radians(angle) / layers) * (RIM**2 - HOLE**2)
    volumes = blocks["volume"].compute_cell_sizes()["Volume"]
    assert volumes.min() > 0.0 or (kind == "triangle" and volumes.max() < 0.0)
    assert abs(volumes.sum()) == pytest.approx(2 * HEIGHT * section, rel=1e-5)
    assert blocks["contact"].area == pytest.approx(section, rel=1e-5)


def test_vectors_and_tensors_turn_with_the_meridian():
    """The position itself, and the dyad with itself, are those of the turned points."""
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    fields = []
    for shape, values in (
        ((2,), lambda x: x[:2]),
        ((2, 2), lambda x: np.stack([x[i] * x[j] for i in (0, 1) for j in (0, 1)])),
        ((), lambda x: x[0]),
    ):
        function = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, shape)))
        function.interpolate(values)
        function.name = f"f{len(shape)}"
        fields.append(function)
    number = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="cell")
    number.x.array[:] = np.arange(len(number.x.array))
    flat = gather_grid([*fields, number])
    grid = revolved(flat, 270.0)
    assert np.allclose(grid.values["f1"], grid.points, atol=1e-14)
    dyads = np.einsum("ni,nj->nij", grid.points, grid.points).reshape(-1, 9)
    assert np.allclose(grid.values["f2"], dyads, atol=1e-14)
    assert np.allclose(grid.values["f0"], np.hypot(grid.points[:, 0], grid.points[:, 2]))
    assert np.array_equal(grid.points[: len(flat.points)], flat.points)
    assert np.array_equal(grid.cell_values["cell"][:8], flat.cell_values["cell"])
    last = grid.points[-len(flat.points) :]  # from x by way of -z and -x to z
    assert np.allclose(last[:, 2], flat.points[:, 0]) and np.allclose(last[:, 0], 0.0)


@pytest.mark.parallel
def test_files(comm, folder):
    """Each rank turns its part of a `.pvd`; the first rank the whole of a `.vtu`."""
    solution = rings(comm)
    for suffix in ("pvd", "vtu"):
        solution.write(folder / f"rings.{suffix}", revolve=90)
    comm.barrier()
    ends = []
    whole = pyvista.read(folder / "rings.vtu")
    ends.append((whole.n_cells, np.ptp(whole.points, axis=0), whole["displacement"].min()))
    parts = pyvista.PVDReader(str(folder / "rings.pvd")).read()[0]
    ends.append((parts.n_cells, np.ptp(parts.points, axis=0), parts["displacement"].min()))
    for cells, size, lowest in ends:
        assert cells == 5 * 15
        assert np.allclose(size, [RIM, 1.0, RIM], rtol=1e-6)
        assert lowest == pytest.approx(-0.01)


def test_a_picture(tmp_path):
    solution = rings(MPI.COMM_SELF)
    solution.plot(tmp_path / "rings.png", revolve=270)
    flat, turned = solution.plot(), solution.plot(revolve=270)
    assert flat.size == turned.size
    assert np.any(np.asarray(flat) != np.asarray(turned))


def test_wrong_arguments(tmp_path):
    solution = rings(MPI.COMM_SELF)
    for angle in (0, -90, 361, "all", True):
        with pytest.raises(InputError, match="revolve must be an angle in degrees"):
            solution.write(tmp_path / "rings.vtu", revolve=angle)
    with pytest.raises(InputError, match=r"needs a '\.pvd' or a '\.vtu'"):
        solution.write(tmp_path / "rings.xdmf", revolve=90)
