"""Elasticity tensors and loads of the user's forms, cell by cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Argument, Grad
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca._base.parallel import summed_at_nodes
from dolfinx_tresca.dual.mesh_error import with_gradient
from dolfinx_tresca.guaranteed.cells import hat_means, opposite, symmetric_basis
from dolfinx_tresca.guaranteed.mesh_cells import OwnedCells, require
from dolfinx_tresca.pairing.search.facets import tabulate
from dolfinx_tresca.stiffness.forms import has_stresses

#: Variation of a stiffness inside a cell, and energy of a rotation, relative to the stiffness, that
#: count as rounding.
STIFFNESS_ROUNDING = 1e-9

#: Value of the hat function of the opposite vertex that counts as rounding on a facet.
HAT_ROUNDING = 1e-9

#: Quadrature of the squared distance of a load from its projection: exact for polynomials of degree
#: up to 5. With the degree that UFL estimates, four fifths of the time of a bound were spent here
#: for loads of sines and cosines.
SQUARES = {"quadrature_degree": 10}


def elasticity(a: ufl.Form, owned: OwnedCells, maps: EntityMaps | None) -> Array:
    """Return the elasticity tensors (n, nsym, nsym) of owned cells in `symmetric_basis`.

    Collective.

    Raises:
        InputError: a depends on more than the symmetric gradient, or a tensor varies in a cell.
    """
    mesh, d = owned.V.mesh, owned.cells.d
    integrals = apply_derivatives(apply_algebra_lowering(a)).integrals()
    of_strain = all(
        integral.integral_type() == "cell"
        and (isinstance(node, Grad) or not isinstance(child, Argument))
        for integral in integrals
        for node in unique_pre_traversal(integral.integrand())
        for child in node.ufl_operands
    )
    require(
        mesh.comm,
        of_strain,
        "a form a of integrals over cells, of the strain alone; this one also has integrals over "
        "facets, or depends on the displacement itself, as springs do, or on a volume's mean",
    )
    constant, linear = (fem.functionspace(mesh, ("DG", k, (d, d))) for k in (0, 1))
    gradient = fem.Function(constant)
    energy = with_gradient(a, gradient, 0.5)
    work = fem.form(ufl.derivative(energy, gradient, ufl.TestFunction(linear)), entity_maps=maps)
    basis = symmetric_basis(d)
    rotations = [np.outer(i, j) - np.outer(j, i) for i, j in combinations(np.eye(d), 2)]
    dofs, stresses = linear.dofmap.list[: len(owned.order)], []
    for tensor in [*basis, *rotations]:
        gradient.x.array.reshape(-1, d * d)[:] = tensor.ravel()
        stresses.append(fem.assemble_vector(work).array.reshape(-1, d * d)[dofs])
    scale = (d + 1) / owned.cells.volumes[:, None, None, None]
    values = np.stack(stresses, axis=3) * scale  # (n, d + 1, d * d, tensors)
    result: Array = basis.reshape(-1, d * d) @ values.mean(axis=1)[:, :, : len(basis)]
    expected = np.zeros_like(values[:, 0])
    expected[:, :, : len(basis)] = basis.reshape(-1, d * d).T @ result
    rounding = STIFFNESS_ROUNDING * np.trace(result, axis1=1, axis2=2)[:, None, None, None]
    require(
        mesh.comm,
        (np.abs(values - expected[:, None]) <= rounding).all(),
        "a stiffness that is constant in each cell, and an energy of the symmetric gradient, not "
        'of rotations. Interpolate moduli that vary into a space ("DG", 0)',
    )
    positive = (np.linalg.eigvalsh(result) > 0.0).all()
    require(mesh.comm, positive, "a stiffness in every cell, and positive moduli")
    return result


@dataclass(frozen=True)
class Loads:
    """The linear projections of the loads of owned cells, and bounds of their distances.

    Attributes:
        load: (n, d + 1, d) load at the vertices.
        traction: (n, d + 1, d, d) tractions on the boundary, facet by facet at its vertices.
        oscillation: (n,) bound of what the loads minus their projections do.
        nodal_forces: (nodes, d) the work of the loads on the basis of the displacement.
    """

    load: Array
    traction: Array
    oscillation: Array
    nodal_forces: Array


def loads(
    forms: Sequence[ufl.Form], owned: OwnedCells, factors: Array, maps: EntityMaps | None
) -> Loads:
    """Return the loads of the sum of linear forms. Collective.

    Projections have the degree that UFL estimates, and are exact for polynomials; distances from
    them are exact for polynomials of degree up to 5, see `SQUARES`.

    Args:
        forms: the forms.
        owned: the cells.
        factors: (n, d + 2) bounds of the work of a load of norm 1 that is orthogonal to linear
            functions, relative to the energy norm: in the cell, and on each facet.
        maps: entity maps of Functions on other meshes.

    Raises:
        InputError: a form has integrals over interior facets, or depends on the gradient.
    """
    V, cells = owned.V, owned.cells
    mesh, element = V.mesh, V.element.basix_element
    n, corners, d = cells.points.shape
    scalars = fem.functionspace(mesh, ("DG", 0))
    moments = fem.functionspace(mesh, ("DG", element.degree, (d,)))
    weight, test = ufl.TestFunction(scalars), ufl.TestFunction(moments)
    projection, opposite_hat = fem.Function(moments), fem.Function(moments)
    on_facet = ufl.conditional(ufl.lt(opposite_hat[0], HAT_ROUNDING), 1.0, 0.0)
    cell_dofs, dofs = scalars.dofmap.list[:n, 0], moments.dofmap.list[:n]
    # the hat functions of vertices at the nodes (n, k, d + 1) of cells
    hats = tabulate(element.cell_type.name, 1, 0, element.points)[0][:, owned.order]
    hats = np.ascontiguousarray(np.swapaxes(hats, 0, 1))
    load, traction = np.zeros((n, corners, d)), np.zeros((n, corners, d, d))
    oscillation, forces_in_cells = np.zeros(n), np.zeros((*dofs.shape, d))
    in_cell = [(np.arange(corners), cells.volumes, load)]
    on_facets = [*zip(opposite(d), cells.areas.T, np.moveaxis(traction, 1, 0), strict=True)]
    for form in forms:
        (argument,) = form.arguments()
        kinds = {integral.integral_type() for integral in form.integrals()}
        require(
            mesh.comm,
            kinds <= {"cell", "exterior_facet"} and not has_stresses(form),
            "a form L of integrals over cells and the boundary, of the displacement itself; this "
            f"one has integrals of the kinds {sorted(kinds)}, or depends on the gradient of the "
            "displacement, as an initial stress does",
        )
        for integral in form.integrals():
            integrand, inside = integral.integrand(), integral.integral_type() == "cell"
            axes = [ufl.replace(integrand, {argument: ufl.as_vector(axis)}) for axis in np.eye(d)]
            square = sum((value - projection[i]) ** 2 for i, value in enumerate(axes))
            place = 1.0 if inside else on_facet
            work = ufl.replace(integrand, {argument: test})
            work_form, square_form = (
                fem.form(ufl.Form([term]), entity_maps=maps)
                for term in (
                    integral.reconstruct(place * work, metadata={}),
                    integral.reconstruct(place * weight * square, metadata=SQUARES),
                )
            )
            for j, (vertices, sizes, projected) in enumerate(in_cell if inside else on_facets):
                opposite_hat.x.array.reshape(-1, d)[dofs] = hats[:, :, [j]]
                forces = fem.assemble_vector(work_form).array.reshape(-1, d)[dofs]
                forces_in_cells += forces
                on_hats = np.swapaxes(hats[:, :, vertices], 1, 2) @ forces
                values = np.linalg.inv(hat_means(np.eye(len(vertices)))) @ on_hats
                values /= sizes[:, None, None]
                projection.x.array.reshape(-1, d)[dofs] = hats[:, :, vertices] @ values
                squares = fem.assemble_vector(square_form).array[cell_dofs]
                projected += values
                oscillation += factors[:, 0 if inside else 1 + j] * np.sqrt(np.maximum(squares, 0))
    nodal_forces = summed_at_nodes(V.dofmap.index_map, V.dofmap.list[:n], forces_in_cells)
    return Loads(load, traction, oscillation, nodal_forces)
