"""Derivatives of a goal with respect to loads, materials and friction."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.adjoint import LinearisedContact, adjoint
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import DryFriction
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.goal_error import weights_of

#: Relative error of the adjoint multipliers: it is the relative error of the derivatives. With
#: an iterative solver for K that of its products.
ACCURACY, ITERATIVE_ACCURACY = 1e-10, 1e-5

#: What may be changed in place, and what derivatives are taken with respect to.
Control: TypeAlias = "fem.Constant | fem.Function"


def gradient(
    goal: Goal,
    dual: DualProgram,
    pairs: Sequence[ContactPair],
    bounds: Sequence[NodalBounds],
    x: Array,
    u: fem.Function,
    forms: tuple[Any, Any],
    controls: Sequence[Control],
    entity_maps: EntityMaps | None,
) -> list[Any]:
    """Return the derivatives of a goal with respect to controls: one adjoint solve. Collective.

    With each node held in its contact state, the residual R(u; v) = a(u, v) - L(v) and the adjoint
    (z, y) of `dual/adjoint.py` the derivative with respect to m is

        dJ/dm = -dR/dm(u; z) + sum over slipping nodes of dg/dm d'(q_x - B z)

    with the slip bound g of a node and the direction d of its traction.

    Args:
        goal: the number J.
        dual: the problem.
        pairs: its pairs.
        bounds: slip bounds of the pairs.
        x: (size,) multipliers of the solution.
        u: displacement of the solution [length].
        forms: a and L.
        controls: Constants and Functions in a, L or slip bounds.
        entity_maps: needed if forms hold Functions on surfaces.

    Returns:
        for each Constant an array of its shape, for each Function a Function of its space with the
        derivatives with respect to its values [unit of the goal over the unit of the control].

    Raises:
        InputError: the goal has no node; a control is none, or nothing depends on it in a way that
            is known.
        ConvergenceError: the adjoint has no solution.
    """
    r = dual.response.gradient_of(u.x.petsc_vec)
    on_jump, on_x = weights_of(goal, dual)
    state = LinearisedContact.of(dual, x, r)
    accuracy = ACCURACY if dual.exact else ITERATIVE_ACCURACY
    z, _ = adjoint(dual, state, on_jump, on_x, accuracy)
    radial = state.face.radial_parts(on_x - dual.jump.of_displacement(z))
    residual = _residual(forms, u, z)
    result: list[Any] = []
    for control in controls:
        in_forms = _depends(residual, control)
        growth = _growth_of_bounds(dual, pairs, bounds, x, control)
        if not in_forms and growth is None:
            raise InputError(
                f"neither a nor L depends on the control {shown(control)}, and no slip bound or "
                "coefficient of friction is this object: the derivative is zero, or it is not "
                "known. Give Constants or Functions that the forms hold, or a Constant that is a "
                "slip bound or a coefficient."
            )
        found = _of_forms(residual, control, entity_maps) if in_forms else None
        if growth is not None:
            by_friction = float(reduce_array(u.function_space.mesh.comm, radial @ growth))
            found = np.array(by_friction) if found is None else found + by_friction
        result.append(found)
    return result


def _residual(forms: tuple[Any, Any], u: fem.Function, z: fem.Function) -> Any:
    """Return the form R(u; z) = a(u, z) - L(z), a number."""
    a, L = forms
    test, trial = a.arguments()
    result = ufl.replace(a, {trial: u, test: z})
    if isinstance(L, ufl.Form):
        result -= ufl.replace(L, {L.arguments()[0]: z})
    return result


def _depends(form: Any, control: Control) -> bool:
    """Whether a form holds a control."""
    return control in (*form.constants(), *form.coefficients())


def _of_forms(residual: Any, control: Control, entity_maps: EntityMaps | None) -> Any:
    """Return -dR/dm(u; z) for a control m in the forms. Collective."""
    maps = {} if entity_maps is None else {"entity_maps": entity_maps}
    m = control
    if isinstance(control, fem.Constant):
        # UFL differentiates with respect to Functions: one with the same value in all cells
        domain = residual.ufl_domain()
        mesh = next(one for one in residual.coefficients()).function_space.mesh
        assert mesh.ufl_domain() == domain
        m = fem.Function(fem.functionspace(mesh, ("DG", 0, control.ufl_shape)))
        m.x.array[:] = np.tile(np.ravel(control.value), len(m.x.array) // np.size(control.value))
        residual = ufl.replace(residual, {control: m})
    derivative = fem.form(ufl.derivative(residual, m, ufl.TestFunction(m.function_space)), **maps)
    vector = fem.assemble_vector(derivative)
    if isinstance(control, fem.Constant):
        sums = vector.array.reshape(-1, np.size(control.value)).sum(axis=0)
        total = reduce_array(m.function_space.mesh.comm, sums, MPI.SUM)
        return -total.reshape(control.ufl_shape)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    result = fem.Function(control.function_space, name=f"derivative by {control.name}")
    result.x.array[:] = -vector.array
    result.x.scatter_forward()
    return result


def _growth_of_bounds(
    dual: DualProgram,
    pairs: Sequence[ContactPair],
    bounds: Sequence[NodalBounds],
    x: Array,
    control: Control,
) -> Array | None:
    """Return the derivative (n_discs,) of the discs' radii, or None without one. Collective.

    Raises:
        InputError: the control is part of an expression, or of an ellipse.
    """
    terms = [
        pair.friction.terms if isinstance(pair.friction, DryFriction) else None for pair in pairs
    ]
    shares: dict[str, list[bool]] = {}
    for name in ("constant", "coefficient", "limit"):
        values = [None if one is None else getattr(one, name) for one in terms]
        shares[name] = [value is control for value in values]
        for value, pair in zip(values, pairs, strict=True):
            inside = value if isinstance(value, tuple) else (value,)
            hidden = isinstance(value, tuple) or not isinstance(control, fem.Constant)
            for one in inside:
                if (one is control and hidden) or (one is not control and _contains(one, control)):
                    raise InputError(
                        f"contact pair {pair}: the derivative with respect to a slip bound or a "
                        "coefficient is known for a Constant that is given as such, for all "
                        f"directions. The control {shown(control)} is a Function there, or is part "
                        "of an ellipse or of an expression."
                    )
    if not any(any(one) for one in shares.values()):
        return None

    def radii(name: str, values: Sequence[float | Array]) -> Array:
        given = []
        for value, on_nodes in zip(values, dual.jump.pairs, strict=True):
            none, whole = np.zeros(len(on_nodes.nodes)), np.full(len(on_nodes.nodes), np.inf)
            nodal = NodalBounds(constant=none, coefficient=none, limit=whole)
            fields: dict[str, Any] = {name: none + value}
            given.append(dataclasses.replace(nodal, **fields))
        return np.asarray(dual.jump.bounded(given).section(x).radius)

    grows = {name: [float(one) for one in share] for name, share in shares.items()}
    by_pressure = radii("coefficient", [one.coefficient for one in bounds])
    is_limited = by_pressure > radii("constant", [one.limit for one in bounds])
    growth: Array = radii("constant", grows["constant"]) + np.where(
        is_limited, radii("constant", grows["limit"]), radii("coefficient", grows["coefficient"])
    )
    return growth


def _contains(value: Any, control: Control) -> bool:
    """Whether an expression of UFL holds a control."""
    if not isinstance(value, ufl.core.expr.Expr):
        return False
    return any(one is control for one in ufl.corealg.traversal.traverse_unique_terminals(value))
