"""The function space of the forms, its displacement component, and checks of forms and of K."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

import basix
import ufl
from dolfinx import fem
from dolfinx.cpp.fem import DirichletBC_float64
from dolfinx.mesh import MeshTags
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Argument, Grad
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca._base.arguments import check_type
from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.compat import EntityMaps, collapse, contains, same_topology
from dolfinx_tresca._base.functions import zero_like
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca._base.petsc import sparse_matrix
from dolfinx_tresca._base.tolerances import ASSEMBLY_ROUNDING
from dolfinx_tresca.errors import InputError, StiffnessError


def compiled(name: str, form: Any, mesh: Any, entity_maps: EntityMaps | None) -> Any:
    """Return a form of UFL compiled, and any other object unchanged. Collective."""
    if not isinstance(form, ufl.Form):
        return form
    for coefficient in form.coefficients():
        if coefficient.function_space.mesh != mesh and not entity_maps:
            raise InputError(
                f"the form {name} holds the Function '{coefficient.name}' on another mesh than the "
                "problem's: take solution.on_mesh(...), or entity_maps=surface.entity_maps."
            )
    for integral in form.integrals():
        tags = integral.subdomain_data()
        if isinstance(tags, MeshTags) and not same_topology(tags, mesh):
            # DOLFINx would integrate over entities with the same numbers
            raise InputError(
                f"the form {name} has an integral over tags on another mesh than the problem's."
            )
    try:
        return fem.form(form, entity_maps=entity_maps)
    except Exception as error:  # UFL, FFCx and DOLFINx raise any error, on all ranks
        why = str(error).rstrip(".") or type(error).__name__
        raise InputError(
            f"the form {name} cannot be compiled: {why}. All integrals must be over the problem's "
            "mesh, and those of a kind must have the same tags."
        ) from error


def coefficients(form: Any) -> list[npt.NDArray[Any]]:
    """Return this rank's values of a UFL form's coefficients and constants, of others nothing."""
    if not isinstance(form, ufl.Form):
        return []
    functions = [function.x.array for function in form.coefficients()]
    return functions + [constant.value for constant in form.constants()]


#: Cells whose facets are all of one type.
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def has_stresses(L: Any) -> bool:
    """Return whether a UFL form L has derivatives of its test function, as for thermal strains."""
    if not isinstance(L, ufl.Form):
        return False
    return any(
        isinstance(node, Grad) and isinstance(node.ufl_operands[0], Argument)
        for integral in apply_derivatives(apply_algebra_lowering(L)).integrals()
        for node in unique_pre_traversal(integral.integrand())
    )


def form_space(a: Any, L: Any, bcs: Sequence[Any], V: Any = None) -> Any:
    """Return the space of the forms, after a check that forms and conditions suit contact.

    V is the space if neither a nor L is a form of UFL. If several sub-spaces of a mixed space suit
    displacements, V is the sub-space of the displacement, and the result is the mixed space.
    """
    # types and arguments of the forms
    given = "a UFL form, {}, or a compiled form together with V="
    one_space = " Of several unknowns make one space, with basix.ufl.mixed_element."
    check_type("a", a, ufl.Form | fem.Form | PETSc.Mat, given.format("a PETSc.Mat"), one_space)
    check_type("L", L, ufl.Form | fem.Form | None, given.format("None for no load"))
    check_type("bcs", bcs, Sequence, "a sequence of Dirichlet conditions")
    check_type("V", V, fem.FunctionSpace | None, "the function space of the displacement")
    arguments = [2 if isinstance(a, PETSc.Mat) else len(_spaces(a)), len(_spaces(L))]
    if arguments != [2, 0 if L is None else 1]:
        raise InputError(
            f"a needs a trial and a test function, L a test function; found {arguments[0]} and "
            f"{arguments[1]} arguments.{one_space}"
        )
    # the space of the arguments: that of UFL forms, or V
    forms = [form for form in (a, L) if isinstance(form, ufl.Form)]
    if V is None and not forms:
        raise InputError(
            "the space of the displacement is not known: a and L are not forms of UFL, so give V=."
        )
    space = forms[-1].arguments()[-1].ufl_function_space() if forms else V
    if V is not None and not _is_part(V, space):
        space = V
    if any(each is not space._cpp_object for form in (a, L) for each in _spaces(form)):
        raise InputError(
            "the arguments of a and L are from different function spaces, or not from V."
        )
    # numbers of type float64, cells, and conditions
    mesh = space.mesh
    fields = [field for form in forms for field in (*form.coefficients(), *form.constants())]
    for name, typed in (("the mesh", mesh.geometry.x), *zip(map(str, fields), fields, strict=True)):
        if typed.dtype != np.float64:
            raise InputError(
                f"contact needs a mesh, and forms of numbers, of type float64, found "
                f"{np.dtype(typed.dtype)} in {name}: leave dtype=... away where it is made."
            )
    dim, cell = mesh.geometry.dim, mesh.topology.cell_name()
    if mesh.topology.dim != dim or cell not in CELLS:
        raise InputError(
            f"contact needs a mesh of {', '.join(CELLS)} cells in 2D or 3D, found {cell} cells of "
            f"dimension {mesh.topology.dim} in space of dimension {dim}: gdim is 2 in 2D."
        )
    for number, bc in enumerate(bcs):
        kind = "a Dirichlet condition of type float64, as dolfinx.fem.dirichletbc(...) makes it"
        check_type(f"bcs[{number}]", getattr(bc, "_cpp_object", bc), DirichletBC_float64, kind)
        if not contains(space, bc):
            raise InputError(
                f"bcs[{number}] is on another function space than the forms: take V, or V.sub(i)."
            )
    return space


def _spaces(form: Any) -> Sequence[Any]:
    """Return the C++ function spaces of a form's arguments; none of a matrix or None."""
    if isinstance(form, ufl.Form):
        return [argument.ufl_function_space()._cpp_object for argument in form.arguments()]
    return form.function_spaces if isinstance(form, fem.Form) else ()


