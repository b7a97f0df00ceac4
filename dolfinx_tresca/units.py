"""Names of the units that the user computes in: for what is printed and drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

from dolfinx_tresca.errors import InputError, shown

Quantity: TypeAlias = Literal["length", "stress", "force", "energy"]

#: Common units, which are taken for no other quantity.
LENGTHS = ("m", "km", "cm", "mm", "um", "µm", "μm", "nm", "in", "inch", "ft")
STRESSES = ("Pa", "kPa", "MPa", "GPa", "bar", "psi", "ksi", "N/m²", "N/m^2", "N/mm²", "N/mm^2")


@dataclass(frozen=True)
class Units:
    """Names of units, as in `Units("mm", "MPa", force="N")`. Nothing is converted.

    Attributes:
        length: of coordinates, displacements, slips and gaps.
        stress: of moduli, pressures, tractions and slip bounds.
        force: of resultants in 3D; by default it is put together, as in "MPa mm²". In 2D forces
            and energies are those of a unit of thickness.

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
            InputError: one is no string, that of length or stress is empty, or they are exchanged.
        """
        for field in fields(self):
            name = getattr(self, field.name)
            if not isinstance(name, str) or (not name.strip() and field.name != "force"):
                raise InputError(
                    f"{field.name} must be the name of a unit, such as 'mm', found {shown(name)}."
                )
        if self.length in STRESSES or self.stress in LENGTHS:
            raise InputError(
                f"the unit of length comes first, as in Units('mm', 'MPa'), found {self.length!r} "
                f"of length and {self.stress!r} of stress."
            )

    def of(self, quantity: Quantity, dim: int = 3) -> str:
        """Return the name of the unit of a quantity.

        Args:
            quantity: what is measured.
            dim: of space; in 2D forces and energies are those of a unit of thickness.
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
    """Return a number with the name of its unit; as it is where there are no names."""
    return number if units is None else f"{number} {units.of(quantity, dim)}"
