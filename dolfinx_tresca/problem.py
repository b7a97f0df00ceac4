"""The contact problem: wires forms, pairs and solver together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType, TracebackType
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem

from dolfinx_tresca._parallel import errors_on_all_ranks, gather_rows, log, reduce_array
from dolfinx_tresca._timing import largest, timed
from dolfinx_tresca.dual.diagonal import fit_diagonal, rough_vector
from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.dual.operator import DualOperator
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.fields import Surface, SurfaceFields
from dolfinx_tresca.friction import SlipBounds
from dolfinx_tresca.monitor import Iteration, Observer
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.node import pair_nodes
from dolfinx_tresca.result import ContactSolution, NodeCounts
from dolfinx_tresca.solvers import gimssn, imssn, mssn, projected_newton, ssn
from dolfinx_tresca.solvers.problem import DualSolution
from dolfinx_tresca.solvers.recycling import RecycledProducts
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.bodies import check_held
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.multigrid import multigrid
from dolfinx_tresca.stiffness.solver import StiffnessMethod, StiffnessSolver, choose
from dolfinx_tresca.stiffness.system import LinearSystem

_METHODS: dict[str, ModuleType] = {"gimssn": gimssn, "imssn": imssn, "mssn": mssn, "ssn": ssn}


class ContactProblem:
    """Elastic bodies in contact with Tresca friction: (38.1) to (38.3).

    Forms and slip bounds may hold `fem.Constant` and `fem.Function`: change them in place, and the
    next `solve()` sees the new values. K is assembled and factored once; after a change of what
    the form `a` depends on call `update_stiffness()`. Each solve starts from the last one's
    multipliers and keeps its products with A.

    Owns PETSc objects: call `destroy()`, or use it as a context manager.
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
        petsc_options: Mapping[str, Any] | None = None,
        petsc_options_prefix: str | None = None,
    ) -> None:
        """Assemble and factor K, and pair the surfaces. Collective.

        Args:
            a: bilinear form, symmetric and, with `bcs`, positive definite; arguments in a vector
                space of degree 1 in 3D.
            L: linear form.
            pairs: surfaces that may touch.
            bcs: Dirichlet conditions.
            options: of the contact algorithm; can be changed for a single solve.
            stiffness: how to solve with K: "cholesky", "multigrid" (for large models), or "auto".
            petsc_options: of the solver for K, on top of the defaults.
            petsc_options_prefix: of these options, for a command line.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric positive definite; a body that nothing holds is
            named.
        """
        self.options = SolverOptions() if options is None else options
        self.pairs = list(pairs)
        if not self.pairs:
            raise InputError("a contact problem needs at least one ContactPair, found none.")
        self._petsc_options = dict(petsc_options or {})
        self._petsc_options_prefix = petsc_options_prefix
        self._setup_timings: dict[str, float] = {}
        self._system = LinearSystem(a, L, bcs)
        V, comm = self._system.V, self._system.comm
        self._stiffness = choose(stiffness, V.dofmap.index_map.size_global * 3, comm)
        if comm.rank == 0:
            warn_of_slow_blas()
        solver = self._factor(self._setup_timings)
        with timed("pairing", self._setup_timings):
            operators = [pair_nodes(V, self._system.prescribed, pair) for pair in self.pairs]
            self._surfaces = [Surface.of(V, pair) for pair in self.pairs]
            self._dual = DualOperator(self._system, solver, operators)
        self._slip_bounds = SlipBounds(V)
        self.forget()

    @property
    def free_dofs(self) -> int:
        """n, the degrees of freedom of all ranks that are not prescribed. Collective."""
        return int(reduce_array(self._system.comm, np.sum(~self._system.prescribed)))

    @property
    def contact_nodes(self) -> int:
        """m, the nodes of all pairs and ranks that carry multipliers. Collective."""
        return int(
            reduce_array(self._system.comm, sum(len(pair.nodes) for pair in self._dual.pairs))
        )

    def __str__(self) -> str:
        """Describe the problem. Collective: call it on all ranks, print on one."""
        V = self._system.V
        cells = V.mesh.topology.index_map(3).size_global
        rows = [
            (
                "mesh",
                f"{cells} cells ({V.mesh.topology.cell_name()}), {self._bodies} bodies, "
                f"{V.mesh.comm.size} ranks",
            ),
            (
                "displacements",
                f"{V.dofmap.index_map.size_global * 3}, {self.free_dofs} of them free",
            ),
            ("contact nodes", f"{self.contact_nodes} in {len(self.pairs)} pairs, node-to-node"),
        ]
        for pair, operators in zip(self.pairs, self._dual.pairs, strict=True):
            gap = gather_rows(V.mesh.comm, operators.gap)
            rows.append(
                (
                    "  pair",
                    f"tag {pair.secondary} on tag {pair.primary}, {len(gap)} nodes, gap "
                    f"{gap.min():.3g} to "
                    f"{gap.max():.3g}, slip bound {pair.friction.slip_bound!r}",
                )
            )
        rows.append(("solver for K", str(self._dual.solver)))
        rows.append(("method", f"{self.options.method}, rtol {self.options.rtol:.0e}"))
        return "\n".join(f"{name:<14} {value}" for name, value in rows)

    def __enter__(self) -> ContactProblem:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.destroy()

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._dual.destroy()
        self._dual.solver.destroy()
        self._system.destroy()

    def forget(self) -> None:
        """Drop multipliers and products of earlier solves: the next one starts from zero."""
        self._multipliers: Array = np.zeros(len(self._dual.scale))
        self._recycled: RecycledProducts | None = None

    def update_stiffness(self) -> None:
        """Assemble and factor K again, after a change of what the form `a` depends on. Collective.

        Raises:
            StiffnessError: K is not symmetric positive definite.
        """
        self._dual.solver.destroy()
        self._dual.solver = self._factor(self._setup_timings)
        self._recycled = None

    def solve(self, *, observer: Observer | None = None, **changes: Any) -> ContactSolution:
        """Solve for the present loads, prescribed values and slip bounds. Collective.

        Args:
            observer: called before each iteration on the ranks that give one; see
                `dolfinx_tresca.ProgressBar`. Where it returns True the solve stops.
            **changes: fields of `SolverOptions` for this solve, such as `rtol=1e-8` or
                `method="gimssn"`.

        Returns:
            the solution; look at its `status`, or call its `raise_if_failed()`.

        Raises:
            InputError: an option, a load, a prescribed value or a slip bound is wrong.
            StiffnessError: a solve with K failed.
        """
        unknown = changes.keys() - {field.name for field in dataclasses.fields(SolverOptions)}
        if unknown:
            raise InputError(f"SolverOptions has no field {', '.join(sorted(unknown))}.")
        options = dataclasses.replace(self.options, **changes)
        dual, system = self._dual, self._system
        timings, self._setup_timings = self._setup_timings, {}
        products, krylov = dual.products, dual.solver.krylov_iterations
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
            found = self._minimise(options, self._observe(observer))
        self._multipliers = found.multipliers
        with timed("fields", timings):
            fields = self._fields(found)
        log(
            system.comm,
            "%s: %s after %d iterations, %d products, residual %.2e",
            *(options.method, found.status.value, found.iterations, dual.products - products),
            found.residuals[-1],
        )
        return ContactSolution(
            status=found.status,
            options=options,
            iterations=found.iterations,
            products=dual.products - products,
            krylov_iterations=dual.solver.krylov_iterations - krylov,
            residuals=found.residuals,
            q=found.q,
            timings=largest(system.comm, timings),
            **fields,
        )

    def _factor(self, timings: dict[str, float]) -> StiffnessSolver:
        """Assemble K, check that every body is held, and set its solver up. Collective."""
        system = self._system
        with timed("stiffness", timings):
            system.assemble_stiffness()
            self._bodies = check_held(system)
        with timed(self._stiffness, timings):
            if self._stiffness == "cholesky":
                return cholesky(system.K, self._petsc_options, self._petsc_options_prefix)
            return multigrid(system.K, system.V, self._petsc_options, self._petsc_options_prefix)

    def _observe(self, observer: Observer | None) -> Callable[[Iteration], bool]:
        """Return an observer whose answer, or exception, is the same on all ranks. Collective."""
        comm = self._system.comm
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
            method = _METHODS[options.method]
            found: DualSolution = method.solve(dual, self._multipliers, options, observe)
            return found
        if self._recycled is None:
            self._recycled = RecycledProducts(dual)
            probe = rough_vector(dual)
            product = dual.apply(probe)
            self._recycled.add(probe, product)
            dual.diagonal = fit_diagonal(dual, probe, product)
        return projected_newton.solve(dual, self._multipliers, options, observe, self._recycled)

    def _fields(self, found: DualSolution) -> dict[str, Any]:
        """Return displacement, surface fields, energies, counts and forces. Collective."""
        dual, comm = self._dual, self._system.comm
        u = fem.Function(self._system.V, name="displacement")
        dual.displacement(found.multipliers, u.x.petsc_vec)
        u.x.scatter_forward()
        stress = found.multipliers * dual.scale
        jump = dual.jump(u.x.petsc_vec) * dual.scale
        target = found.multipliers - found.rho * found.gradient
        face = dual.feasible_set.face(target)

        surfaces: list[SurfaceFields] = []
        counts: npt.NDArray[np.int64] = np.zeros(4, dtype=np.int64)
        force: Array = np.zeros(4)
        first = 0
        for operators, surface, (n, t) in zip(dual.pairs, self._surfaces, dual.slices, strict=True):
            sticking = face.stick[first : first + len(operators.nodes)]
            first += len(operators.nodes)
            fields = surface.fields(
                operators, stress[n], stress[t], jump[n], jump[t], target[n] > 0.0, sticking
            )
            surfaces.append(fields)
            touching = fields.touching
            counts += [len(touching), touching.sum(), sticking.sum(), (touching & sticking).sum()]
            force[0] += operators.weights[operators.normal_node] @ stress[n]
            force[1:] += (
                operators.weights[operators.tangent_node] * stress[t]
            ) @ operators.tangents
        counts, force = reduce_array(comm, counts), reduce_array(comm, force)
        primal, dual_energy = dual.energies(found.multipliers, u.x.petsc_vec)
        return {
            "u": u,
            "surfaces": tuple(surfaces),
            "multipliers": stress,
            "primal_energy": primal,
            "dual_energy": dual_energy,
            "counts": NodeCounts(*(int(count) for count in counts)),
            "normal_force": float(force[0]),
            "tangential_force": float(np.linalg.norm(force[1:])),
        }
