"""Elasticity tensors and loads of the user's forms, cell by cell."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Argument, Grad
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps, interpolation_points
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.dual.bounds.estimate import with_gradient
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.simplices import Simplices, mean_products
from dolfinx_tresca.guaranteed.stress_element import stress_element
from dolfinx_tresca.stiffness.forms import has_stresses

#: Variation of a stiffness inside a cell, and energy of a rotation, relative to the stiffness, that
#: count as rounding.
STIFFNESS_ROUNDING = 1e-9

#: Square of the difference of two unit normals that counts as rounding.
NORMAL_ROUNDING = 1e-8

NEEDED = "a guaranteed bound needs "


def elasticity(a: ufl.Form, cells: Simplices, mesh: Any, maps: EntityMaps | None) -> Array:
    """Return the elasticity tensors (n, nsym, nsym) of owned cells in `StressElement.basis`.

    Collective.

    Raises:
        InputError: a depends on more than the symmetric gradient, or a tensor varies in a cell.
    """
    for integral in apply_derivatives(apply_algebra_lowering(a)).integrals():
        if integral.integral_type() != "cell":
            raise InputError(
                f"{NEEDED}a form a of integrals over cells alone, found one of the kind "
                f"'{integral.integral_type()}'."
            )
        bare = [
            node
            for node in unique_pre_traversal(integral.integrand())
            if any(isinstance(child, Argument) for child in node.ufl_operands)
            and not isinstance(node, Grad)
        ]
        if bare:
            raise InputError(
                f"{NEEDED}a form a of the strain alone; this one also depends on the displacement "
                "itself, as springs do, or on a volume's mean."
            )
    dim = mesh.geometry.dim
    space = fem.functionspace(mesh, ("DG", 1))
    gradient = fem.Constant(mesh, np.zeros((dim, dim)))
    form = _compiled(with_gradient(a, gradient, ufl.TestFunction(space)), maps)
    scale = (dim + 1) / cells.volumes[:, None]
    dofs = space.dofmap.list[: len(cells.points)]

    def energies(tensor: Array) -> Array:
        gradient.value = tensor
        return np.asarray(scale * np.asarray(fem.assemble_vector(form).array)[dofs])

    basis = stress_element(dim).basis
    diagonal = [energies(tensor) for tensor in basis]
    at_vertices = np.empty((len(dofs), dim + 1, len(basis), len(basis)))
    for i, energy in enumerate(diagonal):
        at_vertices[:, :, i, i] = energy
    for i, j in combinations(range(len(basis)), 2):
        both = 0.5 * (energies(basis[i] + basis[j]) - diagonal[i] - diagonal[j])
        at_vertices[:, :, i, j] = at_vertices[:, :, j, i] = both
    result: Array = at_vertices.mean(axis=1)
    size = np.trace(result, axis1=1, axis2=2)
    turned = np.zeros(len(dofs))
    for i, j in combinations(range(dim), 2):
        rotation = np.zeros((dim, dim))
        rotation[i, j], rotation[j, i] = 1.0, -1.0
        turned = np.maximum(turned, np.abs(energies(rotation)).max(axis=1))
    with errors_on_all_ranks(mesh.comm):  # the cells of one rank may be at fault
        if (turned > STIFFNESS_ROUNDING * size).any():
            raise InputError(
                f"{NEEDED}a form a of the symmetric gradient; this one gives rotations an energy."
            )
        spread = np.abs(at_vertices - result[:, None]).max(axis=(1, 2, 3), initial=0.0)
        if (spread > STIFFNESS_ROUNDING * size).any():
            raise InputError(
                f"{NEEDED}a stiffness that is constant in each cell. Interpolate the moduli into a "
                'space ("DG", 0).'
            )
        if not (np.linalg.eigvalsh(result)[:, 0] > 0.0).all():
            raise InputError(f"{NEEDED}a stiffness in every cell, and positive moduli.")
    return result


@dataclass
class Loads:
    """The loads of owned cells, as in `CellData`, and their differences from what is balanced.

    Attributes:
        load: (n, d + 1, d + 1, d) integrals of f lambda_i lambda_k over cells.
        traction: (n, d + 1, d + 1, d + 1, d) integrals of t lambda_i lambda_k over facets j.
        load_rest: (n,) bound of the norm of f minus its linear projection.
        traction_rest: (n, d + 1) bound of the norm of t minus its linear projection on facets.
    """

    load: Array
    traction: Array
    load_rest: Array
    traction_rest: Array


def loads(L: ufl.Form | None, cells: Simplices, mesh: Any, maps: EntityMaps | None) -> Loads:
    """Return the loads of a linear form. Collective.

    Integrals have the degree that UFL estimates: exact for polynomials.

    Raises:
        InputError: L has integrals over interior facets, or depends on the gradient.
    """
    n, corners, dim = cells.points.shape
    result = Loads(
        np.zeros((n, corners, corners, dim)),
        np.zeros((n, corners, corners, corners, dim)),
        np.zeros(n),
        np.zeros((n, corners)),
    )
    if L is None:
        return result
    spaces = {k: fem.functionspace(mesh, ("DG", k, (dim,) if k else ())) for k in range(3)}
    moments_of, weight = ufl.TestFunction(spaces[2]), ufl.TestFunction(spaces[0])
    linear = fem.Function(spaces[1])
    points = interpolation_points(spaces[2].element)
    hats = np.column_stack([1.0 - points.sum(axis=1), points])
    pairs = np.einsum("ai,ak->aik", hats, hats)
    axes = [ufl.as_vector(row) for row in np.eye(dim)]
    normal = fem.Function(fem.functionspace(mesh, ("DG", 0, (dim,))))

    def by_cell(form: fem.Form, degree: int, width: int) -> Array:
        values = np.asarray(fem.assemble_vector(form).array).reshape(-1, width)
        return np.asarray(values[spaces[degree].dofmap.list[:n]])

    def set_values(function: fem.Function, values: Array) -> None:
        dofs = function.function_space.dofmap.list[:n]
        function.x.array.reshape(-1, dim)[dofs] = values.reshape(*dofs.shape, dim)

    for integral in apply_derivatives(apply_algebra_lowering(L)).integrals():
        kind, integrand = integral.integral_type(), integral.integrand()
        if kind not in ("cell", "exterior_facet"):
            raise InputError(
                f"{NEEDED}loads on cells and on the boundary, found an integral of the kind "
                f"'{kind}' in L."
            )
        if has_stresses(ufl.Form([integral])):
            raise InputError(
                f"{NEEDED}a form L of the displacement itself; this one depends on its gradient, "
                "as an initial stress does."
            )
        there: Any = 1.0
        if kind == "exterior_facet":
            off = ufl.FacetNormal(mesh) - normal
            there = ufl.conditional(ufl.lt(ufl.inner(off, off), NORMAL_ROUNDING), 1.0, 0.0)
        (argument,) = L.arguments()
        whole, rest = (
            _compiled(ufl.Form([integral.reconstruct(integrand=there * one, metadata={})]), maps)
            for one in (
                ufl.replace(integrand, {argument: moments_of}),
                weight
                * sum(
                    (ufl.replace(integrand, {argument: axis}) - linear[i]) ** 2
                    for i, axis in enumerate(axes)
                ),
            )
        )
        for j in range(corners if kind == "exterior_facet" else 1):
            set_values(normal, cells.normals[:, j])
            products = np.einsum("nax,aik->nikx", by_cell(whole, 2, dim), pairs)
            if kind == "cell":
                inverse = np.linalg.inv(mean_products(corners, 2))
                projected = inverse @ products.sum(axis=2) / cells.volumes[:, None, None]
                result.load += products
            else:
                on_facet = np.arange(corners) != j
                projected = np.zeros((n, corners, dim))
                inverse = np.linalg.inv(mean_products(dim, 2))
                projected[:, on_facet] = (
                    inverse @ products.sum(axis=2)[:, on_facet] / cells.areas[:, j, None, None]
                )
                result.traction[:, j] += products
            set_values(linear, projected)
            distance = np.sqrt(np.maximum(by_cell(rest, 0, 1)[:, 0, 0], 0.0))
            if kind == "cell":
                result.load_rest += distance
            else:
                result.traction_rest[:, j] += distance
    return result


def _compiled(form: ufl.Form, maps: EntityMaps | None) -> fem.Form:
    return fem.form(form, **({} if maps is None else {"entity_maps": maps}))


def displacement_gradients(values: Array, cells: Simplices, edges: Array) -> Array:
    """Return the gradients (n, d + 1, d, d) of displacements at the vertices of cells.

    Args:
        values: (n, k, d) displacement at the vertices of each cell, and for degree 2 also at the
            midpoints of its edges.
        cells: the cells.
        edges: (e, 2) the vertices of each edge.
    """
    corners = cells.points.shape[1]
    slopes = cells.gradients
    if values.shape[1] == corners:
        constant = np.einsum("nka,nkb->nab", values, slopes)
        return np.repeat(constant[:, None], corners, axis=1)
    # of lambda_k (2 lambda_k - 1) and 4 lambda_i lambda_j
    own = 4.0 * np.eye(corners) - 1.0
    result: Array = np.einsum("vk,nka,nkb->nvab", own, values[:, :corners], slopes, optimize=True)
    for (i, j), middle in zip(edges, np.swapaxes(values[:, corners:], 0, 1), strict=True):
        result[:, i] += 4.0 * np.einsum("na,nb->nab", middle, slopes[:, j])
        result[:, j] += 4.0 * np.einsum("na,nb->nab", middle, slopes[:, i])
    return result
