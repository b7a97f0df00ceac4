"""Admissible contact tractions on the facets of cells, and what they lack of the law of contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree

import basix
import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import (
    LEAST_DIVISOR,
    Array,
    GlobalNumbers,
    Indices,
    LocalNumbers,
    Mask,
)
from dolfinx_tresca._base.parallel import errors_on_all_ranks, gather_rows
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.simplices import mean_products
from dolfinx_tresca.pairing.operators import as_petsc
from dolfinx_tresca.scene.friction import Bonded, Frictionless
from dolfinx_tresca.scene.obstacle import RigidPlane
from dolfinx_tresca.scene.pair import ContactPair

#: Difference of unit normals, and of entries of the primary side's means from 1, that count as
#: rounding; for distances relative to the size of the mesh.
FLATNESS = 1e-8

#: Penetration relative to the largest displacement that counts as rounding.
PENETRATION = 1e-10


@dataclass(frozen=True)
class LoadedFacets:
    """Facets of owned cells with linear tractions.

    Attributes:
        cell: (m,) the cells.
        facet: (m,) numbers of the facets in their cells.
        corners: (m, d) vertices of the facets in their cells.
        tractions: (m, d, d) tractions on the cells at these vertices [stress].
    """

    cell: Indices
    facet: Indices
    corners: Indices
    tractions: Array


@dataclass(frozen=True)
class ContactFacets:
    """The facets of a pair's secondary side with admissible tractions.

    Attributes:
        pair: the contact pair.
        nodes: (n,) owned nodes of the secondary side that touch.
        opposite: (n, nodes of V) sparse matrix with a 1 for the node opposite to each; empty rows
            for an obstacle.
        node_normals: (n, d) contact normals.
        node_gaps: (n,) gaps [length].
        sides: the facets of the secondary side, and those of the primary side if it is a body.
        normals: (m, d) contact normals of the secondary facets.
        gaps: (m, d) gaps at the facets' vertices [length].
        bounds: (m, d) slip bounds at the facets' vertices [stress].
        origins: (m, d, d) tangential jumps at the facets' vertices from which slip counts [length].
        edges: (m, e) nodes in the middles of the facets' edges, in the order of `np.triu_indices`;
            e = 0 for degree 1.
    """

    pair: ContactPair
    nodes: LocalNumbers
    opposite: Any
    node_normals: Array
    node_gaps: Array
    sides: list[LoadedFacets]
    normals: Array
    gaps: Array
    bounds: Array
    origins: Array
    edges: Indices

    @property
    def bonded(self) -> bool:
        """Whether the surfaces are bonded."""
        return isinstance(self.pair.friction, Bonded)


def contact_facets(
    V: Any,
    dual: DualProgram,
    pair: ContactPair,
    rows: RowsOfPair,
    multipliers: Array,
    bounds: Array,
    prescribed: Mask,
) -> ContactFacets:
    """Return the facets of a pair, with tractions interpolated between nodes. Collective.

    Args:
        V: the space of the displacement.
        dual: the dual problem.
        pair: the pair.
        rows: rows of B that act on the pair.
        multipliers: (size,) the multipliers.
        bounds: (nodes of all pairs,) slip bounds [stress].
        prescribed: (nodes of this rank, d) prescribed degrees of freedom.

    Raises:
        InputError: the bound does not cover such surfaces, or such friction.
    """
    jump, on, dim = dual.jump, rows.operators, V.mesh.geometry.dim
    plane = pair.primary if isinstance(pair.primary, RigidPlane) else None
    name = f"contact pair {pair}"
    matches = (np.diff(on.primary.indptr) == 1).all()
    matches = matches and bool((np.abs(on.primary.data - 1.0) < FLATNESS).all())
    with errors_on_all_ranks(V.mesh.comm):
        if plane is None and not isinstance(pair.primary, int):
            raise InputError(
                f"a guaranteed bound needs rigid planes or meshes that match, and {name} has "
                f"{pair.primary} as its primary side."
            )
        if plane is None and not matches:
            raise _no_match(name)
        if (on.semi_axes != 1.0).any() or not (on.bonded or np.isfinite(bounds[rows.nodes]).all()):
            raise InputError(
                f"a guaranteed bound needs one finite slip bound for all directions, and {name} "
                "has two, or an infinite one."
            )
        if any(member.friction != pair.friction for member in on.undeformed.group.pairs):
            raise InputError(
                f"a guaranteed bound needs the same law for all pairs of the surface of {name}. "
                "Leave a gap between surfaces of different laws."
            )
        if len(np.unique(on.nodes)) < len(on.nodes):
            raise InputError(
                f"a guaranteed bound needs flat surfaces, and {name} has sharp edges. Make a pair "
                "of each side."
            )
    stress = multipliers * jump.stress_scale
    traction = -on.tangential_vectors(stress[rows.tangential])
    traction[on.normal_node] -= stress[rows.normal, None] * on.normals[on.normal_node]
    origin = (dual.response.offset - jump.gap) * jump.length_scale
    moves = np.zeros(len(on.nodes))
    moves[on.normal_node] = 1.0
    slides = np.bincount(on.tangent_node, minlength=len(on.nodes)) == dim - 1
    slides |= isinstance(pair.friction, Frictionless)
    owned = V.dofmap.index_map.size_local
    points = V.tabulate_dof_coordinates()[:, :dim]
    offset = np.zeros_like(traction)
    if plane is None:
        offset = _products(V, on.primary, points[:owned]) - points[on.nodes]
    columns = {
        "normal": on.normals,
        "traction": traction,
        "origin": on.tangential_vectors(origin[rows.tangential]),
        "offset": offset,
        "gap": on.gap[:, None],
        "bound": np.where(on.bonded, np.inf, bounds[rows.nodes, None]),
        "unpressed": 1.0 - moves[:, None],
        "unrubbed": ~slides[:, None],
        "present": np.ones((len(moves), 1)),
    }
    widths = {key: values.shape[1] for key, values in columns.items()}
    table = np.zeros((owned, sum(widths.values())))
    table[on.nodes] = np.hstack(list(columns.values()))
    secondary, primary = pair.given_tags("secondary"), pair.given_tags("primary")
    rim = _rim_nodes(V, secondary, prescribed, on.nodes)
    table[rim] = _rim_data(V, secondary, _spread(V, table), widths)[rim]
    at_rim = _split(table, widths)
    if pair.gap is not None:
        gaps = NodalValues(V).at(pair.gap, rim, f"the gap of {name}")
        at_rim["gap"][rim, 0] = gaps
    if plane is not None and len(rim):
        distance, normals = plane.at(V.tabulate_dof_coordinates()[rim])
        cosine = -np.einsum("nd,nd->n", at_rim["normal"][rim], normals[:, :dim])
        at_rim["gap"][rim, 0] = distance / cosine + (0.0 if pair.gap is None else gaps)
    nodes, opposite = np.concatenate([on.nodes, rim]), on.primary
    near = FLATNESS * np.ptp(points, axis=0).max(initial=0.0)
    if plane is None:
        wanted = points[rim] + at_rim["offset"][rim]
        partner, distance = _partners(V, primary, on.primary, wanted)
        with errors_on_all_ranks(V.mesh.comm):
            if (distance > near).any():
                raise _no_match(name)
        unit = csr_array(
            (np.ones(len(rim)), partner, np.arange(len(rim) + 1)), (len(rim), opposite.shape[1])
        )
        opposite = vstack([opposite, unit], format="csr")
    else:
        opposite = csr_array((len(nodes), opposite.shape[1]))
    loaded, at = _loaded(V, secondary, _spread(V, table), widths, name)
    sides = [loaded]
    with errors_on_all_ranks(V.mesh.comm):
        if (np.abs(at["normal"] - at["normal"][:, :1]) > FLATNESS).any():
            raise InputError(
                f"a guaranteed bound needs contact normals that do not turn, and those of {name} "
                "do. Replace curved surfaces by planes."
            )
        if (np.abs(at["offset"] - at["offset"][:, :1]) > near).any():
            raise _no_match(name)
    node_normals, node_gaps = at_rim["normal"][nodes], at_rim["gap"][nodes, 0]
    if plane is None:
        at_rim["traction"] *= -1.0
        there = _spread(V, _products(V, opposite, table[nodes], transposed=True))
        sides.append(_loaded(V, primary, there, widths, name)[0])
        if V.mesh.comm.allreduce(len(sides[1].cell) - len(sides[0].cell)):
            raise _no_match(name)
    edges = np.zeros((len(sides[0].cell), 0), dtype=np.intp)
    if V.element.basix_element.degree > 1:
        numbers = np.zeros((dim + 1, dim + 1), dtype=np.intp)
        for number, (i, j) in enumerate(basix.topology(V.mesh.basix_cell())[1]):
            numbers[i, j] = numbers[j, i] = dim + 1 + number
        i, j = np.triu_indices(dim, 1)
        own = numbers[sides[0].corners[:, i], sides[0].corners[:, j]]
        edges = V.dofmap.list[sides[0].cell[:, None], own]
    return ContactFacets(
        pair=pair,
        nodes=nodes,
        opposite=opposite,
        node_normals=node_normals,
        node_gaps=node_gaps,
        sides=sides,
        normals=at["normal"][:, 0],
        gaps=at["gap"][:, :, 0],
        bounds=at["bound"][:, :, 0],
        origins=at["origin"],
        edges=edges,
    )


def _no_match(name: str) -> InputError:
    return InputError(
        "a guaranteed bound needs rigid planes, or bodies of degree 1 whose meshes match on flat "
        f"surfaces, and those of {name} do not. Mesh both surfaces alike."
    )


def _spread(V: Any, owned: Array) -> Array:
    """Return values (owned nodes, k) at this rank's nodes, ghosts included. Collective."""
    vector = dolfinx.la.vector(V.dofmap.index_map, owned.shape[1])
    vector.array[: owned.size] = owned.ravel()
    vector.scatter_forward()
    return np.array(vector.array).reshape(-1, owned.shape[1])


