"""Contact of nonlinear bodies: each step of Newton's method is a contact problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of, comm_of_self
from dolfinx_tresca._base.arguments import check_type
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import agreed_observer, errors_on_all_ranks, warn
from dolfinx_tresca._base.petsc import destroyed_on_error
from dolfinx_tresca.contact.contact_system import inputs_changed
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.errors import ContactError, ConvergenceError, InputError, StiffnessError, shown
from dolfinx_tresca.monitor import Observer
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.problem.newton import EnergyBalance, Newton, NewtonOptions, NewtonRecord
from dolfinx_tresca.problem.process import ContactProcess, check_options, problem_to_agree
from dolfinx_tresca.problem.tangent_problem import TangentProblem, TangentSystem
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.choice import SolverRequest, StiffnessMethod
from dolfinx_tresca.table import Row, Units


@dataclass(frozen=True, repr=False)
class NonlinearContactSolution(ContactSolution):
    """A `ContactSolution` of nonlinear bodies: the last Newton step, and `newton`, the record.

    Iterations, products and seconds are sums over all Newton steps. Energies and errors belong to
    the quadratic problem of the last step, and the norm |u|_K is that of this step's tangent K.
    """

    newton: NewtonRecord

    @property
    def failure(self) -> str:
        """Reason why the iterations failed, and what helps; empty if they converged."""
        if self.status is ContactStatus.NO_EQUILIBRIUM:
            return self.newton.message
        return super().failure

    def _rows(self) -> list[Row]:
        newton = f"{len(self.newton.steps)} steps, residual {self.newton.residual:.1e}"
        # energies would be those of the last Newton step alone
        rows = [row for row in super()._rows() if row[0] not in ("energy error", "energy")]
        rows.insert(1, ("Newton", newton))
        if self.newton.snaps:
            rows.insert(2, ("released", f"energy {self.newton.released:.4g}: bodies snap"))
        return rows


def _check_options(options: Any, newton: Any) -> None:
    """Check the types of both options, and refuse accuracy='balanced'. Not collective."""
    check_options(options)
    if options.balanced:
        raise InputError(
            "accuracy='balanced' asks for an estimate of the mesh's error, which there is for "
            "linear bodies only: give rtol=..., or a number as accuracy."
        )
    check_type("newton", newton, NewtonOptions, "NewtonOptions(...)")


class NonlinearContactProblem(ContactProcess):
    """Nonlinear bodies in contact with friction: F(u; v) + contact = 0.

    The interface resembles `dolfinx.fem.petsc.NonlinearProblem`: F depends on the Function u, from
    which a solve starts and which holds the solution afterwards. Each Newton step solves a
    contact problem with the tangent at the present u; its unknown is the total displacement. The
    conditions of contact and friction are not linearised, so they hold after each step. Change
    Constants and Functions in forms and conditions in place, as for `ContactProblem`. Multipliers
    are kept from step to step, and products with A as long as the tangent is.

    If Newton's method fails, half of the change of load is applied first. This works for all kinds
    of load, since the residual at the start of the solve is removed in parts. A tangent, which does
    not contain the contact, may be indefinite; springs added in the contact change no solution.

    A solve starts at the present u. In a process with Coulomb friction, a solve after a solution
    that was not accepted starts at the u of the last accepted step, unless u was changed.

    Materials with a history, such as plastic ones, are described by two functions of the user.
    `before_assembly()` computes the stress and its tangent from the present u and the history, and
    stores them in Functions on which F and J depend; it is called for each new u, before anything
    is assembled, last for that at which a solve ends. `on_accept()` makes the state at u the
    history; only `accept()` calls it: failed parts of a load, and trial solves, do not change it.

    For `pairs`, `options`, `units` and `destroy()` see `ContactProblem`.

    Example:
        The cube of `ContactProblem`, made of rubber and compressed to 60 % of its height:

        >>> from dolfinx_tresca import NonlinearContactProblem
        >>> u = fem.Function(V)
        >>> F = ufl.Identity(3) + ufl.grad(u)
        >>> J = ufl.det(F)
        >>> energy = 0.5 * (ufl.inner(F, F) - 3 - 2 * ufl.ln(J)) + 0.75 * ufl.ln(J) ** 2
        >>> residual = ufl.derivative(energy * ufl.dx, u, ufl.TestFunction(V))
        >>> bcs = [fem.dirichletbc(np.array([0.0, 0.0, -0.4]), pressed, V)]
        >>> problem = NonlinearContactProblem(residual, u, [pair], bcs)
        >>> solution = problem.solve()
        >>> solution.raise_if_failed()
        >>> f"{solution.normal_force:.2f} after {len(solution.newton.steps)} steps"
        '1.76 after 4 steps'

    Attributes:
        u: the displacement [length], or all unknowns of a mixed space.
        newton: options of Newton's method.
    """

    _contact: TangentProblem

    @collective(comm_of("u", "F", "bcs", "J"), ignored=("entity_maps",))
    def __init__(
        self,
        F: Any,
        u: fem.Function,
        pairs: Sequence[ContactPair],
        bcs: Sequence[Any] = (),
        J: Any = None,
        *,
        before_assembly: Callable[[], None] | None = None,
        on_accept: Callable[[], None] | None = None,
        symmetrize: bool = False,
        options: SolverOptions | None = None,
        newton: NewtonOptions | None = None,
        stiffness: StiffnessMethod = "auto",
        petsc_options: Mapping[str, Any] | None = None,
        petsc_options_prefix: str | None = None,
        units: Units | None = None,
        entity_maps: EntityMaps | None = None,
        axisymmetric: bool = False,
        V: Any = None,
    ) -> None:
        """Factor the tangent of the undeformed bodies, and pair the surfaces. Collective.

        If `before_assembly` or `on_accept` is given, it is the tangent at the given u.

        Args:
            F: residual form, internal minus external forces; linear in its test function.
            u: displacement on which F depends; the first solve starts from it. In a mixed space (of
                displacement and pressure), u has all unknowns, and `bcs` must hold the bodies.
            pairs: surfaces that may touch.
            bcs: Dirichlet conditions of the total displacement, not of its change in a Newton step.
            J: derivative of F, symmetric; None: `ufl.derivative(F, u)`.
            before_assembly: function without arguments that computes further coefficients of F and
                J from u; ghosts of u are up to date, and the function must update the ghosts of
                other Functions. If F contains u only through these coefficients, give J.
            on_accept: function without arguments that makes the present state of the material the
                history. An error that either function raises on one rank is raised on all ranks;
                other ranks wait for ever if they then communicate in it (make a `fem.Function`).
            symmetrize: whether to replace J by its symmetric part, as follower loads and
                non-associated plasticity need; Newton's method then converges linearly.
            options: options of the contact algorithm; by default a relative residual of 1e-6. The
                contact problem of a step is solved at least as accurately as `newton` requests.
            newton: options of Newton's method.
            stiffness: how to solve with the tangent; see `ContactProblem`.
            petsc_options: options of the solver for the tangent.
            petsc_options_prefix: see `ContactProblem`, as for the following arguments.
            units: names of the units of length and stress.
            entity_maps: needed if forms contain Functions on surface meshes.
            axisymmetric: whether the mesh is the meridian of bodies of revolution.
            V: the sub-space of the displacement in a mixed space with several vector components.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: this tangent is not symmetric, or is indefinite.
        """
        check_type("F", F, ufl.Form, "a UFL form")
        check_type("before_assembly", before_assembly, Callable | None, "a function or None")
        check_type("on_accept", on_accept, Callable | None, "a function or None")
        if not isinstance(u, fem.Function) or (
            u not in F.coefficients() and (before_assembly is None or J is None)
        ):
            raise InputError(
                f"u must be the Function that the form F depends on, found {shown(u)}. For linear "
                "bodies take ContactProblem; if a function computes the stress from u, give it as "
                "before_assembly, and give J with the tangent that it computes."
            )
        if len(F.arguments()) != 1:
            raise InputError(
                f"F must be the residual form, with a test function and no other argument, found "
                f"{len(F.arguments())}: of an energy it is ufl.derivative(energy, u, v)."
            )
        super().__init__(pairs, SolverOptions(rtol=1e-6) if options is None else options, units)
        self.u, self.newton = u, NewtonOptions() if newton is None else newton
        _check_options(self.options, self.newton)
        J = ufl.derivative(F, u) if J is None else J
        if symmetrize:
            if not isinstance(J, ufl.Form):
                raise InputError(f"symmetrize needs J as a UFL form, found {shown(J)}.")
            J = 0.5 * (J + ufl.adjoint(J))
        self._F, self._is_symmetrized = F, symmetrize
        request = SolverRequest(stiffness, petsc_options, petsc_options_prefix)
        tangent = TangentSystem(J, F, bcs, u, entity_maps, before_assembly, axisymmetric, V)
        with destroyed_on_error(tangent):
            self._take(TangentProblem(tangent, on_accept, self.pairs, request))
        self._solves = self._level = 0

    def _solved_for(self, purpose: str) -> StepSolution:
        """Return the last solve, with the tangent at its solution, for derivatives. Collective.

        The tangent that was assembled last belongs to the iterate before the solution, so one more
        Newton step is made. A long step shows that inputs have changed since, which is an error.
        """
        former, problem = super()._solved_for(purpose), self._contact
        if not problem.state.pending:
            raise ContactError(
                f"there is no solution for {purpose}: call solve() first, and accept() afterwards."
            )
        if self._is_symmetrized:
            raise InputError(
                f"{purpose} needs the derivative of F: symmetrize=True takes its symmetric part."
            )
        problem.tangent.forget_material()  # loads may have changed since
        with problem.restored():
            try:
                problem.factor()
            except StiffnessError as error:
                if not error.evidence:
                    raise
                raise ConvergenceError(
                    f"{purpose} needs bodies that are stable without the contact, and at this "
                    f"solution contact alone holds them: of the tangent, {error.evidence}. Compare "
                    "two solutions."
                ) from error
            problem.solve(self.options, self.units, lambda _: False)
            solved = problem.solution_for(purpose)
            change = problem.energy_norm(solved.fields.u.x.array - self.u.x.array)
            inputs_differ = problem.is_large(change, self.u.x.array)
        if inputs_differ:
            raise inputs_changed(purpose)
        solved = replace(solved, status=former.status, history=former.history, fields=former.fields)
        problem.state = replace(problem.state, solution=solved)
        return solved

    def _residual_at(self, u: fem.Function) -> ufl.Form:
        return self._F  # F depends on the user's own Function u, whatever Function is given

    @collective(comm_of_self, ignored=("observer",), extra_values=problem_to_agree)
    def solve(
        self,
        *,
        observer: Observer | None = None,
        options: SolverOptions | None = None,
        newton: NewtonOptions | None = None,
    ) -> NonlinearContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        Args:
            observer: function to be called before each iteration; see `ContactProblem.solve`.
            options: options of the contact algorithm that replace the problem's in this solve.
            newton: options of Newton's method that replace the problem's in this solve.

        Returns:
            the solution; check its `status`, or call its `raise_if_failed()`. The problem's `u`
            holds the same displacement. If the status is NO_EQUILIBRIUM, the result is the
            solution for a part of the change of load; if no part could be solved, it is the
            solution of the last Newton step, and the problem's `u` is where the solve started.

        Raises:
            ContactError: the problem was destroyed.
            InputError: an option, a load, a prescribed value or a slip bound is wrong, or `u` has
                values that are NaN or infinite; or nothing holds a body against its loads.
            StiffnessError: no Newton step is possible from `u`: the tangent there is not symmetric,
                not finite, or indefinite with all springs that may be added.
        """
        options = self.options if options is None else options
        newton = self.newton if newton is None else newton
        _check_options(options, newton)
        observe = agreed_observer(self.comm, observer, "an Iteration, such as a ProgressBar")
        self._contact.check_not_destroyed()
        with errors_on_all_ranks(self.comm):
            if not np.isfinite(self.u.x.array).all():
                raise InputError(
                    "u, which the solve starts from, has values that are NaN or infinite."
                )
        balance = EnergyBalance(self._contact)
        self._contact.begin()
        self._solves += 1
        run = Newton(self._contact, newton, options, self.units, observe, self._level)
        try:
            run.run()
        finally:
            self._contact.end_load(run.fraction)
        self._contact.state = replace(self._contact.state, end=self.u.x.array.copy())
        released, snaps = balance.released(run.start) if run.fraction == 1.0 else (np.nan, False)
        if snaps:
            warn(
                self.comm,
                "bodies snap in solve number %d: they release an energy of %.4g, which is neither "
                "stored nor dissipated by friction. A quasi-static solution does not tell the path "
                "to this equilibrium",
                self._solves,
                released,
            )
        if len(run.steps) > 2 * newton.max_iterations:  # most load steps take 4 to 8
            warn(
                self.comm,
                "solve number %d took %d Newton steps: its change of load is too large, or bodies "
                "snap or are unstable. More load steps, each with a smaller change, may be faster",
                self._solves,
                len(run.steps),
            )
        if run.solution is None:
            raise StiffnessError(
                f"{run.failure}. This is at the displacement u that the solve starts from: begin "
                "at another one, such as zero."
            )
        self._contact.tangent.update_material()  # parts that failed leave it elsewhere
        self._level, solution = run.level, run.solution
        status, message = solution.status, ""
        if run.fraction < 1.0:
            status = ContactStatus.STOPPED if run.stopped else ContactStatus.NO_EQUILIBRIUM
            self._contact.state = self._contact.state.with_status(status)
            hint = f"Parts down to {0.5**newton.max_halvings:.3g} of the change were tried: allow "
            hint += "smaller ones, more steps: NewtonOptions(max_halvings=..., max_iterations=...)."
            message = (
                f"solve number {self._solves} reached {run.fraction:.4g} of its change of load: "
                f"{run.failure}. {'' if run.stuck else f'{hint} '}Look at `u`: bodies that snap "
                "through, buckle or crease have no equilibrium nearby; free faces beside a sharp "
                "edge of the contact fold sooner on finer meshes (take a coarser mesh there); "
                "cells that are squeezed flat need another mesh."
            )
        record = NewtonRecord(
            tuple(run.steps), run.fraction, message, released, snaps, run.unbalanced, run.flips
        )
        values = vars(solution) | run.cost | {"status": status, "newton": record}
        return self._contact.checked(NonlinearContactSolution(**values))
