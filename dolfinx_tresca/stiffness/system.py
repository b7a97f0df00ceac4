"""Assembly of K and f from the user's forms, with Dirichlet conditions eliminated symmetrically."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps, require_real_petsc
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError, StiffnessError, shown
from dolfinx_tresca.stiffness.forms import coefficients, compiled, vector_space

#: |x'K y - y'K x| over |x| |K y| up to which K counts as symmetric: rounding in the assembly.
SYMMETRY = 1e-10


class LinearSystem(PetscOwner):
    """K u = f on the degrees of freedom that are not prescribed.

    Rows and columns of prescribed degrees of freedom are those of the identity, and f holds the
    prescribed values there. What these cause elsewhere comes from the stiffness that K was made
    of: changes of the form's coefficients count from the next `assemble_stiffness` on, all of them.

    Owns PETSc objects: call `destroy()`, or use it as a context manager.

    Attributes:
        V: the function space.
        bcs: the Dirichlet conditions.
        form: the bilinear form, None where it was given compiled or as a matrix.
        K: the `PETSc.Mat`, symmetric.
        f: the load, a `fem.Function` whose vector is f.
        prescribed: (owned degrees of freedom,) bool, the prescribed ones.
    """

    def __init__(
        self,
        a: Any,
        L: Any,
        bcs: Sequence[Any],
        entity_maps: EntityMaps | None = None,
        V: Any = None,
    ) -> None:
        """Compile the forms; nothing is assembled yet. Collective.

        Raises:
            InputError: forms or conditions do not fit together.
        """
        require_real_petsc()
        self.V = vector_space(a, L, bcs, V)
        self.bcs = list(bcs)
        self.form = a if isinstance(a, ufl.Form) else None
        maps = {} if entity_maps is None else {"entity_maps": entity_maps}
        self._a, self._L = (
            compiled(name, form, self.V.mesh, maps) for name, form in (("a", a), ("L", L))
        )
        self.K = (
            self._a.duplicate()
            if isinstance(self._a, PETSc.Mat)
            else dolfinx.fem.petsc.create_matrix(self._a)
        )
        self._columns: Any = None
        self._coefficients: list[npt.NDArray[Any]] = []
        self.f = fem.Function(self.V, name="f")
        index_map = self.V.dofmap.index_map
        self.prescribed = np.zeros(
            index_map.size_local * self.V.dofmap.index_map_bs, dtype=np.bool_
        )
        for bc in self.bcs:
            dofs = bc.dof_indices()[
                0
            ]  # with ghosts; the count of owned ones is off for blocked V in 0.9
            self.prescribed[dofs[dofs < len(self.prescribed)]] = True

    def destroy(self) -> None:
        """Free the PETSc matrices. Collective."""
        self.K.destroy()
        if self._columns is not None:
            self._columns.destroy()
            self._columns = None

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self.V.mesh.comm

    def check_displacement(self, name: str, u: Any, other: str = "") -> None:
        """Check that u is a displacement of this system. Collective.

        Args:
            name: what it is, for the message.
            u: what is checked.
            other: what it may be besides.

        Raises:
            InputError: it is no Function of the space, or has values that are NaN or infinite.
        """
        if not isinstance(u, fem.Function) or u.function_space != self.V:
            raise InputError(
                f"{name} must be a displacement: a Function on the space of the forms,{other} "
                f"found {shown(u)}. Interpolate what is on another space."
            )
        with errors_on_all_ranks(self.comm):
            if not np.isfinite(u.x.array).all():
                raise InputError(f"{name} has values that are NaN or infinite.")

    def assemble_stiffness(self) -> None:
        """Assemble K from the form's present coefficients. Collective.

        Raises:
            StiffnessError: K is not symmetric, or not finite.
        """
        if isinstance(self._a, PETSc.Mat):
            self._a.copy(self.K, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        else:
            self.K.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(self.K, self._a)
        self.K.assemble()
        norm = self.K.norm(PETSc.NormType.FROBENIUS)
        if not np.isfinite(norm):
            raise StiffnessError(
                "the stiffness matrix has entries that are NaN or infinite: look for coefficients "
                "of the form a that are, and for cells without volume."
            )
        self._eliminate()
        self._check_symmetry()
        self.K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._coefficients = [np.copy(values) for values in coefficients(self.form)]

    def _eliminate(self) -> None:
        """Make prescribed rows and columns of K those of the identity; keep the columns."""
        first, last = self.K.getOwnershipRange()
        rows = PETSc.IS().createStride(last - first, first, 1, comm=self.K.comm)
        prescribed = (first + np.flatnonzero(self.prescribed)).astype(PETSc.IntType)
        columns = PETSc.IS().createGeneral(prescribed, comm=self.K.comm)
        if self._columns is not None:
            self._columns.destroy()
        self._columns = self.K.createSubMatrix(rows, columns)
        self.K.zeroRowsColumns(columns, 1.0)
        rows.destroy()
        columns.destroy()

    def _forces_of(self, values: Array) -> PETSc.Vec:
        """Return the forces [force] that hold this rank's prescribed values, all else zero.

        The caller's. Collective.
        """
        given, forces = self._columns.createVecs()
        given.array = values
        self._columns.mult(given, forces)
        given.destroy()
        return forces

    @property
    def outdated(self) -> bool:
        """Whether coefficients of the form have changed since K was assembled. Collective."""
        changed = not all(
            np.array_equal(now, then)
            for now, then in zip(coefficients(self.form), self._coefficients, strict=True)
        )
        return bool(self.comm.allreduce(changed, op=MPI.LOR))

    def _check_symmetry(self) -> None:
        """Compare x'K y with y'K x for two rough vectors: a product instead of a transpose."""
        x, y = self.K.createVecLeft(), self.K.createVecLeft()
        Kx, Ky = x.duplicate(), x.duplicate()
        first, last = x.getOwnershipRange()
        rows = np.arange(first, last)
        x.array = np.cos(12.9898 * rows)
        y.array = np.sin(78.233 * rows)
        self.K.mult(x, Kx)
        self.K.mult(y, Ky)
        defect = abs(x.dot(Ky) - y.dot(Kx))
        scale = x.norm() * Ky.norm()
        for vector in (x, y, Kx, Ky):
            vector.destroy()
        if defect > SYMMETRY * scale:
            raise StiffnessError(
                f"the stiffness matrix is not symmetric (relative defect {defect / scale:.1e}): "
                "the form a(u, v) must equal a(v, u). Move unsymmetric terms to L, or drop them."
            )

    @property
    def prescribes_zero(self) -> bool:
        """Whether all prescribed values are zero. Collective."""
        values = self.f.x.array[: len(self.prescribed)][self.prescribed]
        return not self.comm.allreduce(bool(values.any()), op=MPI.LOR)

    def strain_energy(self, u: PETSc.Vec) -> float:
        """Return a(u, u) / 2 [energy], for the coefficients that K was assembled with. Collective.

        Args:
            u: displacement, with prescribed values.
        """
        inside = u.copy()
        inside.array[self.prescribed] = 0.0
        Ku = u.duplicate()
        self.K.mult(inside, Ku)
        forces = self._forces_of(u.array[self.prescribed])
        energy = 0.5 * float(inside.dot(Ku) + inside.dot(forces) + u.dot(forces))
        for vector in (inside, Ku, forces):
            vector.destroy()
        return energy

    def assemble_forces(self) -> fem.Function:
        """Return L alone: f without the prescribed values and what they cause. Collective."""
        forces = fem.Function(self.V)
        if self._L is not None:
            fem.assemble_vector(forces.x.array, self._L)
        forces.x.scatter_reverse(dolfinx.la.InsertMode.add)
        forces.x.array[: len(self.prescribed)][self.prescribed] = 0.0
        forces.x.scatter_forward()
        return forces

    def assemble_load(self) -> None:
        """Assemble f from the present loads and prescribed values. Collective.

        Raises:
            InputError: a value is NaN or infinite.
        """
        array = self.f.x.array
        array[:] = 0.0
        if self._L is not None:
            fem.assemble_vector(array, self._L)
        self.f.x.scatter_reverse(dolfinx.la.InsertMode.add)
        for bc in self.bcs:
            bc.set(array)
        owned = array[: len(self.prescribed)]
        forces = self._forces_of(owned[self.prescribed])
        owned[~self.prescribed] -= forces.array[~self.prescribed]
        forces.destroy()
        self.f.x.scatter_forward()
        self._check_load()

    def _check_load(self) -> None:
        """Check that f is finite. Collective.

        Raises:
            InputError: a value is NaN or infinite.
        """
        with errors_on_all_ranks(self.comm):
            if not np.isfinite(self.f.x.array).all():
                raise InputError(
                    "the load vector has entries that are NaN or infinite: look at the "
                    "coefficients of the form L and at the values of the Dirichlet conditions."
                )
