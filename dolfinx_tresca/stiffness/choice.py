"""The choice of the solver for K."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from petsc4py import PETSc

from dolfinx_tresca._base.number import integer
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.stiffness.cholesky import cholesky, saddle_cholesky
from dolfinx_tresca.stiffness.multigrid import multigrid
from dolfinx_tresca.stiffness.solver import StiffnessSolver
from dolfinx_tresca.stiffness.system import LinearSystem

#: Name of a solver for K.
ChosenMethod: TypeAlias = Literal["cholesky", "multigrid"]

#: Name of a solver for K as users request it; "auto": `choose` decides.
StiffnessMethod: TypeAlias = Literal["auto", ChosenMethod]


class CholeskyLimits(NamedTuple):
    """Largest numbers of degrees of freedom of a body for which K is factored by default.

    The cost of factors grows with the square of the size of each body, not of all bodies together.

    Attributes:
        once: limit for one contact solve; above it multigrid is faster.
        further: increase of the limit for each further solve.
        most: limit for any number of solves, since factors take memory.
    """

    once: int
    further: int
    most: int


#: Limits by the dimension of space and the degree of displacements. For degree 2, K has more
#: entries than for degree 1, but its factors have hardly more entries, and multigrid is set up
#: faster, since the next level has degree 1.
CHOLESKY_LIMITS = {
    (2, 1): CholeskyLimits(800_000, 400_000, 3_000_000),
    (2, 2): CholeskyLimits(800_000, 400_000, 3_000_000),
    (3, 1): CholeskyLimits(50_000, 25_000, 300_000),
    (3, 2): CholeskyLimits(40_000, 25_000, 300_000),
}

#: Limits for meshes that were refined where the error is large. Most of their cells are along edges
#: and surfaces: few unknowns separate such cells, so factors are sparse, while multigrid needs more
#: iterations at singular edges.
REFINED_LIMITS = CHOLESKY_LIMITS | {(3, 2): CholeskyLimits(200_000, 25_000, 300_000)}


def check_choice(method: StiffnessMethod, expected_solves: int, *, saddle: bool = False) -> None:
    """Check the arguments of `choose`. Not collective.

    Args:
        method: the requested method; "auto": `choose` decides.
        expected_solves: expected number of contact solves with the same K.
        saddle: whether K belongs to a mixed space.

    Raises:
        InputError: the method is unknown or unsuitable for a mixed space, or the number of solves
            is not positive.
    """
    solves = integer(expected_solves)
    if solves is None or solves < 1:
        raise InputError(
            f"expected_solves must be a positive integer, found {shown(expected_solves)}."
        )
    methods = get_args(StiffnessMethod)
    if not isinstance(method, str) or method not in methods:
        raise InputError(f"stiffness must be one of {', '.join(methods)}, found {shown(method)}.")
    if method == "multigrid" and saddle:
        raise InputError(
            "stiffness='multigrid' needs a positive definite K, and K of a mixed space is "
            "indefinite. Take stiffness='cholesky'; or, for models too large for it, the form "
            "of the displacement alone, with the volumetric part integrated with a lower "
            "quadrature_degree."
        )


def choose(
    method: StiffnessMethod,
    size: float,
    dim: int,
    degree: int,
    expected_solves: int,
    comm: Any,
    *,
    saddle: bool = False,
    refined: bool = False,
) -> tuple[ChosenMethod, str]:
    """Return the name of the solver for K, and the reason for the choice. Not collective.

    The choice is logged if the method is "auto". The arguments must have passed `check_choice`.

    Args:
        method: the requested method.
        size: number of degrees of freedom of a body, averaged over the degrees of freedom instead
            of over the bodies, so that large bodies decide.
        dim: dimension of space.
        degree: degree of the displacements.
        expected_solves: expected number of contact solves with the same K.
        comm: communicator of the log.
        saddle: whether K belongs to a mixed space.
        refined: whether the mesh was refined from coarser meshes, which multigrid can use.
    """
    if method != "auto":
        return method, "requested"
    if saddle:
        reason = "since multigrid needs a positive definite K"
        log(comm, "stiffness: cholesky, %s", reason)
        return "cholesky", reason
    once, further, most = (REFINED_LIMITS if refined else CHOLESKY_LIMITS)[dim, degree]
    limit = min(once + (expected_solves - 1) * further, most)
    chosen: ChosenMethod = "cholesky" if size <= limit else "multigrid"
    reason = (
        f"since {size:,.0f} unknowns of a body {'<=' if size <= limit else '>'} {limit:,} "
        f"(limit for {expected_solves} solve(s), degree {degree}, {dim}D{', refined' * refined})"
    )
    log(comm, "stiffness: %s, %s", chosen, reason)
    return chosen, reason


def solver_for(
    method: ChosenMethod,
    K: PETSc.Mat,
    system: LinearSystem,
    petsc_options: Mapping[str, Any],
    prefix: str | None,
) -> StiffnessSolver:
    """Return the chosen solver. Collective.

    Args:
        method: name of the solver, see `choose`.
        K: the system's matrix, with the springs of floating bodies, if there are any.
        system: the linear system of K.
        petsc_options: PETSc options in addition to the defaults.
        prefix: prefix of the user's options in PETSc's database.

    Raises:
        StiffnessError: K is indefinite.
    """
    if system.component is not None:
        return saddle_cholesky(K, petsc_options, prefix, system.saddle_size)
    if method == "cholesky":
        return cholesky(K, petsc_options, prefix)
    return multigrid(K, system.V, system.prescribed, petsc_options, prefix)
