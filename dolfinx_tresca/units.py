"""Names of the user's units, for printed tables and plots."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

from dolfinx_tresca.errors import InputError, shown

Quantity: TypeAlias = Literal["length", "stress", "force", "energy"]


@dataclass(frozen=True)
class Units:
    """Names of units, as in `Units("mm", "MPa", force="N")`; values are never converted.

    Attributes:
        length: unit of coordinates, displacements, slips and gaps.
        stress: unit of moduli, pressures, tractions and slip bounds.
        force: unit of resultant forces in 3D and of axisymmetric bodies; in plane strain, forces
            and energies are per unit of thickness. The default is composed of stress and length, as
            in "MPa mm²".

    Example:
        >>> from dolfinx_tresca import Units
        >>> Units("mm", "MPa", force="N").of("energy")
        'N mm'
        >>> Units("m", "Pa").of("force", dim=2)
        'Pa m'
    """

    length: str
    stress: str
    force: str = ""

    def __post_init__(self) -> None:
        """Check the names.

        Raises:
            InputError: a name is not a string, or the name of the length or the stress is empty.
        """
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
            dim: dimension of space; in 2D, forces and energies are per unit of thickness.
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
