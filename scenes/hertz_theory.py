"""Hertz's theory of balls and cylinders that are pressed together.

K. L. Johnson, Contact Mechanics, sections 4.2 and 5.6. Lengths in mm, stresses in MPa, forces in N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np


def plane_strain_modulus(young: float, poisson: float) -> float:
    """Return E/(1 - nu^2) [MPa]."""
    return young / (1 - poisson**2)


def far_compliance(radius: float, young: float, poisson: float) -> float:
    """Return how far a unit force moves the end of a ball opposite to the contact [mm/N].

    The displacement of a half-space at the depth 2 R under a point load is a good approximation
    (Y. Tatara, J. Eng. Mater. Technol. 113, 1991).
    """
    return ((1 + poisson) / 4 + (1 - poisson**2) / 2) / (math.pi * young * radius)


@dataclass(frozen=True)
class HertzSphere:
    """Two balls, or a ball and a plane, pressed together by a force."""

    force: float  # N
    radius: float  # mm, R
    modulus: float  # MPa, E
    far: float = 0.0  # mm/N, `far_compliance`, or the sum of this for both balls

    @property
    def contact_radius(self) -> float:
        """Radius a of the contact [mm]."""
        return (0.75 * self.force * self.radius / self.modulus) ** (1 / 3)

    @property
    def peak(self) -> float:
        """The pressure in the middle [MPa]."""
        return 1.5 * self.force / (math.pi * self.contact_radius**2)

    @property
    def approach(self) -> float:
        """How much the middles of the bodies approach each other [mm]."""
        return self.contact_radius**2 / self.radius - self.far * self.force

    def pressure(self, r: Any) -> Any:
        """Return the pressure [MPa] at distances r [mm] from the middle."""
        return self.peak * np.sqrt(np.maximum(1 - (r / self.contact_radius) ** 2, 0))


@dataclass(frozen=True)
class HertzLine:
    """A cylinder and a plane, pressed together by a force per length."""

    force: float  # N/mm
    radius: float  # mm, R
    modulus: float  # MPa, E

    @property
    def contact_radius(self) -> float:
        """Half the width of the contact, a [mm]."""
        return math.sqrt(4 * self.force * self.radius / (math.pi * self.modulus))

    @property
    def peak(self) -> float:
        """The pressure in the middle [MPa]."""
        return 2 * self.force / (math.pi * self.contact_radius)

    @property
    def approach(self) -> float:
        """How much the axis of a cylinder between two planes approaches each plane [mm]; (5.57)."""
        logarithm = 2 * math.log(4 * self.radius / self.contact_radius) - 1
        return self.force / (math.pi * self.modulus) * logarithm

    def pressure(self, r: Any) -> Any:
        """Return the pressure [MPa] at distances r [mm] from the middle."""
        return self.peak * np.sqrt(np.maximum(1 - (r / self.contact_radius) ** 2, 0))
