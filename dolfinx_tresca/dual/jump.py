"""The jump operator B = (N; T) of all pairs, and the rows of the multipliers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import RankReductions
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.friction_cones import FrictionCones
from dolfinx_tresca.pairing.operators import PairOperators, assemble_B, multiplier_slices
from dolfinx_tresca.stiffness.system import LinearSystem


class JumpOperator(PetscOwner):
    """B, with rows times the square root of their node's area, and what belongs to its rows.

    Vectors of multipliers are numpy arrays with this rank's rows: for each pair its normal
    multipliers, then its tangential ones. Physical tractions are `scale` times them.

    Owns PETSc objects: call `destroy()`. The linear system stays the caller's.

    Attributes:
        system: whose displacements jump.
        pairs: the pairs.
        slices: the positions of each pair's normal and tangential multipliers.
        matrix: the `PETSc.Mat` B.
        scale: (size,) 1 / sqrt(area): stress over multiplier, and length over residual.
        gap: (size,) the initial gaps d over `scale`; zero for tangential rows.
        unbounded: Lambda with infinite slip bounds.
        reductions: over the ranks.
    """

    def __init__(self, system: LinearSystem, pairs: Sequence[PairOperators]) -> None:
        """Assemble B. Collective."""
        self.system = system
        self.pairs, self.slices = list(pairs), multiplier_slices(pairs)
        self.reductions = RankReductions(system.comm)
        self.matrix = assemble_B(system.V, pairs)
        self._multipliers, self._jump = self.matrix.createVecLeft(), self.matrix.createVecLeft()
        self._force, self._u = self.matrix.createVecRight(), self.matrix.createVecRight()
        areas = [pair.weights[pair.row_node] for pair in pairs]
        self.scale = 1.0 / np.sqrt(np.concatenate(areas))
        self.gap = np.zeros(len(self.scale))
        for pair, (normal, _) in zip(self.pairs, self.slices, strict=True):
            self.gap[normal] = pair.gap[pair.normal_node] / self.scale[normal]
        self.unbounded = self._without_bounds()

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self.system.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for owned in (self._multipliers, self._jump, self._force, self._u, self.matrix):
            owned.destroy()

    def _without_bounds(self) -> FeasibleSet:
        """Return Lambda with infinite slip bounds. Not collective."""
        normal, tangential, node = [], [], []
        nodes = 0
        positions = np.arange(len(self.scale))
        for pair, (n, t) in zip(self.pairs, self.slices, strict=True):
            if not pair.bonded:
                normal.append(positions[n])
                tangential.append(positions[t])
                node.append(pair.tangent_node + nodes)
            nodes += len(pair.nodes)
        return FeasibleSet(
            size=len(self.scale),
            normal=np.concatenate([*normal, positions[:0]]),
            tangential=np.concatenate([*tangential, positions[:0]]),
            node=np.concatenate([*node, positions[:0]]).astype(np.intp),
            radius=np.full(nodes, np.inf),
        )

    def bounded(self, slip_bounds: Sequence[NodalBounds]) -> FeasibleSet | FrictionCones:
        """Return Lambda for slip bounds at each pair's nodes. Collective.

        Cones where the bounds of any pair depend on the pressure, on any rank.
        """
        roots = np.sqrt(np.concatenate([pair.weights for pair in self.pairs]))
        constant, coefficient, limit = (
            np.concatenate([getattr(bounds, name) for bounds in slip_bounds])
            for name in ("constant", "coefficient", "limit")
        )
        if not self.comm.allreduce(bool(coefficient.any()), op=MPI.LOR):
            return dataclasses.replace(self.unbounded, radius=constant * roots)
        normal_of = np.full(len(roots), -1)
        first = 0
        for pair, (normal, _) in zip(self.pairs, self.slices, strict=True):
            if not pair.bonded:
                rows = np.arange(normal.start, normal.stop)
                normal_of[first + pair.normal_node] = rows
            first += len(pair.nodes)
        return FrictionCones(
            self.unbounded, normal_of, constant * roots, coefficient, limit * roots
        )

    def of(self, u: PETSc.Vec) -> Array:
        """Return B u as a new array, for instance of a whole displacement. Collective."""
        self.matrix.mult(u, self._jump)
        return np.array(self._jump.array)

    def of_values(self, u: Array) -> Array:
        """Return B u for the values of u on this rank. Collective."""
        self._u.array = u
        return self.of(self._u)

    def whole_force(self, x: Array) -> PETSc.Vec:
        """Return B'x [force], also where u is prescribed; the next call overwrites it."""
        self._multipliers.array = x
        self.matrix.multTranspose(self._multipliers, self._force)
        return self._force

    def contact_force(self, x: Array) -> PETSc.Vec:
        """Return B'x [force], zero where u is prescribed; the next call overwrites it."""
        self.whole_force(x)
        self._force.array[self.system.prescribed] = 0.0
        return self._force

    def net_force(self, x: Array) -> PETSc.Vec:
        """Return f - B'x [force]; the next call, or one of `contact_force`, overwrites it."""
        force = self.contact_force(x)
        force.aypx(-1.0, self.system.f.x.petsc_vec)
        return force
