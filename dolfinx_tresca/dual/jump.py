"""The jump operator B = (N; T) of all pairs, and the rows of the multipliers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import kron

from dolfinx import fem

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices, dots
from dolfinx_tresca._base.parallel import RankReductions
from dolfinx_tresca._base.petsc import PetscOwner, as_petsc
from dolfinx_tresca.dual.slip_bounds import NodalBounds, friction_discs, with_tangents_along_axes
from dolfinx_tresca.pairing.operators import PairOperators, assemble_B, joined
from dolfinx_tresca.solvers.feasible_set import FeasibleSet, FrictionCones, NodalCurves
from dolfinx_tresca.stiffness.frames import BodyFrames
from dolfinx_tresca.stiffness.system import LinearSystem


@dataclasses.dataclass(frozen=True)
class RowsOfPair:
    """Nodes and rows of B of a pair, in `JumpOperator.own_rows` or `JumpOperator.by_pair`.

    Pairs of a group (`PairGroup`) share nodes: at a common edge, or if they have the same nodes.
    One pair owns the multipliers of such a node, but they act on all. `own_rows` has the nodes that
    the pair owns; `by_pair` has all nodes whose multipliers act on the pair.

    Attributes:
        operators: the operators at these nodes. Their weights are the covered areas of the nodes,
            in `own_rows` on all pairs of the group together, in `by_pair` on this pair alone.
        nodes: (n,) number of each node among the nodes of all pairs of B.
        normal: (n_normal,) row of B of each row of N.
        tangential: (n_tangential,) row of B of each row of T.
    """

    operators: PairOperators
    nodes: Indices
    normal: Indices
    tangential: Indices

    def nodal_vectors(self, values: Array) -> Array:
        """Return `PairOperators.nodal_vectors` (n, 1 + d) from the values (size,) of B's rows."""
        return self.operators.nodal_vectors(values[self.normal], values[self.tangential])


