"""Options of the contact algorithm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

from dolfinx_tresca._base.arguments import check_word, checked_integer, checked_number

Method: TypeAlias = Literal["projected_newton", "gimssn", "imssn", "mssn", "ssn"]
Accuracy: TypeAlias = float | Literal["balanced"]

#: Method -> default of `rho_sigma`, from benchmarks/README.md; 1 for projected Newton.
_RHO_SIGMA: dict[str, float] = {"gimssn": 1.9, "imssn": 3.0, "mssn": 3.0, "ssn": 3.0}


@dataclass(frozen=True)
class SolverOptions:
    """Options of the dual solver.

    Attributes:
        method: the algorithm. All but "projected_newton" are algorithms of the paper, for bodies
            held by supports and for slip bounds that do not depend on the pressure.
        accuracy: largest accepted error of the iteration relative to the displacement, both in the
            energy norm; in (0, 1). The solve stops when `ContactSolution.energy_error_bound` is at
            most this number. The error of the mesh is not included. With "balanced", the solve
            stops when the bound is at most `mesh_part` times the estimated error of the mesh
            (`ContactSolution.discretisation_error`) and `local_accuracy` is met.
        mesh_part: ratio of the iteration's error to the error of the mesh if `accuracy` is
            "balanced", in (0, 1). The two errors are orthogonal: errors of 1 and 0.1 have the sum
            1.005.
        local_accuracy: largest accepted `ContactSolution.local_error`, which is approximately the
            relative error of nodal pressures, if `accuracy` is "balanced"; in (0, 1). With the
            default, peak pressure, greatest slip and forces are within 1 % of the discrete solution
            (benchmarks/README.md); the number of nodes in a state may differ by
            `ContactSolution.counts.undecided`.
        rtol: largest natural residual |lambda - P(lambda - rho r)|, in the L2 norm of the contact
            surface and relative to its value at lambda = 0; in (0, 1). Here P projects onto the
            feasible set, and r is the gradient of the dual energy. If bodies float, the residual of
            their equilibrium, divided by rho, is a further component. If a value is given, the
            solve stops when this criterion and the criteria of "balanced" are met. Nodal pressures
            and tractions that are exact to several digits need a small value, such as 1e-6. None:
            `accuracy` alone decides.
        max_iterations: largest number of outer iterations, for each `NewtonStep` and configuration.
        rho_sigma: step length rho of the projection times the estimated largest eigenvalue of A.
            GIMSSN and projected Newton take values in (0, 2), for which GIMSSN converges if slip
            bounds are given and supports hold all bodies; the other methods take any positive
            value. None: 1 for projected Newton, 1.9 for GIMSSN, 3 for the others.
        r_tol: ratio of the tolerance of an inner iteration to the outer residual (Step 3.1 of the
            paper), in (0, 1).
        c_fact: largest ratio of an inner tolerance to the previous one (Step 3.1 of the paper), in
            (0, 1); projected Newton does not use it.
        geometry_accuracy: with finite sliding, the largest accepted error that results from pairing
            the surfaces in a configuration that differs from the solution. This is the relative
            error of contact forces, or the error of gaps relative to the displacement of the load
            step, whichever is larger; in (0, 1).

    Example:
        `ContactProblem(..., options=options)` sets the options of all solves; the arguments of
        `ContactProblem.solve` have the same names and change the options of a single solve.

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
        """Check every value, and convert numbers to int or float."""
        check_word("method", self.method, get_args(Method))
        vars(self).update(max_iterations=checked_integer("max_iterations", self.max_iterations))
        names = ["local_accuracy", "mesh_part", "r_tol", "c_fact", "geometry_accuracy"]
        names += [] if self.accuracy == "balanced" else ["accuracy"]
        intervals = dict.fromkeys(names, "(0, 1)")
        if self.rtol is not None:
            intervals["rtol"] = "(0, 1)"
        if self.rho_sigma is not None:
            converges_always = self.method in ("projected_newton", "gimssn")
            intervals["rho_sigma"] = "(0, 2)" if converges_always else "(0, inf)"
        for name, interval in intervals.items():
            vars(self)[name] = checked_number(name, getattr(self, name), interval)

    def with_changes(self, **changes: Any) -> SolverOptions:
        """Return a copy with new values of the named options; values None are ignored.

        A new `accuracy` without a new `rtol` also resets `rtol` to None.

        Raises:
            InputError: a value has the wrong type or is out of its range.
        """
        given = {name: value for name, value in changes.items() if value is not None}
        if "accuracy" in given:
            given.setdefault("rtol", None)
        return replace(self, **given)

    def at_least(self, accuracy: float) -> SolverOptions:
        """Return options with `rtol`, or a number as `accuracy`, of at most this `accuracy`."""
        if self.rtol is not None:
            return self.with_changes(rtol=min(self.rtol, accuracy))
        is_number = self.accuracy != "balanced"
        return self.with_changes(accuracy=min(self.accuracy, accuracy)) if is_number else self

    @property
    def step_factor(self) -> float:
        """Product of rho and the largest eigenvalue of A: `rho_sigma`, or the method's default."""
        return _RHO_SIGMA.get(self.method, 1.0) if self.rho_sigma is None else self.rho_sigma

    @property
    def balanced(self) -> bool:
        """Whether `accuracy` is "balanced" with the mesh's estimated error, and `rtol` is None."""
        return self.rtol is None and self.accuracy == "balanced"

    @property
    def target(self) -> str:
        """The stopping criterion in words, for tables and messages."""
        if self.rtol is not None:
            return f"residual {self.rtol:.0e}"
        if self.balanced:
            return "an error well below the mesh error, and converged nodal tractions"
        return f"energy error {self.accuracy:.0e}"
