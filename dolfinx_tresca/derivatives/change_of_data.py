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
from functools import partial
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_array

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, LocalNumbers
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.goals import value_of
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import Carry, moved_jump
from dolfinx_tresca.dual.nodal_values import inputs_of, replaced, values_of
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.friction_axes import NodalEllipses
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.forms import Forms
from dolfinx_tresca.solvers.friction_cones import FrictionCones, pressed_values

#: Input with respect to which derivatives are taken; users change its values in place.
Control: TypeAlias = "fem.Constant | fem.Function"

#: Step of the central differences of B: the change of the distance from an obstacle, relative to
#: the extent of the mesh. The truncation error is about the square of the step, the rounding error
#: about the rounding of one value divided by the step.
DIFFERENCE_STEP = 1e-5

#: A tangent with displaced obstacles and a tangent with the obstacles where they are count as the
#: same row of T if none of their components differs by more than this number.
TURNED = 0.05


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
        result = inner(self.offset, change.offset) + inner(self.radius, change.radius)
        for derivative, values in (
            (self.force, change.force),
            (self.prescribed, change.prescribed),
        ):
            owned = owned_size(values)
            result = result + inner(derivative.x.array[:owned], values.x.array[:owned])
        return float(result)


@dataclass(frozen=True)
class MovedRows:
    """Central differences of B in a direction of a Constant that moves obstacles.

    Gaps, normals and tangents at the nodes depend on the position of an obstacle. Their central
    differences have relative errors of some 1e-10, and need no solve.

    Attributes:
        sides: B with the obstacles displaced forwards and backwards; the PETSc objects are freed.
        jumps: (size,) B u with both operators.
        step: size of the displacement, as a factor of the direction.
        present: B with the obstacles where they are.
        origin: (size,) slip origin, divided by `JumpOperator.length_scale`, if at each node it is a
            fixed vector, whose components change with the tangents; None: the components of the
            slip origin are constant.
    """

    sides: tuple[JumpOperator, JumpOperator]
    jumps: tuple[Array, Array]
    step: float
    present: JumpOperator
    origin: Array | None

    def rate(self, function: Callable[[JumpOperator, Array], Any]) -> Any:
        """Return the directional derivative of a function of B and B u. Collective if it is."""
        after, before = map(function, self.sides, self.jumps)
        return (after - before) / (2.0 * self.step)

    @property
    def offset(self) -> Array:
        """(size,) directional derivative of (d; s) - B u, with fixed u, gaps d, slip origins s."""

        def offset(side: JumpOperator, jump_of_u: Array) -> Array:
            gap = side.gap - jump_of_u
            if self.origin is None:
                return gap
            return gap + Carry(self.present, side).residuals(self.origin)

        return np.asarray(self.rate(offset))


