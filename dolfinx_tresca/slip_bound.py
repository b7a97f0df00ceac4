"""Slip bounds in every form that DOLFINx has for a scalar: checks, and values at nodes."""

from __future__ import annotations

import numbers
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from ufl.classes import Argument, Coefficient, Derivative, Expr, GeometricQuantity
from ufl.corealg.traversal import unique_pre_traversal
from ufl.domain import extract_domains

from dolfinx_tresca._base.compat import interpolation_points
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError

FloatArray: TypeAlias = npt.NDArray[np.float64]
NodeArray: TypeAlias = npt.NDArray[np.int32]

#: A scalar on the contact surface. What it depends on may be changed in place.
ScalarField: TypeAlias = (
    "float | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)

_CONTINUOUS = "Interpolate it into a continuous space, such as Lagrange 1, or project it there."


def check_slip_bound(bound: ScalarField) -> None:
    """Check the kind of a bound, and numbers.

    Raises:
        InputError: it is no scalar, or complex, or has no value at nodes; or it is a number that
            is negative or NaN.
    """
    if isinstance(bound, fem.Constant | fem.Expression | Expr):
        expression = bound.ufl_expression if isinstance(bound, fem.Expression) else bound
        _check_shape(tuple(expression.ufl_shape))
        _check_parts(expression)
    elif not callable(bound) or isinstance(bound, type):
        _check_shape(np.asarray(bound).shape)
        if not isinstance(bound, numbers.Real):
            raise InputError(
                "the slip bound must be a number, a scalar fem.Constant, fem.Function or UFL "
                f"expression, or a function of points, found {bound!r}."
            )
        if not float(bound) >= 0.0:
            raise InputError(f"the slip bound must not be negative, found {bound:g}.")


def _check_shape(shape: tuple[int, ...]) -> None:
    if shape != ():
        raise InputError(
            f"the slip bound must be a scalar, found shape {shape}. For a bound that varies "
            "give a scalar fem.Function or a function of points."
        )


def _check_parts(expression: Expr) -> None:
    """Check that an expression is real and has one value at each node.

    Raises:
        InputError: it does not.
    """
    if expression.ufl_free_indices:
        raise InputError(f"the slip bound must be a scalar, found free indices in {expression}.")
    for part in unique_pre_traversal(expression):
        dtype = np.dtype(getattr(part, "dtype", np.float64))
        if dtype != np.float64:
            raise InputError(f"the slip bound must be of type float64, found {dtype} in {part}.")
        if isinstance(part, Argument):
            raise InputError(
                f"the slip bound must not depend on a trial or test function, found {part}. For a "
                "bound that depends on a displacement use a fem.Function."
            )
        if isinstance(part, Derivative | GeometricQuantity) and not isinstance(
            part, ufl.SpatialCoordinate
        ):
            raise InputError(
                f"the slip bound {expression} has no value at nodes, since {part} jumps from cell "
                f"to cell. {_CONTINUOUS}"
            )
        if isinstance(part, Coefficient) and part.ufl_element() not in ufl.H1:
            raise InputError(
                "the slip bound has no value at nodes: "
                f"'{getattr(part, 'name', part)}' is a discontinuous Function, of "
                f"{part.ufl_element()}. {_CONTINUOUS}"
            )


def slip_bound_text(bound: ScalarField) -> str:
    """Return what a bound is, for people."""
    if isinstance(bound, fem.Function):
        return f"Function '{bound.name}'"
    if isinstance(bound, fem.Constant):
        return f"Constant, now {float(bound.value):g}"
    if isinstance(bound, Expr):
        return f"{bound}"
    if isinstance(bound, fem.Expression):
        return f"{bound.ufl_expression}"
    return "a function of points" if callable(bound) else f"{bound:g}"


class NodalValues:
    """Takes scalars at nodes of a vector space; what a kind needs is made when it is first met."""

    def __init__(self, V: Any) -> None:
        """Keep the space; its element has its nodes as interpolation points."""
        self._V = V
        self._compiled: dict[Expr, fem.Expression] = {}

    def at(self, bound: ScalarField, nodes: NodeArray) -> FloatArray:
        """Return the values, as they are now, at nodes of this rank. Collective.

        Raises:
            InputError: the bound lives on another mesh, or a function returns something else than
                a number, or one number for each point.
        """
        if isinstance(bound, fem.Expression):
            bound = bound.ufl_expression
        if isinstance(bound, fem.Constant):
            return np.full(len(nodes), float(bound.value))
        if isinstance(bound, Expr):
            return self._of_expression(bound, nodes)
        if callable(bound):
            with errors_on_all_ranks(self._V.mesh.comm):
                return self._of_function(bound, nodes)
        return np.full(len(nodes), float(bound))

    def _of_function(self, function: Callable[[Any], Any], nodes: NodeArray) -> FloatArray:
        """Return what a function gives for the nodes. Not collective."""
        n = len(nodes)
        if n == 0:
            return np.zeros(0)
        found = np.asarray(function(self._points[nodes].T.copy()))
        if found.dtype.kind not in "biuf" or found.shape not in ((), (n,), (1, n)):
            raise InputError(
                "the function for the slip bound must return a real number, or one for each "
                f"point: for the {n} contact nodes of this rank it gets x of shape (3, {n}) and "
                f"should return an array of shape ({n},), found "
                + (f"{found}." if found.shape == () else f"shape {found.shape} of {found.dtype}.")
            )
        values: FloatArray = np.array(np.broadcast_to(found, (1, n))[0], dtype=np.float64)
        return values

    def _of_expression(self, expression: Expr, nodes: NodeArray) -> FloatArray:
        """Return the values of a Function or an expression. Collective."""
        mesh = self._V.mesh
        if any(domain != mesh.ufl_domain() for domain in extract_domains(expression)):
            kind = "a Function" if isinstance(expression, Coefficient) else "an expression"
            raise InputError(
                f"the slip bound is {kind} on another mesh than the problem's. Make it on the mesh "
                "of the displacements."
            )
        if isinstance(expression, fem.Function):
            field, position = self._scalar_field
            field.interpolate(expression)
            values: FloatArray = field.x.array[position[nodes]]
            return values
        if expression not in self._compiled:
            one = fem.Constant(mesh, 1.0)  # expressions of numbers alone know no mesh
            self._compiled[expression] = fem.Expression(
                one * expression, interpolation_points(self._V.element)
            )
        cells = self._V.dofmap.list
        first = self._first_seen[nodes]
        found = self._compiled[expression].eval(mesh, first // cells.shape[1])
        values = found.reshape(len(nodes), cells.shape[1])[
            np.arange(len(nodes)), first % cells.shape[1]
        ]
        return values

    @cached_property
    def _points(self) -> FloatArray:
        """The places (n, 3) of the nodes."""
        points: FloatArray = self._V.tabulate_dof_coordinates()
        return points

    @cached_property
    def _first_seen(self) -> NodeArray:
        """The first place of each node in the cells' list of nodes."""
        cells = self._V.dofmap.list
        first = np.zeros(cells.max(initial=-1) + 1, dtype=np.int32)
        first[cells.ravel()[::-1]] = np.arange(cells.size, dtype=np.int32)[::-1]
        return first

    @cached_property
    def _scalar_field(self) -> tuple[fem.Function, NodeArray]:
        """A scalar Function, and for each node of V its degree of freedom there. Collective."""
        scalar, dofs = self._V.sub(0).collapse()
        # 0.11 gives a list of arrays
        dofs = np.asarray(dofs, dtype=np.int64).ravel() // self._V.dofmap.index_map_bs
        position = np.empty(len(dofs), dtype=np.int32)
        position[dofs] = np.arange(len(dofs))
        return fem.Function(scalar), position
