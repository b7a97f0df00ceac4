"""What `print(problem)` shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.stiffness.system import LinearSystem


@dataclass(frozen=True)
class ProblemSummary:
    """Sizes of a problem, over all ranks.

    Attributes:
        mesh: number and type of cells, ranks.
        dofs: degrees of freedom of the displacement.
        free_dofs: n, those of them that are not prescribed.
        contact_nodes: m, nodes that carry multipliers.
        pairs: a line for each pair.
    """

    mesh: str
    dofs: int
    free_dofs: int
    contact_nodes: int
    pairs: tuple[str, ...]

    @classmethod
    def of(
        cls, system: LinearSystem, pairs: Sequence[ContactPair], operators: Sequence[PairOperators]
    ) -> ProblemSummary:
        """Count. Collective."""
        mesh, comm = system.V.mesh, system.comm
        cells = mesh.topology.index_map(mesh.topology.dim).size_global
        counts = reduce_array(
            comm, [(~system.prescribed).sum(), *(len(o.nodes) for o in operators)]
        )
        return cls(
            mesh=f"{cells} cells ({mesh.topology.cell_name()}), MPI ranks: {comm.size}",
            dofs=system.V.dofmap.index_map_bs * system.V.dofmap.index_map.size_global,
            free_dofs=int(counts[0]),
            contact_nodes=int(counts[1:].sum()),
            pairs=tuple(
                f"{pair}, {one.pairing}: {nodes} nodes, {_gap_range(comm, one)}, {pair.friction}"
                for pair, one, nodes in zip(pairs, operators, counts[1:], strict=True)
            ),
        )

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values. Not collective."""
        return [
            ("mesh", self.mesh),
            ("displacements", f"{self.dofs}, {self.free_dofs} of them free"),
            ("contact nodes", f"{self.contact_nodes}"),
            *(("  pair", pair) for pair in self.pairs),
        ]


def _gap_range(comm: Any, operators: PairOperators) -> str:
    """Return the range of the gap, with what is rounding shown as zero. Collective."""
    size = operators.weights ** (1.0 / (operators.normals.shape[1] - 1))
    gap = np.where(np.abs(operators.gap) > 1e-12 * size, operators.gap, 0.0)
    least, negated = reduce_array(
        comm, [gap.min(initial=np.inf), (-gap).min(initial=np.inf)], MPI.MIN
    )
    return f"gap {least:.3g}" if least == -negated else f"gap {least:.3g} to {-negated:.3g}"
