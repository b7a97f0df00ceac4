"""The blocks of a solution, and grids of them in VTK's layout: for files and pictures."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

import basix
import dolfinx.plot
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.compat import same_topology
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.fields import IntegerFunction

ROOT = 0  #: the rank that gets the grids

#: Fields that users may add to the volume.
Field: TypeAlias = "fem.Function | MeshTags"

#: Mesh -> number of each cell's body; kept, since finding bodies takes longer than writing a step.
_LABELS: WeakKeyDictionary[Any, npt.NDArray[np.int64]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Grid:
    """A mesh with each node and cell once.

    Attributes:
        dim: dimension of space, 2 or 3.
        points: (n, 3) nodes [length].
        cells: (m, 1 + k) number of nodes k, then the nodes in VTK's order.
        cell_types: (m,) VTK's numbers of the cell types.
        values: name -> (n,), (n, 3) or (n, 9) values of a Function; vectors and tensors of 2D are
            padded with 0.
        cell_values: name -> (m,), (m, 3) or (m, 9) values of a Function that is constant in cells.
    """

    dim: int
    points: Array
    cells: npt.NDArray[np.int64]
    cell_types: npt.NDArray[np.int64]
    values: dict[str, npt.NDArray[Any]]
    cell_values: dict[str, npt.NDArray[Any]] = dataclass_field(default_factory=dict)

    def to_pyvista(self) -> Any:
        """Return the `pyvista.UnstructuredGrid` with its point and cell data. Not collective.

        Raises:
            ContactError: pyvista is not installed, or does not suit the installed VTK.
        """
        try:
            import pyvista
        except (ImportError, AttributeError) as error:  # AttributeError: VTK lacks something
            raise ContactError(
                f"pictures and to_pyvista() need pyvista, which does not import ({error}): install "
                "python3-pyvista (Debian) or pyvista (conda, pip); `pip install -U pyvista` brings "
                "one that goes with its VTK."
            ) from error
        grid = pyvista.UnstructuredGrid(self.cells.ravel(), self.cell_types, self.points)
        grid.point_data.update(self.values)
        grid.cell_data.update(self.cell_values)
        return grid


def gather_grid(functions: Sequence[fem.Function]) -> Grid | None:
    """Return the grid of the whole mesh on rank `ROOT`, None on other ranks. Collective.

    Args:
        functions: Functions on the same mesh: one or more continuous Lagrange Functions of one
            degree, and maybe Functions of degree 0.
    """
    nodal = [function for function in functions if not is_constant_in_cells(function)]
    constant = [function for function in functions if is_constant_in_cells(function)]
    space = nodal[0].function_space
    index_map = space.dofmap.index_map
    owned = slice(index_map.size_local)
    cells, cell_types, points = dolfinx.plot.vtk_mesh(space)
    cells = np.array(cells, dtype=np.int64).reshape(-1, 1 + space.dofmap.list.shape[1])
    nodes = cells[:, 1:]
    nodes[:] = index_map.local_to_global(nodes.astype(np.int32).ravel()).reshape(nodes.shape)
    columns = [points[owned], cells, np.asarray(cell_types)]
    for function in nodal:  # in the numbering of `space`, which has the same nodes
        rows = _rows(function)
        order = np.arange(len(rows))
        order[space.dofmap.list] = function.function_space.dofmap.list
        columns.append(rows[order][owned])
    columns += [_rows(function)[: len(cells)] for function in constant]
    gathered = space.mesh.comm.gather(columns, root=ROOT)
    if gathered is None:
        return None
    # ranks own ascending ranges of global numbers: rows in rank order are in the order of numbers
    points, cells, cell_types, *arrays = map(np.concatenate, zip(*gathered, strict=True))
    values, cell_values = (
        dict(zip([function.name for function in group], of_group, strict=True))
        for group, of_group in ((nodal, arrays[: len(nodal)]), (constant, arrays[len(nodal) :]))
    )
    return Grid(space.mesh.geometry.dim, points, cells, cell_types, values, cell_values)


def is_constant_in_cells(function: fem.Function) -> bool:
    """Return whether a Function is discontinuous of degree 0. Not collective."""
    return bool(function.function_space.ufl_element().degree == 0)


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


def blocks_of(solution: Evaluation, fields: Sequence[Field]) -> dict[str, list[fem.Function]]:
    """Return the Functions of the blocks "volume" and "contact" of a file. Collective.

    With several pairs there is a block for each, named after the pair. The Functions of a block are
    on one mesh, and of one degree or of degree 0. The degree of the volume is high enough for
    curved cells to be shown as curved; surfaces are of degree 1.

    Args:
        solution: the solution to be written.
        fields: further Functions and tags for the block "volume".

    Raises:
        InputError: `solution` is not a `ContactSolution`; a field is of another kind, on another
            mesh, or has a name that is in use; or `fields` is a single field.
    """
    check_solution(solution)
    u, surfaces = solution.u, solution.surfaces
    if isinstance(fields, fem.Function | MeshTags):
        raise InputError(f"fields must be a sequence: write [field] for '{fields.name}' alone.")
    volume = [u, _bodies(u.function_space)]
    if solution.cell_errors is not None:
        volume.append(solution.cell_errors)
    for field in fields:
        volume.append(_checked(field, u, [function.name for function in volume]))
    blocks = {"volume": _in_one_degree(volume)}
    for i, surface in enumerate(surfaces):
        name = "contact" if len(surfaces) == 1 else surface.name
        blocks[_unused_name(name, blocks, i + 1)] = list(surface.functions)
    return blocks


def check_solution(solution: Any) -> None:
    """Check that a solution is one. Not collective.

    Raises:
        InputError: it is not.
    """
    if not isinstance(solution, Evaluation):
        raise InputError(f"solution must be what solve() has returned, found {shown(solution)}.")


def _unused_name(name: str, taken: Container[str], number: int) -> str:
    """Return an unused name for a block, of letters, digits and underscores. Not collective.

    Args:
        name: name of a pair.
        taken: names of other blocks.
        number: number of the pair, which is appended if the name is taken.
    """
    result = re.sub(r"\W+", "_", name, flags=re.ASCII)[:60].strip("_") or f"block_{number}"
    while result in taken:
        result += f"_{number}"
    return result


def _bodies(V: Any) -> IntegerFunction:
    """Return the number of each cell's body, counted from 1 as in messages. Collective."""
    if V.mesh not in _LABELS:
        _LABELS[V.mesh] = 1 + label_bodies(V)[V.dofmap.list[:, 0]]
    function = IntegerFunction(fem.functionspace(V.mesh, ("DG", 0)), name="body")
    function.x.array[:] = _LABELS[V.mesh]
    return function


