"""Derivatives of a goal with respect to loads, materials, friction, gaps and prescribed values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.dual.adjoint import LinearisedContact, adjoint
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction
from dolfinx_tresca.scene.goal import Goal
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

    def assembled(self, form: Any) -> fem.Function:
        """Return a linear form as a Function of its space, summed over the ranks. Collective."""
        maps = {} if self.entity_maps is None else {"entity_maps": self.entity_maps}
        vector = fem.assemble_vector(fem.form(form, **maps))
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
        result = fem.Function(form.arguments()[0].ufl_function_space())
        result.x.array[:] = vector.array
        result.x.scatter_forward()
        return result


def gradient(
    goal: Goal | ufl.Form,
    dual: DualProgram,
    pairs: Sequence[ContactPair],
    bounds: Sequence[NodalBounds],
    x: Array,
    u: fem.Function,
    forms: Forms,
    values: NodalValues,
    controls: Sequence[Control],
) -> list[Any]:
    """Return the derivatives of a goal with respect to controls: one adjoint solve. Collective.

    With each node held in its contact state, the residual R(u; v) and the adjoint (z, y) of
    `dual/adjoint.py` the derivative with respect to m is

        dJ/dm = explicit - dR/dm(u; z) + y'dd/dm + (q_u - B'y - dR/du(u; z))'du_D/dm
                + sum over slipping nodes of dg/dm t'(q_x - B z)

    with the gap d, the prescribed values u_D, the slip bound g of a node and the direction t of its
    traction.

    Args:
        goal: the number J, or a form of rank 0 that depends on u.
        dual: the problem.
        pairs: its pairs.
        bounds: slip bounds of the pairs.
        x: (size,) multipliers of the solution.
        u: displacement of the solution [length].
        forms: forms and conditions of the bodies.
        values: takes fields of friction and gaps at the nodes of u.
        controls: Constants and Functions.

    Returns:
        for each Constant an array of its shape, for each Function a Function of its space with the
        derivatives with respect to its values [unit of the goal over the unit of the control].

    Raises:
        InputError: the goal has no node, or does not depend on u; or the derivative with respect to
            a control is not known.
        ConvergenceError: the adjoint has no solution.
    """
    jump = dual.jump
    form: Any = goal if isinstance(goal, ufl.Form) else None
    on_jump, on_x = np.zeros_like(x), np.zeros_like(x)
    if not isinstance(goal, ufl.Form):
        on_jump, on_x = weights_of(goal, dual)
    prescribed = jump.system.prescribed
    owned, on_u = len(prescribed), fem.Function(u.function_space)
    if form is not None:
        if u not in form.coefficients():
            raise InputError(
                "the goal is a form that does not depend on the displacement of the last solution: "
                "write it in terms of solution.u."
            )
        on_u = forms.assembled(ufl.derivative(form, u, ufl.TestFunction(u.function_space)))
    on_prescribed = on_u.x.array[:owned].copy()
    on_u.x.petsc_vec.array[prescribed] = 0.0
    state = LinearisedContact.of(dual, x, dual.response.gradient_of(u.x.petsc_vec))
    accuracy = ACCURACY if dual.exact else ITERATIVE_ACCURACY
    weights = on_u.x.petsc_vec if form is not None else None
    z, y = adjoint(dual, state, on_jump, on_x, accuracy, weights)

    test, trial = forms.tangent.arguments()
    reaction = forms.assembled(
        ufl.replace(forms.tangent, {test: z, trial: ufl.TestFunction(u.function_space)})
    )
    on_prescribed += jump.whole_force(on_jump - y).array - reaction.x.array[:owned]
    radial = state.face.radial_parts(on_x - jump.of_displacement(z))
    fields = _nodal_fields(dual, pairs, bounds, x, y, radial)
    residual = forms.residual(z)
    result: list[Any] = []
    for control in controls:
        parts = [
            values.pulled_back(field, control, nodes, weight, name)
            for field, nodes, weight, name in fields
        ]
        if control in (*residual.constants(), *residual.coefficients()):
            parts.append(-_of_form(residual, control, forms))
        if form is not None and control in (*form.constants(), *form.coefficients()):
            parts.append(_of_form(form, control, forms))
        parts.append(_of_prescribed(forms.bcs, control, on_prescribed, u.function_space.mesh.comm))
        known = [part for part in parts if part is not None]
        if not known:
            log(
                jump.comm,
                "gradient: nothing depends on the control %s: its derivative is zero",
                getattr(control, "name", control),
            )
        result.append(_as_control(sum(known[1:], known[0]) if known else 0.0, control))
    return result


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


def _of_form(form: Any, control: Control, forms: Forms) -> Array:
    """Return the derivative of a form of rank 0 with respect to a control in it. Collective."""
    m = control
    if isinstance(control, fem.Constant):
        # UFL differentiates with respect to Functions: one with the same value in all cells
        mesh = next(one for one in form.coefficients()).function_space.mesh
        assert mesh.ufl_domain() == form.ufl_domain()
        m = fem.Function(fem.functionspace(mesh, ("DG", 0, control.ufl_shape)))
        m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // np.size(control.value))
        form = ufl.replace(form, {control: m})
    found = forms.assembled(ufl.derivative(form, m, ufl.TestFunction(m.function_space)))
    values: Array = found.x.array[: _owned(found)]
    if isinstance(control, fem.Constant):
        sums = values.reshape(-1, np.size(control.value)).sum(axis=0)
        total = reduce_array(found.function_space.mesh.comm, sums, MPI.SUM)
        return np.asarray(total.reshape(control.ufl_shape))
    return values


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
        pairs: its pairs.
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
            fields: dict[str, Any] = {name: none + value}
            given.append(dataclasses.replace(nodal, **fields))
        return np.asarray(jump.bounded(given).section(x).radius)

    ones = [1.0] * len(pairs)
    is_limited = radii("coefficient", [one.coefficient for one in bounds]) > radii(
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
