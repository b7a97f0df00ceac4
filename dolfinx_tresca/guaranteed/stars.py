"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from scipy.sparse import bsr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, exchange, summed_at_nodes
from dolfinx_tresca.guaranteed.cells import MeshCells, facet_vertices, rigid_motions

#: Relative increase of the diagonal of the stars' equations, so that dependent equations, too, can
#: be solved: up to a relative error of about this number.
LOOSE = 1e-11


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star balances the forces that are missing at its vertex, cell by cell in force and moment, by
    the least tractions on the facets at the vertex (docs/theory/guaranteed.md). Tractions are the
    matrices `_roots` times factors x (facets, d * d, 1), so that their energy is |x|^2; `_work`
    times x is their work on the rigid motions about each vertex of each cell.

    Tractions are on this rank's facets with ghosts; the owner of a vertex solves its equations.
    """

    def __init__(self, cells: MeshCells, energies: Array, unknown: Mask) -> None:
        """Factor the equations of all stars. Collective.

        `energies` (n, d + 1, d * d, d * d) give squared norms for tractions on one facet each;
        stars change only the components of tractions that are `unknown` (n, d + 1, d).
        """
        d, comm, topology = cells.d, cells.V.mesh.comm, cells.V.mesh.topology
        self._cells, (n, corners) = cells, cells.facets.shape
        # the sum of both sides' energies has the inverse R R', with the roots R
        sums = cells.facet_sums(energies)
        changes = np.tile(cells.facet_sums(unknown[:, :, None].astype(np.float64)) > 0.0, d)
        both = np.swapaxes(changes, 1, 2) & changes
        self._roots = both * np.linalg.cholesky(np.linalg.inv(np.where(both, sums, np.eye(d * d))))
        # the work of tractions on rigid motions; the facets at vertex k are opposite to near[k]
        near = facet_vertices(d)
        arms = cells.points[:, near[near]] - cells.points[:, :, None, None]
        # the means of two hat functions' products are 1 / d / (d + 1), twice this for equal ones
        work = rigid_motions((arms + arms.sum(axis=3, keepdims=True)) / (d + 1))
        work *= (cells.signs[..., 0, 0] * cells.areas)[:, near][..., None, None, None] / d
        facets, size = cells.facets[:, near], work.shape[3]
        work = work.reshape(n, corners, d, size, d * d) @ self._roots[facets]
        self._work = _block_rows(work, facets, len(sums)).tocsr()
        # Each cell sends its rows for a vertex to the owner of the vertex. Each star has its own
        # tractions, in columns by the facet, and by the vertex's number among its vertices
        number = np.arange(corners)[:, None] - (near < np.arange(corners)[:, None])
        columns = cells.facet_map.local_to_global(facets.ravel()).reshape(facets.shape) * d + number
        firsts = comm.allgather(topology.index_map(0).local_range[0])
        self._owner = np.searchsorted(firsts, cells.vertices.ravel(), side="right") - 1
        columns, self._senders = exchange(comm, columns.reshape(-1, d), self._owner)
        work, _ = exchange(comm, work.reshape(n * corners, d * size * d * d), self._owner)
        # the equations W W' of all stars of this rank: least tractions are W' times their solution
        with errors_on_all_ranks(comm):
            columns = np.unique(columns.ravel(), return_inverse=True)[1]
            rows = _block_rows(work.reshape(-1, d, size, d * d), columns, columns.size)
            equations = rows @ rows.T
            blocks = equations.indptr, equations.indices, equations.data
            matrix = PETSc.Mat().createBAIJ(equations.shape, size, csr=blocks, comm=PETSc.COMM_SELF)
            del work, rows, equations, blocks
            diagonal = matrix.getDiagonal()
            diagonal.array = np.where(diagonal.array > 0.0, LOOSE * diagonal.array, 1.0)
            matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD)
            matrix.factorLU(*matrix.getOrdering("nd"))  # in place, by blocks
        self._factors = matrix

    def _balancing(self, missing: Array) -> Array:
        """Return the sum of the least tractions of all stars, as factors (facets, d * d, 1).

        The tractions of a star do the work `missing` (n, d + 1, r) on the r rigid motions of each
        cell about the vertex: their factors of `_roots` are W'(W W')^-1 `missing`. Collective.
        """
        comm, owner = self._cells.V.mesh.comm, self._owner
        right, _ = exchange(comm, missing.reshape(len(owner), missing.shape[2]), owner)
        forces = PETSc.Vec().createWithArray(right.ravel(), comm=PETSc.COMM_SELF)
        self._factors.solve(forces, solution := forces.duplicate())
        returned, _ = exchange(comm, solution.array.reshape(right.shape), self._senders)
        multipliers = np.empty_like(returned)
        # rows return in the order of the ranks that own the stars
        multipliers[np.argsort(owner, kind="stable")] = returned
        factors = (multipliers.ravel() @ self._work).reshape(self._roots.shape[:2])
        return summed_at_nodes(self._cells.facet_map, np.arange(len(factors)), factors)[..., None]

    def preconditioned(self, descent: Array) -> Array:
        """Return a change of loadings that balances itself, and lowers an energy. Collective.

        It is the sum of the best corrections of all stars. `descent` (n, d + 1, d + 1, d) is minus
        the derivative of the energy by the loading.
        """
        cells, d = self._cells, self._cells.d
        forces = cells.facet_sums(cells.signs * descent[:, :, :d]).reshape(-1, d * d, 1)
        tractions = np.swapaxes(self._roots, 1, 2) @ forces
        total = (self._work @ tractions.ravel()).reshape(*cells.facets.shape, d * (d + 1) // 2)
        return cells.on_sides(self._roots @ (d * tractions - self._balancing(total)))

    def equilibrated(self, loading: Array, stress: Array) -> Array:
        """Return a loading whose forces and moments in each cell balance. Collective.

        Its tractions are those of `loading`, where both sides differ their means, plus the least
        corrections of all stars. `stress` is the loading of a stress in discrete equilibrium.
        """
        cells, d = self._cells, self._cells.d
        result = cells.on_sides(cells.facet_sums(cells.signs * loading[:, :, :d]) / cells.sides)
        result[:, :, d] = loading[:, :, d]
        # a force at the vertex itself has no moment about it
        missing = np.pad(cells.resultants(stress - result), ((0, 0), (0, 0), (0, d * (d - 1) // 2)))
        return result + cells.on_sides(self._roots @ self._balancing(missing))


def _block_rows(blocks: Array, columns: Indices, width: int) -> bsr_array:
    """Return a sparse matrix of blocks (..., k, r, c), k per block row, in `columns` (..., k)."""
    count, rows, size = blocks.shape[-3:]
    starts = np.arange(0, columns.size + 1, count, dtype=np.int32)
    entries = blocks.reshape(-1, rows, size), columns.ravel().astype(np.int32), starts
    return bsr_array(entries, shape=(rows * columns.size // count, size * width))
