"""Status of a solve."""

from __future__ import annotations

from enum import Enum


class ContactStatus(Enum):
    """The reason why the iteration ended; docs/how-to/debugging.md says what to do."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "iteration limit reached"
    STAGNATED = "no further progress in double precision"
    NO_FIXED_POINT = "found no fixed point of pressures and slip bounds"
    NO_EQUILIBRIUM = "Newton's method found no equilibrium for the whole load"
    OUTSIDE_THEORY = "solved, but the scene has left linear theory"
    STOPPED = "stopped by the observer"


class AdaptiveStatus(Enum):
    """The reason why adaptive refinement ended."""

    REACHED = "accuracy reached"
    MAX_DOFS = "limit of unknowns reached"
    MAX_LEVELS = "limit of meshes reached"
    STOPPED = "stopped by the observer"
    FAILED = "an iteration did not converge"