def _split(table: Array, widths: dict[str, int]) -> dict[str, Array]:
    """Return the columns of a table (..., k) by name, as views."""
    ends = np.cumsum(list(widths.values()))[:-1]
    return dict(zip(widths, np.split(table, ends, axis=-1), strict=True))


def _summed(V: Any, nodes: Indices, values: Array) -> Array:
    """Return sums (owned nodes, k) of values (..., k) at nodes (...) of any rank. Collective."""
    vector = dolfinx.la.vector(V.dofmap.index_map, values.shape[-1])
    vector.array[:] = 0.0
    np.add.at(vector.array.reshape(-1, values.shape[-1]), nodes, values)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    owned = V.dofmap.index_map.size_local
    return np.array(vector.array.reshape(-1, values.shape[-1])[:owned])


def _rim_nodes(V: Any, tags: Any, prescribed: Mask, paired: LocalNumbers) -> LocalNumbers:
    """Return the owned prescribed nodes of tagged facets that are not paired. Collective."""
    cell, _, corners = _tagged(V, *tags)
    used = _summed(V, V.dofmap.list[cell[:, None], corners], np.ones((*corners.shape, 1)))
    used[paired] = 0.0
    return np.flatnonzero((used[:, 0] > 0.0) & prescribed[: len(used)].all(axis=1)).astype(np.int32)


