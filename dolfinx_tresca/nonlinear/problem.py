"""Contact of nonlinear bodies: Newton's method whose every step is a contact problem."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of, comm_of_self
from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.errors import InputError, StiffnessError, shown
from dolfinx_tresca.monitor import Observer
from dolfinx_tresca.nonlinear.linearised import LinearisedProblem
from dolfinx_tresca.nonlinear.newton import Newton
from dolfinx_tresca.nonlinear.record import NewtonOptions, NewtonRecord
from dolfinx_tresca.nonlinear.solution import NonlinearContactSolution
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.output.table import Row, Tabulated
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.problem import ContactProblem
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.choice import StiffnessMethod
from dolfinx_tresca.units import Units

_P = ParamSpec("_P")
_T = TypeVar("_T")


def _of_each_step(
    method: Callable[Concatenate[ContactProblem, _P], _T],
) -> Callable[Concatenate[NonlinearContactProblem, _P], _T]:
    """Return what the problem of each Newton step does, and with it the one of all of them."""

    @functools.wraps(method)
    def do(self: NonlinearContactProblem, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        return method(self._step, *args, **kwargs)

    return do


def _check_options(options: Any, newton: Any) -> None:
    """Check the kinds of options.

    Raises:
        InputError: they are no options, or not for nonlinear bodies.
    """
    if not isinstance(options, SolverOptions):
        raise InputError(f"options must be SolverOptions(...), found {shown(options)}.")
    if options.balanced:
        raise InputError(
            "accuracy='balanced' asks for an estimate of the mesh's error, which there is for "
            "linear bodies only: give rtol=..., or a number as accuracy."
        )
    if not isinstance(newton, NewtonOptions):
        raise InputError(f"newton must be NewtonOptions(...), found {shown(newton)}.")


def _options(problem: NonlinearContactProblem) -> dict[str, Any]:
    """Return the options that count where a solve is given none. Not collective."""
    return {"options of the problem": problem.options, "newton of the problem": problem.newton}


class NonlinearContactProblem(PetscOwner, Tabulated):
    """Nonlinear bodies in contact with friction: F(u; v) + contact = 0.

    The shape is that of `dolfinx.fem.petsc.NonlinearProblem`: F depends on the Function u, which
    has the solution after `solve()`, and is where the next one starts. Each Newton step is a
    contact problem for the whole displacement, with the tangent at the last one: gap, friction and
    multipliers are those of the nonlinear problem in every step, and contact is exact in all of
    them. What the forms and conditions depend on is changed in place, as with `ContactProblem`;
    multipliers and the models of products are kept from step to step.

    Where Newton's method fails the change of load is halved, whatever it is: forces that are out of
    balance at the start are taken away little by little. A tangent that is indefinite, since
    nothing tells it of contact, gets springs there that do not change the answer.

    Sliding is small: nodes keep their partners and normals, unless `update_geometry` finds others.

    Owns PETSc objects: call `destroy()`, or use it as a context manager.

    Example:
        The cube of `ContactProblem`, of rubber and squeezed to 60 %:

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
        u: the displacement [length].
        pairs: surfaces that may touch.
        units: names of the units of length and stress; None: none are shown.
        options: of the contact algorithm.
        newton: of Newton's method.
    """

    @collective(comm_of("u", "F", "bcs", "J"), but=("entity_maps",))
    def __init__(
        self,
        F: Any,
        u: fem.Function,
        pairs: Sequence[ContactPair],
        bcs: Sequence[Any] = (),
        J: Any = None,
        *,
        options: SolverOptions | None = None,
        newton: NewtonOptions | None = None,
        stiffness: StiffnessMethod = "auto",
        petsc_options: Mapping[str, Any] | None = None,
        petsc_options_prefix: str | None = None,
        units: Units | None = None,
        entity_maps: EntityMaps | None = None,
    ) -> None:
        """Factor the tangent of the undeformed bodies, and pair the surfaces. Collective.

        Args:
            F: residual form, what is internal less what is external; linear in its test function.
            u: displacement that it depends on; where the first solve starts.
            pairs: surfaces that may touch.
            bcs: Dirichlet conditions, of the whole displacement.
            J: derivative of F, symmetric; None: by `ufl.derivative`.
            options: of the contact algorithm; a residual of 1e-6 by default. Steps are solved as
                accurately as Newton's method asks for at least.
            newton: of Newton's method.
            stiffness: how to solve with the tangent; see `ContactProblem`.
            petsc_options: of the solver for it.
            petsc_options_prefix: of these options, for a command line.
            units: names of the units of length and stress.
            entity_maps: where forms hold Functions on surfaces; see `ContactProblem`.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: the tangent of the undeformed bodies is not symmetric, or is indefinite.
        """
        if not isinstance(F, ufl.Form):
            raise InputError(f"F must be a UFL form, found {shown(F)}.")
        if not isinstance(u, fem.Function) or u not in F.coefficients():
            raise InputError(
                f"u must be the Function that the form F depends on, found {shown(u)}. For linear "
                "bodies take ContactProblem."
            )
        found = len(F.arguments())
        if found != 1:
            raise InputError(
                f"F must be the residual form, with a test function and no other argument, found "
                f"{found}: of an energy it is ufl.derivative(energy, u, v)."
            )
        options = SolverOptions(rtol=1e-6) if options is None else options
        newton = NewtonOptions() if newton is None else newton
        _check_options(options, newton)
        self.u, self.newton = u, newton
        self._step = LinearisedProblem(
            F,
            u,
            ufl.derivative(F, u) if J is None else J,
            pairs=pairs,
            bcs=bcs,
            options=options,
            stiffness=stiffness,
            petsc_options=petsc_options,
            petsc_options_prefix=petsc_options_prefix,
            units=units,
            entity_maps=entity_maps,
        )
        self.pairs, self.units = self._step.pairs, units
        self.options = options
        self._solves = 0
        self._level = 0

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self._step.comm

    @property
    def free_dofs(self) -> int:
        """n, the degrees of freedom of all ranks that are not prescribed. Not collective."""
        return self._step.free_dofs

    @property
    def contact_nodes(self) -> int:
        """m, the nodes of all pairs and ranks that carry multipliers. Not collective."""
        return self._step.contact_nodes

    @property
    def prescribed(self) -> Mask:
        """(owned degrees of freedom,) those that `bcs` prescribe: no contact force moves them."""
        return self._step.prescribed

    @property
    def operators(self) -> tuple[ContactOperators, ...]:
        """N, T, gap and areas of each pair, for the whole displacement: see `ContactOperators`."""
        return self._step.operators

    accept = _of_each_step(ContactProblem.accept)
    forget = _of_each_step(ContactProblem.forget)
    set_slip_origin = _of_each_step(ContactProblem.set_slip_origin)
    start_from = _of_each_step(ContactProblem.start_from)
    save_state = _of_each_step(ContactProblem.save_state)
    load_state = _of_each_step(ContactProblem.load_state)

    def _rows(self) -> list[Row]:
        return self._step._rows()

    def __repr__(self) -> str:
        return f"<NonlinearContactProblem: {repr(self._step)[len('<ContactProblem: ') :]}"

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._step.destroy()

    @collective(comm_of_self)
    def update_geometry(self, u: fem.Function | None = None) -> None:
        """Pair the surfaces where the present displacement has brought them. Collective.

        See `ContactProblem.update_geometry`.

        Args:
            u: another displacement [length].

        Raises:
            InputError: it is no displacement of the problem.
            PairingError: the moved surfaces cannot be paired; the problem stays as it was.
            StiffnessError: a solve with the tangent failed.
        """
        self._step.update_geometry(self.u if u is None else u)

    @collective(comm_of_self, but=("observer",), also=_options)
    def solve(
        self,
        *,
        observer: Observer | None = None,
        options: SolverOptions | None = None,
        newton: NewtonOptions | None = None,
    ) -> NonlinearContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        Args:
            observer: called before each iteration of each contact problem; see
                `ContactProblem.solve`.
            options: in place of the problem's.
            newton: in place of the problem's.

        Returns:
            the solution, which `u` has too; look at its `status`, or call its `raise_if_failed()`.
            Where that is NO_EQUILIBRIUM it is the solution for a part of the change of load; if
            there is none, that of the last step, and `u` is what it was.

        Raises:
            ContactError: the problem was destroyed.
            InputError: an option, a load, a prescribed value or a slip bound is wrong, or `u` has
                values that are NaN or infinite; or nothing holds a body against its loads.
            StiffnessError: there is no way on from `u`: the tangent there is not symmetric, not
                finite, or indefinite whatever is added.
        """
        options = self.options if options is None else options
        newton = self.newton if newton is None else newton
        _check_options(options, newton)
        self._step.begin()
        self._solves += 1
        run = Newton(self._step, newton, options, observer, self._level)
        run.run()
        if run.found is None:
            raise StiffnessError(
                f"{run.failure}. This is at the displacement u that the solve starts from: begin "
                "at another one, such as zero."
            )
        self._level, found = run.level, run.found
        status, message = found.status, ""
        if run.fraction < 1.0:
            status = ContactStatus.STOPPED if run.stopped else ContactStatus.NO_EQUILIBRIUM
            self._step.end_with(status)
            message = (
                f"solve number {self._solves} came to {run.fraction:.4g} of its change of load: "
                f"{run.failure}. Take smaller load steps, or allow smaller parts and more steps by "
                "NewtonOptions(max_halvings=..., max_iterations=...). See where `u` is going: what "
                "snaps through, buckles or creases has no equilibrium near by; free faces by a "
                "sharp edge of the contact fold the sooner the finer the mesh (take a coarser one "
                "there); cells that are squeezed flat need another mesh."
            )
        values = {field.name: getattr(found, field.name) for field in dataclasses.fields(found)}
        values |= {
            "status": status,
            "iterations": sum(one.iterations for one in run.steps),
            "products": sum(one.products for one in run.steps),
            "krylov_iterations": run.krylov_iterations,
            "timings": run.timings,
            "newton": NewtonRecord(tuple(run.steps), run.fraction, message),
        }
        return NonlinearContactSolution(**values)
