"""The solution of a contact problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx import fem

from dolfinx_tresca._base.number import integer
from dolfinx_tresca.errors import ContactError, ConvergenceError, InputError, shown
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output import io, plot
from dolfinx_tresca.output.blocks import Field
from dolfinx_tresca.output.report import contact_rows, error_rows
from dolfinx_tresca.output.table import Row, Tabulated
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.fields import SurfaceFields
from dolfinx_tresca.solution.resultants import Resultant
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.units import Units


@dataclass(frozen=True)
class ContactSolution(Evaluation, Tabulated):
    """Displacement, contact fields, and how they were found.

    Attributes:
        u: displacement [length], in the user's space; of a mixed space the component, by itself.
        w: all unknowns, in the space of the forms: u and the pressure of a mixed space,
            `u, p = solution.w.split()`; else the same as u.
        contact_force: -N'lambda_nu - T'lambda_tau [force], on nodes of both bodies, in the space of
            u: what the contact does to them. Where nothing is prescribed a(u, v) - L(v) is its
            power with v; elsewhere the difference is the reaction of the supports.
        surfaces: the fields on each pair's secondary surface.
        multipliers: (size,) this rank's part of lambda [stress], for each pair the normal
            multipliers and then the tangential ones.
        status: the end of the iteration.
        options: the options of the solve.
        units: names of units for what is printed and drawn, if the problem was given some.
        axisymmetric: whether forces, areas and energies are those of rings about the axis x = 0;
            the radial component of a resultant is the sum of radial forces round the ring, which
            balance each other.
        iterations: outer iterations.
        sliding: where the status is `NO_FIXED_POINT` since friction cannot hold a body: which one,
            how it moves, and by how much the loads exceed friction. With finite sliding also where
            the configurations did not converge, and what to do. Else empty.
        sweeps: Tresca problems that were solved one after the other, where bounds depend on the
            pressure; 0 for projected Newton, which finds the fixed point on its model of A.
        products: applications of A = B K^-1 B', set-up included.
        krylov_iterations: iterations of the solver for K; 0 where K was factored.
        residuals: relative natural residual at the start and after each iteration.
        q: 1/2 lambda'A lambda - lambda'b [energy] at the same points; -q is `dual_energy` less its
            value without contact, -1/2 f'K^-1 f. Where bodies float: less its value at the
            least lambda that balances the loads.
        primal_energy: 1/2 u'K u - f'u + sum of g |T u| [energy], over what is not prescribed; no
            bound, since u may penetrate a little. In load steps T u counts from the last one.
        dual_energy: a lower bound of the least primal energy, from the multipliers [energy]; as
            rigorous as the next one. With equal values, and without penetration, the solution is
            exact.
        dissipation: work of friction in this step, the sum of traction times slip since the last
            accepted one [energy].
        total_dissipation: dissipation of all accepted steps and this one [energy].
        energy_error_bound: bound of |u - u*|_K / |u|_K, where u* is the exact solution of the
            discrete problem: the error of the iteration in the energy norm, see
            `dual/certificate.py`. Infinite where constraints are dependent.
        bound_is_rigorous: whether that is proven, but for rounding. It is where K is factored.
            Else what iterative solves leave is in it as an estimate, by the smallest eigenvalue of
            the preconditioned K that conjugate gradients have met so far.
        local_error: the largest change of a node's tractions if it moved by itself, over the
            largest traction: how well pressures hold node by node, about.
        bound_error: the largest change of a slip bound, over the largest one, if nodes moved by
            themselves: the distance from the fixed point where bounds depend on the pressure, for
            which all other errors take the present bounds. Else 0.
        cell_errors: estimated error of the mesh in each cell, in the energy norm [energy^(1/2)];
            see `dual/estimate.py`. None where a `rtol`, or a number as `accuracy`, was asked for,
            without which there are no solves with mixed spaces and matrices.
        discretisation_error: root of the sum of squared `cell_errors`, over |u|_K.
        counts: nodes by state.
        peak_pressure: largest pressure of all nodes [stress].
        greatest_slip: largest slip of a pressed node [length]; in a process, that of this step.
            Nodes that stick have none.
        greatest_total_slip: largest path of a pressed node over the other side: the sum of the
            lengths of its slips in all steps [length].
        normal_force: integral of the pressure [force].
        tangential_force: norm of the integral of the tangential traction [force].
        pair_resultants: force and moment on the secondary side of each pair, about the middle of
            the contact; see `resultants`.
        body_resultants: force and moment of all contact on each body, in the order in which
            messages number the bodies.
        between_bodies: for each two bodies (i, j), i < j, that push each other, the force and
            moment on body i by body j, about the origin; i and j count from 0 in the order of
            `body_resultants`. See `resultants_between`.
        body_names: for each body the name of the tag of its cells in the mesh file (see
            `read_gmsh`), with its number where several bodies have this name; or its number.
        timings: seconds of each phase, the largest over the ranks.

    Example:
        With the cube of `ContactProblem`:

        >>> solution = problem.solve(accuracy=1e-3)
        >>> solution.status
        <ContactStatus.CONVERGED: 'converged'>
        >>> solution.energy_error_bound < 1e-3
        True
        >>> f"{solution.normal_force:.2f} N on {solution.counts.contact} nodes"
        '1.00 N on 16 nodes'
        >>> solution.pressure.name, solution.surface.gap.name
        ('pressure', 'gap')
    """

    status: ContactStatus
    options: SolverOptions
    units: Units | None
    iterations: int
    sweeps: int
    products: int
    krylov_iterations: int
    residuals: tuple[float, ...]
    q: tuple[float, ...]
    timings: dict[str, float]
    sliding: str

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
    def slip_increment(self) -> fem.Function | None:
        """Slip of the only pair in this step [length]; None without friction."""
        return self.surface.slip_increment

    @property
    def gap(self) -> fem.Function:
        """Distance of the only pair [length]."""
        return self.surface.gap

    @property
    def state(self) -> fem.Function:
        """State of the only pair, values of `ContactState`."""
        return self.surface.state

    def on_mesh(self, name: str) -> fem.Function:
        """Return a field of the only pair on the problem's mesh, for forms. Collective.

        See `SurfaceFields.on_mesh`.

        Args:
            name: such as "pressure".

        Raises:
            ContactError: there are several pairs: take `surfaces[i].on_mesh`.
            InputError: there is no such field.
        """
        return self.surface.on_mesh(name)

    def resultants(self, point: npt.ArrayLike | None = None) -> tuple[Resultant, ...]:
        """Return force and moment of each pair, as the secondary side feels them. Not collective.

        That is -N'lambda_nu - T'lambda_tau: pressures push against the normals, tractions drag with
        their sign changed. The primary side feels the opposite. `body_resultants` has the sums of
        all pairs on each body.

        Args:
            point: (d,) about which moments are taken [length]; the origin by default.

        Raises:
            InputError: it is no point.
        """
        dim = self.u.function_space.mesh.geometry.dim
        about = np.zeros(dim) if point is None else point
        return tuple(resultant.about(about) for resultant in self.pair_resultants)

    def resultants_between(
        self, body: int | str, other: int | str, point: npt.ArrayLike | None = None
    ) -> Resultant:
        """Return force and moment of contact on a body by another one. Not collective.

        Args:
            body: the body that feels the force: its index in the order of `body_resultants`, or
                its name in `body_names`.
            other: the other body.
            point: (d,) about which moments are taken [length]; the origin by default.

        Raises:
            InputError: there is no such body, both are the same, or the point is none.
        """
        first, second = self._body_index(body), self._body_index(other)
        if first == second:
            raise InputError(f"forces are between two bodies, found {shown(body)} twice.")
        dim = self.u.function_space.mesh.geometry.dim
        none = Resultant(np.zeros(dim), np.zeros(1 if dim == 2 else 3), np.zeros(dim))
        found = self.between_bodies.get((min(first, second), max(first, second)), none)
        sign = 1.0 if first < second else -1.0
        found = Resultant(sign * found.force, sign * found.moment, found.point)
        return found if point is None else found.about(point)

    def _body_index(self, body: int | str) -> int:
        """Return the index of a body that is given by it, or by its name.

        Raises:
            InputError: there is no such body.
        """
        if isinstance(body, str) and body in self.body_names:
            return self.body_names.index(body)
        index, last = integer(body), len(self.body_names) - 1
        if index is None or not 0 <= index <= last:
            names = f"{self.body_names[0]!r} to {self.body_names[last]!r}"
            raise InputError(
                f"a body is given by its index from 0 to {last}, or by its name in body_names, "
                f"{names}, found {shown(body)}."
            )
        return index

    def raise_if_failed(self) -> None:
        """Check that the iteration reached what was asked for. Not collective.

        Raises:
            ConvergenceError: it did not.
        """
        if self.status is not ContactStatus.CONVERGED:
            advice = self.sliding or "Allow more iterations, or ask for less"
            if not self.sliding and self.options.method != "projected_newton":
                advice += ", or take method='projected_newton', which converges from any start"
            raise ConvergenceError(
                f"{self.options.method}: {self.status.value} after {self.iterations} iterations, "
                f"residual {self.residuals[-1]:.1e}, energy error at most "
                f"{self.energy_error_bound:.1e}, asked for {self.options.target}. {advice}."
            )

    def values_to_agree(self) -> dict[str, Any]:
        """Return the values that ranks compare of a solution. Not collective."""
        return {"status": self.status.value, "pairs": len(self.surfaces), "u": self.u}

    def write(self, path: str | Path, *, fields: Sequence[Field] = ()) -> None:
        """Write the fields for ParaView; see `dolfinx_tresca.output.io.write`. Collective."""
        io.write(path, self, fields=fields)

    def to_pyvista(self, *, fields: Sequence[Field] = ()) -> Any:
        """Return the blocks for pyvista; see `dolfinx_tresca.output.io.to_pyvista`. Collective."""
        return io.to_pyvista(self, fields=fields)

    def plot(self, path: str | Path | None = None, *, scale: float | None = None) -> Any:
        """Save a picture, or return it; see `dolfinx_tresca.output.plot.plot`. Collective."""
        return plot.plot(path, self.u, self.surfaces, scale=scale, units=self.units)

    def _rows(self) -> list[Row]:
        converged = self.status is ContactStatus.CONVERGED
        work = f"{self.iterations}, {self.products} products with A"
        if self.sweeps:
            work += f", {self.sweeps} sweeps"
        if self.krylov_iterations:
            work += f", {self.krylov_iterations} Krylov iterations"
        total = sum(self.timings.values())
        phases = [
            f"{name} {value:.2f}" for name, value in self.timings.items() if value > 0.05 * total
        ]
        return [
            ("status", self.status.name + ("" if converged else f": {self.status.value}")),
            *([("sliding", self.sliding)] if self.sliding else []),
            ("method", self.options.method),
            ("iterations", work if self.iterations else f"{work}; nothing to do"),
            ("residual", f"{self.residuals[-1]:.1e} relative"),
            *error_rows(self),
            ("asked for", self.options.target),
            *contact_rows(self, self.units),
            ("seconds", f"{total:.2f}: {', '.join(phases)}"),
        ]

    def __repr__(self) -> str:
        return (
            f"<ContactSolution: {self.status.name}, {self.iterations} iterations, {self.products} "
            f"products, energy error {self.energy_error_bound:.1e}, {self.counts.contact} of "
            f"{self.counts.nodes} contact nodes pressed>"
        )
