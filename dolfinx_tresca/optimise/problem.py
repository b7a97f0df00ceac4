"""The input and the result of the algorithms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.constraints import EqualityConstraints
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.friction_cones import FrictionCones
from dolfinx_tresca.optimise.products import ProductStore
from dolfinx_tresca.optimise.reductions import Reductions
from dolfinx_tresca.status import ContactStatus


class DualProblem(Reductions, Protocol):
    """The quadratic program (38.4). Vectors are this rank's parts; `inner` sums over all ranks.

    Where slip bounds depend on the pressure there is one such program, a `section`, for each x; a
    solution is an x that minimises q over the section at x.
    """

    @property
    def b(self) -> Array:
        """The linear term (size,)."""
        ...

    @property
    def b_error(self) -> float:
        """Error of b in the norm of `gradient`. It enters the gradient at zero only."""
        ...

    def refine_b(self) -> None:
        """Compute b to the highest accuracy of the solver for K. Collective."""
        ...

    @property
    def admissible(self) -> FeasibleSet | FrictionCones:
        """Lambda (Tresca), or friction cones (Coulomb), whose section at a pressure is a Lambda."""
        ...

    @property
    def feasible_set(self) -> FeasibleSet:
        """Lambda; if bounds depend on the pressure, Lambda at zero pressure."""
        ...

    def section(self, x: Array) -> DualProblem:
        """Return the program with the slip bounds that belong to the pressures of x (size,).

        Itself where they do not depend on pressures.
        """
        ...

    def relaxed(self, part: float, softness: float, c: Array) -> DualProblem:
        """Return the program with a part of the coefficients of friction, and softer constraints.

        Args:
            part: factor of the coefficients of friction, in (0, 1].
            softness: number that is added to the diagonal of the constraints' matrix S.
            c: (k,) multipliers of the constraints for which the softer constraints are unchanged.
        """
        ...

    @property
    def is_load_step(self) -> bool:
        """Whether this is a step of a process, whose multipliers go on from those it starts at."""
        ...

    @property
    def constraints(self) -> EqualityConstraints:
        """The equations that multipliers satisfy besides Lambda; maybe none."""
        ...

    @property
    def store(self) -> ProductStore:
        """The products that are known; the first call may make some. Collective."""
        ...

    @property
    def near_store(self) -> ProductStore | None:
        """Known products with the near field; None where it does not pay. Collective."""
        ...

    @property
    def products(self) -> int:
        """Number of products with A."""
        ...

    @property
    def exact(self) -> bool:
        """Whether products are exact to rounding, whatever accuracy is asked for."""
        ...

    @property
    def product_error(self) -> float:
        """Largest error of `apply` so far, in the norm of `gradient`, over sqrt(x'A x)."""
        ...

    def apply(self, x: Array) -> Array:
        """Return A x. Collective."""
        ...

    def near_field(self, x: Array) -> Array:
        """Return D x for an operator 0 < D <= A, about, that costs little. Collective.

        The nearer it is to A for rough x, the fewer products with A are needed.
        """
        ...

    def gradient(
        self, x: Array, accuracy: float, origin: Array | None = None
    ) -> tuple[Array, float]:
        """Return r = A x - b, and an estimate of its error. Collective.

        Args:
            x: (size,).
            origin: (size,) where the step to x begins, if it is one: of that a part may be taken.
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
        """Return the relative change of tractions to the minimiser of each node alone. Collective.

        That is the largest change of a node's tractions if its neighbours did not move, over the
        largest traction of all.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        ...

    def energy_norm(self, x: Array, r: Array, error: float = 0.0) -> float:
        """Return |u|_K [energy^(1/2)] for the displacement u at x; 0 below its error. Collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
            error: of r, in the norm of `gradient`.
        """
        ...

    @property
    def energy_resolution(self) -> float:
        """Energy norm [energy^(1/2)] below which a displacement is rounding. Collective."""
        ...

    def discretisation_error(self, x: Array, rho: float) -> float:
        """Return an estimate of the mesh's error in the energy norm, over |u|. Collective.

        Args:
            x: (size,) multipliers; a rough solution will do.
            rho: a step length.
        """
        ...


@dataclass(frozen=True)
class FrictionDeficit:
    """Constraints that no multipliers with known bounds satisfy.

    Attributes:
        motion: (k,) combination of the constraints that asks for more than friction has, as a
            unit vector.
        load: what it asks for, e'motion.
        friction: what friction has, the sum of g |G motion|.
    """

    motion: Array
    load: float
    friction: float


@dataclass(frozen=True)
class DualSolution:
    """The result of an algorithm.

    Attributes:
        multipliers: (size,) lambda in Lambda.
        c: (k,) multipliers of the equality constraints.
        gradient: (size,) r = A lambda - b - G c there.
        status: how the iteration ended.
        iterations: outer iterations.
        residuals: relative natural residual at the start and after each iteration.
        q: q(lambda) at the same points; with equality constraints less its value at the
            least lambda that satisfies them.
        rho: the step length at the end.
        wanted: the relative error in the energy norm that was wanted; inf if residuals decided.
        accuracy: what the error of the displacement may be in the energy norm; None: by the options
            of the solver for K.
        sweeps: Tresca problems that were solved one after the other, where bounds depend on the
            pressure; 0 where the method did not need that.
        deficit: where friction is too weak for the constraints; None if that is not known.
    """

    multipliers: Array
    c: Array
    gradient: Array
    status: ContactStatus
    iterations: int
    residuals: tuple[float, ...]
    q: tuple[float, ...]
    rho: float
    wanted: float
    accuracy: float | None
    sweeps: int = 0
    deficit: FrictionDeficit | None = None
