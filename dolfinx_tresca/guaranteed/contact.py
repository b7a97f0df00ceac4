"""Contact surfaces with admissible tractions, and what they lack of the law of contact."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import kron

import ufl
from dolfinx import fem
from dolfinx.mesh import meshtags

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices, Mask
from dolfinx_tresca._base.parallel import reduce_array, summed_at_nodes
from dolfinx_tresca.dual.jump import RowsOfPair
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.guaranteed.cells import bernstein, bernstein_means, bernstein_points
from dolfinx_tresca.guaranteed.mesh_cells import OwnedCells, require, spread
from dolfinx_tresca.pairing.group import Undeformed
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc, joined
from dolfinx_tresca.pairing.pair_surfaces import pair_displaced_surfaces
from dolfinx_tresca.scene.friction import Bonded, Frictionless
from dolfinx_tresca.scene.obstacle import RigidPlane
from dolfinx_tresca.scene.pair import SideName

#: Difference of unit normals, and of entries of the primary side's means from 1, that count as
#: rounding.
FLATNESS = 1e-8


class ContactSurface:
    """The secondary surface of a pair, with tractions that are linear between nodes.

    Rigid planes, bodies and all laws are alike: the jump of the displacement is bounded along
    `axes`, and a traction acts on it.

    Attributes:
        pair: the contact pair.
        normal: (d,) the contact normal: of the secondary side, or towards the rigid plane.
        axes: (k, d) the directions in which the jump is bounded: the normal; all if bonded.
        cell: (m,) the cells of the secondary facets.
        facet: (m,) the numbers of these facets in their cells.
        load: linear form of the work of the tractions on both sides.
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
        self._bonded = isinstance(pair.friction, Bonded)
        V, d, comm = owned.V, owned.cells.d, owned.V.mesh.comm
        finite = self._bonded or np.isfinite(bounds[rows.nodes]).all()
        alike = all(member.friction == pair.friction for member in group.pairs)
        require(
            comm,
            alike and finite and (rows.operators.semi_axes == 1.0).all(),
            "surfaces of one law with one finite slip bound for all directions, unlike those "
            f"of contact pair {pair}. Leave a gap between surfaces of different laws",
        )
        rigid = isinstance(pair.primary, RigidPlane)
        every = _with_all_nodes(V, rows.operators.undeformed)
        every = every.at_nodes(every.shares[:, member] > 0.0)
        nodewise = pair.obstacle is None and not pair.touches_itself
        nodewise = nodewise and (np.diff(every.primary.indptr) == 1).all()
        nodewise = nodewise and (np.abs(every.primary.data - 1.0) < FLATNESS).all()
        matching = (
            "rigid planes, or bodies of degree 1 whose meshes match on flat surfaces, and those of "
            f"contact pair {pair} do not. Mesh both alike, and make a pair of each flat side"
        )
        require(comm, rigid or nodewise, matching)
        self._nodes, self._jump = every.nodes, None
        if not rigid:
            jump = kron(every.jump, np.eye(d), format="csr")
            self._jump = as_petsc(V.dofmap.index_map, d, [jump], comm)
        gaps = np.zeros(len(every.nodes)) if self._bonded else every.distance
        if pair.gap is not None and not self._bonded:
            name = f"the gap of contact pair {pair}"
            gaps = gaps + NodalValues(V).scalars_at(pair.gap, every.nodes, name)
        touching = self._carried(self._at_nodes(np.ones((len(gaps), d))))[:, 0] != 0.0

        self.cell, self.facet, self._on_facets, outside = self._facets_of("secondary", touching)
        normals = owned.cells.normals[self.cell, self.facet]
        facets = owned.facets[self.cell, self.facet]
        if rigid:
            self.normal = -pair.primary.at(np.zeros((1, 3)))[1][0, :d]
        else:
            total = reduce_array(comm, normals.sum(axis=0))
            self.normal = total / np.linalg.norm(total)
            cell, facet, _, _ = self._facets_of("primary", touching)
            turned = np.vstack([normals, -owned.cells.normals[cell, facet]]) - self.normal
            unpaired = comm.allreduce(len(cell) - len(self.cell))
            require(comm, not unpaired and (np.abs(turned) < FLATNESS).all(), matching)
            facets = np.concatenate([facets, owned.facets[cell, facet]])
        self.axes = np.eye(d) if self._bonded else self.normal[None]
        require(
            comm,
            not prescribed[self._on_facets].all(axis=1).any(),
            "contact surfaces without prescribed displacements, and some facets of contact pair "
            f"{pair} have them",
        )
        corners, points = self._on_facets[:, :d], bernstein_points(d)
        pressure, friction, *law = self._admissible(dual, rows, multipliers, bounds)
        tractions = friction - pressure * self.normal
        require(
            comm,
            not tractions[outside].any(),
            f"multipliers at all nodes of pressed facets, and contact pair {pair} has pressed "
            "facets at a rim",
        )
        self._tractions, self._bounds, self._origins = (
            points @ table[corners] for table in (tractions, *law)
        )
        self._gaps = points @ self._at_nodes(gaps[:, None])[corners]
        open_corners = (pressure[corners] <= 0.0) & (not self._bonded)
        self._pressed = points @ open_corners == 0.0
        traction = fem.Function(V)
        values = self._carried(tractions)
        values[self._on_facets] = self._tractions[:, : self._on_facets.shape[1]]
        traction.x.array[:] = values.ravel()
        touched = np.unique(facets).astype(np.int32)
        tags = meshtags(V.mesh, d - 1, touched, np.zeros_like(touched))
        on_both_sides = ufl.Measure("ds", domain=V.mesh, subdomain_data=tags)(0)
        self.load = ufl.inner(traction, ufl.TestFunction(V)) * on_both_sides

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
        nodes = self._owned.facet_nodes[cell, facet]
        vertices = nodes[:, : self._owned.cells.d]
        keep = touching[vertices].all(axis=1)
        return cell[keep], facet[keep], nodes[keep], vertices[~keep]

    def _admissible(
        self, dual: DualProgram, rows: RowsOfPair, multipliers: Array, bounds: Array
    ) -> list[Array]:
        """Return admissible pressures, friction, slip bounds, and origins of the slip. Collective.

        Nodes whose multipliers lack components, which are prescribed, have means of neighbours.

        Returns:
            arrays (nodes, 1), (nodes, d), (nodes, 1) and (nodes, d).
        """
        V, pair, d = self._owned.V, rows.operators, self._owned.cells.d
        stress = multipliers * dual.jump.stress_scale
        origin = (dual.response.offset - dual.jump.gap) * dual.jump.length_scale
        pressures = np.zeros(len(pair.nodes))
        pressures[pair.normal_node] = stress[rows.normal]
        components = 1 if isinstance(self.pair.friction, Frictionless) else d
        counts = np.bincount(pair.row_node, minlength=len(pair.nodes))
        columns = (
            pressures,
            np.zeros_like(pressures) if self._bonded else bounds[rows.nodes],
            -pair.tangential_vectors(stress[rows.tangential]),
            pair.tangential_vectors(origin[rows.tangential]),
            np.ones_like(pressures),
        )
        values = np.zeros((V.dofmap.index_map.size_local, 2 * d + 3))
        values[pair.nodes] = np.column_stack(columns) * (counts == components)[:, None]
        table = spread(V, values)
        corners = self._on_facets[:, :d]
        sums = np.repeat(table[corners].sum(axis=1, keepdims=True), d, axis=1)
        around = summed_at_nodes(V.dofmap.index_map, corners, sums)
        table = np.where(table[:, -1:] > 0.0, table, around)
        table /= np.maximum(table[:, -1:], 1.0)

        pressure, bound, friction, origins = np.split(table[:, :-1], [1, 2, d + 2], axis=1)
        across = np.eye(d) - np.outer(self.normal, self.normal)
        friction, origins = friction @ across, origins @ across
        if not self._bonded:
            pressure = np.maximum(pressure, 0.0)
            sizes = np.linalg.norm(friction, axis=1, keepdims=True)
            friction *= np.minimum(1.0, bound / np.maximum(sizes, LEAST_DIVISOR))
        return [pressure, friction, bound, origins]

    def _at_nodes(self, values: Array) -> Array:
        """Return values (nodes, k), given (n, k) at `_nodes` and zero elsewhere. Collective."""
        result = np.zeros((self._owned.V.dofmap.index_map.size_local, values.shape[1]))
        result[self._nodes] = values
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
        """Return values (nodes, d) of the surface, and their opposites at partners. Collective.

        This is the transpose of the jump.
        """
        if self._jump is None:
            return values.copy()
        unknowns, jumps = self._jump.createVecs()
        jumps.array = values[self._nodes].ravel()
        self._jump.multTranspose(jumps, unknowns)
        return spread(self._owned.V, unknowns.array.reshape(-1, values.shape[1]))

    def _coefficients(self, values: Array) -> Array:
        """Return Bernstein's coefficients (m, k, d) of jumps on the secondary facets. Collective.

        Jumps are between their least and largest coefficients.
        """
        points, nodes = bernstein_points(self._owned.cells.d), self._on_facets
        linear = nodes.shape[1] < len(points)
        of_nodes = points if linear else np.linalg.inv(bernstein(points))
        return np.asarray(of_nodes @ self._jumps(values)[nodes])

    def lift(self, v: fem.Function) -> None:
        """Move nodes such that nothing penetrates, and bonded surfaces have no jumps. Collective.

        Pressed nodes also close their gaps. The nodes of both sides move, where they are free.

        Args:
            v: the displacement, which changes.
        """
        d, index_map = self._owned.cells.d, self._owned.V.dofmap.index_map
        values = v.x.array.reshape(-1, d)
        along = np.tile(self.axes.sum(axis=0), (len(values), 1))
        room = self._jumps(self._free * self._carried(along)) @ self.axes.T
        # a coefficient at a vertex moves like it, one of an edge twice as far as the middle
        for places, share in ((slice(d), 1.0), (slice(d, self._on_facets.shape[1]), 0.5)):
            nodes = self._on_facets[:, places]
            excess = (self._coefficients(values)[:, places] @ self.axes.T) - self._gaps[:, places]
            excess = np.where(self._pressed[:, places], excess, np.maximum(excess, 0.0))
            space = room[nodes]
            moves = np.divide(excess, space, out=np.zeros_like(space), where=space > 0.1)
            counted = np.concatenate([moves @ self.axes, np.ones((*nodes.shape, 1))], axis=2)
            sums = summed_at_nodes(index_map, nodes, counted)
            means = sums[:, :d] / np.maximum(sums[:, d:], 1.0)
            values -= share * self._free * self._carried(means)

    def defects(self, v: fem.Function) -> tuple[Array, Array, float]:
        """Return by how much tractions and jumps miss the law of contact. Collective.

        Returns:
            the integrals (m,) over facets of p (d - v_n), upper bounds (m,) of those of
            g |v_t - s| + t (v_t - s), and the largest penetration, or jump of bonded surfaces.
        """
        d, means = self._owned.cells.d, bernstein_means(self._owned.cells.d)
        jumps = self._coefficients(v.x.array.reshape(-1, d))
        normal = self.normal[:, None]
        closing, pressure = jumps @ normal, -self._tractions @ normal
        openings = self._gaps - closing
        friction = self._tractions + pressure * self.normal
        slips = jumps - closing * self.normal - self._origins
        areas = self._owned.cells.areas[self.cell, self.facet]
        sizes = np.linalg.norm(slips, axis=2, keepdims=True)
        complementarity = areas * np.einsum("mkc,kl,mlc->m", pressure, means, openings)
        lack = areas * np.einsum("mkc,kl,mlc->m", self._bounds, means, sizes)
        lack += areas * np.einsum("mkc,kl,mlc->m", friction, means, slips)
        depth = np.abs(jumps) if self._bonded else -openings
        return complementarity, lack, float(depth.max(initial=0.0))


def _with_all_nodes(V: Any, undeformed: Undeformed) -> PairOperators:
    """Pair surfaces as if nothing were prescribed, with jumps at all nodes. Collective."""
    sides = {
        tag: replace(facets, free=np.ones_like(facets.free))
        for tag, facets in undeformed.sides.items()
    }
    index_map = V.dofmap.index_map
    nowhere = np.zeros((index_map.size_local + index_map.num_ghosts, V.mesh.geometry.dim))
    return joined(pair_displaced_surfaces(V, replace(undeformed, sides=sides), nowhere))
