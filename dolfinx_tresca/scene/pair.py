"""What the user says about surfaces that may touch."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from dolfinx.mesh import MeshTags

from dolfinx_tresca._base.number import integer, real
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import Bonded, DryFriction, Friction, Frictionless
from dolfinx_tresca.scene.geometry import Geometry, check_geometry
from dolfinx_tresca.scene.mesh import NamedTags
from dolfinx_tresca.scene.obstacle import RigidObstacle

Pairing: TypeAlias = Literal["auto", "nodes", "mortar"]

Sliding: TypeAlias = Literal["small", "finite"]


@dataclass(frozen=True)
class ContactPair:
    """Two surfaces that may touch, or a surface and a rigid obstacle, and their friction.

    Tags may go round edges, or mark whole boundaries: only facets that face the other side count,
    in their areas, normals and integrals, and nothing pairs through a body whose boundary is in
    one of the tags. Of several layers the nearest one counts. Normals are averaged over the facets
    round a node, but not over edges at which they differ by more than
    `surface.edges.EDGE_ANGLE`, 55 degrees. Where both sides of such an edge are in contact, as in
    a groove, its nodes have a pressure for each; there friction acts along the edge only.

    Attributes:
        facet_tags: `MeshTags` of the facets of the problem's mesh.
        secondary: tag of the side that carries multipliers, normals and gap; of two equal sides
            take the softer or the finer one.
        primary: tag of the other side, or a `RigidObstacle`.
        friction: `Tresca`, `Coulomb`, `Frictionless` or `Bonded`.
        pairing: "nodes" couples each secondary node with the primary node that it meets; "mortar"
            weighs the jump over the facets, and needs no matching meshes; "auto" takes nodes where
            the meshes are the same to rounding (1e-8 of a facet) wherever the sides face each
            other, else mortar. Without meaning for a rigid obstacle.
        search_distance: only what is not farther apart than this [length], or penetrates no deeper,
            takes part; None: any distance.
        geometry: where facets stand for curved surfaces, what these are: `TaggedMesh.geometry` of
            `read_gmsh`, or tag -> a function from points (3, n) to the points (3, n) on the surface
            next to them [length]. Gaps of mortar pairs are between these surfaces then, which makes
            up for coarse facets where bodies fit closely; after `update_geometry` they stay as high
            over the facets as they were. None: surfaces through the nodes, smooth as these say.
            Without meaning node-to-node, and for a rigid obstacle.
        sliding: "small" keeps the normal and the partner of each node; "finite" pairs the surfaces
            in the configuration of the solution, so they may slide far, leave each other and come
            back. `SolverOptions.geometry_accuracy` is its accuracy.
        name: of the pair in tables, pictures, files and messages; None: the names of its tags in
            the mesh file (see `read_gmsh`), or else the tags.

    Example:
        Two bodies in one mesh, by the names of their faces in a Gmsh file:

        >>> from mpi4py import MPI
        >>> from dolfinx_tresca import ContactPair, Frictionless, RigidPlane, Tresca
        >>> from dolfinx_tresca import MESHES, read_gmsh
        >>> bricks = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_WORLD, N=2)
        >>> ContactPair(
        ...     bricks.facet_tags,
        ...     secondary=bricks.tags["upper_contact"],
        ...     primary=bricks.tags["lower_contact"],
        ...     friction=Tresca(0.09),
        ... )
        <ContactPair: upper_contact on lower_contact, slip bound 0.09>

        A body on a floor:

        >>> floor = RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
        >>> ContactPair(bricks.facet_tags, 13, floor, Frictionless(), name="ground")
        <ContactPair: ground, no friction>
    """

    facet_tags: Any
    secondary: int
    primary: int | RigidObstacle
    friction: Friction
    pairing: Pairing = "auto"
    search_distance: float | None = None
    geometry: Geometry | None = None
    sliding: Sliding = "small"
    name: str | None = None

    def __post_init__(self) -> None:
        """Check all but what the mesh has to say.

        Raises:
            InputError: a tag is no integer, both are the same, or an argument is of the wrong kind.
        """
        if not isinstance(self.facet_tags, MeshTags):
            raise InputError(
                "facet_tags must be dolfinx.mesh.MeshTags of facets, such as "
                f"read_gmsh(...).facet_tags, found {shown(self.facet_tags)}."
            )
        if self.facet_tags.values.dtype != np.int32:
            raise InputError(
                f"facet_tags must have values of type int32, found {self.facet_tags.values.dtype}."
            )
        for name in ("secondary", "primary"):
            tag = getattr(self, name)
            if name == "primary" and isinstance(tag, RigidObstacle):
                continue
            number = integer(tag)
            if number is None or abs(number) > np.iinfo(np.int32).max:
                other = " or a RigidObstacle" if name == "primary" else ""
                raise InputError(
                    f"{name} must be the integer tag of a surface{other}, found {shown(tag)}. "
                    'Names of a Gmsh file have their tags in read_gmsh(...).tags["name"].'
                )
            object.__setattr__(self, name, number)
        if self.secondary == self.primary:
            raise InputError(
                f"secondary and primary have the same tag {self.secondary}: "
                "a pair needs two different surfaces."
            )
        if not isinstance(self.friction, DryFriction | Frictionless | Bonded):
            raise InputError(
                "friction must be a law such as Tresca(0.1), Coulomb(0.3), Frictionless() or "
                f"Bonded(), found {shown(self.friction)}."
            )
        if not isinstance(self.pairing, str) or self.pairing not in get_args(Pairing):
            raise InputError(
                f"pairing must be one of {', '.join(get_args(Pairing))}, found "
                f"{shown(self.pairing)}."
            )
        if self.search_distance is not None:
            distance = real(self.search_distance)
            if distance is None or not distance > 0.0:
                raise InputError(
                    "search_distance must be a positive number, found "
                    f"{shown(self.search_distance)}."
                )
            object.__setattr__(self, "search_distance", distance)
        check_geometry(self.geometry)
        if not isinstance(self.sliding, str) or self.sliding not in get_args(Sliding):
            raise InputError(
                f"sliding must be one of {', '.join(get_args(Sliding))}, found "
                f"{shown(self.sliding)}."
            )
        if self.name is not None and not (isinstance(self.name, str) and self.name.strip()):
            raise InputError(f"name must be a string, found {shown(self.name)}.")

    @property
    def search_limit(self) -> float:
        """The search distance as a number [length]."""
        return math.inf if self.search_distance is None else self.search_distance

    def __repr__(self) -> str:
        return f"<ContactPair: {self}, {self.friction}>"

    def __str__(self) -> str:
        if self.name is not None:
            return self.name
        return f"{self.side('secondary')} on {self.side('primary')}"

    def side(self, which: Literal["secondary", "primary"]) -> str:
        """Return how messages name a side: as the mesh file does, or by its tag."""
        tag = getattr(self, which)
        if isinstance(tag, RigidObstacle):
            return str(tag)
        names = self.facet_tags.names if isinstance(self.facet_tags, NamedTags) else {}
        return names.get(tag, f"tag {tag}")


def checked_pairs(pairs: Sequence[ContactPair]) -> list[ContactPair]:
    """Return the pairs as a list.

    Raises:
        InputError: they are no pairs, or two of them are between the same surfaces.
    """
    if not isinstance(pairs, Iterable):
        raise InputError(
            f"pairs must be a sequence: write [pair] for a single one; found {shown(pairs)}."
        )
    result = list(pairs)
    for pair in result:
        if not isinstance(pair, ContactPair):
            raise InputError(f"pairs must hold ContactPair objects, found {shown(pair)}.")
    if not result:
        raise InputError("a contact problem needs at least one ContactPair, found none.")
    named: set[str] = set()
    seen: set[frozenset[Any]] = set()
    for pair in result:
        sides = frozenset((pair.secondary, pair.primary))
        if sides in seen:
            raise InputError(
                f"two pairs are between the surfaces {pair.secondary} and {pair.primary}: that "
                "would constrain their nodes twice. Give one pair."
            )
        seen.add(sides)
        if pair.name in named:
            raise InputError(f"two pairs have the name {pair.name}: give each a name of its own.")
        named.update(() if pair.name is None else (pair.name,))
    return result
