"""The discrete contact operators of a pair, for other solvers and other physics.

Fields and loads are transferred between the sides by P, the primary part of N and T: the projection
by the dual basis psi, (P f)_i = (integral of psi_i f) / (integral of psi_i), whose rows sum to 1:

- *Values* (temperatures, displacements) are transferred from the primary to the secondary side
  by P, which is exact for constants and linear functions.
- *Loads* (nodal forces, nodal heat flows) are transferred from the secondary to the primary
  side by P', which conserves their sum.

Densities (pressures, fluxes) are loads divided by areas. With the covered areas w of secondary
nodes, the covered areas of primary nodes are P'w, and a density f becomes P'(w f) / P'w. This is
exact for constants and conserves the sum of densities times areas.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from typing import Any, Literal

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.assembly import assembled
from dolfinx_tresca._base.matrices import dense_matrix
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca._base.vertices import entities_per_cell
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc
from dolfinx_tresca.pairing.search.facets import tabulate
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: Covered area of a primary node, relative to the largest one, that counts as rounding: densities
#: are zero at such a node.
AREA_PART = 1e-10

#: Quadrature at the corners of facets, which lumps integrals: only values at a node contribute to
#: the node's integral.
AT_CORNERS = {"quadrature_rule": "vertex", "quadrature_degree": 1}


def _space(operators: ContactOperators) -> dict[str, Any]:
    """Return a name and the space of the problem, which `collective` compares on all ranks."""
    return {"the space of the problem": operators._V}


class ContactOperators(PetscOwner):
    """The jump operators N and T of one pair, with weights, normals, gap and tangents.

    The rows of N and T are distributed among the ranks like the contact nodes, the columns like
    those of K. K and f are the stiffness matrix and the load of the problem, w the areas of the
    rows' nodes, p the pressure, t the tangential traction and g the slip bound. The solution
    satisfies K u + N'(w p) + T'(w t) = f at free degrees of freedom; p >= 0, N u <= gap and
    p (gap - N u) = 0; and at each node |t| <= g and T u = c t with a factor c >= 0, which is 0 if
    |t| < g.

    N and T are PETSc matrices, which `ContactProblem.destroy()` frees.

    Example:
        The cube in the example of `ContactProblem`, on one rank. Non-negative least squares
        find the forces F >= 0 that minimise 1/2 F'A F - F'b, where A = N K^-1 N' = C C' and
        b = N K^-1 f - gap.

        >>> from scipy.optimize import nnls
        >>> from scipy.sparse import csr_array
        >>> from scipy.sparse.linalg import splu
        >>> one = problem.operators[0]
        >>> K, N = (csr_array(M.getValuesCSR()[::-1], M.size) for M in (problem.stiffness, one.N))
        >>> displaced = splu(K.tocsc()).solve(N.T.toarray())
        >>> C = np.linalg.cholesky(N @ displaced)
        >>> F, _ = nnls(C.T, np.linalg.solve(C, displaced.T @ problem.load.array - one.gap))
        >>> f"{F.sum():.2f} N, {(F / one.weights[one.normal_node]).max():.2f} MPa"
        '1.00 N, 1.00 MPa'
    """

    def __init__(
        self,
        V: Any,
        pair: PairOperators,
        surfaces: ContactPair,
        columns: Callable[[PETSc.Mat], PETSc.Mat] = lambda rows: rows,
    ) -> None:
        """Wrap the operators of a pair; matrices are created on first use. Not collective.

        Args:
            V: the space of the displacement.
            pair: the operators of the pair.
            surfaces: the contact pair.
            columns: function that converts a matrix from the columns of V to the columns of K,
                which differ if V is a component of a mixed space.
        """
        self._V, self._pair, self._columns = V, pair, columns
        self.comm = self._V.mesh.comm
        self._surfaces = surfaces

    def __repr__(self) -> str:
        rows = f"{len(self.normal_node)} rows of N and {len(self.tangent_node)} of T"
        return f"<ContactOperators: {rows} on this rank>"

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for name in ("N", "T"):
            if name in vars(self):
                vars(self).pop(name).destroy()

    @cached_property
    def N(self) -> PETSc.Mat:
        """Matrix of normal jumps N u [length], secondary minus primary, positive if closing.

        One row for each normal multiplier, see `normal_node`. Columns of prescribed degrees of
        freedom are not zeroed. Collective.
        """
        return self._matrix(self._pair.N)

    @cached_property
    def T(self) -> PETSc.Mat:
        """Matrix of tangential jumps T u [length], secondary minus primary, along `tangents`.

        Without friction the matrix has no rows. Collective.
        """
        return self._matrix(self._pair.T)

    def _matrix(self, rows: Any) -> PETSc.Mat:
        """Return sparse rows as a PETSc matrix with the columns of K. Collective."""
        dofmap = self._V.dofmap
        return self._columns(as_petsc(dofmap.index_map, dofmap.index_map_bs, [rows], self.comm))

    @property
    def nodes(self) -> LocalNumbers:
        """(n,) local numbers of the contact nodes that this rank owns (blocks of V)."""
        return self._pair.nodes

    @property
    def points(self) -> Array:
        """(n, 3) positions of the contact nodes [length]."""
        points: Array = self._V.tabulate_dof_coordinates()[self._pair.nodes]
        return points

    @property
    def weights(self) -> Array:
        """(n,) covered areas of the contact nodes [length^2, in 2D length].

        The covered part of a node's area is the part that faces the primary side.
        """
        return self._pair.weights

    @property
    def normals(self) -> Array:
        """(n, d) outward unit normals of the secondary side."""
        return self._pair.normals

    @property
    def gap(self) -> Array:
        """(rows of N,) initial gap of the undeformed bodies [length], positive if open."""
        gap: Array = self._pair.gap[self._pair.normal_node]
        return gap

    @property
    def normal_node(self) -> LocalNumbers:
        """(rows of N,) index in `nodes` of each row of N."""
        return self._pair.normal_node

    @property
    def tangents(self) -> Array:
        """(rows of T, d) unit vectors: each row of T is the jump along its vector."""
        return self._pair.tangents

    @property
    def tangent_node(self) -> LocalNumbers:
        """(rows of T,) index in `nodes` of each row of T; nodes have up to two rows in 3D."""
        return self._pair.tangent_node

    @cached_property
    def _scalar(self) -> Any:
        """The scalar space of degree 1 of transferred fields. Collective."""
        return fem.functionspace(self._V.mesh, ("Lagrange", 1))

    @cached_property
    def _vector(self) -> Any:
        """The vector space of degree 1. Collective."""
        V = self._V
        if V.element.basix_element.degree == 1:
            return V
        return fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))

    @cached_property
    def _nodes(self) -> LocalNumbers:
        """(n,) numbers of the contact nodes in `_scalar`."""
        return _numbers_in(self._scalar, self._V)[self._pair.nodes]

    @cached_property
    def _vector_nodes(self) -> LocalNumbers:
        """(nodes of `_scalar`,) the node of `_vector` at each node of `_scalar`."""
        return _numbers_in(self._vector, self._scalar)

    def areas(self) -> fem.Function:
        """Return the covered areas of the nodes of both sides as a Function. Collective.

        The areas are `weights` on the secondary side, and the mortar transfer of `weights` on the
        primary side; both sides have the same total area. The Function is a scalar of degree 1 on
        the mesh of the displacement.
        """
        result, weights = fem.Function(self._scalar, name="areas"), self._pair.weights
        np.add.at(result.x.array, self._nodes, weights)
        result.x.scatter_forward()
        result.x.array[:] += self._transposed(weights[:, None])[:, 0]
        return result

    def area_fraction(self) -> fem.Function:
        """Return the covered fraction of each node's area as a Function. Collective.

        The Function is a scalar [1] of degree 1 on the mesh of the displacement, with values at the
        nodes of both sides: `areas` divided by the integral of the node's hat function over all
        facets of the pair. The fraction is 1 if all facets at a node face the other side, whether
        they touch it or not, and less at the rim of the overlap. It is 0 off the surfaces, and at
        secondary nodes beyond the rim, which carry no multiplier: the neighbours of these nodes
        take over their areas, and may have fractions above 1. After `update_geometry` the fraction
        also contains the factor by which the displacement has stretched the facets.

        Multiply nodal values by this fraction to integrate them in forms: the integral over the
        facets of either side is then the sum of the values times `areas`. For
        `solution.on_mesh("pressure")` this integral is the contact force, whether the meshes match
        or not.
        """
        surfaces, areas, Q = self._surfaces, self.areas(), self._scalar
        sides = (surfaces.secondary, surfaces.primary)
        tags = [side for side in sides if not isinstance(side, RigidObstacle)]
        radius = ufl.SpatialCoordinate(Q.mesh)[0]
        size = 2.0 * np.pi * radius if self._pair.axisymmetric else ufl.as_ufl(1.0)
        form = size * ufl.TestFunction(Q) * _tagged_measure(Q, surfaces.facet_tags, tags)
        whole = assembled(form, Q).x.array
        areas.x.array[:] /= np.where(whole > 0.0, whole, 1.0)
        areas.name = "area_fraction"
        return areas

    @collective(comm_of_self, extra_values=_space)
    def transfer(
        self, function: fem.Function, to: Literal["secondary", "primary"] = "secondary"
    ) -> fem.Function:
        """Transfer a field from one side to the other; the result is zero elsewhere. Collective.

        The transfer to the secondary side is the mortar projection, which is exact for linear
        functions: it serves primal fields whose jump is needed, such as temperatures. The transfer
        to the primary side is for densities, such as a pressure or flux: it is exact for constants
        and conserves the sum of values times `areas`. This sum is the integral over the primary
        facets only if the secondary side covers all primary facets.

        On a facet, a discontinuous field, such as a field of degree 0, has the value of the facet's
        cell; its value at a node is the mean over the facets at the node, weighted by area.

        Args:
            function: a scalar or vector on the mesh of the displacement; it is interpolated in
                degree 1.
            to: the side that receives the values.

        Raises:
            InputError: `function` is not such a Function, or `to` is not the name of a side.
        """
        if to not in ("secondary", "primary"):
            raise InputError(f'to must be "secondary" or "primary", found {shown(to)}.')
        surfaces = self._surfaces
        if to == "primary":
            field = self._nodal_values(function, surfaces.secondary)
            return self._as_function(function, self._transferred_density(field[self._nodes]))
        P, Q = self._projection(self._scalar), self._scalar.dofmap.index_map
        owned = self._nodal_values(function, surfaces.primary)[: Q.size_local]
        columns = dense_matrix(owned, self.comm)
        product = P.matMult(columns)
        values = product.getDenseArray().copy()
        for matrix in (P, columns, product):
            matrix.destroy()
        return self._as_function(function, self._at_contact_nodes(values))

    @collective(comm_of_self, extra_values=_space)
    def transfer_loads(self, function: fem.Function) -> fem.Function:
        """Transfer nodal loads from the secondary to the primary side. Collective.

        The transfer is the transpose of the mortar projection; it conserves the sum of the loads up
        to rounding. For example, a flux through the contact [per area] times `areas()` is the load
        that secondary nodes lose, and its transfer is the load that primary nodes gain.

        Args:
            function: nodal loads, a scalar or vector of Lagrange elements of degree 1.

        Raises:
            InputError: `function` is not such a Function.
        """
        nodal = [space.ufl_element() for space in (self._scalar, self._vector)]
        with errors_on_all_ranks(self.comm):
            if isinstance(function, fem.Function) and function.ufl_element() not in nodal:
                raise InputError(
                    "loads of nodes must be a Function of Lagrange elements of degree 1, assembled "
                    f"with their test functions, found {shown(function)}. Densities are "
                    'transferred by transfer(q, to="primary").'
                )
        loads = self._nodal_values(function, self._surfaces.secondary)[self._nodes]
        return self._as_function(function, self._transposed(loads))

    @collective(comm_of_self, extra_values=_space)
    def conductance_matrix(self, h: fem.Function) -> PETSc.Mat:
        """Return the matrix C of a flux h (T_s - T_p) [per area] through the contact. Collective.

        Here T is not the jump operator, but a scalar field of degree 1, such as a temperature. T_s
        are its values at secondary nodes, T_p its `transfer` from the primary side, and T_p = 0 for
        a rigid obstacle. Row i of C T is the flow out of node i. C is symmetric and positive
        semidefinite. Between two bodies its rows sum to zero, and the flow out of one side equals
        the flow into the other side, up to rounding.

        The caller owns the matrix and may destroy it. Add it to the matrix of a form of T: `K + C`,
        or `K.axpy(1.0, C)`. C is not changed by Dirichlet conditions: if T is prescribed at contact
        nodes, assemble K without conditions and call `zeroRowsColumns` on the sum.

        Args:
            h: the conductance [flux per area and jump of T], in the space of T. Its values at
                secondary nodes are used; they may depend on the pressure (`SurfaceFields.on_mesh`).

        Raises:
            InputError: h is not a scalar Function of degree 1 on the mesh of the displacement.
        """
        mesh = self._V.mesh
        with errors_on_all_ranks(self.comm):
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
        Q = h.function_space
        nodes, index_map = _numbers_in(Q, self._V)[self._pair.nodes], Q.dofmap.index_map
        count = len(nodes)
        entries = np.ones(count), index_map.local_to_global(nodes), np.arange(count + 1)
        rows = csr_array(entries, shape=(count, index_map.size_global))
        jump, P = as_petsc(index_map, 1, [rows], self.comm), self._projection(Q)
        jump.axpy(-1.0, P)
        weighted, weights = jump.duplicate(copy=True), jump.createVecLeft()
        weights.array = self._pair.weights * h.x.array[nodes]
        weighted.diagonalScale(L=weights)
        result = jump.transposeMatMult(weighted)
        for owned in (jump, P, weighted, weights):
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
        whole, across = self._at_contact_nodes(density), self._transferred_density(density)
        nowhere = ~whole.any(axis=1)
        whole[nowhere] = across[nowhere]
        like = fem.Function(self._scalar if scalar else self._vector, name=name)
        return self._as_function(like, whole)

    def _nodal_values(self, function: fem.Function, side: int | RigidObstacle) -> Array:
        """Return the values (nodes of `_scalar`, 1 or d) of a field in degree 1. Collective.

        Args:
            function: a scalar or vector field.
            side: tag of the side from which a discontinuous field takes its values, or an obstacle.

        Raises:
            InputError: `function` is not a scalar or vector Function on the mesh.
        """
        dim, mesh = self._V.dofmap.index_map_bs, self._V.mesh
        with errors_on_all_ranks(self.comm):
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
            nodal = fem.Function(space)
            nodal.interpolate(function)
        else:
            nodal = facet_means(function, space, self._surfaces.facet_tags, side)
        values: Array = nodal.x.array.reshape(-1, 1 if scalar else dim)
        return values if scalar else values[self._vector_nodes]

    def _projection(self, Q: Any) -> PETSc.Mat:
        """Create P (n, nodes of Q) for a scalar space Q of degree 1. Collective.

        The caller destroys the matrix. At nodes of V on edges and faces a field of degree 1 is
        interpolated from the corners of a cell.
        """
        V, element = self._V, self._V.element.basix_element
        # exact zeros, halves and quarters, so that nodes off the surface have no entries
        hats = np.round(tabulate(element.cell_type.name, 1, 0, element.points)[0], 12)
        cell, place = np.zeros((2, V.dofmap.list.max(initial=-1) + 1), dtype=np.intp)
        cell[V.dofmap.list] = np.arange(len(V.dofmap.list))[:, None]
        place[V.dofmap.list] = np.arange(V.dofmap.list.shape[1])
        owned, nodes = V.dofmap.index_map.size_local, Q.dofmap.index_map
        corners = Q.dofmap.list[cell[:owned]].ravel()
        entries = hats[place[:owned]].ravel(), nodes.local_to_global(corners)
        ends = np.arange(owned + 1) * hats.shape[1]
        interpolation = csr_array((*entries, ends), shape=(owned, nodes.size_global))
        interpolation.eliminate_zeros()
        P = as_petsc(V.dofmap.index_map, 1, [self._pair.primary], self.comm)
        to_Q = as_petsc(nodes, 1, [interpolation], self.comm)
        result = P.matMult(to_Q)
        P.destroy()
        to_Q.destroy()
        return result

    def _transposed(self, loads: Array) -> Array:
        """Return P'F (nodes of `_scalar` with ghosts, d) for loads F (n, d). Collective."""
        P, rows = self._projection(self._scalar), dense_matrix(loads, self.comm)
        product = P.transposeMatMult(rows)
        result = self._with_ghosts(product.getDenseArray())
        for matrix in (P, rows, product):
            matrix.destroy()
        return result

    def _transferred_density(self, values: Array) -> Array:
        """Return P'(w f) / P'w (nodes of `_scalar` with ghosts, d) for f (n, d). Collective."""
        weights = self._pair.weights[:, None]
        sums = self._transposed(np.hstack([weights * values, weights]))
        loads, areas = sums[:, :-1], sums[:, -1:]
        largest = self.comm.allreduce(areas.max(initial=0.0), op=MPI.MAX)
        # zero at nodes whose covered area is only rounding
        covered = np.broadcast_to(areas > AREA_PART * largest, loads.shape)
        return np.divide(loads, areas, out=np.zeros_like(loads), where=covered)

    def _at_contact_nodes(self, values: Array) -> Array:
        """Put values (n, d) at contact nodes into an array (nodes of `_scalar` with ghosts, d).

        Values at other nodes are zero. Collective.
        """
        owned = np.zeros((self._scalar.dofmap.index_map.size_local, values.shape[1]))
        owned[self._nodes] = values
        return self._with_ghosts(owned)

    def _with_ghosts(self, values: Array) -> Array:
        """Return values (owned nodes of `_scalar`, d) followed by those at ghosts. Collective."""
        vector = dolfinx.la.vector(self._scalar.dofmap.index_map, values.shape[1], np.float64)
        vector.array[: values.size] = values.ravel()
        vector.scatter_forward()
        return np.array(vector.array).reshape(-1, values.shape[1])

    def _as_function(self, like: fem.Function, values: Array) -> fem.Function:
        """Return values (nodes of `_scalar`, d) as a Function with the shape and name of `like`."""
        if like.ufl_shape == ():
            result = fem.Function(self._scalar, name=like.name)
            result.x.array[:] = values[:, 0]
            return result
        result = fem.Function(self._vector, name=like.name)
        result.x.array.reshape(-1, values.shape[1])[self._vector_nodes] = values
        return result


