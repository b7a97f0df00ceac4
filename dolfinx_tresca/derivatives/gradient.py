"""Derivatives of a goal with respect to loads, materials, friction, gaps and prescribed values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.derivatives.adjoint import adjoint
from dolfinx_tresca.derivatives.goal_error import weights_of
from dolfinx_tresca.derivatives.nodal_fields import nodal_fields
from dolfinx_tresca.derivatives.obstacle_differences import FindDifferences
from dolfinx_tresca.derivatives.prescribed import sources_of_prescribed
from dolfinx_tresca.derivatives.solved_step import SolvedStep
from dolfinx_tresca.dual.nodal_values import NodalValues, inputs_of
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import DryFriction
from dolfinx_tresca.scene.goal import Goal, checked_goal
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.forms import Forms

#: Input with respect to which derivatives are taken; users change its values in place.
Control: TypeAlias = "fem.Constant | fem.Function"


def check_control(control: Control, pairs: Sequence[ContactPair]) -> None:
    """Check that no direction of orthotropic friction depends on a control. Not collective.

    Args:
        control: a Constant or a Function.
        pairs: the pairs of the problem.

    Raises:
        InputError: such a direction depends on the control, so the derivative is not known.
    """
    for pair in pairs:
        law = pair.friction
        if isinstance(law, DryFriction) and control in inputs_of(law.terms.direction):
            raise InputError(
                f"contact pair {pair}: the derivative with respect to {shown(control)} is not "
                "known, since it is part of the direction of orthotropic friction."
            )


def checked_form_or_goal(goal: Any, pairs: int, V: Any) -> Goal | ufl.Form:
    """Check a goal that is to be differentiated, and return it. Not collective.

    Args:
        goal: the user's argument, which may have any type.
        pairs: number of pairs of the problem.
        V: the space of the displacement.

    Raises:
        InputError: the argument is neither a goal of this problem nor a form of rank 0.
    """
    if not isinstance(goal, ufl.Form):
        return checked_goal(goal, pairs, V.mesh.geometry.dim)
    if goal.arguments():
        raise InputError("the goal is a form with arguments: a number is a form of rank 0.")
    return goal


#: Goals of a solution, each with its factor in a sum.
WeightedGoals: TypeAlias = "Sequence[tuple[float, Goal | ufl.Form]]"


class Differentiation:
    """Derivatives of goals with respect to controls, for any number of solutions.

    Forms are compiled once. With each node held in its contact state, the derivative of a goal J
    with respect to a control m follows from the residual R(u; v) and the adjoint (z, y) of
    `derivatives/adjoint.py`:

        dJ/dm = explicit - dR/dm(u; z) + y'dd/dm + (q_u - B'y - dR/du(u; z))'du_D/dm
                + sum over slipping nodes of dg/dm t'(q_x - B z)

    Here `explicit` is the derivative of J for fixed u and multipliers, d the gap, u_D the
    prescribed values, g the slip bound of a node, and t the direction of its traction; q_u and q_x
    are the derivatives of J with respect to u and to the multipliers. The derivative with respect
    to the slip origin s is y, like the derivative with respect to the gap. A node that stuck in the
    previous load step keeps the s of this previous step; for any other node s is its tangential
    jump T u in the previous step. So y carries the derivatives of a step's goals back to the
    previous step.
    """

    def __init__(
        self,
        pairs: Sequence[ContactPair],
        forms: Forms,
        u: fem.Function,
        values: NodalValues,
        controls: Sequence[Control],
        find_differences: FindDifferences | None = None,
    ) -> None:
        """Compile the derivatives of the residual. Collective.

        Args:
            pairs: the pairs of the problem.
            forms: forms and conditions of the bodies at u.
            u: displacement in the forms, to which `backwards` gives the values of each solution.
            values: object that evaluates fields of friction and gaps at the nodes of u.
            controls: Constants and Functions with respect to which derivatives are taken.
            find_differences: function (Constant, direction) -> central differences of B for
                obstacles that the Constant moves; None: obstacles depend on no control.
        """
        self._find_differences = find_differences
        self._pairs, self._forms, self._u, self._values = pairs, forms, u, values
        self.controls = list(controls)
        self._z = fem.Function(u.function_space, name="adjoint")
        residual, (test, trial) = forms.residual(self._z), forms.tangent.arguments()
        self._reaction = forms.compiled(
            ufl.replace(forms.tangent, {test: self._z, trial: ufl.TestFunction(u.function_space)})
        )
        self._by_control = [_derivative(residual, control, forms) for control in self.controls]

    def backwards(
        self,
        step: SolvedStep,
        goals: WeightedGoals,
        on_origin: Array | None = None,
        on_displacement: Array | None = None,
    ) -> tuple[list[Any], Array]:
        """Return the derivatives of a sum of goals, by one adjoint solve. Collective.

        The sum may contain further terms, of which only the derivatives `on_origin` and
        `on_displacement` are given.

        Args:
            step: the solution.
            goals: pairs of a factor and a goal; a goal may be a form of rank 0 that depends on the
                solution's u.
            on_origin: (size,) derivatives of further terms with respect to the slip origin of the
                next step; None: zeros.
            on_displacement: derivatives of further terms with respect to the values of the
                displacement; only the values that this rank owns are used. None: zeros.

        Returns:
            for each control the derivatives with respect to its values (for a Function, those that
            this rank owns), or None if nothing depends on the control; and (size,) the derivatives
            with respect to the slip origin of this step.

        Raises:
            InputError: the patch of a goal has no node, or a form does not depend on u; or the
                derivative with respect to a control is not known.
            ConvergenceError: the adjoint has no solution.
        """
        dual, jump = step.dual, step.dual.jump
        sticking, rest = step.sticking_and_other_rows
        on_origin = np.zeros(len(jump.gap)) if on_origin is None else on_origin
        of_next_step = np.where(rest, on_origin, 0.0)
        on_jump, on_x = of_next_step.copy(), np.zeros_like(on_origin)
        prescribed = jump.system.prescribed
        owned, on_u = len(prescribed), fem.Function(step.u.function_space)
        in_forms = [(weight, goal) for weight, goal in goals if isinstance(goal, ufl.Form)]
        for weight, form in in_forms:
            on_u.x.array[:owned] += weight * self._by_displacement(form, step.u)[:owned]
        if on_displacement is not None:
            on_u.x.array[:owned] += on_displacement[:owned]
        for weight, goal in goals:
            if not isinstance(goal, ufl.Form):
                by_both = weights_of(goal, jump, step.multipliers)
                for total, part in zip((on_jump, on_x), by_both, strict=True):
                    total += weight * part
        on_prescribed = on_u.x.array[:owned].copy()
        on_u.x.petsc_vec.array[prescribed] = 0.0
        weights = on_u.x.petsc_vec if in_forms or on_displacement is not None else None
        z, y = adjoint(dual, step.state, on_jump, on_x, step.accuracy, weights)

        self._z.x.array[:] = z.x.array
        if self._u is not step.u:
            self._u.x.array[:] = step.u.x.array
        on_prescribed += jump.whole_force(on_jump - y).array - assembled(self._reaction)[:owned]
        radial = step.state.face.radial_parts(on_x - jump.of_displacement(z))
        fields = nodal_fields(step, self._pairs)
        result: list[Any] = []
        for control, by_residual in zip(self.controls, self._by_control, strict=True):
            parts = [
                self._values.pulled_back(
                    one.field, control, one.nodes, one.weights(y, radial), one.name
                )
                for one in fields
            ]
            if by_residual is not None:
                parts.append(-by_residual())
            for weight, form in in_forms:
                explicit = _derivative(form, control, self._forms)
                if explicit is not None:
                    parts.append(weight * explicit())
            comm = step.u.function_space.mesh.comm
            parts.append(_of_prescribed(self._forms.bcs, control, on_prescribed, comm))
            if self._find_differences is not None and isinstance(control, fem.Constant):
                others = [one for one in goals if not isinstance(one[1], ufl.Form)]
                parts.append(self._of_places(control, step, others, y, radial, of_next_step))
            result.append(sum_of_known(parts))
        return result, np.where(sticking, y + on_origin, np.where(rest, y, 0.0))

    def _of_places(
        self,
        control: fem.Constant,
        step: SolvedStep,
        goals: WeightedGoals,
        y: Array,
        radial: Array,
        on_jump: Array,
    ) -> Array | None:
        """Return the part of the derivative that is due to moved obstacles. Collective.

        The result is None if no obstacle depends on the control. For the arguments see
        `ObstacleDifferences.derivative`.
        """
        assert self._find_differences is not None
        result = np.zeros(np.size(control.value))
        for k, unit in enumerate(np.eye(result.size)):
            jumps = self._find_differences(control, unit.reshape(control.ufl_shape))
            if jumps is None:
                return None
            with jumps:
                result[k] = jumps.derivative(step, goals, self._z, y, radial, on_jump)
        return result.reshape(control.ufl_shape)

    def _by_displacement(self, form: Any, u: fem.Function) -> Array:
        """Return the derivative of a form of rank 0 with respect to u. Collective.

        Raises:
            InputError: the form does not depend on u.
        """
        if u not in form.coefficients():
            raise InputError(
                "the goal is a form that does not depend on the displacement of its solution: "
                "write it in terms of solution.u."
            )
        test = ufl.TestFunction(u.function_space)
        return assembled(self._forms.compiled(ufl.derivative(form, u, test)))


def sum_of_known(parts: Sequence[Any]) -> Any:
    """Return the sum of those parts that are not None; None if all are None."""
    known = [part for part in parts if part is not None]
    return sum(known[1:], known[0]) if known else None


def as_derivatives(values: Sequence[Any], controls: Sequence[Control], comm: Any) -> list[Any]:
    """Return derivatives by `Differentiation.backwards` as arrays and Functions. Collective.

    Args:
        values: for each control the derivatives with respect to its values; None: nothing depends
            on the control, and the log says so.
        controls: the Constants and Functions to which the derivatives belong.
        comm: communicator.

    Returns:
        for each Constant an array of its shape, for each Function a Function on its space.
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
    """Return derivatives as an array or a Function, like the control. Collective.

    Args:
        values: derivatives with respect to the values of the control that this rank owns.
        control: a Constant or a Function.
    """
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


