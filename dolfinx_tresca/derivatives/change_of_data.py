"""How the data of a solution change with controls, and how outputs change with the data.

The data of a solution are the load f, the prescribed values u_D, the offsets (d; s) (gaps and slip
origins) and the radii g of the friction discs. A `DataVector` has one entry for each datum. It is a
change of the data, (df, du_D, do, dg), or the derivatives of an output with respect to the data:
(z, w, y, t) with the adjoint (z, y), see `linearised`. The output changes by the inner product of
both.

`DataOfSolution` is the one place that knows what depends on controls: forms, Dirichlet conditions,
gaps, terms and curves of friction laws (`nodal_fields`), and the rows of B, which rigid obstacles
change (`moved_rows`). Its two methods are transposed to each other: `change` is for tangents, and
for gradients with respect to Constants, which have few values; `pulled_back` is for gradients with
respect to Functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_array

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.functions import with_owned_values
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.goals import value_of
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import Carry, moved_jump
from dolfinx_tresca.dual.nodal_values import DIFFERENCE, inputs_of, replaced, values_of
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.forces import Forms
from dolfinx_tresca.solvers.friction_cones import FrictionCones, pressed_values

#: Input with respect to which derivatives are taken; users change its values in place.
Control: TypeAlias = "fem.Constant | fem.Function"


@dataclass(frozen=True)
class NodalField:
    """A user's scalar field, such as a gap, at the nodes of a pair, and its effect on the data.

    Attributes:
        field: the scalar as the user gave it.
        nodes: (n,) local numbers of the nodes.
        name: name of the scalar in errors.
        discs: the discs of the nodes.
        radius: (n,) derivatives of the radii of these discs with respect to the nodal values.
        offset: (size, n) derivatives of the offsets (d; s), divided by
            `JumpOperator.length_scale`, with respect to the nodal values.
    """

    field: Any
    nodes: LocalNumbers
    name: str
    discs: slice
    radius: Array
    offset: csr_array


def nodal_fields(contact: LinearisedContact, pairs: Sequence[ContactPair]) -> list[NodalField]:
    """Return the scalars on which solutions depend: gaps and terms of slip bounds. Collective."""
    jump, x, r = contact.dual.jump, contact.multipliers, contact.gradient
    size = contact.face.discs.size
    cones = contact.dual.admissible.at_point(x, r)
    curves = iter(cones.curve_arguments(x) if isinstance(cones, FrictionCones) else ())
    is_limited = cones.exceed_limit(x) if isinstance(cones, FrictionCones) else False

    def radii(constant: float, coefficient: float) -> Array:
        """Return the radii (n_discs,) for a bound c + F p that is the same at all nodes."""
        ones = [np.ones(len(pair.nodes)) for pair in jump.pairs]
        bounds = [NodalBounds(constant * unit, coefficient * unit, np.inf * unit) for unit in ones]
        return np.asarray(jump.bounded(bounds).section(x).radius)

    by_constant = radii(1.0, 0.0)
    by_term = {
        "constant": by_constant,
        "coefficient": np.where(is_limited, 0.0, radii(0.0, 1.0)),
        "limit": np.where(is_limited, by_constant, 0.0),
    }
    result: list[NodalField] = []
    for pair, operators, discs, (normal, _) in zip(
        pairs, jump.pairs, jump.nodes, jump.slices, strict=True
    ):
        n, rows = len(operators.nodes), np.arange(normal.start, normal.stop)
        entries = 1.0 / jump.length_scale[normal], (rows, operators.normal_node)
        by_gap, name = csr_array(entries, shape=(size, n)), f"the gap of contact pair {pair}"
        of_pair = partial(NodalField, nodes=operators.nodes, discs=discs)
        result.append(of_pair(pair.gap, name=name, radius=np.zeros(n), offset=by_gap))
        terms = pair.friction.terms
        for term, words in TERMS.items():
            scalar, name = getattr(terms, term), f"{words} of {pair}"
            if term == "coefficient" and terms.curve is not None:
                scalar = partial(pressed_values, *next(curves))
            if not isinstance(scalar, tuple):  # `check_controls` refuses controls in two bounds
                by_bound = by_term[term][discs]
                result.append(of_pair(scalar, name=name, radius=by_bound, offset=0.0 * by_gap))
    return result


@dataclass(frozen=True)
class MovedRows:
    """Central differences of B in a direction of a Constant that moves obstacles.

    Gaps, normals and tangents at the nodes depend on the position of an obstacle. Their central
    differences have relative errors of some 1e-10, and need no solve.

    Attributes:
        sides: B with the obstacles displaced forwards and backwards.
        jumps: (size,) B u with both operators.
        step: size of the displacement, as a factor of the direction.
        origin: (size,) the slip origin that keeps its vector at each node, in components along the
            tangents of the solution.
    """

    sides: Sequence[JumpOperator]
    jumps: Sequence[Array]
    step: float
    origin: Array

    def rate(self, function: Callable[[JumpOperator, Array], Any]) -> Any:
        """Return the directional derivative of a function of B and B u. Collective if it is."""
        after, before = map(function, self.sides, self.jumps)
        return (after - before) / (2.0 * self.step)


def moved_rows(
    system: ContactSystem,
    contact: LinearisedContact,
    constant: fem.Constant,
    direction: Array,
    in_all_steps: bool,
) -> MovedRows | None:
    """Return the central differences of B in a direction of a Constant. Collective.

    Args:
        system: the problem, after a solve.
        contact: the solution.
        constant: the Constant, on which positions of obstacles may depend.
        direction: change of the Constant, an array of the shape of its value.
        in_all_steps: whether the Constant changes in all load steps so far. If not, it changes only
            after the last accepted step: the slip of the accepted steps stays the same vector at
            each node, whose components change with the tangents.

    Returns:
        the differences; None if no obstacle depends on the Constant.

    Raises:
        InputError: an obstacle moves in the load step of the last solve, or a node faces the
            obstacle at only one of the two displaced positions of the obstacle.
    """
    surfaces, obstacles, jump = system.surfaces, system.surfaces.obstacles, system.surfaces.jump
    moves = obstacles.rates(constant, None, jump) > 0.0
    if not moves.any():
        return None
    origin: Array = np.zeros(len(jump.gap))
    if not in_all_steps:
        solved = system.solution_for("a derivative")
        origin, moves_in_step = solved.dual.history.origin, moves & solved.moved
        for pair, moved, (_, t) in zip(system.pairs, moves_in_step, jump.slices, strict=True):
            if moved and system.comm.allreduce(bool(origin[t].any()), op=MPI.LOR):
                raise InputError(
                    f"contact pair {pair}: the derivative with respect to the place of an "
                    "obstacle is not known for a load step in which move_to() moves it."
                )
    # with a step that changes distances by a given length, differences do not depend on the units
    largest = float(obstacles.rates(constant, direction, jump).max(initial=0.0))
    step = DIFFERENCE * obstacles.extent / largest if largest > 0.0 else 0.0
    sides = []
    for factor in (step, -step):
        with replaced([constant], [values_of(constant) + factor * np.ravel(direction)]):
            displaced = moved_jump(jump, system.pairs, surfaces.state.geometry, moves)
        sides.append(displaced.along_axes(contact.bounds))
    same = all(
        np.array_equal(displaced.nodes, pair.nodes)
        and np.array_equal(displaced.row_node, pair.row_node)
        and np.allclose(displaced.weights, pair.weights, rtol=1e-9)
        and (np.abs(displaced.tangents - pair.tangents) <= 0.05).all()  # the same row of T
        for side in sides
        for displaced, pair in zip(side.pairs, jump.pairs, strict=True)
    )
    if not system.comm.allreduce(same, op=MPI.LAND):
        raise InputError(
            "nodes are at the edge of what faces an obstacle, or of its search limit: there is "
            "no derivative with respect to its place. Compare two solutions."
        )
    jumps = [side.of_displacement(contact.u) for side in sides]
    return MovedRows(sides, jumps, step or 1.0, origin)


@dataclass
class DataVector:
    """A change of the data of a solution, or the derivatives of an output by the data.

    Attributes:
        force: (owned degrees of freedom,) change of the load [force]; or the adjoint displacement
            z, zero where u is prescribed.
        prescribed: (owned degrees of freedom,) change of the prescribed values [length], zero
            elsewhere; or derivatives with respect to all values of u, of which those with respect
            to prescribed values count.
        offset: (size,) change of (d; s), divided by `JumpOperator.length_scale`; or y.
        radius: (n_discs,) change of the radii of the discs; or derivatives by them.
        moved: central differences of B, in a change of the data for which obstacles move.
    """

    force: Array
    prescribed: Array
    offset: Array
    radius: Array
    moved: list[MovedRows] = field(default_factory=list)

    def inner(self, change: DataVector, inner: Callable[[Array, Array], Any]) -> float:
        """Return the change of the output of these derivatives by a change of the data. Collective.

        Args:
            change: the change of the data.
            inner: the inner product of arrays over all ranks.
        """
        names = ("force", "prescribed", "offset", "radius")
        return float(sum(inner(getattr(self, name), getattr(change, name)) for name in names))


class DataOfSolution:
    """The data of solutions as functions of controls, to first order.

    Forms are compiled once for any number of solutions of a problem: call `linearise` with each.
    """

    def __init__(
        self, system: ContactSystem, forms: Forms, u: fem.Function, *, in_all_steps: bool = False
    ) -> None:
        """Keep what data depend on. Collective.

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
        test, trial = forms.tangent.arguments()
        transposed = {test: self._z, trial: ufl.TestFunction(u.function_space)}
        self._reaction = forms.compiled(ufl.replace(forms.tangent, transposed))
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
                terms = pair.friction.terms
                bounds = [getattr(terms, name) for name in TERMS]
                axes = [bound for bound in bounds if isinstance(bound, tuple)]
                if control in inputs_of((terms.direction, *axes)):
                    raise InputError(
                        f"contact pair {pair}: the derivative with respect to {shown(control)} is "
                        "not known, since it is part of the direction or the two bounds of "
                        "orthotropic friction. Compare two solutions."
                    )
            surfaces.obstacles.rates(control, None, surfaces.jump)

    def linearise(self, contact: LinearisedContact) -> None:
        """Take the data of a solution. Collective."""
        self.contact = contact
        if self.u is not contact.u:
            self.u.x.array[:] = contact.u.x.array
        self._fields = nodal_fields(contact, self.system.pairs)

    def change(self, controls: Sequence[Control], directions: Sequence[Any]) -> DataVector:
        """Return the change of the data along a direction of controls. Collective.

        Args:
            controls: Constants and Functions.
            directions: their changes, an array for a Constant, a Function for a Function.

        Raises:
            InputError: the derivative with respect to a control is not known.
        """
        contact, owned = self.contact, owned_size(self.u)
        jump, x = contact.dual.jump, contact.multipliers
        discs = len(contact.face.discs.radius)
        force, prescribed = np.zeros((2, owned))
        change = DataVector(force, prescribed, np.zeros(len(x)), np.zeros(discs))

        def radii(side: JumpOperator, _: Array) -> Array:
            values = side.bounded(contact.bounds).section(x).radius
            return np.where(np.isfinite(values), values, 0.0)

        def offsets(side: JumpOperator, jump_of_u: Array, origin: Array) -> Array:
            return np.asarray(side.gap - jump_of_u + Carry(jump, side).residuals(origin))

        for control, direction in zip(controls, directions, strict=True):
            change.force -= self.derivative(self._residual, control, direction)
            change.prescribed += self._prescribed_by(control, _flat(direction))
            for scalar in self._fields:
                rates = self._values.pushed_forward(
                    scalar.field, control, direction, scalar.nodes, scalar.name
                )
                if rates is not None:
                    change.offset += scalar.offset @ rates
                    change.radius[scalar.discs] += scalar.radius * rates
            if not isinstance(control, fem.Constant):
                continue
            rows = moved_rows(self.system, contact, control, direction, self._in_all_steps)
            if rows is not None:
                change.moved.append(rows)
                change.force -= rows.rate(lambda side, _: np.array(side.whole_force(x).array))
                change.radius += rows.rate(radii)
                change.offset += rows.rate(partial(offsets, origin=rows.origin))
        return change

    def pulled_back(self, control: fem.Function, derivatives: DataVector) -> Array:
        """Return derivatives of an output by the values of a Function that this rank owns.

        Collective.

        Args:
            control: the Function.
            derivatives: derivatives of the output with respect to the data.

        Raises:
            InputError: the derivative with respect to the Function is not known.
        """
        self._z.x.array[: len(derivatives.force)] = derivatives.force
        self._z.x.scatter_forward()
        by_prescribed = dolfinx.la.vector(control.x.index_map, control.x.block_size)
        numbers = np.arange(1, len(control.x.array) + 1, dtype=np.float64)
        source = self._prescribed_by(control, numbers).astype(np.intp)
        depends = source > 0
        np.add.at(by_prescribed.array, source[depends] - 1, derivatives.prescribed[depends])
        by_prescribed.scatter_reverse(dolfinx.la.InsertMode.add)
        result = by_prescribed.array[: owned_size(control)].copy()
        result -= self.derivative(self._work, control)
        for scalar in self._fields:
            weights = scalar.offset.T @ derivatives.offset
            weights += scalar.radius * derivatives.radius[scalar.discs]
            by_field = self._values.pulled_back(
                scalar.field, control, scalar.nodes, weights, scalar.name
            )
            if by_field is not None:
                result += by_field
        return np.asarray(result)

    def explicit_rate(
        self, goal: Any, controls: Sequence[Control], directions: Sequence[Any], change: DataVector
    ) -> float:
        """Return the change of a goal with u and the multipliers fixed, to first order. Collective.

        A form of rank 0 may depend on controls, and a goal such as a force depends on the position
        of obstacles through normals and tangents.

        Args:
            goal: a goal, or a form of rank 0.
            controls: Constants and Functions.
            directions: their changes.
            change: the change of the data that these changes cause.
        """
        if isinstance(goal, ufl.Form):
            pairs = zip(controls, directions, strict=True)
            return float(sum(self.derivative(goal, *pair) for pair in pairs))
        x = self.contact.multipliers
        return float(
            sum(
                rows.rate(lambda side, jump_of_u: value_of(goal, side, x, jump_of_u))
                for rows in change.moved
            )
        )

    def pull_of(self, prescribed: Array) -> Array:
        """Return K u (owned,) [force] for a displacement u of prescribed nodes. Collective."""
        u = with_owned_values(self.u.function_space, prescribed)
        return _owned_entries(self._forms.compiled(ufl.action(self._forms.tangent, u)))

    def reaction_of(self, z: fem.Function) -> Array:
        """Return K'z (owned,) for a displacement z. Collective."""
        self._z.x.array[:] = z.x.array
        return _owned_entries(self._reaction)

    def _prescribed_by(self, control: Control, values: Array) -> Array:
        """Return the values that Dirichlet conditions take from a control. Not collective.

        DOLFINx does not say which values these are: the effect of the conditions shows it.

        Args:
            control: a Constant or a Function.
            values: values that the control takes.

        Returns:
            (owned degrees of freedom,) prescribed values, zero where they are no control's value.
        """
        ends = np.zeros((2, len(self.u.x.array)))
        for prescribed, given in zip(ends, (values, np.zeros_like(values)), strict=True):
            with replaced([control], [given]):
                for bc in self._forms.bcs:
                    bc.set(prescribed)
        return np.asarray(ends[0] - ends[1])[: owned_size(self.u)]

    def derivative(self, form: Any, control: Control, direction: Any = None) -> Any:
        """Return the derivative of a form by a control; 0 if it does not depend on it. Collective.

        Args:
            form: a form; of rank 0 if there is no direction.
            control: a Constant or a Function.
            direction: change of the control: values of a Constant, or a Function; None: the result
                has one value for each value of the Function.

        Returns:
            a number, or the entries (owned degrees of freedom,) of a vector.
        """
        if control not in (*form.constants(), *form.coefficients()):
            return 0.0
        key = id(form), id(control), direction is None
        if key not in self._compiled:
            if isinstance(control, fem.Function):
                m, space = control, control.function_space
            else:  # UFL differentiates by Functions: take one with the same value in all cells
                space = fem.functionspace(self.u.function_space.mesh, ("DG", 0, control.ufl_shape))
                m = fem.Function(space)
            along = ufl.TestFunction(space) if direction is None else fem.Function(space)
            replaced_form = form if m is control else ufl.replace(form, {control: m})
            compiled = self._forms.compiled(ufl.derivative(replaced_form, m, along))
            self._compiled[key] = form, compiled, m, along  # keeping `form` keeps its id valid
        _, compiled, m, along = self._compiled[key]
        if m is not control:
            m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // control.value.size)
        if direction is not None:
            values = _flat(direction)
            along.x.array[:] = np.tile(values, len(along.x.array) // len(values))
        if compiled.rank == 0:
            return self.comm.allreduce(fem.assemble_scalar(compiled), op=MPI.SUM)
        return _owned_entries(compiled)


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
        terms = pair.friction.terms
        functions = [getattr(terms.curve, name, None) for name in ("function", "derivatives")]
        bounds = [getattr(terms, name) for name in TERMS]
        inputs += inputs_of((pair.gap, *bounds, *functions))
    inputs += [bc.g for bc in bcs]
    return list(dict.fromkeys(inputs))


def _flat(direction: Any) -> Array:
    """Return a change of a control as a flat array. Not collective."""
    return values_of(direction) if isinstance(direction, fem.Function) else np.ravel(direction)


def owned_size(function: fem.Function) -> int:
    """Return the number of values of a Function that this rank owns. Not collective."""
    return int(function.x.index_map.size_local * function.x.block_size)


def _owned_entries(form: fem.Form) -> Array:
    """Return the entries of a linear form for the degrees of freedom of this rank. Collective."""
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.asarray(vector.array[: vector.index_map.size_local * vector.block_size])
