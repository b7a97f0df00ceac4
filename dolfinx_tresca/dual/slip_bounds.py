"""Slip bounds at contact nodes: values of what users gave, as it is now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem
from ufl.classes import Coefficient, Expr
from ufl.domain import extract_domains

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import interpolation_points
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction, Friction
from dolfinx_tresca.scene.scalar_field import ScalarField

FloatArray: TypeAlias = npt.NDArray[np.float64]
NodeArray: TypeAlias = npt.NDArray[np.int32]

#: Negative part of the largest finite slip bound of a pair that is rounding, and means zero.
BOUND_ROUNDING = 1e-12


#: The terms of a bound, for errors.
TERMS = {
    "constant": "the slip bound",
    "coefficient": "the coefficient of friction",
    "limit": "the limit of the slip bound",
}


@dataclass(frozen=True)
class NodalBounds:
    """Slip bounds c + min(F p, l) at the nodes of a pair on this rank.

    Attributes:
        constant: (n,) c [stress].
        coefficient: (n,) F.
        limit: (n,) l [stress].
    """

    constant: Array
    coefficient: Array
    limit: Array


class SlipBounds:
    """Takes slip bounds at nodes of a vector space."""

    def __init__(self, V: Any) -> None:
        """Keep the space of the displacements."""
        self._comm = V.mesh.comm
        self._values = NodalValues(V)

    def check(self, friction: Friction, nodes: npt.NDArray[np.int32]) -> None:
        """Check that there are values at nodes of this rank, whatever they are now. Collective.

        Raises:
            InputError: the bound lives on another mesh, or a function returns something else than
                a number, or one number for each point.
        """
        if isinstance(friction, DryFriction):
            for name, field in vars(friction.terms).items():
                self._values.at(field, nodes, TERMS[name])

    def at(self, friction: Friction, nodes: npt.NDArray[np.int32]) -> NodalBounds:
        """Return the bound at nodes of this rank, as it is now; 0 without friction. Collective.

        Raises:
            InputError: a value is negative by more than rounding, or NaN, or a coefficient is
                infinite; or see `check`.
        """
        terms = friction.terms if isinstance(friction, DryFriction) else BoundTerms()
        found = {name: self._at(field, nodes, TERMS[name]) for name, field in vars(terms).items()}
        return NodalBounds(**found)

    def _at(self, field: ScalarField, nodes: npt.NDArray[np.int32], name: str) -> Array:
        """Return values at nodes of this rank, none of them negative. Collective."""
        values = self._values.at(field, nodes, name)
        largest = values[np.isfinite(values)].max(initial=0.0)
        zero = -BOUND_ROUNDING * self._comm.allreduce(float(largest), op=MPI.MAX)
        with errors_on_all_ranks(self._comm):
            bad = ~(values >= zero)
            if bad.any():
                raise InputError(
                    f"{name} must not be negative, found {values[bad][0]:g} "
                    f"at {bad.sum()} of the {len(nodes)} contact nodes of rank {self._comm.rank}."
                )
            if name == TERMS["coefficient"] and np.isinf(values).any():
                raise InputError(f"{name} must be finite, found infinity.")
        result: Array = np.maximum(values, 0.0)
        return result


class NodalValues:
    """Takes scalars at nodes of a vector space; what a kind needs is made when it is first met."""

    def __init__(self, V: Any) -> None:
        """Keep the space; its element has its nodes as interpolation points."""
        self._V = V
        self._compiled: dict[Expr, fem.Expression] = {}

    def at(self, bound: ScalarField, nodes: NodeArray, name: str) -> FloatArray:
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
            return self._of_expression(bound, nodes, name)
        if callable(bound):
            with errors_on_all_ranks(self._V.mesh.comm):
                return self._of_function(bound, nodes, name)
        return np.full(len(nodes), float(bound))

    def _of_function(
        self, function: Callable[[Any], Any], nodes: NodeArray, name: str
    ) -> FloatArray:
        """Return what a function gives for the nodes. Not collective."""
        n = len(nodes)
        if n == 0:
            return np.zeros(0)
        found = np.asarray(function(self._points[nodes].T.copy()))
        if found.dtype.kind not in "biuf" or found.shape not in ((), (n,), (1, n)):
            raise InputError(
                f"the function for {name} must return a real number, or one for each "
                f"point: for the {n} contact nodes of this rank it gets x of shape (3, {n}) and "
                f"should return an array of shape ({n},), found "
                + (f"{found}." if found.shape == () else f"shape {found.shape} of {found.dtype}.")
            )
        values: FloatArray = np.array(np.broadcast_to(found, (1, n))[0], dtype=np.float64)
        return values

    def _of_expression(self, expression: Expr, nodes: NodeArray, name: str) -> FloatArray:
        """Return the values of a Function or an expression. Collective."""
        mesh = self._V.mesh
        if any(domain != mesh.ufl_domain() for domain in extract_domains(expression)):
            kind = "a Function" if isinstance(expression, Coefficient) else "an expression"
            raise InputError(
                f"{name} is {kind} on another mesh than the problem's. Make it on the mesh "
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
