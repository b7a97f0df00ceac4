"""Contact surfaces with admissible tractions, and what they lack of the law of contact."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from dolfinx import fem

from dolfinx_tresca._base.arrays import (
    LEAST_DIVISOR,
    Array,
    Indices,
    Mask,
)
from dolfinx_tresca._base.parallel import (
    errors_on_all_ranks,
    exchange,
    gather_rows,
    summed_at_nodes,
)
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.cells import mean_products
from dolfinx_tresca.guaranteed.mesh_cells import Copies, OwnedCells, spread
from dolfinx_tresca.scene.friction import Bonded, Frictionless
from dolfinx_tresca.scene.obstacle import RigidPlane
from dolfinx_tresca.scene.pair import ContactPair

#: Difference of unit normals, and of entries of the primary side's means from 1, that count as
#: rounding; for distances relative to the size of the mesh.
FLATNESS = 1e-8


class ContactSurface:
    """The secondary surface of a pair, with tractions that are linear between nodes.

    Attributes:
        pair: the contact pair.
        bonded: whether its surfaces are bonded.
        cell: (m,) the cells of the secondary facets.
        facet: (m,) the numbers of these facets in their cells.
        normals: (m, d) their unit normals.
        tractions: (m, d, d) tractions on the secondary facets at their vertices [stress].
        sides: cells (m,), numbers of facets (m,) and tractions (m, d, d) of the secondary side, and
            of the primary side if it is a body.
    """

    def __init__(
        self,
        owned: OwnedCells,
        dual: DualProgram,
        pair: ContactPair,
        rows: RowsOfPair,
        multipliers: Array,
        bounds: Array,
        prescribed: Mask,
    ) -> None:
        """Interpolate the multipliers of a pair between nodes. Collective.

        Args:
            owned: the cells of this rank.
            dual: the dual problem.
            pair: the pair.
            rows: rows of B that act on the pair.
            multipliers: (size,) the multipliers.
            bounds: (nodes of all pairs,) slip bounds [stress].
            prescribed: (nodes of this rank, d) prescribed degrees of freedom.

        Raises:
            InputError: the bound does not cover such surfaces, or such friction.
        """
        self.pair, self._owned, self._prescribed = pair, owned, prescribed
        self.bonded = isinstance(pair.friction, Bonded)
        V, d = owned.V, owned.cells.d
        self._check(dual, rows, bounds)
        cell, facet, nodes = self._tagged("secondary")
        tractions, distance, touching = self._interpolate(
            nodes[:, :d], dual, rows, multipliers, bounds
        )
        points = V.tabulate_dof_coordinates()
        self.nodes: Indices = np.flatnonzero(touching[: V.dofmap.index_map.size_local])
        self._gaps = self._nodal_gaps(points, distance, touching)

        keep = touching[nodes[:, :d]].all(axis=1)
        outside = nodes[~keep, :d]
        near = FLATNESS * np.ptp(points, axis=0).max(initial=0.0)
        self.cell, self.facet = cell[keep], facet[keep]
        self._corners, self._middles = np.split(nodes[keep], [d], axis=1)
        self.normals = owned.cells.normals[self.cell, self.facet]
        self.tractions = tractions[self._corners]
        turned = np.abs(self._normals[self._corners] - self.normals[:, None])
        tilted = np.ptp(distance[self._corners], axis=1)
        with errors_on_all_ranks(V.mesh.comm):
            if tractions[outside][touching[outside]].any():
                raise InputError(
                    "a guaranteed bound needs multipliers at all nodes of pressed facets, and "
                    f"contact pair {pair} has pressed facets at a rim."
                )
            if turned.max(initial=0.0) > FLATNESS:
                raise InputError(
                    "a guaranteed bound needs contact normals that do not turn, and those of "
                    f"contact pair {pair} do. Replace curved surfaces by planes."
                )
            if not isinstance(pair.primary, RigidPlane) and tilted.max(initial=0.0) > near:
                raise self._no_match()
        self._partners: Copies | None = None
        self.sides = [(self.cell, self.facet, self.tractions)]
        if not isinstance(pair.primary, RigidPlane):
            places = points[:, :d] + distance[:, None] * self._normals
            self._pair_nodes(places, near)
            self.sides.append(self._opposite(tractions))

    def _check(self, dual: DualProgram, rows: RowsOfPair, bounds: Array) -> None:
        """Refuse what the bound does not cover. Collective."""
        pair, on = self.pair, rows.operators
        matches = (np.diff(on.primary.indptr) == 1).all()
        matches = matches and bool((np.abs(on.primary.data - 1.0) < FLATNESS).all())
        with errors_on_all_ranks(self._owned.V.mesh.comm):
            if not isinstance(pair.primary, RigidPlane | int):
                raise InputError(
                    f"a guaranteed bound needs rigid planes or meshes that match, and contact pair "
                    f"{pair} has {pair.primary} as its primary side."
                )
            if isinstance(pair.primary, int) and not matches:
                raise self._no_match()
            finite = on.bonded or np.isfinite(bounds[rows.nodes]).all()
            if (on.semi_axes != 1.0).any() or not finite:
                raise InputError(
                    "a guaranteed bound needs one finite slip bound for all directions, and "
                    f"contact pair {pair} has two, or an infinite one."
                )
            if any(member.friction != pair.friction for member in on.undeformed.group.pairs):
                raise InputError(
                    "a guaranteed bound needs the same law for all pairs of the surface of contact "
                    f"pair {pair}. Leave a gap between surfaces of different laws."
                )
            if len(np.unique(on.nodes)) < len(on.nodes):
                raise InputError(
                    f"a guaranteed bound needs flat surfaces, and contact pair {pair} has sharp "
                    "edges. Make a pair of each side."
                )

    def _interpolate(
        self, nodes: Indices, dual: DualProgram, rows: RowsOfPair, multipliers: Array, bounds: Array
    ) -> tuple[Array, Array, Mask]:
        """Set the data of the law at nodes, ghosts included. Collective.

        Returns:
            the tractions (nodes, d), initial distances (nodes,) of the surfaces, and whether a node
            has a multiplier, or is prescribed and on a facet with multipliers (nodes,).
        """
        V, on, d = self._owned.V, rows.operators, self._owned.cells.d
        stress = multipliers * dual.jump.stress_scale
        origin = (dual.response.offset - dual.jump.gap) * dual.jump.length_scale
        # components of multipliers that prescribed displacements replace stay unknown
        rubs = np.bincount(on.tangent_node, minlength=len(on.nodes)) == d - 1
        rubs |= isinstance(self.pair.friction, Frictionless)
        data = np.full((V.dofmap.index_map.size_local, 3 * d + 3), np.nan)
        data[on.nodes[on.normal_node], 0] = stress[rows.normal]
        data[on.nodes[rubs], 1 : d + 1] = -on.tangential_vectors(stress[rows.tangential])[rubs]
        radius = np.zeros(len(on.nodes)) if self.bonded else bounds[rows.nodes]
        origins = on.tangential_vectors(origin[rows.tangential])
        data[on.nodes, d + 1 :] = np.column_stack([on.normals, origins, radius, on.distance])
        paired = spread(V, np.isfinite(data[:, -1:]).astype(np.float64))[:, 0] > 0.0
        data, touching = _with_means(V, nodes, data)
        touching &= paired | self._prescribed.all(axis=1)
        pressure, friction, normals, self._origins, radius, distance = np.split(
            data, np.cumsum([1, d, d, d, 1]), axis=1
        )
        friction -= (friction * normals).sum(axis=1, keepdims=True) * normals
        if not self.bonded:
            pressure = np.maximum(pressure, 0.0)
            sizes = np.linalg.norm(friction, axis=1, keepdims=True)
            friction *= np.minimum(1.0, radius / np.maximum(sizes, LEAST_DIVISOR))
        self._normals, self._bounds, self._pressure = normals, radius[:, 0], pressure[:, 0]
        return friction - pressure * normals, distance[:, 0], touching

    def _nodal_gaps(self, points: Array, distance: Array, touching: Mask) -> Array:
        """Return the gaps (nodes,) of touching nodes. Collective."""
        V, pair, own = self._owned.V, self.pair, self.nodes.astype(np.int32)
        if isinstance(pair.primary, RigidPlane):
            heights, normals = pair.primary.at(points)
            cosine = -np.einsum("nd,nd->n", self._normals, normals[:, : self._owned.cells.d])
            distance = heights / np.where(touching, cosine, 1.0)
        gaps = distance[: V.dofmap.index_map.size_local, None].copy()
        if pair.gap is not None:
            name = f"the gap of contact pair {pair}"
            gaps[own, 0] += NodalValues(V).scalars_at(pair.gap, own, name)
        return spread(V, gaps)[:, 0]

    def _no_match(self) -> InputError:
        return InputError(
            "a guaranteed bound needs rigid planes, or bodies of degree 1 whose meshes match on "
            f"flat surfaces, and those of contact pair {self.pair} do not. Mesh both surfaces "
            "alike."
        )

    def _tagged(self, side: Literal["secondary", "primary"]) -> tuple[Indices, Indices, Indices]:
        """Return the cells (m,) of a side's facets, their numbers (m,), and their nodes (m, k).

        The nodes are those at the vertices, then those in the middles of the edges.
        """
        tags, numbers = self.pair.given_tags(side)
        facets = np.concatenate([tags.find(number) for number in numbers])
        cell, facet = np.nonzero(np.isin(self._owned.facets, facets))
        return cell, facet, self._owned.nodes[cell[:, None], self._owned.on_facets[facet]]

    def _pair_nodes(self, places: Array, near: float) -> None:
        """Find the opposite nodes of all touching nodes. Collective.

        Prescribed nodes at a rim have no multipliers, and no row of the pairing: all nodes are
        found by their places.

        Args:
            places: (nodes, d) positions of the opposite nodes.
            near: distance [length] that counts as rounding.
        """
        V, d = self._owned.V, self._owned.cells.d
        comm, index_map = V.mesh.comm, V.dofmap.index_map
        _, _, side = self._tagged("primary")
        uses = summed_at_nodes(index_map, side, np.ones((*side.shape, 1)))
        (numbers,) = np.nonzero(uses[: index_map.size_local, 0])
        points = V.tabulate_dof_coordinates()[numbers, :d]
        rows = gather_rows(comm, np.column_stack([points, numbers + index_map.local_range[0]]))
        distance, nearest = cKDTree(rows[:, :d]).query(places[self.nodes])
        with errors_on_all_ranks(comm):
            if distance.max(initial=0.0) > near:
                raise self._no_match()
        partner = rows[nearest, d].astype(np.int64)
        starts = np.array(comm.allgather(index_map.local_range[0]))
        rank = np.searchsorted(starts, partner, side="right") - 1
        order = np.argsort(rank, kind="stable")  # the order of the answers
        self.nodes = self.nodes[order]
        numbers, sources = exchange(comm, partner[order], rank[order])
        self._partners = Copies(comm, numbers - index_map.local_range[0], sources)

    def _opposite(self, tractions: Array) -> tuple[Indices, Indices, Array]:
        """Return the primary side's cells, numbers of facets, and tractions. Collective."""
        sums = self._carried(np.column_stack([tractions, np.ones(len(tractions))])[self.nodes])
        cell, facet, nodes = self._tagged("primary")
        keep = (sums[nodes, -1] < 0.0).all(axis=1)
        if self._owned.V.mesh.comm.allreduce(int(keep.sum()) - len(self.cell)):
            raise self._no_match()
        return cell[keep], facet[keep], sums[nodes[keep], :-1]

    def _carried(self, values: Array) -> Array:
        """Return values (nodes, k) of `nodes` there, and their opposites at partners. Collective.

        This is the transpose of the jump.
        """
        V = self._owned.V
        result = np.zeros((V.dofmap.index_map.size_local, values.shape[1]))
        result[self.nodes] = values
        if self._partners is not None:
            result -= self._partners.summed(values, len(result))
        return spread(V, result)

    def _jumps(self, v: fem.Function) -> Array:
        """Return jumps (nodes, d) of a displacement at the nodes of this rank. Collective."""
        values: Array = v.x.array.reshape(-1, self._owned.cells.d)
        if self._partners is None:
            return values
        owned = np.zeros_like(values[: self._owned.V.dofmap.index_map.size_local])
        owned[self.nodes] = values[self.nodes] - self._partners.spread(values)
        return spread(self._owned.V, owned)

    def coefficients(self, v: fem.Function) -> Array:
        """Return Bernstein's coefficients (m, k, d) of jumps on the secondary facets. Collective.

        Jumps, taken as quadratic functions, are between their least and largest coefficients: the
        values at the vertices, and for each edge twice the value in its middle minus the mean of
        its ends.
        """
        jumps = self._jumps(v)
        corners = jumps[self._corners]
        i, j = np.triu_indices(corners.shape[1], 1)
        means = 0.5 * (corners[:, i] + corners[:, j])
        middles = 2.0 * jumps[self._middles] - means if self._middles.size else means
        return np.concatenate([corners, middles], axis=1)

    def _excess(self, jumps: Array, normals: Array, gaps: Array, pressed: Mask) -> Array:
        """Return by how much jumps (..., d) are wrong: they penetrate, or are open but pressed."""
        if self.bonded:
            return jumps
        depth = np.einsum("...d,...d->...", jumps, normals) - gaps
        depth = np.where(pressed, depth, np.maximum(depth, 0.0))
        return np.asarray(depth[..., None] * normals)

    def _allowed(self, nodes: Any, excess: Array, normals: Array) -> Array:
        """Return the moves (..., d) of nodes that take an excess of jumps, where they are free."""
        free = ~self._prescribed[nodes]
        if self.bonded:
            return np.asarray(np.where(free, excess, 0.0))
        along = normals * free
        squares = (along * along).sum(axis=-1, keepdims=True)
        lengths = (excess * normals).sum(axis=-1, keepdims=True)
        factors = np.divide(lengths, squares, out=np.zeros_like(lengths), where=squares > 0.1)
        return np.asarray(factors * along)

    def lift(self, v: fem.Function) -> None:
        """Move nodes such that nothing penetrates, and bonded surfaces have no jumps. Collective.

        Pressed nodes also close their gaps. Nodes of the secondary side move, where they are
        prescribed the opposite nodes.

        Args:
            v: the displacement, which changes.
        """
        V, d, own = self._owned.V, self._owned.cells.d, self.nodes
        values = v.x.array.reshape(-1, d)
        pressed = self._pressure > 0.0
        normals, gaps = self._normals[own], self._gaps[own]
        excess = self._excess(self._jumps(v)[own], normals, gaps, pressed[own])
        values[own] -= self._allowed(own, excess, normals)
        v.x.scatter_forward()
        if self._partners is not None:  # their nodes take what prescribed nodes leave
            excess = self._excess(self._jumps(v)[own], normals, gaps, pressed[own])
            moves = self._carried(np.hstack([excess, normals]))
            values -= self._allowed(slice(None), moves[:, :d], moves[:, d:])
        if V.element.basix_element.degree > 1:
            i, j = np.triu_indices(d, 1)
            middles = self.coefficients(v)[:, d:]
            ends = self._corners[:, i], self._corners[:, j]
            normals = np.repeat(self.normals[:, None], len(i), axis=1)
            gaps = 0.5 * (self._gaps[ends[0]] + self._gaps[ends[1]])
            excess = self._excess(middles, normals, gaps, pressed[ends[0]] & pressed[ends[1]])
            # a coefficient moves twice as far as the middle of its edge
            moves = self._allowed(self._middles, 0.5 * excess, normals)
            # a node takes the mean of the moves for all its facets
            moves = np.concatenate([moves, np.ones((*self._middles.shape, 1))], axis=2)
            sums = summed_at_nodes(V.dofmap.index_map, self._middles, moves)
            values -= sums[:, :d] / np.maximum(sums[:, d:], 1.0)

    def defects(self, v: fem.Function) -> tuple[Array, Array, float]:
        """Return by how much tractions and jumps miss the law of contact. Collective.

        Returns:
            the integrals (m,) over facets of p (d - v_n), upper bounds (m,) of those of
            g |v_t - s| + t (v_t - s), and the largest penetration, or jump of bonded surfaces.
        """
        jumps, d = self.coefficients(v), self._owned.cells.d
        if self.bonded:
            nothing = np.zeros(len(jumps))
            return nothing, nothing, float(np.abs(jumps).max(initial=0.0))
        # integrals of products of the hats of vertices and Bernstein's quadratic functions
        i, j = np.triu_indices(d, 1)
        products, hats = mean_products(d, 3), np.eye(d)
        mass = np.concatenate([np.einsum("kll->kl", products), 2.0 * products[:, i, j]], axis=1)
        elevation = np.vstack([hats, 0.5 * (hats[i] + hats[j])])
        normal = np.einsum("mkd,md->mk", jumps, self.normals)
        pressure = -np.einsum("mkd,md->mk", self.tractions, self.normals)
        friction = self.tractions + pressure[:, :, None] * self.normals[:, None]
        slips = jumps - normal[:, :, None] * self.normals[:, None]
        slips = slips - elevation @ self._origins[self._corners]
        openings = self._gaps[self._corners] @ elevation.T - normal
        areas = self._owned.cells.areas[self.cell, self.facet]
        bounds = self._bounds[self._corners]
        complementarity = np.einsum("mk,kl,ml->m", pressure, mass, openings)
        lack = np.einsum("mk,kl,ml->m", bounds, mass, np.linalg.norm(slips, axis=2))
        lack += np.einsum("mkd,kl,mld->m", friction, mass, slips)
        return areas * complementarity, areas * lack, float((-openings).max(initial=0.0))


def _with_means(V: Any, nodes: Indices, values: Array) -> tuple[Array, Mask]:
    """Return values at the nodes of this rank, where NaN is replaced by means. Collective.

    Args:
        V: the space of the displacement.
        nodes: (m, d) the nodes of facets, whose values have part in the means of the others.
        values: (owned nodes, k).

    Returns:
        the values (nodes, k), zero where no mean exists, and whether a node has all but the first
        entries: those of the last column (nodes,).
    """
    present = np.isfinite(values)
    table = spread(V, np.hstack([np.where(present, values, 0.0), present]))
    sums, counts = np.split(table[nodes].sum(axis=1, keepdims=True), 2, axis=2)
    means = np.concatenate([sums / np.maximum(counts, 1.0), counts > 0.0], axis=2)
    means = np.repeat(means, nodes.shape[1], axis=1)
    around = summed_at_nodes(V.dofmap.index_map, nodes, means)
    (result, given), (sums, counts) = (np.split(array, 2, axis=1) for array in (table, around))
    result = np.where(given > 0.0, result, sums / np.maximum(counts, 1.0))
    return result, (given + counts)[:, -1] > 0.0
