"""A published case: quantities with their published values, and ours on three meshes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from mpi4py import MPI

import numpy as np

#: Residual of each solve, so small that errors are those of the mesh.
RTOL = 1e-8


@dataclass(frozen=True)
class Published:
    """What others have published of a quantity.

    Attributes:
        low, high: lowest and highest value.
        text: what the table shows.
        source: where the values come from, if not from where the others of the case come.
    """

    low: float
    high: float
    text: str
    source: str = ""


def number(value: float) -> str:
    """Return a value with five digits."""
    return f"{value:.5g}"


def exactly(value: float) -> Published:
    """Return the value of a formula."""
    return Published(value, value, number(value))


def between(low: float, high: float) -> Published:
    """Return a range."""
    return Published(low, high, f"{number(low)} to {number(high)}")


def by_group(values: Mapping[str, float], rounding: float = 0.0, source: str = "") -> Published:
    """Return the values of several groups or programs, rounded to twice `rounding`."""
    texts = [f"{value:g} ({name})" for name, value in values.items()]
    return Published(
        min(values.values()) - rounding, max(values.values()) + rounding, ", ".join(texts), source
    )


def peak_of(x: np.ndarray, pressure: np.ndarray) -> float:
    """Return the pressure in the middle of the half ellipse that fits the inner half of a contact.

    Single nodes differ from their neighbours where the meshes of the bodies do not match.

    Args:
        x: (n,) distances from the middle, over half the width.
        pressure: (n,).
    """
    inside = x < 0.5
    _, square = np.polyfit(x[inside] ** 2, pressure[inside] ** 2, 1)
    return float(np.sqrt(square))


@dataclass(frozen=True)
class Result:
    """The solution of a case on one mesh.

    Attributes:
        values: quantity -> value.
        space: of the displacement.
        x, y: points of the curve that the picture shows, (n,) each.
    """

    values: Mapping[str, float]
    space: Any
    x: np.ndarray = field(default_factory=lambda: np.zeros(0))
    y: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, kw_only=True)
class Case:
    """A published case.

    Attributes:
        name: of its script.
        title: in tables and pictures.
        published: quantity -> published value.
        source: whether the values come from a formula, from other programs, or from tests of
            specimens.
        argument: what the size is.
        sizes: mesh sizes or numbers of cells, from coarse to fine, each the last one by a constant
            factor.
        solve: communicator and size -> result. Collective.
        order: the power of the cell size with which errors fall in theory.
        resolution: relative error that does not depend on the mesh, such as that of a bisection.
        axes: labels of the picture's axes; None: there is no picture.
        curve: points of the published curve, x and y; None if there is none.
        marks: published points, x and y, in place of a curve.
    """

    name: str
    title: str
    published: Mapping[str, Published]
    source: Literal["formula", "programs", "experiments"]
    argument: str
    sizes: Sequence[float]
    solve: Callable[[MPI.Comm, float], Result]
    order: float = 2.0
    resolution: float = 0.0
    axes: tuple[str, str] | None = None
    curve: tuple[np.ndarray, np.ndarray] | None = None
    marks: tuple[Sequence[float], Sequence[float]] | None = None

    def main(self) -> None:
        """Print published values and ours; the mesh size may be given as an argument."""
        size = float(sys.argv[1]) if len(sys.argv) > 1 else self.sizes[0]
        values = self.solve(MPI.COMM_WORLD, size).values
        if MPI.COMM_WORLD.rank == 0:
            print(f"{self.title}; {self.argument}: {size:g}")
            for quantity, known in self.published.items():
                print(f"{quantity:42s} {values[quantity]:12.6g}   published {known.text}")
