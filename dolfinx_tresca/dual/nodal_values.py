"""Nodal values of the user's fields, and their derivatives by controls (Constants, Functions)."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property, partial
from math import prod
from typing import Any

import numpy as np

import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives
from ufl.classes import Coefficient, Expr
from ufl.corealg.traversal import traverse_unique_terminals
from ufl.domain import extract_domains

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.compat import interpolation_points
from dolfinx_tresca._base.parallel import errors_on_all_ranks, largest_abs, summed_at_nodes
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import ScalarField, VectorField, expression_of

#: Step of central differences, relative to the magnitude of a Constant, or to the mesh's extent
#: where an obstacle moves. The truncation error is about its square, the rounding error about the
#: rounding of one value divided by the step.
DIFFERENCE = 1e-5

#: Magnitudes of a control that are tried in turn if its own, which may be 0, is of no use.
MAGNITUDES = (1.0, 1e-3, 1e-6, 1e-9)

#: Least and largest change of values, relative to the largest value, with which a difference is
#: taken at once. With smaller changes rounding errors exceed 1e-4; larger ones are not small.
LEAST_CHANGE, LARGEST_CHANGE = 1e-12, 1e-2


def inputs_of(field: Any) -> list[fem.Constant | fem.Function]:
    """Return the Constants and Functions in a field, or those that a Python function refers to."""
    if isinstance(field, tuple):
        return [variable for component in field for variable in inputs_of(component)]
    field = expression_of(field)
    variables: list[Any] = []
    if isinstance(field, Expr):
        variables = list(traverse_unique_terminals(field))
    elif inspect.isfunction(field):
        seen = inspect.getclosurevars(field)
        variables = [*seen.nonlocals.values(), *seen.globals.values(), *(field.__defaults__ or ())]
    return [variable for variable in variables if isinstance(variable, fem.Constant | fem.Function)]


def values_of(control: fem.Constant | fem.Function) -> Array:
    """Return the values of a Constant or Function as a flat array that shares their memory."""
    return np.asarray(control.value if hasattr(control, "value") else control.x.array).reshape(-1)


@contextmanager
def replaced(
    controls: Sequence[fem.Constant | fem.Function], values: Sequence[Array]
) -> Iterator[None]:
    """Replace the values of controls inside the block, and restore them after it."""
    present = [values_of(control) for control in controls]
    before = [array.copy() for array in present]
    for array, value in zip(present, values, strict=True):
        array[:] = value
    try:
        yield
    finally:
        for array, value in zip(present, before, strict=True):
            array[:] = value


def central_differences(
    comm: Any, control: Any, directions: Array, values: Callable[[], Array], name: str
) -> Array | None:
    """Return central differences of values along directions of a control. Collective.

    This is for Python functions of the user, which have no symbolic derivative: `values` returns
    this rank's values (n, ...) for the present control. The `directions` are (k, number of values
    of the control). The result (k, n, ...) is None if no value changes. Messages use the `name`.

    Raises:
        InputError: values change with a control that is a Function, not a Constant.
    """
    given = values_of(control).copy()
    result: Array | None = None
    # the first magnitude with a useful change, or else the first with any change
    for magnitude in (*largest_abs(comm, given), *MAGNITUDES):
        ends = []  # the values at +end along each direction, then those at -end
        for end in (DIFFERENCE * magnitude, -DIFFERENCE * magnitude):
            for direction in directions:
                with replaced([control], [given + end * direction]):
                    ends.append(values())
        high, low = np.split(np.array(ends), 2)
        change, *largest = largest_abs(comm, high - low, high, low)
        is_useful = LEAST_CHANGE * max(largest) <= change <= LARGEST_CHANGE * max(largest)
        if change > 0.0 and (is_useful or result is None):
            result = np.asarray((high - low) / (2.0 * DIFFERENCE * magnitude))
            if is_useful:
                break
    if result is not None and isinstance(control, fem.Function):
        raise InputError(
            f"{name} is a Python function that reads {shown(control)}: its derivatives are known "
            "with respect to Constants that it reads, not with respect to Functions."
        )
    return result


class NodalValues:
    """Evaluates the user's fields, and their derivatives, at nodes of a vector space."""

    def __init__(self, V: Any) -> None:
        """Keep V, whose nodes are the interpolation points of its element."""
        self._V = V
        self._compiled: dict[Expr, fem.Expression] = {}

    def values_at(
        self, field: ScalarField | VectorField, nodes: LocalNumbers, name: str, components: int = 1
    ) -> Array:
        """Return the present values (n, components) of a scalar or vector at nodes. Collective.

        Nodes (n,) are local numbers. A scalar has 1 component, a vector 3. Messages use the `name`.

        Raises:
            InputError: the field is on another mesh, or a function returns arrays of another shape.
        """
        field = expression_of(field)
        if isinstance(field, fem.Constant):
            field = field.value
        if isinstance(field, fem.Function):
            self._check_mesh(field, name)
            # interpolation keeps infinite values, which basis functions would spread as NaN
            nodal = fem.Function(self._V)
            (nodal if components > 1 else nodal.sub(0)).interpolate(field)
            values = nodal.x.array.reshape(-1, self._V.dofmap.index_map_bs)
            return np.asarray(values[nodes, :components])
        if isinstance(field, Expr):
            return self._of_expression(field, nodes, name)
        if callable(field):
            with errors_on_all_ranks(self._V.mesh.comm):
                return self._of_function(field, nodes, name, components).T
        return np.tile(np.asarray(field, dtype=np.float64), (len(nodes), 1))

    def pulled_back(
        self,
        field: ScalarField,
        control: fem.Function,
        nodes: LocalNumbers,
        weights: Array,
        name: str,
    ) -> Array | None:
        """Return the derivative of sum(weights * field at nodes) by a Function. Collective.

        The weights (n,) are derivatives of a goal by nodal values. The result has a value for each
        degree of freedom of the control that this rank owns; None: the control has no effect.
        """
        # slopes (n, k) by the k degrees of freedom of the cell from which a node takes its value
        space, dofmap = control.function_space, control.function_space.dofmap
        slopes = self.slopes(field, control, ufl.TestFunction(space), nodes, name)
        if slopes is None:
            return None
        dofs, terms = dofmap.list[self._cell_and_index[0, nodes]], weights[:, None] * slopes
        sums = summed_at_nodes(dofmap.index_map, dofs, terms[..., None])
        return sums[: dofmap.index_map.size_local, 0]

    def slopes(
        self, field: ScalarField, control: Any, direction: Any, nodes: LocalNumbers, name: str
    ) -> Array | None:
        """Return derivatives (n, k) of a scalar along directions of a control. Collective.

        The direction of a Constant is given by values, that of a Function by a Function, or by a
        test function, which stands for k directions: the basis functions of the node's cell. The
        result is None if the scalar does not depend on the control.
        """
        is_constant = isinstance(control, fem.Constant)
        field = expression_of(field)
        if callable(field) and not isinstance(field, Expr):
            # if the control is a Function, a change of values raises an error
            comm, values = self._V.mesh.comm, partial(self.values_at, field, nodes, name, 1)
            along = np.ravel(direction) if is_constant else np.ones(values_of(control).size)
            rates = central_differences(comm, control, along[None], values, name)
            return None if rates is None else rates[0]
        if control not in inputs_of(field):
            return None
        if is_constant:
            variable = ufl.variable(control)
            slope = ufl.diff(ufl.replace(field, {control: variable}), variable)
            slopes = self._of_expression(expand_derivatives(slope), nodes, name)
            return slopes @ np.reshape(direction, (-1, 1))
        if control.ufl_shape != ():
            raise InputError(
                f"{name} depends on a Function with components, '{control.name}': derivatives "
                "are available with respect to scalar Functions only."
            )
        slope = ufl.derivative(field, control, direction)
        return self._of_expression(expand_derivatives(slope), nodes, name)

    def _of_function(
        self, function: Callable[[Any], Any], nodes: LocalNumbers, name: str, components: int
    ) -> Array:
        """Return the values (components, n) of a function at the nodes. Not collective.

        The function may return them in this shape, a vector (components,) for all nodes, or, if it
        is a scalar, (n,) or a single number.
        """
        n = len(nodes)
        if n == 0:
            return np.zeros((components, 0))
        array = np.asarray(function(self._points[nodes].T.copy()))
        is_vector = components > 1
        kind = "a vector" if is_vector else "a real number"
        constant = (components,) if is_vector else ()
        wanted = (components, n) if is_vector else (n,)
        if array.dtype.kind not in "biuf" or array.shape not in (constant, wanted, (components, n)):
            raise InputError(
                f"the function for {name} must return {kind}, or one for each "
                f"point: for the {n} contact nodes of this rank it gets x of shape (3, {n}) and "
                f"should return an array of shape {wanted}, found "
                + (f"{array}." if array.shape == () else f"shape {array.shape} of {array.dtype}.")
            )
        columns = array[:, None] if is_vector and array.shape == constant else array
        return np.array(np.broadcast_to(columns, (components, n)), dtype=np.float64)

    def _check_mesh(self, expression: Expr, name: str) -> None:
        """Check that a Function or an expression is on the mesh of the space. Not collective."""
        if any(domain != self._V.mesh.ufl_domain() for domain in extract_domains(expression)):
            kind = "a Function" if isinstance(expression, Coefficient) else "an expression"
            raise InputError(
                f"{name} is {kind} on another mesh than the problem's. Make it on the mesh "
                'of the displacements; of a contact surface take solution.on_mesh("pressure").'
            )

    def _of_expression(self, expression: Expr, nodes: LocalNumbers, name: str) -> Array:
        """Return the values (n, k) of an expression, k values at each node. Collective.

        These are its components, or one for each basis function of a test function.
        """
        # evaluated at all nodes of one cell of each node; values at other nodes are dropped
        self._check_mesh(expression, name)
        if expression not in self._compiled:
            # expressions of numbers alone have no mesh
            on_mesh = fem.Constant(self._V.mesh, 1.0) * expression
            points = interpolation_points(self._V.element)
            self._compiled[expression] = fem.Expression(on_mesh, points)
        cells, index = self._cell_and_index[:, nodes]
        sampled = self._compiled[expression].eval(self._V.mesh, cells)
        count = self._V.dofmap.list.shape[1]
        at_points = sampled.reshape(len(cells), count, prod(sampled.shape[1:]) // count)
        return np.asarray(at_points[np.arange(len(cells)), index])

    @cached_property
    def _points(self) -> Array:
        """The positions (n, 3) of the nodes."""
        return np.asarray(self._V.tabulate_dof_coordinates())

    @cached_property
    def _cell_and_index(self) -> LocalNumbers:
        """For each node the first cell that has it, and its index in this cell, (2, nodes)."""
        # of entries that are written several times, numpy keeps the last: in reverse, the first
        cells = self._V.dofmap.list
        first_seen = np.zeros(cells.max(initial=-1) + 1, dtype=np.int32)
        first_seen[cells.ravel()[::-1]] = np.arange(cells.size, dtype=np.int32)[::-1]
        return np.array(np.divmod(first_seen, cells.shape[1]))
