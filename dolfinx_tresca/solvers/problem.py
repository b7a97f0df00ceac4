"""Input and result of the algorithms: the dual problem as protocols, its solution as a record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.solvers.constraints import EqualityConstraints, InnerProduct, Reductions
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.solvers.products import BlockBFGSModel, ProductStore, WholeModel
from dolfinx_tresca.status import ContactStatus

#: Products with A that are known: single products, or A as a matrix. Both give a model of A.
KnownProducts: TypeAlias = ProductStore | WholeModel

#: A symmetric positive definite model of A.
Model: TypeAlias = BlockBFGSModel | WholeModel


class Compliance(Protocol):
    """The symmetric positive semidefinite matrix A, known by its products.

    Attributes:
        exact: whether products are exact to rounding, whatever accuracy is requested.
    """

    exact: bool

    @property
    def products(self) -> int:
        """Number of products with A so far, with solves for columns of A. Not collective."""

    def apply(self, x: Array) -> Array:
        """Return A x (size,). Collective."""

    def known_products(self) -> KnownProducts:
        """Return the known products; the first call computes A if that is cheap. Collective."""

    def complete_products(self) -> bool:
        """Compute A as a matrix, if it is not too large; return whether it is known. Collective."""


class DualProblem(InnerProduct, Protocol):
    """The quadratic program (38.4). Vectors are this rank's parts; `inner` sums over all ranks.

    If slip bounds depend on the pressure, each x has its own Lambda (`section_at`); a solution is
    an x that minimises q over its own Lambda.

    In this room, x (size,) are multipliers, c (k,) are the multipliers of the constraints, and r
    (size,) is the gradient: A x - b - G c in a `Point`, A x - b in `gradient` and `energy_norm`.
    The error e of a gradient is given in the norm sqrt(e'A^-1 e), which is the energy norm of the
    error of the displacement.

    Attributes:
        b: (size,) the linear term.
        b_error: error of b, and of the gradient at zero multipliers.
        is_load_step: whether a load step was accepted before, which the solution continues.
        constraints: the equations that multipliers satisfy in addition to Lambda.
    """

    b: Array
    b_error: float
    is_load_step: bool
    constraints: EqualityConstraints

    @property
    def compliance(self) -> Compliance:
        """The matrix A of (38.4)."""

    @property
    def b_terms(self) -> Array:
        """The sums (size,) of absolute values of the terms of b, to which rounding is relative."""

    def refine_b(self) -> None:
        """Compute b to the highest accuracy of the solver for K. Collective."""

    @property
    def reductions(self) -> Reductions:
        """Sums over all ranks, and values that are equal on all ranks."""

    @property
    def admissible(self) -> FeasibleSet:
        """Lambda (Tresca), or friction cones (Coulomb), whose section at a pressure is a Lambda."""

    def section_at(self, x: Array, r: Array) -> FeasibleSet:
        """Return Lambda with the slip bounds at the pressures of x and the slips of r."""

    def gradient(self, x: Array, accuracy: float) -> tuple[Array, float]:
        """Return r = A x - b, and an estimate of its error. Collective.

        The error exceeds the requested `accuracy` if the solver for K cannot reach it.
        """

    def energy_norm(self, x: Array, r: Array, error: float = 0.0) -> float:
        """Return |u|_K of u = K^-1 (f - B'x); 0 if an `error` of u may hide it. Collective."""

    def energy_resolution(self) -> float:
        """Return the energy norm below which displacements are rounding errors. Collective."""

    def energy_bound(self, x: Array, r: Array, error: float) -> float:
        """Return a bound of |u - u*|_K; u* is the solution over `section_at(x, r)`. Collective."""

    def local_error(self, x: Array, r: Array) -> float:
        """Return the largest distance of a node's traction from its local minimiser. Collective.

        The local minimiser minimises q over the node's traction in the section at x, with fixed
        neighbours. The distance is relative to the largest traction of all nodes.
        """

    def discretisation_error(self, x: Array, c: Array) -> float:
        """Return an estimate of the relative error of the mesh in the energy norm. Collective."""


@dataclass(frozen=True)
class Point:
    """Multipliers x (size,) and c (k,), with the gradient in x.

    Attributes:
        r: (size,) gradient A x - b - G c, or an approximation of it.
    """

    x: Array
    c: Array
    r: Array


@dataclass(frozen=True)
class FrictionDeficit:
    """A rigid motion along which the load exceeds the friction.

    Attributes:
        motion: (k,) unit vector of the motion's components, one for each equality constraint.
        load: work of the load along the motion, e'motion, with e of `EqualityConstraints`.
        friction: largest work of friction along the motion: the sum of g |G motion|, with G of
            `EqualityConstraints` and the slip bounds g.
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
        gradient: (size,) r = A lambda - b - G c at the multipliers.
        residuals: relative natural residual at the start and after each iteration.
        q: q(lambda) at the start and after each iteration, with the energy of soft constraints.
        wanted: requested relative error in the energy norm; inf: none (residuals alone decided).
        displacement_tolerance: tolerable error of the displacement in the energy norm, not
            relative; None: determined by the options of the solver for K.
        deficit: motion along which friction is too weak for the constraints, if known.
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
    displacement_tolerance: float | None
    deficit: FrictionDeficit | None = None
