"""What the user says about two surfaces that may touch."""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from typing import Any

from dolfinx_tresca.errors import InputError
from dolfinx_tresca.friction import Tresca


@dataclass(frozen=True)
class ContactPair:
    """Two surfaces that may touch, and the friction between them.

    Attributes:
        facet_tags: `MeshTags` of the facets of the problem's mesh.
        secondary: tag of the side that carries multipliers, normals and gap; of two equal sides
            take the softer or the finer one.
        primary: tag of the other side.
        friction: the law of friction.
    """

    facet_tags: Any
    secondary: int
    primary: int
    friction: Tresca

    def __post_init__(self) -> None:
        """Check tags and friction.

        Raises:
            InputError: a tag is no integer, both are the same, or the friction is no law.
        """
        for name in ("secondary", "primary"):
            tag = getattr(self, name)
            if not isinstance(tag, numbers.Integral) or isinstance(tag, bool):
                raise InputError(
                    f"{name} must be the integer tag of a surface, found {tag!r}. Names of a Gmsh "
                    "file "
                    'have their tags in read_gmsh(...).tags["name"].'
                )
        if self.secondary == self.primary:
            raise InputError(
                f"secondary and primary have the same tag {self.secondary}: "
                "a pair needs two different surfaces."
            )
        if not isinstance(self.friction, Tresca):
            raise InputError(
                f"friction must be a law such as Tresca(0.1), found {self.friction!r}."
            )
