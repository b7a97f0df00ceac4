"""Derivatives of a goal with respect to loads, materials, friction, gaps and prescribed values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.dual.adjoint import LinearisedContact, adjoint
from dolfinx_tresca.dual.nodal_values import NodalValues, inputs_of
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction, parts_of_ellipse
from dolfinx_tresca.scene.friction_curve import FrictionCurve
from dolfinx_tresca.scene.goal import Goal, checked_goal
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.goal_error import weights_of
from dolfinx_tresca.solution.prescribed import sources_of_prescribed

#: Relative error of the adjoint multipliers: it is the relative error of the derivatives. With
#: an iterative solver for K that of its products.
ACCURACY, ITERATIVE_ACCURACY = 1e-10, 1e-5

#: What may be changed in place, and what derivatives are taken with respect to.
Control: TypeAlias = "fem.Constant | fem.Function"


@dataclass(frozen=True)
class Forms:
    """The forms and conditions of the bodies, as users gave them.

    Attributes:
        residual: function that returns the residual R(u; z), a form of rank 0, for a Function z.
        tangent: dR/du, a bilinear form.
        bcs: Dirichlet conditions.
        entity_maps: needed if forms hold Functions on surfaces.
    """

    residual: Callable[[fem.Function], Any]
    tangent: Any
    bcs: Sequence[Any]
    entity_maps: EntityMaps | None

    def compiled(self, form: Any) -> fem.Form:
        """Return a compiled form. Collective."""
        maps = {} if self.entity_maps is None else {"entity_maps": self.entity_maps}
        return fem.form(form, **maps)


@dataclass(frozen=True)
class SolvedStep:
    """A solution, with the problem that it solves.

    Attributes:
        dual: the problem.
        multipliers: (size,) multipliers of the solution.
        u: displacement of the solution [length].
        bounds: slip bounds at the nodes of each pair.
    """

    dual: DualProgram
    multipliers: Array
    u: fem.Function
    bounds: Sequence[NodalBounds]

    @cached_property
    def state(self) -> LinearisedContact:
        """The contact state of each node. Collective at the first access."""
        gradient = self.dual.response.gradient_of(self.u.x.petsc_vec)
        return LinearisedContact.of(self.dual, self.multipliers, gradient)

    @property
    def origin_rows(self) -> tuple[Mask, Mask]:
        """Tangential rows (size,) of nodes that stick, and of all others. Not collective.

        The next load step counts the slip of the former from the same origin as this one, and the
        slip of the latter from their tangential jump (`SlipHistory.after`).
        """
        face = self.state.face
        rows, sticks = face.discs.tangential, face.stick[face.discs.node]
        kept, moved = np.zeros((2, face.discs.size), dtype=np.bool_)
        kept[rows[sticks]], moved[rows[~sticks]] = True, True
        return kept, moved


def check_control(control: Any, pairs: Sequence[ContactPair]) -> None:
    """Check the type of a control, and that it is no part of an ellipse. Not collective.

    Raises:
        InputError: the control is unsuitable.
    """
    if not isinstance(control, fem.Constant | fem.Function):
        raise InputError(
            f"a control must be a fem.Constant or a fem.Function, found {shown(control)}."
        )
    for pair in pairs:
        for inside in parts_of_ellipse(pair.friction):
            if control in inputs_of(inside):
                raise InputError(
                    f"contact pair {pair}: the derivative with respect to {shown(control)} is "
                    "not known, since it is part of a bound or a direction of orthotropic friction."
                )


def checked_form_or_goal(goal: Any, pairs: int, V: Any) -> Goal | ufl.Form:
    """Check a goal of which a derivative is wanted, and return it. Not collective.

    Args:
        goal: the argument of the user.
        pairs: number of pairs of the problem.
        V: the space of the displacement.

    Raises:
        InputError: it is neither a goal of this problem nor a form of rank 0.
    """
    if not isinstance(goal, ufl.Form):
        return checked_goal(goal, pairs, V.mesh.geometry.dim)
    if goal.arguments():
        raise InputError("the goal is a form with arguments: a number is a form of rank 0.")
    return goal


#: Goals of a solution, each with its factor in a sum.
WeightedGoals: TypeAlias = "Sequence[tuple[float, Goal | ufl.Form]]"


class Differentiation:
    """Derivatives of goals with respect to controls, at one solution after the other.

    Forms are compiled once. With each node held in its contact state, the residual R(u; v) and the
    adjoint (z, y) of `dual/adjoint.py` the derivative of a goal J with respect to m is

        dJ/dm = explicit - dR/dm(u; z) + y'dd/dm + (q_u - B'y - dR/du(u; z))'du_D/dm
                + sum over slipping nodes of dg/dm t'(q_x - B z)

    with the gap d, the prescribed values u_D, the slip bound g of a node and the direction t of its
    traction. The derivative with respect to the origin of the slip s is y, as that with respect to
    the gap. In a process s is the s of the step before where a node stuck in that step, and its
    tangential jump T u elsewhere: so the derivatives of a step's goals are carried on by y to the
    step before.
    """

    def __init__(
        self,
        pairs: Sequence[ContactPair],
        forms: Forms,
        u: fem.Function,
        values: NodalValues,
        controls: Sequence[Control],
    ) -> None:
        """Compile the derivatives of the residual. Collective.

        Args:
            pairs: the pairs of the problem.
            forms: forms and conditions of the bodies at u.
            u: a displacement, which takes the values of each solution.
            values: takes fields of friction and gaps at the nodes of u.
            controls: Constants and Functions.
        """
        self._pairs, self._forms, self._u, self._values = pairs, forms, u, values
        self.controls = list(controls)
        self._z = fem.Function(u.function_space, name="adjoint")
        residual, (test, trial) = forms.residual(self._z), forms.tangent.arguments()
        self._reaction = forms.compiled(
            ufl.replace(forms.tangent, {test: self._z, trial: ufl.TestFunction(u.function_space)})
        )
        self._by_control = [_derivative(residual, control, forms) for control in self.controls]

    def backwards(
        self, step: SolvedStep, goals: WeightedGoals, on_origin: Array | None = None
    ) -> tuple[list[Any], Array]:
        """Return the derivatives of a sum of goals: one adjoint solve. Collective.

        Args:
            step: the solution.
            goals: factors, and goals or forms of rank 0 that depend on the solution's u.
            on_origin: (size,) derivatives of other numbers, which are added, with respect to the
                origin of the slip of the step that follows; None: zeros.

        Returns:
            for each control the derivatives with respect to its values, those of a Function that
            this rank owns, or None where nothing depends on it; and (size,) the derivatives with
            respect to the origin of the slip of this step.

        Raises:
            InputError: a goal has no node, or does not depend on u; or the derivative with respect
                to a control is not known.
            ConvergenceError: the adjoint has no solution.
        """
        dual, jump = step.dual, step.dual.jump
        kept, moved = step.origin_rows
        on_origin = np.zeros(len(jump.gap)) if on_origin is None else on_origin
        on_jump, on_x = np.where(moved, on_origin, 0.0), np.zeros_like(on_origin)
        prescribed = jump.system.prescribed
        owned, on_u = len(prescribed), fem.Function(step.u.function_space)
        in_forms = [(weight, goal) for weight, goal in goals if isinstance(goal, ufl.Form)]
        for weight, form in in_forms:
            on_u.x.array[:owned] += weight * self._by_displacement(form, step.u)[:owned]
        for weight, goal in goals:
            if not isinstance(goal, ufl.Form):
                by_both = weights_of(goal, dual, step.multipliers)
                for total, part in zip((on_jump, on_x), by_both, strict=True):
                    total += weight * part
        on_prescribed = on_u.x.array[:owned].copy()
        on_u.x.petsc_vec.array[prescribed] = 0.0
        accuracy = ACCURACY if dual.exact else ITERATIVE_ACCURACY
        weights = on_u.x.petsc_vec if in_forms else None
        z, y = adjoint(dual, step.state, on_jump, on_x, accuracy, weights)

        self._z.x.array[:] = z.x.array
        if self._u is not step.u:
            self._u.x.array[:] = step.u.x.array
        on_prescribed += jump.whole_force(on_jump - y).array - _assembled(self._reaction)[:owned]
        radial = step.state.face.radial_parts(on_x - jump.of_displacement(z))
        fields = _nodal_fields(dual, self._pairs, step.bounds, step.multipliers, y, radial)
        result: list[Any] = []
        for control, by_residual in zip(self.controls, self._by_control, strict=True):
            parts = [
                self._values.pulled_back(field, control, nodes, weight, name)
                for field, nodes, weight, name in fields
            ]
            if by_residual is not None:
                parts.append(-by_residual())
            for weight, form in in_forms:
                explicit = _derivative(form, control, self._forms)
                if explicit is not None:
                    parts.append(weight * explicit())
            comm = step.u.function_space.mesh.comm
            parts.append(_of_prescribed(self._forms.bcs, control, on_prescribed, comm))
            result.append(sum_of_known(parts))
        return result, np.where(kept, y + on_origin, np.where(moved, y, 0.0))

    def _by_displacement(self, form: Any, u: fem.Function) -> Array:
        """Return the derivative of a form of rank 0 with respect to u. Collective."""
        if u not in form.coefficients():
            raise InputError(
                "the goal is a form that does not depend on the displacement of its solution: "
                "write it in terms of solution.u."
            )
        test = ufl.TestFunction(u.function_space)
        return _assembled(self._forms.compiled(ufl.derivative(form, u, test)))


def sum_of_known(parts: Sequence[Any]) -> Any:
    """Return the sum of those parts that are not None; None without any."""
    known = [part for part in parts if part is not None]
    return sum(known[1:], known[0]) if known else None


def as_derivatives(values: Sequence[Any], controls: Sequence[Control], comm: Any) -> list[Any]:
    """Return the derivatives of `Differentiation.backwards` for the user. Collective.

    Args:
        values: for each control the derivatives with respect to its values; None: the log says that
            nothing depends on it.
        controls: Constants and Functions.
        comm: communicator.

    Returns:
        for each Constant an array of its shape, for each Function a Function of its space.
    """
    for control, known in zip(controls, values, strict=True):
        if known is None:
            log(
                comm,
                "gradient: nothing depends on the control %s: its derivative is zero",
                getattr(control, "name", control),
            )
    return [
        _as_control(0.0 if known is None else known, control)
        for control, known in zip(controls, values, strict=True)
    ]


def _as_control(values: Any, control: Control) -> Any:
    """Return values by the owned degrees of freedom in the shape of a control. Collective."""
    if isinstance(control, fem.Constant):
        return np.array(np.broadcast_to(values, control.ufl_shape))
    result = fem.Function(control.function_space, name=f"derivative by {control.name}")
    result.x.array[: _owned(control)] = values
    result.x.scatter_forward()
    return result


def _owned(control: fem.Function) -> int:
    """Return the number of values of a Function that this rank owns. Not collective."""
    dofmap = control.function_space.dofmap
    return int(dofmap.index_map.size_local * dofmap.index_map_bs)


def _assembled(form: fem.Form) -> Array:
    """Return the values of a linear form, summed over the ranks; ghosts' are wrong. Collective."""
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.asarray(vector.array)


