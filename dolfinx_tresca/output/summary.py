"""The rows of `print(problem)`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.number import real
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.output.table import Row, abridged
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.friction import Friction, Tresca
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.units import Units, with_unit


@dataclass(frozen=True)
class ProblemSummary:
    """Sizes of a problem, over all ranks.

    Attributes:
        mesh: the number and type of cells and the number of ranks, as text.
        dofs: degrees of freedom of the displacement.
        free_dofs: n, degrees of freedom of the displacement that are not prescribed.
        other_dofs: free degrees of freedom of other components of a mixed space.
        contact_nodes: m, nodes that carry multipliers.
        pairs: for each pair: the pair; its kind of pairing and number of nodes, as text; and the
            range of its gap, as text.
    """

    mesh: str
    dofs: int
    free_dofs: int
    other_dofs: int
    contact_nodes: int
    pairs: tuple[tuple[ContactPair, str, str], ...]

    @classmethod
    def of(
        cls, system: LinearSystem, pairs: Sequence[ContactPair], jump: JumpOperator
    ) -> ProblemSummary:
        """Count cells, unknowns and contact nodes of a problem. Collective."""
        mesh, comm = system.V.mesh, system.comm
        cells = mesh.topology.index_map(mesh.topology.dim).size_global
        operators = [rows.operators for rows in jump.by_pair]
        own = [int(system.moves.sum()), sum(len(one.nodes) for one in jump.pairs)]
        counts = reduce_array(comm, [*own, *(len(one.nodes) for one in operators)])
        return cls(
            mesh=f"{cells} cells ({mesh.topology.cell_name()}"
            + ", axisymmetric" * system.axisymmetric
            + f"), MPI ranks: {comm.size}",
            dofs=system.V.dofmap.index_map_bs * system.V.dofmap.index_map.size_global,
            free_dofs=int(counts[0]),
            other_dofs=system.saddle_size,
            contact_nodes=int(counts[1]),
            pairs=tuple(
                (pair, f"{_kind(pair)}: {nodes} nodes", _gap_range(comm, one))
                for pair, one, nodes in zip(pairs, operators, counts[2:], strict=True)
            ),
        )

    def rows(self, units: Units | None) -> list[Row]:
        """Return names and values. Not collective."""
        beside = f", beside {self.other_dofs} unknowns of other kinds" if self.other_dofs else ""
        return [
            ("mesh", self.mesh),
            ("displacements", f"{self.dofs}, {self.free_dofs} of them free" + beside),
            ("contact nodes", f"{self.contact_nodes}"),
            *abridged([self._pair_row(*one, units) for one in self.pairs], "pairs"),
        ]

    @staticmethod
    def _pair_row(pair: ContactPair, paired: str, gap: str, units: Units | None) -> Row:
        """Return the row of a pair."""
        friction = _friction_text(pair.friction, units)
        return "  pair", f"{pair}, {paired}, {with_unit(gap, units, 'length')}, {friction}"


def _kind(pair: ContactPair) -> str:
    """Return the kind of the pairing."""
    return "obstacle" if isinstance(pair.primary, RigidObstacle) else "mortar"


def _friction_text(friction: Friction, units: Units | None) -> str:
    """Return a law as text; a Tresca bound that is a number or a Constant has its unit."""
    number = False
    if isinstance(friction, Tresca):
        bound = friction.slip_bound
        bounds = bound if isinstance(bound, tuple) else (bound,)
        number = all(isinstance(one, fem.Constant) or real(one) is not None for one in bounds)
    return with_unit(str(friction), units if number else None, "stress")


def _gap_range(comm: Any, operators: PairOperators) -> str:
    """Return the range of the gap as text; rounding is shown as zero. Collective."""
    gap = np.where(np.abs(operators.gap) > 1e-12 * operators.sizes, operators.gap, 0.0)
    least, negated = reduce_array(
        comm, [gap.min(initial=np.inf), (-gap).min(initial=np.inf)], MPI.MIN
    )
    return f"gap {least:.3g}" if least == -negated else f"gap {least:.3g} to {-negated:.3g}"
