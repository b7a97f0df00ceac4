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
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.dual.mesh_error import with_gradient
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.cells import mean_products, opposite, stress_element
from dolfinx_tresca.guaranteed.mesh_cells import OwnedCells
from dolfinx_tresca.stiffness.forms import has_stresses

#: Variation of a stiffness inside a cell, and energy of a rotation, relative to the stiffness, that
#: count as rounding.
STIFFNESS_ROUNDING = 1e-9

#: Square of the difference of two unit normals that counts as rounding.
NORMAL_ROUNDING = 1e-8

NEEDED = "a guaranteed bound needs "


def elasticity(a: ufl.Form, owned: OwnedCells, maps: EntityMaps | None) -> Array:
    """Return the elasticity tensors (n, nsym, nsym) of owned cells in `StressElement.basis`.

    Collective.

    Raises:
        InputError: a depends on more than the symmetric gradient, or a tensor varies in a cell.
    """
    integrals = apply_derivatives(apply_algebra_lowering(a)).integrals()
    kinds = {integral.integral_type() for integral in integrals} - {"cell"}
    if kinds:
        raise InputError(
            f"{NEEDED}a form a of integrals over cells alone, found one of the kind "
            f"'{kinds.pop()}'."
        )
    if any(
        isinstance(child, Argument) and not isinstance(node, Grad)
        for integral in integrals
        for node in unique_pre_traversal(integral.integrand())
        for child in node.ufl_operands
    ):
        raise InputError(
            f"{NEEDED}a form a of the strain alone; this one also depends on the displacement "
            "itself, as springs do, or on a volume's mean."
        )
    mesh, d = owned.V.mesh, owned.cells.d
    tensors, at_vertices = (fem.functionspace(mesh, ("DG", k, (d, d))) for k in (0, 1))
    gradient = fem.Function(tensors)
    form = with_gradient(a, gradient, 0.5)
    for direction in (ufl.TestFunction(tensors), ufl.TrialFunction(at_vertices)):
        form = ufl.derivative(form, gradient, direction)
    matrix = fem.assemble_matrix(_compiled(form, maps)).to_scipy().tobsr((d * d, d * d))
    n = len(owned.order)
    values = matrix.data.reshape(-1, d + 1, d * d, d * d)[tensors.dofmap.list[:n, 0]]
    values *= (d + 1) / owned.cells.volumes[:, None, None, None]
    basis = stress_element(d).basis.reshape(-1, d * d)
    every = basis @ values @ basis.T
    result: Array = every.mean(axis=1)
    size = np.trace(result, axis1=1, axis2=2)
    rotations = np.array([np.outer(i, j) - np.outer(j, i) for i, j in combinations(np.eye(d), 2)])
    turned = np.abs(rotations.reshape(-1, d * d) @ values).max(axis=(1, 2, 3), initial=0.0)
    with errors_on_all_ranks(mesh.comm):  # the cells of one rank may be at fault
        if (turned > STIFFNESS_ROUNDING * size).any():
            raise InputError(
                f"{NEEDED}a form a of the symmetric gradient; this one gives rotations an energy."
            )
        spread = np.abs(every - result[:, None]).max(axis=(1, 2, 3), initial=0.0)
        if (spread > STIFFNESS_ROUNDING * size).any():
            raise InputError(
                f"{NEEDED}a stiffness that is constant in each cell. Interpolate the moduli into a "
                'space ("DG", 0).'
            )
        if not (np.linalg.eigvalsh(result)[:, 0] > 0.0).all():
            raise InputError(f"{NEEDED}a stiffness in every cell, and positive moduli.")
    return result


@dataclass(frozen=True)
class Loads:
    """The linear projections of the loads of owned cells, and their distances from the loads.

    Attributes:
        load: (n, d + 1, d) load at the vertices.
        traction: (n, d + 1, d, d) tractions on the boundary, facet by facet at its vertices.
        load_distance: (n,) bound of the norm of the load minus its projection.
        traction_distance: (n, d + 1) bound of the same norm on each facet.
    """

    load: Array
    traction: Array
    load_distance: Array
    traction_distance: Array


def loads(L: ufl.Form | None, owned: OwnedCells, maps: EntityMaps | None) -> Loads:
    """Return the loads of a linear form. Collective.

    Integrals have the degree that UFL estimates: exact for polynomials.

    Raises:
        InputError: L has integrals over interior facets, or depends on the gradient.
    """
    mesh, cells = owned.V.mesh, owned.cells
    n, corners, d = cells.points.shape
    result = Loads(
        np.zeros((n, corners, d)),
        np.zeros((n, corners, d, d)),
        np.zeros(n),
        np.zeros((n, corners)),
    )
    if L is None:
        return result
    constant = fem.functionspace(mesh, ("DG", 0))
    linear = fem.functionspace(mesh, ("DG", 1, (d,)))
    weight, moments = ufl.TestFunction(constant), ufl.TestFunction(linear)
    projection = fem.Function(linear)
    dofs = np.take_along_axis(linear.dofmap.list[:n], owned.order, axis=1)
    normal = fem.Function(fem.functionspace(mesh, ("DG", 0, (d,))))
    off = ufl.FacetNormal(mesh) - normal
    on_facet = ufl.conditional(ufl.lt(ufl.inner(off, off), NORMAL_ROUNDING), 1.0, 0.0)
    (argument,) = L.arguments()
    if has_stresses(L):
        raise InputError(
            f"{NEEDED}a form L of the displacement itself; this one depends on its gradient, as an "
            "initial stress does."
        )
    for integral in L.integrals():
        kind = integral.integral_type()
        if kind not in ("cell", "exterior_facet"):
            raise InputError(
                f"{NEEDED}loads on cells and on the boundary, found an integral of the kind "
                f"'{kind}' in L."
            )
        indicator = 1.0 if kind == "cell" else on_facet
        load = [ufl.replace(integral.integrand(), {argument: axis}) for axis in _axes(d)]
        distance = sum((load[i] - projection[i]) ** 2 for i in range(d))
        forms = [
            _compiled(
                ufl.Form([integral.reconstruct(integrand=indicator * integrand, metadata={})]), maps
            )
            for integrand in (
                ufl.replace(integral.integrand(), {argument: moments}),
                distance * weight,
            )
        ]
        for j in range(1 if kind == "cell" else corners):
            vertices = np.arange(corners) if kind == "cell" else opposite(d)[j]
            sizes = cells.volumes if kind == "cell" else cells.areas[:, j]
            normal.x.array.reshape(-1, d)[constant.dofmap.list[:n, 0]] = cells.normals[:, j]
            forces = fem.assemble_vector(forms[0]).array.reshape(-1, d)[dofs[:, vertices]]
            inverse = np.linalg.inv(mean_products(len(vertices), 2))
            values = inverse @ forces / sizes[:, None, None]
            projection.x.array[:] = 0.0
            projection.x.array.reshape(-1, d)[dofs[:, vertices]] = values
            squares = fem.assemble_vector(forms[1]).array[constant.dofmap.list[:n, 0]]
            norms = np.sqrt(np.maximum(squares, 0.0))
            if kind == "cell":
                result.load[:] += values
                result.load_distance[:] += norms
            else:
                result.traction[:, j] += values
                result.traction_distance[:, j] += norms
    return result


def _axes(d: int) -> list[Any]:
    return [ufl.as_vector(row) for row in np.eye(d)]


def _compiled(form: ufl.Form, maps: EntityMaps | None) -> fem.Form:
    return fem.form(form, **({} if maps is None else {"entity_maps": maps}))
