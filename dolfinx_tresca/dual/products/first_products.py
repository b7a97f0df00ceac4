"""The first product with A, and the estimate of diag(A) that follows from it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import ROUGH
from dolfinx_tresca._base.mixing import splitmix64
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca._base.vertices import numbers_in_file
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.operator import DualOperator
from dolfinx_tresca.optimise.models.products import ProductStore


def first_products(
    operator: DualOperator, compliance: Array, near_field: Callable[[Array], Array] | None
) -> ProductStore:
    """Return a store with an estimate of diag(A), from the product with random signs. Collective.

    The mean of x_i (A x)_i for random signs x_i estimates the mean of A_ii (Hutchinson 1989, A
    stochastic estimator of the trace of the influence matrix). A_ii is nearly proportional to the
    compliance of a node whose neighbours are fixed, which depends on materials, edges and cell
    sizes. Therefore only two factors are fitted for a pair: one for all normal multipliers, and one
    for all tangential multipliers.

    If there is a near field, it replaces A in this product, since the effect of random signs is
    local; the store then has no products with A.

    Args:
        operator: A.
        compliance: (size,) compliance of nodes whose neighbours are fixed, the same for all
            directions of a friction disc.
        near_field: function that applies the near field to multipliers (size,); None: there is
            none.
    """
    jump = operator.jump
    signs, error = rademacher_vector(jump), 0.0
    if near_field is None:
        product, error = operator.product(signs, ROUGH)
    else:
        product = near_field(signs)
    diagonal = rescaled_diagonal(jump, compliance, jump, signs * product, compliance)
    store = ProductStore(jump.reductions, diagonal)
    if near_field is None:
        store.add(signs, product, error)
    return store


def rademacher_vector(jump: JumpOperator) -> Array:
    """Return a vector (size,) of random signs, equal on all partitions.

    The sign depends on the node's number in the mesh file, through a mixing of the number's bits.
    """
    file_number = numbers_in_file(jump.system.V).astype(np.uint64)
    signs = []
    for pair in jump.pairs:
        for kind, rows in enumerate((pair.normal_node, pair.tangent_node)):
            repeat = np.zeros(len(rows), dtype=int)
            repeat[1:] = rows[1:] == rows[:-1]  # the second tangent of a node
            seed = file_number[pair.nodes[rows]] * 4 + (kind + repeat).astype(np.uint64)
            signs.append(1.0 - 2.0 * (splitmix64(seed) & np.uint64(1)).astype(float))
    return np.concatenate(signs)


def rescaled_diagonal(
    jump: JumpOperator,
    compliance: Array,
    before: JumpOperator,
    diagonal: Array,
    before_compliance: Array,
) -> Array:
    """Return an estimate (size,) of diag(A) from diag(A) of an earlier B or K. Collective.

    The estimate is the compliance times the ratio of the earlier diag(A) to the earlier compliance,
    both summed over the normal or over the tangential multipliers of each pair.

    Args:
        jump: B.
        compliance: (size,) compliance of nodes whose neighbours are fixed.
        before: an earlier B, of the same pairs.
        diagonal: (size before,) diag(A) for the earlier B.
        before_compliance: (size before,) compliance of nodes whose neighbours are fixed, for the
            earlier B and K.
    """
    parts = [part for slices in before.slices for part in slices]
    sums = [(diagonal[part].sum(), before_compliance[part].sum()) for part in parts]
    totals = reduce_array(jump.comm, sums)
    overall, overall_size = totals.sum(axis=0)
    mean = overall / overall_size if overall_size > 0.0 else 1.0
    result = np.empty_like(compliance)
    after = [part for slices in jump.slices for part in slices]
    for part, (energy, size) in zip(after, totals, strict=True):
        # the sum over few nodes may even be negative: the mean of all pairs is then used instead
        factor = energy / size if energy > 0.0 else mean
        result[part] = factor * compliance[part]
    return result