def assembled(form: fem.Form) -> Array:
    """Return the values of a linear form on this rank. Collective.

    Values of owned degrees of freedom are sums over the ranks; values of ghosts are not.
    """
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.asarray(vector.array)


def _derivative(form: Any, control: Control, forms: Forms) -> Callable[[], Array] | None:
    """Return a function that differentiates a form of rank 0 by a control, at present values.

    Collective, and so is the returned function. The result is None if the form does not depend on
    the control.
    """
    if control not in (*form.constants(), *form.coefficients()):
        return None
    if isinstance(control, fem.Function):
        test = ufl.TestFunction(control.function_space)
        compiled = forms.compiled(ufl.derivative(form, control, test))
        return lambda: assembled(compiled)[: _owned(control)]
    # UFL differentiates with respect to Functions: take a Function with the control's value in all
    # cells
    mesh = next(one for one in form.coefficients()).function_space.mesh
    assert mesh.ufl_domain() == form.ufl_domain()
    m = fem.Function(fem.functionspace(mesh, ("DG", 0, control.ufl_shape)))
    form = ufl.replace(form, {control: m})
    compiled = forms.compiled(ufl.derivative(form, m, ufl.TestFunction(m.function_space)))
    size = np.size(control.value)

    def by_constant() -> Array:
        m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // size)
        sums = assembled(compiled)[: _owned(m)].reshape(-1, size).sum(axis=0)
        total = reduce_array(mesh.comm, sums, MPI.SUM)
        return np.asarray(total.reshape(control.ufl_shape))

    return by_constant


def _of_prescribed(bcs: Sequence[Any], control: Control, weights: Array, comm: Any) -> Any:
    """Return the derivative with respect to a control through prescribed values. Collective.

    Args:
        bcs: Dirichlet conditions.
        control: a Constant or a Function.
        weights: (owned degrees of freedom,) derivatives with respect to the prescribed values.
        comm: communicator.

    Returns:
        the derivatives with respect to the values of the control (for a Function, those that this
        rank owns); None if no prescribed value depends on the control.
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