def _checked(field: Field, u: fem.Function, taken: Sequence[str]) -> fem.Function:
    """Check a field of the user and return it; tags of cells become a Function of degree 0.

    Raises:
        InputError: see `blocks_of`.
    """
    mesh = u.function_space.mesh
    if not isinstance(field, fem.Function | MeshTags):
        raise InputError(
            "fields must be Functions, such as interpolated expressions, or MeshTags of cells, "
            f"found {shown(field)}."
        )
    if field.name in taken:
        raise InputError(
            f"there is a field '{field.name}' already: give yours another name, as in "
            "field.name = 'mine'."
        )
    if isinstance(field, MeshTags):
        if field.dim != mesh.topology.dim or not same_topology(field, mesh):
            raise InputError(f"'{field.name}' are no tags of the cells of this mesh.")
        function = IntegerFunction(fem.functionspace(mesh, ("DG", 0)), name=field.name)
        function.x.array[field.indices] = field.values
        return function
    V = field.function_space
    if not same_topology(V.mesh, mesh):
        raise InputError(f"'{field.name}' lives on another mesh than the displacement.")
    try:
        element = V.element.basix_element
        lagrange = element.family == basix.ElementFamily.P and (
            element.degree == 0 or not element.discontinuous
        )
    except RuntimeError:  # a mixed element, or values at points only
        lagrange = False
    real = field.x.array.dtype.kind == "f"
    if not (real and lagrange and V.dofmap.bs == math.prod(field.ufl_shape)):
        raise InputError(
            f"'{field.name}' must be a real Lagrange Function or one of degree 0 ('DG', 0), found "
            f"{V.ufl_element()} of {field.x.array.dtype}: interpolate it."
        )
    return field


def _in_one_degree(functions: Sequence[fem.Function]) -> list[fem.Function]:
    """Interpolate Functions to the highest degree of these and of the geometry. Collective.

    Functions of degree 0 stay.
    """
    mesh = functions[0].function_space.mesh
    degrees = [function.function_space.ufl_element().degree for function in functions]
    degree = max(*degrees, int(mesh.ufl_domain().ufl_coordinate_element().degree))
    results = []
    for function in functions:
        if function.function_space.ufl_element().degree in (0, degree):
            results.append(function)
            continue
        W = fem.functionspace(mesh, ("Lagrange", degree, function.ufl_shape))
        result = fem.Function(W, name=function.name)
        result.interpolate(function)
        result.x.scatter_forward()
        results.append(result)
    return results
