"""Transfer of fields and loads between the sides of a pair."""

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

#: Covered area of a primary node, relative to the largest one, that counts as rounding: densities
#: are zero at such a node.
AREA_PART = 1e-10


class SideTransfer:
    """The transfer P from the primary side to the contact nodes, and its transpose P'.

    P is the primary part of N and T, the projection by the dual basis psi,
    (P f)_i = (integral of psi_i f) / (integral of psi_i). Rows of P sum to 1. Values and loads are
    transferred differently:

    - *Values* (temperatures, displacements) are transferred from the primary to the secondary side
      by P, which is exact for constants and linear functions.
    - *Loads* (nodal forces, nodal heat flows) are transferred from the secondary to the primary
      side by P', which conserves their sum.

    Densities (pressures, fluxes) are loads divided by areas. With the covered areas w of secondary
    nodes, the covered areas of primary nodes are P'w, and a density f becomes P'(w f) / P'w. This
    is exact for constants and conserves the sum of densities times areas.

    All resulting Functions are of degree 1, scalars or vectors with the dimension of space.
    """

    def __init__(self, V: Any, pair: PairOperators, surfaces: ContactPair) -> None:
        """Wrap the operators of a pair; nothing is computed yet. Not collective.

        Args:
            V: the space of the displacement.
            pair: the operators of the pair.
            surfaces: the contact pair.
        """
        self._V, self._pair, self._surfaces = V, pair, surfaces

    @cached_property
    def _vector(self) -> Any:
        """The vector space of degree 1. Collective."""
        V = self._V
        if V.element.basix_element.degree == 1:
            return V
        return fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))

    @cached_property
    def _scalar(self) -> Any:
        """The scalar space of degree 1. Collective."""
        return fem.functionspace(self._V.mesh, ("Lagrange", 1))

    @cached_property
    def _nodes(self) -> LocalNumbers:
        """(n,) numbers of the contact nodes in `_vector`; in V they differ if V has degree 2."""
        corners = entities_per_cell(self._V, 0)
        number = np.zeros(self._V.dofmap.list.max(initial=0) + 1, dtype=np.int32)
        number[self._V.dofmap.list[:, :corners]] = self._vector.dofmap.list
        return number[self._pair.nodes]

    def values(self, function: fem.Function, to: Literal["secondary", "primary"]) -> fem.Function:
        """Transfer a field; see `ContactOperators.transfer`. Collective.

        Args:
            function: a scalar or vector field on the mesh of the displacement.
            to: the side that receives values; the primary side receives a density.

        Raises:
            InputError: `function` is not such a Function, or `to` is not the name of a side.
        """
        if to not in ("secondary", "primary"):
            raise InputError(f'to must be "secondary" or "primary", found {shown(to)}.')
        surfaces = self._surfaces
        field = self._as_degree_1(
            function, surfaces.primary if to == "secondary" else surfaces.secondary
        )
        if to == "primary":
            return self._as_function(function, self._transfer_density(self._at_nodes(field)))
        before = self._apply_P(field)
        return self._as_function(function, self._scatter_contact_values(before))

    def loads(self, function: fem.Function) -> fem.Function:
        """Transfer nodal loads from the secondary to the primary side. Collective.

        Args:
            function: nodal loads, such as an assembled linear form; only values at contact nodes
                are used.

        Raises:
            InputError: `function` is not a Lagrange Function of degree 1 on the mesh.
        """
        nodal = [space.ufl_element() for space in (self._scalar, self._vector)]
        with errors_on_all_ranks(self._V.mesh.comm):
            if isinstance(function, fem.Function) and function.ufl_element() not in nodal:
                raise InputError(
                    "loads of nodes must be a Function of Lagrange elements of degree 1, assembled "
                    f"with their test functions, found {shown(function)}. Densities are "
                    'transferred by transfer(q, to="primary").'
                )
        field = self._as_degree_1(function, self._surfaces.secondary)
        return self._as_function(function, self._apply_P_transpose(self._at_nodes(field)))

    def areas(self) -> fem.Function:
        """Return the covered areas of the nodes of both sides; the sums are equal. Collective."""
        dim, own = self._V.dofmap.index_map_bs, fem.Function(self._vector)
        weights = np.tile(self._pair.weights[:, None], dim)
        np.add.at(own.x.array.reshape(-1, dim), self._nodes, weights)
        own.x.scatter_forward()
        whole = own.x.array.reshape(-1, dim) + self._apply_P_transpose(weights)
        return self._as_function(fem.Function(self._scalar, name="areas"), whole)

    def area_fraction(self) -> fem.Function:
        """Return the covered fraction of the areas of the nodes of both sides. Collective."""
        surfaces, areas = self._surfaces, self.areas()
        sides = (surfaces.secondary, surfaces.primary)
        tags = [side for side in sides if not isinstance(side, RigidObstacle)]
        whole = node_areas(self._scalar, surfaces.facet_tags, tags, self._pair.axisymmetric)
        areas.x.array[:] /= np.where(whole > 0.0, whole, 1.0)
        areas.name = "area_fraction"
        return areas

    def conductance(self, h: fem.Function) -> PETSc.Mat:
        """Return G' diag(w h) G on the space of h, where G f = f - P f is the jump. Collective.

        Between two bodies rows and columns sum to zero, since the jump of a constant is zero.

        Args:
            h: a scalar of degree 1 on the mesh; only values at contact nodes are used.

        Raises:
            InputError: h is not such a Function.
        """
        jump, Q = self._scalar_jump(h), h.function_space
        at_nodes = fem.Function(self._vector)
        rows = at_nodes.x.array.reshape(-1, self._V.dofmap.index_map_bs)
        rows[self._vector_nodes(Q), 0] = h.x.array
        weighted, weights = jump.duplicate(copy=True), jump.createVecLeft()
        weights.array = self._pair.weights * rows[self._nodes, 0]
        weighted.diagonalScale(L=weights)
        result = jump.transposeMatMult(weighted)
        for owned in (jump, weighted, weights):
            owned.destroy()
        return result

    def on_both_sides(self, density: Array, name: str, scalar: bool) -> fem.Function:
        """Return a density at contact nodes as a Function with values on both sides. Collective.

        Nodes of the primary side have the transferred density.

        Args:
            density: (n, d) values at contact nodes; a scalar density is in the first column.
            name: name of the Function.
            scalar: whether the density is a scalar.
        """
        result = fem.Function(self._scalar if scalar else self._vector, name=name)
        whole = self._scatter_contact_values(density)
        other = self._transfer_density(density)
        nowhere = ~whole.any(axis=1)
        whole[nowhere] = other[nowhere]
        return self._as_function(result, whole)

    def _as_degree_1(self, function: fem.Function, side: int | RigidObstacle) -> fem.Function:
        """Return a field in `_vector`; a scalar field becomes the first component. Collective.

        Args:
            function: a scalar or vector field.
            side: tag of the side from which a discontinuous field takes its values, or an obstacle.

        Raises:
            InputError: `function` is not a scalar or vector Function on the mesh.
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
                    "a transferred field must be a Function on the mesh of the displacement, a "
                    f"scalar or a vector of {dim} components, found {shown(function)}."
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
        result.x.array.reshape(-1, dim)[self._scalar_nodes, 0] = found.x.array
        return result

    def _scalar_jump(self, h: fem.Function) -> PETSc.Mat:
        """Return the jump G (n, nodes of the space of h), secondary minus primary. Collective.

        Raises:
            InputError: h is not a scalar Function of degree 1 on the mesh.
        """
        mesh = self._V.mesh
        with errors_on_all_ranks(mesh.comm):
            if (
                not isinstance(h, fem.Function)
                or h.function_space.mesh != mesh
                or h.function_space.ufl_element() != self._scalar.ufl_element()
            ):
                raise InputError(
                    "a conductance must be a scalar Function of degree 1 in the space of the "
                    "temperature, on the mesh of the displacement: of "
                    f'fem.functionspace(mesh, ("Lagrange", 1)), found {shown(h)}.'
                )
        Q, nodes = h.function_space, self._vector.dofmap.index_map
        vector_nodes = self._vector_nodes(Q)
        own = np.flatnonzero(vector_nodes < nodes.size_local).astype(np.int32)
        columns = np.empty(nodes.size_local, dtype=np.int64)
        columns[vector_nodes[own]] = Q.dofmap.index_map.local_to_global(own)
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
        P = self._create_P()
        jump.axpy(-1.0, P)
        result = jump.matMult(to_Q)
        for owned in (jump, P, to_Q):
            owned.destroy()
        return result

    @cached_property
    def _scalar_nodes(self) -> LocalNumbers:
        """(nodes of `_scalar`,) the node of `_vector` at each node of `_scalar`."""
        return self._vector_nodes(self._scalar)

    def _vector_nodes(self, Q: Any) -> LocalNumbers:
        """Return the node of `_vector` at each node of a scalar space of degree 1."""
        number = np.zeros(Q.dofmap.list.max(initial=-1) + 1, dtype=np.int32)
        number[Q.dofmap.list] = self._vector.dofmap.list
        return number

    def _at_nodes(self, field: fem.Function) -> Array:
        """Return the values (n, d) of a field in `_vector` at contact nodes."""
        values: Array = field.x.array.reshape(-1, self._V.dofmap.index_map_bs)[self._nodes]
        return values

    def _apply_P(self, field: fem.Function) -> Array:
        """Return P f (n, d) for a field f in `_vector`. Collective."""
        values = field.x.array.reshape(-1, self._V.dofmap.index_map_bs)
        P = self._create_P()
        right, left = P.createVecs()
        result = np.zeros((len(self._pair.nodes), values.shape[1]))
        for column in range(values.shape[1]):
            right.array = values[: right.local_size, column]
            P.mult(right, left)
            result[:, column] = left.array
        for owned in (P, right, left):
            owned.destroy()
        return result

    def _apply_P_transpose(self, loads: Array) -> Array:
        """Return P'F (nodes of `_vector` with ghosts, d) for loads F (n, d). Collective."""
        result = fem.Function(self._vector)
        whole: Array = result.x.array.reshape(-1, loads.shape[1])
        P = self._create_P()
        right, left = P.createVecs()
        for column in range(loads.shape[1]):
            left.array = loads[:, column]
            P.multTranspose(left, right)
            whole[: right.local_size, column] = right.array
        for owned in (P, right, left):
            owned.destroy()
        result.x.scatter_forward()
        return whole

    def _create_P(self) -> PETSc.Mat:
        """Create the matrix P (n, nodes of `_vector`), which the caller destroys. Collective."""
        V, comm = self._V, self._V.mesh.comm
        P = as_petsc(V.dofmap.index_map, 1, [self._pair.primary], comm)
        if V is self._vector:
            return P
        # values at nodes on edges and faces are interpolated from the corners
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

    def _transfer_density(self, values: Array) -> Array:
        """Return P'(w f) / P'w (nodes of `_vector` with ghosts, d) for f (n, d). Collective."""
        weights = self._pair.weights[:, None]
        loads, areas = (
            self._apply_P_transpose(weights * one) for one in (values, np.ones_like(values))
        )
        largest = self._V.mesh.comm.allreduce(areas.max(initial=0.0), op=MPI.MAX)
        result = np.zeros_like(loads)
        # zero at nodes whose covered area is only rounding
        np.divide(loads, areas, out=result, where=areas > AREA_PART * largest)
        return result

    def _scatter_contact_values(self, values: Array) -> Array:
        """Put values (n, d) at contact nodes into an array (nodes of `_vector` with ghosts, d).

        Values at other nodes are zero. Collective.
        """
        whole = fem.Function(self._vector)
        rows: Array = whole.x.array.reshape(-1, values.shape[1])
        rows[self._nodes] = values
        whole.x.scatter_forward()
        return rows

    def _as_function(self, like: fem.Function, values: Array) -> fem.Function:
        """Return values (nodes of `_vector`, d) as a Function with the shape and name of `like`."""
        if like.ufl_shape == ():
            result = fem.Function(self._scalar, name=like.name)
            result.x.array[:] = values[self._scalar_nodes, 0]
            return result
        result = fem.Function(self._vector, name=like.name)
        result.x.array[:] = values.ravel()
        return result