def _rim_data(V: Any, tags: Any, table: Array, widths: dict[str, int]) -> Array:
    """Return data (owned nodes, k) of nodes without multipliers, from their neighbours. Collective.

    They are the means over the neighbours in common facets, without traction, which is marked to be
    missing.
    """
    cell, _, corners = _tagged(V, *tags)
    nodes = V.dofmap.list[cell[:, None], corners]
    present = _split(table[nodes], widths)["present"]
    means = (present * table[nodes]).sum(axis=1, keepdims=True)
    result = _summed(V, nodes, np.repeat(means, corners.shape[1], axis=1))
    data = _split(result, widths)
    result /= np.maximum(data["present"], 1.0)
    data["traction"][:] = data["origin"][:] = 0.0
    data["unpressed"][:] = data["unrubbed"][:] = data["present"]
    return result


def _partners(V: Any, tags: Any, paired: Any, points: Array) -> tuple[GlobalNumbers, Array]:
    """Return the numbers (n,) of the unpaired nodes of a side nearest to points, and distances.

    Nodes at the rim of the side are few, and gathered on all ranks. Collective.
    """
    index_map = V.dofmap.index_map
    cell, _, corners = _tagged(V, *tags)
    used = _summed(V, V.dofmap.list[cell[:, None], corners], np.ones((*corners.shape, 1)))
    taken = _products(V, paired, np.ones((paired.shape[0], 1)), transposed=True)
    (unpaired,) = np.nonzero((used[:, 0] > 0.0) & (taken[:, 0] == 0.0))
    dim = points.shape[1]
    numbers = unpaired[:, None] + index_map.local_range[0]
    here = V.tabulate_dof_coordinates()[unpaired, :dim]
    rim = gather_rows(V.mesh.comm, np.hstack([here, numbers]))
    if not len(rim):
        return np.zeros(len(points), dtype=np.int64), np.full(len(points), np.inf)
    distance, nearest = cKDTree(rim[:, :dim]).query(points)
    return rim[nearest, dim].astype(np.int64), distance


