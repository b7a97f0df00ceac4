"""The discrete contact operators of a pair, for other solvers and other physics.

Fields and loads are transferred between the sides by P, the primary part of N and T: the projection
by the dual basis psi, (P f)_i = (integral of psi_i f) / (integral of psi_i), whose rows sum to 1.
P transfers values from the primary to the secondary side, and P' loads in the opposite direction. A
density f is a load w f divided by the covered areas, w and P'w: it becomes P'(w f) / P'w.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Literal

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.functions import assembled, owned_values, vertex_count, with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca._base.petsc import as_petsc, dense_matrix
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.facets import MESH_ROUNDING, tabulate
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair


def _space(operators: ContactOperators) -> dict[str, Any]:
    """Return the space of the problem by a name, for `collective` to compare on all ranks."""
    return {"the space of the problem": operators._V}


class ContactOperators:
    """The jump operators N and T of one pair, with weights, normals, gap and tangents.

    N and T are PETSc matrices of the jump of the displacement, secondary minus primary, made on
    first use. Each rank has the rows of its contact nodes; columns are those of K, prescribed ones
    included. K and f are the stiffness matrix and the load of the problem, w the weights of the
    rows' nodes, p the pressure, t the tangential traction and g the slip bound. The solution
    satisfies K u + N'(w p) + T'(w t) = f at free degrees of freedom; p >= 0, N u <= gap and
    p (gap - N u) = 0; and at each node |t| <= g and T u = c t with a factor c >= 0, which is 0 if
    |t| < g. The how-to on embedding solves such a problem by non-negative least squares.

    Attributes:
        nodes: (n,) local numbers of the contact nodes that this rank owns (blocks of V).
        weights: (n,) covered areas of the nodes, facing the primary side [length^2, in 2D length].
        normals: (n, d) unit contact normals, out of the secondary side.
        gap: (rows of N,) gap at u = 0, with `ContactPair.gap` [length], positive if open.
        normal_node: (rows of N,) index in `nodes` of each row of N.
        tangents: (rows of T, d) unit vectors: each row of T is the jump along its vector.
        tangent_node: (rows of T,) index in `nodes` of each row of T, up to two for a node in 3D.
    """

    def __init__(
        self,
        V: Any,
        pair: PairOperators,
        surfaces: ContactPair,
        columns: Callable[[PETSc.Mat], PETSc.Mat] = lambda rows: rows,
    ) -> None:
        """Wrap the operators of a pair; matrices are created on first use. Not collective.

        `columns` converts a matrix from the columns of V to those of K, for mixed spaces.
        """
        self._V, self._pair, self._surfaces, self._columns = V, pair, surfaces, columns
        self.comm = V.mesh.comm
        self.nodes, self.weights, self.normals = pair.nodes, pair.weights, pair.normals
        self.normal_node, self.gap = pair.normal_node, pair.gap[pair.normal_node]
        self.tangents, self.tangent_node = pair.tangents, pair.tangent_node

    def __repr__(self) -> str:
        rows = f"{len(self.normal_node)} rows of N and {len(self.tangent_node)} of T"
        return f"<ContactOperators: {rows} on this rank>"

    @cached_property
    def N(self) -> PETSc.Mat:
        """Matrix of normal jumps N u [length], positive if closing. Collective."""
        return self._matrix(self._pair.N)

    @cached_property
    def T(self) -> PETSc.Mat:
        """Matrix of tangential jumps T u [length]; no rows without friction. Collective."""
        return self._matrix(self._pair.T)

    def _matrix(self, rows: Any) -> PETSc.Mat:
        """Return sparse rows as a PETSc matrix with the columns of K. Collective."""
        dofmap = self._V.dofmap
        return self._columns(as_petsc(dofmap.index_map, dofmap.index_map_bs, [rows], self.comm))

    @property
    def points(self) -> Array:
        """(n, 3) positions of the contact nodes [length]."""
        return np.asarray(self._V.tabulate_dof_coordinates()[self._pair.nodes])

    def areas(self) -> fem.Function:
        """Return the covered areas of the nodes of both sides as a Function. Collective.

        It is a scalar of degree 1 on the mesh of the displacement: `weights` on the secondary side,
        and their transfer on the primary side, with the same sum.
        """
        Q = fem.functionspace(self._V.mesh, ("Lagrange", 1))
        weights = self._pair.weights[:, None]
        areas = self._multiplied(Q, weights, transposed=True)
        np.add.at(areas, self._nodes_in(Q), weights)
        return with_owned_values(Q, areas, "areas")

    def area_fraction(self) -> fem.Function:
        """Return the covered fraction of each node's area as a Function. Collective.

        The Function is a scalar [1] like `areas`, whose values are divided by the integral of the
        node's hat function over all facets of the pair. The fraction is 1 if all facets at a node
        face the other side, whether they touch it or not, and less at the rim of the overlap. It is
        0 at secondary nodes beyond the rim, which carry no multiplier: the neighbours of these
        nodes take over their areas, and may have fractions above 1. After `update_geometry` the
        fraction also contains the stretch of the facets.

        Multiply nodal values by this fraction to integrate them in forms: the integral over the
        facets of either side is then the sum of the values times `areas`, for
        `solution.on_mesh("pressure")` the contact force, whether the meshes match or not.
        """
        areas, tags = self.areas(), self._surfaces.facet_tags
        Q, sides = areas.function_space, (self._surfaces.secondary, self._surfaces.primary)
        chosen = [side for side in sides if not isinstance(side, RigidObstacle)]
        facets = tags.indices[np.isin(tags.values, chosen)]
        # all these facets get one new tag, so that a form is compiled only once, whatever the tags
        values = np.ones(len(facets), dtype=np.int32)
        marked = dolfinx.mesh.meshtags(Q.mesh, tags.dim, facets, values)
        ds = ufl.Measure("ds", domain=Q.mesh, subdomain_data=marked, subdomain_id=1)
        ring = ufl.as_ufl(1.0)
        if self._pair.undeformed.sides[0].axisymmetric:
            ring = 2.0 * np.pi * ufl.SpatialCoordinate(Q.mesh)[0]
        whole = assembled(ring * ufl.TestFunction(Q) * ds, Q).x.array
        areas.x.array[:] /= np.where(whole > 0.0, whole, 1.0)
        areas.name = "area_fraction"
        return areas

    @collective(comm_of_self, extra_values=_space)
    def transfer(
        self, function: fem.Function, to: Literal["secondary", "primary"] = "secondary"
    ) -> fem.Function:
        """Transfer a field from one side to the other; the result is zero elsewhere. Collective.

        The transfer to the secondary side, exact for linear functions, serves primal fields such as
        temperatures. The transfer to the primary side is for densities, such as a pressure or flux:
        it is exact for constants and conserves the sum of values times `areas`, which is the
        integral over the primary facets only if the secondary side covers all of them.

        Args:
            function: a scalar or vector of Lagrange elements of degree 1 on the problem's mesh.
            to: the side that receives the values.

        Raises:
            InputError: `function` is not such a Function, or `to` is not the name of a side.
        """
        if to not in ("secondary", "primary"):
            raise InputError(f'to must be "secondary" or "primary", found {shown(to)}.')
        Q, values = self._nodal_values(function)
        if to == "primary":
            return with_owned_values(Q, self._density(Q, values[self._nodes_in(Q)]), function.name)
        result = np.zeros_like(values)
        result[self._nodes_in(Q)] = self._multiplied(Q, values)
        return with_owned_values(Q, result, function.name)

    @collective(comm_of_self, extra_values=_space)
    def transfer_loads(self, function: fem.Function) -> fem.Function:
        """Transfer nodal loads from the secondary to the primary side. Collective.

        The sum of the loads is conserved. For example, a flux through the contact [per area] times
        `areas()` is the load that secondary nodes lose, and its transfer what primary nodes gain.

        Args:
            function: nodal loads, a scalar or vector of Lagrange elements of degree 1.

        Raises:
            InputError: `function` is no such Function.
        """
        Q, values = self._nodal_values(function)
        loads = self._multiplied(Q, values[self._nodes_in(Q)], transposed=True)
        return with_owned_values(Q, loads, function.name)

    @collective(comm_of_self, extra_values=_space)
    def conductance_matrix(self, h: fem.Function) -> PETSc.Mat:
        """Return the matrix C of a flux h (q_s - q_p) [per area] through the contact. Collective.

        q is a scalar field of degree 1, such as a temperature; q_s and q_p are its means over both
        sides, weighted as in N and T: inside the contact q_s are its values at secondary nodes, q_p
        its `transfer` from the primary side; q_p = 0 for a rigid obstacle. C q is the flow out of
        each node. C is symmetric, and positive semidefinite if h >= 0; between two bodies its rows
        sum to zero: the flow out of one side is the flow into the other side.

        The caller owns the matrix. Add it to the matrix of a form of q: `K + C`, or
        `K.axpy(1.0, C)`. C is not changed by Dirichlet conditions: if q is prescribed at contact
        nodes, assemble K without conditions and call `zeroRowsColumns` on the sum.

        Args:
            h: the conductance [flux per area and jump of q], in the space of q, of which values at
                secondary nodes count; they may depend on the pressure (`SurfaceFields.on_mesh`).

        Raises:
            InputError: h is not a scalar Function of degree 1 on the mesh of the displacement.
        """
        Q, values = self._nodal_values(h, scalar=True)
        jump = self._in_space(Q, self._pair.jump)
        weighted, weights = jump.duplicate(copy=True), jump.createVecLeft()
        weights.array = self._pair.weights * values[self._nodes_in(Q), 0]
        weighted.diagonalScale(L=weights)
        return jump.transposeMatMult(weighted)

    def on_both_sides(self, density: Array, name: str, scalar: bool) -> fem.Function:
        """Return a density (n, d) at contact nodes as a Function on both sides. Collective.

        Primary nodes get the transferred density; a `scalar` density is in the first column.
        """
        shape = () if scalar else (self._V.dofmap.index_map_bs,)
        Q = fem.functionspace(self._V.mesh, ("Lagrange", 1, shape))
        density = density[:, : Q.dofmap.index_map_bs]
        result = self._density(Q, density)
        secondary = density.any(axis=1)  # elsewhere a node may have a density as a primary node
        result[self._nodes_in(Q)[secondary]] = density[secondary]
        return with_owned_values(Q, result, name)

    def _nodal_values(self, function: fem.Function, *, scalar: bool = False) -> tuple[Any, Array]:
        """Check a user's field; return its space, and values (owned nodes, 1 or d). Collective."""
        mesh, dim = self._V.mesh, self._V.dofmap.index_map_bs
        shapes: list[tuple[int, ...]] = [()] if scalar else [(), (dim,)]
        cell = mesh.basix_cell()
        elements = [basix.ufl.element("Lagrange", cell, 1, shape=shape) for shape in shapes]
        with errors_on_all_ranks(self.comm):
            on_mesh = isinstance(function, fem.Function) and function.function_space.mesh == mesh
            if not (on_mesh and function.ufl_element() in elements):
                vector = "" if scalar else f" or a vector of {dim} components"
                raise InputError(
                    "the field must be a Function of Lagrange elements of degree 1 on the mesh of "
                    f"the displacement, a scalar{vector}, found {shown(function)}. Interpolate or "
                    "project it into such a space."
                )
        return function.function_space, owned_values(function)

    def _nodes_in(self, Q: Any) -> LocalNumbers:
        """Return the local numbers (n,) in Q, of degree 1, of the contact nodes, all vertices."""
        dofs = self._V.dofmap.list
        number = np.zeros(dofs.max(initial=-1) + 1, dtype=np.int32)
        number[dofs[:, : vertex_count(self._V)]] = Q.dofmap.list
        return np.asarray(number[self._pair.nodes])

    def _in_space(self, Q: Any, rows: Any) -> PETSc.Mat:
        """Create the matrix (n, nodes of Q) that acts on Q like `rows` (n, nodes of V). Collective.

        Fields of Q have degree 1: nodes of V between vertices get values by interpolation.
        """
        V, element = self._V, self._V.element.basix_element
        # exact zeros, halves and quarters, so that nodes off the surface have no entries
        hats = np.round(tabulate(element.cell_type.name, 1, 0, element.points)[0], 12)
        # for each node of V a cell that has it (the last one written), and its place in this cell
        cell, place = np.zeros((2, V.dofmap.list.max(initial=-1) + 1), dtype=np.intp)
        cell[V.dofmap.list] = np.arange(len(V.dofmap.list))[:, None]
        place[V.dofmap.list] = np.arange(V.dofmap.list.shape[1])
        owned, nodes = V.dofmap.index_map.size_local, Q.dofmap.index_map
        corners = Q.dofmap.list[cell[:owned]].ravel()
        entries = hats[place[:owned]].ravel(), nodes.local_to_global(corners)
        ends = np.arange(owned + 1) * hats.shape[1]
        interpolation = csr_array((*entries, ends), shape=(owned, nodes.size_global))
        interpolation.eliminate_zeros()
        in_V = as_petsc(V.dofmap.index_map, 1, [rows], self.comm)
        return in_V.matMult(as_petsc(nodes, 1, [interpolation], self.comm))

    def _multiplied(self, Q: Any, values: Array, *, transposed: bool = False) -> Array:
        """Return P f (n, k) for f (owned nodes of Q, k), or P'f for f (n, k). Collective."""
        P = self._in_space(Q, self._pair.primary)
        columns = dense_matrix(values, self.comm)
        product = P.transposeMatMult(columns) if transposed else P.matMult(columns)
        return np.asarray(product.getDenseArray().copy())

    def _density(self, Q: Any, values: Array) -> Array:
        """Return P'(w f) / P'w (owned nodes of Q, k) for a density f (n, k). Collective."""
        weights = self._pair.weights[:, None]
        sums = self._multiplied(Q, np.hstack([weights * values, weights]), transposed=True)
        loads, areas = sums[:, :-1], sums[:, -1:]
        largest = self.comm.allreduce(areas.max(initial=0.0), op=MPI.MAX)
        # zero at nodes whose covered area is only rounding
        covered = np.broadcast_to(areas > MESH_ROUNDING * largest, loads.shape)
        return np.divide(loads, areas, out=np.zeros_like(loads), where=covered)
