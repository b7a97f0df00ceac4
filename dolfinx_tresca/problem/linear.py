"""The contact problem of linear elastic bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of, comm_of_self
from dolfinx_tresca._base.arguments import checked_number
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import agreed_observer, warn
from dolfinx_tresca._base.petsc import destroyed_on_error
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.contact.finite_sliding import solve_with_finite_sliding
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.derivatives.goals import GoalError, goal_error
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.derivatives.tape import ProcessTape
from dolfinx_tresca.errors import ContactError, InputError
from dolfinx_tresca.guaranteed import bound
from dolfinx_tresca.guaranteed.bound import GAIN, GuaranteedError, GuaranteedGoal
from dolfinx_tresca.monitor import Observer
from dolfinx_tresca.options import Accuracy, Method, SolverOptions
from dolfinx_tresca.problem.process import ContactProcess, problem_to_agree
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.pair import ContactForce, ContactPair, Goal, NormalForce, checked_goal
from dolfinx_tresca.solvers.convergence import SMALLEST_TOLERANCE
from dolfinx_tresca.stiffness.choice import SolverRequest, StiffnessMethod
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.table import Units


class ContactProblem(ContactProcess):
    """Linear elastic bodies in contact, with or without friction (docs/theory/problem.md).

    Forms and slip bounds may contain `fem.Constant` and `fem.Function`: change these in place, and
    the next `solve()` uses the new values. K is assembled and factored once. After a change of
    coefficients of the form `a`, call `update_stiffness()`; until then, solves use the K that was
    factored last, and the log warns. Each solve starts from the multipliers of the last solve (with
    Coulomb friction, from those of the last accepted step, if there is one), and uses the products
    with the compliance A of earlier solves as long as neither K nor the pairing changes. The set of
    degrees of freedom that `bcs` prescribe is fixed, but their values may change.

    Friction resists the total slip, measured from the undeformed state: this is the law of a single
    static load. For a sequence of loads, call `accept()` after each `solve()`. Friction then
    resists the slip since the last accepted step, and slip remains when the loads are removed.

    A problem owns PETSc objects: call `destroy()`, or use the problem as a context manager. If the
    problem is not destroyed, its PETSc objects are freed later: on one rank when Python frees the
    problem, on several ranks when a problem on the same mesh is then made, solved or destroyed.

    Attributes:
        pairs: surfaces that may touch.
        options: options of the contact algorithm for the solves that follow.
        units: names of the units of length and stress; None: no units are shown.

    Example:
        A cube of 1 mm is pressed on a rigid floor by 1 µm; its Poisson's ratio is zero.

        >>> from mpi4py import MPI
        >>> import numpy as np
        >>> import ufl
        >>> from dolfinx import fem, mesh
        >>> from dolfinx_tresca import ContactPair, ContactProblem, RigidPlane, Tresca, Units
        >>> cube = mesh.create_unit_cube(MPI.COMM_WORLD, 3, 3, 3)
        >>> bottom = mesh.locate_entities_boundary(cube, 2, lambda x: x[2] < 1e-9)
        >>> top = mesh.locate_entities_boundary(cube, 2, lambda x: x[2] > 1 - 1e-9)
        >>> facet_tags = mesh.meshtags(cube, 2, bottom, np.full(len(bottom), 7, dtype=np.int32))
        >>> V = fem.functionspace(cube, ("Lagrange", 1, (3,)))
        >>> u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        >>> a = 1000.0 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
        >>> L = ufl.inner(fem.Constant(cube, np.zeros(3)), v) * ufl.dx
        >>> pressed = fem.locate_dofs_topological(V, 2, top)
        >>> bcs = [fem.dirichletbc(np.array([0.0, 0.0, -1e-3]), pressed, V)]
        >>> floor = RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
        >>> pair = ContactPair(facet_tags, secondary=7, primary=floor, friction=Tresca(0.1))
        >>> problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("mm", "MPa", force="N"))
        >>> problem
        <ContactProblem: 192 displacements, 16 contact nodes in 1 pair(s), cholesky>
        >>> solution = problem.solve()
        >>> solution.raise_if_failed()
        >>> f"{solution.peak_pressure:.2f} MPa"
        '1.00 MPa'
    """

    @collective(comm_of("V", "L", "a", "bcs"), ignored=("entity_maps",))
    def __init__(
        self,
        a: Any,
        L: Any | None,
        pairs: Sequence[ContactPair],
        bcs: Sequence[Any] = (),
        *,
        options: SolverOptions | None = None,
        stiffness: StiffnessMethod = "auto",
        expected_solves: int = 1,
        petsc_options: Mapping[str, Any] | None = None,
        petsc_options_prefix: str | None = None,
        units: Units | None = None,
        entity_maps: EntityMaps | None = None,
        V: Any = None,
        axisymmetric: bool = False,
    ) -> None:
        """Assemble and factor K, and pair the surfaces. Collective.

        Args:
            a: bilinear form, symmetric and, with `bcs`, positive definite except for rigid motions
                of bodies that contact holds. Its arguments are in a vector space of degree 1 or 2,
                in 3D or in 2D (plane strain; a meridian with `axisymmetric`), or in a mixed space
                with such a component: then K is a saddle point, and Dirichlet conditions must hold
                the bodies (see the guide on embedding). If V is given, `a` may also be a compiled
                form, or a `PETSc.Mat` that was assembled without conditions. For a mixed space, a
                compiled form or a matrix, the discretisation error is unknown: solve with a number
                as `accuracy`, or with `rtol`.
            L: linear form of the loads, in UFL or compiled; None: no load.
            pairs: surfaces that may touch.
            bcs: Dirichlet conditions.
            options: options of the contact algorithm; `solve()` can change them for one solve.
            stiffness: how to solve with K: "cholesky", "multigrid" (for large models), or "auto".
            expected_solves: approximate number of calls of `solve()` before K changes. The larger
                it is, the sooner "auto" takes "cholesky", whose further solves are cheaper.
            petsc_options: PETSc options of the solver for K, which take precedence over the
                defaults. For degree 2, the options of the GAMG solver on the level of degree 1
                begin with "mg_coarse_"; options without this prefix hold for that level as well.
            petsc_options_prefix: prefix of the options that the command line gives to this solver.
            units: names of the units of length and stress, for tables and pictures.
            entity_maps: the argument of `dolfinx.fem.form` that forms need if they contain
                Functions on the mesh of a surface: take `SurfaceFields.entity_maps`.
            V: the space of the displacement. It is needed if `a` is not a form of UFL, and for a
                mixed space W with several vector components: a sub-space such as W.sub(0).
            axisymmetric: whether the mesh is the meridian of bodies of revolution: x[0] is the
                radius, x[1] is along the axis, and the integrands of the forms have the factor
                2 pi x[0]. Contact forces, areas and energies are then those of the whole rings.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite; or contact and `bcs` enclose an
                incompressible body of a mixed space on all sides.
        """
        super().__init__(pairs, SolverOptions() if options is None else options, units)
        request = SolverRequest(stiffness, petsc_options, petsc_options_prefix, expected_solves)
        linear = LinearSystem(a, L, bcs, entity_maps, V, axisymmetric)
        with destroyed_on_error(linear):
            self._take(ContactSystem(linear, self.pairs, request))

    @property
    def stiffness(self) -> PETSc.Mat:
        """The stiffness matrix K as assembled last. It belongs to the problem: change a copy.

        Rows and columns of prescribed degrees of freedom are those of the identity.

        Raises:
            ContactError: the problem was destroyed.
        """
        self._contact.check_not_destroyed()
        return self._contact.linear.K

    @property
    def load(self) -> PETSc.Vec:
        """The present right-hand side f [force] that belongs to `stiffness`. Collective.

        Rows of prescribed degrees of freedom hold the prescribed values [length]; the forces that
        these values cause are in the other rows. The next access and the next solve overwrite f.

        Raises:
            ContactError: the problem was destroyed.
        """
        self._contact.check_not_destroyed()
        self._contact.linear.assemble_load()
        return self._contact.linear.f.x.petsc_vec

    @collective(comm_of_self, extra_values=problem_to_agree)
    def update_stiffness(self) -> None:
        """Assemble and factor K again, after a change of coefficients of the form `a`. Collective.

        Slip, accepted steps and multipliers are kept; products with A are dropped.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
            ContactError: the problem was destroyed.
        """
        self._contact.check_not_destroyed()
        self._contact.update_stiffness()

    @collective(comm_of_self, ignored=("observer",), extra_values=problem_to_agree)
    def solve(
        self,
        *,
        observer: Observer | None = None,
        method: Method | None = None,
        accuracy: Accuracy | None = None,
        local_accuracy: float | None = None,
        mesh_part: float | None = None,
        rtol: float | None = None,
        max_iterations: int | None = None,
        rho_sigma: float | None = None,
        r_tol: float | None = None,
        c_fact: float | None = None,
        geometry_accuracy: float | None = None,
    ) -> ContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        The `observer` is called before each iteration, on the ranks that give it; see
        `dolfinx_tresca.ProgressBar`. The solve stops if it returns True on any rank. All other
        arguments are fields of `SolverOptions`, which explains them. They replace the fields of the
        problem's `options` in this solve; an `accuracy` also replaces an `rtol` of theirs.

        Returns:
            the solution; check its `status`, or call its `raise_if_failed()`.

        Raises:
            ContactError: the problem was destroyed, or its last `update_stiffness` failed.
            InputError: an option, a load, a prescribed value or a slip bound is wrong; or nothing
                holds a body against its loads (the message names the body and its motion).
            StiffnessError: a solve with K failed.
        """
        options = self.options.with_changes(
            method=method,
            accuracy=accuracy,
            local_accuracy=local_accuracy,
            mesh_part=mesh_part,
            rtol=rtol,
            max_iterations=max_iterations,
            rho_sigma=rho_sigma,
            r_tol=r_tol,
            c_fact=c_fact,
            geometry_accuracy=geometry_accuracy,
        )
        observe = agreed_observer(self.comm, observer, "an Iteration, such as a ProgressBar")
        contact = self._contact
        contact.begin_solve()
        solve = solve_with_finite_sliding if contact.slides_far else ContactSystem.solve
        solution = contact.checked(solve(contact, options, self.units, observe))
        if contact.linear.outdated:
            warn(
                self.comm,
                "coefficients of the form a have changed since K was factored: this solution is "
                "for the earlier values, until update_stiffness() is called",
            )
        return solution

    @collective(comm_of_self)
    def goal_error(self, goal: Goal) -> GoalError:
        """Return the value of a goal in the last solution, with an error estimate. Collective.

        The estimate keeps the contact state of each node, since changes of states are of second
        order in the error of the displacement: if all nodes stick, the mean slip and its estimated
        error are zero. The error of a mesh that approximates curved boundaries without contact is
        not included. The estimate costs about ten products with A, which later solves use, too.

        Args:
            goal: a `NormalForce`, `ContactForce`, `MeanPressure`, `MeanSlip` or `PressureNorm`.

        Raises:
            ContactError: nothing was solved since the problem changed.
            InputError: the goal is wrong; `a` is no UFL form, or is on a mixed space; friction
                depends on the slip; or forces hold obstacles, or preloads hold bolts.
            ConvergenceError: with the contact state kept, rigid motions of bodies change the goal.
        """
        goal = checked_goal(goal, len(self.pairs), self.mesh.geometry.dim)
        solved = self._solved_for("the error of a goal")
        dual, fields = solved.dual, solved.fields
        energy_error = fields.energy_error_bound * dual.norm_of(fields.deformation)
        # slip bounds, here (), are read for derivatives by places of obstacles alone
        linearised = LinearisedContact(dual, solved.multipliers, fields.deformation, ())
        return goal_error(goal, linearised, fields.u, energy_error)

    @collective(comm_of_self)
    def guaranteed_error(self, *, gain: float = GAIN) -> GuaranteedError:
        """Return a guaranteed bound of the whole error of the last solution. Collective.

        The bound covers the iteration, the mesh and contact. It is for triangles and tetrahedra,
        displacements of degree 1 or 2, stiffnesses that are constant in each cell, and contact with
        rigid planes, or (degree 1) of bodies whose meshes match on flat surfaces. Each body needs
        Dirichlet conditions that hold it. See `GuaranteedError` for what the exact solution is, and
        docs/theory/guaranteed.md for the proof. It costs a solve with K, and small local problems.

        Args:
            gain: the bound is made sharper step by step, until a step lowers it by less than this
                fraction. Each step costs some percent of the time.

        Raises:
            ContactError: nothing was solved since the problem changed, the last solve did not
                converge, or the displacement is not in equilibrium.
            InputError: the bound does not cover the problem.

        Example:
            With the cube in the example of `ContactProblem`, whose stress is uniform:

            >>> solution = problem.solve(rtol=1e-10)
            >>> problem.guaranteed_error().relative_error < 1e-6
            True
        """
        bodies, solved, gain = self._checked_for_bounds(gain)
        return bodies.error(solved.dual, solved.multipliers, solved.fields.u, gain)

    @collective(comm_of_self)
    def guaranteed_goal(
        self, goal: NormalForce | ContactForce | ufl.Form, *, gain: float = GAIN
    ) -> GuaranteedGoal:
        """Return proven bounds from both sides of a goal in the exact solution. Collective.

        For problems and exact solutions as in `guaranteed_error`, without friction that depends on
        the pressure. Eight further problems are solved, with the load plus and minus multiples of
        the goal (docs/theory/guaranteed.md). Where contact does not change with the
        load, the width of the interval is about the product of the errors of the displacement and
        of the goal's adjoint; where contact changes, the interval is wider.

        Args:
            goal: a `NormalForce`, a `ContactForce`, or a linear form of UFL, such as
                `ufl.TestFunction(V)[0] * ds(7)` for the integral of a displacement. A force is the
                integral of tractions times a weight, which is 1 at contact nodes, zero where the
                displacement is prescribed, and linear (degree 2: quadratic) between nodes.
            gain: see `guaranteed_error`.

        Raises:
            ContactError: as `guaranteed_error`.
            InputError: the goal is wrong, or the bounds do not cover the problem.

        Example:
            With the cube in the example of `ContactProblem`, whose stress is uniform:

            >>> from dolfinx_tresca import NormalForce
            >>> solution = problem.solve(rtol=1e-10)
            >>> bounds = problem.guaranteed_goal(NormalForce())
            >>> bounds.upper - bounds.lower < 1e-6 * bounds.value
            True
        """
        bodies, solved, gain = self._checked_for_bounds(gain)
        contact, linear = self._contact, self._contact.linear
        functional = bound.Functional(goal, bodies, solved.dual)
        u = solved.fields.u
        size = solved.dual.norm_of(u) or self.guaranteed_error(gain=gain).error
        multiple = fem.Constant(self.mesh, 0.0)
        _, L = linear.ufl_forms
        load = multiple * functional.form if L is None else L + multiple * functional.form
        # the bounds are differences of these solves, divided by the multiple of the goal
        options = self.options.with_changes(rtol=SMALLEST_TOLERANCE)

        def candidate(t: float) -> bound.Candidate:
            multiple.value = t
            contact.solve(options, self.units, lambda iteration: False)
            # the bound holds for any multipliers, converged or not
            loaded = contact.solution_for("a guaranteed bound")
            given = bodies.load + t * functional.load
            return bodies.candidate(loaded.dual, loaded.multipliers, loaded.fields.u, given)

        with contact.restored(), linear.loaded(load):
            return functional.interval(u, size, candidate, gain)

    def _checked_for_bounds(self, gain: Any) -> tuple[bound.Bodies, StepSolution, float]:
        """Return bodies, last solution and gain, all checked for guaranteed bounds. Collective."""
        contact, solved = self._contact, self._solved_for("a guaranteed bound")
        contact.check_inputs("a guaranteed bound")
        gain, state = checked_number("gain", gain, "(0, inf]"), contact.state
        displaced = any(w.x.array.any() for w in (state.geometry, state.configuration))
        if contact.slides_far or self.comm.allreduce(displaced, op=MPI.LOR):
            raise InputError(
                "a guaranteed bound needs surfaces that are paired where they are undeformed: take "
                "sliding='small', and do not call update_geometry()."
            )
        return bound.Bodies(contact.linear, solved.dual), solved, gain

    @contextmanager
    def record(self) -> Iterator[ProcessTape]:
        """Record the load steps accepted inside the block, for derivatives through all of them.

        Not collective; each recorded `accept()` is collective, and assembles the load once more to
        check that nothing has changed since the solve.

        Example:
            `with problem.record() as tape:`, then `solve()` and `accept()` for each step, and
            `tape.gradient({9: ContactForce((1.0, 0.0))}, [coefficient])` for the tenth step.

        Raises:
            ContactError: the problem records already.
            InputError: `a` or `L` is no form of UFL, or a pair has finite sliding.
        """
        self._contact.check_not_destroyed()
        self._check_pairing_fixed()
        if self._tape is not None:
            raise ContactError("the problem records its load steps already.")
        self._tape = tape = ProcessTape(self._contact, self._solved_for, self._residual_at)
        try:
            yield tape
        finally:
            self._tape = None

    def _solved_for(self, purpose: str) -> StepSolution:
        solved, linear = super()._solved_for(purpose), self._contact.linear
        if linear.form is None:
            raise InputError(f"{purpose} needs a form of UFL, and a is none. Give the form.")
        if linear.outdated:
            raise ContactError(
                f"coefficients of a have changed since the solution that {purpose} is for: call "
                "update_stiffness() and solve()."
            )
        return solved

    def _residual_at(self, u: fem.Function) -> ufl.Form:
        a, L = self._contact.linear.ufl_forms
        return ufl.action(a, u) if L is None else ufl.action(a, u) - L
