"""The solution of a contact problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import integer
from dolfinx_tresca._base.atomic_write import atomic_write
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import (
    ContactError,
    ConvergenceError,
    InputError,
    OutsideTheoryError,
    shown,
)
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output import plot
from dolfinx_tresca.output.files import Field, SolutionWriter, grids_of, optional
from dolfinx_tresca.output.report import contact_rows, error_rows, page
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.fields import SurfaceFields
from dolfinx_tresca.solution.forces import BoltForce, Resultant
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.table import LISTED_ROWS, Row, Tabulated, Units

#: Status with which an iteration has failed -> what helps.
ADVICE = {
    ContactStatus.MAX_ITERATIONS: "Allow more iterations, or request less accuracy",
    ContactStatus.STAGNATED: "Rounding errors are as large as the residual: request less accuracy",
    ContactStatus.NO_FIXED_POINT: "Where friction is large, there may be none: apply the load in "
    "steps, with accept() after each, or check the coefficients of friction",
    ContactStatus.STOPPED: "The solution is that of the last iteration",
}


@dataclass(frozen=True)
class ContactSolution(Evaluation, Tabulated):
    """Displacement and contact fields of a solve, with its status, errors and cost.

    Attributes:
        u: displacement [length] in the user's space; for a mixed space, on the component's space.
        w: all unknowns, in the space of the forms. In a mixed space, these are u and the pressure,
            `u, p = solution.w.split()`; in other spaces, w is u.
        deformation: displacement [length] from which strains and stresses follow: for linear bodies
            that turn with finite sliding the displacement v in the frame of each body, with
            u = u_R + R v, the rigid motion u_R and the rotation R of the frame; in all other cases
            u itself.
        contact_force: -N'lambda_nu - T'lambda_tau [force], the contact forces on the nodes of all
            bodies, in the space of u. At free degrees of freedom, their work with v is
            a(u, v) - L(v); at prescribed ones, a(u, v) - L(v) also contains the reactions of the
            supports.
        surfaces: the fields on each pair's secondary surface.
        multipliers: (size,) this rank's part of lambda [stress], for each pair the normal
            multipliers and then the tangential ones.
        status: the reason why the iteration ended.
        options: the options of the solve.
        units: names of units in tables and pictures; None if the problem has none.
        axisymmetric: whether forces, areas and energies are those of rings about the axis x = 0.
            The radial component of a resultant is then the sum of the radial components round the
            ring, although radial forces round a ring cancel as vectors in space.
        iterations: number of outer iterations.
        sliding: explanation of the status `NO_FIXED_POINT` if friction cannot hold a body: the
            body, its motion, and by how much the loads exceed friction. If the configurations of
            finite sliding did not converge, or the status is `OUTSIDE_THEORY`: the reason, with
            advice. In all other cases empty.
        products: number of applications of A = B K^-1 B', set-up included.
        krylov_iterations: number of iterations of the solver for K; 0 if K is factored.
        residuals: relative natural residual at the start and after each iteration.
        q: 1/2 lambda'A lambda - lambda'b [energy] at the start and after each iteration. The
            `dual_energy` is the dual energy of a reference state minus the last value of q. The
            reference state is lambda = 0, with the dual energy -1/2 f'K^-1 f; with floating bodies,
            it is the smallest lambda that balances the loads.
        primal_energy: 1/2 u'K u - f'u + sum of g |T u| [energy] over free degrees of freedom; not
            an upper bound of the minimum, since u may penetrate slightly. In a process, T u stands
            for the slip since the last accepted step.
        dual_energy: lower bound of the minimum of the primal energy, from the multipliers [energy];
            proven if `bound_is_rigorous`. If both energies are equal and nothing penetrates, the
            solution is exact.
        dissipation: work of friction in this step, the sum of traction times slip since the last
            accepted step [energy].
        total_dissipation: dissipation of all accepted steps and this one [energy].
        energy_error_bound: bound of |u - u*|_K / |u|_K, where u* is the exact solution of the
            discrete problem: the error of the iteration in the energy norm, see
            `dual/accuracy.py`. Infinite if constraints are dependent.
        bound_is_rigorous: whether `energy_error_bound` is proven up to rounding: True if K is
            factored. If K is not factored, the bound includes an estimate of the error of iterative
            solves, from the smallest eigenvalue of the preconditioned K that conjugate gradients
            have found so far.
        local_error: largest change of the tractions of a node if this node alone took the state
            that minimises the energy, with its neighbours fixed, relative to the largest traction:
            approximately the relative error of nodal pressures.
        bound_error: largest change of a slip bound that such changes of all nodes' tractions would
            cause, relative to the largest bound: the distance from the fixed point if bounds depend
            on the pressure, else 0. All other errors are those of Tresca's problem with the present
            bounds.
        cell_errors: estimated discretisation error of each cell in the energy norm
            [energy^(1/2)]; see `dual/accuracy.py`. None if an `rtol`, or a number as
            `accuracy`, was requested. Mixed spaces and matrices always need such a request.
        discretisation_error: root of the sum of squared `cell_errors`, divided by |u|_K if that
            is not zero; None without `cell_errors`.
        counts: numbers of nodes in each state.
        peak_pressure: largest pressure of all nodes [stress].
        greatest_slip: largest slip of a pressed node [length]; in a process, the slip in this step.
            Nodes that stick count with zero.
        greatest_total_slip: longest path of a pressed node over the other side: the sum of the
            lengths of its slips in all steps [length].
        normal_force: integral of the pressure [force].
        tangential_force: norm of the integral of the tangential traction [force].
        pair_resultants: force and moment on the secondary side of each pair, about the same
            point as `body_resultants`; see `resultants`.
        pair_states: for each pair the number of pressed nodes, of all nodes, and by how much its
            sides have moved apart at most [length].
        body_resultants: force and moment of all contact on each body, about the centre of the
            bounding box of all contact forces, in the order in which messages number the bodies.
        between_bodies: (i, j) -> force and moment on body i by body j, for bodies i < j in contact.
            Moments are about the mean of the points at which the forces between both bodies act,
            weighted by the sizes of the forces; i and j count from 0 in the order of
            `body_resultants`. See `resultants_between`.
        body_names: name of each body: the name of the tag of its cells in the mesh file (see
            `read_gmsh`). If several bodies share this tag, the name is like "body 2 (roller)"; for
            bodies without such a tag, it is like "body 2". Numbers count from 1.
        reactions: name of each support that `problem.reaction` was asked for -> its force and
            moment; they are in tables and reports.
        timings: seconds of each phase, the largest over the ranks.
        problem_rows: names and values in the table of the problem.
        bolts: name of each pair with a `Preload` -> force in the bolt, and its change [force].

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
    products: int
    krylov_iterations: int
    residuals: tuple[float, ...]
    q: tuple[float, ...]
    timings: dict[str, float]
    sliding: str
    bolts: dict[str, BoltForce]
    problem_rows: list[Row]

    @property
    def surface(self) -> SurfaceFields:
        """The fields of the only pair; with several pairs, a ContactError: take `surfaces[i]`."""
        if len(self.surfaces) != 1:
            raise ContactError(
                f"there are {len(self.surfaces)} pairs: take surfaces[i] of one of them."
            )
        return self.surfaces[0]

    @property
    def pressure(self) -> fem.Function:
        """Contact pressure of the only pair [stress], positive in compression; see `surface`."""
        return self.surface.pressure

    @property
    def traction(self) -> fem.Function | None:
        """Tangential traction of the only pair on its primary side [stress]; None: no friction."""
        return self.surface.traction

    @property
    def slip(self) -> fem.Function | None:
        """Slip of the only pair over all steps [length], secondary minus primary; see `surface`."""
        return self.surface.slip

    @property
    def slip_increment(self) -> fem.Function | None:
        """Slip of the only pair in this step [length]; None without friction."""
        return self.surface.slip_increment

    @property
    def gap(self) -> fem.Function:
        """Gap of the only pair [length], positive where it is open; see `surface`."""
        return self.surface.gap

    @property
    def state(self) -> fem.Function:
        """State of the only pair, values of `ContactState`; see `surface`."""
        return self.surface.state

    def on_mesh(self, name: str) -> fem.Function:
        """Return a field of the only pair on the mesh; see `SurfaceFields.on_mesh`. Collective."""
        return self.surface.on_mesh(name)

    def resultants(self, point: npt.ArrayLike | None = None) -> tuple[Resultant, ...]:
        """Return force and moment of contact on the secondary side of each pair. Not collective.

        The forces are -N'lambda_nu - T'lambda_tau: they act against the normals and against the
        tractions. Those on the primary side are opposite. `body_resultants` sums over all pairs.

        Args:
            point: (d,) reference point of the moments [length], by default as in `body_resultants`.

        Raises:
            InputError: the point does not have d finite coordinates.
        """
        about = self.body_resultants[0].point if point is None else point
        return tuple(resultant.about(about) for resultant in self.pair_resultants)

    def resultants_between(
        self, body: int | str, other: int | str, point: npt.ArrayLike | None = None
    ) -> Resultant:
        """Return force and moment of contact on a body by another body. Not collective.

        Args:
            body: the body that feels the force: its index in the order of `body_resultants`, or
                its name in `body_names`.
            other: the body that exerts the force, given in the same way.
            point: (d,) reference point of the moment [length], by default as in `body_resultants`.

        Raises:
            InputError: no body has an index or a name, both bodies are equal, or the point does
                not have d finite coordinates.
        """
        names, indices = self.body_names, []
        for given in (body, other):
            is_name = isinstance(given, str) and given in names
            index = names.index(given) if is_name else integer(given)
            if index is None or not 0 <= index < len(names):
                raise InputError(
                    f"a body is given by its index from 0 to {len(names) - 1}, or by its name in "
                    f"body_names, {names[0]!r} to {names[-1]!r}, found {shown(given)}."
                )
            indices.append(index)
        i, j = indices
        if i == j:
            raise InputError(f"forces are between two bodies, found {shown(body)} twice.")
        whole = self.body_resultants[0]
        no_force = Resultant(0.0 * whole.force, 0.0 * whole.moment, whole.point)
        # the resultant on the body with the lower index; on the other body it is opposite
        on_lower = self.between_bodies.get((min(i, j), max(i, j)), no_force)
        sign = 1.0 if i < j else -1.0
        on_body = Resultant(sign * on_lower.force, sign * on_lower.moment, on_lower.point)
        return on_body.about(whole.point if point is None else point)

    def raise_if_failed(self) -> None:
        """Raise an error unless the iteration reached the requested accuracy. Not collective.

        Raises:
            ConvergenceError: the status is not CONVERGED.
            OutsideTheoryError: the status is OUTSIDE_THEORY; this is a kind of ConvergenceError.
        """
        if self.status is ContactStatus.OUTSIDE_THEORY:
            raise OutsideTheoryError(self.failure, self.u)
        if self.failure:
            raise ConvergenceError(self.failure)

    @property
    def failure(self) -> str:
        """Reason why the iteration failed, and what helps; empty if it converged."""
        if self.status is ContactStatus.CONVERGED:
            return ""
        if self.status is ContactStatus.OUTSIDE_THEORY:
            return f"the equations are solved, but the scene has left its theory: {self.sliding}."
        advice = self.sliding or ADVICE[self.status]
        if not self.sliding and self.options.method != "projected_newton":
            advice += ", or take method='projected_newton', which converges from any start"
        return (
            f"{self.options.method}: {self.status.value} after {self.iterations} iterations, "
            f"residual {self.residuals[-1]:.1e}, energy error at most "
            f"{self.energy_error_bound:.1e}, requested {self.options.target}. {advice}."
        )

    def values_to_agree(self) -> dict[str, Any]:
        """Return the values that must be equal on all ranks, by name. Not collective."""
        return {"status": self.status.value, "pairs": len(self.surfaces), "u": self.u}

    def summary(self) -> str:
        """Return the table that `print` and `report` show, as text. Not collective.

        It has the status, errors, counts of nodes, and the forces of pairs, bodies, supports and
        bolts, with as many digits as the error justifies.
        """
        return str(self)

    @collective(comm_of_self, ignored=("path",))
    def write(self, path: str | Path, *, fields: Sequence[Field] = ()) -> None:
        """Write displacement and contact fields for ParaView, as a `.pvd`. Collective.

        There is a block "volume" and, for the secondary surface of the pair, a block "contact";
        with several pairs, there are blocks named after the pairs, such as "upper_on_lower". The
        parent folder is created. Beside the file is a folder with the blocks as `.vtu`, which the
        first rank writes. The folder also has the names and colours of the states for ParaView
        (`state.json`). For several solutions see `SolutionWriter`.

        Displacements of degree 2 and curved meshes are kept; contact fields are of degree 1.
        Vectors of 2D get a third component 0, as ParaView requires. Without friction there are no
        fields "traction" and "slip". With load steps there are "slip_increment" and "slip_path" as
        well, from the second step on.

        Beside the displacement the volume has `body`, the number of each cell's body, counted from
        1 as in messages; `cell_errors`, if they were estimated; and the requested fields.

        Args:
            path: the file; the first rank's path counts.
            fields: further fields of the volume, under their names: Lagrange Functions, or
                Functions of degree 0, on the mesh of the displacement, such as a von Mises stress;
                and `MeshTags` of its cells, such as materials, with 0 in cells without a tag.

        Raises:
            InputError: the suffix is not `.pvd`, a field is of another kind or has a name that is
                taken, or the file cannot be written.
        """
        SolutionWriter(self.comm.bcast(str(path))).write(self, 0.0, fields=fields)

    @collective(comm_of_self)
    def to_pyvista(self, *, fields: Sequence[Field] = ()) -> Any:
        """Return the blocks of `write` as a `pyvista.MultiBlock` on the first rank. Collective.

        Args:
            fields: see `write`.

        Returns:
            The blocks of all ranks; None on all ranks but the first.

        Raises:
            InputError: a field is of another kind or has a name that is taken.
            ContactError: pyvista is missing.
        """
        grids = grids_of(self, fields)
        with errors_on_all_ranks(self.comm):
            if not grids:
                return None
            blocks = {name: grid.to_pyvista() for name, grid in grids.items()}
            return optional("pyvista").MultiBlock(blocks)

    def plot(self, path: str | Path | None = None, *, scale: float | None = None) -> Any:
        """Save a picture, or return it; see `dolfinx_tresca.output.plot.plot`. Collective."""
        return plot.plot(path, self.u, self.surfaces, scale=scale, units=self.units)

    def report(self, path: str | Path, *, steps: Sequence[ContactSolution] = ()) -> None:
        """Write a report: one HTML page, which needs neither a server nor a network. Collective.

        It has the table of the solution; a picture of the bodies and of at most 8 pairs, those with
        the largest forces; a graph of the forces between bodies, unless there are more than 24;
        tables of the load steps, if `steps` are given, and of the problem; the last 20 warnings of
        the first rank, versions of software, and the script. The first rank needs pyvista and
        matplotlib, as for `plot`.

        Args:
            path: the `.html` file; the first rank's path counts.
            steps: the solutions of earlier load steps, for a table.

        Raises:
            InputError: the path does not end in .html, `steps` are no solutions, or the file cannot
                be written.
            ContactError: there is no pyvista or matplotlib, or VTK would need a display.
        """
        with errors_on_all_ranks(self.comm):
            if self.comm.rank == 0 and Path(path).suffix != ".html":
                raise InputError(f"a report is an .html file, found '{path}'.")
            if not all(isinstance(step, ContactSolution) for step in steps):
                raise InputError(f"steps must be a list of ContactSolution, found {shown(steps)}.")
        forces = [np.linalg.norm(resultant.force) for resultant in self.pair_resultants]
        drawn = np.sort(np.argsort(forces)[-LISTED_ROWS:])  # more views would take minutes
        picture = plot.plot(None, self.u, [self.surfaces[pair] for pair in drawn], units=self.units)
        with errors_on_all_ranks(self.comm):
            if self.comm.rank == 0:
                with atomic_write(Path(path)) as new:
                    new.write_text(page(self, steps, picture), encoding="utf-8")

    def _rows(self) -> list[Row]:
        """Return the rows of the table; phases of less than a twentieth of the time are omitted."""
        rows = [("status", self.status.name)]
        if self.status is not ContactStatus.CONVERGED:
            rows = [("status", f"{self.status.name}: {self.status.value}")]
        if self.sliding:
            rows.append(("sliding", self.sliding))
        work = f"{self.iterations}, {self.products} products with A"
        if self.krylov_iterations:
            work += f", {self.krylov_iterations} Krylov iterations"
        if self.iterations == 0:
            work += "; nothing to do"
        total = sum(self.timings.values())
        phases = [f"{name} {x:.2f}" for name, x in self.timings.items() if x > 0.05 * total]
        return [
            *rows,
            ("method", self.options.method),
            ("iterations", work),
            ("residual", f"{self.residuals[-1]:.1e} relative"),
            *error_rows(self),
            ("requested", self.options.target),
            *contact_rows(self, self.units, self.bolts),
            ("seconds", f"{total:.2f}: {', '.join(phases)}"),
        ]

    def __repr__(self) -> str:
        return (
            f"<ContactSolution: {self.status.name}, {self.iterations} iterations, {self.products} "
            f"products, energy error {self.energy_error_bound:.1e}, {self.counts.contact} of "
            f"{self.counts.nodes} contact nodes pressed>"
        )
