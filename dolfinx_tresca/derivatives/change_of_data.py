"""How the data of a solution change with controls, and how outputs change with the data.

The data of a solution are the load f, the prescribed values u_D, the offsets (d; s) (gaps and slip
origins) and the radii g of the friction discs. A `DataVector` has one entry for each datum. It is a
change of the data, (df, du_D, do, dg), or the derivatives of an output with respect to the data:
(z, w, y, t) with the adjoint (z, y), see `linearised`. The output changes by the inner product of
both.

`DataOfSolution` is the one place that knows what depends on controls: forms, Dirichlet conditions,
gaps, terms and curves of friction laws, and the rows of B, which rigid obstacles change. Its two
methods are transposed to each other: `change` is for tangents, and for gradients with respect to
Constants, which have few values; `pulled_back` is for gradients with respect to Functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.contact_data import MovedRows, moved_rows, nodal_fields
from dolfinx_tresca.derivatives.goals import value_of
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.nodal_values import inputs_of, replaced, values_of
from dolfinx_tresca.dual.slip_bounds import TERMS
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import DryFriction
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.forces import Forms

#: Input with respect to which derivatives are taken; users change its values in place.
Control: TypeAlias = "fem.Constant | fem.Function"


def checked_controls(controls: Any) -> list[Control]:
    """Check that controls are a list of Constants and Functions, and return the list.

    Not collective.

    Args:
        controls: the user's argument, which may have any type.

    Raises:
        InputError: controls are not such a list.
    """
    if not isinstance(controls, Sequence):
        raise InputError(
            "controls must be a list of fem.Constant and fem.Function, such as [coefficient], "
            f"found {shown(controls)}."
        )
    for control in controls:
        if not isinstance(control, fem.Constant | fem.Function):
            raise InputError(
                f"a control must be a fem.Constant or a fem.Function, found {shown(control)}."
            )
    return list(controls)


def checked_directions(controls: Sequence[Control], directions: Any) -> list[Any]:
    """Check changes of controls, and return them: arrays for Constants, or Functions.

    Not collective.

    Raises:
        InputError: there is not one direction of the right type for each control.
    """
    directions = list(directions) if isinstance(directions, Sequence) else [directions]
    if len(directions) != len(controls):
        raise InputError(
            f"directions must be a list with one for each control, found {len(directions)} for "
            f"{len(controls)} control(s)."
        )
    result = []
    for control, given in zip(controls, directions, strict=True):
        direction = given
        if isinstance(control, fem.Function):
            if (
                not isinstance(direction, fem.Function)
                or direction.function_space != control.function_space
            ):
                raise InputError(
                    f"the direction of the Function {control.name} must be a Function on its space,"
                    f" found {shown(direction)}."
                )
            values = direction.x.array
        else:
            direction = values = np.asarray(given, dtype=np.float64)
            if values.shape != control.ufl_shape:
                raise InputError(
                    f"the direction of a Constant must have its shape {control.ufl_shape}, found "
                    f"{shown(given)}."
                )
        if not np.isfinite(values).all():
            raise InputError(f"the direction of {shown(control)} is NaN or infinite.")
        result.append(direction)
    return result


@dataclass
class DataVector:
    """A change of the data of a solution, or the derivatives of an output by the data.

    Attributes:
        force: change of the load [force]; or the adjoint displacement z, zero where u is
            prescribed.
        prescribed: change of the prescribed values [length], zero elsewhere; or derivatives with
            respect to all values of u, of which those with respect to prescribed values count.
        offset: (size,) change of (d; s), divided by `JumpOperator.length_scale`; or y.
        radius: (n_discs,) change of the radii of the discs; or derivatives by them.
        moved: central differences of B, in a change of the data for which obstacles move.
    """

    force: fem.Function
    prescribed: fem.Function
    offset: Array
    radius: Array
    moved: list[MovedRows] = field(default_factory=list)

    def inner(self, change: DataVector, inner: Callable[[Array, Array], Any]) -> float:
        """Return the change of the output of these derivatives by a change of the data. Collective.

        Args:
            change: the change of the data.
            inner: the inner product of arrays over all ranks.
        """
        owned = owned_size(self.force)
        products = [(self.offset, change.offset), (self.radius, change.radius)]
        products += [
            (by_field.x.array[:owned], field_change.x.array[:owned])
            for by_field, field_change in (
                (self.force, change.force),
                (self.prescribed, change.prescribed),
            )
        ]
        return float(sum(inner(derivatives, values) for derivatives, values in products))


class DataOfSolution:
    """The data of solutions as functions of controls, to first order.

    Forms are compiled once for any number of solutions of a problem: call `linearise` with each.
    """

    def __init__(
        self, system: ContactSystem, forms: Forms, u: fem.Function, *, in_all_steps: bool = False
    ) -> None:
        """Keep what data depend on. Not collective.

        Args:
            system: the problem.
            forms: forms and conditions of the bodies at u.
            u: displacement in the forms, to which `linearise` gives the values of a solution.
            in_all_steps: see `moved_rows`.
        """
        self.system, self.u, self.comm = system, u, system.comm
        self._forms, self._in_all_steps = forms, in_all_steps
        self._values = system.surfaces.nodal_values
        self._z = fem.Function(u.function_space, name="adjoint")
        self._residual = forms.residual(ufl.TestFunction(u.function_space))
        self._work = forms.residual(self._z)
        self._compiled: dict[Any, Any] = {}

    def check_controls(self, controls: Sequence[Control]) -> None:
        """Check that derivatives with respect to controls are known. Collective.

        Raises:
            InputError: a direction or two bounds of orthotropic friction, or the position of an
                obstacle that reads a Function, depend on a control.
        """
        surfaces = self.system.surfaces
        for control in controls:
            for pair in self.system.pairs:
                terms = pair.friction.terms if isinstance(pair.friction, DryFriction) else None
                if terms is None or terms.direction is None:
                    continue
                bounds = [getattr(terms, name) for name in TERMS]
                axes = [bound for bound in bounds if isinstance(bound, tuple)]
                if control in inputs_of((terms.direction, *axes)):
                    raise InputError(
                        f"contact pair {pair}: the derivative with respect to {shown(control)} is "
                        "not known, since it is part of the direction or the two bounds of "
                        "orthotropic friction. Compare two solutions."
                    )
            surfaces.obstacles.depending_on(control, surfaces.jump)

    def linearise(self, contact: LinearisedContact) -> None:
        """Take the data of a solution. Collective."""
        self.contact = contact
        if self.u is not contact.u:
            self.u.x.array[:] = contact.u.x.array
        self._fields = nodal_fields(contact, self.system.pairs)

    def change(
        self, controls: Sequence[Control], directions: Sequence[Any]
    ) -> tuple[DataVector, list[bool]]:
        """Return the change of the data along a direction of controls. Collective.

        Args:
            controls: Constants and Functions.
            directions: their changes, an array for a Constant, a Function for a Function.

        Returns:
            the change of the data, and for each control whether data depend on it.

        Raises:
            InputError: the derivative with respect to a control is not known.
        """
        V, contact = self.u.function_space, self.contact
        size, discs = contact.face.discs.size, len(contact.face.discs.radius)
        change = DataVector(fem.Function(V), fem.Function(V), np.zeros(size), np.zeros(discs))
        owned = owned_size(self.u)
        depends = []
        for control, direction in zip(controls, directions, strict=True):
            is_input = False
            rows = None
            if isinstance(control, fem.Constant):
                rows = moved_rows(self.system, contact, control, direction, self._in_all_steps)
            if rows is not None:
                is_input = True
                change.force.x.array[:owned] += rows.force
                change.offset += rows.offset
                change.radius += rows.radius
                change.moved.append(rows)
            form = self._along(self._residual, control, direction)
            if form is not None:
                is_input = True
                change.force.x.array[:owned] -= owned_entries(form)
            for scalar in self._fields:
                rates = self._values.pushed_forward(
                    scalar.field, control, direction, scalar.nodes, scalar.name
                )
                if rates is not None:
                    is_input = True
                    change.offset += scalar.offset @ rates
                    change.radius[scalar.discs] += scalar.radius * rates
            by_control = self._prescribed_by(control, _flat(direction))
            change.prescribed.x.array[:] += by_control
            is_input |= bool(self.comm.allreduce(bool(by_control.any()), op=MPI.LOR))
            depends.append(is_input)
        change.prescribed.x.scatter_forward()
        return change, depends

    def pulled_back(self, control: fem.Function, derivatives: DataVector) -> Array | None:
        """Return derivatives of an output by the values of a Function. Collective.

        Args:
            control: the Function.
            derivatives: derivatives of the output with respect to the data.

        Returns:
            derivatives with respect to the values that this rank owns; None if no datum depends on
            the Function.

        Raises:
            InputError: the derivative with respect to the Function is not known.
        """
        self._z.x.array[:] = derivatives.force.x.array
        owned, terms = owned_size(control), []
        form = self._along(self._work, control, None)
        if form is not None:
            terms.append(-owned_entries(form))
        for scalar in self._fields:
            weights = scalar.offset.T @ derivatives.offset
            weights += scalar.radius * derivatives.radius[scalar.discs]
            by_field = self._values.pulled_back(
                scalar.field, control, scalar.nodes, weights, scalar.name
            )
            if by_field is not None:
                terms.append(by_field)
        numbers = np.arange(1, len(control.x.array) + 1, dtype=np.float64)
        source = self._prescribed_by(control, numbers).astype(np.intp)[: owned_size(self.u)]
        depends = source > 0
        if self.comm.allreduce(bool(depends.any()), op=MPI.LOR):
            vector = dolfinx.la.vector(control.x.index_map, control.x.block_size)
            weights = derivatives.prescribed.x.array[: len(source)]
            np.add.at(vector.array, source[depends] - 1, weights[depends])
            vector.scatter_reverse(dolfinx.la.InsertMode.add)
            terms.append(vector.array[:owned].copy())
        return sum(terms[1:], terms[0]) if terms else None

    def explicit_rate(
        self, goal: Any, controls: Sequence[Control], directions: Sequence[Any], change: DataVector
    ) -> float | None:
        """Return the change of a goal with u and the multipliers fixed. Collective.

        A form of rank 0 may depend on controls, and a goal such as a force depends on the position
        of obstacles through normals and tangents.

        Args:
            goal: a goal, or a form of rank 0.
            controls: Constants and Functions.
            directions: their changes.
            change: the change of the data that these changes cause.

        Returns:
            the change, to first order; None if the goal depends on the data alone.
        """
        if not isinstance(goal, ufl.Form):
            x = self.contact.multipliers
            rates = [
                float(rows.rate(lambda side, jump_of_u: value_of(goal, side, x, jump_of_u)))
                for rows in change.moved
            ]
        else:
            forms = [
                self._along(goal, control, direction)
                for control, direction in zip(controls, directions, strict=True)
            ]
            rates = [
                float(self.comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM))
                for form in forms
                if form is not None
            ]
        return sum(rates) if rates else None

    def by_values(self, form: Any, control: fem.Function) -> Array | None:
        """Return the derivatives of a form of rank 0 by a Function's own values. Collective.

        The result is None if the form does not depend on the Function.
        """
        derivative = self._along(form, control, None)
        return None if derivative is None else owned_entries(derivative)

    def pull_of(self, prescribed: fem.Function) -> Array:
        """Return K u (owned,) [force] for a displacement u of prescribed nodes. Collective."""
        form = self._forms.compiled(ufl.action(self._forms.tangent, prescribed))
        return owned_entries(form)

    def reaction_of(self, z: fem.Function) -> Array:
        """Return K'z (owned,) for a displacement z. Collective."""
        self._z.x.array[:] = z.x.array
        if "reaction" not in self._compiled:
            test, trial = self._forms.tangent.arguments()
            moved = {test: self._z, trial: ufl.TestFunction(z.function_space)}
            self._compiled["reaction"] = self._forms.compiled(
                ufl.replace(self._forms.tangent, moved)
            )
        return owned_entries(self._compiled["reaction"])

    def _prescribed_by(self, control: Control, values: Array) -> Array:
        """Return the values that Dirichlet conditions take from a control. Not collective.

        DOLFINx does not say which values these are: the effect of the conditions shows it.

        Args:
            control: a Constant or a Function.
            values: values that the control takes.

        Returns:
            (local degrees of freedom,) prescribed values, zero where they are no control's value.
        """
        ends = np.zeros((2, len(self.u.x.array)))
        for prescribed, given in zip(ends, (values, np.zeros_like(values)), strict=True):
            with replaced([control], [given]):
                for bc in self._forms.bcs:
                    bc.set(prescribed)
        return np.asarray(ends[0] - ends[1])

    def _along(self, form: Any, control: Control, direction: Any) -> fem.Form | None:
        """Return the compiled derivative of a form along a change of a control. Collective.

        Args:
            form: a form of any rank.
            control: a Constant or a Function.
            direction: change of the control: values of a Constant, or a Function; None: the result
                has one value for each value of the Function.

        Returns:
            the form; None if the form does not depend on the control.
        """
        if control not in (*form.constants(), *form.coefficients()):
            return None
        key = id(form), id(control), direction is None
        if key not in self._compiled:
            if isinstance(control, fem.Function):
                m, space = control, control.function_space
            else:  # UFL differentiates by Functions: take one with the same value in all cells
                space = fem.functionspace(self.u.function_space.mesh, ("DG", 0, control.ufl_shape))
                m = fem.Function(space)
            along = ufl.TestFunction(space) if direction is None else fem.Function(space)
            replaced_form = form if m is control else ufl.replace(form, {control: m})
            derivative = self._forms.compiled(ufl.derivative(replaced_form, m, along))
            self._compiled[key] = form, derivative, m, along  # keeping `form` keeps its id valid
        _, derivative, m, along = self._compiled[key]
        if m is not control:
            m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // control.value.size)
        if direction is not None:
            values = _flat(direction)
            along.x.array[:] = np.tile(values, len(along.x.array) // len(values))
        return derivative


def inputs_of_problem(
    forms: Sequence[Any], pairs: Sequence[ContactPair], bcs: Sequence[Any]
) -> list[Any]:
    """Return all Constants and Functions on which solutions depend, each once.

    Values of Dirichlet conditions may be C++ objects of DOLFINx; `values_of` accepts them, too.
    """
    inputs: list[Any] = []
    for form in forms:
        if form is not None:
            inputs += [*form.coefficients(), *form.constants()]
    for pair in pairs:
        inputs += inputs_of(pair.gap)
        if isinstance(pair.friction, DryFriction):
            terms = pair.friction.terms
            functions = [getattr(terms.curve, name, None) for name in ("function", "derivatives")]
            for term in (*(getattr(terms, name) for name in TERMS), *functions):
                inputs += inputs_of(term)
    inputs += [bc.g for bc in bcs]
    return list(dict.fromkeys(inputs))


def _flat(direction: Any) -> Array:
    """Return a change of a control as a flat array. Not collective."""
    return values_of(direction) if isinstance(direction, fem.Function) else np.ravel(direction)


def owned_size(function: fem.Function) -> int:
    """Return the number of values of a Function that this rank owns. Not collective."""
    return int(function.x.index_map.size_local * function.x.block_size)


def owned_entries(form: fem.Form) -> Array:
    """Return the entries of a linear form for the degrees of freedom of this rank. Collective."""
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.asarray(vector.array[: vector.index_map.size_local * vector.block_size])