class JumpOperator(PetscOwner):
    """The jump operator B: its matrix with scaled rows, and scales, nodes and gaps of the rows.

    A row is multiplied by the root of its node's area. Tangential rows are also stretched such that
    friction ellipses become discs. Vectors of multipliers are numpy arrays with the rows of this
    rank, `size` in number: for each pair its normal rows, then its tangential rows. Tractions are
    `stress_scale` times multipliers. Owns PETSc objects: call `destroy()`. The caller keeps the
    linear system.

    Attributes:
        pairs: for each contact pair the operators at the nodes whose multipliers it owns.
        frames: the frames of bodies that have turned; None: there are none.
        own_rows: for each pair the nodes and rows of the multipliers that it owns.
        nodes: for each pair the slice of its nodes among the nodes of all pairs.
        row_nodes: (size,) the index of each row's node among the nodes of all pairs.
        is_tangential: (size,) whether a row is tangential.
        matrix: the `PETSc.Mat` B, with a column for each unknown of the system; with `frames`, B R,
            since the unknowns are displacements in the frames.
        stress_scale: (size,) stress per multiplier: 1 / sqrt(area), times the stretch.
        length_scale: (size,) length per entry of a scaled jump: 1 / (sqrt(area) stretch).
        gap: (size,) the initial gaps d, divided by `length_scale`; zero for tangential rows.
        discs: Lambda with infinite slip bounds. The tangential rows of a node share one disc. At
            nodes with friction along only one of two tangents, the frictionless row has a disc of
            its own; these discs come after the discs of all nodes.
        work: a vector of unknowns that `ContactCompliance`, `NearField`, `DualProgram` overwrite.
    """

    def __init__(
        self, system: LinearSystem, pairs: Sequence[PairOperators], frames: BodyFrames | None = None
    ) -> None:
        """Assemble B from the operators of all pairs; with `frames`, B R. Collective."""
        self.system, self.frames, self.comm = system, frames, system.comm
        self.reductions = RankReductions(system.comm)
        # nodes are numbered pair by pair, and rows too: those of N, then those of T
        self.nodes: list[slice] = []
        self._rows: list[tuple[Indices, Indices]] = []
        row_nodes = []
        node, row = 0, 0  # numbers of the first node and row of a pair
        for operators in pairs:
            self.nodes.append(slice(node, node + len(operators.nodes)))
            middle = row + len(operators.normal_node)
            end = middle + len(operators.tangent_node)
            self._rows.append((np.arange(row, middle), np.arange(middle, end)))
            row_nodes.append(operators.row_node + node)
            node, row = node + len(operators.nodes), end
        self.row_nodes = np.concatenate(row_nodes)
        self._root_areas = np.sqrt(np.concatenate([operators.weights for operators in pairs]))
        scale: Array = 1.0 / self._root_areas[self.row_nodes]
        tangential = np.concatenate([rows for _, rows in self._rows])
        self.is_tangential = np.zeros(len(scale), dtype=np.bool_)
        self.is_tangential[tangential] = True
        # friction ellipses become discs by a stretch of the tangential rows
        count, nodes = len(self._root_areas), self.row_nodes[tangential]
        semi_axes = np.concatenate([operators.semi_axes for operators in pairs])
        factors, self._relative_radius, frictionless = friction_discs(nodes, semi_axes, count)
        stretch = np.ones(len(scale))
        stretch[tangential] = factors
        # with a column for each degree of freedom of V; rows times roots of areas, then stretched
        self._of_V = B = assemble_B(system.V, pairs)
        self._multipliers, self._jump = B.createVecLeft(), B.createVecLeft()
        self._multipliers.array = stretch
        B.diagonalScale(L=self._multipliers)
        self.matrix = B if system.component is None else system.component.columns(B)
        if frames is not None:
            self.matrix = frames.columns(B)
        self._force, self.work = self.matrix.createVecRight(), self.matrix.createVecRight()
        self.stress_scale, self.length_scale = scale * stretch, scale / stretch
        self.set_gaps(pairs)
        # a disc for each node, then one for each frictionless row whose node has another row
        is_bonded = np.concatenate([np.full(len(p.row_node), p.bonded) for p in pairs])
        rubs = ~is_bonded[tangential]
        has_own_disc, tangential = frictionless[rubs], tangential[rubs]
        disc = self.row_nodes[tangential].astype(np.intp)
        disc[has_own_disc] = count + np.arange(has_own_disc.sum())
        radius = np.full(count + has_own_disc.sum(), np.inf)
        normal = np.flatnonzero(~(self.is_tangential | is_bonded))
        normal_of = np.full(len(radius), -1)  # the normal row of each disc; -1: none
        normal_of[self.row_nodes[normal]] = normal
        self.discs = FeasibleSet(len(scale), normal, tangential, disc, radius, normal_of)

    def destroy(self) -> None:
        """Free the PETSc objects, `_jump_matrix` if it has been made. Collective."""
        for owned in (self._multipliers, self._jump, self._force, self.work, self.matrix):
            owned.destroy()
        if self._of_V is not self.matrix:
            self._of_V.destroy()
        if "_jump_matrix" in vars(self):
            self._jump_matrix.destroy()

    @property
    def by_pair(self) -> list[RowsOfPair]:
        """Nodes and rows of all multipliers that act on each pair, whichever pair owns them."""
        result = []
        for k in range(len(self.pairs)):
            # of each pair j of the group, the nodes whose areas are in part those of pair k
            numbers = self.pairs[k].undeformed.group.numbers
            acting, acts = [], np.zeros(len(self._root_areas), dtype=np.bool_)
            for j in numbers:
                area = self.pairs[j].shares[:, numbers.index(k)]
                keep = area > 0.0
                acts[self.nodes[j]] = keep
                at_nodes = self.pairs[j].at_nodes(keep)
                acting.append(dataclasses.replace(at_nodes, weights=area[keep]))
            row_acts = acts[self.row_nodes]
            normal = np.flatnonzero(row_acts & ~self.is_tangential)
            tangential = np.flatnonzero(row_acts & self.is_tangential)
            result.append(RowsOfPair(joined(acting), np.flatnonzero(acts), normal, tangential))
        return result

    def set_gaps(self, pairs: Sequence[PairOperators]) -> None:
        """Set `pairs`, `own_rows` and `gap` from pairs that differ in gaps only. Not collective."""
        self.pairs, self.gap = list(pairs), np.zeros(len(self.length_scale))
        self.own_rows: list[RowsOfPair] = []
        for operators, nodes, rows in zip(pairs, self.nodes, self._rows, strict=True):
            normal, tangential = rows
            numbers = np.arange(nodes.start, nodes.stop)
            self.own_rows.append(RowsOfPair(operators, numbers, normal, tangential))
            gaps = operators.gap[operators.normal_node]
            self.gap[normal] = gaps / self.length_scale[normal]

    def bounded(self, slip_bounds: Sequence[NodalBounds]) -> FeasibleSet:
        """Return Lambda or friction cones for slip bounds at each pair's nodes. Collective.

        The result is `FrictionCones` if any bound depends on the pressure, on any rank.
        """
        # the radius of a node's disc is its slip bound times `_relative_radius`, and also times the
        # root of its area if the bound is a stress; a coefficient is a ratio of multipliers. The
        # discs of frictionless rows, which come last, get the radius 0
        count, roots = len(self.discs.radius), self._root_areas
        ratios, scaled = self._relative_radius, self._relative_radius * roots
        of_discs: dict[str, Any] = {}
        for name, factor in (("constant", scaled), ("coefficient", ratios), ("limit", scaled)):
            values = np.concatenate([getattr(bounds, name) for bounds in slip_bounds])
            of_discs[name] = result = np.zeros(count)
            np.multiply(values, factor, out=result[: len(roots)], where=factor > 0.0)  # no inf * 0
        given = dataclasses.replace(self.discs, radius=of_discs.pop("constant"))
        if not self.comm.allreduce(bool(of_discs["coefficient"].any()), op=MPI.LOR):
            return given
        root = np.ones(count)
        root[: len(roots)] = np.where(roots > 0.0, roots, 1.0)
        on_nodes = zip(self.nodes, slip_bounds, strict=True)
        curves = [(nodes, bounds.curve) for nodes, bounds in on_nodes if bounds.curve is not None]
        return FrictionCones(**vars(given), **of_discs, curves=NodalCurves(curves, root))

    def along_axes(self, slip_bounds: Sequence[NodalBounds]) -> JumpOperator:
        """Return B with tangents along the axes of each node's friction ellipse. Collective.

        The result is self if tangents and semi-axes stay, else a new operator that the caller owns.
        """
        pairs = [
            with_tangents_along_axes(self.system.V, operators, bounds)
            for operators, bounds in zip(self.pairs, slip_bounds, strict=True)
        ]
        same = all(new is old for new, old in zip(pairs, self.pairs, strict=True))
        everywhere = self.comm.allreduce(same, op=MPI.LAND)
        return self if everywhere else JumpOperator(self.system, pairs, self.frames)

    def nodal_vectors(self, values: Array) -> list[Array]:
        """Return for each pair vectors (n, 1 + d) from values (size,) of rows; see `RowsOfPair`."""
        return [rows.nodal_vectors(values) for rows in self.own_rows]

    def components(self, vectors: Sequence[Array]) -> Array:
        """Return values (size,) of rows from vectors as of `nodal_vectors`. Not collective."""
        result = np.zeros(len(self.gap))
        for operators, (n, t), at_nodes in zip(self.pairs, self._rows, vectors, strict=True):
            result[n] = at_nodes[operators.normal_node, 0]
            result[t] = dots(at_nodes[operators.tangent_node, 1:], operators.tangents)
        return result

    def of_unknowns(self, u: PETSc.Vec) -> Array:
        """Return B u as a new array, for all unknowns u of the system. Collective.

        With `frames` these are v of u = u_R + R v (`BodyFrames`): the result is B R v, the jump
        without that of the rigid motion u_R of the frames.
        """
        self.matrix.mult(u, self._jump)
        return np.array(self._jump.array)

    def of_displacement(self, u: fem.Function) -> Array:
        """Return B u (size,) for a displacement, with the motion of frames in it. Collective."""
        self._of_V.mult(u.x.petsc_vec, self._jump)
        return np.array(self._jump.array)

    def vectors(self, u: fem.Function) -> list[Array]:
        """Return for each pair the jump vectors (n, d) [length] of u, not scaled. Collective."""
        product = self._jump_matrix.createVecLeft()
        self._jump_matrix.mult(u.x.petsc_vec, product)
        vectors = product.array.reshape(-1, self.system.V.dofmap.index_map_bs).copy()
        return [vectors[nodes] for nodes in self.nodes]

    def closings(self, u: fem.Function) -> list[Array]:
        """Return for each pair by how much u closes gaps at nodes, (n,) [length]. Collective.

        This is the jump along the normal, also at nodes prescribed there, which have no row of N.
        """
        return [
            dots(vectors, operators.normals)
            for vectors, operators in zip(self.vectors(u), self.pairs, strict=True)
        ]

    @cached_property
    def _jump_matrix(self) -> PETSc.Mat:
        """The matrix from u to all components of the jumps at all nodes, not scaled. Collective."""
        dofmap = self.system.V.dofmap
        identity = np.eye(dofmap.index_map_bs)
        rows = [kron(operators.jump, identity, format="csr") for operators in self.pairs]
        return as_petsc(dofmap.index_map, dofmap.index_map_bs, rows, self.comm)

    def whole_force(self, x: Array) -> PETSc.Vec:
        """Return B'x [force], also where u is prescribed. Collective; overwritten by each call."""
        self._multipliers.array = x
        self.matrix.multTranspose(self._multipliers, self._force)
        return self._force

    def contact_force(self, x: Array) -> PETSc.Vec:
        """Return B'x [force], zero where u is prescribed. Collective; overwritten by each call."""
        self.whole_force(x)
        self._force.array[self.system.prescribed] = 0.0
        return self._force

    def net_force(self, x: Array) -> PETSc.Vec:
        """Return f - B'x [force], with the prescribed values of u where there are. Collective."""
        force = self.contact_force(x)  # the vector that the next call overwrites
        force.aypx(-1.0, self.system.f.x.petsc_vec)
        return force


def nodal_compliance(system: LinearSystem) -> PETSc.Vec:
    """Return 1 / diag(K), D in `Lift`, zero except at free displacements; the caller owns it."""
    compliance, moves = system.K.getDiagonal(), system.moves
    compliance.array = np.divide(1.0, compliance.array, where=moves, out=np.zeros(len(moves)))
    return compliance


def local_stiffness(jump: JumpOperator) -> Array:
    """Return 1 / diag(B diag(K)^-1 B'), (size,): force per jump of each row of B. Collective.

    This is the stiffness of a node whose neighbours are fixed, which scales models of A and local
    errors: diag(A) is about its inverse, times a factor that hardly varies over a surface. In the
    code, the matrix of the squares of B's entries is multiplied by diag(K)^-1.
    """
    squares = jump.matrix.copy()
    squares.assemble()
    rows, columns, values = squares.getValuesCSR()
    squares.setValuesCSR(rows, columns, values**2)
    squares.assemble()
    compliance, total = nodal_compliance(jump.system), squares.createVecLeft()
    squares.mult(compliance, total)
    return np.asarray(1.0 / np.maximum(total.array, LEAST_DIVISOR))
