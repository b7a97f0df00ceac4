"""Admissible contact tractions on the facets of cells, and what they lack of the law of contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import basix
import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.simplices import mean_products
from dolfinx_tresca.pairing.operators import as_petsc
from dolfinx_tresca.scene.friction import Frictionless
from dolfinx_tresca.scene.obstacle import RigidPlane
from dolfinx_tresca.scene.pair import ContactPair

#: Difference of unit normals, and of lengths relative to the facet, that count as rounding.
FLATNESS = 1e-8

#: Penetration relative to the largest displacement that counts as rounding.
PENETRATION = 1e-10


@dataclass(frozen=True)
class ContactFacets:
    """The facets of a pair's secondary side with contact tractions; k counts their vertices.

    Attributes:
        pair: the contact pair.
        rows: its rows of B.
        cell: (m,) owned cell of each facet.
        facet: (m,) its number in the cell.
        corners: (m, d) its vertices in the cell.
        normals: (m, d) contact normals.
        gaps: (m, d) gap at each vertex [length].
        bounds: (m, d) slip bound at each vertex [stress].
        origins: (m, d, d) tangential jump at each vertex from which the slip counts [length].
        tractions: (m, d, d) traction on the secondary side at each vertex [stress], linear between.
        edges: (m, e) nodes in the middles of its edges, in the order of `np.triu_indices`; e = 0
            for degree 1.
        others: the cells, facets and vertices of the primary side, with the tractions on them.
    """

    pair: ContactPair
    rows: RowsOfPair
    cell: Indices
    facet: Indices
    corners: Indices
    normals: Array
    gaps: Array
    bounds: Array
    origins: Array
    tractions: Array
    edges: Indices
    others: tuple[Indices, Indices, Indices, Array]

    @classmethod
    def of(
        cls,
        V: Any,
        dual: DualProgram,
        pair: ContactPair,
        rows: RowsOfPair,
        multipliers: Array,
        gradient: Array,
        prescribed: Mask,
    ) -> ContactFacets:
        """Collect the facets of a pair, with tractions interpolated between nodes. Collective.

        Args:
            V: the space of the displacement.
            dual: the dual problem.
            pair: the pair.
            rows: its rows of B.
            multipliers: (size,) the multipliers.
            gradient: (size,) the gradient at the multipliers.
            prescribed: (nodes of this rank, d) prescribed degrees of freedom.

        Raises:
            InputError: the bound does not cover such surfaces, or such friction.
        """
        jump, on = dual.jump, rows.operators
        index_map, dim = V.dofmap.index_map, V.mesh.geometry.dim
        name = f"contact pair {pair}"
        rigid = isinstance(pair.primary, RigidPlane)
        with errors_on_all_ranks(V.mesh.comm):
            if not rigid and not isinstance(pair.primary, int):
                raise InputError(
                    f"a guaranteed bound needs rigid planes or meshes that match, and {name} has "
                    f"{pair.primary} as its primary side."
                )
            if (on.semi_axes != 1.0).any():
                raise InputError(
                    f"a guaranteed bound needs the same slip bound in all directions, and {name} "
                    "has two bounds."
                )
            if len(np.unique(on.nodes)) < len(on.nodes):
                raise InputError(
                    f"a guaranteed bound needs a flat surface, and {name} has sharp edges. Make a "
                    "pair of each side."
                )
        radius = dual.bounds(multipliers, gradient).radius
        areas = np.concatenate([pair_.weights for pair_ in jump.pairs])
        stress = multipliers * jump.stress_scale
        table = np.zeros((len(on.nodes), 3 * dim + 5 + dim))
        normal, traction, origin, scalars, offset = np.split(
            table, np.cumsum([dim, dim, dim, 5]), axis=1
        )
        normal[:] = on.normals
        traction[:] = -on.tangential_vectors(stress[rows.tangential])
        traction[on.normal_node] -= stress[rows.normal, None] * on.normals[on.normal_node]
        slip_origin = dual.response.offset - jump.gap
        origin[:] = on.tangential_vectors((slip_origin * jump.length_scale)[rows.tangential])
        scalars[:, 0] = on.gap
        scalars[:, 1] = 0.0 if on.bonded else radius[rows.nodes] / np.sqrt(areas[rows.nodes])
        scalars[:, 2] = 1.0
        scalars[on.normal_node, 3] = 1.0
        axes = np.bincount(on.tangent_node, minlength=len(on.nodes))
        scalars[:, 4] = (axes == dim - 1) | isinstance(pair.friction, Frictionless)
        at_primary = None
        if not rigid:
            at_primary, offset[:] = _on_primary(V, on, traction, name)
        spread = dolfinx.la.vector(index_map, table.shape[1])
        spread.array[:] = 0.0
        cell, facet, corners, nodes = _facets(V, *pair.given_tags("secondary"))
        at_nodes = spread.array.reshape(-1, table.shape[1])
        at_nodes[on.nodes] = table
        if rigid and pair.gap is not None:
            lacking = _used(index_map, nodes)
            lacking[on.nodes] = False
            lacking &= prescribed[: len(lacking)].all(axis=1)
            numbers = np.flatnonzero(lacking).astype(np.int32)
            at_nodes[numbers, 3 * dim] = NodalValues(V).at(pair.gap, numbers, f"the gap of {name}")
        spread.scatter_forward()
        at_nodes = spread.array.reshape(-1, table.shape[1])[nodes]
        with errors_on_all_ranks(V.mesh.comm):
            if not rigid and V.element.basix_element.degree > 1:
                raise InputError(
                    f"a guaranteed bound for degree 2 needs rigid planes, and {name} is between "
                    "two bodies. Take degree 1."
                )
            at_nodes, keep = _completed(V, pair, at_nodes, nodes, prescribed, name)
        cell, facet, corners = cell[keep], facet[keep], corners[keep]
        normal, traction, origin, scalars, offset = np.split(
            at_nodes, np.cumsum([dim, dim, dim, 5]), axis=2
        )
        edges = np.zeros((len(cell), 0), dtype=np.intp)
        if V.element.basix_element.degree > 1:
            edges = V.dofmap.list[cell[:, None], dim + 1 + _edges_of(V.mesh, corners)]
        with errors_on_all_ranks(V.mesh.comm):
            if (np.abs(normal - normal[:, :1]) > FLATNESS).any():
                raise InputError(
                    f"a guaranteed bound needs contact normals that do not turn, and those of "
                    f"{name} do. Replace curved surfaces by planes."
                )
            nothing = np.zeros(0, np.intp)
            others: tuple[Indices, Indices, Indices, Array] = (
                *(nothing, nothing, nothing.reshape(0, dim)),
                np.zeros((0, dim, dim)),
            )
            if at_primary is not None:
                x = V.mesh.geometry.x[:, :dim]
                size = np.ptp(x, axis=0).max(initial=0.0)
                if (np.abs(offset - offset[:, :1]) > FLATNESS * size).any():
                    raise _no_match(name)
                others = _primary_facets(V, pair, at_primary, len(cell), name)
        if at_primary is not None:
            counts = V.mesh.comm.allreduce(np.array([len(cell), len(others[0])]))
            if counts[0] != counts[1]:
                raise _no_match(name)
        return cls(
            pair,
            rows,
            cell,
            facet,
            corners,
            normal[:, 0],
            scalars[:, :, 0],
            scalars[:, :, 1],
            origin,
            traction,
            edges,
            others,
        )


def _no_match(name: str) -> InputError:
    return InputError(
        f"a guaranteed bound needs meshes that match where bodies touch, and those of {name} do "
        "not. Make both surfaces of one mesh."
    )


def _on_primary(V: Any, on: Any, traction: Array, name: str) -> tuple[Array, Array]:
    """Return tractions at this rank's nodes opposite to nodes (nodes, d + 1), and offsets (n, d).

    The last column is 1 at opposite nodes. Collective.
    """
    dim, comm = V.mesh.geometry.dim, V.mesh.comm
    index_map = V.dofmap.index_map
    with errors_on_all_ranks(comm):
        counts = np.diff(on.primary.indptr)
        if (counts != 1).any() or (np.abs(on.primary.data - 1.0) > FLATNESS).any():
            raise _no_match(name)
    matrix = as_petsc(index_map, 1, [on.primary], comm)
    at_nodes, rows = matrix.createVecs()
    spread = dolfinx.la.vector(index_map, dim + 1)
    columns = spread.array.reshape(-1, dim + 1)
    owned = index_map.size_local
    for axis, values in enumerate([*(-traction.T), np.ones(len(traction))]):
        rows.array = values
        matrix.multTranspose(rows, at_nodes)
        columns[:owned, axis] = at_nodes.array
    spread.scatter_forward()
    points = V.tabulate_dof_coordinates()[:owned, :dim]
    offset = np.empty((len(traction), dim))
    for axis in range(dim):
        at_nodes.array = points[:, axis]
        matrix.mult(at_nodes, rows)
        offset[:, axis] = rows.array - points[on.nodes, axis]
    for owner in (matrix, at_nodes, rows):
        owner.destroy()
    return columns.copy(), offset


def _primary_facets(
    V: Any, pair: ContactPair, at_primary: Array, wanted: int, name: str
) -> tuple[Indices, Indices, Indices, Array]:
    cell, facet, corners, nodes = _facets(V, *pair.given_tags("primary"))
    values = at_primary[nodes]
    keep = (np.abs(values[:, :, -1] - 1.0) < FLATNESS).all(axis=1)
    if (values[~keep, :, :-1] != 0.0).any():
        raise _no_match(name)
    return cell[keep], facet[keep], corners[keep], values[keep, :, :-1]


def _facets(V: Any, tags: Any, numbers: tuple[int, ...]) -> tuple[Indices, ...]:
    """Return cell, number in the cell, vertices in the cell (m, d), and nodes of tagged facets."""
    topology = V.mesh.topology
    tdim = topology.dim
    facets = np.concatenate([tags.find(number) for number in numbers])
    facets = facets[facets < topology.index_map(tdim - 1).size_local]
    to_cell, to_facet = topology.connectivity(tdim - 1, tdim), topology.connectivity(tdim, tdim - 1)
    cell = to_cell.array[to_cell.offsets[facets]]
    own = to_facet.array.reshape(-1, tdim + 1)[cell]
    facet = np.argmax(own == facets[:, None], axis=1)
    opposite = np.array([[k for k in range(tdim + 1) if k != j] for j in range(tdim + 1)])
    corners = opposite[facet]
    nodes = V.dofmap.list[cell[:, None], corners]
    return cell.astype(np.intp), facet, corners, nodes


def _edges_of(mesh: Any, corners: Indices) -> Indices:
    """Return the numbers (m, e) in the cell of the edges of facets with vertices (m, d)."""
    numbers = np.zeros((mesh.topology.dim + 1,) * 2, dtype=np.intp)
    for number, (a, b) in enumerate(basix.topology(mesh.basix_cell())[1]):
        numbers[a, b] = numbers[b, a] = number
    first, second = np.triu_indices(corners.shape[1], 1)
    return np.asarray(numbers[corners[:, first], corners[:, second]])


def _used(index_map: Any, nodes: Indices) -> Mask:
    """Return which owned nodes are among the nodes of any rank. Collective."""
    flags = dolfinx.la.vector(index_map, 1)
    flags.array[:] = 0.0
    flags.array[nodes.ravel()] = 1.0
    flags.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.asarray(flags.array[: index_map.size_local] > 0.0)


def _completed(
    V: Any, pair: ContactPair, values: Array, nodes: Indices, prescribed: Mask, name: str
) -> tuple[Array, Mask]:
    """Complete the data (m, d, .) at vertices without multipliers, and select facets in contact.

    Where multipliers are missing since the displacement is prescribed, the facet's other vertices
    tell the traction. If all of it is prescribed, they also tell the normal and the bound, and the
    gap is measured. Facets whose vertices beyond the rim have no multipliers are not in contact.
    """
    dim = V.mesh.geometry.dim
    gap, bound, flag = 3 * dim, 3 * dim + 1, 3 * dim + 2
    present = values[:, :, flag] > 0.0
    keep: Mask = np.asarray(present.any(axis=1))
    missing: Mask = np.asarray(keep[:, None] & ~present)
    fixed = prescribed[nodes].all(axis=2) & isinstance(pair.primary, RigidPlane)
    beyond = (missing & ~fixed).any(axis=1)
    if (values[beyond, :, dim : 2 * dim] != 0.0).any():
        raise InputError(
            f"a guaranteed bound needs multipliers at all nodes of pressed facets, and {name} has "
            "pressed facets at a rim, or at prescribed nodes of two bodies."
        )
    keep &= ~beyond
    facet, k = np.nonzero(missing & keep[:, None])
    if isinstance(pair.primary, RigidPlane) and len(facet):
        donor = np.argmax(present[facet], axis=1)
        values[facet, k, :dim] = values[facet, donor, :dim]
        values[facet, k, bound] = values[facet, :, bound].max(axis=1)
        distance, normals = pair.primary.at(V.tabulate_dof_coordinates()[nodes[facet, k]])
        cosine = -np.einsum("md,md->m", values[facet, k, :dim], normals[:, :dim])
        values[facet, k, gap] += distance / cosine
    values = values[keep]
    tractions, normals = values[:, :, dim : 2 * dim], values[:, :, :dim]
    pressed = np.einsum("mkd,mkd->mk", tractions, normals)[:, :, None] * normals
    for part, column in ((pressed, flag + 1), (tractions - pressed, flag + 2)):
        has = values[:, :, column] > 0.0
        mean = np.einsum("mk,mkd->md", has, part) / np.maximum(has.sum(axis=1), 1)[:, None]
        lacks = ~has & prescribed[nodes[keep]].any(axis=2)
        rest = np.where(lacks[:, :, None], mean[:, None] - part, 0.0)
        if column == flag + 2:
            size = np.linalg.norm(rest, axis=2)
            within = np.minimum(1.0, values[:, :, bound] / np.maximum(size, LEAST_DIVISOR))
            rest *= within[:, :, None]
        tractions += rest
    return values, keep


def lifted(
    V: Any, contacts: list[ContactFacets], u: fem.Function, prescribed: Mask
) -> fem.Function:
    """Return a displacement near u without penetration, and without jumps of bonded surfaces.

    Nodes of the secondary side move as little as possible. Collective.
    """
    dim, index_map = V.mesh.geometry.dim, V.dofmap.index_map
    v = u.copy()
    values = v.x.array.reshape(-1, dim)
    free = ~prescribed[: index_map.size_local]
    for contact in contacts:
        on = contact.rows.operators
        jumps = jumps_at_nodes(V, contact, v)
        if on.bonded:
            moves = jumps * free[on.nodes]
        else:
            excess = np.einsum("nd,nd->n", jumps, on.normals) - on.gap
            moves = _along(np.maximum(excess, 0.0), on.normals, free[on.nodes])
        values[on.nodes] -= moves
        v.x.scatter_forward()
        if contact.edges.shape[1] == 0:
            continue
        # the coefficient of the middle of an edge, twice its value minus the mean of the ends
        nodes, normals = contact.edges, contact.normals[:, None]
        coefficients = jumps_on_facets(V, contact, v)[:, dim:]
        if on.bonded:
            steps = coefficients
        else:
            first, second = np.triu_indices(dim, 1)
            gaps = 0.5 * (contact.gaps[:, first] + contact.gaps[:, second])
            excess = np.einsum("med,mxd->me", coefficients, normals) - gaps
            steps = np.maximum(excess, 0.0)[:, :, None] * normals
        sums = dolfinx.la.vector(index_map, dim + 1)
        sums.array[:] = 0.0
        steps = np.concatenate([0.5 * steps, np.ones((*steps.shape[:2], 1))], axis=2)
        np.add.at(sums.array.reshape(-1, dim + 1), nodes, steps)
        sums.scatter_reverse(dolfinx.la.InsertMode.add)
        owned = sums.array.reshape(-1, dim + 1)[: len(free)]
        vectors = owned[:, :dim] / np.maximum(owned[:, dim:], 1.0)
        if not on.bonded:
            length = np.linalg.norm(vectors, axis=1)
            vectors = _along(length, vectors / np.maximum(length, LEAST_DIVISOR)[:, None], free)
        values[: len(free)] -= vectors * free
        v.x.scatter_forward()
    return v


def _along(lengths: Array, normals: Array, free: Mask) -> Array:
    """Return the least free moves (n, d) with components (n,) along unit normals (n, d)."""
    along = normals * free
    squares = np.einsum("nd,nd->n", along, along)
    factors = np.divide(lengths, squares, out=np.zeros_like(lengths), where=squares > 0.1)
    return np.asarray(factors[:, None] * along)


def jumps_at_nodes(V: Any, contact: ContactFacets, v: fem.Function) -> Array:
    """Return the jumps (nodes, d) of a displacement at the nodes with multipliers. Collective."""
    dim, on = V.mesh.geometry.dim, contact.rows.operators
    values = v.x.array.reshape(-1, dim)
    result: Array = values[on.nodes]
    if isinstance(contact.pair.primary, RigidPlane):
        return result
    matrix = as_petsc(V.dofmap.index_map, 1, [on.primary], V.mesh.comm)
    columns, products = matrix.createVecs()
    for axis in range(dim):
        columns.array = values[: V.dofmap.index_map.size_local, axis]
        matrix.mult(columns, products)
        result[:, axis] -= products.array
    for owner in (matrix, columns, products):
        owner.destroy()
    return result


def jumps_on_facets(V: Any, contact: ContactFacets, v: fem.Function) -> Array:
    """Return Bernstein's coefficients (m, k, d) of jumps on contact facets. Collective.

    Jumps are between their least and largest coefficients: those at the vertices, and for degree 2
    twice the value in the middle of each edge minus the mean of its ends.
    """
    dim = V.mesh.geometry.dim
    nodes = V.dofmap.list[contact.cell[:, None], contact.corners]
    values = v.x.array.reshape(-1, dim)
    if not isinstance(contact.pair.primary, RigidPlane):
        spread = dolfinx.la.vector(V.dofmap.index_map, dim)
        spread.array[:] = 0.0
        at_nodes = spread.array.reshape(-1, dim)
        at_nodes[contact.rows.operators.nodes] = jumps_at_nodes(V, contact, v)
        spread.scatter_forward()
        return np.asarray(at_nodes[nodes])
    corners: Array = values[nodes]
    first, second = np.triu_indices(dim, 1)
    if contact.edges.shape[1] == 0:
        return corners
    middles = 2.0 * values[contact.edges] - 0.5 * (corners[:, first] + corners[:, second])
    return np.concatenate([corners, middles], axis=1)


def defects(contact: ContactFacets, jumps: Array, areas: Array) -> tuple[Array, Array, Array]:
    """Return what tractions and a displacement lack of the law of contact, facet by facet.

    Args:
        contact: the facets and their tractions.
        jumps: (m, k, d) coefficients of the displacement's jumps, see `jumps_on_facets`.
        areas: (m,) areas of the facets.

    Returns:
        the integrals (m,) of p (d - v_n), upper bounds (m,) of those of g |v_t - s| + t (v_t - s),
        and the largest penetration, or jump of bonded surfaces, (m,).
    """
    m, _, d = jumps.shape
    if contact.rows.operators.bonded:
        return np.zeros(m), np.zeros(m), np.abs(jumps).max(axis=(1, 2), initial=0.0)
    first, second = np.triu_indices(d, 1)
    mass = mean_products(d, 2)
    elevation = np.eye(d)
    if jumps.shape[1] > d:
        products = mean_products(d, 3)
        squares = np.einsum("kll->kl", products)
        mass = np.concatenate([squares, 2.0 * products[:, first, second]], axis=1)
        elevation = np.vstack([elevation, 0.5 * (elevation[first] + elevation[second])])
    normal = np.einsum("mkd,md->mk", jumps, contact.normals)
    pressure = -np.einsum("mkd,md->mk", contact.tractions, contact.normals)
    tangential = contact.tractions + pressure[:, :, None] * contact.normals[:, None]
    slips = jumps - normal[:, :, None] * contact.normals[:, None]
    slips -= elevation @ contact.origins
    openings = contact.gaps @ elevation.T - normal
    complementarity = np.einsum("mk,kl,ml->m", pressure, mass, openings)
    lengths = np.linalg.norm(slips, axis=2)
    friction = np.einsum("mk,kl,ml->m", contact.bounds, mass, lengths)
    friction += np.einsum("mkd,kl,mld->m", tangential, mass, slips)
    depth = np.maximum(-openings, 0.0).max(axis=1, initial=0.0)
    return areas * complementarity, areas * friction, depth
