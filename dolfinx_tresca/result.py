"""What a solve returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dolfinx import fem

from dolfinx_tresca import io, plot
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import ContactError, ConvergenceError
from dolfinx_tresca.evaluation import NodeCounts
from dolfinx_tresca.fields import SurfaceFields
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.units import Units


def significant(value: float, error: float) -> str:
    """Return a number with as many digits as a relative error leaves: one to eight."""
    return f"{value:.{int(np.clip(np.ceil(-np.log10(max(error, 1e-9))), 1, 8))}g}"


@dataclass(frozen=True)
class ContactSolution:
    """Displacement, contact fields, and how they were found.

    Attributes:
        u: displacement [length], in the user's space.
        surfaces: the fields on each pair's secondary surface.
        multipliers: (size,) this rank's part of lambda [stress], for each pair the normal
            multipliers and then the tangential ones.
        status: how the iteration ended.
        options: what was asked for.
        units: names of units for what is printed and drawn, if the problem was given some.
        iterations: outer iterations.
        products: applications of A = B K^-1 B', set-up included.
        krylov_iterations: iterations of the solver for K; 0 where K was factored.
        residuals: relative natural residual at the start and after each iteration.
        q: 1/2 lambda'A lambda - lambda'b [energy] at the same points; -q is `dual_energy` less its
            value without contact, -1/2 f'K^-1 f. Where bodies float: less its value at the
            least lambda that balances the loads.
        primal_energy: 1/2 u'K u - f'u + sum of g |T u| [energy], over what is not prescribed; no
            bound, since u may penetrate a little.
        dual_energy: a lower bound of the least primal energy, from the multipliers [energy]; as
            rigorous as the next one. With equal values, and without penetration, the solution is
            exact.
        energy_error_bound: bound of |u - u*|_K / |u|_K, where u* is the exact solution of the
            discrete problem: the error of the iteration in the energy norm, see
            `dual/certificate.py`. Infinite where constraints are dependent.
        bound_is_rigorous: whether that is proven, but for rounding. It is where K is factored.
            Else what iterative solves leave is in it as an estimate, by the smallest eigenvalue of
            the preconditioned K that conjugate gradients have met so far.
        local_error: the largest change of a node's tractions if it moved by itself, over the
            largest traction: how well pressures hold node by node, about.
        cell_errors: estimated error of the mesh in each cell, in the energy norm [energy^(1/2)];
            see `estimate.py`. None unless `accuracy="balanced"` was asked for, as by default.
        discretisation_error: the same of all cells together, over |u|_K.
        counts: nodes by state.
        peak_pressure: largest pressure of all nodes [stress].
        greatest_slip: largest norm of the tangential jump of all nodes that may slip [length].
        normal_force: integral of the pressure [force].
        tangential_force: norm of the integral of the tangential traction [force].
        timings: seconds of each phase, the largest over the ranks.
    """

    u: fem.Function
    surfaces: tuple[SurfaceFields, ...]
    multipliers: Array
    status: ContactStatus
    options: SolverOptions
    units: Units | None
    iterations: int
    products: int
    krylov_iterations: int
    residuals: tuple[float, ...]
    q: tuple[float, ...]
    primal_energy: float
    dual_energy: float
    energy_error_bound: float
    bound_is_rigorous: bool
    local_error: float
    cell_errors: fem.Function | None
    discretisation_error: float | None
    counts: NodeCounts
    normal_force: float
    tangential_force: float
    peak_pressure: float
    greatest_slip: float
    timings: dict[str, float]

    @property
    def surface(self) -> SurfaceFields:
        """The fields of the only pair.

        Raises:
            ContactError: there are several; take `surfaces`.
        """
        if len(self.surfaces) != 1:
            raise ContactError(
                f"there are {len(self.surfaces)} pairs: take surfaces[i] of one of them."
            )
        return self.surfaces[0]

    @property
    def pressure(self) -> fem.Function:
        """Contact pressure of the only pair [stress]."""
        return self.surface.pressure

    @property
    def traction(self) -> fem.Function | None:
        """Tangential traction of the only pair [stress]; None without friction."""
        return self.surface.traction

    @property
    def slip(self) -> fem.Function | None:
        """Tangential jump of the only pair [length]; None without friction."""
        return self.surface.slip

    @property
    def gap(self) -> fem.Function:
        """Distance of the only pair [length]."""
        return self.surface.gap

    @property
    def state(self) -> fem.Function:
        """State of the only pair, values of `ContactState`."""
        return self.surface.state

    def raise_if_failed(self) -> None:
        """Check that the iteration reached what was asked for. Not collective.

        Raises:
            ConvergenceError: it did not.
        """
        if self.status is not ContactStatus.CONVERGED:
            advice = "Allow more iterations, or ask for less"
            if self.options.method != "projected_newton":
                advice += ", or take method='projected_newton', which converges from any start"
            raise ConvergenceError(
                f"{self.options.method}: {self.status.value} after {self.iterations} iterations, "
                f"residual {self.residuals[-1]:.1e}, energy error at most "
                f"{self.energy_error_bound:.1e}, asked for {self.options.target}. {advice}."
            )

    def write(self, path: str | Path) -> None:
        """Write the fields for ParaView; see `dolfinx_tresca.io.write`. Collective."""
        io.write(path, self.u, self.surfaces, self.cell_errors)

    def plot(self, path: str | Path, *, scale: float | None = None) -> None:
        """Save a picture; see `dolfinx_tresca.plot.plot`. Collective."""
        plot.plot(path, self.u, self.surfaces, scale=scale)

    def _status_text(self) -> str:
        converged = self.status is ContactStatus.CONVERGED
        return self.status.name + ("" if converged else f": {self.status.value}")

    @property
    def _rubs(self) -> bool:
        """Whether any pair has tangential tractions."""
        return any(surface.traction is not None for surface in self.surfaces)

    def _friction_text(self, stick: int, slip: int) -> str:
        """Return what friction does to nodes; nothing where there is none."""
        return f": {stick} stick, {slip} slip" if self._rubs else ""

    def _digits(self, value: float) -> str:
        """Return a number with the digits that hold, as far as `local_error` tells."""
        return significant(value, self.local_error)

    def _energy_text(self) -> str:
        """Return both energies with the digits that tell them apart."""
        primal, dual = self.primal_energy, self.dual_energy
        apart = abs(primal - dual) / (max(abs(primal), abs(dual)) or 1.0)
        return f"{significant(primal, 0.1 * apart)} primal, {significant(dual, 0.1 * apart)} dual"

    def __str__(self) -> str:
        counts = self.counts
        open_nodes = counts.nodes - counts.contact - counts.bonded
        open_stick = counts.stick - counts.contact_stick
        rows = [
            ("status", self._status_text()),
            ("method", self.options.method),
            ("iterations", f"{self.iterations}, {self.products} products with A"
             + (f", {self.krylov_iterations} Krylov iterations" if self.krylov_iterations else "")
             + ("; nothing to do" if self.iterations == 0 else "")),
            ("residual", f"{self.residuals[-1]:.1e} relative"),
            ("energy error", f"{'at most' if self.bound_is_rigorous else 'about'} "
             f"{self.energy_error_bound:.1e} of the solution's norm"),
            *([] if self.discretisation_error is None else [
                ("mesh error", f"about {self.discretisation_error:.1e} of it")]),
            ("asked for", self.options.target),
            ("contact nodes", f"{counts.nodes}"),
            ("  pressed", f"{counts.contact}" + self._friction_text(
                counts.contact_stick, counts.contact - counts.contact_stick)),
            ("  open", f"{open_nodes}" + self._friction_text(open_stick, open_nodes - open_stick)),
            *([("  bonded", f"{counts.bonded}")] if counts.bonded else []),
            ("peak pressure", self._digits(self.peak_pressure)),
            *([("greatest slip", self._digits(self.greatest_slip))] if self._rubs else []),
            ("force", f"{self._digits(self.normal_force)} normal"
             + (f", {self._digits(self.tangential_force)} tangential" if self._rubs else "")),
            ("energy", self._energy_text()),
            ("seconds", f"{sum(self.timings.values()):.2f}: "
             + ", ".join(f"{name} {value:.2f}" for name, value in self.timings.items())),
        ]  # fmt: skip
        return "\n".join(f"{name:<14} {value}" for name, value in rows)
