"""The data of a solution, and derivatives of an output with respect to controls, by the chain rule.

The data of a solution are the load f, the prescribed values u_D, the offsets (d; s) (gaps and slip
origins) and the radii g of the friction discs. An adjoint solve gives the derivatives of an output
with respect to the data, a `DataDerivatives`.

`DataOfSolution` is the one place that knows what depends on controls: forms, Dirichlet conditions,
gaps, terms and curves of friction laws (`nodal_fields`), and the rows of B, which rigid obstacles
change. Its method `pulled_back` takes the derivatives with respect to the
data on to a control.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.goals import WeightedGoals, value_of
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


def nodal_fields(
    contact: LinearisedContact, pairs: Sequence[ContactPair], by_offset: Array, by_radius: Array
) -> Iterator[tuple[Any, LocalNumbers, Array, str]]:
    """Yield the scalars on which solutions depend: gaps and terms of slip bounds. Collective.

    Args:
        contact: the solution.
        pairs: the pairs of contact.
        by_offset: (size,) derivatives of an output by the offsets (d; s), divided by
            `JumpOperator.length_scale`.
        by_radius: (n_discs,) derivatives of the output by the radii of the discs.

    Yields:
        the user's scalar, the local numbers (n,) of the nodes where it counts, the derivatives (n,)
        of the output by its values at these nodes, and its name in errors.
    """
    jump, x = contact.dual.jump, contact.multipliers
    cones = contact.dual.admissible.at_point(x, contact.gradient)
    curves = iter(cones.curve_arguments(x) if isinstance(cones, FrictionCones) else ())
    is_limited = cones.exceed_limit(x) if isinstance(cones, FrictionCones) else False

    def radii(constant: float, coefficient: float) -> Array:
        """Return the radii (n_discs,) for a bound c + F p that is the same at all nodes."""
        ones = [np.ones(len(pair.nodes)) for pair in jump.pairs]
        bounds = [NodalBounds(constant * unit, coefficient * unit, np.inf * unit) for unit in ones]
        return np.asarray(jump.bounded(bounds).section(x).radius)

    by_constant = by_radius * radii(1.0, 0.0)
    by_term = {
        "constant": by_constant,
        "coefficient": np.where(is_limited, 0.0, by_radius * radii(0.0, 1.0)),
        "limit": np.where(is_limited, by_constant, 0.0),
    }
    start = 0
    for pair, operators, (normal, _) in zip(pairs, jump.pairs, jump.slices, strict=True):
        nodes = operators.nodes
        by_gap = np.zeros(len(nodes))
        by_gap[operators.normal_node] = by_offset[normal] / jump.length_scale[normal]
        yield pair.gap, nodes, by_gap, f"the gap of contact pair {pair}"
        discs = slice(start, start + len(nodes))
        start = discs.stop
        terms = pair.friction.terms
        for term, words in TERMS.items():
            scalar = getattr(terms, term)
            if term == "coefficient" and terms.curve is not None:
                scalar = partial(pressed_values, *next(curves))
            if not isinstance(scalar, tuple):  # `check_controls` refuses controls in two bounds
                yield scalar, nodes, by_term[term][discs], f"{words} of {pair}"


@dataclass
class DataDerivatives:
    """An output of a solution, and its derivatives with respect to the data of the solution.

    Attributes:
        goals: the goals in the output, each with its factor.
        on_jump: (size,) derivatives of further terms of the output with respect to B u.
        force: derivatives by the load: the adjoint displacement z, zero where u is prescribed.
        prescribed: (owned degrees of freedom,) derivatives by the values of u, of which those with
            respect to prescribed values count.
        offset: (size,) derivatives by (d; s), divided by `JumpOperator.length_scale`: the adjoint
            multipliers y.
        radius: (n_discs,) derivatives by the radii of the discs.
    """

    goals: WeightedGoals
    on_jump: Array
    force: fem.Function
    prescribed: Array
    offset: Array
    radius: Array


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
            in_all_steps: whether Constants that move obstacles change in all load steps so far. If
                not, they change only after the last accepted step: the slip of the accepted steps
                stays the same vector at each node, whose components change with the tangents.
        """
        self.system, self.u, self.comm = system, u, system.comm
        self._forms, self._in_all_steps = forms, in_all_steps
        self._values = system.surfaces.nodal_values
        self._z = fem.Function(u.function_space, name="adjoint")
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

    def pulled_back(self, control: Control, derivatives: DataDerivatives) -> Array:
        """Return the derivatives of an output by the values of a control. Collective.

        Goals that are forms of rank 0 may depend on controls, and other goals depend on the
        position of obstacles, through normals and tangents.

        Args:
            control: a Constant or a Function.
            derivatives: the output, and its derivatives with respect to the data.

        Returns:
            derivatives with respect to the values of a Constant, in its shape, or to the values of
            a Function that this rank owns.

        Raises:
            InputError: the derivative with respect to the control is not known.
        """
        self._z.x.array[:] = derivatives.force.x.array
        result = self._by_conditions(control, derivatives.prescribed)
        result -= self.derivative(self._work, control)
        for weight, goal in derivatives.goals:
            if isinstance(goal, ufl.Form):
                result += weight * self.derivative(goal, control)
        for field, nodes, weights, name in nodal_fields(
            self.contact, self.system.pairs, derivatives.offset, derivatives.radius
        ):
            result += self._values.pulled_back(field, control, nodes, weights, name)
        if isinstance(control, fem.Function):
            return result
        for k, unit in enumerate(np.eye(len(result))):
            direction = unit.reshape(control.ufl_shape)
            result[k] += self._by_obstacles(control, direction, derivatives)
        return result.reshape(control.ufl_shape)

    def _by_obstacles(
        self, constant: fem.Constant, direction: Array, derivatives: DataDerivatives
    ) -> float:
        """Return the derivative of an output by a Constant that moves obstacles. Collective.

        Gaps, normals and tangents at the nodes depend on the position of an obstacle. Their central
        differences have relative errors of some 1e-10, and need no solve.

        Args:
            constant: the Constant, on which positions of obstacles may depend.
            direction: change of the Constant, an array of the shape of its value.
            derivatives: the output, and its derivatives with respect to the data.

        Returns:
            the part of the derivative along the direction that is due to B; zero if no obstacle
            depends on the Constant.

        Raises:
            InputError: an obstacle moves in the load step of the last solve, or a node faces the
                obstacle at only one of the two displaced positions of the obstacle.
        """
        system, contact = self.system, self.contact
        surfaces, obstacles, jump = system.surfaces, system.surfaces.obstacles, system.surfaces.jump
        moves = obstacles.rates(constant, None, jump) > 0.0
        if not moves.any():
            return 0.0
        origin: Array = np.zeros(len(jump.gap))
        if not self._in_all_steps:
            solved = system.solution_for("a derivative")
            origin, moves_in_step = solved.dual.history.origin, moves & solved.moved
            for pair, moved, (_, t) in zip(system.pairs, moves_in_step, jump.slices, strict=True):
                if moved and system.comm.allreduce(bool(origin[t].any()), op=MPI.LOR):
                    raise InputError(
                        f"contact pair {pair}: the derivative with respect to the place of an "
                        "obstacle is not known for a load step in which move_to() moves it."
                    )
        # with a step that changes distances by a given length, differences depend on no units
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
        after, before = (self._output(derivatives, side, origin) for side in sides)
        return (after - before) / (2.0 * (step or 1.0))

    def _output(self, derivatives: DataDerivatives, B: JumpOperator, origin: Array) -> float:
        """Return the terms of an output that depend on B, for fixed u and x. Collective.

        Args:
            derivatives: the output, and its derivatives with respect to the data.
            B: the jump operator.
            origin: (size,) slip origin that keeps its vector at each node, in components along the
                tangents of the solution.
        """
        contact, inner = self.contact, self.contact.dual.inner
        x, jump_of_u = contact.multipliers, B.of_displacement(contact.u)
        radii = B.bounded(contact.bounds).section(x).radius
        offsets = B.gap - jump_of_u + Carry(contact.dual.jump, B).residuals(origin)
        result = inner(derivatives.offset, offsets) + inner(derivatives.on_jump, jump_of_u)
        result += inner(derivatives.radius, np.where(np.isfinite(radii), radii, 0.0))
        result -= inner(x, B.of_displacement(derivatives.force))
        for weight, goal in derivatives.goals:
            if not isinstance(goal, ufl.Form):
                result += weight * value_of(goal, B, x, jump_of_u)
        return float(result)

    def reaction_of(self, z: fem.Function) -> Array:
        """Return K'z (owned,) for a displacement z. Collective."""
        self._z.x.array[:] = z.x.array
        return _assembled(self._reaction)

    def _by_conditions(self, control: Control, by_prescribed: Array) -> Array:
        """Return the derivatives by a control whose values Dirichlet conditions take. Collective.

        DOLFINx does not say which values these are: numbers in place of the values show it.

        Args:
            control: a Constant or a Function.
            by_prescribed: (owned degrees of freedom,) derivatives by the prescribed values.

        Returns:
            (values of the Constant, or of the Function on this rank without ghosts,) derivatives.
        """
        numbers = np.arange(1, values_of(control).size + 1, dtype=np.float64)
        ends = np.zeros((2, len(self.u.x.array)))
        for prescribed, values in zip(ends, (numbers, 0.0 * numbers), strict=True):
            with replaced([control], [values]):
                for bc in self._forms.bcs:
                    bc.set(prescribed)
        source = (ends[0] - ends[1])[: owned_size(self.u)].astype(np.intp)
        depends = source > 0
        sums: Array = np.zeros(len(numbers))
        np.add.at(sums, source[depends] - 1, by_prescribed[depends])
        if isinstance(control, fem.Constant):
            return np.asarray(reduce_array(self.comm, sums))
        result = dolfinx.la.vector(control.x.index_map, control.x.block_size)
        result.array[:] = sums
        return _owned_entries(result)

    def derivative(self, form: Any, control: Control) -> Array:
        """Return the derivatives of a form of rank 0 by the values of a control. Collective.

        The result has one entry for each value of a Constant, or for each value of a Function that
        this rank owns.
        """
        is_constant = isinstance(control, fem.Constant)
        if control not in (*form.constants(), *form.coefficients()):
            return np.zeros(control.value.size if is_constant else owned_size(control))
        key = id(form), id(control)
        if key not in self._compiled:
            m = control
            if is_constant:  # UFL differentiates by Functions: take one constant in all cells
                mesh = self.u.function_space.mesh
                m = fem.Function(fem.functionspace(mesh, ("DG", 0, control.ufl_shape)))
            replaced_form = ufl.replace(form, {control: m}) if is_constant else form
            by_m = ufl.derivative(replaced_form, m, ufl.TestFunction(m.function_space))
            # keeping `form` keeps its id valid
            self._compiled[key] = form, self._forms.compiled(by_m), m
        _, compiled, m = self._compiled[key]
        if not is_constant:
            return _assembled(compiled)
        m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // control.value.size)
        by_cells = _assembled(compiled).reshape(-1, control.value.size)
        return np.asarray(reduce_array(self.comm, by_cells.sum(axis=0)))


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


def owned_size(function: fem.Function) -> int:
    """Return the number of values of a Function that this rank owns. Not collective."""
    return int(function.x.index_map.size_local * function.x.block_size)


def _assembled(form: fem.Form) -> Array:
    """Return the entries of a linear form for the degrees of freedom of this rank. Collective."""
    return _owned_entries(fem.assemble_vector(form))


def _owned_entries(vector: dolfinx.la.Vector) -> Array:
    """Add the ghosts of a vector to their owners, and return what this rank owns. Collective."""
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.array(vector.array[: vector.index_map.size_local * vector.block_size])
