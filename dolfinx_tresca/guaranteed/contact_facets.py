"""Admissible contact tractions on the facets of cells, and what they lack of the law of contact."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.simplices import mean_products
from dolfinx_tresca.pairing.operators import as_petsc
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
        radius = dual.bounds(multipliers, gradient).radius[: len(jump.stress_scale) + len(on.nodes)]
        areas = np.concatenate([pair_.weights for pair_ in jump.pairs])
        stress = multipliers * jump.stress_scale
        table = np.zeros((len(on.nodes), 3 * dim + 3 + dim))
        normal, traction, origin, scalars, offset = np.split(
            table, np.cumsum([dim, dim, dim, 3]), axis=1
        )
        normal[:] = on.normals
        traction[:] = -on.tangential_vectors(stress[rows.tangential])
        traction[on.normal_node] -= stress[rows.normal, None] * on.normals[on.normal_node]
        slip_origin = dual.response.offset - jump.gap
        origin[:] = on.tangential_vectors((slip_origin * jump.length_scale)[rows.tangential])
        scalars[:, 0] = on.gap
        scalars[:, 1] = 0.0 if on.bonded else radius[rows.nodes] / np.sqrt(areas[rows.nodes])
        scalars[:, 2] = 1.0
        at_primary = None
        if not rigid:
            at_primary, offset[:] = _on_primary(V, on, traction, name)
        spread = dolfinx.la.vector(index_map, table.shape[1])
        spread.array[:] = 0.0
        spread.array.reshape(-1, table.shape[1])[on.nodes] = table
        spread.scatter_forward()
        cell, facet, corners, nodes = _facets(V, *pair.given_tags("secondary"))
        at_nodes = spread.array.reshape(-1, table.shape[1])[nodes]
        with errors_on_all_ranks(V.mesh.comm):
            at_nodes, keep = _completed(V, pair, at_nodes, nodes, prescribed, name)
        cell, facet, corners, at_nodes = cell[keep], facet[keep], corners[keep], at_nodes[keep]
        normal, traction, origin, scalars, offset = np.split(
            at_nodes, np.cumsum([dim, dim, dim, 3]), axis=2
        )
        with errors_on_all_ranks(V.mesh.comm):
            if (np.abs(normal - normal[:, :1]) > FLATNESS).any():
                raise InputError(
                    f"a guaranteed bound needs contact normals that do not turn, and those of "
                    f"{name} do. Replace curved surfaces by planes."
                )
            others = (np.zeros(0, np.intp),) * 2 + (
                np.zeros((0, dim), np.intp),
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


def _completed(
    V: Any, pair: ContactPair, values: Array, nodes: Indices, prescribed: Mask, name: str
) -> tuple[Array, Mask]:
    """Complete the data (m, d, .) at vertices without multipliers, and select facets in contact.

    At nodes whose displacement is prescribed, the traction is zero, the normal and the largest
    bound of the facet's other vertices hold, and the gap is measured.
    """
    dim = V.mesh.geometry.dim
    flag, gap, bound = 3 * dim + 2, 3 * dim, 3 * dim + 1
    present = values[:, :, flag] > 0.0
    keep = present.any(axis=1)
    values = values.copy()
    missing = keep[:, None] & ~present
    if not missing.any():
        return values, keep
    fixed = prescribed[nodes].all(axis=2)
    loaded = (values[:, :, dim : 2 * dim] != 0.0).any(axis=(1, 2))
    outside = (missing & ~fixed).any(axis=1)
    complete = isinstance(pair.primary, RigidPlane) and pair.gap is None
    if (loaded & (outside | (missing.any(axis=1) & (not complete)))).any():
        raise InputError(
            f"a guaranteed bound needs contact up to the rim of the pressed surface, and {name} "
            "has pressed facets with nodes without multipliers."
        )
    keep &= ~outside
    if not complete:
        keep &= ~missing.any(axis=1)
        return values, keep
    facet, k = np.nonzero(missing & keep[:, None])
    donor = np.argmax(present[facet], axis=1)
    values[facet, k, :dim] = values[facet, donor, :dim]
    values[facet, k, bound] = values[facet, :, bound].max(axis=1)
    assert isinstance(pair.primary, RigidPlane)
    points = V.tabulate_dof_coordinates()[nodes[facet, k]]
    distance, normals = pair.primary.at(points)
    cosine = -np.einsum("md,md->m", values[facet, k, :dim], normals[:, :dim])
    values[facet, k, gap] = distance / cosine
    return values, keep


def lifted(
    V: Any, contacts: list[ContactFacets], u: fem.Function, prescribed: Mask
) -> fem.Function:
    """Return a displacement near u without penetration, and without slip of bonded surfaces.

    Contact nodes of the secondary side move as little as possible. Collective.

    Raises:
        InputError: prescribed displacements penetrate.
    """
    dim = V.mesh.geometry.dim
    v = u.copy()
    values = v.x.array.reshape(-1, dim)
    owned = V.dofmap.index_map.size_local
    free = ~prescribed[:owned]
    for contact in contacts:
        on, rows = contact.rows.operators, contact.rows
        matrix = as_petsc(
            V.dofmap.index_map, 1, [on.secondary - on.primary], V.mesh.comm
        )
        columns, products = matrix.createVecs()
        jumps = np.empty((len(on.nodes), dim))
        for axis in range(dim):
            columns.array = values[:owned, axis]
            matrix.mult(columns, products)
            jumps[:, axis] = products.array
        for owner in (matrix, columns, products):
            owner.destroy()
        moves = free[on.nodes]
        if on.bonded:
            values[on.nodes] -= np.where(moves, jumps, 0.0)
        else:
            excess = np.maximum(np.einsum("nd,nd->n", jumps, on.normals) - on.gap, 0.0)
            along = on.normals * moves
            square = np.einsum("nd,nd->n", along, along)
            factor = np.divide(excess, square, out=np.zeros_like(excess), where=square > 0.1)
            values[on.nodes] -= factor[:, None] * along
        v.x.scatter_forward()
    return v


def jumps_on_facets(
    V: Any, contact: ContactFacets, v: fem.Function
) -> Array:
    """Return jumps (m, d, d) of a displacement at the vertices of contact facets. Collective."""
    dim, on = V.mesh.geometry.dim, contact.rows.operators
    nodes = V.dofmap.list[contact.cell[:, None], contact.corners]
    values = v.x.array.reshape(-1, dim)[nodes]
    if isinstance(contact.pair.primary, RigidPlane):
        return values
    matrix = as_petsc(V.dofmap.index_map, 1, [on.primary], V.mesh.comm)
    columns, products = matrix.createVecs()
    opposite = dolfinx.la.vector(V.dofmap.index_map, dim)
    opposite.array[:] = 0.0
    at_nodes = opposite.array.reshape(-1, dim)
    owned = V.dofmap.index_map.size_local
    for axis in range(dim):
        columns.array = v.x.array.reshape(-1, dim)[:owned, axis]
        matrix.mult(columns, products)
        at_nodes[on.nodes, axis] = products.array
    opposite.scatter_forward()
    for owner in (matrix, columns, products):
        owner.destroy()
    return values - at_nodes[nodes]


def defects(contact: ContactFacets, jumps: Array, areas: Array) -> tuple[Array, Array, Array]:
    """Return what tractions and a displacement lack of the law of contact, facet by facet.

    Args:
        contact: the facets and their tractions.
        jumps: (m, d, d) the displacement's jumps at their vertices.
        areas: (m,) areas of the facets.

    Returns:
        the integrals (m,) of p (d - v_n), of g |v_t - s| + t (v_t - s), and the largest penetration
        of each facet.
    """
    m, d, _ = jumps.shape
    normal = np.einsum("mkd,md->mk", jumps, contact.normals)
    if contact.rows.operators.bonded:
        return np.zeros(m), np.zeros(m), np.abs(jumps).max(axis=(1, 2), initial=0.0)
    pressure = -np.einsum("mkd,md->mk", contact.tractions, contact.normals)
    tangential = contact.tractions + pressure[:, :, None] * contact.normals[:, None]
    slips = jumps - normal[:, :, None] * contact.normals[:, None] - contact.origins
    mass = mean_products(d, 2)
    openings = contact.gaps - normal
    complementarity = np.einsum("mk,kl,ml->m", pressure, mass, openings)
    friction = np.einsum(
        "mk,kl,ml->m", contact.bounds, mass, np.linalg.norm(slips, axis=2)
    ) + np.einsum("mkd,kl,mld->m", tangential, mass, slips)
    return areas * complementarity, areas * friction, np.maximum(-openings, 0.0).max(axis=1, initial=0.0)