def move_obstacles(
    system: ContactSystem,
    in_all_steps: bool,
    contact: LinearisedContact,
    constant: fem.Constant,
    direction: Array,
    change: DataVector,
) -> bool:
    """Add the effect of obstacles that a Constant moves to a change of the data. Collective.

    Args:
        system: the problem, after a solve.
        in_all_steps: whether the Constant changes in all load steps so far. If not, it changes only
            after the last accepted step: the slip of the accepted steps stays the same vector at
            each node, whose components change with the tangents.
        contact: the solution.
        constant: the Constant, on which positions of obstacles may depend.
        direction: change of the Constant, an array of the shape of its value.
        change: the change of the data.

    Returns:
        whether an obstacle depends on the Constant.

    Raises:
        InputError: an obstacle moves in the load step of the last solve, or a node faces the
            obstacle at only one of the two displaced positions of the obstacle.
    """
    surfaces, obstacles, jump = system.surfaces, system.surfaces.obstacles, system.surfaces.jump
    moves = obstacles.depending_on(constant, jump)
    if not moves.any():
        return False
    origin: Array | None = None
    if not in_all_steps:
        solved = system.solved
        assert solved is not None
        origin, moves_in_step = solved.dual.history.origin, moves & solved.moved
        for pair, moved, (_, t) in zip(system.pairs, moves_in_step, jump.slices, strict=True):
            if moved and system.comm.allreduce(bool(origin[t].any()), op=MPI.LOR):
                raise InputError(
                    f"contact pair {pair}: the derivative with respect to the place of an "
                    "obstacle is not known for a load step in which move_to() moves it."
                )
    size = obstacles.step_of_unit_change(constant, direction, jump)
    step, bounds = DIFFERENCE_STEP * obstacles.extent * size, contact.bounds
    sides = []
    for factor in (step, -step):
        with replaced([constant], [values_of(constant) + factor * np.ravel(direction)]):
            displaced = moved_jump(jump, system.pairs, surfaces.state.geometry, moves)
        sides.append(displaced.along_axes(bounds))
        if sides[-1] is not displaced:
            displaced.destroy()
    after, before = sides
    jumps = after.of_displacement(contact.u), before.of_displacement(contact.u)
    rows = MovedRows((after, before), jumps, step or 1.0, jump, origin)
    x = contact.multipliers

    def radius(side: JumpOperator, _: Array) -> Array:
        values = side.bounded(bounds).section(x).radius
        return np.where(np.isfinite(values), values, 0.0)

    same = all(
        np.array_equal(displaced.nodes, pair.nodes)
        and np.array_equal(displaced.row_node, pair.row_node)
        and np.allclose(displaced.weights, pair.weights, rtol=1e-9)
        and (np.abs(displaced.tangents - pair.tangents) <= TURNED).all()
        for side in sides
        for displaced, pair in zip(side.pairs, jump.pairs, strict=True)
    )
    everywhere = system.comm.allreduce(same, op=MPI.LAND)
    if everywhere:
        change.offset += rows.offset
        change.radius += rows.rate(radius)
        pull = rows.rate(lambda side, _: np.array(side.whole_force(x).array))
        change.force.x.array[: len(pull)] -= pull
        change.moved.append(rows)
    for side in sides:
        side.destroy()
    if not everywhere:
        raise InputError(
            "nodes are at the edge of what faces an obstacle, or of its search limit: there is "
            "no derivative with respect to its place. Compare two solutions."
        )
    return True


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
            in_all_steps: see `move_obstacles`.
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
            InputError: a direction of orthotropic friction, or the position of an obstacle that
                reads a Function, depends on a control.
        """
        surfaces = self.system.surfaces
        for control in controls:
            for pair in self.system.pairs:
                law = pair.friction
                if isinstance(law, DryFriction) and control in inputs_of(law.terms.direction):
                    raise InputError(
                        f"contact pair {pair}: the derivative with respect to {shown(control)} is "
                        "not known, since it is part of the direction of orthotropic friction."
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
            if isinstance(control, fem.Constant):
                is_input = move_obstacles(
                    self.system, self._in_all_steps, contact, control, direction, change
                )
            form = self._along(self._residual, control, direction)
            if form is not None:
                is_input = True
                change.force.x.array[:owned] -= assembled(form)[:owned]
            for scalar in self._fields:
                rates = self._values.pushed_forward(
                    scalar.field, control, direction, scalar.nodes, scalar.name
                )
                if rates is not None:
                    is_input = True
                    change.offset += scalar.offset @ rates
                    change.radius[scalar.discs] += scalar.radius * rates
            source = sources_of_prescribed(self._forms.bcs, control, len(self.u.x.array))
            values = values_of(direction) if hasattr(direction, "x") else np.ravel(direction)
            change.prescribed.x.array[source >= 0] += values[source[source >= 0]]
            is_input |= bool(self.comm.allreduce(bool((source >= 0).any()), op=MPI.LOR))
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
        owned, parts = owned_size(control), []
        form = self._along(self._work, control, None)
        if form is not None:
            parts.append(-assembled(form)[:owned])
        for scalar in self._fields:
            weights = scalar.offset.T @ derivatives.offset
            weights += scalar.radius * derivatives.radius[scalar.discs]
            by_field = self._values.pulled_back(
                scalar.field, control, scalar.nodes, weights, scalar.name
            )
            if by_field is not None:
                parts.append(by_field)
        source = sources_of_prescribed(self._forms.bcs, control, owned_size(self.u))
        depends = source >= 0
        if self.comm.allreduce(bool(depends.any()), op=MPI.LOR):
            vector = dolfinx.la.vector(control.x.index_map, control.x.block_size)
            weights = derivatives.prescribed.x.array[: len(source)]
            np.add.at(vector.array, source[depends], weights[depends])
            vector.scatter_reverse(dolfinx.la.InsertMode.add)
            parts.append(vector.array[:owned].copy())
        return sum(parts[1:], parts[0]) if parts else None

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
        return None if derivative is None else assembled(derivative)[: owned_size(control)]

    def pull_of(self, prescribed: fem.Function) -> Array:
        """Return K u (owned,) [force] for a displacement u of prescribed nodes. Collective."""
        form = self._forms.compiled(ufl.action(self._forms.tangent, prescribed))
        return assembled(form)[: owned_size(prescribed)]

    def reaction_of(self, z: fem.Function) -> Array:
        """Return K'z (owned,) for a displacement z. Collective."""
        self._z.x.array[:] = z.x.array
        if "reaction" not in self._compiled:
            test, trial = self._forms.tangent.arguments()
            moved = {test: self._z, trial: ufl.TestFunction(z.function_space)}
            self._compiled["reaction"] = self._forms.compiled(
                ufl.replace(self._forms.tangent, moved)
            )
        return assembled(self._compiled["reaction"])[: owned_size(z)]

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
            values = values_of(direction) if hasattr(direction, "x") else np.ravel(direction)
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
            curve = getattr(terms.curve, "function", None)
            for term in (*(getattr(terms, name) for name in TERMS), curve):
                inputs += inputs_of(term)
    inputs += [bc.g for bc in bcs]
    return list(dict.fromkeys(inputs))


