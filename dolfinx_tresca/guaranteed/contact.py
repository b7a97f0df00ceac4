"""Contact surfaces with admissible tractions, and by how much they miss the law of contact."""

from __future__ import annotations

import numpy as np
from scipy.sparse import kron

from dolfinx import fem

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices, Mask, unit
from dolfinx_tresca._base.parallel import largest_abs, reduce_array, summed_at_nodes
from dolfinx_tresca._base.petsc import as_petsc
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.guaranteed.cells import MeshCells, bernstein, mean_products, midpoint_values
from dolfinx_tresca.pairing.pair_surfaces import pair_displaced_surfaces
from dolfinx_tresca.pairing.undeformed import PairGroup, Undeformed
from dolfinx_tresca.scene.friction import Bonded, Frictionless
from dolfinx_tresca.scene.obstacle import RigidPlane
from dolfinx_tresca.scene.pair import SideName

#: Difference of unit normals, and of the weight of an opposite node from 1, that is rounding.
FLATNESS = 1e-8
#: Penetration relative to the largest displacement that counts as rounding.
PENETRATION = 1e-10


class ContactSurface:
    """The secondary surface of a pair, with tractions that are linear between nodes.

    The *nodes* are all nodes of V on this rank, n owned secondary ones of them are *facing* the
    primary side, and m facets of the rank's cells have only facing vertices.

    Attributes:
        cell: (m,) the cells of the secondary facets.
        sides: for the secondary side, and the primary one if it is a body: cells (m,), numbers of
            facets in cells (m,) and tractions at the facets' vertices (m, d, d) [stress].
    """

    def __init__(
        self, cells: MeshCells, dual: DualProgram, number: int, multipliers: Array, bounds: Array
    ) -> None:
        """Check that the bound covers pair `number`, and find its tractions. Collective.

        `multipliers` (size,) and slip `bounds` (nodes of all pairs,) [stress] are of the solution.
        """
        rows = dual.jump.by_pair[number]
        bounds = bounds[rows.nodes]
        group = rows.operators.undeformed.group
        self._pair = pair = group.pairs[group.numbers.index(number)]
        self._bonded = isinstance(pair.friction, Bonded)
        self._cells, V, d, comm = cells, cells.V, cells.d, cells.V.mesh.comm
        self._free = cells.spread(dual.jump.system.prescribed.reshape(-1, d)) == 0.0
        rigid = isinstance(pair.primary, RigidPlane)
        needed = (
            "contact with rigid planes, or of bodies of degree 1 whose meshes match on flat "
            "surfaces, with one law and one finite slip bound for all directions; contact pair "
            f"{pair} differs. Mesh both sides alike, make a pair of each flat side, and leave a "
            "gap between surfaces of different laws"
        )
        alike = all(neighbour.friction == pair.friction for neighbour in group.pairs)
        alike &= bool((rows.operators.semi_axes == 1.0).all() and np.isfinite(bounds).all())
        # all nodes, as if none were prescribed, are paired here; as displaced, without warnings
        nothing = np.zeros(V.dofmap.index_map_bs * V.dofmap.index_map.size_local, dtype=np.bool_)
        undeformed = Undeformed(V, nothing, PairGroup([pair]))
        (paired,) = pair_displaced_surfaces(V, undeformed, np.zeros(self._free.shape))
        matching = (np.diff(paired.primary.indptr) == 1).all() and not pair.touches_itself
        matching &= (np.abs(paired.primary.data - 1.0) < FLATNESS).all()
        cells.require(alike and (rigid or matching), needed)
        self._facing = paired.nodes
        # from unknowns to the displacements (n d,) of the opposite nodes; zero for a plane
        opposite_nodes = kron(paired.primary, np.eye(d), format="csr")
        self._opposite = as_petsc(V.dofmap.index_map, d, [opposite_nodes], comm)
        added_gap = 0.0 if pair.gap is None else pair.gap
        gaps = paired.distance + NodalValues(V).values_at(added_gap, self._facing, "the gap")[:, 0]
        self._gaps = self._at_nodes(gaps[:, None])
        # the facets all of whose vertices face the other side, and their tractions
        touching = self._with_opposites(np.ones_like(self._free, dtype=np.float64))[:, 0] != 0.0
        self.cell, self._facet, self._corners, outside = self._facets_of("secondary", touching)
        self._nodes = cells.facet_nodes[self.cell, self._facet]
        self._normal = unit(reduce_array(comm, paired.normals.sum(axis=0)))
        self._axes = np.eye(d) if self._bonded else self._normal[None]  # of bounded jumps
        tractions = self._with_opposites(self._nodal_tractions(dual, rows, multipliers, bounds))
        rim = f"multipliers at all nodes of pressed facets, unlike those at a rim of pair {pair}"
        cells.require(not tractions[outside].any(), rim)
        self._tractions = tractions[self._corners]
        self.sides = [(self.cell, self._facet, self._tractions)]
        if not rigid:
            cell, facet, corners, _ = self._facets_of("primary", touching)
            normals = [cells.normals[self.cell, self._facet], -cells.normals[cell, facet]]
            turned = np.concatenate(normals) - self._normal
            unpaired = comm.allreduce(len(cell) - len(self.cell))
            cells.require(not unpaired and (np.abs(turned) < FLATNESS).all(), needed)
            self.sides.append((cell, facet, tractions[corners]))

    def _facets_of(self, side: SideName, touching: Mask) -> tuple[Indices, ...]:
        """Find a side's m facets whose vertices are all in the mask `touching` (nodes,).

        Return their cells (m,), numbers in cells (m,) and vertices (m, d); vertices of all others.
        """
        tags, numbers = self._pair.given_tags(side)
        facets = np.concatenate([tags.find(number) for number in numbers])
        cell, facet = np.nonzero(np.isin(self._cells.facets, facets))
        vertices = np.einsum("mkk->mk", self._cells.facet_nodes[cell, facet])
        keep = touching[vertices].all(axis=1)
        return cell[keep], facet[keep], vertices[keep], vertices[~keep]

    def _nodal_tractions(
        self, dual: DualProgram, rows: RowsOfPair, multipliers: Array, bounds: Array
    ) -> Array:
        """Return admissible tractions (nodes, d), and set `_bounds`, `_origins` and `_pressed`.

        These are the slip bounds (nodes,), slip origins (nodes, d), and whether nodes (nodes,) are
        pressed. `bounds` are those at the nodes of `rows`. Nodes that lack a row of N or T, since a
        component is prescribed, get means of neighbours that lack none, one per facet. Collective.
        """
        V, operators, d = self._cells.V, rows.operators, self._cells.d
        stress = rows.nodal_vectors(multipliers * dual.jump.stress_scale)
        origin = rows.nodal_vectors((dual.offset - dual.jump.gap) * dual.jump.length_scale)
        components = 1 if isinstance(self._pair.friction, Frictionless) else d
        has_all = np.bincount(operators.row_node, minlength=len(operators.nodes)) == components
        # for each node its pressure, bound, traction and origin, and a 1, to count nodes in sums
        columns = np.column_stack([stress[:, 0], bounds, -stress[:, 1:], origin[:, 1:], has_all])
        values = np.zeros((V.dofmap.index_map.size_local, columns.shape[1]))
        values[operators.nodes] = has_all[:, None] * columns
        table = self._cells.spread(values)
        # nodes without all rows get sums over their facets' nodes, divided by the counts of nodes
        sums = np.repeat(table[self._corners].sum(axis=1, keepdims=True), d, axis=1)
        around = summed_at_nodes(V.dofmap.index_map, self._corners, sums)
        table = np.where(table[:, -1:] > 0.0, table, around)
        table /= np.maximum(table[:, -1:], 1.0)

        pressure, self._bounds, vectors = table[:, :1], table[:, 1], table[:, 2:-1]
        tangential = np.eye(d) - np.outer(self._normal, self._normal)
        friction, self._origins = vectors[:, :d] @ tangential, vectors[:, d:] @ tangential
        if not self._bonded:
            pressure = np.maximum(pressure, 0.0)
            share = self._bounds / np.maximum(np.linalg.norm(friction, axis=1), LEAST_DIVISOR)
            friction *= np.minimum(1.0, share)[:, None]
        self._pressed = self._bonded | (pressure[:, 0] > 0.0)
        return np.asarray(friction - pressure * self._normal)

    def _at_nodes(self, values: Array) -> Array:
        """Return values (n, k) of facing nodes at all nodes (nodes, k), else zero. Collective."""
        result = np.zeros((self._cells.V.dofmap.index_map.size_local, values.shape[1]))
        result[self._facing] = values
        return self._cells.spread(result)

    def _jumps(self, values: Array) -> Array:
        """Return values (nodes, d), at facing nodes minus those of opposite nodes. Collective."""
        unknowns, facing = self._opposite.createVecs()
        unknowns.array = values.ravel()[: unknowns.local_size]
        self._opposite.mult(unknowns, facing)
        return values - self._at_nodes(facing.array.reshape(-1, values.shape[1]))

    def _with_opposites(self, values: Array) -> Array:
        """Return values (nodes, d) at facing, minus them at opposite nodes, else 0. Collective."""
        unknowns, facing = self._opposite.createVecs()
        facing.array = values[self._facing].ravel()
        self._opposite.multTranspose(facing, unknowns)
        opposites = self._cells.spread(unknowns.array.reshape(-1, values.shape[1]))
        return self._at_nodes(values[self._facing]) - opposites

    def lift(self, v: fem.Function) -> None:
        """Change v such that nothing penetrates, and bonded surfaces have no jumps. Collective.

        Pressed nodes also close their gaps. Nodes of both sides move, unless v is prescribed there;
        with degree 2, the other side is a rigid plane. `room` is the change of jumps if all nodes
        of the secondary side that may move do so by 1 along `_axes`, and opposite ones by -1.
        """
        values, nodes = v.x.array.reshape(-1, self._cells.d), self._nodes
        axes = np.zeros_like(values) + self._axes.sum(axis=0)
        room = self._jumps(self._free * self._with_opposites(axes))
        steps = self._steps(self._jumps(values), self._gaps, self._pressed, room)
        values -= self._free * self._with_opposites(steps)
        if v.function_space.element.basix_element.degree == 2:
            pressed, gaps = self._pressed[self._corners], midpoint_values(self._gaps[self._corners])
            pressed = pressed[:, :, None] & pressed[:, None]
            # a coefficient moves twice as far as a midpoint; a node takes the mean of its facets
            coefficients = bernstein(self._jumps(values)[nodes])
            moves = 0.5 * self._steps(coefficients, gaps, pressed, (self._free * axes)[nodes])
            moves = np.concatenate([moves, np.ones((*nodes.shape, 1))], axis=3)
            sums = summed_at_nodes(v.function_space.dofmap.index_map, nodes, moves)
            values -= self._free * sums[:, :-1] / np.maximum(sums[:, -1:], 1.0)

    def _steps(self, jumps: Array, gaps: Array, pressed: Mask, room: Array) -> Array:
        """Return moves (..., d), in parts of `room`, that make jumps (..., d) admissible."""
        excess = jumps @ self._axes.T - gaps
        excess = np.where(pressed[..., None], excess, np.maximum(excess, 0.0))
        room = room @ self._axes.T
        steps = np.divide(excess, room, out=np.zeros_like(room), where=room > 0.1)
        return np.asarray(steps @ self._axes)

    def defects(self, v: fem.Function) -> Array:
        """Return by how much tractions and v miss the law of contact, (m, 2) [energy]. Collective.

        For each facet, the columns are the integral of p (gap - v_n), and an upper bound of that of
        g |v_t - s| + t.(v_t - s), with the jump v_n, v_t of v, the pressure p, slip bound g,
        friction t and slip origin s: the norms of Bernstein's coefficients, as norms are convex.

        Raises:
            InputError: v penetrates, or bonded surfaces have jumps, since v is prescribed so.
        """
        jumps = bernstein(self._jumps(v.x.array.reshape(-1, self._cells.d))[self._nodes])
        closing, pressure = jumps @ self._normal, -self._tractions @ self._normal
        friction = self._tractions + pressure[:, :, None] * self._normal
        openings = midpoint_values(self._gaps[self._corners])[..., 0] - closing
        slips = jumps - closing[..., None] * self._normal
        slips -= midpoint_values(self._origins[self._corners])
        areas = self._cells.areas[self.cell, self._facet]
        products = areas[:, None, None, None] * mean_products(self._cells.d, 3)
        bounds, sizes = self._bounds[self._corners], np.linalg.norm(slips, axis=3)
        complementarity = np.einsum("mk,mkij,mij->m", pressure, products, openings)
        lack = np.einsum("mk,mkij,mij->m", bounds, products, sizes)
        lack += np.einsum("mkd,mkij,mijd->m", friction, products, slips)
        depths = jumps if self._bonded else np.minimum(openings, 0.0)
        deepest, size = largest_abs(self._cells.V.mesh.comm, depths, v.x.array)
        needed = f"prescribed displacements that do not penetrate, unlike those of {self._pair}"
        self._cells.require(deepest <= PENETRATION * size, needed)
        return np.stack([complementarity, lack], axis=1)
