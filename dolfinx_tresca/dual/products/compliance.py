"""The compliance of the contact surfaces, with all data that follow from one matrix K."""

from __future__ import annotations

from functools import cached_property

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca._base.petsc import PetscOwner, destroyed_on_error, product
from dolfinx_tresca.dual.energy_bound import EnergyBound
from dolfinx_tresca.dual.jump import JumpOperator, local_stiffness
from dolfinx_tresca.dual.mesh_error import DiscretisationError
from dolfinx_tresca.dual.products.near_field import NearField
from dolfinx_tresca.dual.products.operator import (
    DualOperator,
    dense_model,
    sparse_model,
)
from dolfinx_tresca.floating.equilibrium import FloatingBodies
from dolfinx_tresca.floating.fixing import FixingSprings
from dolfinx_tresca.solvers.problem import KnownProducts
from dolfinx_tresca.solvers.products import ProductStore, WholeModel
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: With a direct solver, A is computed at once if it has at most `FEW` rows. If K has fewer than
#: `CHEAP` unknowns, as in the plane, columns of A cost less, and the number of rows may be larger
#: in proportion. (Two strips in the plane with 802 rows and 4,812 unknowns, continued from a file,
#: take 13 iterations in place of 1, and six times the time, without.)
FEW, CHEAP = 400, 10_000


class ContactCompliance(PetscOwner):
    """A = B K^-1 B', and all data that follow from K alone: computed once for each K.

    Data that not every solve needs are computed on first access.

    Owns PETSc objects, the solver among them: call `destroy()`. The caller keeps B.

    Attributes:
        jump: B.
        operator: A.
        springs: the springs that are in the solver's K, but not in the system's K; None if no body
            floats or is held softly.
    """

    def __init__(
        self,
        jump: JumpOperator,
        solver: StiffnessSolver,
        springs: FixingSprings | None,
    ) -> None:
        """Compute the data that every solve needs. Collective.

        Args:
            jump: B.
            solver: solver for the system's K plus the springs.
            springs: springs that fix floating and softly held bodies; None if there are none.

        Raises:
            StiffnessError: rows of B are linearly dependent on the rows of incompressibility in K;
                the solver is destroyed.
        """
        self.jump, self.springs = jump, springs
        self.comm = self.jump.comm
        with destroyed_on_error(solver):
            if jump.system.component is not None:
                _ = self.certificate  # now, since it raises errors of the scene
            self.operator = DualOperator(jump, solver)
        self._store: KnownProducts | None = None

    def destroy(self) -> None:
        """Free the PETSc objects, and those of the solver. Collective."""
        self._destroy_but_solver()
        self.operator.solver.destroy()

    def _destroy_but_solver(self) -> None:
        vars(self).pop("certificate", None)
        if "near_field" in vars(self):
            self.near_field.destroy()

    def on(self, jump: JumpOperator) -> ContactCompliance:
        """Return the compliance for another B, such as the B of displaced surfaces. Collective.

        The solver is the same. PETSc objects of this compliance are destroyed, except the solver.
        K need not be factored: surfaces are also paired after a factorisation has failed.
        """
        self._destroy_but_solver()
        return ContactCompliance(jump, self.operator.solver, self.springs)

    @cached_property
    def floating(self) -> FloatingBodies | None:
        """The floating and softly held bodies; None if there are none. Collective.

        Raises:
            StiffnessError: a solve failed.
        """
        if self.springs is None:
            return None
        U, stiffness = self.springs.response(self.jump.system.K, self.operator.solver)
        jumps = product(self.jump.matrix, U)
        return FloatingBodies(self.springs.modes, U, stiffness, jumps, self.jump.row_nodes)

    @cached_property
    def certificate(self) -> EnergyBound:
        """The object that bounds errors in the energy norm. Collective."""
        return EnergyBound(self.jump, self.nodal_stiffness)

    @cached_property
    def near_field(self) -> NearField:
        """The near field, an approximation of A for oscillating tractions. Collective."""
        return NearField(self.jump, self.operator.solver)

    @cached_property
    def estimator(self) -> DiscretisationError:
        """The object that estimates the error of the mesh. Collective."""
        system = self.jump.system
        return DiscretisationError(system.form, system.V, system.axisymmetric)

    def known_products(self) -> KnownProducts:
        """Return the store of all known products with A. Collective.

        The first call computes A if it is sparse, or if it has few rows (`FEW`).
        """
        if self._store is not None:
            return self._store
        compliance = np.reciprocal(self.nodal_stiffness)
        self._store = sparse_model(self.operator, compliance)
        if self._store is None:
            jump, (size, unknowns) = self.jump, self.jump.matrix.getSize()
            # in a mixed space, clamped nodes round the near field would fix its volume
            has_near = size > 0 and jump.system.component is None
            near = (lambda x: self.near_field.apply(x)) if has_near else None
            self._store = ProductStore(jump.reductions, compliance, apply_near=near)
            if self.operator.exact and 0 < size * min(1.0, unknowns / CHEAP) <= FEW:
                self.complete_products()
        return self._store

    def complete_products(self) -> bool:
        """Compute A as a dense matrix, unless it is known or too large; return whether it is known.

        Collective.
        """
        if not isinstance(self._store, WholeModel):
            compliance = np.reciprocal(self.nodal_stiffness)
            model = dense_model(self.operator, compliance)
            self._store = self._store if model is None else model
        return isinstance(self._store, WholeModel)

    @cached_property
    def nodal_stiffness(self) -> Array:
        """`local_stiffness` (size,), the same for all directions of a friction disc. Collective."""
        return self.jump.discs.mean_over_discs(local_stiffness(self.jump))

    @cached_property
    def stress_rounding(self) -> float:
        """Size of the pressures [stress] that the rounding of coordinates causes. Collective."""
        jump = self.jump
        stress = self.nodal_stiffness * jump.stress_scale / jump.length_scale
        largest = [stress.max(initial=0.0), np.abs(jump.system.V.mesh.geometry.x).max(initial=0.0)]
        stiffness, extent = reduce_array(jump.comm, largest, MPI.MAX)
        return float(ROUNDING * extent * stiffness)

    def forget(self) -> None:
        """Drop all products. Not collective."""
        self._store = None
