"""The contact problem: wires forms, pairs and solver together."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from petsc4py import PETSc

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of, comm_of_self
from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.number import integer
from dolfinx_tresca._base.observers import agreed_observer
from dolfinx_tresca._base.owner import PetscOwner, destroyed_on_error, free_unused
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca._base.timing import largest, timed
from dolfinx_tresca.dual.compliance import ContactCompliance
from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.load_steps import LoadSteps
from dolfinx_tresca.dual.moved import moved_jump
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.saved_displacement import read_displacements
from dolfinx_tresca.dual.slip_bounds import NodalBounds, SlipBounds
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.floating.bodies import find_bodies
from dolfinx_tresca.floating.fixing import fixing_springs
from dolfinx_tresca.monitor import Observer
from dolfinx_tresca.optimise import methods
from dolfinx_tresca.options import SLACK, Accuracy, Method, SolverOptions
from dolfinx_tresca.output.summary import ProblemSummary
from dolfinx_tresca.output.table import Row, Tabulated
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.goal import Goal, checked_goal
from dolfinx_tresca.scene.pair import ContactPair, checked_pairs
from dolfinx_tresca.solution.evaluation import Evaluation, evaluate
from dolfinx_tresca.solution.fields import Surface
from dolfinx_tresca.solution.goal_error import GoalError, goal_error
from dolfinx_tresca.solution.hints import hint_at_displacement, hint_at_scene
from dolfinx_tresca.solution.sliding import Sliding
from dolfinx_tresca.solution.transfer import slip_from, stress_from
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.choice import StiffnessMethod, check_choice, choose, solver_for
from dolfinx_tresca.stiffness.nested import is_nested
from dolfinx_tresca.stiffness.solver import check_options
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.units import Units


def _space(problem: ContactProblem) -> dict[str, Any]:
    """Return the space that a displacement must live on. Not collective."""
    return {"the space of the problem": problem._system.V}


def _present(problem: ContactProblem) -> dict[str, Any]:
    """Return what a solve depends on beside its arguments. Not collective."""
    return {
        "options of the problem": problem.options,
        "pairs": problem.pairs,
        **problem._system.values_to_agree(),
    }


class ContactProblem(PetscOwner, Tabulated):
    """Elastic bodies in contact, with friction or without: (38.1) to (38.3).

    Forms and slip bounds may hold `fem.Constant` and `fem.Function`: change them in place, and the
    next `solve()` sees the new values. K is assembled and factored once; after a change of what
    the form `a` depends on call `update_stiffness()`: until then solutions are those for the K that
    was factored last, also where values are prescribed, and the log warns. Each solve starts from
    the last one's multipliers and keeps its products with A. Which degrees of freedom `bcs`
    prescribe is fixed; their values may change.

    Friction resists the total slip, from the undeformed state on: the law of a single static load.
    For a process call `accept()` after each `solve()`: then it resists the slip since the last
    accepted step, and what has slipped stays where it is when loads are taken away.

    Owns PETSc objects: call `destroy()`, or use it as a context manager. What nobody destroys goes
    with the last reference on one rank; on several when the next problem on the mesh is made.

    Attributes:
        pairs: surfaces that may touch.
        options: of the contact algorithm; those of the solves that follow.
        units: names of the units of length and stress; None: none are shown.

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

    @collective(comm_of("V", "L", "a", "bcs"), but=("entity_maps",))
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
    ) -> None:
        """Assemble and factor K, and pair the surfaces. Collective.

        Args:
            a: bilinear form, symmetric and, with `bcs`, positive definite, but for rigid motions of
                bodies that contact holds; arguments in a vector space of degree 1 or 2, in 3D or
                (plane strain) in 2D. In a mixed space with such a component K is a saddle point,
                of bodies that K holds: see the guide on embedding. Also, with V, a compiled form,
                or the `PETSc.Mat` of one without conditions. In both cases the error of the mesh
                is not known: solve with an `accuracy` or a `rtol`.
            L: linear form, or a compiled one; None: no load.
            pairs: surfaces that may touch.
            bcs: Dirichlet conditions.
            options: of the contact algorithm; can be changed for a single solve.
            stiffness: how to solve with K: "cholesky", "multigrid" (for large models), or "auto".
            expected_solves: how often `solve()` will be called before K changes, about: the more,
                the sooner "auto" takes "cholesky", whose further solves are cheaper.
            petsc_options: of the solver for K, on top of the defaults. For degree 2 those of GAMG,
                which has the level of degree 1, begin with "mg_coarse_"; without, they hold for it
                as well.
            petsc_options_prefix: of these options, for a command line.
            units: names of the units of length and stress, for what is printed and drawn.
            entity_maps: where forms hold Functions on surfaces, as `dolfinx.fem.form` takes them;
                `SurfaceFields.entity_maps` has that of a surface.
            V: the space of the displacement, where no form of UFL says it; of a mixed space W that
                has several vectors the one that touches, such as W.sub(0).

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite; or contact closes in a body that
                cannot change its volume.
        """
        if options is not None and not isinstance(options, SolverOptions):
            raise InputError(
                f"options must be SolverOptions(...), found {shown(options)}. Options of the "
                "solver for K go to petsc_options."
            )
        if units is not None and not isinstance(units, Units):
            raise InputError(f'units must be such as Units("mm", "MPa"), found {shown(units)}.')
        self.options = SolverOptions() if options is None else options
        self.units = units
        self.pairs = checked_pairs(pairs)
        petsc_options = {} if petsc_options is None else petsc_options
        check_options(petsc_options, petsc_options_prefix)
        self._petsc_options = dict(petsc_options)
        self._petsc_options_prefix = petsc_options_prefix
        self._setup_timings: dict[str, float] = {}
        self._warned = self._destroyed = self._moved_far = False
        self._operators: tuple[ContactOperators, ...] | None = None
        self._system = self._linear_system(a, L, bcs, entity_maps, V)
        V, comm = self._system.V, self._system.comm
        free_unused(comm)  # of earlier problems that nobody destroyed
        check_choice(stiffness, expected_solves, saddle=self._system.component is not None)
        self._stiffness_asked = stiffness, int(expected_solves)
        if comm.rank == 0:
            warn_of_slow_blas()
        try:
            with timed("pairing", self._setup_timings):
                prescribed = self._system.prescribed_displacements
                operators = [pair_surfaces(V, prescribed, pair) for pair in self.pairs]
                self._surfaces = [Surface.of(V, pair) for pair in self.pairs]
                self._slip_bounds = SlipBounds(V)
                for pair, on_nodes in zip(self.pairs, operators, strict=True):
                    self._slip_bounds.check(pair.friction, on_nodes.nodes)
            self._summary = ProblemSummary.of(self._system, self.pairs, operators)
            self._jump = JumpOperator(self._system, operators)
            self._guess = InitialGuess(self._jump)
            self._sliding = Sliding(V)
            self._steps = LoadSteps(self._jump)
            with destroyed_on_error(self._guess), destroyed_on_error(self._jump):
                self._compliance = self._factored()
                with destroyed_on_error(self._compliance):
                    rounding = self._compliance.stress_rounding
                    for pair, on_nodes in zip(self.pairs, operators, strict=True):
                        self._slip_bounds.check_numbers(pair.friction, on_nodes.nodes, rounding)
            hint_at_scene(V, self.pairs, operators, self._bodies)
        except ContactError:
            self._system.destroy()
            raise
        self.forget()

    def _linear_system(
        self, a: Any, L: Any, bcs: Sequence[Any], entity_maps: EntityMaps | None, V: Any
    ) -> LinearSystem:
        """Return K u = f; of a Newton step, f depends on K (`nonlinear`). Collective."""
        return LinearSystem(a, L, bcs, entity_maps, V)

    def _present_bounds(self) -> list[NodalBounds]:
        """Return the slip bounds at each pair's nodes, as they are now. Collective.

        Raises:
            InputError: one is wrong.
        """
        rounding = self._compliance.stress_rounding
        return [
            self._slip_bounds.at(pair.friction, operators.nodes, rounding)
            for pair, operators in zip(self.pairs, self._jump.pairs, strict=True)
        ]

    @property
    def free_dofs(self) -> int:
        """n, displacements of all ranks that are not prescribed. Not collective."""
        return self._summary.free_dofs

    @property
    def contact_nodes(self) -> int:
        """m, the nodes of all pairs and ranks that carry multipliers. Not collective."""
        return self._summary.contact_nodes

    def _rows(self) -> list[Row]:
        return [
            ("bodies", f"{self._bodies}"),
            *self._summary.rows(self.units),
            ("solver for K", str(self._compliance.operator.solver)),
            ("chosen", self._stiffness_reason),
            ("method", f"{self.options.method}, {self.options.target}"),
        ]

    def __repr__(self) -> str:
        return (
            f"<ContactProblem: {self._summary.dofs} displacements, {self.contact_nodes} contact "
            f"nodes in {len(self.pairs)} pair(s), {self._stiffness}>"
        )

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self._system.comm

    @property
    def mesh(self) -> Any:
        """That of all bodies, the displacement's."""
        return self._system.V.mesh

    @property
    def stiffness(self) -> PETSc.Mat:
        """K as it was assembled last, the problem's own: copy what is to be changed.

        Rows and columns of what is prescribed are those of the identity.
        """
        self._check_not_destroyed()
        return self._system.K

    @property
    def load(self) -> PETSc.Vec:
        """The right-hand side f [force] that belongs to `stiffness`, as it is now. Collective.

        It has prescribed values [length] where there are any, and elsewhere what they cause. The
        next call, and the next solve, overwrite it.
        """
        self._check_not_destroyed()
        self._system.assemble_load()
        return self._system.f.x.petsc_vec

    @property
    def prescribed(self) -> Mask:
        """(owned degrees of freedom,) those that `bcs` prescribe: no contact force moves them."""
        return self._system.prescribed

    @property
    def operators(self) -> tuple[ContactOperators, ...]:
        """N, T, gap and areas of each pair, for other solvers: see `ContactOperators`.

        Along the tangents of the last solve: bounds that are ellipses may turn them.
        """
        self._check_not_destroyed()
        if self._operators is None:
            pairs = self._jump.pairs
            part = self._system.component
            columns = () if part is None else (part.columns,)
            self._operators = tuple(
                ContactOperators(self._system.V, operators, pair, *columns)
                for operators, pair in zip(pairs, self.pairs, strict=True)
            )
        return self._operators

    def _drop_operators(self) -> None:
        for owner in self._operators or ():
            owner.destroy()
        self._operators = None

    def _check_not_destroyed(self) -> None:
        """Check that there are PETSc objects to work with. Not collective.

        Raises:
            ContactError: the problem was destroyed.
        """
        if self._destroyed:
            raise ContactError("the problem was destroyed: make it anew.")

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._destroyed = True
        self._drop_operators()
        for owner in (self._compliance, self._guess, self._jump, self._system):
            owner.destroy()

    def forget(self) -> None:
        """Drop multipliers and products of earlier solves: the next one starts from zero.

        What was accepted stays: the slip still counts from there. Not collective.
        """
        self._steps.forget()
        self._solved: tuple[DualProgram, Array, Evaluation] | None = None
        self._compliance.forget()

    @collective(comm_of_self)
    def accept(self, *, unconverged: bool = False) -> None:
        """Make the last solution a load step: the slip of the next ones counts from it.

        Friction dissipates, so that a process is more than its last load: after this each `solve()`
        minimises 1/2 u'K u - f'u + sum of g |T u - s|, where s is the slip T u of the last accepted
        step. A solution that is not accepted leaves no trace: try another load instead. Nodes that
        stick keep their s, so that what the iteration leaves there does not add up.

        Collective.

        Args:
            unconverged: whether to take a solution that missed what was asked for.

        Raises:
            ContactError: nothing was solved since the last step.
            ConvergenceError: the last solve failed.
        """
        self._steps.accept(unconverged)

    @collective(comm_of_self, also=_space)
    def set_slip_origin(self, u: fem.Function | None) -> None:
        """Begin load steps at a displacement: the slip of the next ones counts from its T u.

        To go on after a restart, or from a state that another program computed. Collective.

        Args:
            u: displacement [length] in the problem's space; None: as before the first step, slips
                are total.

        Raises:
            InputError: it is no Function of that space, or has values that are NaN or infinite.
        """
        self._check_not_destroyed()
        if u is not None:
            self._system.check_displacement("the slip origin", u, " or None,")
        self._steps.begin_at(u)

    @collective(comm_of_self, also=_space)
    def update_geometry(self, u: fem.Function) -> None:
        """Pair the surfaces again, where a displacement has brought them. Collective.

        The problem is one of small sliding: nodes keep their normals, and what they face. After
        this these are the ones at `u`, and so is the gap: d - N u is the distance of the moved
        surfaces, and stresses are forces over their areas. Where bodies slide far, call it after
        each of several solves of a load step, until forces stay what they are, and then accept the
        step; called once a step it leaves normals a step behind. Slip and load steps go on,
        multipliers are kept; products are not, but K is not factored again. Bonded pairs stay as
        they are.

        Args:
            u: displacement [length] in the problem's space, of a solution as a rule.

        Raises:
            InputError: it is no Function of that space, or has values that are NaN or infinite.
            PairingError: the moved surfaces cannot be paired; the problem stays as it was.
            StiffnessError: a solve with K failed.
        """
        self._check_not_destroyed()
        self._system.check_displacement("what the surfaces are moved by", u)
        before = self._jump
        jump = moved_jump(before, self.pairs, u)
        self._steps.move(jump, u)
        self._guess.forget()
        self._compliance = self._compliance.on(jump)
        self._jump = jump
        self._solved = None
        self._drop_operators()
        before.destroy()
        self._summary = ProblemSummary.of(self._system, self.pairs, jump.pairs)
        self._sliding.begin(u)

    @collective(comm_of_self)
    def start_from(self, solution: ContactSolution, *, accepted: bool = False) -> None:
        """Let the next solve start from the tractions of a solution on another mesh. Collective.

        It is as accurate as from any other start, but needs fewer iterations the nearer that is.
        The u of nonlinear bodies stays where it is: interpolate that, too.

        Args:
            solution: with as many pairs; a point of each surface starts from what is nearest on
                the other's, and from zero where there is nothing near.
            accepted: whether the solution is a load step, which this problem goes on from: slips
                count from its slip, which is interpolated, and its dissipation is added to what
                follows; as `accept()` does on the same mesh.

        Raises:
            InputError: it has another number of pairs, or lives in another dimension.
            ConvergenceError: it is to be accepted, but did not converge.
        """
        dim = self._system.V.mesh.geometry.dim
        if (
            not isinstance(solution, ContactSolution)
            or len(solution.surfaces) != len(self.pairs)
            or solution.surfaces[0].mesh.geometry.dim != dim
        ):
            raise InputError(
                f"to start from is a ContactSolution with {len(self.pairs)} pair(s) in {dim}D, "
                f"found {shown(solution)}."
            )
        if accepted:
            solution.raise_if_failed()
            slip = slip_from(solution.surfaces, self._jump) / self._jump.length_scale
            self._steps.begin(SlipHistory(slip, solution.total_dissipation, begun=True))
        self._steps.start_at(stress_from(solution.surfaces, self._jump))
        self._compliance.expect_start()

    @collective(comm_of_self, but=("path",))
    def save_state(self, path: str | Path, *, step: int = 0) -> None:
        """Write what the next solve starts from, for `load_state` in another run. Collective.

        Multipliers, and the slip of accepted steps with what they dissipated; u where bodies are
        nonlinear, and the one of the last `update_geometry`. Not the loads, and not the products,
        of which a restart costs those of a first solve. After an interruption in the middle of
        writing the file is what it was before.

        Args:
            path: of the file; the first rank's counts.
            step: a number to have back, such as that of the load step.

        Raises:
            InputError: it cannot be written, or the step is no integer.
        """
        number = integer(step)
        if number is None:
            raise InputError(f"step must be an integer, such as 3, found {shown(step)}.")
        self._steps.save(path, number, self._sliding.moved_by)

    @collective(comm_of_self, but=("path",))
    def load_state(self, path: str | Path) -> int:
        """Start the next solve from what `save_state` wrote, on any number of ranks. Collective.

        With the loads of the next step the process goes on as if it had not been interrupted, but
        for the products of a first solve. Surfaces are paired where they were paired then.

        Args:
            path: of the file, of a problem on the same mesh with the same pairs.

        Returns:
            the number that was saved with it.

        Raises:
            InputError: it cannot be read, or is of another mesh, of other pairs, or of laws of
                another kind: with friction, without, bonded.
        """
        path = Path(self.comm.bcast(str(path)))
        found = read_displacements(path, self._system.V, ("u", "moved_by"))
        before = self._sliding.origin.copy()
        moved_by = found.get("moved_by", fem.Function(self._system.V))
        moves = not self._sliding.began_at(moved_by)
        if moves:
            self.update_geometry(moved_by)
        try:
            step = self._steps.load(path, found.get("u"))
        except InputError:
            if moves:
                self.update_geometry(before)
            raise
        self._compliance.expect_start()
        return step

    @collective(comm_of_self, also=_present)
    def update_stiffness(self) -> None:
        """Assemble and factor K again, after a change of what the form `a` depends on. Collective.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
        """
        self._check_not_destroyed()
        self._solved = None
        self._compliance.destroy()
        self._compliance = self._factored(self._compliance)

    @collective(comm_of_self, but=("observer",), also=_present)
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
    ) -> ContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        All arguments but the observer are fields of `SolverOptions`, which says what they mean; for
        this solve they stand in for those of the problem's `options`.

        Args:
            observer: called before each iteration on the ranks that give one; see
                `dolfinx_tresca.ProgressBar`. Where it returns True the solve stops.
            method: the algorithm.
            accuracy: wanted bound of the relative energy error; a `rtol` of the problem's `options`
                does not count then.
            local_accuracy: of `accuracy="balanced"`.
            mesh_part: of `accuracy="balanced"`.
            rtol: wanted residual.
            max_iterations: of the outer iteration.
            rho_sigma: step length.
            r_tol: inner accuracy.
            c_fact: decrease of the inner tolerance.

        Returns:
            the solution; look at its `status`, or call its `raise_if_failed()`.

        Raises:
            ContactError: the problem was destroyed, or its last `update_stiffness` failed.
            InputError: an option, a load, a prescribed value or a slip bound is wrong; or nothing
                holds a body, which is named with its motion, against its loads.
            StiffnessError: a solve with K failed.
        """
        options = self.options.but(
            method=method,
            accuracy=accuracy,
            local_accuracy=local_accuracy,
            mesh_part=mesh_part,
            rtol=rtol,
            max_iterations=max_iterations,
            rho_sigma=rho_sigma,
            r_tol=r_tol,
            c_fact=c_fact,
        )
        self._check_method(options)
        self._compliance.operator.solver.check_ready()
        system = self._system
        timings, self._setup_timings = self._setup_timings, {}
        self._steps.last = self._solved = None
        observe = agreed_observer(self.comm, observer, "an Iteration, such as a ProgressBar")
        self._warn_if_outdated()
        with timed("load", timings):
            system.assemble_load()
            bounds = self._present_bounds()
            self._turn(bounds)
            operator = self._compliance.operator
            products, krylov = operator.products, operator.solver.krylov_iterations
            dual = DualProgram.of(self._compliance, self._guess, bounds, self._steps.history)
        with timed("iteration", timings):
            found = methods.solve(dual, self._steps.multipliers, options, observe)
        self._steps.multipliers = found.multipliers
        with timed("fields", timings):
            evaluation, history = evaluate(
                dual, self._surfaces, self._bodies, found, estimate=options.balanced
            )
        status = found.status
        if (
            status is ContactStatus.CONVERGED
            and evaluation.energy_error_bound > SLACK * found.wanted
        ):
            status = ContactStatus.STAGNATED  # what is returned is not what was judged
        sliding = ""
        if found.deficit is not None and dual.equilibrium is not None:
            sliding = dual.equilibrium.explain(found.deficit)
        self._steps.last = status, history
        self._moved_far = self._moved_far or hint_at_displacement(evaluation.u)
        if status is ContactStatus.CONVERGED:
            self._sliding.warn(self._jump, self.pairs, evaluation.u, found.multipliers)
        self._solved = dual, found.multipliers, evaluation
        log(
            system.comm,
            "%s: %s after %d iterations, %d products, residual %.2e",
            *(options.method, status.value, found.iterations, operator.products - products),
            found.residuals[-1],
        )
        return ContactSolution(
            status=status,
            options=options,
            units=self.units,
            iterations=found.iterations,
            sweeps=found.sweeps,
            products=operator.products - products,
            krylov_iterations=operator.solver.krylov_iterations - krylov,
            residuals=found.residuals,
            q=found.q,
            timings=largest(system.comm, timings),
            sliding=sliding,
            **vars(evaluation),
        )

    @collective(comm_of_self)
    def goal_error(self, goal: Goal) -> GoalError:
        """Return a number of the last solution, and how far the mesh lets it be off. Collective.

        The estimate takes the contact state of each node as it is, which is right to first order:
        of the slip where all nodes stick it says that it is zero, within zero. It sees what
        elements leave of the displacement, not what straight edges leave of the shape of a curved
        body: gaps know of their height, but where nothing touches they count as they are. Costs
        some ten products with A, which later solves use too.

        Args:
            goal: a `NormalForce`, `ContactForce`, `MeanPressure` or `MeanSlip`.

        Raises:
            ContactError: nothing was solved since the last change.
            InputError: the goal is wrong, or `a` is no form of UFL, or that of a mixed space.
            ConvergenceError: with the contact state held the number depends on nothing that holds
                the bodies.
        """
        self._check_not_destroyed()
        goal = checked_goal(goal, len(self.pairs), self._system.V.mesh.geometry.dim)
        if self._system.component is not None:
            raise InputError(
                "goals need the form a of the displacement alone, and not that of a mixed space: "
                "compare two meshes."
            )
        if self._system.form is None:
            raise InputError(
                "the error of a goal is estimated with a form of UFL, and a is none. Give the form."
            )
        if self._solved is None:
            raise ContactError("there is no solution whose error to estimate: call solve() first.")
        dual, multipliers, found = self._solved
        energy_error = found.energy_error_bound * dual.norm_of(found.u)
        return goal_error(goal, dual, multipliers, found.u, energy_error)

    def _turn(self, bounds: Sequence[NodalBounds]) -> None:
        """Take another B where bounds have other axes than in the last solve. Collective.

        Products are dropped then.

        Raises:
            InputError: the direction of two bounds is none in the surface.
        """
        before, jump = self._jump, self._jump.along_axes(bounds)
        if jump is not before:
            self._steps.turn(jump)
            self._guess.forget()
            self._compliance = self._compliance.on(jump)
            self._jump = jump
            self._drop_operators()
            before.destroy()

    def _warn_if_outdated(self) -> None:
        """Log, once for each K, that the form `a` has other coefficients by now. Collective."""
        if not self._warned and self._system.outdated:
            self._warned = True
            log(
                self.comm,
                "coefficients of the form a have changed since K was factored, and count for "
                "nothing until update_stiffness() is called: this solution is for those of then",
                level=logging.WARNING,
            )

    def _factored(self, before: ContactCompliance | None = None) -> ContactCompliance:
        """Assemble K, see what holds the bodies, and set the solver for K up. Collective."""
        system, timings = self._system, self._setup_timings
        with timed("stiffness", timings):
            system.assemble_stiffness()
            self._warned = False
            self._bodies = find_bodies(system)
        if before is None:
            self._stiffness, self._stiffness_reason = self._chosen_stiffness()
        springs = fixing_springs(self._bodies.rigid_modes, system)
        K = springs.added_to(system.K) if springs else system.K
        try:
            with timed(self._stiffness, timings):
                solver = solver_for(
                    self._stiffness, K, system, self._petsc_options, self._petsc_options_prefix
                )
        finally:
            if springs:
                K.destroy()  # the solver has a reference of its own
        with timed(self._stiffness, timings):  # of a saddle point it factors another matrix
            return ContactCompliance(self._jump, solver, springs, before)

    def _chosen_stiffness(self) -> tuple[Literal["cholesky", "multigrid"], str]:
        """Return the solver for K that suits these bodies, and why. Not collective."""
        method, expected_solves = self._stiffness_asked
        V = self._system.V
        dim = V.dofmap.index_map_bs
        return choose(
            method,
            dim * self._bodies.mean_nodes,
            dim,
            V.element.basix_element.degree,
            expected_solves,
            self.comm,
            saddle=self._system.component is not None,
            refined=is_nested(V),
        )

    def _check_method(self, options: SolverOptions) -> None:
        """Check that the method can do with bodies that float, and with the form. Not collective.

        Raises:
            InputError: it cannot.
        """
        system = self._system
        if options.balanced and not system.form_of_displacement:
            found = "a is none" if system.form is None else "a is on a mixed space"
            raise InputError(
                'accuracy="balanced", the default, takes the error of the mesh as a measure, which '
                f"is estimated with a form of UFL of the displacement, and {found}. Give "
                "solve(accuracy=1e-3), or a rtol."
            )
        if options.method != "projected_newton" and self._bodies.rigid_modes:
            raise InputError(
                f"method={options.method!r} needs bodies that K holds, but found "
                f"{self._bodies}. Take method='projected_newton'."
            )
