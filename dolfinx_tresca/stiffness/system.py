"""Assembly of K and f from the user's forms, with Dirichlet conditions eliminated symmetrically."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.compat import EntityMaps, owned_dofs, require_real_petsc
from dolfinx_tresca._base.functions import owned_values, with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, largest_abs
from dolfinx_tresca._base.petsc import PetscOwner, keep_inner_communicator
from dolfinx_tresca._base.tolerances import ROUGH
from dolfinx_tresca.errors import InputError, StiffnessError, shown
from dolfinx_tresca.stiffness import forms
from dolfinx_tresca.stiffness.frames import BodyFrames
from dolfinx_tresca.stiffness.solver import StiffnessSolver


class LinearSystem(PetscOwner):
    """K u = f, whose solution u has the prescribed values.

    K has identity rows and columns for prescribed degrees of freedom, where f has the prescribed
    values. Elsewhere f has the loads, and the forces of these values by the K assembled last.

    In a mixed space u has other unknowns beside the displacement, such as a pressure p, and K is a
    saddle-point matrix: with K = (A, B'; B, -C) the displacement alone has the stiffness A + B'C^-1
    B, or A for B u = 0 if C is zero. Energies refer to this stiffness.

    Attributes:
        V: the space of the displacement; for a mixed space, the collapsed sub-space.
        space: function space of the forms: V, or a mixed space.
        component: the displacement in a mixed space; None if the space is not mixed.
        form: the bilinear form; None if it was given compiled or as a matrix.
        loads: the linear form, as the user has given it.
        K: the `PETSc.Mat`, symmetric.
        f: the load, a `fem.Function` whose vector is f.
        prescribed: (owned degrees of freedom,) whether each is prescribed.
        moves: (owned degrees of freedom,) whether each is a displacement and not prescribed.
        signs: (owned degrees of freedom,) 1 for displacements, -1 for other unknowns.
        axisymmetric: whether the mesh is the meridian of bodies of revolution about the axis x = 0.
        frames: the frames in which u and f are given, if bodies have turned; None: u is the
            displacement, and f is in space.
    """

    frames: BodyFrames | None = None

    #: Whether K is the tangent of a Newton step of nonlinear bodies, as in `TangentSystem`.
    is_tangent = False

    #: Advice for an unsymmetric form, for the error message.
    cure_of_asymmetry = "Move unsymmetric terms to L, or drop them."

    def __init__(
        self,
        a: Any,
        L: Any,
        bcs: Sequence[Any],
        entity_maps: EntityMaps | None = None,
        V: Any = None,
        axisymmetric: bool = False,
    ) -> None:
        """Compile the forms; `ContactProblem` explains the arguments. Collective."""
        require_real_petsc()
        self.space = forms.form_space(a, L, bcs, V)
        index = forms.component_index(self.space, V)
        self.component = None if index is None else forms.Component(self.space, index)
        self.V = self.space if self.component is None else self.component.V
        self.comm = self.V.mesh.comm
        for space in (self.space, self.V):
            keep_inner_communicator(space.dofmap.index_map.comm)
        self.axisymmetric = axisymmetric
        if axisymmetric:
            forms.check_meridian(self.V.mesh)
        self.bcs = list(bcs)
        self.form = a if isinstance(a, ufl.Form) else None
        self.loads, self.entity_maps = L, entity_maps
        self._a = forms.compiled("a", a, self.V.mesh, entity_maps)
        self._L = forms.compiled("L", L, self.V.mesh, entity_maps)
        self._is_matrix = isinstance(self._a, PETSc.Mat)
        self.K = PETSc.Mat() if self._is_matrix else dolfinx.fem.petsc.create_matrix(self._a)
        self._columns: Any = None  # prescribed columns of K before the elimination
        self._coupled = True  # whether they have entries off the diagonal
        self._coefficients: list[npt.NDArray[Any]] = []
        self.f = fem.Function(self.space, name="f")
        dofmap = self.space.dofmap
        owned = dofmap.index_map.size_local * dofmap.index_map_bs
        self.prescribed = np.zeros(owned, dtype=np.bool_)
        for bc in self.bcs:
            self.prescribed[owned_dofs(bc, owned)] = True
        displacement = np.ones(owned, np.bool_) if self.component is None else self.component.mask
        self.moves: Mask = ~self.prescribed & displacement
        self.signs: Array = np.where(displacement, 1.0, -1.0)

    @cached_property
    def body_of_node(self) -> npt.NDArray[np.int64]:
        """The body (nodes of V,) of each node, with ghosts. Collective at the first access."""
        return label_bodies(self.V)

    def destroy(self) -> None:
        """Free the PETSc matrices. Collective."""
        self.K.destroy()
        self._columns = None
        if self.component is not None:
            self.component.destroy()

    @property
    def form_of_displacement(self) -> bool:
        """Whether a is a UFL form of the displacement alone, from which stresses can be derived."""
        return self.form is not None and self.component is None

    @property
    def ufl_forms(self) -> tuple[ufl.Form, ufl.Form | None]:
        """The UFL forms a and L; None in place of a missing L."""
        a, L = self.form, self.loads
        if a is None or not isinstance(L, ufl.Form | None):
            raise InputError(
                "a derivative needs a and L as forms of UFL, neither compiled nor a matrix."
            )
        return a, L

    def values_to_agree(self) -> dict[str, Any]:
        """Return by name the forms and conditions that all ranks must agree on. Not collective."""
        return {"a": self.form, "L": self.loads, "bcs": self.bcs}

    def check_displacement(self, name: str, u: Any, choices: str = "") -> None:
        """Check that u is a finite displacement. Collective.

        Errors say its name; that of a wrong type names other `choices` as well.
        """
        if not isinstance(u, fem.Function) or u.function_space != self.V:
            raise InputError(
                f"{name} must be a displacement: a Function on the space of solution.u,{choices} "
                f"found {shown(u)}."
            )
        with errors_on_all_ranks(self.comm):
            if not np.isfinite(u.x.array).all():
                raise InputError(f"{name} has values that are NaN or infinite.")

    def assemble_stiffness(self) -> None:
        """Assemble K from the form's present coefficients, and check it. Collective."""
        self.assemble_form()
        if not np.isfinite(self.K.norm(PETSc.NormType.FROBENIUS)):
            raise StiffnessError(
                "K has entries that are NaN or infinite: check coefficients of a, and the cells."
            )
        if self.axisymmetric and self.component is None:
            forms.check_hoop_stiffness(self.K)
        self._eliminate()
        forms.check_symmetry(self.K, self.cure_of_asymmetry)
        if self.component is not None:
            forms.check_signs(self.K, ~self.prescribed & ~self.moves)
        self.K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._coefficients = [np.copy(values) for values in forms.coefficients(self.form)]

    def assemble_form(self) -> None:
        """Assemble K before Dirichlet conditions are eliminated. Collective."""
        if self._is_matrix:
            self.K.destroy()  # the new matrix may have another sparsity pattern
            self.K = forms.copied(self._a, self.space)
        else:
            self.K.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(self.K, self._a)
        self.K.assemble()

    def _eliminate(self) -> None:
        """Replace prescribed rows and columns of K by those of the identity. Collective."""
        start, end = self.K.getOwnershipRange()
        rows = PETSc.IS().createStride(end - start, start, 1, comm=self.K.comm)
        prescribed = (start + np.flatnonzero(self.prescribed)).astype(PETSc.IntType)
        columns = PETSc.IS().createGeneral(prescribed, comm=self.K.comm)
        # the columns before that give the forces that prescribed values cause
        self._columns = self.K.createSubMatrix(rows, columns)
        if self._is_matrix:  # are there entries off the diagonal?
            entries = np.count_nonzero(self._columns.getValuesCSR()[2])
            coupled = entries > np.count_nonzero(self.prescribed)
            self._coupled = self.comm.allreduce(coupled, op=MPI.LOR)
        self.K.zeroRowsColumns(columns, 1.0)

    def forces_of(self, values: Array) -> PETSc.Vec:
        """Return K u [force], owned by the caller, for u = 0 but for `values`. Collective."""
        # with K before the elimination; the values are those of prescribed owned unknowns
        given, forces = self._columns.createVecs()
        given.array = values
        self._columns.mult(given, forces)
        return forces

    def reactions_of(self, u: PETSc.Vec) -> Array:
        """Return K u [force] at prescribed unknowns, for a u that is zero there. Collective."""
        reactions = self._columns.createVecRight()
        self._columns.multTranspose(u, reactions)
        return np.array(reactions.array)

    def product(self, u: Array) -> PETSc.Vec:
        """Return K u [force] at free unknowns f: K_ff u_f + K_fp u_p. Collective.

        At prescribed unknowns p it is K_pp u_p alone. The caller owns the vector.
        """
        inside, result = self.K.createVecs()
        inside.array = np.where(self.prescribed, 0.0, u)
        self.K.mult(inside, result)
        result.axpy(1.0, self.forces_of(u[self.prescribed]))
        return result

    @property
    def outdated(self) -> bool:
        """Whether coefficients of a UFL form have changed since K was assembled. Collective."""
        same = map(np.array_equal, forms.coefficients(self.form), self._coefficients)
        return bool(self.comm.allreduce(not all(same), op=MPI.LOR))

    def displacement_stiffness(self) -> PETSc.Mat:
        """Return K, or of a mixed space a new matrix, its displacement block. Collective."""
        return self.K if self.component is None else self.component.block(self.K)

    def displacement(self, w: fem.Function, name: str) -> fem.Function:
        """Return the displacement in w, a Function on `space`, renamed; not mixed: w itself."""
        u = w if self.component is None else self.component.extract(w)
        u.name = name
        return u

    @cached_property
    def prescribed_displacements(self) -> Mask:
        """(owned degrees of freedom of V, not `space`) whether each is prescribed. Collective."""
        if self.component is None:
            return self.prescribed
        flags = with_owned_values(self.space, self.prescribed)
        return np.asarray(owned_values(self.component.extract(flags)).ravel() > 0.0)

    @property
    def negative_pivots(self) -> int:
        """Number of free unknowns that are no displacements; see `cholesky`. Collective."""
        return int(self.comm.allreduce(int((~self.prescribed & ~self.moves).sum())))

    def strain_energy(self, u: PETSc.Vec) -> float:
        """Return the strain energy of u [energy], with the K that was assembled last. Collective.

        With K = (A, B'; B, -C) and u = (v, q) it is (v'A v + q'C q) / 2, not a(u, u) / 2, which has
        - q'C q. u has the prescribed values, which are zero for q.
        """
        # u'K u = u_f'(K_ff u_f + K_fp u_p) + u_p'K_pp u_p + u_p'K_pf u_f, with free unknowns f and
        # prescribed ones p: `product` has the forces of the first two terms
        work = (self.signs * u.array) @ self.product(u.array).array
        prescribed_forces = self.forces_of(u.array[self.prescribed]).array
        work += np.where(self.prescribed, 0.0, u.array) @ prescribed_forces
        return 0.5 * float(self.comm.allreduce(work))

    @contextmanager
    def loaded(self, L: ufl.Form) -> Iterator[None]:
        """Replace the form L inside the block; f is not assembled. Collective."""
        given = self._L
        self._L = forms.compiled("L", L, self.V.mesh, self.entity_maps)
        try:
            yield
        finally:
            self._L = given

    def assemble_forces(self) -> fem.Function:
        """Return the forces of L alone [force], zero except at free displacements. Collective."""
        forces = fem.Function(self.space)
        self._assemble_L(forces.x)
        forces.x.array[: len(self.moves)][~self.moves] = 0.0
        forces.x.scatter_forward()
        return forces

    def _assemble_L(self, x: Any) -> None:
        """Set the owned entries of a `la.Vector` to L, turned into the `frames`. Collective."""
        x.array[:] = 0.0
        if self._L is not None:
            fem.assemble_vector(x.array, self._L)
        x.scatter_reverse(dolfinx.la.InsertMode.add)
        if self.frames is not None:
            x.array[:] = self.frames.into_frames(x.array)

    def prescribed_values(self) -> Array:
        """Return the present values of prescribed owned unknowns, in the frames. Collective."""
        values = fem.Function(self.space)
        for bc in self.bcs:
            bc.set(values.x.array)
        if self.frames is not None:
            values = self.frames.deformation(values)
        return np.array(values.x.array[: len(self.prescribed)][self.prescribed])

    def response_to_prescribed_values(
        self, solver: StiffnessSolver, u: fem.Function
    ) -> fem.Function:
        """Return the displacement to be added to u as prescribed values change. Collective.

        Contact forces and loads stay, and u [length] has the previous prescribed values. An
        iterative solver is accurate to `ROUGH` only: the result predicts a configuration.
        """
        before, response = fem.Function(self.space), fem.Function(self.space)
        before.x.array[slice(None) if self.component is None else self.component.dofs] = u.x.array
        change = self.prescribed_values() - before.x.array[: len(self.prescribed)][self.prescribed]
        changed, largest = largest_abs(self.comm, change, u.x.array)
        if changed > ROUNDING * largest:
            forces = self.forces_of(change)
            forces.array = np.where(self.prescribed, 0.0, -forces.array)
            forces.array[self.prescribed] = change
            solver.improve(forces, response.x.petsc_vec, rtol=ROUGH, accuracy=0.0)
            response.x.scatter_forward()
        return self.displacement(response, "response")

    def assemble_load(self) -> None:
        """Assemble f from the present loads and prescribed values, and check it. Collective."""
        self._assemble_L(self.f.x)
        owned = self.f.x.array[: len(self.prescribed)]
        owned[self.prescribed] = self.prescribed_values()
        with errors_on_all_ranks(self.comm):
            if not self._coupled and owned[self.prescribed].any():
                raise InputError(
                    "the matrix a has nothing but a diagonal where bcs prescribe values that are "
                    "not zero, whose effect elsewhere is lost. Assemble it without bcs."
                )
        owned[~self.prescribed] -= self.forces_of(owned[self.prescribed]).array[~self.prescribed]
        self.f.x.scatter_forward()
        self._check_load()

    def _check_load(self) -> None:
        """Check that f is finite, and that prescribed pressures are zero. Collective."""
        values = self.f.x.array[: len(self.prescribed)][self.prescribed & (self.signs < 0.0)]
        with errors_on_all_ranks(self.comm):
            if values.any():
                raise InputError(
                    "of a mixed space only displacements may be prescribed to be other than zero, "
                    f"found {values[values.nonzero()[0][0]]:.3g} for another unknown."
                )
            if not np.isfinite(self.f.x.array).all():
                raise InputError(
                    "the load vector has entries that are NaN or infinite: check the coefficients "
                    "of L and the values of the Dirichlet conditions."
                )
