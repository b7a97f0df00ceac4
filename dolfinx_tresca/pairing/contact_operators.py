"""The discrete contact operators of a pair, for other solvers and other physics."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Literal

from petsc4py import PETSc

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.pairing.operators import PairOperators, as_petsc
from dolfinx_tresca.pairing.transfer import SideTransfer
from dolfinx_tresca.scene.pair import ContactPair


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
        self._transfer = SideTransfer(V, pair, surfaces)

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

    def areas(self) -> fem.Function:
        """Return the covered areas of the nodes of both sides as a Function. Collective.

        The areas are `weights` on the secondary side, and the mortar transfer of `weights` on the
        primary side; both sides have the same total area. The Function is a scalar of degree 1 on
        the mesh of the displacement.
        """
        return self._transfer.areas()

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
        return self._transfer.area_fraction()

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
        return self._transfer.values(function, to)

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
        return self._transfer.loads(function)

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
        return self._transfer.conductance(h)
