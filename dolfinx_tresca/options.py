"""The knobs of the contact algorithm, each in one place."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

from dolfinx_tresca._base.number import integer, real
from dolfinx_tresca.errors import InputError, shown

Method: TypeAlias = Literal["projected_newton", "gimssn", "imssn", "mssn", "ssn"]
Accuracy: TypeAlias = float | Literal["balanced"]

#: Measured on the two bricks (benchmarks/README.md): larger steps let the sets settle sooner.
_RHO_SIGMA: dict[str, float] = {"gimssn": 1.9, "imssn": 3.0, "mssn": 3.0, "ssn": 3.0}

#: Error of what is returned over the one that was wanted, which the last iterate met.
SLACK = 1.01


@dataclass(frozen=True)
class SolverOptions:
    """Options of the dual solver.

    Attributes:
        method: the algorithm; see the modules of `dolfinx_tresca.optimise`.
        accuracy: stop when the bound of the displacement's error in the energy norm is at most this
            part of the displacement (see `ContactSolution.energy_error_bound`, which is proven
            where K is factored). It is the error of the iteration, not that of the mesh.
            "balanced": `mesh_part` of that of the mesh, by an estimate
            (`ContactSolution.discretisation_error`), and `local_accuracy`.
        mesh_part: of "balanced": the iteration's error over that of the mesh, in (0, 1). Where they
            add up like orthogonal ones, a tenth makes the whole larger by half a percent.
        local_accuracy: of "balanced": stop when no node's tractions would change by more than this
            part of the largest traction if it moved by itself. With the default peak pressure,
            greatest slip, forces and the numbers of nodes in each state are the discrete solution's
            to 1 % (benchmarks/README.md).
        rtol: if given, stop when the natural residual |lambda - P(lambda - rho r)|, in the L2 norm
            of the contact surface, is at most this part of its value at lambda = 0, and what
            "balanced" asks for is met too. Pressures and tractions need a small one, such as 1e-6,
            if they are to be exact at every node.
        max_iterations: of the outer (Newton) iteration.
        rho_sigma: rho times the largest eigenvalue of A (estimated). GIMSSN and projected Newton
            converge for values in (0, 2); the other methods take any positive one. None: 1 for
            projected Newton, 1.9 for GIMSSN, 3 for the others.
        r_tol: inner accuracy over outer residual, (Step 3.1); in (0, 1).
        c_fact: least decrease of the inner tolerance per iteration, (Step 3.1); in (0, 1).
        geometry_accuracy: relative error of the contact forces that finite sliding leaves, since
            surfaces are paired in a configuration that is not exactly the solution's; in (0, 1).

    Example:
        For all solves of a problem, `ContactProblem(..., options=options)`; for a single one the
        same names are arguments of `ContactProblem.solve`.

        >>> from dolfinx_tresca import SolverOptions
        >>> options = SolverOptions(rtol=1e-8, max_iterations=50)
        >>> options.target
        'residual 1e-08'
        >>> SolverOptions(accuracy=2.0)
        Traceback (most recent call last):
        dolfinx_tresca.errors.InputError: accuracy must be a number in (0, 1), found 2.0.
    """

    method: Method = "projected_newton"
    accuracy: Accuracy = "balanced"
    local_accuracy: float = 3e-3
    mesh_part: float = 0.1
    rtol: float | None = None
    max_iterations: int = 200
    rho_sigma: float | None = None
    r_tol: float = 0.1
    c_fact: float = 0.9
    geometry_accuracy: float = 1e-4

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            InputError: one is of the wrong type or out of its range.
        """
        methods = get_args(Method)
        if not isinstance(self.method, str) or self.method not in methods:
            raise InputError(
                f"method must be one of {', '.join(methods)}, found {shown(self.method)}."
            )
        iterations = integer(self.max_iterations)
        if iterations is None or iterations < 1:
            raise InputError(
                f"max_iterations must be a positive integer, found {shown(self.max_iterations)}."
            )
        object.__setattr__(self, "max_iterations", iterations)
        guaranteed = self.method in ("projected_newton", "gimssn")
        for name, value, upper in (
            *([] if self.rtol is None else [("rtol", self.rtol, 1.0)]),
            *([] if self._is_balanced else [("accuracy", self.accuracy, 1.0)]),
            ("local_accuracy", self.local_accuracy, 1.0),
            ("mesh_part", self.mesh_part, 1.0),
            ("rho_sigma", self.step_factor, 2.0 if guaranteed else math.inf),
            ("r_tol", self.r_tol, 1.0),
            ("c_fact", self.c_fact, 1.0),
            ("geometry_accuracy", self.geometry_accuracy, 1.0),
        ):
            number = real(value)
            if number is None or not 0.0 < number < upper:
                raise InputError(
                    f"{name} must be a number in (0, {upper:g}), found {shown(value)}."
                )
            if name != "rho_sigma" or self.rho_sigma is not None:
                object.__setattr__(self, name, number)

    def but(self, **changes: Any) -> SolverOptions:
        """Return the options with those changes that are not None.

        Raises:
            InputError: one is of the wrong type or out of its range.
        """
        given = {name: value for name, value in changes.items() if value is not None}
        if "accuracy" in given:
            given.setdefault("rtol", None)  # which would decide instead
        return replace(self, **given)

    def at_least(self, accuracy: float) -> SolverOptions:
        """Return the options that ask for no less than an accuracy, or residual, in (0, 1)."""
        if self.rtol is not None:
            return self.but(rtol=min(self.rtol, accuracy))
        if self._is_balanced:
            return self
        return self.but(accuracy=min(self.accuracy, accuracy))

    @property
    def step_factor(self) -> float:
        """`rho_sigma`, or the method's own value where that is None."""
        return _RHO_SIGMA.get(self.method, 1.0) if self.rho_sigma is None else self.rho_sigma

    @property
    def balanced(self) -> bool:
        """Whether the error of the mesh decides how accurate the iteration is."""
        return self.rtol is None and self._is_balanced

    @property
    def _is_balanced(self) -> bool:
        return isinstance(self.accuracy, str) and self.accuracy == "balanced"

    @property
    def target(self) -> str:
        """What is asked for, in words."""
        if self.rtol is not None:
            return f"residual {self.rtol:.0e}"
        if self.balanced:
            return "an error well below that of the mesh, and nodes at rest"
        return f"energy error {self.accuracy:.0e}"
