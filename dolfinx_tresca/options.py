"""The knobs of the contact algorithm, each in one place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from dolfinx_tresca.errors import InputError

Method: TypeAlias = Literal["projected_newton", "gimssn", "imssn", "mssn", "ssn"]

#: Measured on the two bricks (benchmarks/README.md): larger steps let the sets settle sooner.
_RHO_SIGMA: dict[str, float] = {"gimssn": 1.9, "imssn": 3.0, "mssn": 3.0, "ssn": 3.0}


@dataclass(frozen=True)
class SolverOptions:
    """Options of the dual solver.

    Attributes:
        method: the algorithm; see the modules of `dolfinx_tresca.solvers`.
        rtol: stop when the natural residual |lambda - P(lambda - rho r)|, in the L2 norm of the
            contact surface, is at most this part of its value at lambda = 0.
        max_iterations: of the outer (Newton) iteration.
        rho_sigma: rho times the largest eigenvalue of A (estimated). GIMSSN and projected Newton
            converge for values in (0, 2); the other methods take any positive one. None: 1 for
            projected Newton, 1.9 for GIMSSN, 3 for the others.
        r_tol: inner accuracy over outer residual, (Step 3.1); in (0, 1).
        c_fact: least decrease of the inner tolerance per iteration, (Step 3.1); in (0, 1).
    """

    method: Method = "projected_newton"
    rtol: float = 1e-6
    max_iterations: int = 200
    rho_sigma: float | None = None
    r_tol: float = 0.1
    c_fact: float = 0.9

    def __post_init__(self) -> None:
        methods = get_args(Method)
        upper = 2.0 if self.method in ("projected_newton", "gimssn") else math.inf
        rho_sigma = self.step_factor
        for name, wanted, good in (
            ("method", f"one of {', '.join(methods)}", self.method in methods),
            ("rtol", "a number in (0, 1)", 0.0 < self.rtol < 1.0),
            ("max_iterations", "a positive integer", self.max_iterations >= 1),
            ("rho_sigma", f"a number in (0, {upper:g})", 0.0 < rho_sigma < upper),
            ("r_tol", "a number in (0, 1)", 0.0 < self.r_tol < 1.0),
            ("c_fact", "a number in (0, 1)", 0.0 < self.c_fact < 1.0),
        ):
            if not good:
                raise InputError(f"{name} must be {wanted}, found {getattr(self, name)!r}.")

    @property
    def step_factor(self) -> float:
        """`rho_sigma`, or the method's own value where that is None."""
        return _RHO_SIGMA.get(self.method, 1.0) if self.rho_sigma is None else self.rho_sigma
