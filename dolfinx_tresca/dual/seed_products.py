"""Products with simple tractions, which show how the bodies answer as a whole."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.diagonal import estimate_diagonal, rademacher_vector
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.operator import DualOperator
from dolfinx_tresca.optimise.products import ProductStore

#: Accuracy of the first product by iteration, which only a rough estimate of diag(A) needs.
SEED_ACCURACY = 3e-3

#: Pairs up to which each has tractions that vary; with more pairs all are constant.
FEW_PAIRS = 4

#: Part of the largest eigenvalue of a Gram matrix from which on vectors count as independent.
INDEPENDENT = 1e-8


def affine_tractions(jump: JumpOperator) -> Array:
    """Return orthonormal multipliers (size, k) that span the affine tractions. Collective.

    On each pair these are the pressures, and the tangential parts of the force densities, that are
    affine functions of the place: nine on a flat surface in space.
    """
    V = jump.system.V
    dim = V.mesh.geometry.dim
    points = V.tabulate_dof_coordinates()[:, :dim]
    columns = [np.zeros((len(jump.gap), 0))]
    for pair, (normal, tangential) in zip(jump.pairs, jump.slices, strict=True):
        x, weights = points[pair.nodes], pair.weights
        moments = reduce_array(jump.comm, np.append(weights @ x, weights.sum()))
        if moments[dim] == 0.0:  # surfaces that do not face each other have no nodes
            continue
        arm = x - moments[:dim] / moments[dim]
        square = reduce_array(jump.comm, weights @ np.square(arm).sum(axis=1))
        shapes = np.ones((len(x), 1))
        if len(jump.pairs) <= FEW_PAIRS and square > 0.0:
            shapes = np.column_stack([shapes, arm / np.sqrt(square / moments[dim])])
        pressures = np.zeros((len(jump.gap), shapes.shape[1]))
        pressures[normal] = shapes[pair.normal_node]
        columns.append(pressures)
        for shape in shapes[pair.tangent_node].T:
            shear = np.zeros((len(jump.gap), dim))
            shear[tangential] = shape[:, None] * pair.tangents
            columns.append(shear)
    tractions = np.column_stack(columns) / jump.stress_scale[:, None]
    values, vectors = (
        jump.reductions.from_first_rank(one)
        for one in eigh(jump.reductions.inner(tractions, tractions))
    )
    kept = values > INDEPENDENT * values.max(initial=0.0)
    result: Array = tractions @ (vectors[:, kept] / np.sqrt(values[kept]))
    return result


def seed_products(
    operator: DualOperator,
    local_compliance: Array,
    affine: bool = True,
    near_field: Callable[[Array], Array] | None = None,
) -> ProductStore:
    """Return products that are there before the iteration, with an estimate of diag(A). Collective.

    No products where a near field tells the diagonal, since random signs are felt nearby only.

    Args:
        operator: A.
        local_compliance: (size,) of nodes that move alone, the same for all directions of a
            friction disc.
        affine: whether products with affine tractions are worth their cost, where they come in one
            block: not near the solution.
        near_field: applies the near field; None: there is none.
    """
    jump = operator.jump
    probe = rademacher_vector(jump)
    if near_field is not None:
        diagonal = estimate_diagonal(jump, local_compliance, probe, near_field(probe))
        return ProductStore(jump.reductions, diagonal)
    if operator.exact and affine:
        # the probe last: the newest pair sets the scale of the model, and the basis is arbitrary
        first = np.column_stack([affine_tractions(jump), probe])
        products, error = operator.apply_to_all(first), 0.0
    else:
        product, error = operator.product(probe, None if operator.exact else SEED_ACCURACY)
        first, products = probe[:, None], product[:, None]
    diagonal = estimate_diagonal(jump, local_compliance, probe, products[:, -1])
    store = ProductStore(jump.reductions, diagonal)
    for x, product in zip(first.T, products.T, strict=True):
        store.add(x, product, error)
    return store
