"""Slip bounds at contact nodes: values of what users gave, as it is now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from ufl.classes import Coefficient, Expr
from ufl.domain import extract_domains

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.compat import collapse, interpolation_points
from dolfinx_tresca._base.number import real
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.friction_axes import NodalEllipses
from dolfinx_tresca.scene.friction import (
    COEFFICIENT_ROUNDING,
    DIRECTION_NAMES,
    Bound,
    BoundTerms,
    DryFriction,
    Friction,
)
from dolfinx_tresca.scene.scalar_field import ScalarField
from dolfinx_tresca.scene.vector_field import VectorField

#: Negative part of the largest finite slip bound of a pair that is rounding, and means zero.
BOUND_ROUNDING = 1e-12

#: The terms of a bound, for errors.
TERMS = {
    "constant": "the slip bound",
    "coefficient": "the coefficient of friction",
    "limit": "the limit of the slip bound",
}

#: What an ellipse turns with, for errors.
DIRECTION = "the direction of the slip bound"


def _semi_axes(bound: Bound, name: str) -> list[tuple[ScalarField, str]]:
    """Return the one or two scalars of a bound, and their names."""
    if not isinstance(bound, tuple):
        return [(bound, name)]
    return [(value, f"{name} {side}") for value, side in zip(bound, DIRECTION_NAMES, strict=True)]


@dataclass(frozen=True)
class NodalBounds:
    """Slip bounds c + min(F p, l) at the nodes of a pair on this rank.

    Attributes:
        constant: (n,) c [stress].
        coefficient: (n,) F.
        limit: (n,) l [stress].
        ellipses: of which these are the longer semi-axes; None: circles.
    """

    constant: Array
    coefficient: Array
    limit: Array
    ellipses: NodalEllipses | None = None


class SlipBounds:
    """Takes slip bounds at nodes of a vector space."""

    def __init__(self, V: Any) -> None:
        """Keep the space of the displacements."""
        self._comm, self._dim = V.mesh.comm, V.mesh.geometry.dim
        self._values = NodalValues(V)

    def check(self, friction: Friction, nodes: LocalNumbers) -> None:
        """Check that there are values at nodes of this rank, whatever they are now. Collective.

        Raises:
            InputError: the bound or the direction lives on another mesh, or a function returns
                something else than a number or vector, or one for each point; or there is a
                direction in 2D.
        """
        if not isinstance(friction, DryFriction):
            return
        for name in TERMS:
            for field, words in _semi_axes(getattr(friction.terms, name), TERMS[name]):
                self._values.at(field, nodes, words)
        if friction.terms.direction is not None:
            if self._dim == 2:
                raise InputError(
                    "two slip bounds and their direction are for surfaces in 3D: in 2D the "
                    "surfaces slide along one direction only, so give one bound."
                )
            self._values.vectors_at(friction.terms.direction, nodes, DIRECTION)

    def check_numbers(
        self, friction: Friction, nodes: LocalNumbers, stress_rounding: float
    ) -> None:
        """Check bounds that are plain numbers, which no solve will find changed. Collective.

        Args:
            friction: the law.
            nodes: contact nodes of this rank.
            stress_rounding: see `at`.

        Raises:
            InputError: one is negative by more than rounding.
        """
        if not isinstance(friction, DryFriction):
            return
        for name in ("constant", "limit"):
            for field, words in _semi_axes(getattr(friction.terms, name), TERMS[name]):
                if real(field) is not None:
                    self._at(field, nodes, words, stress_rounding)

    def at(
        self, friction: Friction, nodes: LocalNumbers, stress_rounding: float = 0.0
    ) -> NodalBounds:
        """Return the bound at nodes of this rank, as it is now; 0 without friction. Collective.

        Args:
            friction: the law.
            nodes: contact nodes of this rank.
            stress_rounding: what is negative by no more is zero [stress], whatever the other nodes
                have.

        Raises:
            InputError: a value is negative by more than rounding, or NaN, or a coefficient is
                infinite, or one of two values alone; or see `check`.
        """
        terms = friction.terms if isinstance(friction, DryFriction) else BoundTerms()
        found: dict[str, Array] = {}
        shape: Array = np.ones((len(nodes), 2))
        for name, words in TERMS.items():
            fields = _semi_axes(getattr(terms, name), words)
            rounding = COEFFICIENT_ROUNDING if name == "coefficient" else stress_rounding
            values = np.stack(
                [self._at(field, nodes, of, rounding) for field, of in fields], axis=1
            )
            found[name] = values.max(axis=1)
            if len(fields) == 2:
                shape = self._shape(values, words)
        ellipses = None
        if terms.direction is not None:
            direction = self._values.vectors_at(terms.direction, nodes, DIRECTION)
            ellipses = NodalEllipses(direction, shape)
        return NodalBounds(found["constant"], found["coefficient"], found["limit"], ellipses)

    def _shape(self, semi_axes: Array, name: str) -> Array:
        """Return semi-axes (n, 2) over the longer one of each node. Collective.

        Raises:
            InputError: only one of two is infinite.
        """
        infinite = np.isinf(semi_axes)
        with errors_on_all_ranks(self._comm):
            if (infinite[:, 0] != infinite[:, 1]).any():
                raise InputError(
                    f"{name} must be finite in both directions, or infinite in both, found "
                    "infinity in one of them. Where surfaces hardly slide in one direction give a "
                    "bound that is larger there by a factor such as 100."
                )
        longer = semi_axes.max(axis=1, keepdims=True)
        shape: Array = np.ones_like(semi_axes)
        np.divide(semi_axes, longer, out=shape, where=np.isfinite(longer) & (longer > 0.0))
        return shape

    def _at(self, field: ScalarField, nodes: LocalNumbers, name: str, rounding: float) -> Array:
        """Return values at nodes of this rank, none of them negative. Collective."""
        values = self._values.at(field, nodes, name)
        largest = values[np.isfinite(values)].max(initial=0.0)
        relative = BOUND_ROUNDING * self._comm.allreduce(float(largest), op=MPI.MAX)
        zero = -max(relative, rounding)
        with errors_on_all_ranks(self._comm):
            bad = ~(values >= zero)
            if bad.any():
                raise InputError(
                    f"{name} must not be negative, found {values[bad][0]:g} "
                    f"at {bad.sum()} of the {len(nodes)} contact nodes of rank {self._comm.rank}."
                )
            if name.startswith(TERMS["coefficient"]) and np.isinf(values).any():
                raise InputError(f"{name} must be finite, found infinity.")
        result: Array = np.maximum(values, 0.0)
        return result


class NodalValues:
    """Takes fields at nodes of a vector space; what a kind needs is made when it is first met."""

    def __init__(self, V: Any) -> None:
        """Keep the space; its element has its nodes as interpolation points."""
        self._V = V
        self._compiled: dict[Expr, fem.Expression] = {}

    def at(self, bound: ScalarField, nodes: LocalNumbers, name: str) -> Array:
        """Return the values, as they are now, at nodes of this rank. Collective.

        Raises:
            InputError: the bound lives on another mesh, or a function returns something else than
                a number, or one number for each point.
        """
        if isinstance(bound, fem.Expression):
            bound = bound.ufl_expression
        if isinstance(bound, fem.Constant):
            return np.full(len(nodes), float(bound.value))
        if isinstance(bound, fem.Function):
            self._check_mesh(bound, name)
            field, position = self._scalar_field
            field.interpolate(bound)
            values: Array = field.x.array[position[nodes]]
            return values
        if isinstance(bound, Expr):
            return self._of_expression(bound, nodes, name).ravel()
        if callable(bound):
            with errors_on_all_ranks(self._V.mesh.comm):
                return self._of_function(bound, nodes, name, 1).ravel()
        return np.full(len(nodes), float(bound))

    def vectors_at(self, direction: VectorField, nodes: LocalNumbers, name: str) -> Array:
        """Return vectors (n, 3), as they are now, at nodes of this rank. Collective.

        Raises:
            InputError: the direction lives on another mesh, or a function returns something else
                than a vector, or one for each point.
        """
        if isinstance(direction, fem.Expression):
            direction = direction.ufl_expression
        if isinstance(direction, fem.Function):
            self._check_mesh(direction, name)
            self._vector_field.interpolate(direction)
            values: Array = self._vector_field.x.array.reshape(-1, 3)[nodes]
            return values
        if isinstance(direction, fem.Constant):
            direction = direction.value
        if isinstance(direction, Expr):
            return self._of_expression(direction, nodes, name)
        if callable(direction):
            with errors_on_all_ranks(self._V.mesh.comm):
                return self._of_function(direction, nodes, name, 3).T
        return np.tile(np.asarray(direction, dtype=np.float64), (len(nodes), 1))

    def _of_function(
        self, function: Callable[[Any], Any], nodes: LocalNumbers, name: str, components: int
    ) -> Array:
        """Return the values (components, n) of a function at the nodes. Not collective."""
        n = len(nodes)
        if n == 0:
            return np.zeros((components, 0))
        found = np.asarray(function(self._points[nodes].T.copy()))
        one, kind = ((), "a real number") if components == 1 else ((3,), "a vector")
        shapes = (one, (components, n), (n,)) if components == 1 else (one, (components, n))
        if found.dtype.kind not in "biuf" or found.shape not in shapes:
            wanted = f"({n},)" if components == 1 else f"({components}, {n})"
            raise InputError(
                f"the function for {name} must return {kind}, or one for each "
                f"point: for the {n} contact nodes of this rank it gets x of shape (3, {n}) and "
                f"should return an array of shape {wanted}, found "
                + (f"{found}." if found.shape == () else f"shape {found.shape} of {found.dtype}.")
            )
        columns = found[:, None] if components == 3 and found.shape == one else found
        values: Array = np.array(np.broadcast_to(columns, (components, n)), dtype=np.float64)
        return values

    def _check_mesh(self, expression: Expr, name: str) -> None:
        """Check that a Function or an expression is on the mesh of the space. Not collective.

        Raises:
            InputError: it is not.
        """
        if any(domain != self._V.mesh.ufl_domain() for domain in extract_domains(expression)):
            kind = "a Function" if isinstance(expression, Coefficient) else "an expression"
            raise InputError(
                f"{name} is {kind} on another mesh than the problem's. Make it on the mesh "
                'of the displacements; of a contact surface take solution.on_mesh("pressure").'
            )

    def _of_expression(self, expression: Expr, nodes: LocalNumbers, name: str) -> Array:
        """Return the values (n, components) of an expression. Collective."""
        self._check_mesh(expression, name)
        mesh = self._V.mesh
        if expression not in self._compiled:
            one = fem.Constant(mesh, 1.0)  # expressions of numbers alone know no mesh
            self._compiled[expression] = fem.Expression(
                one * expression, interpolation_points(self._V.element)
            )
        cells = self._V.dofmap.list
        first = self._first_seen[nodes]
        found = self._compiled[expression].eval(mesh, first // cells.shape[1])
        components = int(np.prod(expression.ufl_shape, dtype=int))
        values: Array = found.reshape(len(nodes), cells.shape[1], components)[
            np.arange(len(nodes)), first % cells.shape[1]
        ]
        return values

    @cached_property
    def _points(self) -> Array:
        """The places (n, 3) of the nodes."""
        points: Array = self._V.tabulate_dof_coordinates()
        return points

    @cached_property
    def _first_seen(self) -> LocalNumbers:
        """The first place of each node in the cells' list of nodes."""
        cells = self._V.dofmap.list
        first = np.zeros(cells.max(initial=-1) + 1, dtype=np.int32)
        first[cells.ravel()[::-1]] = np.arange(cells.size, dtype=np.int32)[::-1]
        return first

    @cached_property
    def _scalar_field(self) -> tuple[fem.Function, LocalNumbers]:
        """A scalar Function, and for each node of V its degree of freedom there. Collective."""
        scalar, dofs = collapse(self._V.sub(0))
        dofs //= self._V.dofmap.index_map_bs
        position = np.empty(len(dofs), dtype=np.int32)
        position[dofs] = np.arange(len(dofs))
        return fem.Function(scalar), position

    @cached_property
    def _vector_field(self) -> fem.Function:
        """A vector Function whose nodes are those of V. Collective."""
        return fem.Function(self._V)
