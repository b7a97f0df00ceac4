"""Contact surfaces with admissible tractions, and what they lack of the law of contact."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from scipy.sparse import kron

from dolfinx import fem

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices, Mask
from dolfinx_tresca._base.parallel import reduce_array, summed_at_nodes
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.guaranteed.cells import OwnedCells, mean_products, require, spread
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc, joined
from dolfinx_tresca.pairing.pair_surfaces import pair_group
from dolfinx_tresca.pairing.undeformed import PairGroup
from dolfinx_tresca.scene.friction import Bonded, Frictionless
from dolfinx_tresca.scene.obstacle import RigidPlane
from dolfinx_tresca.scene.pair import SideName

#: Difference of unit normals, and of entries of the primary side's means from 1, that count as
#: rounding.
FLATNESS = 1e-8


class ContactSurface:
    """The secondary surface of a pair, with tractions that are linear between nodes.

    Attributes:
        pair: the contact pair.
        bonded: whether its surfaces are bonded.
        nodes: (n,) the vertices of this rank that face the primary side, prescribed ones included.
        normal: (d,) the contact normal: of the secondary side, or towards the rigid plane.
        cell: (m,) the cells of the secondary facets.
        facet: (m,) the numbers of these facets in their cells.
        tractions: (m, d, d) tractions on the secondary facets at their vertices [stress].
        sides: cells (m,), numbers of facets (m,) and tractions (m, d, d) of the secondary side, and
            of the primary side if it is a body.
    """

    def __init__(
        self,
        owned: OwnedCells,
        dual: DualProgram,
        number: int,
        multipliers: Array,
        bounds: Array,
        prescribed: Mask,
    ) -> None:
        """Interpolate the multipliers of a pair between nodes. Collective.

        Args:
            owned: the cells of this rank.
            dual: the dual problem.
            number: the number of the pair.
            multipliers: (size,) the multipliers.
            bounds: (nodes of all pairs,) slip bounds [stress].
            prescribed: (nodes of this rank, d) prescribed degrees of freedom.

        Raises:
            InputError: the bound does not cover such surfaces, or such friction.
        """
        rows = dual.jump.by_pair[number]
        group = rows.operators.undeformed.group
        member = group.numbers.index(number)
        self.pair = pair = group.pairs[member]
        self._owned, self._free = owned, ~prescribed
        self.bonded = isinstance(pair.friction, Bonded)
        V, d, comm = owned.V, owned.cells.d, owned.V.mesh.comm
        rigid = isinstance(pair.primary, RigidPlane)
        finite = self.bonded or np.isfinite(bounds[rows.nodes]).all()
        alike = all(member.friction == pair.friction for member in group.pairs)
        require(
            comm,
            alike and finite and (rows.operators.semi_axes == 1.0).all(),
            "surfaces of one law with one finite slip bound for all directions, unlike those "
            f"of contact pair {pair}. Leave a gap between surfaces of different laws",
        )
        matching = (
            "rigid planes, or bodies of degree 1 whose meshes match on flat surfaces, and those of "
            f"contact pair {pair} do not. Mesh both alike, and make a pair of each flat side"
        )
        every = _with_all_nodes(V, group)
        every = every.at_nodes(every.shares[:, member] > 0.0)
        nodewise = pair.obstacle is None and not pair.touches_itself
        nodewise = nodewise and (np.diff(every.primary.indptr) == 1).all()
        nodewise = nodewise and (np.abs(every.primary.data - 1.0) < FLATNESS).all()
        require(comm, rigid or nodewise, matching)
        self.nodes, self._jump = every.nodes, None
        self._faces = self._at_nodes(np.ones((len(self.nodes), 1)))
        if not rigid:
            jump = kron(every.jump, np.eye(d), format="csr")
            self._jump = as_petsc(V.dofmap.index_map, d, [jump], comm)
        gaps = np.zeros(len(self.nodes)) if self.bonded else every.distance
        if pair.gap is not None and not self.bonded:
            name = f"the gap of contact pair {pair}"
            gaps = gaps + NodalValues(V).scalars_at(pair.gap, self.nodes, name)
        self._gaps = self._at_nodes(gaps[:, None])[:, 0]

        touching = self._carried(np.ones_like(self._free, dtype=np.float64))[:, 0] != 0.0
        self.cell, self.facet, nodes, outside = self._facets_of("secondary", touching)
        self._corners, self._middles = np.split(nodes, [d], axis=1)
        normals = owned.cells.normals[self.cell, self.facet]
        if rigid:
            self.normal = -pair.primary.at(np.zeros((1, 3)))[1][0, :d]
        else:
            total = reduce_array(comm, normals.sum(axis=0))
            self.normal = total / np.linalg.norm(total)
        self._axes = np.eye(d) if self.bonded else self.normal[None]
        tractions = self._carried(self._nodal_tractions(dual, rows, multipliers, bounds))
        require(
            comm,
            not tractions[outside].any(),
            f"multipliers at all nodes of pressed facets, and contact pair {pair} has pressed "
            "facets at a rim",
        )
        require(
            comm,
            not prescribed[nodes].all(axis=1).any(),
            "contact surfaces without prescribed displacements, and some facets of contact pair "
            f"{pair} have them",
        )
        self.tractions = tractions[self._corners]
        self.sides = [(self.cell, self.facet, self.tractions)]
        if not rigid:
            cell, facet, nodes, _ = self._facets_of("primary", touching)
            turned = np.vstack([normals, -owned.cells.normals[cell, facet]]) - self.normal
            unpaired = comm.allreduce(len(cell) - len(self.cell))
            require(comm, not unpaired and (np.abs(turned) < FLATNESS).all(), matching)
            self.sides.append((cell, facet, tractions[nodes]))

    def _facets_of(
        self, side: SideName, touching: Mask
    ) -> tuple[Indices, Indices, Indices, Indices]:
        """Return the facets of a side whose vertices all touch.

        Returns:
            their cells (m,), their numbers (m,) in these, and their nodes (m, k), those at the
            vertices before those in the middles of edges; and the vertices of the other facets.
        """
        tags, numbers = self.pair.given_tags(side)
        facets = np.concatenate([tags.find(number) for number in numbers])
        cell, facet = np.nonzero(np.isin(self._owned.facets, facets))
        nodes = self._owned.nodes[cell[:, None], self._owned.on_facets[facet]]
        vertices = nodes[:, : self._owned.cells.d]
        keep = touching[vertices].all(axis=1)
        return cell[keep], facet[keep], nodes[keep], vertices[~keep]

    def _nodal_tractions(
        self, dual: DualProgram, rows: RowsOfPair, multipliers: Array, bounds: Array
    ) -> Array:
        """Return admissible tractions (nodes, d), and set the data of the law. Collective.

        Nodes whose multipliers lack components, which are prescribed, have means of neighbours.
        """
        V, pair, d = self._owned.V, rows.operators, self._owned.cells.d
        stress = multipliers * dual.jump.stress_scale
        origin = (dual.offset - dual.jump.gap) * dual.jump.length_scale
        values = np.zeros((V.dofmap.index_map.size_local, 2 * d + 3))
        values[pair.nodes[pair.normal_node], 0] = stress[rows.normal]
        values[pair.nodes, 1] = 0.0 if self.bonded else bounds[rows.nodes]
        values[pair.nodes, 2 : d + 2] = -pair.tangential_vectors(stress[rows.tangential])
        values[pair.nodes, d + 2 : -1] = pair.tangential_vectors(origin[rows.tangential])
        components = 1 if isinstance(self.pair.friction, Frictionless) else d
        counts = np.bincount(pair.row_node, minlength=len(pair.nodes))
        values[pair.nodes, -1] = counts == components
        table = spread(V, values * values[:, -1:])
        sums = np.repeat(table[self._corners].sum(axis=1, keepdims=True), d, axis=1)
        around = summed_at_nodes(V.dofmap.index_map, self._corners, sums)
        table = np.where(table[:, -1:] > 0.0, table, around)
        table /= np.maximum(table[:, -1:], 1.0)

        pressure, self._bounds, vectors = table[:, :1], table[:, 1], table[:, 2:-1]
        across = np.eye(d) - np.outer(self.normal, self.normal)
        friction, self._origins = vectors[:, :d] @ across, vectors[:, d:] @ across
        if not self.bonded:
            pressure = np.maximum(pressure, 0.0)
            sizes = np.linalg.norm(friction, axis=1)
            share = np.minimum(1.0, self._bounds / np.maximum(sizes, LEAST_DIVISOR))
            friction *= share[:, None]
        self._pressed = self.bonded | (pressure[:, 0] > 0.0)
        return np.asarray(friction - pressure * self.normal)

    def _at_nodes(self, values: Array) -> Array:
        """Return values (nodes, k) that are given (n, k) at `nodes`, zero elsewhere. Collective."""
        result = np.zeros((self._owned.V.dofmap.index_map.size_local, values.shape[1]))
        result[self.nodes] = values
        return spread(self._owned.V, result)

    def _jumps(self, values: Array) -> Array:
        """Return the jumps (nodes, d) of a displacement (nodes, d). Collective."""
        if self._jump is None:
            return values
        unknowns, jumps = self._jump.createVecs()
        unknowns.array = values.ravel()[: unknowns.local_size]
        self._jump.mult(unknowns, jumps)
        return self._at_nodes(jumps.array.reshape(-1, values.shape[1]))

    def _carried(self, values: Array) -> Array:
        """Return values (nodes, d) of `nodes` there, and their opposites at partners. Collective.

        This is the transpose of the jump.
        """
        if self._jump is None:
            return values * self._faces
        unknowns, jumps = self._jump.createVecs()
        jumps.array = values[self.nodes].ravel()
        self._jump.multTranspose(jumps, unknowns)
        return spread(self._owned.V, unknowns.array.reshape(-1, values.shape[1]))

    def _coefficients(self, values: Array) -> Array:
        """Return Bernstein's coefficients (m, k, d) of jumps on the secondary facets. Collective.

        Jumps, taken as quadratic functions, are between their least and largest coefficients: the
        values at the vertices, and for each edge twice the value in its middle minus the mean of
        its ends.
        """
        jumps = self._jumps(values)
        corners = jumps[self._corners]
        i, j = np.triu_indices(corners.shape[1], 1)
        middles = means = 0.5 * (corners[:, i] + corners[:, j])
        if self._middles.size:
            middles = 2.0 * jumps[self._middles] - means
        return np.concatenate([corners, middles], axis=1)

    def lift(self, v: fem.Function) -> None:
        """Move nodes such that nothing penetrates, and bonded surfaces have no jumps. Collective.

        Pressed nodes also close their gaps. The nodes of both sides move, where they are free.

        Args:
            v: the displacement, which changes.
        """
        d, axes = self._owned.cells.d, self._axes.sum(axis=0)
        values = v.x.array.reshape(-1, d)
        room = self._jumps(self._free * self._carried(np.tile(axes, (len(values), 1))))
        steps = self._steps(self._jumps(values), self._gaps, self._pressed, room)
        values -= self._free * self._carried(steps)
        if self._middles.shape[1]:  # degree 2
            i, j = np.triu_indices(d, 1)
            start, end = self._corners[:, i], self._corners[:, j]
            gaps = 0.5 * (self._gaps[start] + self._gaps[end])
            pressed = self._pressed[start] & self._pressed[end]
            jumps = self._coefficients(values)[:, d:]
            # a coefficient moves twice as far as the middle; a node takes the mean of its facets
            moves = 0.5 * self._steps(jumps, gaps, pressed, self._free[self._middles] * axes)
            moves = np.concatenate([moves, np.ones((*moves.shape[:2], 1))], axis=2)
            sums = summed_at_nodes(self._owned.V.dofmap.index_map, self._middles, moves)
            values -= self._free * sums[:, :d] / np.maximum(sums[:, d:], 1.0)

    def _steps(self, jumps: Array, gaps: Array, pressed: Mask, room: Array) -> Array:
        """Return moves (..., d) by which jumps (..., d) become admissible, where there is room."""
        excess = jumps @ self._axes.T - gaps[..., None]
        excess = np.where(pressed[..., None], excess, np.maximum(excess, 0.0))
        room = room @ self._axes.T
        steps = np.divide(excess, room, out=np.zeros_like(room), where=room > 0.1)
        return np.asarray(steps @ self._axes)

    def defects(self, v: fem.Function) -> tuple[Array, Array, float]:
        """Return by how much tractions and jumps miss the law of contact. Collective.

        Returns:
            the integrals (m,) over facets of p (d - v_n), upper bounds (m,) of those of
            g |v_t - s| + t (v_t - s), and the largest penetration, or jump of bonded surfaces.
        """
        d = self._owned.cells.d
        jumps = self._coefficients(v.x.array.reshape(-1, d))
        # integrals of products of the hats of vertices and Bernstein's quadratic functions
        i, j = np.triu_indices(d, 1)
        products, hats = mean_products(d, 3), np.eye(d)
        mass = np.concatenate([np.einsum("kll->kl", products), 2.0 * products[:, i, j]], axis=1)
        elevation = np.vstack([hats, 0.5 * (hats[i] + hats[j])])
        closing, pressure = jumps @ self.normal, -self.tractions @ self.normal
        friction = self.tractions + pressure[:, :, None] * self.normal
        slips = jumps - closing[:, :, None] * self.normal
        slips = slips - elevation @ self._origins[self._corners]
        openings = self._gaps[self._corners] @ elevation.T - closing
        areas = self._owned.cells.areas[self.cell, self.facet]
        bounds = self._bounds[self._corners]
        complementarity = np.einsum("mk,kl,ml->m", pressure, mass, openings)
        lack = np.einsum("mk,kl,ml->m", bounds, mass, np.linalg.norm(slips, axis=2))
        lack += np.einsum("mkd,kl,mld->m", friction, mass, slips)
        depth = np.abs(jumps) if self.bonded else -openings
        return areas * complementarity, areas * lack, float(depth.max(initial=0.0))


def _with_all_nodes(V: Any, group: PairGroup) -> PairOperators:
    """Pair surfaces as if nothing were prescribed: all nodes have jumps and distances. Collective.

    The log has the pairing of the problem already.
    """
    logger = logging.getLogger("dolfinx_tresca")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        nothing = np.zeros(V.dofmap.index_map_bs * V.dofmap.index_map.size_local, dtype=np.bool_)
        return joined(pair_group(V, nothing, group))
    finally:
        logger.setLevel(level)
