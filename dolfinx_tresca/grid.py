"""Functions and their mesh, gathered on one rank: for files and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

import dolfinx.plot
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import ContactError

ROOT = 0  #: the rank that gets the grids


@dataclass(frozen=True)
class Grid:
    """The whole mesh, each node and cell once.

    Attributes:
        dim: of space, 2 or 3.
        degree: of the Functions; the cells of VTK are Lagrange's from 2.
        points: (n, 3) nodes [length], in the order of their global numbers.
        cells: (m, 1 + k) number of nodes k, then the nodes in VTK's order.
        cell_types: (m,) VTK's numbers.
        values: name -> (n,) or (n, 3) values of a Function; vectors of 2D have a third component 0.
        cell_values: name -> (m,) values of a Function that is constant in each cell.
    """

    dim: int
    degree: int
    points: Array
    cells: npt.NDArray[np.int64]
    cell_types: npt.NDArray[np.int64]
    values: dict[str, Array]
    cell_values: dict[str, Array] = field(default_factory=dict)

    def to_pyvista(self) -> Any:
        """Return the `pyvista.UnstructuredGrid` with its point and cell data. Not collective.

        Raises:
            ContactError: there is no pyvista.
        """
        try:
            import pyvista
        except ImportError as error:
            raise ContactError(
                "pictures and .vtu files need pyvista: install python3-pyvista (Debian) or pyvista "
                "(conda, pip)."
            ) from error
        grid = pyvista.UnstructuredGrid(self.cells.ravel(), self.cell_types, self.points)
        for name, values in self.values.items():
            grid.point_data[name] = values
        for name, values in self.cell_values.items():
            grid.cell_data[name] = values
        return grid


def gather_grid(functions: Sequence[fem.Function]) -> Grid | None:
    """Return the grid of Functions on rank `ROOT`, None on others. Collective.

    Args:
        functions: on the same mesh; continuous Lagrange ones of the same degree, then scalar ones
            of degree 0.
    """
    on_cells = [function for function in functions if is_constant_in_cells(function)]
    functions = functions[: len(functions) - len(on_cells)]
    space = functions[0].function_space
    comm, index_map = space.mesh.comm, space.dofmap.index_map
    owned = index_map.size_local
    cells, cell_types, points = dolfinx.plot.vtk_mesh(space)
    nodes = space.dofmap.list.shape[1]
    cells = np.asarray(cells, dtype=np.int64).reshape(-1, 1 + nodes)
    cells[:, 1:] = index_map.local_to_global(cells[:, 1:].astype(np.int32).ravel()).reshape(
        -1, nodes
    )
    values = [_values(function, space)[:owned] for function in functions]
    values += [function.x.array[: len(cells)] for function in on_cells]
    parts = comm.gather((points[:owned], cells, np.asarray(cell_types), values), root=ROOT)
    if parts is None:
        return None
    # each rank owns a range of global numbers, in rank order: rows in rank order are in their order
    columns = [np.concatenate(column) for column in zip(*(part[3] for part in parts), strict=True)]
    return Grid(
        dim=space.mesh.geometry.dim,
        degree=space.ufl_element().degree,
        points=np.concatenate([part[0] for part in parts]),
        cells=np.concatenate([part[1] for part in parts]),
        cell_types=np.concatenate([part[2] for part in parts]),
        values={f.name: column for f, column in zip(functions, columns, strict=False)},
        cell_values={
            f.name: column for f, column in zip(on_cells, columns[len(functions) :], strict=True)
        },
    )


def is_constant_in_cells(function: fem.Function) -> bool:
    """Whether a Function is discontinuous of degree 0. Not collective."""
    return bool(function.function_space.ufl_element().degree == 0)


def _values(function: fem.Function, space: Any) -> Array:
    """Return values (n,) or (n, 3) at the nodes of `space`, in its numbering. Not collective."""
    own, size = function.function_space.dofmap, function.function_space.dofmap.bs
    values: Array = np.asarray(function.x.array).reshape(-1, size)
    order = np.arange(len(values))
    order[space.dofmap.list] = own.list
    values = values[order]
    return values[:, 0] if size == 1 else np.pad(values, ((0, 0), (0, 3 - size)))