def _numbers_in(Q: Any, V: Any) -> LocalNumbers:
    """Return the node of a space Q of degree 1 at each node of V; 0 at nodes off the corners."""
    number = np.zeros(V.dofmap.list.max(initial=-1) + 1, dtype=np.int32)
    number[V.dofmap.list[:, : entities_per_cell(V, 0)]] = Q.dofmap.list
    return number


def facet_means(function: fem.Function, space: Any, facet_tags: Any, tag: int) -> fem.Function:
    """Average a field over the tagged facets at each node. Collective.

    On a boundary facet the field has the values of the facet's cell. The result at a node is the
    mean over its tagged facets, weighted by area; it is zero at nodes without tagged facets.

    Args:
        function: a scalar or vector field of any element with values at the corners of facets.
        space: space of degree 1 for the result, with as many components as the field.
        facet_tags: tags of boundary facets of the mesh.
        tag: the tag of the facets.
    """
    ds = _tagged_measure(space, facet_tags, (tag,))(metadata=AT_CORNERS)
    test = ufl.TestFunction(space)
    one = ufl.as_ufl(1.0) if test.ufl_shape == () else ufl.as_vector([1.0] * len(test))
    total, areas = (assembled(ufl.inner(of, test) * ds, space).x.array for of in (function, one))
    result = fem.Function(space)
    np.divide(total, areas, out=result.x.array, where=areas > 0.0)
    return result


def _tagged_measure(space: Any, facet_tags: Any, tags: Collection[int]) -> Any:
    """Return the measure of all facets with any of the tags.

    All these facets get one new tag, so that a form is compiled only once, whatever the tags are.
    """
    facets = facet_tags.indices[np.isin(facet_tags.values, list(tags))]
    numbered = dolfinx.mesh.meshtags(
        space.mesh, facet_tags.dim, facets, np.ones(len(facets), dtype=np.int32)
    )
    return ufl.Measure("ds", domain=space.mesh, subdomain_data=numbered, subdomain_id=1)
