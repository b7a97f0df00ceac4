"""A solution with the problem that it solves, for its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.derivatives.adjoint import EdgeState, LinearisedContact
from dolfinx_tresca.dual.program import DualProgram, at_edge
from dolfinx_tresca.dual.slip_bounds import NodalBounds

#: Relative error of the adjoint multipliers, and so of the derivatives. `ACCURACY` is for a K that
#: is factored; `ITERATIVE_ACCURACY` is for an iterative solver for K, whose products have this
#: relative error.
ACCURACY, ITERATIVE_ACCURACY = 1e-10, 1e-5


@dataclass(frozen=True)
class SolvedStep:
    """A solution, with the problem that it solves.

    Attributes:
        dual: the dual problem.
        multipliers: (size,) multipliers of the solution.
        u: displacement of the solution [length].
        bounds: slip bounds at the nodes of each pair.
        edge: state to assume for nodes that are about to change their state; see
            `LinearisedContact.of`.
    """

    dual: DualProgram
    multipliers: Array
    u: fem.Function
    bounds: Sequence[NodalBounds]
    edge: EdgeState = None

    @cached_property
    def gradient(self) -> Array:
        """(size,) gradient (d; s) - B u of the dual energy, with gaps d and slip origins s.

        Collective at the first access.
        """
        return self.dual.response.gradient_of(self.u.x.petsc_vec)

    @cached_property
    def state(self) -> LinearisedContact:
        """The contact state of each node. Collective at the first access."""
        return LinearisedContact.of(self.dual, self.multipliers, self.gradient, self.edge)

    def log_edge(self) -> None:
        """Log how many nodes are about to change their state, if there are any. Collective."""
        normal, discs = at_edge(self.dual, self.multipliers, self.gradient)
        comm = self.dual.jump.comm
        rows, stick = reduce_array(comm, np.array([normal.sum(), discs.sum()]))
        if rows or stick:
            log(
                comm,
                "derivative: %d node(s) are about to open or close, and %d to slip or stick: it is "
                'one-sided; at_edge="held" and "released" give those of other sides',
                int(rows),
                int(stick),
            )

    @property
    def accuracy(self) -> float:
        """Relative error of derivatives, which depends on the solver for K. Not collective."""
        return ACCURACY if self.dual.operator.exact else ITERATIVE_ACCURACY

    @property
    def sticking_and_other_rows(self) -> tuple[Mask, Mask]:
        """Tangential rows (size,) of nodes that stick, and of all other nodes. Not collective.

        The next load step counts the slip of nodes that stick from the same origin as this step,
        and the slip of all other nodes from their tangential jump in this step
        (`SlipHistory.after`).
        """
        face = self.state.face
        rows, sticks = face.discs.tangential, face.stick[face.discs.node]
        sticking, others = np.zeros((2, face.discs.size), dtype=np.bool_)
        sticking[rows[sticks]], others[rows[~sticks]] = True, True
        return sticking, others
