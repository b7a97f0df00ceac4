"""The contact problem: wires forms, pairs and solver together."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._owner import PetscOwner, destroyed_on_error
from dolfinx_tresca._parallel import errors_on_all_ranks, log
from dolfinx_tresca._timing import largest, timed
from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.dual.first_products import first_products
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.evaluation import evaluate
from dolfinx_tresca.fields import Surface
from dolfinx_tresca.friction import SlipBounds
from dolfinx_tresca.monitor import Iteration, Observer
from dolfinx_tresca.options import SLACK, Accuracy, Method, SolverOptions
from dolfinx_tresca.pair import ContactPair, checked_pairs
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.solvers import gimssn, imssn, mssn, projected_newton, ssn
from dolfinx_tresca.solvers.problem import ContactStatus, DualSolution
from dolfinx_tresca.solvers.recycling import RecycledProducts
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.bodies import find_bodies
from dolfinx_tresca.stiffness.choice import StiffnessMethod, choose
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.multigrid import multigrid
from dolfinx_tresca.stiffness.solver import StiffnessSolver, check_options
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.summary import ProblemSummary
from dolfinx_tresca.table import Row, Tabulated
from dolfinx_tresca.units import Units

_METHODS: dict[str, ModuleType] = {"gimssn": gimssn, "imssn": imssn, "mssn": mssn, "ssn": ssn}


class ContactProblem(PetscOwner, Tabulated):
    """Elastic bodies in contact with Tresca friction: (38.1) to (38.3).

    Forms and slip bounds may hold `fem.Constant` and `fem.Function`: change them in place, and the
    next `solve()` sees the new values. K is assembled and factored once; after a change of what
    the form `a` depends on call `update_stiffness()`: until then solutions are those for the K that
    was factored last, also where values are prescribed, and the log warns. Each solve starts from
    the last one's multipliers and keeps its products with A. Which degrees of freedom `bcs`
    prescribe is fixed; their values may change.

    Owns PETSc objects: call `destroy()`, or use it as a context manager.

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

    def __init__(
        self,
        a: Any,
        L: Any,
        pairs: Sequence[ContactPair],
        bcs: Sequence[Any] = (),
        *,
        options: SolverOptions | None = None,
        stiffness: StiffnessMethod = "auto",
        expected_solves: int = 1,
        petsc_options: Mapping[str, Any] | None = None,
        petsc_options_prefix: str | None = None,
        units: Units | None = None,
    ) -> None:
        """Assemble and factor K, and pair the surfaces. Collective.

        Args:
            a: bilinear form, symmetric and, with `bcs`, positive definite, but for rigid motions of
                bodies that contact holds; arguments in a vector space of degree 1 or 2, in 3D or
                (plane strain) in 2D.
            L: linear form.
            pairs: surfaces that may touch.
            bcs: Dirichlet conditions.
            options: of the contact algorithm; can be changed for a single solve.
            stiffness: how to solve with K: "cholesky", "multigrid" (for large models), or "auto".
            expected_solves: how often `solve()` will be called before K changes, about: the more,
                the sooner "auto" takes "cholesky", whose further solves are cheaper.
            petsc_options: of the solver for K, on top of the defaults.
            petsc_options_prefix: of these options, for a command line.
            units: names of the units of length and stress, for what is printed and drawn.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite.
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
        self._warned = False
        self._system = LinearSystem(a, L, bcs)
        V, comm = self._system.V, self._system.comm
        dim = V.dofmap.index_map_bs
        self._stiffness, self._stiffness_reason = choose(
            stiffness,
            V.dofmap.index_map.size_global * dim,
            dim,
            V.element.basix_element.degree,
            expected_solves,
            comm,
        )
        if comm.rank == 0:
            warn_of_slow_blas()
        try:
            with timed("pairing", self._setup_timings):
                operators = [pair_surfaces(V, self._system.prescribed, pair) for pair in self.pairs]
                self._surfaces = [Surface.of(V, pair) for pair in self.pairs]
                self._slip_bounds = SlipBounds(V)
                for pair, on_nodes in zip(self.pairs, operators, strict=True):
                    self._slip_bounds.check(pair.friction, on_nodes.nodes)
            self._summary = ProblemSummary.of(self._system, self.pairs, operators)
            solver = self._factor(self._setup_timings)
            with destroyed_on_error(solver):
                loose = self._bodies.loose_motions
                self._dual = DualProgram(self._system, solver, operators, loose)
        except ContactError:
            self._system.destroy()
            raise
        self.forget()

    @property
    def free_dofs(self) -> int:
        """n, the degrees of freedom of all ranks that are not prescribed. Not collective."""
        return self._summary.free_dofs

    @property
    def contact_nodes(self) -> int:
        """m, the nodes of all pairs and ranks that carry multipliers. Not collective."""
        return self._summary.contact_nodes

    def _rows(self) -> list[Row]:
        return [
            ("bodies", f"{self._bodies}"),
            *self._summary.rows(self.units),
            ("solver for K", str(self._dual.solver)),
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

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._dual.destroy()
        self._dual.solver.destroy()
        self._system.destroy()

    def forget(self) -> None:
        """Drop multipliers and products of earlier solves: the next one starts from zero.

        Not collective.
        """
        self._multipliers: Array = np.zeros(len(self._dual.scale))
        self._recycled: RecycledProducts | None = None

    def update_stiffness(self) -> None:
        """Assemble and factor K again, after a change of what the form `a` depends on. Collective.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
        """
        self._dual.solver.destroy()
        solver = self._factor(self._setup_timings)
        with destroyed_on_error(solver):
            self._dual.update_stiffness(solver, self._bodies.loose_motions)
        self._recycled = None

    def solve(
        self,
        *,
        observer: Observer | None = None,
        method: Method | None = None,
        accuracy: Accuracy | None = None,
        local_accuracy: float | None = None,
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
            rtol=rtol,
            max_iterations=max_iterations,
            rho_sigma=rho_sigma,
            r_tol=r_tol,
            c_fact=c_fact,
        )
        dual, system = self._dual, self._system
        timings, self._setup_timings = self._setup_timings, {}
        products, krylov = dual.products, dual.solver.krylov_iterations
        dual.solver.check_ready()
        observe = self._observe(observer)
        self._warn_if_outdated()
        with timed("load", timings):
            system.assemble_load()
            dual.update_bounds(
                [
                    self._slip_bounds.at(pair.friction, operators.nodes)
                    for pair, operators in zip(self.pairs, dual.pairs, strict=True)
                ]
            )
            dual.update_load()
        with timed("iteration", timings):
            found = self._minimise(options, observe)
        self._multipliers = found.multipliers
        with timed("fields", timings):
            evaluation = evaluate(dual, self._surfaces, found, estimate=options.balanced)
        status = found.status
        if (
            status is ContactStatus.CONVERGED
            and evaluation.energy_error_bound > SLACK * found.wanted
        ):
            status = ContactStatus.STAGNATED  # what is returned is not what was judged
        log(
            system.comm,
            "%s: %s after %d iterations, %d products, residual %.2e",
            *(options.method, status.value, found.iterations, dual.products - products),
            found.residuals[-1],
        )
        return ContactSolution(
            status=status,
            options=options,
            units=self.units,
            iterations=found.iterations,
            products=dual.products - products,
            krylov_iterations=dual.solver.krylov_iterations - krylov,
            residuals=found.residuals,
            q=found.q,
            timings=largest(system.comm, timings),
            **vars(evaluation),
        )

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

    def _factor(self, timings: dict[str, float]) -> StiffnessSolver:
        """Assemble K, see what holds the bodies, and set the solver for K up. Collective."""
        system = self._system
        with timed("stiffness", timings):
            system.assemble_stiffness()
            self._warned = False
            self._bodies = find_bodies(system)
        loose = self._bodies.loose_motions
        K = loose.supported(system.K) if loose else system.K
        try:
            with timed(self._stiffness, timings):
                if self._stiffness == "cholesky":
                    return cholesky(K, self._petsc_options, self._petsc_options_prefix)
                return multigrid(K, system.V, self._petsc_options, self._petsc_options_prefix)
        finally:
            if loose:
                K.destroy()  # the solver has a reference of its own

    def _observe(self, observer: Observer | None) -> Callable[[Iteration], bool]:
        """Return an observer whose answer, or exception, is the same on all ranks. Collective.

        Raises:
            InputError: it is no function.
        """
        comm = self._system.comm
        with errors_on_all_ranks(comm):
            if observer is not None and not callable(observer):
                raise InputError(
                    "observer must be a function of an Iteration, such as a ProgressBar, found "
                    f"{shown(observer)}."
                )
        if not comm.allreduce(observer is not None, op=MPI.LOR):
            return lambda iteration: False

        def observe(iteration: Iteration) -> bool:
            stop = False
            with errors_on_all_ranks(comm):
                if observer is not None:
                    stop = bool(observer(iteration))
            return bool(comm.allreduce(stop, op=MPI.LOR))

        return observe

    def _minimise(
        self, options: SolverOptions, observe: Callable[[Iteration], bool]
    ) -> DualSolution:
        """Run the algorithm. Collective."""
        dual = self._dual
        if options.method != "projected_newton":
            if self._bodies.loose_motions:
                raise InputError(
                    f"method={options.method!r} needs bodies that K holds, but found "
                    f"{self._bodies}. Take method='projected_newton'."
                )
            method = _METHODS[options.method]
            found: DualSolution = method.solve(dual, self._multipliers, options, observe)
            return found
        if self._recycled is None:
            self._recycled = RecycledProducts(dual)
            first, products, error = first_products(dual)
            for x, product in zip(first.T, products.T, strict=True):
                self._recycled.add(x, product, error)
        return projected_newton.solve(dual, self._multipliers, options, observe, self._recycled)