def _derivative(form: Any, control: Control, forms: Forms) -> Callable[[], Array] | None:
    """Return a function that computes the derivative of a form of rank 0 for present values.

    Collective, as is the function. None if the form does not depend on the control.
    """
    if control not in (*form.constants(), *form.coefficients()):
        return None
    if isinstance(control, fem.Function):
        test = ufl.TestFunction(control.function_space)
        compiled = forms.compiled(ufl.derivative(form, control, test))
        return lambda: _assembled(compiled)[: _owned(control)]
    # UFL differentiates with respect to Functions: one with the same value in all cells
    mesh = next(one for one in form.coefficients()).function_space.mesh
    assert mesh.ufl_domain() == form.ufl_domain()
    m = fem.Function(fem.functionspace(mesh, ("DG", 0, control.ufl_shape)))
    form = ufl.replace(form, {control: m})
    compiled = forms.compiled(ufl.derivative(form, m, ufl.TestFunction(m.function_space)))
    size = np.size(control.value)

    def by_constant() -> Array:
        m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // size)
        sums = _assembled(compiled)[: _owned(m)].reshape(-1, size).sum(axis=0)
        total = reduce_array(mesh.comm, sums, MPI.SUM)
        return np.asarray(total.reshape(control.ufl_shape))

    return by_constant


