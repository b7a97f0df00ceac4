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
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc
from dolfinx_tresca.scene.friction import Frictionless
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
        on: operators at the nodes of the pair.
        sides: the facets of the secondary side, and those of the primary side if it is a body.
        normals: (m, d) contact normals of the secondary facets.
        gaps: (m, d) gaps at the facets' vertices [length].
        bounds: (m, d) slip bounds at the facets' vertices [stress].
        origins: (m, d, d) tangential jumps at the facets' vertices from which slip counts [length].
        edges: (m, e) nodes in the middles of the facets' edges, in the order of `np.triu_indices`;
            e = 0 for degree 1.
    """

    pair: ContactPair
    on: PairOperators
    sides: list[LoadedFacets]
    normals: Array
    gaps: Array
    bounds: Array
    origins: Array
    edges: Indices


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
        if (on.semi_axes != 1.0).any() or not np.isfinite(bounds[rows.nodes]).all():
            raise InputError(
                f"a guaranteed bound needs one finite slip bound for all directions, and {name} "
                "has two, or an infinite one."
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
    pressed = np.zeros(len(on.nodes))
    pressed[on.normal_node] = 1.0
    rubbed = np.bincount(on.tangent_node, minlength=len(on.nodes)) == dim - 1
    rubbed |= isinstance(pair.friction, Frictionless)
    owned = V.dofmap.index_map.size_local
    points = V.tabulate_dof_coordinates()[:, :dim]
    offset = _products(V, on.primary, points[:owned]) - points[on.nodes]
    columns = {
        "normal": on.normals,
        "traction": traction,
        "origin": on.tangential_vectors(origin[rows.tangential]),
        "offset": np.zeros_like(traction) if plane else offset,
        "gap": on.gap[:, None],
        "bound": bounds[rows.nodes, None],
        "pressed": pressed[:, None],
        "rubbed": rubbed[:, None],
        "present": np.ones((len(pressed), 1)),
    }
    ends = np.cumsum([values.shape[1] for values in columns.values()])
    cell, facet, corners = _tagged(V, *pair.given_tags("secondary"))
    nodes = V.dofmap.list[cell[:, None], corners]
    table = np.zeros((owned, ends[-1]))
    if plane is not None and pair.gap is not None:
        # at nodes without multipliers, since they are prescribed
        lacking = _spread(V, np.zeros((owned, 1)), nodes.ravel())[:owned, 0] > 0.0
        lacking &= prescribed[:owned].all(axis=1)
        numbers = np.flatnonzero(lacking).astype(np.int32)
        table[numbers, ends[3]] = NodalValues(V).at(pair.gap, numbers, f"the gap of {name}")
    table[on.nodes] = np.hstack(list(columns.values()))
    at = dict(zip(columns, np.split(_spread(V, table)[nodes], ends[:-1], axis=2), strict=True))
    with errors_on_all_ranks(V.mesh.comm):
        keep = _completed(plane, points[nodes], at, prescribed[nodes], name)
        at = {key: values[keep] for key, values in at.items()}
        _complete_tractions(at, prescribed[nodes[keep]])
        if (np.abs(at["normal"] - at["normal"][:, :1]) > FLATNESS).any():
            raise InputError(
                f"a guaranteed bound needs contact normals that do not turn, and those of {name} "
                "do. Replace curved surfaces by planes."
            )
        size = np.ptp(points, axis=0).max(initial=0.0)
        if (np.abs(at["offset"] - at["offset"][:, :1]) > FLATNESS * size).any():
            raise _no_match(name)
    sides = [LoadedFacets(cell[keep], facet[keep], corners[keep], at["traction"])]
    if plane is None:
        opposite = np.hstack([-traction, np.ones((len(traction), 1))])
        opposite = _spread(V, _products(V, on.primary, opposite, transposed=True))
        cell, facet, corners = _tagged(V, *pair.given_tags("primary"))
        values = opposite[V.dofmap.list[cell[:, None], corners]]
        inside = (np.abs(values[:, :, -1] - 1.0) < FLATNESS).all(axis=1)
        lost = bool(values[~inside, :, :-1].any())
        sides.append(
            LoadedFacets(cell[inside], facet[inside], corners[inside], values[inside, :, :-1])
        )
        excess = V.mesh.comm.allreduce(len(sides[1].cell) - len(sides[0].cell))
        if V.mesh.comm.allreduce(lost) or excess:
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
        on=on,
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


def _spread(V: Any, owned: Array, marked: Indices | None = None) -> Array:
    """Return values (owned nodes, k) at this rank's nodes, ghosts included. Collective.

    If nodes are marked, 1 is added at their owners for each rank that marks them.
    """
    vector = dolfinx.la.vector(V.dofmap.index_map, owned.shape[1])
    result: Array = vector.array.reshape(-1, owned.shape[1])
    result[:] = 0.0
    if marked is not None:
        result[marked] = 1.0
        vector.scatter_reverse(dolfinx.la.InsertMode.add)
    result[: len(owned)] += owned
    vector.scatter_forward()
    return result.copy()


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


def _completed(
    plane: RigidPlane | None, points: Array, at: dict[str, Array], prescribed: Mask, name: str
) -> Mask:
    """Return which facets (m,) are in contact; complete their data at prescribed vertices.

    Where the displacement is prescribed and there are no multipliers, the facet's other vertices
    tell the normal and the bound, and the gap to a plane is measured. Facets whose vertices lack
    multipliers for other reasons are not in contact, and must not be pressed.
    """
    present: Mask = np.asarray(at["present"][:, :, 0] > 0.0)
    touching: Mask = np.asarray(present.any(axis=1))
    missing = touching[:, None] & ~present
    fixed = prescribed.all(axis=2) & (plane is not None)
    beyond: Mask = np.asarray((missing & ~fixed).any(axis=1))
    if at["traction"][beyond].any():
        raise InputError(
            f"a guaranteed bound needs multipliers at all nodes of pressed facets, and {name} has "
            "pressed facets at a rim, or prescribed nodes between two bodies."
        )
    facet, k = np.nonzero(missing & ~beyond[:, None])
    if plane is not None and len(facet):
        donor = np.argmax(present[facet], axis=1)
        at["normal"][facet, k] = at["normal"][facet, donor]
        at["bound"][facet, k] = at["bound"][facet].max(axis=1)
        there = np.zeros((len(facet), 3))
        there[:, : points.shape[2]] = points[facet, k]
        distance, normals = plane.at(there)
        normals = normals[:, : points.shape[2]]
        cosine = -np.einsum("md,md->m", at["normal"][facet, k], normals)
        at["gap"][facet, k, 0] += distance / cosine
    return touching & ~beyond


def _complete_tractions(at: dict[str, Array], prescribed: Mask) -> None:
    """Add the tractions that prescribed vertices lack: the means of those at other vertices."""
    tractions, normals = at["traction"], at["normal"]
    along = np.einsum("mkd,mkd->mk", tractions, normals)[:, :, None] * normals
    for values, key in ((along, "pressed"), (tractions - along, "rubbed")):
        has = at[key][:, :, 0] > 0.0
        mean = np.einsum("mk,mkd->md", has, values) / np.maximum(has.sum(axis=1), 1)[:, None]
        lacks = ~has & prescribed.any(axis=2)
        added = np.where(lacks[:, :, None], mean[:, None] - values, 0.0)
        if key == "rubbed":
            size = np.linalg.norm(added, axis=2, keepdims=True)
            added *= np.minimum(1.0, at["bound"] / np.maximum(size, LEAST_DIVISOR))
        tractions += added


def jumps(V: Any, contact: ContactFacets, v: fem.Function) -> Array:
    """Return the jumps (nodes of this rank, d) of a displacement at contact nodes. Collective."""
    values = v.x.array.reshape(-1, V.mesh.geometry.dim)
    owned = np.zeros_like(values[: V.dofmap.index_map.size_local])
    owned[contact.on.nodes] = _products(V, contact.on.primary, values[: len(owned)])
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

    Nodes of the secondary side move as little as possible. Collective.
    """
    dim = V.mesh.geometry.dim
    v = u.copy()
    values = v.x.array.reshape(-1, dim)
    owned = V.dofmap.index_map.size_local

    def move(nodes: Any, excess: Array, normals: Array, contact: ContactFacets) -> None:
        """Take the excess (m, d) of jumps, or its part along the normals, from nodes (m,)."""
        free = ~prescribed[nodes]
        steps = np.where(free, excess, 0.0)
        if not contact.on.bonded:
            along = normals * free
            squares = np.einsum("md,md->m", along, along)
            lengths = np.einsum("md,md->m", excess, normals)
            factors = np.divide(lengths, squares, out=np.zeros_like(lengths), where=squares > 0.1)
            steps = factors[:, None] * along
        # the owner of a node takes the mean of the steps from all facets
        sums = dolfinx.la.vector(V.dofmap.index_map, dim + 1)
        sums.array[:] = 0.0
        steps = np.hstack([steps, np.ones((len(steps), 1))])
        np.add.at(sums.array.reshape(-1, dim + 1), nodes, steps)
        sums.scatter_reverse(dolfinx.la.InsertMode.add)
        means = sums.array.reshape(-1, dim + 1)[:owned]
        values[:owned] -= means[:, :dim] / np.maximum(means[:, dim:], 1.0)
        v.x.scatter_forward()

    for contact in contacts:
        on = contact.on
        at_nodes = jumps(V, contact, v)[on.nodes]
        if not on.bonded:
            excess = np.maximum(np.einsum("nd,nd->n", at_nodes, on.normals) - on.gap, 0.0)
            at_nodes = excess[:, None] * on.normals
        move(on.nodes, at_nodes, on.normals, contact)
        if V.element.basix_element.degree > 1:
            # twice as far as the middle of an edge, its coefficient moves
            middles = coefficients(contact, jumps(V, contact, v), V.dofmap.list)[:, dim:]
            normals = np.repeat(contact.normals[:, None], middles.shape[1], axis=1)
            if not on.bonded:
                i, j = np.triu_indices(dim, 1)
                gaps = 0.5 * (contact.gaps[:, i] + contact.gaps[:, j])
                excess = np.maximum(np.einsum("med,med->me", middles, normals) - gaps, 0.0)
                middles = excess[:, :, None] * normals
            flat = 0.5 * middles.reshape(-1, dim), normals.reshape(-1, dim)
            move(contact.edges.ravel(), *flat, contact)
    return v


def defects(contact: ContactFacets, jump: Array, areas: Array) -> tuple[Array, Array, Array]:
    """Return what tractions and a displacement lack of the law of contact, facet by facet.

    Args:
        contact: the facets and their tractions.
        jump: (m, k, d) coefficients of the displacement's jumps, see `coefficients`.
        areas: (m,) areas of the facets.

    Returns:
        the integrals (m,) of p (d - v_n), upper bounds (m,) of those of g |v_t - s| + t (v_t - s),
        and the largest penetration, or jump of bonded surfaces, (m,).
    """
    m, size, d = jump.shape
    if contact.on.bonded:
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
