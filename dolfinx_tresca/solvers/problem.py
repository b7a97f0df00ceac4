"""What an algorithm is given, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from dolfinx_tresca.dual.feasible_set import Array, FeasibleSet


class DualProblem(Protocol):
    """The quadratic program (38.4). Vectors are this rank's parts; `inner` sums over all ranks."""

    @property
    def b(self) -> Array:
        """The linear term (size,)."""
        ...

    @property
    def diagonal(self) -> Array:
        """An estimate (size,) of diag(A) > 0, the same for all tangential multipliers of a node.

        It steers speed, not results.
        """
        ...

    @property
    def feasible_set(self) -> FeasibleSet:
        """Lambda."""
        ...

    @property
    def products(self) -> int:
        """How often A was applied."""
        ...

    @property
    def exact(self) -> bool:
        """Whether products are exact to rounding, whatever accuracy is asked for."""
        ...

    @property
    def product_error(self) -> float:
        """Error of `apply`, in the norm of `gradient`, over sqrt(x'A x)."""
        ...

    def apply(self, x: Array) -> Array:
        """Return A x. Collective."""
        ...

    def gradient(self, x: Array, accuracy: float) -> tuple[Array, float]:
        """Return r = A x - b, and an estimate of its error. Collective.

        Args:
            x: (size,).
            accuracy: what the error e of r may be, in the norm |e| = sqrt(e'A^-1 e): that of the
                energy of the displacement's error. It is larger where the problem can do no better.
        """
        ...

    def energy_bound(self, x: Array, r: Array, error: float) -> float:
        """Return a bound of |u - u*|_K [energy^(1/2)] for the displacement u at x. Collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
            error: of r, in the norm of `gradient`.
        """
        ...

    def local_error(self, x: Array, r: Array) -> float:
        """Return how far tractions are from where their nodes would go by themselves. Collective.

        That is the largest change of a node's tractions if its neighbours did not move, over the
        largest traction of all.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        ...

    def energy_norm(self, x: Array, r: Array) -> float:
        """Return |u|_K [energy^(1/2)] for the displacement u at x. Collective."""
        ...

    def discretisation_error(self, x: Array, rho: float) -> float:
        """Return an estimate of the mesh's error in the energy norm, over |u|. Collective.

        Args:
            x: (size,) multipliers; a rough solution will do.
            rho: a step length.
        """
        ...

    def agreed(self, x: Array) -> Array:
        """Return the first rank's x, which others have but for rounding. Collective."""
        ...

    def least(self, value: float) -> float:
        """Return the least value of all ranks. Collective."""
        ...

    def inner(self, x: Array, y: Array) -> Array:
        """Return x'y over all ranks; x and y of shape (size,) or (size, k). Collective."""
        ...


class ContactStatus(Enum):
    """How the iteration ended."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "iteration limit reached"
    STAGNATED = "no further progress in double precision"
    STOPPED = "stopped by the observer"


@dataclass(frozen=True)
class DualSolution:
    """What an algorithm returns.

    Attributes:
        multipliers: (size,) lambda in Lambda.
        rigid: (k,) motions of loose bodies, which balance the loads together with lambda.
        gradient: (size,) r = A lambda - b there.
        status: how the iteration ended.
        iterations: outer iterations.
        residuals: relative natural residual at the start and after each iteration.
        q: q(lambda) at the same points; where bodies are loose, less its value at the origin.
        rho: the step length at the end.
        wanted: the relative error in the energy norm that was wanted; inf if residuals decided.
        accuracy: what the error of the displacement may be in the energy norm; None: by the options
            of the solver for K.
    """

    multipliers: Array
    rigid: Array
    gradient: Array
    status: ContactStatus
    iterations: int
    residuals: tuple[float, ...]
    q: tuple[float, ...]
    rho: float
    wanted: float
    accuracy: float | None