def _is_part(V: Any, space: Any) -> bool:
    """Return whether `space` is mixed, and V a sub-space that `space.sub` has made."""
    mixed = space.dofmap.index_map_bs == 1
    return mixed and len(V.component()) == 1 and bool(space._cpp_object.contains(V._cpp_object))


def component_index(space: Any, V: Any = None) -> int | None:
    """Return the index of the sub-space of the displacement; None: the space is not mixed."""
    dim, element = space.mesh.geometry.dim, space.ufl_element()
    if _suits(element, dim):
        return None
    sub_elements = element.sub_elements if space.dofmap.index_map_bs == 1 else []
    suitable = [index for index, sub_element in enumerate(sub_elements) if _suits(sub_element, dim)]
    if V is not None and _is_part(V, space):
        suitable = [index for index in suitable if index == V.component()[0]]
    if len(suitable) > 1:
        raise InputError(
            f"the sub-spaces {suitable} of the mixed space could all be the displacement's: give "
            f"one of them, such as V=W.sub({suitable[0]})."
        )
    if not suitable:
        raise InputError(
            f'contact needs the space functionspace(mesh, ("Lagrange", 1, ({dim},))), or degree 2, '
            f"or a mixed space with such a component, found {element}."
        )
    return suitable[0]


def _suits(element: Any, dim: int) -> bool:
    """Return whether an element suits displacements: continuous vectors of degree 1 or 2."""
    return bool(
        element.reference_value_shape == (dim,)
        and element.block_size == dim
        and element.element_family == basix.ElementFamily.P
        and element.degree in (1, 2)
        and not element.discontinuous
    )


