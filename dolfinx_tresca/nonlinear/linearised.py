"""The contact problem of one Newton step, with what makes an indefinite tangent definite."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import gather_rows, reduce_array
from dolfinx_tresca.dual.local_stiffness import local_stiffness
from dolfinx_tresca.nonlinear.tangent import TangentSystem
from dolfinx_tresca.problem import ContactProblem
from dolfinx_tresca.status import ContactStatus

#: Part of the slip bound below which a traction counts as that of a node that sticks: where bounds
#: depend on the pressure they are known to the accuracy of their fixed point.
STICKING = 1.0 - 1e-3

#: Gap over the largest jump up to which a node counts as one that touches.
TOUCHING = 1e-6

#: Accuracy of dual norms by iterative solvers: they only decide whether to go on.
NORM_ACCURACY = 1e-3


class LinearisedProblem(ContactProblem):
    """The contact problem of a Newton step, in the whole displacement.

    Owns PETSc objects: call `destroy()`, or use it as a context manager.

    Attributes:
        u: the displacement u_k that the forms depend on.
        tangent: its linear system.
    """

    tangent: TangentSystem

    def __init__(self, F: Any, u: fem.Function, J: Any, **arguments: Any) -> None:
        """Factor the tangent of the undeformed bodies, and pair the surfaces. Collective.

        Args:
            F: residual form.
            u: displacement that it depends on.
            J: its derivative.
            arguments: of `ContactProblem`.

        Raises:
            InputError: an argument is wrong.
            PairingError: the surfaces of a pair cannot be paired.
            StiffnessError: K is not symmetric, or is indefinite.
        """
        self.u = u
        present = u.x.array.copy()
        u.x.array[:] = 0.0
        try:
            super().__init__(J, F, **arguments)
            self._steps.u = u
            self._resistance = local_stiffness(self._jump)
            self._plain = True  # nothing is added to the tangent that was factored
        finally:
            u.x.array[:] = present

    def _linear_system(
        self, a: Any, L: Any, bcs: Sequence[Any], entity_maps: EntityMaps | None, V: Any
    ) -> TangentSystem:
        self.tangent = TangentSystem(a, L, bcs, self.u, entity_maps)
        return self.tangent

    def update_geometry(self, u: fem.Function) -> None:
        """Pair the surfaces again, where a displacement has brought them. Collective."""
        super().update_geometry(u)
        self._assemble_undeformed()
        self._plain = False  # K is no longer what was factored
        self._resistance = local_stiffness(self._jump)

    def factor(self, springs: float = 0.0, proximal: float = 0.0) -> None:
        """Assemble and factor the tangent at the present u_k, and what is added to it. Collective.

        Args:
            springs: how stiff those are that keep nodes from leaving what they touch, over the
                stiffness of a node of the undeformed body that moves alone.
            proximal: how much of the undeformed bodies' stiffness is added.

        Raises:
            StiffnessError: K is not symmetric, or still is indefinite.
        """
        if springs == proximal == 0.0 and self._plain and not self.tangent.outdated:
            return
        self._plain = False
        parts: list[PETSc.Mat] = []
        if springs > 0.0:
            parts.append(self._contact_springs(springs))
        if proximal > 0.0:
            parts.append(self._undeformed_stiffness(proximal))
        for part in parts[1:]:
            parts[0].axpy(1.0, part, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self.tangent.added = parts[0] if parts else None
        try:
            self.update_stiffness()
            self._plain = not parts
        finally:
            self.tangent.added = None
            for part in parts:
                part.destroy()

    def _contact_springs(self, factor: float) -> PETSc.Mat:
        """Return B_a'C B_a for the rows a in which nodes are held. Collective."""
        B = self._jump.matrix.copy()
        rows, columns = B.createVecLeft(), B.createVecRight()
        rows.array = np.sqrt(factor * self._held() * self._resistance)
        columns.array = np.where(self.tangent.prescribed, 0.0, 1.0)
        B.diagonalScale(rows, columns)
        springs = B.transposeMatMult(B)
        for owned in (B, rows, columns):
            owned.destroy()
        return springs

    def _held(self) -> Mask:
        """Return which rows (size,) of B contact holds at the present u_k. Collective.

        Those of pressed nodes, and of nodes that stick, by the multipliers: those of another mesh
        or run, and of surfaces that have moved, tell as much as those of the last solve. Where none
        are known all rows of nodes count that touch.
        """
        jump, multipliers = self._jump, self._steps.multipliers
        if not self.comm.allreduce(bool(multipliers.any()), op=MPI.LOR):
            return self._touching()
        lam = jump.bounded(self._present_bounds()).section(multipliers)
        sticks = lam.norms(multipliers) < STICKING * lam.radius
        held: Mask = np.ones(len(multipliers), dtype=np.bool_)
        held[lam.normal] = multipliers[lam.normal] > 0.0
        held[lam.tangential] = sticks[lam.node]
        return held

    def _touching(self) -> Mask:
        """Return which rows (size,) of B belong to nodes whose gap u_k closes. Collective."""
        jump = self._jump
        closed = jump.of(self.u.x.petsc_vec)
        largest = reduce_array(self.comm, np.abs(closed).max(initial=0.0), MPI.MAX)
        held: Mask = np.ones(len(closed), dtype=np.bool_)
        for pair, (n, t) in zip(jump.pairs, jump.slices, strict=True):
            if not pair.bonded:
                touches = np.zeros(len(pair.nodes), dtype=np.bool_)
                touches[pair.normal_node] = jump.gap[n] - closed[n] <= TOUCHING * largest
                held[n], held[t] = touches[pair.normal_node], touches[pair.tangent_node]
        return held

    def _undeformed_stiffness(self, factor: float) -> PETSc.Mat:
        """Return a part of the undeformed bodies' stiffness, less prescribed rows. Collective."""
        self._assemble_undeformed()
        stiffness = self.tangent.K.copy()
        free = stiffness.createVecLeft()
        free.array = np.where(self.tangent.prescribed, 0.0, factor)
        stiffness.diagonalScale(free)
        free.destroy()
        return stiffness

    def _assemble_undeformed(self) -> None:
        """Assemble the stiffness of the undeformed bodies. Collective."""
        present = self.u.x.array.copy()
        self.u.x.array[:] = 0.0
        try:
            self.tangent.assemble_stiffness()
        finally:
            self.u.x.array[:] = present

    @property
    def state(self) -> tuple[Any, ...]:
        """What to go back to where Newton's method fails. Not collective."""
        return self.u.x.array.copy(), self._steps.multipliers, self._steps.last

    @state.setter
    def state(self, state: tuple[Any, ...]) -> None:
        self.u.x.array[:], self._steps.multipliers, self._steps.last = state

    def begin(self) -> None:
        """Check that a solve can start from u, and turn B to the bounds of now. Collective.

        So no step turns it, and `state` stays along its rows.

        Raises:
            ContactError: the problem was destroyed.
            InputError: u has values that are NaN or infinite; or a slip bound is wrong.
        """
        self._check_not_destroyed()
        self.tangent.check_displacement("u, which the solve starts from,", self.u)
        self._turn(self._present_bounds())

    def end_with(self, status: ContactStatus) -> None:
        """Say how the solve of the whole load ended: `accept` asks for it. Not collective."""
        if self._steps.last is not None:
            self._steps.last = status, self._steps.last[1]

    def contact_forces(self) -> Array:
        """Return B'lambda [force] of owned unknowns, zero where prescribed. Collective."""
        return np.array(self._jump.contact_force(self._steps.multipliers).array)

    def residual_norm(self) -> float:
        """Return |R(u_k) + B'lambda - h|_{K^-1}, NaN where a force is. Collective.

        In the energy norm it is the displacement that would restore balance if contact did not
        change: with the tangent of the step before, a simplified Newton correction (Deuflhard 2011,
        Newton methods for nonlinear problems, 2.1.1).
        """
        force = self._jump.matrix.createVecRight()
        force.array = self.tangent.out_of_balance(self.contact_forces())
        if not np.isfinite(force.norm()):
            force.destroy()
            return float("nan")
        motion = force.duplicate()
        motion.set(0.0)
        solver = self._compliance.operator.solver
        solver.improve(force, motion, rtol=NORM_ACCURACY, accuracy=0.0)
        square = float(force.dot(motion))
        force.destroy()
        motion.destroy()
        return float(np.sqrt(max(square, 0.0)))

    def place_of_largest(self, values: Array) -> Array:
        """Return the point (dim,) [length] where the displacement `values` is largest. Collective.

        Args:
            values: of owned unknowns (and ghosts), on this rank.
        """
        dim = len(self.u)
        points = self.u.function_space.tabulate_dof_coordinates()[:, :dim]
        sizes = np.linalg.norm(values[: len(self.prescribed)].reshape(-1, dim), axis=1)
        largest = np.argsort(sizes)[-1:]
        found = gather_rows(self.comm, np.column_stack((sizes[largest], points[largest])))
        return np.array(found[np.argmax(found[:, 0]), 1:])

    def energy_norm(self, values: Array) -> float:
        """Return |v|_K for the values of v (owned and ghosts) on this rank. Collective."""
        v = fem.Function(self.u.function_space)
        v.x.array[:] = values
        return float(np.sqrt(max(2.0 * self.tangent.strain_energy(v.x.petsc_vec), 0.0)))