def _products(V: Any, matrix: Any, values: Array, *, transposed: bool = False) -> Array:
    """Return products of a matrix (rows, nodes of V) and values at owned nodes. Collective.

    Args:
        V: the space of the displacement.
        matrix: sparse rows of this rank with global column numbers.
        values: (owned nodes, k), or (rows, k) if `transposed`.
        transposed: whether the transpose is taken.
    """
    petsc = as_petsc(V.dofmap.index_map, 1, [matrix], V.mesh.comm)
    right, left = petsc.createVecs()
    source, target, multiply = right, left, petsc.mult
    if transposed:
        source, target, multiply = left, right, petsc.multTranspose
    columns = []
    for column in values.T:
        source.array = column
        multiply(source, target)
        columns.append(target.array.copy())
    for owner in (petsc, right, left):
        owner.destroy()
    return np.stack(columns, axis=1)


def _tagged(V: Any, tags: Any, numbers: tuple[int, ...]) -> tuple[Indices, Indices, Indices]:
    """Return the cell (m,) of tagged facets, their number (m,) and vertices (m, d) in it."""
    topology = V.mesh.topology
    tdim = topology.dim
    facets = np.concatenate([tags.find(number) for number in numbers])
    facets = facets[facets < topology.index_map(tdim - 1).size_local]
    to_cell, to_facet = topology.connectivity(tdim - 1, tdim), topology.connectivity(tdim, tdim - 1)
    cell = to_cell.array[to_cell.offsets[facets]].astype(np.intp)
    facet = np.argmax(to_facet.array.reshape(-1, tdim + 1)[cell] == facets[:, None], axis=1)
    opposite = np.array([[k for k in range(tdim + 1) if k != j] for j in range(tdim + 1)])
    return cell, facet, opposite[facet]


