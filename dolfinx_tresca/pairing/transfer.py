"""Fields and loads from one side of a pair to the other."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca._base.vertices import entities_per_cell
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.facet_means import facet_means, node_areas
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: Area of a primary node before the secondary side, over the largest one, up to which nothing is
#: known of densities there: rounding.
AREA_PART = 1e-10


class SideTransfer:
    """P, which has what is before the contact nodes on the primary side, and its transpose.

    P is the part of N and T that the primary side has: with mortar pairing the projection with the
    multiplier basis psi, (P f)_i = integral of psi_i f over that of psi_i; node-to-node the value
    of the partner. Rows sum to 1. Two things differ:

    - *Values* (temperatures, displacements) go from the primary to the secondary side by P, which
      keeps constants, and functions that are linear over both sides where it projects.
    - *Loads*, integrals over nodes (forces, heat), go from the secondary to the primary side by P',
      which keeps their sum: what leaves one body enters the other, to rounding.

    Densities (pressures, fluxes) are loads over areas. Those of the primary nodes are P'w, for the
    areas w of the secondary ones; so a density f becomes P'(w f) / P'w: constants are kept, and the
    sum with these areas, which are the part of each node's area that is before the other side.

    All Functions are of degree 1, scalars or vectors of the dimension of space. What is carried may
    be another one: a field that jumps between cells has the values of the cells that facets of the
    side belong to, in their mean by area where several meet in a node.
    """

    def __init__(self, V: Any, pair: PairOperators, surfaces: ContactPair) -> None:
        """Keep a pair, and what users said of it; nothing is made. Not collective.

        Args:
            V: the space of the displacements.
            pair: its operators.
            surfaces: whose operators they are.
        """
        self._V, self._pair, self._surfaces = V, pair, surfaces

    @cached_property
    def _vector(self) -> Any:
        """Vectors of degree 1. Collective."""
        V = self._V
        if V.element.basix_element.degree == 1:
            return V
        return fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))

    @cached_property
    def _scalar(self) -> Any:
        """Scalars of degree 1. Collective."""
        return fem.functionspace(self._V.mesh, ("Lagrange", 1))

    @cached_property
    def _nodes(self) -> LocalNumbers:
        """(n,) the contact nodes in the numbering of `_vector`; those of V are others."""
        corners = entities_per_cell(self._V, 0)
        number = np.zeros(self._V.dofmap.list.max(initial=0) + 1, dtype=np.int32)
        number[self._V.dofmap.list[:, :corners]] = self._vector.dofmap.list
        return number[self._pair.nodes]

    def values(self, function: fem.Function, to: Literal["secondary", "primary"]) -> fem.Function:
        """Return a Function with the values of the other side, zero elsewhere. Collective.

        Args:
            function: on the mesh of the displacements.
            to: the side that gets them; the primary one as a density.

        Raises:
            InputError: it is no such Function, or there is no such side.
        """
        if to not in ("secondary", "primary"):
            raise InputError(f'to must be "secondary" or "primary", found {shown(to)}.')
        surfaces = self._surfaces
        field = self._checked(
            function, surfaces.primary if to == "secondary" else surfaces.secondary
        )
        if to == "primary":
            return self._result(function, self._density(self._at_nodes(field)))
        before = self._before_nodes(field)
        return self._result(function, self._placed(before))

    def loads(self, function: fem.Function) -> fem.Function:
        """Return the loads of primary nodes that take those of secondary ones over. Collective.

        Args:
            function: a load of each node, as an assembled linear form has them; what it has at
                others than contact nodes counts for nothing.

        Raises:
            InputError: it is no such Function.
        """
        nodal = [space.ufl_element() for space in (self._scalar, self._vector)]
        with errors_on_all_ranks(self._V.mesh.comm):
            if isinstance(function, fem.Function) and function.ufl_element() not in nodal:
                raise InputError(
                    "loads of nodes must be a Function of Lagrange elements of degree 1, assembled "
                    f"with their test functions, found {shown(function)}. A density goes to the "
                    'other side by transfer(q, to="primary").'
                )
        field = self._checked(function, self._surfaces.secondary)
        return self._result(function, self._transposed(self._at_nodes(field)))

    def areas(self) -> fem.Function:
        """Return the areas of nodes that are in contact, on both sides, as a Function. Collective.

        Those of either side have the same sum.
        """
        dim, own = self._V.dofmap.index_map_bs, fem.Function(self._vector)
        weights = np.tile(self._pair.weights[:, None], dim)
        np.add.at(own.x.array.reshape(-1, dim), self._nodes, weights)
        own.x.scatter_forward()
        whole = own.x.array.reshape(-1, dim) + self._transposed(weights)
        return self._result(fem.Function(self._scalar, name="areas"), whole)

    def area_fraction(self) -> fem.Function:
        """Return which part of nodes' areas is in contact, on both sides. Collective."""
        surfaces, areas = self._surfaces, self.areas()
        sides = (surfaces.secondary, surfaces.primary)
        tags = [side for side in sides if not isinstance(side, RigidObstacle)]
        whole = node_areas(self._scalar, surfaces.facet_tags, tags)
        areas.x.array[:] /= np.where(whole > 0.0, whole, 1.0)
        areas.name = "area_fraction"
        return areas

    def conductance(self, h: fem.Function) -> PETSc.Mat:
        """Return G' diag(w h) G on the space of h, with the jump G f = f - P f. Collective.

        Rows and columns sum to zero: G takes constants away.

        Args:
            h: a scalar of degree 1 on the mesh; what it has at contact nodes counts.

        Raises:
            InputError: it is none.
        """
        jump, Q = self._scalar_jump(h), h.function_space
        at_nodes = fem.Function(self._vector)
        rows = at_nodes.x.array.reshape(-1, self._V.dofmap.index_map_bs)
        rows[self._of(Q), 0] = h.x.array
        weighed, weights = jump.duplicate(copy=True), jump.createVecLeft()
        weights.array = self._pair.weights * rows[self._nodes, 0]
        weighed.diagonalScale(L=weights)
        result = jump.transposeMatMult(weighed)
        for owned in (jump, weighed, weights):
            owned.destroy()
        return result

    def on_both_sides(self, density: Array, name: str, scalar: bool) -> fem.Function:
        """Return a density (n, d) at contact nodes as a Function on both sides. Collective.

        Args:
            density: of vectors; of scalars the first column counts.
            name: of the Function.
            scalar: whether it is one.
        """
        result = fem.Function(self._scalar if scalar else self._vector, name=name)
        whole = self._placed(density)
        other = self._density(density)
        nowhere = ~whole.any(axis=1)
        whole[nowhere] = other[nowhere]
        return self._result(result, whole)

    def _checked(self, function: fem.Function, side: int | RigidObstacle) -> fem.Function:
        """Return a Function in `_vector`; of a scalar it is the first component. Collective.

        Args:
            function: a scalar or a vector.
            side: whose values count: its tag.

        Raises:
            InputError: it is none on the mesh, or neither a scalar nor a vector.
        """
        dim = self._V.dofmap.index_map_bs
        mesh = self._V.mesh
        with errors_on_all_ranks(mesh.comm):
            if (
                not isinstance(function, fem.Function)
                or function.function_space.mesh != mesh
                or function.ufl_shape not in ((), (dim,))
                or function.ufl_element().family_name == "quadrature"
            ):
                raise InputError(
                    "what is carried from one side to the other must be a Function on the mesh of "
                    f"the displacements, a scalar or a vector of {dim} components, found "
                    f"{shown(function)}."
                )
        scalar = function.ufl_shape == ()
        space = self._scalar if scalar else self._vector
        if function.ufl_element() in ufl.H1 or isinstance(side, RigidObstacle):
            found = fem.Function(space)
            found.interpolate(function)
        else:
            found = facet_means(function, space, self._surfaces.facet_tags, side)
        if not scalar:
            return found
        result = fem.Function(self._vector)
        result.x.array.reshape(-1, dim)[self._of_scalar, 0] = found.x.array
        return result

    def _scalar_jump(self, h: fem.Function) -> PETSc.Mat:
        """Return G (n, nodes of the space of h), secondary minus primary. Collective.

        Raises:
            InputError: h is no scalar of degree 1 on the mesh.
        """
        mesh = self._V.mesh
        with errors_on_all_ranks(mesh.comm):
            if (
                not isinstance(h, fem.Function)
                or h.function_space.mesh != mesh
                or h.function_space.ufl_element() != self._scalar.ufl_element()
            ):
                raise InputError(
                    "a conductance must be a scalar Function of degree 1, in the space of the "
                    "field that flows, on the mesh of the displacements: of "
                    f'fem.functionspace(mesh, ("Lagrange", 1)), found {shown(h)}.'
                )
        Q, nodes = h.function_space, self._vector.dofmap.index_map
        of_Q = self._of(Q)
        own = np.flatnonzero(of_Q < nodes.size_local).astype(np.int32)
        columns = np.empty(nodes.size_local, dtype=np.int64)
        columns[of_Q[own]] = Q.dofmap.index_map.local_to_global(own)
        count, total = len(self._nodes), nodes.size_global
        secondary = csr_array(
            (np.ones(count), nodes.local_to_global(self._nodes), np.arange(count + 1)),
            shape=(count, total),
        )
        renumbered = csr_array(
            (np.ones(len(columns)), columns, np.arange(len(columns) + 1)),
            shape=(len(columns), total),
        )
        jump = as_petsc(nodes, 1, [secondary], mesh.comm)
        to_Q = as_petsc(Q.dofmap.index_map, 1, [renumbered], mesh.comm)
        P = self._primary()
        jump.axpy(-1.0, P)
        result = jump.matMult(to_Q)
        for owned in (jump, P, to_Q):
            owned.destroy()
        return result

    @cached_property
    def _of_scalar(self) -> LocalNumbers:
        """The node of `_vector` of each one of `_scalar`."""
        return self._of(self._scalar)

    def _of(self, Q: Any) -> LocalNumbers:
        """Return the node of `_vector` of each one of a space of scalars of degree 1."""
        number = np.zeros(Q.dofmap.list.max(initial=-1) + 1, dtype=np.int32)
        number[Q.dofmap.list] = self._vector.dofmap.list
        return number

    def _at_nodes(self, field: fem.Function) -> Array:
        """Return values (n, d) at contact nodes."""
        values: Array = field.x.array.reshape(-1, self._V.dofmap.index_map_bs)[self._nodes]
        return values

    def _before_nodes(self, field: fem.Function) -> Array:
        """Return P f (n, d). Collective."""
        values = field.x.array.reshape(-1, self._V.dofmap.index_map_bs)
        P = self._primary()
        right, left = P.createVecs()
        result = np.zeros((len(self._pair.nodes), values.shape[1]))
        for column in range(values.shape[1]):
            right.array = values[: right.local_size, column]
            P.mult(right, left)
            result[:, column] = left.array
        for owned in (P, right, left):
            owned.destroy()
        return result

    def _transposed(self, loads: Array) -> Array:
        """Return P'F (nodes of `_vector` with ghosts, d). Collective."""
        result = fem.Function(self._vector)
        whole: Array = result.x.array.reshape(-1, loads.shape[1])
        P = self._primary()
        right, left = P.createVecs()
        for column in range(loads.shape[1]):
            left.array = loads[:, column]
            P.multTranspose(left, right)
            whole[: right.local_size, column] = right.array
        for owned in (P, right, left):
            owned.destroy()
        result.x.scatter_forward()
        return whole

    def _primary(self) -> PETSc.Mat:
        """Return P (n, nodes of `_vector`). Collective."""
        V, comm = self._V, self._V.mesh.comm
        P = as_petsc(V.dofmap.index_map, 1, [self._pair.primary], comm)
        if V is self._vector:
            return P
        # nodes on edges have what their corners have
        dim = V.dofmap.index_map_bs
        interpolation = dolfinx.fem.petsc.interpolation_matrix(self._vector, V)
        interpolation.assemble()
        rows = V.dofmap.index_map.size_local * dim
        entries = csr_array(interpolation.getValuesCSR()[::-1], shape=(rows, interpolation.size[1]))
        nodes = as_petsc(self._vector.dofmap.index_map, 1, [entries[::dim, ::dim]], comm)
        result = P.matMult(nodes)
        for owned in (P, interpolation, nodes):
            owned.destroy()
        return result

    def _density(self, values: Array) -> Array:
        """Return P'(w f) / P'w (nodes of `_vector` with ghosts, d). Collective."""
        weights = self._pair.weights[:, None]
        loads, areas = (self._transposed(weights * one) for one in (values, np.ones_like(values)))
        largest = self._V.mesh.comm.allreduce(areas.max(initial=0.0), op=MPI.MAX)
        result = np.zeros_like(loads)
        # where only rounding, or the rim of a function, is before the secondary side there is none
        np.divide(loads, areas, out=result, where=areas > AREA_PART * largest)
        return result

    def _placed(self, values: Array) -> Array:
        """Return values (n, d) of contact nodes as those of `_vector`, with ghosts. Collective."""
        whole = fem.Function(self._vector)
        rows: Array = whole.x.array.reshape(-1, values.shape[1])
        rows[self._nodes] = values
        whole.x.scatter_forward()
        return rows

    def _result(self, like: fem.Function, values: Array) -> fem.Function:
        """Return values (nodes of `_vector`, d) as a Function of its kind and name."""
        if like.ufl_shape == ():
            result = fem.Function(self._scalar, name=like.name)
            result.x.array[:] = values[self._of_scalar, 0]
            return result
        result = fem.Function(self._vector, name=like.name)
        result.x.array[:] = values.ravel()
        return result
