"""Functions and their mesh in VTK's layout, of one rank or gathered: for files and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

import dolfinx.plot
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import ContactError
from dolfinx_tresca.solution.fields import IntegerFunction

ROOT = 0  #: the rank that gets the grids


@dataclass(frozen=True)
class Grid:
    """A mesh, or a rank's part of it, with each node and cell once.

    Attributes:
        dim: dimension of space, 2 or 3.
        degree: degree of the Functions; from degree 2 on, the cells are VTK's Lagrange cells.
        points: (n, 3) nodes [length].
        cells: (m, 1 + k) number of nodes k, then the nodes in VTK's order.
        cell_types: (m,) VTK's numbers of the cell types.
        values: name -> (n,), (n, 3) or (n, 9) values of a Function; vectors and tensors of 2D are
            padded with 0.
        cell_values: name -> (m,), (m, 3) or (m, 9) values of a Function that is constant in cells.
        texts: name -> texts that belong to the whole grid, such as names of bodies.
    """

    dim: int
    degree: int
    points: Array
    cells: npt.NDArray[np.int64]
    cell_types: npt.NDArray[np.int64]
    values: dict[str, npt.NDArray[Any]]
    cell_values: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    texts: dict[str, Sequence[str]] = field(default_factory=dict)

    def part(self, kept: npt.NDArray[np.bool_]) -> Grid:
        """Return the grid of the cells with True in `kept` (m,). Not collective."""
        cells = self.cells[kept]
        used = np.zeros(len(self.points), dtype=np.bool_)
        used[cells[:, 1:]] = True
        cells[:, 1:] = (np.cumsum(used) - 1)[cells[:, 1:]]
        return replace(
            self,
            points=self.points[used],
            cells=cells,
            cell_types=self.cell_types[kept],
            values={name: values[used] for name, values in self.values.items()},
            cell_values={name: values[kept] for name, values in self.cell_values.items()},
        )

    def to_pyvista(self) -> Any:
        """Return the `pyvista.UnstructuredGrid` with its point and cell data. Not collective.

        Raises:
            ContactError: pyvista is not installed, or does not suit the installed VTK.
        """
        try:
            import pyvista
        except (ImportError, AttributeError) as error:
            if isinstance(error, ModuleNotFoundError) and error.name == "pyvista":
                reason = (
                    "pictures and to_pyvista() need pyvista: install python3-pyvista (Debian) or "
                    "pyvista (conda, pip)."
                )
            else:  # the installed VTK lacks something that pyvista needs
                reason = (
                    f"pyvista is installed but does not import: {error}; `pip install -U pyvista` "
                    "brings one that goes with its VTK."
                )
            raise ContactError(reason) from error
        grid = pyvista.UnstructuredGrid(self.cells.ravel(), self.cell_types, self.points)
        for name, values in self.values.items():
            grid.point_data[name] = values
        for name, values in self.cell_values.items():
            grid.cell_data[name] = values
        for name, texts in self.texts.items():
            grid.field_data[name] = list(texts)
        return grid


def local_grid(functions: Sequence[fem.Function]) -> Grid:
    """Return the grid of this rank's own cells and their nodes. Not collective.

    Args:
        functions: Functions on the same mesh: one or more continuous Lagrange Functions of one
            degree, and maybe Functions of degree 0.
    """
    grid = _with_ghosts(functions)
    return grid.part(np.ones(len(grid.cells), dtype=np.bool_))


def gather_grid(functions: Sequence[fem.Function]) -> Grid | None:
    """Return the grid of the whole mesh on rank `ROOT`, None on other ranks. Collective.

    Args:
        functions: see `local_grid`.
    """
    grid = _with_ghosts(functions)
    space = _at_nodes(functions)[0].function_space
    index_map = space.dofmap.index_map
    own = slice(index_map.size_local)
    nodes = grid.cells[:, 1:]
    nodes[:] = index_map.local_to_global(nodes.astype(np.int32).ravel()).reshape(nodes.shape)
    columns = [grid.points[own], grid.cells, grid.cell_types]
    columns += [values[own] for values in grid.values.values()]
    columns += grid.cell_values.values()
    parts = space.mesh.comm.gather(columns, root=ROOT)
    if parts is None:
        return None
    # ranks own ascending ranges of global numbers: rows in rank order are in the order of numbers
    points, cells, cell_types, *rest = map(np.concatenate, zip(*parts, strict=True))
    arrays = iter(rest)
    return replace(
        grid,
        points=points,
        cells=cells,
        cell_types=cell_types,
        values={name: next(arrays) for name in grid.values},
        cell_values={name: next(arrays) for name in grid.cell_values},
    )


def _with_ghosts(functions: Sequence[fem.Function]) -> Grid:
    """Return the grid of this rank's own cells, with all nodes of the rank, ghosts included.

    Not collective.
    """
    space = _at_nodes(functions)[0].function_space
    cells, cell_types, points = dolfinx.plot.vtk_mesh(space)
    nodes = space.dofmap.list.shape[1]
    cells = np.array(cells, dtype=np.int64).reshape(-1, 1 + nodes)
    return Grid(
        dim=space.mesh.geometry.dim,
        degree=space.ufl_element().degree,
        points=points,
        cells=cells,
        cell_types=np.asarray(cell_types),
        values={f.name: _in_order_of(space, f) for f in _at_nodes(functions)},
        cell_values={f.name: _rows(f)[: len(cells)] for f in functions if is_constant_in_cells(f)},
    )


def is_constant_in_cells(function: fem.Function) -> bool:
    """Return whether a Function is discontinuous of degree 0. Not collective."""
    return bool(function.function_space.ufl_element().degree == 0)


def _at_nodes(functions: Sequence[fem.Function]) -> list[fem.Function]:
    return [function for function in functions if not is_constant_in_cells(function)]


def _in_order_of(space: Any, function: fem.Function) -> npt.NDArray[Any]:
    """Return a Function's values in the numbering of `space`, which has the same nodes."""
    values = _rows(function)
    order = np.arange(len(values))
    order[space.dofmap.list] = function.function_space.dofmap.list
    ordered: npt.NDArray[Any] = values[order]
    return ordered


def _rows(function: fem.Function) -> npt.NDArray[Any]:
    """Return a Function's values (n,), (n, 3) or (n, 9), with zeros as third components of 2D.

    Values of an `IntegerFunction` are integers. Not collective.
    """
    shape = function.ufl_shape
    values: npt.NDArray[Any] = np.asarray(function.x.array).reshape(-1, *shape)
    if isinstance(function, IntegerFunction):
        values = np.rint(values).astype(np.int32)
    values = np.pad(values, [(0, 0), *((0, 3 - size) for size in shape)])
    rows: npt.NDArray[Any] = values.reshape(-1, 3 ** len(shape)) if shape else values
    return rows