def _loaded(
    V: Any, tags: Any, table: Array, widths: dict[str, int], name: str
) -> tuple[LoadedFacets, dict[str, Array]]:
    """Return the facets of a side that are in contact, and their data by column (m, d, .).

    They are those all of whose vertices have data; others must not be pressed. Where tractions are
    missing, since the displacement is prescribed, the means over the facet's other vertices are
    taken, so that they stay admissible. Collective.
    """
    cell, facet, corners = _tagged(V, *tags)
    at = _split(table[V.dofmap.list[cell[:, None], corners]], widths)
    present = at["present"][:, :, 0] > 0.0
    keep: Mask = np.asarray(present.all(axis=1))
    with errors_on_all_ranks(V.mesh.comm):
        if at["traction"][~keep].any():
            raise InputError(
                "a guaranteed bound needs multipliers at all nodes of pressed facets, and "
                f"{name} has pressed facets at a rim."
            )
    at = {key: values[keep] for key, values in at.items()}
    tractions, normals = at["traction"], at["normal"]
    along = np.einsum("mkd,mkd->mk", tractions, normals)[:, :, None] * normals
    across = tractions - along
    for values, lacks in ((along, at["unpressed"] > 0.0), (across, at["unrubbed"] > 0.0)):
        count = np.maximum((~lacks).sum(axis=1, keepdims=True), 1)
        mean = (~lacks * values).sum(axis=1, keepdims=True) / count
        values += lacks * (mean - values)
    sizes = np.linalg.norm(across, axis=2, keepdims=True)
    across *= np.minimum(1.0, at["bound"] / np.maximum(sizes, LEAST_DIVISOR))
    at["traction"] = tractions = along + across
    return LoadedFacets(cell[keep], facet[keep], corners[keep], tractions), at


def jumps(V: Any, contact: ContactFacets, v: fem.Function) -> Array:
    """Return the jumps (nodes of this rank, d) of a displacement at contact nodes. Collective."""
    values = v.x.array.reshape(-1, V.mesh.geometry.dim)
    owned = np.zeros_like(values[: V.dofmap.index_map.size_local])
    owned[contact.nodes] = _products(V, contact.opposite, values[: len(owned)])
    return np.asarray(values - _spread(V, owned))


def coefficients(contact: ContactFacets, at_nodes: Array, nodes: Indices) -> Array:
    """Return Bernstein's coefficients (m, k, d) of jumps on the secondary facets.

    Jumps are between their least and largest coefficients: those at the vertices, and for degree 2
    twice the value in the middle of each edge minus the mean of its ends.

    Args:
        contact: the facets.
        at_nodes: see `jumps`.
        nodes: (n, .) nodes of the cells.
    """
    side = contact.sides[0]
    corners = at_nodes[nodes[side.cell[:, None], side.corners]]
    i, j = np.triu_indices(corners.shape[1], 1)
    middles = 2.0 * at_nodes[contact.edges]
    middles -= 0.5 * (corners[:, i] + corners[:, j])[:, : middles.shape[1]]
    return np.concatenate([corners, middles], axis=1)


