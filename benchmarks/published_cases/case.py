"""A published case: quantities with their published values, and ours on three meshes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np


@dataclass(frozen=True)
class Result:
    """The solution of a case on one mesh.

    Attributes:
        values: quantity -> value.
        x, y: points of the curve that the picture shows, (n,) each.
    """

    values: Mapping[str, float]
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Case:
    """A published case.

    Attributes:
        name: of its script.
        title: in tables and pictures.
        published: quantity -> lowest and highest published value.
        sizes: mesh sizes or numbers of cells, from coarse to fine; each halves the cells.
        solve: communicator and size -> result. Collective.
        axes: labels of the picture's axes.
        curve: points of the published curve, x and y; None if there is none.
        marks: published points, x and y, in place of a curve.
    """

    name: str
    title: str
    published: Mapping[str, tuple[float, float]]
    sizes: Sequence[float]
    solve: Callable[[MPI.Comm, float], Result]
    axes: tuple[str, str]
    curve: tuple[np.ndarray, np.ndarray] | None = None
    marks: tuple[Sequence[float], Sequence[float]] | None = None

    def main(self) -> None:
        """Print published values and ours; the mesh size may be given as an argument."""
        size = float(sys.argv[1]) if len(sys.argv) > 1 else self.sizes[0]
        values = self.solve(MPI.COMM_WORLD, size).values
        if MPI.COMM_WORLD.rank == 0:
            print(f"{self.title}; size {size:g}")
            for quantity, (low, high) in self.published.items():
                spread = f"{low:.5g}" if low == high else f"{low:.5g} to {high:.5g}"
                print(f"{quantity:32s} {values[quantity]:12.6g}   published {spread}")