def _of_prescribed(bcs: Sequence[Any], control: Control, weights: Array, comm: Any) -> Any:
    """Return the derivative by a control that values are prescribed by; None for others.

    Collective.

    Args:
        bcs: Dirichlet conditions.
        control: a Constant or a Function.
        weights: (owned degrees of freedom,) derivative by the prescribed values.
        comm: communicator.
    """
    source = sources_of_prescribed(bcs, control, len(weights))
    depends = source >= 0
    if not comm.allreduce(bool(depends.any()), op=MPI.LOR):
        return None
    source, weights = source[depends], weights[depends]
    if isinstance(control, fem.Constant):
        sums = np.zeros(np.size(control.value))
        np.add.at(sums, source, weights)
        return reduce_array(comm, sums).reshape(control.ufl_shape)
    vector = dolfinx.la.vector(control.x.index_map, control.x.block_size)
    np.add.at(vector.array, source, weights)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return vector.array[: _owned(control)].copy()


def _nodal_fields(
    dual: DualProgram,
    pairs: Sequence[ContactPair],
    bounds: Sequence[NodalBounds],
    x: Array,
    y: Array,
    radial: Array,
) -> list[tuple[Any, Any, Array, str]]:
    """Return fields, the nodes they are taken at, and derivatives by the values there (n,).

    Collective.

    Args:
        dual: the problem.
        pairs: pairs of the problem.
        bounds: slip bounds of the pairs.
        x: (size,) multipliers of the solution.
        y: (size,) the adjoint multipliers.
        radial: (n_discs,) derivatives of the goal by the radii of the discs.
    """
    jump = dual.jump
    by_gap = y / jump.length_scale
    numbers = [len(on_nodes.nodes) for on_nodes in jump.pairs]

    def radii(name: str, values: Sequence[Any]) -> Array:
        given = []
        for value, n in zip(values, numbers, strict=True):
            none, whole = np.zeros(n), np.full(n, np.inf)
            nodal = NodalBounds(constant=none, coefficient=none, limit=whole)
            curved = isinstance(value, FrictionCurve)
            fields: dict[str, Any] = {name: none + (1.0 if curved else value)}
            if curved:
                fields["curve"] = value
            given.append(dataclasses.replace(nodal, **fields))
        return np.asarray(jump.bounded(given).section(x).radius)

    ones = [1.0] * len(pairs)
    is_limited = radii("coefficient", [one.curve or one.coefficient for one in bounds]) > radii(
        "constant", [one.limit for one in bounds]
    )
    by_constant = radial * radii("constant", ones)
    by_value = {
        "constant": by_constant,
        "coefficient": np.where(is_limited, 0.0, radial * radii("coefficient", ones)),
        "limit": np.where(is_limited, by_constant, 0.0),
    }
    result: list[tuple[Any, Any, Array, str]] = []
    first = 0
    for pair, on_nodes, n, (normal, _) in zip(pairs, jump.pairs, numbers, jump.slices, strict=True):
        of_gap = np.zeros(n)
        of_gap[on_nodes.normal_node] = by_gap[normal]
        result.append((pair.gap, on_nodes.nodes, of_gap, f"the gap of contact pair {pair}"))
        terms = pair.friction.terms if isinstance(pair.friction, DryFriction) else BoundTerms()
        for name, words in TERMS.items():
            weight = by_value[name][first : first + n]
            result.append((getattr(terms, name), on_nodes.nodes, weight, f"{words} of {pair}"))
        first += n
    return result
