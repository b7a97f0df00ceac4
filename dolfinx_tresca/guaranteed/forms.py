"""Elasticity tensors and loads of the user's forms, cell by cell."""

from __future__ import annotations

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
from dolfinx_tresca.dual.accuracy import with_gradient
from dolfinx_tresca.guaranteed.cells import (
    QUADRATIC_TRACE,
    TRACE,
    OwnedCells,
    basis_means,
    basis_nodes,
    opposite,
    require,
    symmetric_basis,
)
from dolfinx_tresca.stiffness.forms import has_stresses

#: Variation of a stiffness inside a cell, and energy of a rotation, relative to the stiffness, that
#: count as rounding.
STIFFNESS_ROUNDING = 1e-9

#: Square of the difference of two unit normals that counts as rounding.
NORMAL_ROUNDING = 1e-8

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
    scale = (d + 1) / owned.cells.volumes[:, None, None]
    values = np.stack(stresses, axis=2) * scale[:, :, None]  # (n, d + 1, d * d, d * d)
    every = values[:, :, : len(basis)] @ basis.reshape(-1, d * d).T
    result: Array = every.mean(axis=1)
    rounding = STIFFNESS_ROUNDING * np.trace(result, axis1=1, axis2=2)[:, None, None, None]
    turned = np.abs(values[:, :, len(basis) :]) <= rounding
    require(
        mesh.comm,
        turned.all(),
        "a form a of the symmetric gradient; this one gives rotations an energy",
    )
    require(
        mesh.comm,
        (np.abs(every - result[:, None]) <= rounding).all(),
        'a stiffness that is constant in each cell. Interpolate the moduli into a space ("DG", 0)',
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
    """

    load: Array
    traction: Array
    oscillation: Array


def loads(L: ufl.Form | None, owned: OwnedCells, factors: Array, maps: EntityMaps | None) -> Loads:
    """Return the loads of a linear form. Collective.

    Projections have the degree that UFL estimates, and are exact for polynomials; distances from
    them are exact for polynomials of degree up to 5, see `SQUARES`. The distance of a traction has
    a quadratic part, with a smaller factor, and the rest, the distance from quadratic functions.

    Args:
        L: the form.
        owned: the cells.
        factors: (n, d + 2) bounds of the work of a load of norm 1 that is orthogonal to linear
            functions, relative to the energy norm: in the cell, and on each facet.
        maps: entity maps of Functions on other meshes.

    Raises:
        InputError: L has integrals over interior facets, or depends on the gradient.
    """
    mesh, cells = owned.V.mesh, owned.cells
    n, corners, d = cells.points.shape
    result = Loads(np.zeros((n, corners, d)), np.zeros((n, corners, d, d)), np.zeros(n))
    if L is None:
        return result
    constant = fem.functionspace(mesh, ("DG", 0))
    weight, cell_dofs = ufl.TestFunction(constant), constant.dofmap.list[:n, 0]
    normal = fem.Function(fem.functionspace(mesh, ("DG", 0, (d,))))
    off = ufl.FacetNormal(mesh) - normal
    on_facet = ufl.conditional(ufl.lt(ufl.inner(off, off), NORMAL_ROUNDING), 1.0, 0.0)
    (argument,) = L.arguments()
    kinds = {integral.integral_type() for integral in L.integrals()}
    require(
        mesh.comm,
        kinds <= {"cell", "exterior_facet"} and not has_stresses(L),
        "a form L of integrals over cells and the boundary, of the displacement itself; this one "
        f"has integrals of the kinds {sorted(kinds)}, or depends on the gradient of the "
        "displacement, as an initial stress does",
    )
    for integral in L.integrals():
        kind, integrand = integral.integral_type(), integral.integrand()
        indicator, degree = 1.0, 1
        places = [(range(corners), cells.volumes, result.load)]
        if kind != "cell":
            indicator, degree = on_facet, 2
            places = [*zip(opposite(d), cells.areas.T, result.traction.swapaxes(0, 1), strict=True)]
        space, nodes = fem.functionspace(mesh, ("DG", degree, (d,))), basis_nodes(corners, degree)
        nearest, test = fem.Function(space), ufl.TestFunction(space)
        dofs = np.take_along_axis(space.dofmap.list[:n], owned.order[:, : len(nodes)], axis=1)
        axes = [ufl.replace(integrand, {argument: ufl.as_vector(axis)}) for axis in np.eye(d)]
        square = sum((load - nearest[i]) ** 2 for i, load in enumerate(axes))
        integrands = ufl.replace(integrand, {argument: test}), square * weight
        forces, squares = (
            fem.form(
                ufl.Form([integral.reconstruct(indicator * values, metadata=metadata)]),
                entity_maps=maps,
            )
            for values, metadata in zip(integrands, ({}, SQUARES), strict=True)
        )
        for j, (vertices, sizes, load) in enumerate(places):
            normal.x.array.reshape(-1, d)[cell_dofs] = cells.normals[:, j]
            mass, linear = basis_means(len(vertices), degree), basis_nodes(len(vertices), degree)
            among_vertices = nodes[:, vertices].sum(axis=1) == 1.0
            basis_dofs = dofs[:, among_vertices]
            moments = fem.assemble_vector(forces).array.reshape(-1, d)[basis_dofs]
            values = np.linalg.solve(mass, moments) / sizes[:, None, None]
            nearest.x.array[:] = 0.0
            nearest.x.array.reshape(-1, d)[basis_dofs] = values
            farther = np.sqrt(np.maximum(fem.assemble_vector(squares).array[cell_dofs], 0.0))
            projection = np.linalg.solve(linear.T @ mass @ linear, linear.T @ mass @ values)
            values -= linear @ projection
            load += projection  # a view of the result
            if kind == "cell":
                result.oscillation[:] += factors[:, 0] * farther
            else:
                quadratic = np.sqrt(sizes * (values * (mass @ values)).sum(axis=(1, 2)))
                work = largest_work(quadratic, farther, d)
                result.oscillation[:] += factors[:, 1 + j] * work
    return result


def largest_work(quadratic: Array, farther: Array, d: int) -> Array:
    """Return |t - t_h| cos(theta_F) (n,) of tractions on facets (docs/theory/guaranteed.md).

    The factor R_F of a traction that is orthogonal to linear functions is too large for its
    quadratic part, whose factor is Q_F: R_F cos(theta_F) is Q_F for quadratic tractions.

    Args:
        quadratic: (n,) norms of the quadratic parts of t - t_h.
        farther: (n,) distances of the tractions t from quadratic functions.
        d: dimension of space.
    """
    angle = np.arccos(QUADRATIC_TRACE[d] / TRACE[d]) - np.arctan2(farther, quadratic)
    return np.asarray(np.hypot(quadratic, farther) * np.cos(np.maximum(angle, 0.0)))
