"""The contact problem of one Newton step, and stiffness that makes its tangent definite."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.functions import with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, largest_abs
from dolfinx_tresca._base.tolerances import ROUGH
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.dual.jump import JumpOperator, local_stiffness
from dolfinx_tresca.dual.nodal_values import replaced
from dolfinx_tresca.errors import ContactError, InputError, StiffnessError, shown
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.stiffness.choice import SolverRequest
from dolfinx_tresca.stiffness.system import LinearSystem


class TangentSystem(LinearSystem):
    """K u = K u_k - R(u_k) + h: the tangent K at u_k and a load whose solution is the whole u.

    Here R are internal minus external forces, and h takes back what of the load is not applied yet.

    Added stiffness, which makes an indefinite tangent definite, acts on u - u_k only, so the
    solution of a converged iteration does not depend on it. Springs in the contact also exert the
    forces `added_forces` on the bodies, which are zero at nodes where contact holds.

    A continuation parameter t goes from 0 to 1. The prescribed values go linearly from their values
    at the start of the solve to the present values, and h = (1 - t) r_0 contains the residual r_0
    at the start. So t applies any change of the loads, whatever has changed in the forms.

    Attributes:
        u: the displacement u_k, or all unknowns of a mixed space, on which the forms depend.
        has_material: whether a function of the user computes coefficients of the forms.
        added: the `PETSc.Mat` that the next `assemble_stiffness` adds to the tangent, zero in
            prescribed rows and columns, owned by the caller; None: nothing is added.
        added_forces: forces [force] of the added springs at owned unknowns, a part of the load.
        fraction: the continuation parameter t.
    """

    is_tangent = True

    cure_of_asymmetry = (
        "Newton's method takes its symmetric part with symmetrize=True, and converges linearly."
    )

    def __init__(
        self,
        J: Any,
        F: Any,
        bcs: Sequence[Any],
        u: fem.Function,
        entity_maps: EntityMaps | None = None,
        before_assembly: Callable[[], None] | None = None,
        axisymmetric: bool = False,
        V: Any = None,
    ) -> None:
        """Compile the forms; `NonlinearContactProblem` explains the arguments. Collective."""
        super().__init__(J, F, bcs, entity_maps, V, axisymmetric)
        if u.function_space != self.space:
            raise InputError(
                "u must be a Function on the space of F's test function, found one on "
                f"{u.function_space.ufl_element()}. A displacement of a mixed space W is a part of "
                "w = fem.Function(W): give w, and write F with ufl.split(w)."
            )
        self.u = u
        self._before_assembly = before_assembly
        self.has_material = before_assembly is not None
        forms = [form for form in (F, J) if isinstance(form, ufl.Form)]
        self._functions = {f: None for form in forms for f in form.coefficients() if f != u}
        self._updated_at: Array | None = None
        self._forces: tuple[Array, Array] | None = None  # the latest u and R(u)
        self.added: PETSc.Mat | None = None
        self.added_forces: Array | float = 0.0
        self.fraction = 1.0
        self._tangent = self.K  # the tangent alone: with `added` stiffness, another matrix than K
        self._prescribed_before: Array = np.zeros(int(self.prescribed.sum()))
        self._initial_residual: Array = np.zeros(len(self.prescribed))

    def destroy(self) -> None:
        """Free the PETSc matrices. Collective."""
        if self._tangent is not self.K:
            self._tangent.destroy()
        super().destroy()

    def update_material(self) -> None:
        """Compute the material's coefficients by `before_assembly`, once for each u. Collective."""
        if self._before_assembly is None:
            return
        same = self._updated_at is not None and np.array_equal(self.u.x.array, self._updated_at)
        if self.comm.allreduce(same, op=MPI.LAND):
            return
        self.u.x.scatter_forward()
        u, self._updated_at = self.u.x.array.copy(), None
        with errors_on_all_ranks(self.comm):
            self._before_assembly()
            if not np.array_equal(self.u.x.array, u):
                self.u.x.array[:] = u
                raise InputError(
                    "before_assembly() has changed u, which it must only read: the solve sets u."
                )
        self.check_functions()
        self._updated_at = u

    def check_functions(self) -> None:
        """Check that Functions in the forms, other than u, are finite. Collective."""
        with errors_on_all_ranks(self.comm):
            fields = [field for field in self._functions if not np.isfinite(field.x.array).all()]
            text = f"values that are NaN or infinite in {', '.join(map(shown, fields))}."
            if fields and self.has_material:
                raise StiffnessError(f"before_assembly() leaves {text}")
            if fields:
                raise InputError(f"F or J depends on {text}")

    def forget_material(self) -> None:
        """Let material and forces be computed again, even at the same u. Not collective."""
        self._updated_at, self._forces = None, None

    @property
    def outdated(self) -> bool:
        """Whether coefficients of the form may have changed since K was assembled. Collective."""
        return self.form is None or super().outdated

    def assemble_stiffness(self) -> None:
        """Assemble the tangent at the present u_k, plus the stiffness `added`. Collective."""
        self.update_material()
        if self._tangent is not self.K:  # K is a sum with `added`: assemble the tangent alone
            self.K.destroy()
            self.K = self._tangent
        super().assemble_stiffness()
        self._tangent = self.K  # a new object after each assembly if the user gives J as a matrix
        if self.added is not None:
            self.K = self._tangent.copy()
            self.K.axpy(1.0, self.added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self.K.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def all_forces(self) -> Array:
        """Return R(u_k) [force] at all owned unknowns, assembled once for each u. Collective."""
        u = self.u.x.array
        same = self._forces is not None and np.array_equal(u, self._forces[0])
        if self._forces is None or not self.comm.allreduce(same, op=MPI.LAND):
            self.update_material()
            forces = fem.Function(self.space)
            self._assemble_L(forces.x)
            self._forces = u.copy(), np.array(forces.x.array[: len(self.prescribed)])
        return self._forces[1].copy()

    def prescribed_values(self) -> Array:
        """Return the prescribed values of the present `fraction`. Collective."""
        before, after = self._prescribed_before, super().prescribed_values()
        return (1.0 - self.fraction) * before + self.fraction * after

    def begin(self, contact_forces: Array) -> None:
        """Begin the continuation at the present u_k with contact forces B'lambda. Collective."""
        self._prescribed_before = self.u.x.array[: len(self.prescribed)][self.prescribed]
        self.fraction = 1.0
        self._initial_residual = self.residual(contact_forces)

    def residual(self, contact_forces: Array) -> Array:
        """Return R(u_k) + B'lambda - h [force], zero where prescribed. Collective."""
        remaining_load = (1.0 - self.fraction) * self._initial_residual
        return np.where(self.prescribed, 0.0, self.all_forces()) + contact_forces - remaining_load

    def assemble_load(self) -> None:
        """Assemble the load of the step from u_k, for the present `fraction`. Collective.

        If all forces are rounding errors of the terms whose sums they are, they are set to zero:
        else unloaded linear bodies would shrink step by step until squares of numbers underflow.
        """
        values = self.prescribed_values()
        u = np.array(self.u.x.array[: len(self.prescribed)])
        terms = np.abs(self.K.getDiagonal().array * u)
        # prescribed values are eliminated: f is K (u_k - values) - R(u_k) + h at other unknowns
        u[self.prescribed] -= values
        product, residual = self.product(u).array, self.residual(np.zeros_like(u))
        terms += np.abs(product) + np.abs(residual)
        owned = self.f.x.array[: len(u)]
        owned[:] = product - residual + self.added_forces
        further = ~(self.moves | self.prescribed)  # unknowns of a mixed space, such as a pressure
        force, further_force, term, further_term = largest_abs(
            self.comm, owned[self.moves], owned[further], terms[self.moves], terms[further]
        )
        if force <= ROUNDING * term and further_force <= ROUNDING * further_term:
            owned[:] = 0.0
        owned[self.prescribed] = values
        self.f.x.scatter_forward()
        self._check_load()


#: Nodes touch if their gap is at most this fraction of the largest component of the jumps B u.
TOUCHING = 1e-6


class TangentProblem(ContactSystem):
    """The contact problem of a Newton step; its unknown is the total displacement, not a change.

    Attributes:
        u: the present u_k, or all unknowns of a mixed space, at which the tangent is taken.
        tangent: the linear system of a step.
    """

    def __init__(
        self,
        tangent: TangentSystem,
        on_accept: Callable[[], None] | None,
        pairs: list[ContactPair],
        request: SolverRequest,
    ) -> None:
        """Factor the reference tangent, and pair the surfaces. Collective."""
        # the reference tangent, whose multiples `factor` adds, is that of the undeformed bodies; if
        # the material has a history, that at the displacement from which the present solve starts
        self.tangent, self.u, self._on_accept = tangent, tangent.u, on_accept
        self._has_history = tangent.has_material or on_accept is not None
        u = self.u.x.array
        self._reference = u.copy() if self._has_history else np.zeros_like(u)
        self._reference_block: PETSc.Mat | None = None  # for `energy_norm`, without conditions
        with replaced([self.u], [self._reference]):
            if tangent.component is not None:
                tangent.update_material()
                tangent.assemble_form()
                self._reference_block = tangent.displacement_stiffness()
            super().__init__(tangent, pairs, request)
        self.unknowns = self.u
        self._stiffness_for: tuple[JumpOperator, Array] | None = None
        self._tangent_is_plain = True  # the factored tangent has no springs, and is the present one

    @property
    def displacement(self) -> fem.Function:
        """The present displacement: u, or in a mixed space a copy of the displacement in u."""
        return self.tangent.displacement(self.u, self.u.name)

    def advance_material(self, solution: StepSolution) -> None:
        """Let the user's `on_accept` make the material's state at a solution its history.

        Before that, forces out of balance at a converged solution are an error. Collective.
        """
        if not self._has_history:
            return
        w, is_converged = solution.fields.w.x.array, solution.status is ContactStatus.CONVERGED
        try:
            with replaced([self.u], [w]):
                self.tangent.forget_material()
                self.tangent.update_material()
                if is_converged and self.is_large(self.residual_norm(), w, w - self._reference):
                    raise ContactError(
                        "the history of the material, loads or coefficients of F have changed "
                        "since the solution that is to be accepted: call solve() again, and "
                        "accept() before you change them. Only on_accept may change the history."
                    )
                if self._on_accept is not None:
                    with errors_on_all_ranks(self.comm):
                        self._on_accept()
        finally:
            self.tangent.forget_material()

    def factor(self, springs: float = 0.0, proximal: float = 0.0) -> None:
        """Assemble and factor the tangent at the present u_k with added stiffness. Collective.

        Springs hold nodes in contact, with `springs` times the stiffness of a single node in the
        reference tangent. If they are added, so is the reference tangent times `proximal`.
        """
        self.tangent.update_material()
        if springs == proximal == 0.0 and self._tangent_is_plain and not self.tangent.outdated:
            return  # the tangent at u_k is factored already
        self._tangent_is_plain = False
        added, self.tangent.added_forces = None, 0.0
        if springs > 0.0:
            added, self.tangent.added_forces = self._contact_springs(springs)
            if proximal > 0.0:
                # the reference tangent of free displacements, times the factor
                with replaced([self.u], [self._reference]):
                    self.tangent.assemble_stiffness()
                reference = self.tangent.K.copy()
                rows, columns = reference.createVecs()
                # other rows and columns become zero: stiffness would change constraints
                rows.array, columns.array = proximal * self.tangent.moves, self.tangent.moves
                reference.diagonalScale(rows, columns)
                added.axpy(1.0, reference, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self.tangent.added = added
        try:
            self.update_stiffness()
            self._tangent_is_plain = added is None
        finally:
            self.tangent.added = None

    def _contact_springs(self, factor: float) -> tuple[PETSc.Mat, Array]:
        """Return the stiffness B_a'C B_a of springs and their forces; B_a are rows in contact.

        The springs pull to the jumps j that contact prescribes, the gap and the slip origin, with
        forces B_a'C (j - B_a u_k) at owned unknowns, zero where contact holds. The stiffness C of
        a spring is the factor times the stiffness of the row's node. Collective.
        """
        jump, tangent = self.jump, self.tangent
        # j - B u, for u_k with the prescribed values of the present fraction
        u = fem.Function(tangent.space)
        u.x.array[:] = self.u.x.array
        owned = u.x.array[: len(tangent.prescribed)]
        owned[tangent.prescribed] = tangent.prescribed_values()
        u.x.scatter_forward()
        missing = jump.gap + self.history_of_solve().origin - jump.of_unknowns(u.x.petsc_vec)
        B = jump.matrix.copy()
        rows, columns = B.createVecLeft(), B.createVecRight()
        in_contact = self._rows_in_contact()
        if self._stiffness_for is None or self._stiffness_for[0] is not jump:
            # the stiffness (size,) of each row's node in the reference tangent, kept for the jump
            with replaced([self.u], [self._reference]):
                tangent.assemble_stiffness()
            self._stiffness_for = jump, local_stiffness(jump)
        rows.array = np.sqrt(factor * in_contact * self._stiffness_for[1])  # C^(1/2)
        columns.array = np.where(tangent.prescribed, 0.0, 1.0)
        B.diagonalScale(rows, columns)  # C^(1/2) B_a, zero in prescribed columns
        springs = B.transposeMatMult(B)  # B_a'C B_a
        rows.array *= missing  # C^(1/2) (j - B_a u_k)
        B.multTranspose(rows, columns)  # B_a'C (j - B_a u_k)
        return springs, np.array(columns.array)

    def _rows_in_contact(self) -> Mask:
        """Return a mask (size,) of the rows of B in contact at the present u_k. Collective.

        In contact are all rows of bonded pairs, normal rows of pressed nodes, and tangential rows
        of sticking nodes (with the bounds of the present pressures, and curves of friction at zero
        slip). If all multipliers are zero, nodes that touch count as pressed, and none as sticking.
        """
        jump, multipliers = self.jump, self.state.multipliers
        section = jump.bounded(self.slip_bounds()).section(multipliers)
        held: Mask = np.ones(len(multipliers), dtype=np.bool_)
        if self.comm.allreduce(bool(multipliers.any()), op=MPI.LOR):
            held[section.normal] = multipliers[section.normal] > 0.0
            # bounds that depend on the pressure are known to the accuracy of their fixed point
            sticks = section.norms(multipliers) < (1.0 - ROUGH) * section.radius
            held[section.tangential] = sticks[section.node]
            return held
        jumps = jump.of_unknowns(self.u.x.petsc_vec)
        (largest,) = largest_abs(self.comm, jumps)
        held[section.normal] = (jump.gap - jumps)[section.normal] <= TOUCHING * largest
        held[section.tangential] = False
        return held

    def begin(self) -> None:
        """Go to the state in which a solve starts; note where obstacles move in it. Collective."""
        before = self.state.motions
        self.begin_solve()
        accepted = self.state.accepted
        u = accepted.displacement
        same = u is not None and np.array_equal(u.x.array, self.displacement.x.array)
        if self.comm.allreduce(same, op=MPI.LAND):
            before = accepted.motions  # a trial may have left obstacles elsewhere
        self._motions = before, self.obstacles.motions  # at the start and at the end of the solve
        self._loads_in_parts = False
        self.tangent.forget_material()  # the caller may have changed the material's history
        if not self.tangent.has_material:
            self.tangent.check_functions()
        if self._has_history:
            self._reference = self.u.x.array.copy()
        self.align_tangents(self.slip_bounds())

    def apply_load(self, fraction: float) -> None:
        """Apply a fraction of the change of load, and of the motion of obstacles. Collective.

        The first fraction below 1 puts obstacles back where their motion starts, to find r_0 there.
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
        if not np.array_equal(*self._motions):
            obstacles = self.obstacles
            obstacles.place(obstacles.between(*self._motions, fraction))
            self.pair_where_changed()

    def end_load(self, fraction: float) -> None:
        """Return rigid obstacles to the positions that the user gave. Collective.

        If no fraction was solved for, the next solve starts, as this one, where their motion does.
        """
        if fraction == 0.0:
            self._place_obstacles(0.0)
        self.obstacles.place(self._motions[1])

    def residual_norm(self) -> float:
        """Return |R(u_k) + B'lambda - h|_{K^-1}, see `TangentSystem`; NaN: not finite. Collective.

        The tangent K is that of the step which led to u_k, so this is the energy norm of a
        simplified Newton correction (Deuflhard 2011, Newton methods for nonlinear problems, 2.1.1).
        """
        return self.norm_of_correction(self.tangent.residual(self.contact_forces()))

    def norm_of_correction(self, forces: Array) -> float:
        """Return |K^-1 p|_K for forces p [force] at owned unknowns; NaN: not finite. Collective."""
        force = self.jump.matrix.createVecRight()
        force.array = forces
        if not np.isfinite(force.norm()):
            return math.nan
        correction = fem.Function(self.tangent.space)
        motion = correction.x.petsc_vec
        self.compliance.solver.improve(force, motion, rtol=ROUGH, accuracy=0.0)
        if self._reference_block is not None:  # of a mixed space, whose K is indefinite
            correction.x.scatter_forward()
            return self.energy_norm(correction.x.array)
        return math.sqrt(max(float(force.dot(motion)), 0.0))

    def is_large(self, error: float, *displacements: Array) -> bool:
        """Return whether an error norm is above rounding and `ROUGH` of others. Collective."""
        largest = max(map(self.energy_norm, displacements))
        limit = max(ROUGH * largest, self.rounding_norm())
        return bool(self.comm.bcast(not error <= limit))  # True for NaN

    def rounding_norm(self) -> float:
        """Return the `norm_of_correction` of the rounding errors of R(u_k). Collective.

        It is `ROUNDING` sqrt(n u_k'D u_k + |X|_K^2), with the diagonal D of K in rows of
        displacements, the mean number n of entries in a row, and the positions X of nodes from
        their middle. A force is the sum of n terms of the size D_i |u_i|, whose rounding adds up to
        sqrt(n) times that of one; as (K^-1)_ii >= 1 / D_i, the mean square norm is at least the
        first term. Stresses that depend on the gradient of X + u_k are rounded as if X, whose
        gradient is 1, were a displacement.
        """
        K, V, moves = self.tangent.K, self.tangent.V, self.tangent.moves
        entries = K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] / K.size[0]
        terms = np.abs(K.getDiagonal().array[moves]) * self.u.x.array[: len(moves)][moves] ** 2
        total = entries * self.comm.allreduce(float(terms.sum()))
        # |X|_K
        nodes = V.dofmap.index_map
        x = V.tabulate_dof_coordinates()[: nodes.size_local, : V.mesh.geometry.dim]
        middle = self.comm.allreduce(x.sum(axis=0)) / nodes.size_global
        middle[0] *= not self.tangent.axisymmetric  # a radial translation would be a strain
        norm_of_X = self._norm(with_owned_values(V, x - middle))
        return ROUNDING * math.hypot(math.sqrt(total), norm_of_X)

    def energy_norm(self, values: Array) -> float:
        """Return sqrt(v'K v) for the values of v on this rank, with ghosts. Collective.

        K is the tangent that was assembled last. In a mixed space it is the block of displacements
        of the first reference tangent: that of a later tangent may be indefinite for displacements
        that change the volume. An error of the other unknowns alone is gone after one step.
        """
        v = fem.Function(self.tangent.space)
        v.x.array[:] = values
        return self._norm(self.tangent.displacement(v, v.name))

    def _norm(self, u: fem.Function) -> float:
        """Return the `energy_norm` of a displacement [length]. Collective."""
        if self._reference_block is None:
            return math.sqrt(max(2.0 * self.tangent.strain_energy(u.x.petsc_vec), 0.0))
        forces = self._reference_block.createVecLeft()
        self._reference_block.mult(u.x.petsc_vec, forces)
        return math.sqrt(max(float(u.x.petsc_vec.dot(forces)), 0.0))
