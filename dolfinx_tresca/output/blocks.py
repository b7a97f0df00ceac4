"""The blocks of a solution in files: their names and the Functions in each."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping, Sequence
from typing import Any, Protocol, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

import basix
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.compat import same_topology
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.output.grid import is_constant_in_cells
from dolfinx_tresca.solution.fields import IntegerFunction, SurfaceFields
from dolfinx_tresca.solution.resultants import Resultant

#: Fields that users may add to the volume.
Field: TypeAlias = "fem.Function | MeshTags"

#: Name of a block -> its Functions, on the same mesh.
Blocks: TypeAlias = dict[str, list[fem.Function]]

#: Largest number of characters in the name of a block that is named after a pair or a body.
NAME_LENGTH = 60

#: Mesh -> number of each cell's body; kept, since finding bodies takes longer than writing a step.
_LABELS: WeakKeyDictionary[Any, npt.NDArray[np.int64]] = WeakKeyDictionary()


class HasFields(Protocol):
    """The part of `ContactSolution` that writers need."""

    @property
    def u(self) -> fem.Function:
        """Displacement."""

    @property
    def surfaces(self) -> tuple[SurfaceFields, ...]:
        """The fields of each pair."""

    @property
    def axisymmetric(self) -> bool:
        """Whether the mesh is the meridian of bodies of revolution."""

    @property
    def between_bodies(self) -> Mapping[tuple[int, int], Resultant]:
        """Forces between bodies."""

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies."""

    @property
    def cell_errors(self) -> fem.Function | None:
        """The error of the mesh in each cell."""


def blocks_of(solution: HasFields, fields: Sequence[Field]) -> Blocks:
    """Return the Functions of the blocks "volume" and "contact" of a file. Collective.

    With several pairs there is a block for each, named after the pair.

    Args:
        solution: the solution to be written.
        fields: further Functions and tags for the block "volume".

    Raises:
        InputError: `solution` is not a `ContactSolution`; a field is of another kind, on another
            mesh, or has a name that is in use; or `fields` is a single field.
    """
    if not all(hasattr(solution, name) for name in ("u", "surfaces", "cell_errors")):
        raise InputError(f"solution must be what solve() has returned, found {shown(solution)}.")
    u, surfaces = solution.u, solution.surfaces
    if isinstance(fields, fem.Function | MeshTags):
        raise InputError(f"fields must be a sequence: write [field] for '{fields.name}' alone.")
    volume = [u, _bodies(u.function_space)]
    if solution.cell_errors is not None:
        volume.append(solution.cell_errors)
    for field in fields:
        volume.append(_checked(field, u, [function.name for function in volume]))
    blocks: Blocks = {"volume": volume}
    for i, surface in enumerate(surfaces):
        name = "contact" if len(surfaces) == 1 else surface.name
        blocks[unused_name(name, blocks, i + 1)] = list(surface.functions)
    return blocks


def unused_name(name: str, taken: Container[str], number: int) -> str:
    """Return an unused name for a block, of letters, digits and underscores. Not collective.

    Args:
        name: name of a pair or of a body.
        taken: names of other blocks.
        number: number of the pair or body, which is appended if the name is taken.
    """
    result = re.sub(r"\W+", "_", name, flags=re.ASCII)[:NAME_LENGTH].strip("_") or f"block_{number}"
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
    if V.mesh.topology is not mesh.topology:
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


def curved(functions: Sequence[fem.Function]) -> list[fem.Function]:
    """Interpolate Functions to one degree, high enough for curved cells to be shown as curved.

    Collective.
    """
    degrees = [function.function_space.ufl_element().degree for function in functions]
    return in_degree(functions, max(*degrees, mesh_degree(functions[0].function_space.mesh)))


def mesh_degree(mesh: Any) -> int:
    """Return the degree of the geometry. Not collective."""
    return int(mesh.ufl_domain().ufl_coordinate_element().degree)


def in_degree(functions: Sequence[fem.Function], degree: int) -> list[fem.Function]:
    """Interpolate Functions to a degree, except Functions of degree 0. Collective."""
    return [_in_degree(function, degree) for function in functions]


def _in_degree(function: fem.Function, degree: int) -> fem.Function:
    V = function.function_space
    if V.ufl_element().degree == degree or is_constant_in_cells(function):
        return function
    element = ("Lagrange", degree, function.ufl_shape)
    result = type(function)(fem.functionspace(V.mesh, element), name=function.name)
    if isinstance(function, IntegerFunction):
        _interpolate_categories(function, result)
    else:
        result.interpolate(function)
    result.x.scatter_forward()
    return result


def _interpolate_categories(function: IntegerFunction, result: IntegerFunction) -> None:
    """Interpolate integers: each node gets one of the integers of the cells around the node.

    This is the integer whose indicator function, interpolated, has the largest value at the node;
    if several values are equally large, it is the lowest of these integers.
    """
    one, parts = fem.Function(function.function_space), fem.Function(result.function_space)
    largest = np.zeros(len(parts.x.array))
    mesh = function.function_space.mesh
    categories = sorted(set().union(*mesh.comm.allgather(set(np.rint(function.x.array)))))
    for category in categories:
        one.x.array[:] = np.rint(function.x.array) == category
        parts.interpolate(one)
        more = parts.x.array > largest + 1e-6
        result.x.array[more] = category
        largest[more] = parts.x.array[more]
