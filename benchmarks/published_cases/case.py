"""The description of a published case: quantities, their published values, and our solve."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from mpi4py import MPI

import numpy as np

#: Relative residual at which solves end, so small that only errors of the mesh remain.
RTOL = 1e-8


@dataclass(frozen=True)
class Published:
    """The published values of a quantity.

    Attributes:
        low, high: lowest and highest published value.
        text: text in the table.
        source: source of these values; "": they have the source of the case.
    """

    low: float
    high: float
    text: str
    source: str = ""


def number(value: float) -> str:
    """Return a value with five digits."""
    return f"{value:.5g}"


def exactly(value: float) -> Published:
    """Return a single value, such as the value of a formula, as published."""
    return Published(value, value, number(value))


def between(low: float, high: float) -> Published:
    """Return a published range of values."""
    return Published(low, high, f"{number(low)} to {number(high)}")


def by_group(values: Mapping[str, float], rounding: float = 0.0, source: str = "") -> Published:
    """Return the published values of several groups or programs, which were rounded.

    Args:
        values: name of the group -> value.
        rounding: half of the last digit of the values.
        source: see `Published.source`.
    """
    texts = [f"{value:g} ({name})" for name, value in values.items()]
    return Published(
        min(values.values()) - rounding, max(values.values()) + rounding, ", ".join(texts), source
    )


def peak_of(x: np.ndarray, pressure: np.ndarray) -> float:
    """Return the peak of the half ellipse that is fitted to the inner half of a contact.

    The fit is used since pressures of single nodes differ from their neighbours if meshes do not
    match.

    Args:
        x: (n,) distances from the middle, divided by the half width of the contact.
        pressure: (n,) pressures at these distances.
    """
    inside = x < 0.5
    _, square = np.polyfit(x[inside] ** 2, pressure[inside] ** 2, 1)
    return float(np.sqrt(square))


@dataclass(frozen=True)
class Result:
    """The solution of a case on one mesh.

    Attributes:
        values: quantity -> value.
        space: the space of the displacement.
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
        name: name of the script.
        title: title in tables and pictures.
        published: quantity -> published value.
        source: whether the values come from a formula, from other programs, or from tests of
            specimens.
        argument: meaning of the size, which is the argument of the script.
        sizes: mesh sizes or numbers of cells, from coarse to fine; the ratio of successive sizes is
            constant.
        solve: function from a communicator and a size to the result. Collective.
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
