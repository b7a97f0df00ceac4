"""The knobs of the contact algorithm, each in one place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from dolfinx_tresca.errors import InputError

Method: TypeAlias = Literal["projected_newton", "gimssn", "imssn", "mssn", "ssn"]


@dataclass(frozen=True)
class SolverOptions:
    """Options of the dual solver.

    Attributes:
        method: the algorithm; see the modules of `dolfinx_tresca.solvers`.
        rtol: stop when the natural residual |lambda - P(lambda - rho r)|, in the L2 norm of the
            contact surface, is at most this part of its value at lambda = 0.
        max_iterations: of the outer (Newton) iteration.
        rho_sigma: rho times the largest eigenvalue of A (estimated). GIMSSN and projected Newton
            converge for values in (0, 2); the other methods take any positive one.
        r_tol: inner accuracy over outer residual, (Step 3.1); in (0, 1).
        c_fact: least decrease of the inner tolerance per iteration, (Step 3.1); in (0, 1).
    """

    method: Method = "projected_newton"
    rtol: float = 1e-6
    max_iterations: int = 200
    rho_sigma: float = 1.0
    r_tol: float = 0.1
    c_fact: float = 0.9

    def __post_init__(self) -> None:
        methods = get_args(Method)
        upper = 2.0 if self.method in ("projected_newton", "gimssn") else math.inf
        for name, wanted, good in (
            ("method", f"one of {', '.join(methods)}", self.method in methods),
            ("rtol", "a number in (0, 1)", 0.0 < self.rtol < 1.0),
            ("max_iterations", "a positive integer", self.max_iterations >= 1),
            ("rho_sigma", f"a number in (0, {upper:g})", 0.0 < self.rho_sigma < upper),
            ("r_tol", "a number in (0, 1)", 0.0 < self.r_tol < 1.0),
            ("c_fact", "a number in (0, 1)", 0.0 < self.c_fact < 1.0),
        ):
            if not good:
                raise InputError(f"{name} must be {wanted}, found {getattr(self, name)!r}.")
