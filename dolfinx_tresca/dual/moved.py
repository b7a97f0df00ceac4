"""The jump operator of displaced surfaces, and the transfer of multipliers and jumps to it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers, Mask
from dolfinx_tresca._base.owner import destroyed_on_error
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.pairing.moved import interpolate_in_geometry, pair_moved_surfaces
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair


def moved_jump(
    before: JumpOperator,
    pairs: Sequence[ContactPair],
    u: fem.Function,
    anew: Sequence[bool] | Mask | None = None,
) -> JumpOperator:
    """Return B of displaced surfaces, owned by the caller. Collective.

    The gap is the distance of the displaced surfaces plus N u, since it is compared with N times
    the total displacement. For curved edges of the secondary side the gap keeps the heights over
    chords of the previous B: further bending is in N u. Bent edges of the primary side may now face
    other nodes, and the distance is measured to these bent edges; so their bending is included in
    the N u that is added. Bonded pairs stay the same.

    Args:
        before: the previous B.
        pairs: the pairs of B.
        u: displacement [length].
        anew: for each pair whether it is paired anew; bonded pairs never are. None: all other
            pairs are.

    Raises:
        PairingError: the moved surfaces cannot be paired.
    """
    system = before.system
    prescribed = system.prescribed_displacements
    stay = [
        old.bonded or not new
        for old, new in zip(
            before.pairs, [True] * len(pairs) if anew is None else anew, strict=True
        )
    ]
    in_geometry = interpolate_in_geometry(u)
    operators = [
        old if stays else pair_moved_surfaces(u, prescribed, pair, system.axisymmetric, in_geometry)
        for stays, old, pair in zip(stay, before.pairs, pairs, strict=True)
    ]
    bends = in_geometry is not u  # edges that the mesh's geometry keeps straight
    straight = u.copy()  # the vector that the jump makes of u would be left to garbage collection
    if bends:
        straight.interpolate(in_geometry)
    jump = JumpOperator(system, operators)
    with destroyed_on_error(jump):
        for k, (one, old, pair, (normal, _)) in enumerate(
            zip(operators, before.pairs, pairs, jump.slices, strict=True)
        ):
            if not stay[k]:
                moves = _bent_primary(straight, u, pair) if bends else straight
                closed = jump.of_displacement(moves) * jump.length_scale
                raised = np.append(old.secondary_sagitta, 0.0)[_position(one.nodes, old.nodes)]
                distance = one.distance + one.secondary_sagitta - raised
                distance[one.normal_node] += closed[normal]
                operators[k] = dataclasses.replace(one, distance=distance, secondary_sagitta=raised)
        jump.set_distances(operators)
    return jump


def _bent_primary(straight: fem.Function, u: fem.Function, pair: ContactPair) -> fem.Function:
    """Return the displacement of the mesh's geometry, with bent primary edges. Collective.

    N of the result enters the gap. If the true surfaces are given, edges stay straight: the height
    of these surfaces over the facets is kept.

    Args:
        straight: the displacement interpolated in the degree of the geometry.
        u: displacement.
        pair: the surfaces.
    """
    V = u.function_space
    # A Function that was interpolated is in a reference cycle: ranks would free its vector, which
    # is collective, when their garbage collectors run.
    result, dim = straight.copy(), V.dofmap.index_map_bs
    if pair.geometry is not None or isinstance(pair.primary, RigidObstacle):
        return result
    facets = pair.facet_tags.find(pair.primary)
    nodes = fem.locate_dofs_topological(V, pair.facet_tags.dim, facets)
    result.x.array.reshape(-1, dim)[nodes] = u.x.array.reshape(-1, dim)[nodes]
    return result


def carried_over(values: Array, before: JumpOperator, after: JumpOperator) -> Array:
    """Return tractions or jumps (size,) at the same nodes, for another B. Not collective.

    A tangential vector loses its part that is normal to the new tangents. Values at new nodes are
    zero.

    Args:
        values: (size before,) or (size before, k) multipliers times `stress_scale`, or residuals
            times `length_scale`.
        before: B of the values.
        after: B of the same pairs.
    """
    result = np.zeros((len(after.gap), *values.shape[1:]))
    for one, old, (n, t), (old_n, old_t) in zip(
        after.pairs, before.pairs, after.slices, before.slices, strict=True
    ):
        found, count = _position(one.nodes, old.nodes), len(old.nodes) + 1  # the last for new nodes
        for rows, old_rows, new, known in (
            (n, old_n, _pressures(one), _pressures(old)),
            (t, old_t, (one.tangent_node, one.tangents), (old.tangent_node, old.tangents)),
        ):
            to = _components(found[new[0]], new[1], count)
            of = _components(known[0], known[1], count)
            result[rows] = to @ (of.T @ values[old_rows])
    return result


def carried_multipliers(x: Array, before: JumpOperator, after: JumpOperator) -> Array:
    """Return multipliers (size,) or (size, k) for another B, see `carried_over`."""
    return (carried_over((x.T * before.stress_scale).T, before, after).T / after.stress_scale).T


def carried_residuals(r: Array, before: JumpOperator, after: JumpOperator) -> Array:
    """Return residuals (size,) or (size, k) for another B, see `carried_over`."""
    return (carried_over((r.T * before.length_scale).T, before, after).T / after.length_scale).T


def _pressures(pair: PairOperators) -> tuple[LocalNumbers, Array]:
    """Return the nodes (n_normal,) of normal multipliers, and ones (n_normal, 1)."""
    return pair.normal_node, np.ones((len(pair.normal_node), 1))


def _components(nodes: Indices | LocalNumbers, vectors: Array, count: int) -> csr_array:
    """Return the matrix (n, d * count) from nodal vectors to components along vectors (n, d).

    Args:
        nodes: (n,) nodes of the components, in 0, ..., count - 1.
        vectors: (n, d) directions of the components.
        count: number of nodes.
    """
    number, dim = vectors.shape
    columns = dim * nodes[:, None] + np.arange(dim)
    ends = dim * np.arange(number + 1)
    return csr_array((vectors.ravel(), columns.ravel(), ends), (number, dim * count))


def _position(nodes: LocalNumbers, others: LocalNumbers) -> Indices:
    """Return the position (n,) of each node among others; len(others) if it is missing.

    A node on a sharp edge occurs once for each of its normals: its occurrences are matched in
    order.
    """
    known = {key: k for k, key in enumerate(_numbered(others))}
    return np.array([known.get(key, len(others)) for key in _numbered(nodes)], dtype=np.intp)


def _numbered(nodes: LocalNumbers) -> list[tuple[int, int]]:
    """Return each node with the number of its earlier occurrences."""
    count: dict[int, int] = {}
    result = []
    for node in map(int, nodes):
        count[node] = count.get(node, -1) + 1
        result.append((node, count[node]))
    return result
