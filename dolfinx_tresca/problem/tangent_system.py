"""The linear system of one Newton step, whose solution is the total displacement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError, StiffnessError, shown
from dolfinx_tresca.stiffness.system import LinearSystem


class TangentSystem(LinearSystem):
    """K u = K u_k - R(u_k) + h: the tangent K at u_k and a load whose solution is the whole u.

    Here R are internal minus external forces, and h is the part of the change of load that is not
    applied yet.

    Added stiffness, which makes an indefinite tangent definite, acts on u - u_k only: it is added
    on both sides, so the solution of a converged iteration does not depend on this stiffness. Its
    springs in the contact have forces beside, which vanish there where contact holds.

    A continuation parameter t goes from 0 to 1. The prescribed values go linearly from their values
    at the start of the solve to the present values, and h = (1 - t) r_0 contains the residual r_0
    at the start. So t applies any change of the loads, whatever has changed in the forms.

    In a mixed space, u has other unknowns besides the displacement, and K is a saddle point.

    Attributes:
        u: the displacement u_k, or all unknowns of a mixed space, on which the forms depend.
        has_material: whether a function of the user computes coefficients of the forms.
        added: the `PETSc.Mat` that the next `assemble_stiffness` adds to the tangent, zero in
            prescribed rows and columns, owned by the caller; None: nothing is added.
        added_forces: forces [force] at owned degrees of freedom that are added to the load; None:
            there are none.
        fraction: the continuation parameter t.
    """

    is_tangent = True

    cure_of_asymmetry = (
        "Newton's method takes the symmetric part of the derivative with symmetrize=True, and then "
        "converges linearly."
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
        """Compile the forms; nothing is assembled yet. Collective.

        Args:
            J: derivative of F with respect to u.
            F: residual form, internal minus external forces.
            bcs: Dirichlet conditions of the total displacement, not of its change in a Newton step.
            u: displacement on which the forms depend, or all unknowns of a mixed space.
            entity_maps: see `ContactProblem`.
            before_assembly: function that computes further coefficients of the forms from u.
            axisymmetric: whether the mesh is the meridian of bodies of revolution.
            V: the sub-space of the displacement, if a mixed space has several candidates.

        Raises:
            InputError: forms, conditions and u do not fit together.
        """
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
        self._material_changed = False
        self.added: PETSc.Mat | None = None
        self.added_forces: Array | None = None
        self.fraction = 1.0
        self._tangent = self.K
        self._prescribed_before: Array = np.zeros(int(self.prescribed.sum()))
        self._initial_residual: Array = np.zeros(len(self.prescribed))

    def destroy(self) -> None:
        """Free the PETSc matrices. Collective."""
        if self._tangent is not self.K:
            self._tangent.destroy()
        super().destroy()

    def update_material(self) -> None:
        """Compute the material's coefficients by `before_assembly`, once for each u. Collective.

        Raises:
            StiffnessError: the user's function leaves values that are NaN or infinite.
            InputError: the user's function changes u.
            Exception: an error of the user's function, on all ranks.
        """
        if self._before_assembly is None:
            return
        u = self.u.x.array
        same = self._updated_at is not None and np.array_equal(u, self._updated_at)
        if self.comm.allreduce(same, op=MPI.LAND):
            return
        self.u.x.scatter_forward()
        u, self._updated_at = self.u.x.array.copy(), None
        with errors_on_all_ranks(self.comm):
            self._before_assembly()
            if not np.array_equal(self.u.x.array, u):
                self.u.x.array[:] = u
                raise InputError(
                    "before_assembly() has changed u, which it must only read: Newton's method "
                    "chooses u."
                )
            if fields := self._not_finite():
                raise StiffnessError(
                    f"before_assembly() leaves values that are NaN or infinite in {fields}."
                )
        self._updated_at = u
        self._material_changed = True

    def check_functions(self) -> None:
        """Check that Functions in the forms are finite, unless `before_assembly` computes them.

        Collective.

        Raises:
            InputError: a Function other than u has values that are NaN or infinite.
        """
        if self._before_assembly is not None:
            return
        with errors_on_all_ranks(self.comm):
            if fields := self._not_finite():
                raise InputError(f"F or J depends on values that are NaN or infinite in {fields}.")

    def _not_finite(self) -> str:
        """Return the names of Functions in the forms, other than u, that are not finite."""
        fields = [field for field in self._functions if not np.isfinite(field.x.array).all()]
        return ", ".join(shown(field) for field in fields)

    def forget_material(self) -> None:
        """Let material and forces be computed again, even at the same u. Not collective."""
        self._updated_at, self._forces = None, None

    @property
    def outdated(self) -> bool:
        """Whether coefficients of the form have changed since K was assembled. Collective."""
        unknown = self._material_changed or not self.has_material
        return (self.form is None and unknown) or super().outdated

    def assemble_stiffness(self) -> None:
        """Assemble the tangent at the present u_k, plus the stiffness `added`. Collective.

        Raises:
            StiffnessError: K is not symmetric, or not finite.
        """
        self.update_material()
        self._material_changed = False
        if self._tangent is not self.K:
            self.K.destroy()
            self.K = self._tangent
        super().assemble_stiffness()
        self._tangent = self.K  # K is a new object after each assembly if J is a matrix
        if self.added is not None:
            self.K = self._tangent.copy()
            self.K.axpy(1.0, self.added, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            self.K.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def internal_forces(self) -> Array:
        """Return R(u_k) [force] at owned degrees of freedom, zero where prescribed. Collective."""
        return np.where(self.prescribed, 0.0, self.all_forces())

    def all_forces(self) -> Array:
        """Return R(u_k) [force] at all owned degrees of freedom. Collective.

        Nothing is assembled at the u of the last call: a step begins where the one before ended.
        """
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
        owned = self.u.x.array[: len(self.prescribed)]
        self._prescribed_before = owned[self.prescribed]
        self._initial_residual = self.internal_forces() + contact_forces

    def residual(self, contact_forces: Array) -> Array:
        """Return R(u_k) + B'lambda - h [force], zero where prescribed. Collective.

        Args:
            contact_forces: B'lambda on owned degrees of freedom, zero where prescribed.
        """
        remaining_load = (1.0 - self.fraction) * self._initial_residual
        return self.internal_forces() + contact_forces - remaining_load

    def assemble_load(self) -> None:
        """Assemble the load of the step from u_k, for the present `fraction`. Collective."""
        values = self.prescribed_values()
        u = np.array(self.u.x.array[: len(self.prescribed)])
        u[self.prescribed] -= values
        owned = self.f.x.array[: len(u)]
        owned[:] = self.product(u).array - self.residual(np.zeros_like(u))
        if self.added_forces is not None:
            owned += self.added_forces
        owned[self.prescribed] = values
        self.f.x.scatter_forward()
        self._check_load()
