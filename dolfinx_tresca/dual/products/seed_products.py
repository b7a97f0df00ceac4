"""Products with affine tractions, which describe the response of whole bodies."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import ROUGH
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.diagonal import estimate_diagonal, rademacher_vector
from dolfinx_tresca.dual.products.operator import DualOperator
from dolfinx_tresca.optimise.models.products import ProductStore
from dolfinx_tresca.surface.numbering import label_bodies, labels_of

#: Largest number of groups of pairs for which the seed tractions vary linearly over each group; for
#: more groups, the tractions are constant on each group.
FEW_GROUPS = 4

#: Vectors count as linearly dependent if an eigenvalue of their Gram matrix is at most this
#: fraction of the largest eigenvalue.
INDEPENDENT = 1e-8


def affine_tractions(jump: JumpOperator) -> Array:
    """Return orthonormal multipliers (size, k) that span the affine tractions. Collective.

    On each group of pairs, the affine tractions are the pressures that are affine functions of the
    position, and the tangential parts of the force densities that are affine functions of the
    position: nine on a flat surface in 3D. If there are more than `FEW_GROUPS` groups, only the
    constant tractions are returned.
    """
    V = jump.system.V
    dim = V.mesh.geometry.dim
    points = V.tabulate_dof_coordinates()[:, :dim]
    columns = [np.zeros((len(jump.gap), 0))]
    groups = _groups_of_pairs(jump)
    for group in groups:
        pairs = [jump.pairs[k] for k in group]
        x = np.concatenate([points[pair.nodes] for pair in pairs])
        weights = np.concatenate([pair.weights for pair in pairs])
        moments = reduce_array(jump.comm, np.append(weights @ x, weights.sum()))
        if moments[dim] == 0.0:  # surfaces that do not face each other have no nodes
            continue
        arm = x - moments[:dim] / moments[dim]
        square = reduce_array(jump.comm, weights @ np.square(arm).sum(axis=1))
        shapes = np.ones((len(x), 1))
        if len(groups) <= FEW_GROUPS and square > 0.0:
            shapes = np.column_stack([shapes, arm / np.sqrt(square / moments[dim])])
        pressures = np.zeros((len(jump.gap), shapes.shape[1]))
        shears = np.zeros((len(jump.gap), shapes.shape[1], dim))
        ends = np.cumsum([len(pair.nodes) for pair in pairs])[:-1]
        for k, own in zip(group, np.split(shapes, ends), strict=True):
            pair, (normal, tangential) = jump.pairs[k], jump.slices[k]
            pressures[normal] = own[pair.normal_node]
            shears[tangential] = own[pair.tangent_node, :, None] * pair.tangents[:, None]
        columns += [pressures, *shears.swapaxes(0, 1)]
    tractions = np.column_stack(columns) / jump.stress_scale[:, None]
    values, vectors = (
        jump.reductions.from_first_rank(one)
        for one in eigh(jump.reductions.inner(tractions, tractions))
    )
    kept = values > INDEPENDENT * values.max(initial=0.0)
    result: Array = tractions @ (vectors[:, kept] / np.sqrt(values[kept]))
    return result


def _groups_of_pairs(jump: JumpOperator) -> list[list[int]]:
    """Return the numbers of the pairs in each group. Collective.

    If there are few pairs (`FEW_GROUPS`), each pair is a group of its own. Otherwise the pairs that
    join the same bodies are one group, which saves products: as a whole, a body responds to forces
    on 50 strips of its surface about as it responds to the same forces on one surface.
    """
    if len(jump.pairs) <= FEW_GROUPS:
        return [[k] for k in range(len(jump.pairs))]
    V = jump.system.V
    label = label_bodies(V)
    primary = [pair.primary.indices for pair in jump.pairs]
    numbers = np.unique(np.concatenate(primary))
    label_of_primary = labels_of(V, label, numbers.astype(np.int64))
    bodies = [
        {*label[pair.nodes], *label_of_primary[np.searchsorted(numbers, nodes)]}
        for pair, nodes in zip(jump.pairs, primary, strict=True)
    ]
    groups: dict[frozenset[int], list[int]] = {}
    for k, of_ranks in enumerate(zip(*jump.comm.allgather(bodies), strict=True)):
        groups.setdefault(frozenset().union(*of_ranks), []).append(k)
    return list(groups.values())


def seed_products(
    operator: DualOperator,
    local_compliance: Array,
    affine: bool = True,
    near_field: Callable[[Array], Array] | None = None,
) -> ProductStore:
    """Return a store with an estimate of diag(A) and the first products with A. Collective.

    The diagonal is estimated from the product of A with a vector of random signs. If there is a
    near field, it replaces A in this product, since the effect of random signs is local; the store
    then has no products with A. Otherwise the store keeps the product with the random signs. With a
    direct solver, the store also gets the products with affine tractions, which are solved for as
    one block.

    Args:
        operator: A.
        local_compliance: (size,) compliance of nodes whose neighbours are fixed, the same for all
            directions of a friction disc.
        affine: whether to compute products with affine tractions, which save later products only if
            the iteration starts far from the solution.
        near_field: function that applies the near field to multipliers (size,); None: there is
            none.
    """
    jump = operator.jump
    probe = rademacher_vector(jump)
    if near_field is not None:
        diagonal = estimate_diagonal(jump, local_compliance, probe, near_field(probe))
        return ProductStore(jump.reductions, diagonal)
    if operator.exact and affine:
        # the vector of random signs comes last: the newest product sets the scale of the model,
        # and the order of the affine tractions is arbitrary
        first = np.column_stack([affine_tractions(jump), probe])
        products, error = operator.apply_to_all(first), 0.0
    else:
        product, error = operator.product(probe, ROUGH)
        first, products = probe[:, None], product[:, None]
    diagonal = estimate_diagonal(jump, local_compliance, probe, products[:, -1])
    store = ProductStore(jump.reductions, diagonal)
    for x, product in zip(first.T, products.T, strict=True):
        store.add(x, product, error)
    return store
