"""The part of a goal's error from nodes that change their contact state on finer meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.derivatives.adjoint import LinearisedContact
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.solution.fields import Surface


def state_changes(
    dual: DualProgram,
    surfaces: Sequence[Surface],
    state: LinearisedContact,
    primal: tuple[Array, Array],
    adjoint: tuple[Array, Array],
) -> float:
    """Return the sum of absolute error terms at the edges of contact and stick zones. Collective.

    The exact adjoint has multipliers y where the exact solution is in contact; the discrete
    solution is in contact on a slightly different part of the surface. So the error of a goal is
    a(e, e') + (y, r) + (lambda, w), where e and e' are the errors of the displacement and of the
    adjoint, (,) is an integral over the surface, r the gap of the discrete solution, and w = q_x -
    B z the residual of the discrete adjoint (z, y) at open nodes, with the derivative q_x of the
    goal with respect to the multipliers. The edges of stick zones add similar terms, with the slip
    in place of the gap, and the distance of the traction from its bound in place of the pressure.
    At each node one factor of each product is zero, so the integral over a facet whose nodes have
    the same state vanishes; on a facet with nodes of two states both factors, interpolated
    linearly, differ from zero. The signs of the terms are not reliable, so their absolute values
    are added.

    Args:
        dual: the dual problem.
        surfaces: secondary surfaces of the pairs.
        state: contact states of the nodes.
        primal: multipliers and gradient of the solution, (size,) each.
        adjoint: multipliers y of the adjoint and its residual w, (size,) each.

    Returns:
        the sum, in the unit of the goal.
    """
    jump, face = dual.jump, state.face
    (x, r), (y, w) = primal, adjoint
    bound = face.discs.radius
    lacking = np.where(np.isfinite(bound), bound - face.discs.norms(x), 0.0)
    result = 0.0
    for rows, surface in zip(jump.by_pair, surfaces, strict=True):
        pair, n, t, discs = rows.operators, rows.normal, rows.tangential, rows.nodes
        if pair.bonded:
            continue
        pressed = np.zeros(len(pair.nodes), dtype=np.bool_)
        pressed[pair.normal_node] = face.active[n]
        sticks, slips = face.stick[discs], face.slip[discs]
        (p, q), (gap, left) = ([_normal(pair, v[n]) for v in two] for two in ((x, y), (r, w)))
        pull, slip, late = (_tangential(pair, v[t]) for v in (y, r, w))
        integrand = sum(
            surface.function("one", pair.nodes, one / np.sqrt(pair.weights))
            * surface.function("other", pair.nodes, other / np.sqrt(pair.weights))
            for one, other in (
                (p * pressed, left * ~pressed),
                (q * pressed, gap * ~pressed),
                (lacking[discs] * sticks, late * slips),
                (pull * sticks, slip * slips),
            )
        )
        result += fem.assemble_scalar(fem.form(integrand * ufl.dx))
    return float(reduce_array(jump.comm, result))


def _normal(pair: PairOperators, values: Array) -> Array:
    """Return absolute values (nodes,) of values (n_normal,); zero at nodes without a value."""
    result = np.zeros(len(pair.nodes))
    result[pair.normal_node] = np.abs(values)
    return result


def _tangential(pair: PairOperators, values: Array) -> Array:
    """Return lengths (nodes,) of vectors with values (n_tangential,); zero at other nodes."""
    return np.sqrt(np.bincount(pair.tangent_node, values**2, minlength=len(pair.nodes)))
