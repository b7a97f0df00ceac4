"""Tables of names and values, for `print` and for notebooks, and the names of the user's units."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from html import escape
from typing import Literal, TypeAlias

from dolfinx_tresca._base.parallel import fill
from dolfinx_tresca.errors import InputError, shown

Quantity: TypeAlias = Literal["length", "stress", "force", "energy"]

#: A name, indented if it belongs to the row above, and its value.
Row: TypeAlias = tuple[str, str]

#: Largest number of rows of a list in a table. Of a longer list the first rows are shown, and the
#: number of the remaining rows.
LISTED_ROWS = 8


@dataclass(frozen=True)
class Units:
    """Names of units, as in `Units("mm", "MPa", force="N")`; values are never converted.

    Attributes:
        length: unit of coordinates, displacements, slips and gaps.
        stress: unit of moduli, pressures, tractions and slip bounds.
        force: unit of resultant forces in 3D and of axisymmetric bodies; in plane strain, forces
            and energies are per unit of thickness. By default stress times area, "MPa mm²".

    Example:
        >>> from dolfinx_tresca import Units
        >>> Units("mm", "MPa", force="N").of("energy")
        'N mm'
    """

    length: str
    stress: str
    force: str = ""

    def __post_init__(self) -> None:
        """Check the names."""
        for field in fields(self):
            name = getattr(self, field.name)
            if not isinstance(name, str) or (not name.strip() and field.name != "force"):
                raise InputError(
                    f"{field.name} must be the name of a unit, such as 'mm', found {shown(name)}."
                )

    def of(self, quantity: Quantity, dim: int = 3) -> str:
        """Return the name of the unit of a quantity.

        Args:
            quantity: quantity whose unit is returned, such as "stress".
            dim: dimension; 3 for axisymmetric bodies. In 2D forces and energies are per thickness.
        """
        if quantity == "length":
            return self.length
        if quantity == "stress":
            return self.stress
        if not self.force:
            power = dim - 1 if quantity == "force" else dim
            return f"{self.stress} {self.length}" + {1: "", 2: "²", 3: "³"}[power]
        name = self.force if quantity == "force" else f"{self.force} {self.length}"
        return name if dim == 3 else f"{name}/{self.length}"


def with_unit(number: str, units: Units | None, quantity: Quantity, dim: int = 3) -> str:
    """Return a number followed by the name of its unit, or the number alone without units."""
    return number if units is None else f"{number} {units.of(quantity, dim)}"


class Tabulated(ABC):
    """An object that `print` and notebooks show as the same table."""

    @abstractmethod
    def _rows(self) -> list[Row]:
        """Return the rows of the table. Not collective."""

    def __str__(self) -> str:
        return as_text(self._rows())

    def _repr_html_(self) -> str:
        return as_html(self._rows())


def abridged(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return all rows of a list, or the first rows and a row like "and 5 other pairs" (`kind`)."""
    if len(rows) <= LISTED_ROWS:
        return list(rows)
    listed = list(rows[: LISTED_ROWS - 1])
    return [*listed, (listed[-1][0], f"and {len(rows) - len(listed)} other {kind}")]


def as_text(rows: Sequence[Row]) -> str:
    """Return a table as text: each row is a line, or several lines if its value is long."""
    return "\n".join(fill(value, f"{name:<14} ", 15 * " ") for name, value in rows)


def as_html(rows: Sequence[Sequence[str]]) -> str:
    """Return a table for notebooks, in the colours of the notebook's theme."""
    left = 'style="text-align: left"'  # Jupyter aligns texts in tables to the right
    lines = []
    for name, *values in rows:
        cells = "".join(f"<td {left}>{escape(value)}</td>" for value in values)
        lines.append(f"<tr><th {left}>{escape(name).replace(' ', '&nbsp;')}</th>{cells}</tr>")
    return "\n".join(["<table>", *lines, "</table>"])