class Component:
    """The displacement in a mixed space, as a space V with a numbering of its own.

    A node on the border of two ranks may have different owners in V and in the mixed space. So an
    owned value of V may be a ghost value in the mixed space.

    Attributes:
        V: the collapsed sub-space, on which Functions can be created.
        dofs: for each degree of freedom of V, with ghosts, its local number in the mixed space.
        mask: (owned degrees of freedom of the mixed space,) whether each is in the component.
    """

    def __init__(self, space: Any, index: int) -> None:
        """Collapse a sub-space, which gives its degrees of freedom other numbers. Collective."""
        self.comm = space.mesh.comm
        self.V, self.dofs = collapse(space.sub(index))
        self._original = fem.Function(self.V)
        own, whole = self.V.dofmap, space.dofmap.index_map
        self.mask: Mask = np.isin(np.arange(whole.size_local), self.dofs)
        owned = own.index_map.size_local * own.index_map_bs
        entries = np.ones(owned), whole.local_to_global(self.dofs[:owned]), np.arange(owned + 1)
        rows = csr_array(entries, shape=(owned, whole.size_global))
        self._parts = sparse_matrix(rows, (whole.size_local, whole.size_global), space.mesh.comm)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._parts.destroy()

    def extract(self, w: fem.Function) -> fem.Function:
        """Return this component of w, whose ghost values must be up to date. Not collective."""
        component = zero_like(self._original, w.name)
        component.x.array[:] = w.x.array[self.dofs]
        return component

    def columns(self, B: PETSc.Mat) -> PETSc.Mat:
        """Return B, whose columns are those of V, on the mixed space; the caller owns it."""
        return B.matMult(self._parts)

    def block(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return the component's block of K, numbered like V; the caller owns it. Collective."""
        return K.ptap(self._parts.copy().transpose())


def copied(K: PETSc.Mat, V: Any) -> PETSc.Mat:
    """Return a copy of the user's matrix K on V, of DOLFINx's matrix type. Collective."""
    if not K.handle:
        raise InputError("the matrix a was destroyed: keep it as long as the problem assembles K.")
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    total = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
    sizes = K.getSizes()
    with errors_on_all_ranks(V.mesh.comm):
        if sizes != ((owned, total), (owned, total)):
            raise InputError(
                f"the matrix a must have the size of V, {total} rows and columns, {owned} of them "
                f"on this rank, found {sizes[0][1]} and {sizes[1][1]}, {sizes[0][0]} on this rank."
            )
    if not K.isAssembled():
        raise InputError("the matrix a is not assembled: call a.assemble() first.")
    return K.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())


def check_meridian(mesh: Any) -> None:
    """Check that a mesh may be a meridian: in 2D, with no negative radius x[0]. Collective."""
    dim, radii = mesh.geometry.dim, mesh.geometry.x[:, 0]
    least, largest = reduce_array(
        mesh.comm, [radii.min(initial=np.inf), -np.abs(radii).max(initial=0.0)], MPI.MIN
    )
    if dim != 2 or least < 1e-9 * largest:  # `largest` is negative; less is rounding
        geometry = f"a mesh in {dim}D" if dim != 2 else f"x[0] down to {least:.3g}"
        raise InputError(
            "axisymmetric=True needs a mesh in 2D, whose x[0] is the radius and not negative, and "
            f"whose x[1] is along the axis, found {geometry}."
        )


def check_hoop_stiffness(K: PETSc.Mat) -> None:
    """Check that an axisymmetric K, before the elimination, has hoop stiffness. Collective."""
    motion, force = K.createVecs()
    motion.array = np.tile([1.0, 0.0], motion.local_size // 2)
    K.mult(motion, force)
    resistance, largest = (v.norm(PETSc.NormType.INFINITY) for v in (force, K.getDiagonal()))
    if resistance <= ASSEMBLY_ROUNDING * largest:
        raise InputError(
            "the form a does not resist a radial translation: an axisymmetric one has the hoop "
            "strain u[0] / x[0] and the factor 2 * pi * x[0], with x = SpatialCoordinate(mesh)."
        )


def check_symmetry(K: PETSc.Mat, cure: str) -> None:
    """Check that K x = K'x for an oscillating x, which is cheaper than K - K'. Collective."""
    x, Kx = K.createVecs()
    x.array = np.cos(12.9898 * np.arange(*x.getOwnershipRange()))
    K.mult(x, Kx)
    scale, defect = Kx.norm(), x.duplicate()
    K.multTranspose(x, defect)
    defect.axpy(-1.0, Kx)
    if defect.norm() > 1e-10 * scale:  # less is rounding of the assembly
        raise StiffnessError(
            f"the stiffness matrix is not symmetric (relative defect {defect.norm() / scale:.1e}): "
            f"the form a(u, v) must equal a(v, u). {cure}"
        )


def check_signs(K: PETSc.Mat, not_displacement: Mask) -> None:
    """Check that C in (A, B'; B, -C) has no negative diagonal entry. Collective."""
    # -C is in the rows of the mask (owned unknowns,); the pivots do not show its signs
    entries = K.getDiagonal().array[not_displacement]
    largest = K.comm.tompi4py().allreduce(float(entries.max(initial=-np.inf)), op=MPI.MAX)
    if largest > 0.0:
        raise StiffnessError(
            f"K has {largest:.3g} on the diagonal of an unknown that is no displacement: in a form "
            "with - c(p, q), c(p, p) must be >= 0. Check signs, and Poisson's ratio (at most 0.5)."
        )