def sources_of_prescribed(bcs: Sequence[Any], control: Any, size: int) -> Indices:
    """Return for each degree of freedom which value of a control is prescribed there.

    Not collective.

    Args:
        bcs: Dirichlet conditions; the last condition that prescribes a value counts.
        control: a Constant or a Function.
        size: number of this rank's degrees of freedom, in local order: owned degrees of freedom
            come first.

    Returns:
        (size,) position in the control's values; -1 where no value of the control is prescribed.
    """
    result = np.full(size, -1, dtype=np.intp)
    numbers = np.arange(values_of(control).size, dtype=np.float64)
    for bc in bcs:
        # DOLFINx does not say which value a condition takes: the effect of its bc.set shows it
        marked, numbered = np.zeros(size), np.full(size, -1.0)
        with replaced([control], [np.full(numbers.size, np.nan)]):
            bc.set(marked)
        with replaced([control], [numbers]):
            bc.set(numbered)
        dofs = bc.dof_indices()[0]
        dofs = dofs[dofs < size]
        result[dofs] = np.where(np.isnan(marked[dofs]), numbered[dofs], -1.0).astype(np.intp)
    return result


def owned_size(function: fem.Function) -> int:
    """Return the number of values of a Function that this rank owns. Not collective."""
    return int(function.x.index_map.size_local * function.x.block_size)


def assembled(form: fem.Form) -> Array:
    """Return the values of a linear form on this rank. Collective.

    Values of owned degrees of freedom are sums over the ranks; values of ghosts are not.
    """
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.asarray(vector.array)


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
    discs = contact.face.discs
    cones = contact.dual.admissible.at(x, r)
    curves = iter(cones.curve_arguments(x) if isinstance(cones, FrictionCones) else ())
    is_limited = cones.exceed_limit(x) if isinstance(cones, FrictionCones) else False

    def radii(constant: float, coefficient: float) -> Array:
        """Return the radii (n_discs,) for a bound c + F p that is the same at all nodes."""
        ones = [np.ones(len(pair.nodes)) for pair in jump.pairs]
        bounds = [NodalBounds(constant * one, coefficient * one, np.inf * one) for one in ones]
        return np.asarray(jump.bounded(bounds).section(x).radius)

    by_constant = radii(1.0, 0.0)
    by_term = {
        "constant": by_constant,
        "coefficient": np.where(is_limited, 0.0, radii(0.0, 1.0)),
        "limit": np.where(is_limited, by_constant, 0.0),
    }
    result: list[NodalField] = []
    end = 0
    for pair, operators, bounds, (normal, tangential) in zip(
        pairs, jump.pairs, contact.bounds, jump.slices, strict=True
    ):
        nodes, n = operators.nodes, len(operators.nodes)
        own = slice(end, end + n)
        end += n

        def offsets(rows: Any, columns: Any, values: Any, n: int = n) -> csr_array:
            return csr_array((values, (rows, columns)), shape=(discs.size, n))

        rows = np.arange(normal.start, normal.stop)
        by_gap = offsets(rows, operators.normal_node, 1.0 / jump.length_scale[normal])
        name = f"the gap of contact pair {pair}"
        result.append(NodalField(pair.gap, nodes, name, own, np.zeros(n), by_gap))
        terms = pair.friction.terms if isinstance(pair.friction, DryFriction) else BoundTerms()
        for term, words in TERMS.items():
            scalar, by_bound, name = getattr(terms, term), by_term[term][own], f"{words} of {pair}"
            if term == "coefficient" and terms.curve is not None:
                scalar = partial(pressed_values, *next(curves))
            if not isinstance(scalar, tuple) or bounds.ellipses is None:
                nothing = offsets([], [], [])
                result.append(NodalField(scalar, nodes, name, own, by_bound, nothing))
                continue
            axes = _Axes.of(operators, bounds.ellipses)
            rows = tangential.start + axes.rows
            # the stretched rows and multipliers of a node change with the ratio of its semi-axes
            outwards = np.einsum("na,na->n", contact.face.radial[rows], axes.mirrored(x[rows]))
            moved = axes.mirrored(r[rows] - contact.curvature[rows] * x[rows])
            longer = np.argmax(bounds.ellipses.shape, axis=1)
            for k, semi_axis in enumerate(scalar):
                value = bounds.ellipses.shape[:, k] * getattr(bounds, term)
                counts = np.isfinite(value) & (value > 0.0)
                inverse = np.zeros(n)
                np.divide(1.0, value, out=inverse, where=counts)
                by_axis = inverse * np.where(counts, discs.radius[own], 0.0)
                by_axis *= axes.shares[:, k] - (longer == k)
                by_axis += np.where(longer == k, by_bound, 0.0)
                half = (0.5 if k == 0 else -0.5) * inverse[axes.node]
                by_axis[axes.node] += half * outwards
                by_ratio = offsets(
                    rows.ravel(), np.repeat(axes.node, 2), (half[:, None] * moved).ravel()
                )
                result.append(NodalField(semi_axis, nodes, name, own, by_axis, by_ratio))
    return result


