"""How the data of a solution change with controls.

The data of a solution are the load f, with the prescribed values u_D in their rows, the offsets
(d; s) (gaps and slip origins) and the radii g of the friction discs. A `DataVector` has one entry
for each datum: it is a change of the data, or the derivatives of a goal with respect to the data
(for f and (d; s), the adjoint). The inner product of these two is the change of the goal.

`DataOfSolution` is the one place that knows what depends on controls: forms, Dirichlet conditions,
gaps, terms and curves of friction laws (`nodal_fields`), and the rows of B, which rigid obstacles
change (`jump_differences`). Its two methods are transposed to each other: `change` is for tangents,
and for gradients with respect to Constants; `pulled_back` is for those with respect to Functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeAlias

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_array

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arguments import check_type
from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.functions import owned_size
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.load_steps import Carry, displaced_jump
from dolfinx_tresca.dual.nodal_values import DIFFERENCE, inputs_of, replaced, values_of
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.pair import ContactPair, Goal, checked_goal
from dolfinx_tresca.solvers.feasible_set import FrictionCones, pressed_values

#: Input with respect to which derivatives are taken; users change its values in place.
Control: TypeAlias = "fem.Constant | fem.Function"


class NodalField(NamedTuple):
    """A user's scalar field, such as a gap, at the n nodes of a pair, and its effect on the data.

    Attributes:
        effect: (size + n_discs, n) derivatives of the offsets (d; s), divided by
            `JumpOperator.length_scale`, and of the radii, with respect to the nodal values.
    """

    field: Any
    name: str
    nodes: LocalNumbers
    effect: csr_array


def nodal_fields(linearised: LinearisedContact, pairs: Sequence[ContactPair]) -> list[NodalField]:
    """Return each pair's gap and terms of its slip bound, with their effects. Collective."""
    jump, x = linearised.dual.jump, linearised.multipliers
    cones = linearised.dual.admissible.at_point(x, linearised.gradient)
    # an entry for each pair with a curve, in the order of the pairs
    curves = iter(cones.curve_arguments(x) if isinstance(cones, FrictionCones) else ())
    is_limited = cones.exceed_limit(x) if isinstance(cones, FrictionCones) else False

    def radii_of_bound(constant: float, coefficient: float) -> Array:
        """Return the radii (n_discs,) for bounds c + F p with the same c and F at all nodes."""
        bounds = []
        for pair in jump.pairs:
            ones = np.ones(len(pair.nodes))
            circles = np.ones((len(ones), 2))
            bounds.append(NodalBounds(constant * ones, coefficient * ones, np.inf * ones, circles))
        return np.asarray(jump.bounded(bounds).section(x).radius)

    # derivatives of the radii for bounds c + min(F p, l): since a radius is linear in the bound,
    # they are the radii for 1 (by c), p (by F, below the limit) and 1 (by l, above the limit)
    by_constant = radii_of_bound(1.0, 0.0)
    by_term = {
        "constant": by_constant,
        "coefficient": np.where(is_limited, 0.0, radii_of_bound(0.0, 1.0)),
        "limit": np.where(is_limited, by_constant, 0.0),
    }
    result: list[NodalField] = []
    for pair, rows in zip(pairs, jump.own_rows, strict=True):
        operators, disc = rows.operators, rows.nodes  # each node has a disc
        node = np.arange(len(disc))
        shape = len(x) + len(by_constant), len(node)
        # entries of `effect`, with their rows and columns
        entries: Any = 1.0 / jump.length_scale[rows.normal], (rows.normal, operators.normal_node)
        effect, name = csr_array(entries, shape=shape), f"the gap of contact pair {pair}"
        result.append(NodalField(pair.gap, name, operators.nodes, effect))
        for term, words in TERMS.items():
            scalar = getattr(pair.friction.terms, term)
            if term == "coefficient" and pair.friction.terms.curve is not None:
                scalar = partial(pressed_values, *next(curves))
            if not isinstance(scalar, tuple):  # `check_controls` refuses two bounds of a pair
                entries = by_term[term][disc], (len(x) + disc, node)
                effect, name = csr_array(entries, shape=shape), f"{words} of {pair}"
                result.append(NodalField(scalar, name, operators.nodes, effect))
    return result


