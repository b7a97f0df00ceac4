"""Simple tractions, whose products with A show how the bodies answer as a whole."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from dolfinx_tresca._parallel import reduce_array
from dolfinx_tresca.dual.diagonal import fit_diagonal, rough_vector
from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.dual.operator import DualOperator

#: Accuracy of the first product by iteration, which only a rough estimate of diag(A) needs.
ROUGH = 1e-2

#: Pairs up to which each has tractions that vary; with more pairs all are constant.
FEW_PAIRS = 4

#: Part of the largest eigenvalue of a Gram matrix from which on vectors count as independent.
INDEPENDENT = 1e-8


def affine_tractions(dual: DualOperator) -> Array:
    """Return orthonormal multipliers (size, k) that span the affine tractions. Collective.

    On each pair these are the pressures, and the tangential parts of the force densities, that are
    affine functions of the place: nine on a flat surface in space.
    """
    V = dual.system.V
    dim = V.mesh.geometry.dim
    points = V.tabulate_dof_coordinates()[:, :dim]
    columns = []
    for pair, (normal, tangential) in zip(dual.pairs, dual.slices, strict=True):
        x, weights = points[pair.nodes], pair.weights
        moments = reduce_array(dual.system.comm, np.append(weights @ x, weights.sum()))
        arm = x - moments[:dim] / moments[dim]
        square = reduce_array(dual.system.comm, weights @ np.square(arm).sum(axis=1))
        shapes = np.ones((len(x), 1))
        if len(dual.pairs) <= FEW_PAIRS and square > 0.0:
            shapes = np.column_stack([shapes, arm / np.sqrt(square / moments[dim])])
        pressures = np.zeros((len(dual.scale), shapes.shape[1]))
        pressures[normal] = shapes[pair.normal_node]
        columns.append(pressures)
        for shape in shapes[pair.tangent_node].T:
            shear = np.zeros((len(dual.scale), dim))
            shear[tangential] = shape[:, None] * pair.tangents
            columns.append(shear)
    tractions = np.column_stack(columns) / dual.scale[:, None]
    values, vectors = (dual.agreed(one) for one in eigh(dual.inner(tractions, tractions)))
    kept = values > INDEPENDENT * values[-1]
    result: Array = tractions @ (vectors[:, kept] / np.sqrt(values[kept]))
    return result


def first_products(dual: DualOperator) -> tuple[Array, Array, float]:
    """Return products that are known before the iteration, and estimate diag(A). Collective.

    Returns:
        multipliers x (size, k), the products A x (size, k), and their error in the norm
        sqrt(e'A^-1 e).
    """
    probe = rough_vector(dual)
    if dual.exact:
        # the probe last: the newest pair sets the scale of the model, and the basis is arbitrary
        first = np.column_stack([affine_tractions(dual), probe])
        products, error = dual.apply_to_all(first), 0.0
    else:
        first, products = probe[:, None], dual.apply(probe, rtol=ROUGH)[:, None]
        error = ROUGH * float(np.sqrt(dual.inner(probe, products[:, -1])))
    dual.diagonal = fit_diagonal(dual, probe, products[:, -1])
    return first, products, error
