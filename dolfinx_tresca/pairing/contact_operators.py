"""The operators of a pair, for other solvers and other physics."""

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
    """Return the space on whose mesh Functions must live. Not collective."""
    return {"the space of the problem": operators._V}


class ContactOperators(PetscOwner):
    """N, T and what belongs to their rows: the contact of one pair, discretised.

    Rows are distributed like the contact nodes, columns like those of K. With K and f of the
    problem the contact is: K u + N'(w p) + T'(w t) = f, where nothing is prescribed, with the areas
    w of the rows' nodes, the pressure p and the tangential traction t; N u <= gap, p >= 0, one of
    the two with equality; |t| <= g at each node, and T u along t where it is g.

    Owns PETSc objects, those of the problem: they go with `ContactProblem.destroy()`.

    Example:
        The cube of `ContactProblem`, which a plane presses, by non-negative least squares: the
        least of 1/2 F'A F - F'b for forces F >= 0, on one rank.

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
        """Keep a pair; matrices are made when they are asked for. Not collective.

        Args:
            V: the space of the displacement.
            pair: its operators.
            surfaces: whose operators they are.
            columns: gives a matrix with columns for V, which it may keep, those of K.
        """
        self._V, self._pair, self._columns = V, pair, columns
        self._transfer = SideTransfer(V, pair, surfaces)

    def __repr__(self) -> str:
        rows = f"{len(self.normal_node)} rows of N and {len(self.tangent_node)} of T"
        return f"<ContactOperators: {self._pair.pairing}, {rows} on this rank>"

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self._V.mesh.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for name in ("N", "T"):
            if name in vars(self):
                vars(self).pop(name).destroy()

    @cached_property
    def N(self) -> PETSc.Mat:
        """Normal jumps N u [length], secondary minus primary: closing where positive. Collective.

        A row per normal multiplier, `normal_node`. Where u is prescribed columns are as elsewhere.
        """
        return self._matrix(self._pair.N)

    @cached_property
    def T(self) -> PETSc.Mat:
        """Tangential jumps T u [length] along `tangents`; no rows without friction. Collective."""
        return self._matrix(self._pair.T)

    def _matrix(self, rows: Any) -> PETSc.Mat:
        dofmap = self._V.dofmap
        return self._columns(as_petsc(dofmap.index_map, dofmap.index_map_bs, [rows], self.comm))

    @property
    def nodes(self) -> LocalNumbers:
        """(n,) contact nodes that this rank owns: numbers of blocks of V."""
        return self._pair.nodes

    @property
    def points(self) -> Array:
        """(n, 3) where they are [length]."""
        points: Array = self._V.tabulate_dof_coordinates()[self._pair.nodes]
        return points

    @property
    def weights(self) -> Array:
        """(n,) their areas [length^2, in 2D length]."""
        return self._pair.weights

    @property
    def normals(self) -> Array:
        """(n, d) outward unit normals of the secondary side."""
        return self._pair.normals

    @property
    def gap(self) -> Array:
        """(rows of N,) distance before the bodies move [length], positive: open."""
        gap: Array = self._pair.gap[self._pair.normal_node]
        return gap

    @property
    def normal_node(self) -> LocalNumbers:
        """(rows of N,) the position in `nodes` of each row of N."""
        return self._pair.normal_node

    @property
    def tangents(self) -> Array:
        """(rows of T, d) unit vectors: the direction of each row of T."""
        return self._pair.tangents

    @property
    def tangent_node(self) -> LocalNumbers:
        """(rows of T,) the position in `nodes` of each row of T; both of a node in 3D."""
        return self._pair.tangent_node

    def areas(self) -> fem.Function:
        """Return `weights`, and what they are on the primary side, as a Function. Collective.

        A scalar of degree 1 on the mesh of the displacements; the sum is the same on both sides.
        """
        return self._transfer.areas()

    def area_fraction(self) -> fem.Function:
        """Return which part of each node's area is in contact, as a Function. Collective.

        A scalar [1] of degree 1 on the mesh of the displacements, at the nodes of both sides:
        `areas` over what the facets round a node have in forms. 1 where all of them are before the
        other side, pressed or open, and 0 elsewhere. At rims it is less, and 0 at secondary nodes
        beyond the rim, which carry no multiplier; their neighbours, which have their part, may have
        more than 1. After `update_geometry` it has the stretch of the facets as a factor. Values at
        nodes times this are a density for forms: its integrals over the facets of either side are
        sums of values times `areas`, which for
        `solution.on_mesh("pressure")` are the force, on whatever meshes.
        """
        return self._transfer.area_fraction()

    @collective(comm_of_self, extra_values=_space)
    def transfer(
        self, function: fem.Function, to: Literal["secondary", "primary"] = "secondary"
    ) -> fem.Function:
        """Return a field with the values of the other side, zero elsewhere. Collective.

        To the secondary side by the mortar projection, which keeps what is linear: for primal
        fields, such as temperatures, whose jump is wanted. To the primary side as a density, with
        the same constants, and the same sum with `areas`: for pressures and fluxes. That sum is the
        integral over the primary facets only where the secondary side is before all of them.

        A field that jumps between cells, such as one of degree 0, has the values of the cells that
        the facets of its side belong to, in their mean by area where several meet in a node.

        Args:
            function: a scalar or a vector on the mesh of the displacements; taken in degree 1.
            to: the side that gets values.

        Raises:
            InputError: it is no such Function, or there is no such side.
        """
        return self._transfer.values(function, to)

    @collective(comm_of_self, extra_values=_space)
    def transfer_loads(self, function: fem.Function) -> fem.Function:
        """Return what secondary nodes' loads are on the primary side: the transpose. Collective.

        The sum of all is kept to rounding. A flux through the contact [per area] times
        `areas()` are the loads that secondary nodes lose; this is what the primary side gets.

        Args:
            function: a load of each node, a scalar or a vector, of Lagrange elements of degree 1.

        Raises:
            InputError: it is no such Function.
        """
        return self._transfer.loads(function)

    @collective(comm_of_self, extra_values=_space)
    def conductance_matrix(self, h: fem.Function) -> PETSc.Mat:
        """Return the matrix of a flux h (T_s - T_p) [per area] through the contact. Collective.

        T is a scalar field of degree 1, such as a temperature; T_p what `transfer` makes of it, and
        zero before a rigid obstacle, which then takes what the body loses.
        Row i of the matrix times T is what leaves node i. Symmetric, positive semidefinite, and
        between two bodies rows sum to zero: whatever T is, what leaves one side enters the other,
        to rounding.

        The matrix is the caller's, who may destroy it. Add it to that of a form of T: `K + C`, or
        `K.axpy(1.0, C)`. It knows no Dirichlet conditions: where T is prescribed in contact nodes,
        assemble K without them and call `zeroRowsColumns` on the sum.

        Args:
            h: the conductance [flux per area and jump], in the space of T; its values at nodes of
                the secondary side count, and may depend on the pressure (`SurfaceFields.on_mesh`).

        Raises:
            InputError: it is no scalar Function of degree 1 on the mesh of the displacements.
        """
        return self._transfer.conductance(h)