@dataclass(frozen=True)
class JumpDifferences:
    """Central differences of B in a direction of a Constant that moves obstacles.

    Gaps, normals and tangents at the nodes depend on the position of an obstacle. Their central
    differences have relative errors of some 1e-10, and need no solve.

    Attributes:
        sides: B with the obstacles displaced forwards and backwards.
        jumps: (size,) B u with both operators, for the same u.
        step: multiple of the direction that is added to the Constant, forwards, or subtracted.
        origin: (size,) the slip origin whose vector at each node does not move with the obstacle,
            in components along the tangents of the solution; zero if the slip origin moves.
    """

    sides: Sequence[JumpOperator]
    jumps: Sequence[Array]
    step: float
    origin: Array

    def rate(self, values: Sequence[Any]) -> Any:
        """Return the rate along the direction of a quantity with these values on both sides."""
        after, before = values
        return (after - before) / (2.0 * self.step)


def jump_differences(
    contact: ContactSystem,
    linearised: LinearisedContact,
    constant: fem.Constant,
    direction: Array,
    in_all_steps: bool,
) -> JumpDifferences | None:
    """Return the central differences of B in a direction of a Constant. Collective.

    The direction has the shape of the Constant's value. The result is None if no distance from an
    obstacle and no normal changes. If the Constant changes `in_all_steps` of a process, the slip
    origin changes, too, with the jumps of the previous step (`goals.gradient`). If it changes in
    the last step alone, the slip origin stays the same vector at each node; its components change.
    """
    obstacles, jump = contact.obstacles, contact.jump
    rates = obstacles.rates(constant, direction, jump)
    moves = rates > 0.0
    if not moves.any():
        return None
    origin: Array = np.zeros(len(jump.gap))
    if not in_all_steps:
        # where move_to() has moved an obstacle in this step, the slip origin depends on its place
        solved = contact.solution_for("a derivative")
        origin = solved.dual.history.origin
        in_step = moves & solved.obstacle_moves
        for pair, moved, rows in zip(contact.pairs, in_step, jump.own_rows, strict=True):
            if moved and contact.comm.allreduce(bool(origin[rows.tangential].any()), op=MPI.LOR):
                raise InputError(
                    f"contact pair {pair}: the derivative with respect to the place of an "
                    "obstacle is not known for a load step in which move_to() moves it."
                )
    # with a step that changes distances by a given length, differences do not depend on the units
    step = DIFFERENCE * obstacles.extent / float(rates.max())
    sides = []
    for factor in (step, -step):
        with replaced([constant], [values_of(constant) + factor * np.ravel(direction)]):
            displaced = displaced_jump(jump, contact.pairs, contact.state.geometry, moves)
        sides.append(displaced.along_axes(linearised.bounds))
    # both sides must have the present nodes, weights and, nearly, tangents: the same rows of B
    has_same_rows = all(
        np.array_equal(displaced.nodes, present.nodes)
        and np.array_equal(displaced.row_node, present.row_node)
        and np.allclose(displaced.weights, present.weights, rtol=1e-9)
        and (np.abs(displaced.tangents - present.tangents) <= 0.05).all()
        for side in sides
        for displaced, present in zip(side.pairs, jump.pairs, strict=True)
    )
    if not contact.comm.allreduce(has_same_rows, op=MPI.LAND):
        raise InputError(
            "nodes are at the edge of what faces an obstacle, or of its search limit: there is "
            "no derivative with respect to its place. Compare two solutions."
        )
    jumps = [side.of_displacement(linearised.u) for side in sides]
    return JumpDifferences(sides, jumps, step, origin)


class DataVector(NamedTuple):
    """A change of the data of a solution, or the derivatives of an output by the data.

    Attributes:
        load: (owned degrees of freedom,) change of the load [force], and of prescribed values
            [length] in their rows; or the adjoint z, and derivatives by prescribed values.
        laws: (size + n_discs,) change of (d; s), divided by `JumpOperator.length_scale`, and of the
            radii of the discs; or the adjoint y, and derivatives by the radii.
        jump_differences: central differences of B, if the change of the data moves obstacles.
    """

    load: Array
    laws: Array
    jump_differences: Sequence[JumpDifferences] = ()