@dataclass(frozen=True)
class _Axes:
    """Derivatives of friction discs and tangential rows by the semi-axes of friction ellipses.

    Tangential rows are stretched so that the ellipse of a node becomes a disc. A change of the
    semi-axes b_1, b_2 stretches the multipliers of a node with two tangential rows by 1 + S, with
    S = (a a' - e e') (db_1/b_1 - db_2/b_2) / 2 for the unit vectors a and e along the axes.

    Attributes:
        rows: (m, 2) tangential rows of each node with two tangential rows.
        node: (m,) index of each node with two tangential rows among the nodes of the pair.
        along: (m, 2) components of a along the tangents of the rows.
        shares: (n, 2) derivatives of log(radius) of the discs with respect to log(b_1), log(b_2).
    """

    rows: Indices
    node: Indices
    along: Array
    shares: Array

    @classmethod
    def of(cls, pair: PairOperators, ellipses: NodalEllipses) -> _Axes:
        """Return the derivatives at the nodes of a pair. Not collective."""
        node, d = pair.tangent_node, pair.normals.shape[1]
        direction = ellipses.direction[:, :d]
        inward = np.einsum("ni,ni->n", direction, pair.normals)
        axis = direction - inward[:, None] * pair.normals
        length = np.linalg.norm(axis, axis=1)
        axis /= np.where(length > 0.0, length, 1.0)[:, None]
        cosines = np.einsum("ri,ri->r", pair.tangents, axis[node])
        second = np.flatnonzero(node[1:] == node[:-1]) + 1
        has_two = np.zeros(len(pair.nodes), dtype=np.bool_)
        has_two[node[second]] = True
        positive = ellipses.shape > ROUNDING
        shares = positive / np.maximum(positive.sum(axis=1, keepdims=True), 1)
        for row in np.flatnonzero(~has_two[node]):
            # the semi-diameter b has 1/b^2 = (cos/b_1)^2 + (sin/b_2)^2
            squares = np.array([cosines[row] ** 2, max(1.0 - cosines[row] ** 2, 0.0)])
            b = ellipses.shape[node[row]]
            squares = np.where(squares > ROUNDING, squares, 0.0)
            terms = np.divide(squares, b**2, out=np.zeros(2), where=b > ROUNDING)
            shares[node[row]] = terms / terms.sum() if terms.any() else 0.0
        second = second[positive[node[second]].all(axis=1)]
        rows = np.stack([second - 1, second], axis=1)
        return cls(rows, node[second].astype(np.intp), cosines[rows], shares)

    def mirrored(self, v: Array) -> Array:
        """Return (a a' - e e') v for (m, 2) components along the tangents."""
        # e e' = 1 - a a' in the tangential plane; a is zero where a circle has no direction
        along, length = np.einsum("na,na->n", self.along, v), np.sum(self.along**2, axis=1)
        return np.asarray(2.0 * along[:, None] * self.along - length[:, None] * v)
