"""Causes of changes of contact data: users' scalars at nodes, and rigid obstacles that move."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import Carry, moved_jump
from dolfinx_tresca.dual.nodal_values import replaced, values_of
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solvers.friction_cones import FrictionCones, pressed_values

#: Step of the central differences of B: the change of the distance from an obstacle, relative to
#: the extent of the mesh. The truncation error is about the square of the step, the rounding error
#: about the rounding of one value divided by the step.
DIFFERENCE_STEP = 1e-5

#: A tangent with displaced obstacles and a tangent with the obstacles where they are count as the
#: same row of T if none of their components differs by more than this number.
TURNED = 0.05


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
    end = 0
    for pair, operators, (normal, _) in zip(pairs, jump.pairs, jump.slices, strict=True):
        nodes, n = operators.nodes, len(operators.nodes)
        own = slice(end, end + n)
        end += n
        rows = np.arange(normal.start, normal.stop)
        inverse = 1.0 / jump.length_scale[normal]
        by_gap = csr_array((inverse, (rows, operators.normal_node)), shape=(discs.size, n))
        name = f"the gap of contact pair {pair}"
        result.append(NodalField(pair.gap, nodes, name, own, np.zeros(n), by_gap))
        terms = pair.friction.terms if isinstance(pair.friction, DryFriction) else BoundTerms()
        for term, words in TERMS.items():
            scalar, by_bound, name = getattr(terms, term), by_term[term][own], f"{words} of {pair}"
            if term == "coefficient" and terms.curve is not None:
                scalar = partial(pressed_values, *next(curves))
            if not isinstance(scalar, tuple):  # `check_controls` refuses controls in two bounds
                no_offsets = csr_array((discs.size, n))
                result.append(NodalField(scalar, nodes, name, own, by_bound, no_offsets))
    return result


@dataclass(frozen=True)
class MovedRows:
    """Central differences of B in a direction of a Constant that moves obstacles.

    Gaps, normals and tangents at the nodes depend on the position of an obstacle. Their central
    differences have relative errors of some 1e-10, and need no solve.

    Attributes:
        sides: B with the obstacles displaced forwards and backwards; the PETSc objects are freed.
        jumps: (size,) B u with both operators.
        step: size of the displacement, as a factor of the direction.
        force: (owned,) directional derivative of -B'x for fixed x [force].
        offset: (size,) directional derivative of (d; s) - B u for fixed u.
        radius: (n_discs,) directional derivative of the radii of the discs, for fixed pressures.
    """

    sides: tuple[JumpOperator, JumpOperator]
    jumps: tuple[Array, Array]
    step: float
    force: Array
    offset: Array
    radius: Array

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
    moves = obstacles.depending_on(constant, jump)
    if not moves.any():
        return None
    origin: Array = np.zeros(len(jump.gap))
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
    step = DIFFERENCE_STEP * obstacles.extent * size
    sides = []
    for factor in (step, -step):
        with replaced([constant], [values_of(constant) + factor * np.ravel(direction)]):
            displaced = moved_jump(jump, system.pairs, surfaces.state.geometry, moves)
        sides.append(displaced.along_axes(contact.bounds))
        if sides[-1] is not displaced:
            displaced.destroy()
    same = all(
        np.array_equal(displaced.nodes, pair.nodes)
        and np.array_equal(displaced.row_node, pair.row_node)
        and np.allclose(displaced.weights, pair.weights, rtol=1e-9)
        and (np.abs(displaced.tangents - pair.tangents) <= TURNED).all()
        for side in sides
        for displaced, pair in zip(side.pairs, jump.pairs, strict=True)
    )
    result = None
    if system.comm.allreduce(same, op=MPI.LAND):
        jumps, x = [side.of_displacement(contact.u) for side in sides], contact.multipliers
        none = np.zeros(0)
        rows = MovedRows((sides[0], sides[1]), (jumps[0], jumps[1]), step or 1.0, none, none, none)

        def radius(side: JumpOperator, _: Array) -> Array:
            values = side.bounded(contact.bounds).section(x).radius
            return np.where(np.isfinite(values), values, 0.0)

        result = replace(
            rows,
            force=-rows.rate(lambda side, _: np.array(side.whole_force(x).array)),
            offset=rows.rate(
                lambda side, jump_of_u: side.gap - jump_of_u + Carry(jump, side).residuals(origin)
            ),
            radius=rows.rate(radius),
        )
    for side in sides:
        side.destroy()
    if result is None:
        raise InputError(
            "nodes are at the edge of what faces an obstacle, or of its search limit: there is "
            "no derivative with respect to its place. Compare two solutions."
        )
    return result
