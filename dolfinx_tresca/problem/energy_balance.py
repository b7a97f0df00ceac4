"""The energy that a load step releases: its bodies snap, and what they lose is motion and heat."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.errors import StiffnessError

if TYPE_CHECKING:
    from dolfinx_tresca.problem.tangent_problem import TangentProblem

#: Fractions of the change of displacement at which internal forces are evaluated, with the weights
#: of the mean of both ends, and of the integral along the change (Lobatto's rule with four points,
#: exact for polynomials of degree 5).
INNER = 0.5 * np.sqrt(0.2)
PATH = (
    *((0.0, 0.5, 1.0 / 12.0), (1.0, 0.5, 1.0 / 12.0)),
    *((0.5 - INNER, 0.0, 5.0 / 12.0), (0.5 + INNER, 0.0, 5.0 / 12.0)),
)

#: Bodies have snapped if they release more than the first part of the energy that they exchange
#: with contact or store, whichever is larger, and move more than the second number times as far as
#: obstacles and prescribed values. (A step in which contact of round bodies begins seems to release
#: 0.2, since its force is no linear function of the motion; one in which an edge passes from node
#: to node up to 0.6, which the next step takes back.)
SNAP, FAR = 0.5, 3.0


class EnergyBalance:
    """Work, stored energy and friction between the start of a solve and its solution.

    The work of loads, prescribed values and obstacles is that of forces which change linearly with
    the motion (the trapezoidal rule), as they do in small steps of a quasi-static process. The
    change of the stored energy is the integral of the internal forces R over the straight path from
    u_0 to u_1. The energy that remains is

        1/2 (R_0 + R_1)'(u_1 - u_0) - integral of R'du + 1/2 (C_0 + C_1)'(u_1 - u_0 - v) - D

    with the contact forces C = B'lambda, the displacement v of the obstacles at the nodes, and the
    dissipation D of friction. Forces at prescribed degrees of freedom and loads that have changed
    are included. In a smooth step each of the differences vanishes, to third order in the step.
    """

    def __init__(self, problem: TangentProblem) -> None:
        """Note displacement and contact forces at the end of the last solve. Collective.

        Args:
            problem: the problem before its surfaces are paired for the next solve.
        """
        self._problem, surfaces = problem, problem.surfaces
        state = surfaces.state
        self._motions = state.motions, surfaces.obstacles.motions
        self._start = problem.u.x.array.copy()
        known_ends = [u for u in (state.end, state.accepted.unknowns) if u is not None]
        self._ends = known_ends or [np.zeros_like(self._start)]
        self._forces_at_start, self._work_at_start, _ = self._contact()

    def _contact(self) -> tuple[Array, float, float]:
        """Return C at owned unknowns, the local sum of C'v, and the largest v. Collective."""
        problem, surfaces = self._problem, self._problem.surfaces
        jump, multipliers = surfaces.jump, surfaces.state.multipliers
        forces, work = np.array(jump.whole_force(multipliers).array), 0.0
        farthest = 0.0
        for before, after, rows in zip(*self._motions, jump.slices, strict=True):
            if not np.array_equal(before, after):
                own = np.zeros_like(multipliers)
                for indices in rows:
                    own[indices] = multipliers[indices]
                moved = surfaces.obstacles.displacement(before, after, problem.displacement)
                moves = problem.tangent.whole(moved)[: len(forces)]
                work += float(jump.whole_force(own).array @ moves)
                farthest = max(farthest, np.abs(moves).max(initial=0.0))
        return forces, work, farthest

    def note_start(self) -> None:
        """Note whether the solve starts where the last one has ended. Not collective."""
        begins_there = np.array_equal(self._problem.u.x.array, self._start)
        is_end = any(np.array_equal(self._start, end) for end in self._ends)
        self._starts_elsewhere = not (begins_there and is_end)

    def released(self, dissipation: float) -> tuple[float, bool]:
        """Return the released energy at the present displacement, and whether bodies snap.

        The energy is NaN if the solve did not start where the last one ended, or if internal forces
        cannot be computed on the straight path. If a function of the user computes them, it is
        called only where bodies move `FAR`, and the energy is NaN elsewhere. Collective.

        Args:
            dissipation: D [energy].

        Raises:
            Exception: an error of the user's functions, on all ranks.
        """
        problem, tangent = self._problem, self._problem.tangent
        forces, work, driven = self._contact()
        change = problem.u.x.array - self._start
        owned, moves = change[: len(forces)], tangent.moves
        sizes = [np.abs(owned[rows]).max(initial=0.0) for rows in (moves, tangent.prescribed)]
        moved, held, driven, elsewhere = reduce_array(
            problem.comm, [*sizes, driven, float(self._starts_elsewhere)], MPI.MAX
        )
        is_far = moved > FAR * max(held, driven)
        if elsewhere or (tangent.has_material and not is_far):
            return np.nan, False
        at_ends = stored = 0.0
        try:
            for fraction, of_ends, of_path in PATH:
                with problem.at_unknowns(self._start + fraction * change):
                    power = float(tangent.all_forces() @ owned)
                at_ends, stored = at_ends + of_ends * power, stored + of_path * power
        except StiffnessError:
            return np.nan, False
        contact = 0.5 * float((self._forces_at_start + forces) @ owned)
        local = [at_ends, stored, contact, 0.5 * (self._work_at_start + work)]
        at_ends, stored, contact, work = reduce_array(problem.comm, local)
        released = at_ends - stored + contact - work - dissipation
        is_large = released > SNAP * max(abs(stored), abs(contact))
        return released, bool(is_large and is_far)