def lifted(
    V: Any, contacts: list[ContactFacets], u: fem.Function, prescribed: Mask
) -> fem.Function:
    """Return a displacement near u without penetration, and without jumps of bonded surfaces.

    Nodes of the secondary side move as little as possible; where they are prescribed, the opposite
    nodes move. Collective.
    """
    dim = V.mesh.geometry.dim
    v = u.copy()
    values = v.x.array.reshape(-1, dim)
    owned = V.dofmap.index_map.size_local

    def allowed(nodes: Any, excess: Array, normals: Array, bonded: bool) -> Array:
        """Return the moves (m, d) of nodes that take an excess of jumps, or what is free of it."""
        free = ~prescribed[nodes]
        if bonded:
            return np.where(free, excess, 0.0)
        along = normals * free
        squares = np.einsum("md,md->m", along, along)
        lengths = np.einsum("md,md->m", excess, normals)
        factors = np.divide(lengths, squares, out=np.zeros_like(lengths), where=squares > 0.1)
        return np.asarray(factors[:, None] * along)

    for contact in contacts:
        bonded, normals = contact.bonded, contact.node_normals
        for primary in (False, True):
            excess = jumps(V, contact, v)[contact.nodes]
            if not bonded:
                depth = np.einsum("nd,nd->n", excess, normals) - contact.node_gaps
                excess = np.maximum(depth, 0.0)[:, None] * normals
            if primary:  # what prescribed nodes leave
                sources = np.hstack([excess, normals])
                sources = _products(V, contact.opposite, sources, transposed=True)
                moves = allowed(np.arange(owned), sources[:, :dim], sources[:, dim:], bonded)
                values[:owned] += moves
            else:
                values[contact.nodes] -= allowed(contact.nodes, excess, normals, bonded)
            v.x.scatter_forward()
        if V.element.basix_element.degree > 1:
            middles = coefficients(contact, jumps(V, contact, v), V.dofmap.list)[:, dim:]
            on_edges = np.repeat(contact.normals[:, None], middles.shape[1], axis=1)
            if not bonded:
                i, j = np.triu_indices(dim, 1)
                gaps = 0.5 * (contact.gaps[:, i] + contact.gaps[:, j])
                depth = np.einsum("med,med->me", middles, on_edges) - gaps
                middles = np.maximum(depth, 0.0)[:, :, None] * on_edges
            # a coefficient moves twice as far as the middle of its edge
            nodes = contact.edges.ravel()
            moves = allowed(
                nodes, 0.5 * middles.reshape(-1, dim), on_edges.reshape(-1, dim), bonded
            )
            # the owner of a node takes the mean of the moves for all its facets
            sums = _summed(V, nodes, np.hstack([moves, np.ones((len(moves), 1))]))
            values[:owned] -= sums[:, :dim] / np.maximum(sums[:, dim:], 1.0)
            v.x.scatter_forward()
    return v


def defects(contact: ContactFacets, jump: Array, areas: Array) -> tuple[Array, Array, Array]:
    """Return by how much tractions and jumps miss the law of contact on each facet.

    Args:
        contact: the facets and their tractions.
        jump: (m, k, d) coefficients of the displacement's jumps, see `coefficients`.
        areas: (m,) areas of the facets.

    Returns:
        the integrals (m,) of p (d - v_n), upper bounds (m,) of those of g |v_t - s| + t (v_t - s),
        and the largest penetration, or jump of bonded surfaces, (m,).
    """
    m, size, d = jump.shape
    if contact.bonded:
        return np.zeros(m), np.zeros(m), np.abs(jump).max(axis=(1, 2), initial=0.0)
    i, j = np.triu_indices(d, 1)
    mass, elevation = mean_products(d, 2), np.eye(d)
    if size > d:
        products = mean_products(d, 3)
        squares = np.einsum("kll->kl", products)
        mass = np.concatenate([squares, 2.0 * products[:, i, j]], axis=1)
        elevation = np.vstack([elevation, 0.5 * (elevation[i] + elevation[j])])
    tractions, normals = contact.sides[0].tractions, contact.normals
    normal = np.einsum("mkd,md->mk", jump, normals)
    pressure = -np.einsum("mkd,md->mk", tractions, normals)
    tangential = tractions + pressure[:, :, None] * normals[:, None]
    slips = jump - normal[:, :, None] * normals[:, None] - elevation @ contact.origins
    openings = contact.gaps @ elevation.T - normal
    complementarity = np.einsum("mk,kl,ml->m", pressure, mass, openings)
    friction = np.einsum("mk,kl,ml->m", contact.bounds, mass, np.linalg.norm(slips, axis=2))
    friction += np.einsum("mkd,kl,mld->m", tangential, mass, slips)
    depth = np.maximum(-openings, 0.0).max(axis=1, initial=0.0)
    return areas * complementarity, areas * friction, depth