class DataOfSolution:
    """The data of solutions as functions of controls, to first order.

    Forms are compiled once for any number of solutions of a problem: `linearise` chooses one.
    """

    def __init__(
        self, contact: ContactSystem, residual: Any, u: fem.Function, *, in_all_steps: bool = False
    ) -> None:
        """Keep the forms and fields from which the data come. Collective.

        The `residual` is internal minus external forces at u, a form of rank 1; `linearise` gives u
        the values of a solution. `jump_differences` explains `in_all_steps`.
        """
        self.contact, self.u, self.comm = contact, u, contact.comm
        self._residual, self._in_all_steps = residual, in_all_steps
        self._values = contact.friction.values
        self._z = fem.Function(u.function_space, name="adjoint")
        self._work = ufl.action(residual, self._z)
        self._compiled: dict[Any, Any] = {}

    def check_controls(self, controls: Any) -> None:
        """Check that derivatives with respect to the user's controls are known. Collective.

        Raises:
            InputError: controls are no list of Constants and Functions; or a direction or two
                bounds of orthotropic friction, or the position of an obstacle that reads a
                Function, depend on a control.
        """
        wanted = "a list of fem.Constant and fem.Function, such as [coefficient]"
        check_type("controls", controls, Sequence, wanted)
        for control in controls:
            kinds = fem.Constant | fem.Function
            check_type("a control", control, kinds, "a fem.Constant or a fem.Function")
            for pair in self.contact.pairs:
                terms = pair.friction.terms
                bounds = [getattr(terms, name) for name in TERMS]
                axes = [bound for bound in bounds if isinstance(bound, tuple)]
                if control in inputs_of((terms.direction, *axes)):
                    raise InputError(
                        f"contact pair {pair}: the derivative with respect to {shown(control)} is "
                        "not known, since it is part of the direction or the two bounds of "
                        "orthotropic friction. Compare two solutions."
                    )
            # raises an error if an obstacle's place depends on the values of a Function
            self.contact.obstacles.rates(control, None, self.contact.jump)

    def checked_goal(self, goal: Any) -> Goal | ufl.Form:
        """Check a goal that is to be differentiated, and return it. Not collective.

        In forms, the solution's unknowns replace the user's u of a nonlinear problem, which moves.
        """
        if not isinstance(goal, ufl.Form):
            dim = self.u.function_space.mesh.geometry.dim
            return checked_goal(goal, len(self.contact.pairs), dim)
        if goal.arguments():
            raise InputError("the goal is a form with arguments: a number is a form of rank 0.")
        present = self.contact.unknowns
        return goal if present is None else ufl.replace(goal, {present: self.u})

    def linearise(self, linearised: LinearisedContact) -> None:
        """Choose the solution to which `change` and `pulled_back` refer. Collective."""
        self.linearised = linearised
        if self.u is not linearised.u:
            self.u.x.array[:] = linearised.u.x.array
        self._fields = nodal_fields(linearised, self.contact.pairs)

    def change(self, controls: Sequence[Control], directions: Sequence[Any]) -> DataVector:
        """Return the change of the data along directions of controls, summed. Collective.

        The direction of a Constant is an array, that of a Function is a Function.
        """
        contact, linearised = self.contact, self.linearised
        prescribed, x = contact.linear.prescribed, linearised.multipliers
        forces, values = np.zeros(len(prescribed)), np.zeros(len(prescribed))
        laws = np.zeros(len(x) + len(linearised.face.discs.radius))
        differences: list[JumpDifferences] = []
        for control, direction in zip(controls, directions, strict=True):
            forces -= self.derivative(self._residual, control, direction)
            values += self._prescribed_by(control, flat(direction))
            for scalar in self._fields:
                rates = self._values.slopes(
                    scalar.field, control, direction, scalar.nodes, scalar.name
                )
                if rates is not None:
                    laws += scalar.effect @ rates[:, 0]
            if not isinstance(control, fem.Constant):
                continue
            # an obstacle that moves changes B: in the forces B'x, the offsets and the radii
            moved = jump_differences(contact, linearised, control, direction, self._in_all_steps)
            if moved is None:
                continue
            differences.append(moved)
            forces -= moved.rate([np.array(side.whole_force(x).array) for side in moved.sides])
            laws_on_sides = []
            for side, jump_of_u in zip(moved.sides, moved.jumps, strict=True):
                radius = side.bounded(linearised.bounds).section(x).radius
                origin = Carry(linearised.dual.jump, side).jumps(moved.origin)
                # a change of B u at fixed u has the effect of an opposite change of (d; s)
                offset = side.gap - jump_of_u + origin
                laws_on_sides.append(np.append(offset, np.where(np.isfinite(radius), radius, 0.0)))
            laws += moved.rate(laws_on_sides)
        return DataVector(np.where(prescribed, values, forces), laws, differences)

    def pulled_back(self, control: fem.Function, derivatives: DataVector) -> Array:
        """Return the derivatives of a goal by the values of a Function that this rank owns.

        Collective. The given `derivatives` of the goal are those by the data. By the chain rule,
        the residual R contributes -z'dR; prescribed values and nodal fields contribute, too.
        """
        prescribed = self.contact.linear.prescribed
        self._z.x.array[: len(prescribed)] = np.where(prescribed, 0.0, derivatives.load)
        self._z.x.scatter_forward()
        by_prescribed = dolfinx.la.vector(control.x.index_map, control.x.block_size)
        # which value of the control is prescribed where: with its values replaced by the numbers 1,
        # 2, 3, ..., conditions prescribe these numbers, and the result is 0 at other unknowns
        numbers = np.arange(1, len(control.x.array) + 1, dtype=np.float64)
        value_number = self._prescribed_by(control, numbers).astype(np.intp)
        depends = value_number > 0
        np.add.at(by_prescribed.array, value_number[depends] - 1, derivatives.load[depends])
        by_prescribed.scatter_reverse(dolfinx.la.InsertMode.add)
        result = by_prescribed.array[: owned_size(control)] - self.derivative(self._work, control)
        for scalar in self._fields:
            by_field = self._values.pulled_back(
                scalar.field, control, scalar.nodes, scalar.effect.T @ derivatives.laws, scalar.name
            )
            if by_field is not None:
                result += by_field
        return np.asarray(result)

    def _prescribed_by(self, control: Control, values: Array) -> Array:
        """Return what Dirichlet conditions prescribe if a control has the values. Not collective.

        The result (owned degrees of freedom,) is zero where no condition takes a value from the
        control. DOLFINx does not say where one does: values change there if the control is zero.
        """
        with_values = np.zeros(len(self.u.x.array))
        with_zero = np.zeros_like(with_values)
        for prescribed, given in ((with_values, values), (with_zero, np.zeros_like(values))):
            with replaced([control], [given]):
                for bc in self.contact.linear.bcs:
                    bc.set(prescribed)
        return np.asarray(with_values - with_zero)[: owned_size(self.u)]

    def derivative(self, form: Any, control: Control, direction: Any = None) -> Any:
        """Return the derivative of a form by a control, or by u; 0 without dependence. Collective.

        Along a direction (values of a Constant, or a Function), this is a number for a form of rank
        0, and a vector (owned degrees of freedom,) for rank 1. Without a direction, for a Function
        only, it has the derivatives of a form of rank 0 by each value that this rank owns.
        """
        if control not in (*form.constants(), *form.coefficients()):
            return 0.0
        key = id(form), id(control), direction is None
        if key not in self._compiled:
            if isinstance(control, fem.Function):
                space = control.function_space
                along = ufl.TestFunction(space) if direction is None else fem.Function(space)
                change = ufl.derivative(form, control, along)
            else:  # UFL differentiates by the factor of a change of the Constant
                mesh = self.u.function_space.mesh
                along = fem.Constant(mesh, np.zeros(control.ufl_shape))
                factor = ufl.variable(fem.Constant(mesh, 0.0))
                change = ufl.diff(ufl.replace(form, {control: control + factor * along}), factor)
            compiled = fem.form(change, entity_maps=self.contact.linear.entity_maps)
            self._compiled[key] = form, compiled, along  # keeping `form` keeps its id valid
        _, compiled, along = self._compiled[key]
        if direction is not None:
            values_of(along)[:] = flat(direction)
        if compiled.rank == 0:
            return self.comm.allreduce(fem.assemble_scalar(compiled), op=MPI.SUM)
        vector = fem.assemble_vector(compiled)
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        return np.asarray(vector.array[: vector.index_map.size_local * vector.block_size])


def flat(direction: Any) -> Array:
    """Return a change of a control as a flat array. Not collective."""
    return values_of(direction) if isinstance(direction, fem.Function) else np.ravel(direction)
