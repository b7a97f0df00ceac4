"""Elasticity tensors and loads of the user's forms, cell by cell."""

from __future__ import annotations

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import EntityMaps
from dolfinx_tresca.guaranteed.cells import MeshCells, lagrange, mean_products, symmetric
from dolfinx_tresca.stiffness.forms import has_stresses

#: Forces that a constant stiffness does not explain, relative to it, that count as rounding.
STIFFNESS_ROUNDING = 1e-9
#: Difference of the cosine of two unit normals from 1 that counts as rounding.
NORMAL_ROUNDING = 1e-8

#: Quadrature of loads, and of squared distances from their projections: exact for polynomials up to
#: degree 5. The degree that UFL estimates for sines would take four fifths of the time of a bound.
QUADRATURE = {"quadrature_degree": 10}


def elasticity(a: ufl.Form, cells: MeshCells, maps: EntityMaps | None) -> tuple[Array, ...]:
    """Return the elasticity tensors of a form a(w, v) in each cell, for stresses. Collective.

    For each matrix G with a single entry 1, the strain of w = G x causes forces a(w, v) on the
    quadratic displacements v of each cell. Their mean stresses, for symmetric G, are the tensor. An
    InputError is raised if a stress that is constant in each cell does not explain all forces.

    Returns:
        the tensors (n, d * d, d * d), their inverses (n, k, k) in the basis `symmetric`, and their
        least eigenvalues (n,).
    """
    mesh, (n, corners, d) = cells.V.mesh, cells.points.shape
    test, trial = a.arguments()
    slope = fem.Constant(mesh, np.zeros((d, d)))
    changes = {trial: slope * ufl.SpatialCoordinate(mesh), test: ufl.TestFunction(cells.quadratics)}
    work = fem.form(ufl.replace(a, changes), entity_maps=maps)
    results = []
    for gradient in np.eye(d * d).reshape(-1, d, d):
        slope.value = gradient
        results.append(fem.assemble_vector(work).array.reshape(-1, d)[cells.dofs])
    # forces (n, d * d, q, d) on the q nodes of a cell for each G, divided by the cell's volume
    forces = np.stack(results, axis=1) / cells.volumes[:, None, None, None]
    # a mean stress is the work of the forces, whose sum is zero, on linear functions
    nodes, basis, _ = lagrange(corners)
    offsets = nodes @ (cells.points - cells.points[:, :1])
    stresses = np.swapaxes(forces, 2, 3) @ offsets[:, None]
    moduli = symmetric(d).T @ stresses.reshape(n, d * d, d * d) @ symmetric(d)
    stiffness = symmetric(d) @ moduli @ symmetric(d).T
    least = np.linalg.eigvalsh(moduli)[:, 0]
    # A constant stress exerts on a node itself times the mean slope of the node's function, and
    # grad (lambda_i lambda_j) has the mean (grad lambda_i + grad lambda_j) / corners. No other
    # forces may remain: those of antisymmetric G would give rotations an energy.
    mean_slopes = 2.0 / corners * basis.sum(axis=0).T @ cells.gradients
    of_mean_stress = mean_slopes[:, None] @ stiffness.reshape(stresses.shape)
    difference = np.abs(forces - of_mean_stress).max(axis=(1, 2, 3), initial=0.0)
    rounding = STIFFNESS_ROUNDING * np.trace(moduli, axis1=1, axis2=2) / cells.heights.min(axis=1)
    kinds = {integral.integral_type() for integral in a.integrals()}
    cells.require(
        kinds == {"cell"} and (difference <= rounding).all() and (least > 0.0).all(),
        "a form a of integrals over cells, of the strain alone, with positive moduli that are "
        'constant in each cell: interpolate them into a space ("DG", 0). This form has moduli that '
        "vary in cells, or integrals over facets, or depends on the displacement itself, as "
        "springs do, or on a volume's mean, or gives rotations an energy",
    )
    return stiffness, np.asarray(np.linalg.inv(moduli)), np.asarray(least)


def loads(
    L: ufl.Form | None, cells: MeshCells, factors: Array, maps: EntityMaps | None
) -> tuple[Array, Array]:
    """Return a form's loads, projected onto linear functions, and bounds of the rest. Collective.

    `factors` (n, d + 2) bound the work of a load of norm 1 that is orthogonal to linear functions,
    in the cell and on each facet, on displacements of energy norm 1 in the cell.

    Returns:
        the loading (n, d + 1, d + 1, d) of the cells, with tractions on the boundary alone, and
        bounds (n,) of the work of loads minus their projections on displacements of energy norm 1.
    """
    mesh, (n, corners, d) = cells.V.mesh, cells.points.shape
    loading, oscillation = np.zeros((n, corners, corners, d)), np.zeros(n)
    if L is None:
        return loading, oscillation
    (argument,) = L.arguments()
    kinds = {integral.integral_type() for integral in L.integrals()}
    cells.require(
        kinds <= {"cell", "exterior_facet"} and not has_stresses(L),
        "a form L of integrals over cells and the boundary, of the displacement itself; this one "
        f"has integrals of the kinds {sorted(kinds)}, or depends on the gradient of the "
        "displacement, as an initial stress does",
    )
    # a projection in a cell is a function of this space; on a facet, its values at the vertices
    linears = fem.functionspace(mesh, ("DG", 1, (d,)))
    test, weight = map(ufl.TestFunction, (linears, fem.functionspace(mesh, ("DG", 0))))
    projection = fem.Function(linears)
    dofs = linears.dofmap.list[np.arange(n)[:, None], cells.order]
    # cells may have many facets on the boundary: integrals are over the one with this normal
    normal = fem.Function(fem.functionspace(mesh, ("DG", 0, (d,))))
    cosine = ufl.inner(ufl.FacetNormal(mesh), normal)
    on_facet = ufl.conditional(ufl.gt(cosine, 1.0 - NORMAL_ROUNDING), 1.0, 0.0)
    sizes = np.insert(cells.areas, 0, cells.volumes, axis=1)  # of the cell, then of each facet
    for integral in L.integrals():
        axes = (ufl.replace(integral.integrand(), {argument: ufl.as_vector(e)}) for e in np.eye(d))
        load = ufl.as_vector(list(axes))
        difference, on_domain, domains = load - projection, 1.0, range(1)  # 0 is the cell
        if integral.integral_type() != "cell":
            on_domain, domains = on_facet, range(1, corners + 1)
        moments, squares = (
            fem.form(
                ufl.Form([integral.reconstruct(on_domain * integrand, metadata=QUADRATURE)]),
                entity_maps=maps,
            )
            for integrand in (ufl.inner(load, test), ufl.inner(difference, difference) * weight)
        )
        for number in domains:
            dof = dofs[:, np.arange(corners) != number - 1]  # without the opposite vertex
            normal.x.array.reshape(-1, d)[:n] = cells.normals[:, number - 1]
            work = fem.assemble_vector(moments).array.reshape(-1, d)[dof]
            work /= sizes[:, number, None, None]
            values = np.linalg.inv(mean_products(dof.shape[1], 2)) @ work
            projection.x.array.reshape(-1, d)[dof] = values
            given = loading[:, number - 1, :d] if number else loading[:, :, d]
            given += values  # a view of the loading
            oscillation += factors[:, number] * np.sqrt(fem.assemble_vector(squares).array[:n])
    return loading, oscillation
