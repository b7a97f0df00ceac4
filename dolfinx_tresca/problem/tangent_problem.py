"""The contact problem of one Newton step, and stiffness that makes its tangent definite."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask
from dolfinx_tresca._base.compat import collapse
from dolfinx_tresca._base.functions import with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca._base.tolerances import ROUGH
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.contact.factorisation import Factorisation
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.dual.jump import JumpOperator, local_stiffness
from dolfinx_tresca.errors import ContactError, InputError, StiffnessError
from dolfinx_tresca.problem.tangent_system import TangentSystem
from dolfinx_tresca.status import ContactStatus

#: Nodes touch if their gap is at most this fraction of the largest component of the jumps B u.
TOUCHING = 1e-6

#: Bodies have snapped if they release more than the first part of the energy that they exchange
#: with contact or store, whichever is larger, and move more than the second number times as far as
#: obstacles and prescribed values. (A step in which contact of round bodies begins seems to release
#: 0.2, since its force is no linear function of the motion; one in which an edge passes from node
#: to node up to 0.6, which the next step takes back.)
SNAP, FAR = 0.5, 3.0


class TangentProblem(ContactSystem):
    """The contact problem of a Newton step; its unknown is the total displacement, not a change.

    Attributes:
        u: the present displacement u_k, or all unknowns of a mixed space, at which the tangent is
            taken.
        tangent: the linear system of a step.
        balance: the balance of energy of the present solve.
    """

    balance: EnergyBalance

    def __init__(
        self,
        tangent: TangentSystem,
        on_accept: Callable[[], None] | None,
        factorisation: Factorisation,
    ) -> None:
        """Factor the reference tangent, and pair the surfaces. Collective.

        The reference tangent is the tangent of the undeformed bodies; if the material has a
        history, it is the tangent at the displacement from which the present solve starts.

        Args:
            tangent: the linear system of a step. The problem owns it.
            on_accept: see `NonlinearContactProblem`.
            factorisation: object that factors the tangent.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite.
        """
        self.tangent, self.u, self._on_accept = tangent, tangent.u, on_accept
        u = self.u
        self._has_history = tangent.has_material or on_accept is not None
        self._reference = u.x.array.copy() if self._has_history else np.zeros_like(u.x.array)
        self._mixed_norm: PETSc.Mat | None = None  # block of displacements, without conditions
        with self.at_unknowns(self._reference):
            if tangent.component is not None:
                tangent.update_material()
                tangent.assemble_form()
                self._mixed_norm = tangent.displacement_stiffness()
            super().__init__(factorisation)
        self.unknowns = u
        # motions of the obstacles at the start and at the end of a solve
        self._places = (self.obstacles.motions,) * 2
        self._loads_in_parts = False
        self._stiffness_for: tuple[JumpOperator, Array] | None = None
        self._tangent_is_plain = True  # the factored tangent has no springs, and is the present one

    @contextmanager
    def at_unknowns(self, values: Array) -> Iterator[None]:
        """Set u to other values inside the block, and restore it at the end. Not collective."""
        present = self.u.x.array.copy()
        self.u.x.array[:] = values
        try:
            yield
        finally:
            self.u.x.array[:] = present

    @property
    def displacement(self) -> fem.Function:
        """The present displacement: u, or in a mixed space a copy of the displacement in u."""
        return self.tangent.displacement(self.u, self.u.name)

    def advance_material(self, solution: StepSolution) -> None:
        """Make the material's state at a solution the history. Collective.

        Raises:
            ContactError: the forces at u have changed since the solve, for example through another
                history.
            Exception: an error of the user's functions, on all ranks.
        """
        if not self._has_history:
            return
        w, is_converged = solution.fields.w, solution.status is ContactStatus.CONVERGED
        try:
            with self.at_unknowns(w.x.array):
                self.tangent.forget_material()
                states = w.x.array, w.x.array - self._reference
                if is_converged and self.is_large(self.residual_norm(), *states):
                    raise ContactError(
                        "the history of the material, loads or coefficients of F have changed "
                        "since the solution that is to be accepted: call solve() again, and "
                        "accept() before you change them. Only on_accept may make a solution the "
                        "history."
                    )
                if self._on_accept is not None:
                    with errors_on_all_ranks(self.comm):
                        self._on_accept()
        finally:
            self.tangent.forget_material()

    def factor(self, springs: float = 0.0, proximal: float = 0.0) -> None:
        """Assemble and factor the tangent at the present u_k with added stiffness. Collective.

        Nothing is done if no stiffness is to be added, and the tangent at this u_k is factored
        already.

        Args:
            springs: stiffness of springs that hold nodes in contact, relative to the stiffness of a
                single node of the reference tangent.
            proximal: factor with which the reference tangent is added, beside springs.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite in spite of the added stiffness.
        """
        self.tangent.update_material()
        if springs == proximal == 0.0 and self._tangent_is_plain and not self.tangent.outdated:
            return
        self._tangent_is_plain = False
        self.tangent.added_forces = None
        added = self._contact_springs(springs) if springs > 0.0 else None
        if added is not None and proximal > 0.0:
            reference = self._reference_stiffness(proximal)
            added.axpy(1.0, reference, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self.tangent.added = added
        try:
            self.update_stiffness()
            self._tangent_is_plain = added is None
        finally:
            self.tangent.added = None

    def _contact_springs(self, factor: float) -> PETSc.Mat:
        """Return the springs B_a'C B_a, where B_a are the rows of B in contact. Collective.

        The springs pull to the jumps t that contact prescribes, the gap and the slip origin: their
        forces B_a'C (t - B_a u_k) are added to the load. So they exert no force where contact
        holds, and do not change the solution of the step there.

        Args:
            factor: stiffness C of each spring, relative to the stiffness of the row's node.
        """
        jump, tangent = self.jump, self.tangent
        u = fem.Function(tangent.space)
        u.x.array[:] = self.u.x.array
        u.x.array[: len(tangent.prescribed)][tangent.prescribed] = tangent.prescribed_values()
        u.x.scatter_forward()
        contact = jump.gap + self.history_of_solve().origin
        missing = contact - jump.of_unknowns(u.x.petsc_vec)
        B = jump.matrix.copy()
        rows, columns = B.createVecLeft(), B.createVecRight()
        rows.array = np.sqrt(factor * self._rows_in_contact() * self._nodal_stiffness())
        columns.array = np.where(tangent.prescribed, 0.0, 1.0)
        B.diagonalScale(rows, columns)
        springs = B.transposeMatMult(B)
        rows.array *= missing
        B.multTranspose(rows, columns)
        tangent.added_forces = np.array(columns.array)
        return springs

    def _nodal_stiffness(self) -> Array:
        """Return the stiffness (size,) of each row's node in the reference tangent. Collective."""
        jump = self.jump
        if self._stiffness_for is None or self._stiffness_for[0] is not jump:
            with self.at_unknowns(self._reference):
                self.tangent.assemble_stiffness()
            self._stiffness_for = jump, local_stiffness(jump)
        return self._stiffness_for[1]

    def _rows_in_contact(self) -> Mask:
        """Return a mask (size,) of the rows of B in contact at the present u_k. Collective.

        The multipliers decide: normal rows of pressed nodes, tangential rows of sticking nodes
        (with the bounds of the present pressures, and curves of friction at zero slip) and all rows
        of bonded pairs are in contact. If all multipliers are zero, normal rows of nodes that touch
        are in contact.
        """
        jump, multipliers = self.jump, self.state.multipliers
        lam = jump.bounded(self.slip_bounds()).section(multipliers)
        held: Mask = np.ones(len(multipliers), dtype=np.bool_)
        if self.comm.allreduce(bool(multipliers.any()), op=MPI.LOR):
            held[lam.normal] = multipliers[lam.normal] > 0.0
            # bounds that depend on the pressure are known to the accuracy of their fixed point
            sticks = lam.norms(multipliers) < (1.0 - ROUGH) * lam.radius
            held[lam.tangential] = sticks[lam.node]
            return held
        jumps = jump.of_unknowns(self.u.x.petsc_vec)
        largest = reduce_array(self.comm, np.abs(jumps).max(initial=0.0), MPI.MAX)
        held[lam.normal] = (jump.gap - jumps)[lam.normal] <= TOUCHING * largest
        held[lam.tangential] = False
        return held

    def _reference_stiffness(self, factor: float) -> PETSc.Mat:
        """Return the reference tangent times a factor. Collective.

        Rows and columns of prescribed degrees of freedom are zero. Rows and columns of unknowns
        other than displacements are zero, too: stiffness added to them would change constraints.
        """
        with self.at_unknowns(self._reference):
            self.tangent.assemble_stiffness()
        stiffness = self.tangent.K.copy()
        free, moves = stiffness.createVecs()
        free.array, moves.array = factor * self.tangent.moves, self.tangent.moves
        stiffness.diagonalScale(free, moves)
        return stiffness

    def begin(self) -> None:
        """Prepare a solve: check u, return to the accepted state, align the rows of B. Collective.

        Tangent vectors are rotated to the axes of the slip bounds only here, and not in Newton
        steps.

        Raises:
            ContactError: the problem was destroyed.
            InputError: u has values that are NaN or infinite; or a slip bound is wrong.
        """
        self.check_not_destroyed()
        with errors_on_all_ranks(self.comm):
            if not np.isfinite(self.u.x.array).all():
                raise InputError(
                    "u, which the solve starts from, has values that are NaN or infinite."
                )
        before = self.state.motions
        self.balance = EnergyBalance(self)
        self.begin_solve()
        accepted = self.state.accepted
        u = accepted.displacement
        same = u is not None and np.array_equal(u.x.array, self.displacement.x.array)
        if self.comm.allreduce(same, op=MPI.LAND):
            before = accepted.motions  # a trial may have left obstacles elsewhere
        self._places, self._loads_in_parts = (before, self.obstacles.motions), False
        self.tangent.forget_material()  # the caller may have changed the material's history
        self.tangent.check_functions()
        if self._has_history:
            self._reference = self.u.x.array.copy()
        self.align_tangents(self.slip_bounds())

    def apply_load(self, fraction: float) -> None:
        """Apply a fraction of the change of load, and of the motion of obstacles. Collective.

        Obstacles are at the end of their motion until a fraction less than 1 is tried. The present
        u and contact forces are then those at the start of the solve.

        Raises:
            PairingError: the surfaces cannot be paired.
            StiffnessError: a solve with K failed.
        """
        if fraction < 1.0 and not self._loads_in_parts:
            self._place_obstacles(0.0)
            self.tangent.begin(self.contact_forces())
            self._loads_in_parts = True
        if self._loads_in_parts:
            self._place_obstacles(fraction)
        self.tangent.fraction = fraction

    def _place_obstacles(self, fraction: float) -> None:
        """Apply a fraction of the motion of obstacles, and pair the surfaces. Collective."""
        if not np.array_equal(*self._places):
            obstacles = self.obstacles
            obstacles.motions = obstacles.between(*self._places, fraction)
            self.pair_where_changed()

    def end_load(self) -> None:
        """Return rigid obstacles to the positions that the user gave. Not collective."""
        self.obstacles.motions = self._places[1]

    def residual_norm(self) -> float:
        """Return |R(u_k) + B'lambda - h|_{K^-1}; NaN if forces are not finite. Collective.

        See `TangentSystem` for R and h. This is the energy norm of the displacement that would
        remove the residual at unchanged contact forces. The tangent is the one of the previous
        step, so this displacement is a simplified Newton correction (Deuflhard 2011, Newton methods
        for nonlinear problems, 2.1.1).
        """
        return self.norm_of_correction(self.tangent.residual(self.contact_forces()))

    def norm_of_correction(self, forces: Array) -> float:
        """Return |F|_{K^-1} for forces F [force] at owned degrees of freedom. Collective.

        The result is NaN if F is not finite. In a mixed space, it is the `energy_norm` of K^-1 F.
        """
        force = self.jump.matrix.createVecRight()
        force.array = forces
        if not np.isfinite(force.norm()):
            return math.nan
        correction = fem.Function(self.tangent.space)
        motion = correction.x.petsc_vec
        solver = self.compliance.operator.solver
        solver.improve(force, motion, rtol=ROUGH, accuracy=0.0)
        if self._mixed_norm is not None:
            correction.x.scatter_forward()
            return self.energy_norm(correction.x.array)
        return math.sqrt(max(float(force.dot(motion)), 0.0))

    def is_large(self, error: float, *displacements: Array) -> bool:
        """Return whether an error is more than that of a rough solution or of rounding. Collective.

        Args:
            error: an `energy_norm`; NaN is large.
            displacements: values of u to which the error is compared, with ghosts.
        """
        size = max(map(self.energy_norm, displacements))
        limit = max(ROUGH * size, self.rounding_norm())
        return bool(self.comm.bcast(not error <= limit))

    def rounding_norm(self) -> float:
        """Return the size of rounding errors of R(u_k) in the norm |F|_{K^-1}. Collective.

        It is `ROUNDING` sqrt(n u_k'D u_k + |x|_K^2), where D is the diagonal of K in rows of
        displacements, n is the mean number of entries in a row, and x is the position relative to
        the middle of all nodes. A force is the sum of n terms of the size D_i |u_i|, and the
        rounding errors of n terms add up to sqrt(n) times one of them; and (K^-1)_ii >= 1 / D_i.
        Stresses that depend on the deformation gradient, the gradient of x + u_k, are rounded as if
        the strains had the size 1. A rigid motion has such rounding errors, but no energy.
        """
        K, moves = self.tangent.K, self.tangent.moves
        entries = K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] / K.size[0]
        diagonal = K.getDiagonal()
        terms = np.abs(diagonal.array[moves]) * self.u.x.array[: len(moves)][moves] ** 2
        total = entries * self.comm.allreduce(float(terms.sum()))
        return ROUNDING * math.hypot(math.sqrt(total), self._norm(self._position()))

    def _position(self) -> fem.Function:
        """Return the displacement [length] that is the position of each node. Collective.

        The position is relative to the middle of all nodes: terms of F may resist a translation. In
        a body of revolution a radial translation is a strain, and the radius is not changed.
        """
        V = self.tangent.V
        nodes, x = V.dofmap.index_map, V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim]
        middle = self.comm.allreduce(x[: nodes.size_local].sum(axis=0)) / nodes.size_global
        middle[0] *= not self.tangent.axisymmetric
        return with_owned_values(V, (x - middle)[: nodes.size_local])

    def unbalanced_forces(self) -> fem.Function:
        """Return R(u_k) + B'lambda - h [force] at the nodes of the displacement. Collective."""
        try:
            residual = self.tangent.residual(self.contact_forces())
        except StiffnessError:  # the user's function has no stresses here
            residual = np.full(len(self.tangent.prescribed), np.nan)
        forces = with_owned_values(self.tangent.space, residual)
        return self.tangent.displacement(forces, "unbalanced")

    def function_at_nodes(self, name: str, values: Array) -> fem.Function:
        """Return a function with values (owned nodes,) at the nodes of the displacement.

        Collective.
        """
        space, dofs = collapse(self.tangent.V.sub(0))
        owned = dofs[: space.dofmap.index_map.size_local]
        return with_owned_values(space, values[owned // self.tangent.V.dofmap.bs], name)

    def energy_norm(self, values: Array) -> float:
        """Return |v|_K for the values of v on this rank, with ghosts. Collective.

        In a mixed space it is the norm of the displacement, with the block of displacements of the
        reference tangent: the block of a later tangent may be indefinite for displacements that
        change the volume. A step solves for the other unknowns as exactly as for displacements: an
        error of theirs alone is gone after one step.
        """
        v = fem.Function(self.tangent.space)
        v.x.array[:] = values
        return self._norm(self.tangent.displacement(v, v.name))

    def _norm(self, u: fem.Function) -> float:
        """Return the `energy_norm` of a displacement [length]. Collective."""
        if self._mixed_norm is None:
            return math.sqrt(max(2.0 * self.tangent.strain_energy(u.x.petsc_vec), 0.0))
        forces = self._mixed_norm.createVecLeft()
        self._mixed_norm.mult(u.x.petsc_vec, forces)
        return math.sqrt(max(float(u.x.petsc_vec.dot(forces)), 0.0))


class EnergyBalance:
    """Work, stored energy and friction between the start of a solve and its solution.

    The work of loads, prescribed values and obstacles is that of forces which change linearly with
    the motion (the trapezoidal rule), as they do in small steps of a quasi-static process. The
    change of the stored energy is the integral of the internal forces R over the straight path from
    u_0 to u_1. The energy that remains is

        1/2 (R_0 + R_1)'(u_1 - u_0) - integral of R'du + 1/2 (C_0 + C_1)'(u_1 - u_0 - v) - D

    with the contact forces C = B'lambda, the displacement v of the obstacles at the nodes, and the
    dissipation D of friction. Forces at prescribed degrees of freedom and loads that have changed
    are included. In a smooth step each of the differences vanishes, to third order in the step.
    """

    def __init__(self, problem: TangentProblem) -> None:
        """Note displacement and contact forces at the end of the last solve. Collective.

        Args:
            problem: the problem before its surfaces are paired for the next solve.
        """
        state = problem.state
        self._problem = problem
        self._motions = state.motions, problem.obstacles.motions
        self._start = problem.u.x.array.copy()
        known_ends = [u for u in (state.end, state.accepted.unknowns) if u is not None]
        ends = known_ends or [np.zeros_like(self._start)]
        self._begins_at_end = any(np.array_equal(self._start, end) for end in ends)
        self._forces_at_start, self._work_at_start, _ = self._contact()

    def _contact(self) -> tuple[Array, float, float]:
        """Return C at owned unknowns, the local sum of C'v, and the largest v. Collective."""
        problem, multipliers = self._problem, self._problem.state.multipliers
        jumps, largest = problem.obstacle_jumps(*self._motions)
        forces = np.array(problem.jump.whole_force(multipliers).array)
        return forces, float(multipliers @ jumps), largest

    def released(self, start: Array, dissipation: float) -> tuple[float, bool]:
        """Return the released energy at the present displacement, and whether bodies snap.

        The energy is NaN if the solve did not start where the last one ended, or if internal forces
        cannot be computed on the straight path. If a function of the user computes them, it is
        called only where bodies move `FAR`, and the energy is NaN elsewhere. Collective.

        Args:
            start: values of u at which the solve started.
            dissipation: D [energy].

        Raises:
            Exception: an error of the user's functions, on all ranks.
        """
        problem, tangent = self._problem, self._problem.tangent
        forces, work, driven = self._contact()
        change = problem.u.x.array - self._start
        owned, moves = change[: len(forces)], tangent.moves
        sizes = [np.abs(owned[rows]).max(initial=0.0) for rows in (moves, tangent.prescribed)]
        starts_there = self._begins_at_end and np.array_equal(start, self._start)
        moved, held, driven, elsewhere = reduce_array(
            problem.comm, [*sizes, driven, float(not starts_there)], MPI.MAX
        )
        is_far = moved > FAR * max(held, driven)
        if elsewhere or (tangent.has_material and not is_far):
            return np.nan, False
        powers = []
        inner = 0.5 * np.sqrt(0.2)  # Lobatto's rule is exact for polynomials of degree 5
        try:
            for fraction in (0.0, 1.0, 0.5 - inner, 0.5 + inner):
                with problem.at_unknowns(problem.u.x.array - fraction * change):
                    powers.append(float(tangent.all_forces() @ owned))
        except StiffnessError:
            return np.nan, False
        at_ends = 0.5 * sum(powers[:2])
        stored = (sum(powers[:2]) + 5.0 * sum(powers[2:])) / 12.0
        contact = 0.5 * float((self._forces_at_start + forces) @ owned)
        local = [at_ends, stored, contact, 0.5 * (self._work_at_start + work)]
        at_ends, stored, contact, work = reduce_array(problem.comm, local)
        released = at_ends - stored + contact - work - dissipation
        is_large = released > SNAP * max(abs(stored), abs(contact))
        return released, bool(is_large and is_far)
