"""Pairs of surfaces that may touch, and goals: numbers computed from a pair's solution."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from dolfinx.cpp.mesh import MeshTags_int32

from dolfinx_tresca._base.arguments import (
    check_type,
    check_word,
    checked_integer,
    checked_number,
    checked_vector,
)
from dolfinx_tresca._base.arrays import integer
from dolfinx_tresca._base.compat import same_topology
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.friction import Bonded, Friction, Preload, ScalarField, check_field
from dolfinx_tresca.scene.geometry import Geometry, check_geometry
from dolfinx_tresca.scene.mesh import MergedTags, NamedTags
from dolfinx_tresca.scene.obstacle import RigidObstacle

Pairing: TypeAlias = Literal["auto", "nodes", "mortar"]

Sliding: TypeAlias = Literal["small", "finite"]

SideName: TypeAlias = Literal["secondary", "primary"]

SIDES: tuple[SideName, SideName] = ("secondary", "primary")


@dataclass(frozen=True)
class ContactPair:
    """Two surfaces that may touch, or a surface and a rigid obstacle, and their law of friction.

    The tagged surfaces may include edges or whole boundaries: areas, normals and integrals include
    only facets that face the other side, and facets are not paired through a body whose boundary
    has one of the tags. Among several layers of facets the nearest one is paired. Gaps and
    pressures are along the contact normal: of two sides the one whose normal turns less from facet
    to facet decides (docs/theory/pairing.md). If both sides of a sharp edge
    (`pairing.facets.EDGE_ANGLE`, 55 degrees) are in contact, as in a groove, a node on the edge has
    one pressure for each side, and friction acts along the edge only.

    Attributes:
        facet_tags: `MeshTags` of the facets of the problem's mesh.
        secondary: tag of the secondary side, which carries multipliers, normals and gap: the
            softer or finer side is the better choice. For a surface with several tags, give the
            list of its tags: the pair keeps the first one, and its own `facet_tags` have this first
            tag in place of the others; `geometry` has the tags of the list. Pairs for each tag,
            which may have different laws, share the multipliers of their common nodes.
        primary: tag, or list of tags, of the primary side, or a `RigidObstacle`. With the same tag
            as `secondary`, or the same list of tags, all bodies with this surface may touch each
            other, and so may parts of one body. Of two bodies that meet, the body with finer facets
            is secondary; if their facets are alike, that with the smaller least x, then y, then z.
        friction: `Tresca`, `Coulomb`, `Frictionless`, `Bonded` or `Preload`.
        pairing: "auto" and "mortar" average the jump over the facets by dual basis functions; where
            the meshes of both sides match, this is the jump between a node and the node opposite
            to it. "nodes" does the same, but demands that the undeformed meshes match within 1e-8
            of a facet wherever the sides face each other. Ignored for a rigid obstacle.
        search_distance: largest gap and largest penetration [length] at which points of the
            surfaces are paired; None: no limit.
        geometry: the curved surfaces that the facets approximate: `TaggedMesh.geometry` of
            `read_gmsh`, or tag -> function from points (3, n) to the nearest points (3, n) on the
            surface [length]; flat surfaces need no function. Gaps and normals are those of these
            surfaces, which corrects coarse facets of closely fitting bodies. `update_geometry`
            keeps the heights of the surfaces over the facets. None: the geometry that `facet_tags`
            of `read_gmsh` have; a warning says if it cannot be used, because the file is gone or
            nodes were moved. For other tags, and with {} for all, gaps and normals are those of
            smooth surfaces through the nodes, by the nodal normals. Ignored for rigid obstacles.
        sliding: "small" keeps the normal and the partner of each node; "finite" pairs the surfaces
            in the configuration of the solution, so that they may slide far, separate and touch
            again, with the accuracy `SolverOptions.geometry_accuracy`.
        gap: gap [length] that is added to the distance of the surfaces at each contact node of the
            secondary side, along its normal, positive where it separates them: a profile, a shim,
            or the depth of wear. It may be a scalar of any type that `Tresca.slip_bound` may have,
            and may be negative. Constants and Functions may be changed in place before each solve.
            If surfaces are paired again, each node keeps its added gap. None: no gap is added.
        name: name of the pair in tables, pictures, files and messages; None: the names of its tags
            in the mesh file (see `read_gmsh`), or the tags.

    Example:
        Two bodies in one mesh, with the names of their surfaces in a Gmsh file:

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
    secondary: Any
    primary: Any
    friction: Friction
    pairing: Pairing = "auto"
    search_distance: float | None = None
    geometry: Geometry | None = None
    sliding: Sliding = "small"
    gap: ScalarField | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        """Check the arguments, without the mesh, and replace lists of tags by their first tags.

        Raises:
            InputError: an argument has a wrong type or value, the sides have only a part of their
                tags in common, an obstacle has a preload, or bonded surfaces have a gap.
        """
        kind = "dolfinx.mesh.MeshTags of facets, of type int32, such as read_gmsh(...).facet_tags"
        facet_tags = getattr(self.facet_tags, "_cpp_object", self.facet_tags)
        check_type("facet_tags", facet_tags, MeshTags_int32, kind)
        tags_of_side: dict[SideName, list[int]] = {}  # each tag once; without a rigid obstacle
        for side in SIDES:
            given = getattr(self, side)
            if side == "primary" and isinstance(given, RigidObstacle):
                continue
            entries = given if isinstance(given, Sequence) else [given]
            integers = [integer(entry) for entry in entries]  # None: no integer
            tags = list(dict.fromkeys(tag for tag in integers if tag is not None))
            if not tags or None in integers or max(map(abs, tags)) > np.iinfo(np.int32).max:
                obstacle = ", or a RigidObstacle" if side == "primary" else ""
                raise InputError(
                    f"{side} must be the integer tag of a surface, or a list of integer tags"
                    f'{obstacle}, found {shown(given)}. Tags are in read_gmsh(...).tags["name"].'
                )
            tags_of_side[side] = tags
        secondary, primary = tags_of_side["secondary"], tags_of_side.get("primary", [])
        common = [tag for tag in secondary if tag in primary]
        if common and set(secondary) != set(primary):
            raise InputError(
                f"the tags {shown(common)} are on both sides, and others are not: give two lists "
                "without common tags, or the same list twice."
            )
        if common:  # equal lists may have different orders; both sides get the same first tag
            tags_of_side["primary"] = secondary
        # a list of tags becomes one tag, of one surface in `MergedTags`
        for side, tags in tags_of_side.items():
            object.__setattr__(self, side, tags[0])
        lists = [tags for tags in tags_of_side.values() if len(tags) > 1]
        if lists:
            object.__setattr__(self, "facet_tags", MergedTags(self.facet_tags, lists))
        laws = "a law such as Tresca(0.1), Coulomb(0.3), Frictionless() or Bonded()"
        check_type("friction", self.friction, Friction, laws)
        check_word("pairing", self.pairing, get_args(Pairing))
        checked_number("search_distance", self.search_limit, "(0, inf]")
        check_geometry(self.geometry)
        check_word("sliding", self.sliding, get_args(Sliding))
        if isinstance(self.friction, Preload) and self.obstacle is not None:
            raise InputError(f"a preload needs two deformable sides, found {self.primary}.")
        if self.gap is not None:
            check_field(self.gap, (), "the gap")
            if isinstance(self.friction, Bonded):
                raise InputError("bonded surfaces keep their initial gap: leave out the gap.")
        check_type("name", self.name, str | None, "a string")

    @property
    def cell_tags(self) -> NamedTags | None:
        """The tags of the cells, which name the bodies; None if `facet_tags` have no names."""
        return self.facet_tags.cell_tags if isinstance(self.facet_tags, NamedTags) else None

    @property
    def obstacle(self) -> RigidObstacle | None:
        """The rigid primary side; None if the primary side is deformable."""
        return self.primary if isinstance(self.primary, RigidObstacle) else None

    @property
    def touches_itself(self) -> bool:
        """Whether the two sides are the same surface, of one body or of several."""
        return bool(self.secondary == self.primary)

    @property
    def search_limit(self) -> float:
        """The search distance [length], infinite by default."""
        return math.inf if self.search_distance is None else self.search_distance

    def given_tags(self, which: SideName) -> tuple[Any, tuple[int, ...]]:
        """Return the MeshTags that the user gave, and all tags of a side; () for an obstacle."""
        tag = getattr(self, which)
        if isinstance(tag, RigidObstacle):
            return self.facet_tags, ()
        if isinstance(self.facet_tags, MergedTags):
            return self.facet_tags.given, self.facet_tags.merged.get(tag, (tag,))
        return self.facet_tags, (tag,)

    def __repr__(self) -> str:
        return f"<ContactPair: {self}, {self.friction}>"

    def __str__(self) -> str:
        if self.name is not None:
            return self.name
        primary = "itself" if self.touches_itself else self.side("primary")
        return f"{self.side('secondary')} on {primary}"

    def side(self, which: SideName) -> str:
        """Return the name of a side: its name in the mesh file, its tag, or the obstacle's name."""
        tag = getattr(self, which)
        if isinstance(tag, RigidObstacle):
            return str(tag)
        names = self.facet_tags.names if isinstance(self.facet_tags, NamedTags) else {}
        return names.get(tag, f"tag {tag}")


def check_tags(pairs: Sequence[ContactPair], mesh: Any) -> None:
    """Check that the tags of all pairs are those of facets of the problem's mesh. Collective."""
    dim = mesh.topology.dim - 1
    with errors_on_all_ranks(mesh.comm):
        for pair in pairs:
            text = f"the facet_tags of contact pair {pair}"
            if not same_topology(pair.facet_tags, mesh):
                raise InputError(f"{text} belong to another mesh than the forms.")
            if pair.facet_tags.dim != dim:
                raise InputError(f"{text} have dimension {pair.facet_tags.dim}, facets have {dim}.")


def checked_pairs(pairs: Sequence[ContactPair]) -> list[ContactPair]:
    """Return the user's argument `pairs` as a list whose entries are checked.

    An InputError is raised if there is none, or if two share a given name or the same two surfaces.
    """
    check_type("pairs", pairs, Iterable, "a sequence", " Write [pair] for a single one.")
    result = list(pairs)
    for number, pair in enumerate(result):
        check_type(f"pairs[{number}]", pair, ContactPair, "a ContactPair")
    if not result:
        raise InputError("a contact problem needs at least one ContactPair, found none.")
    names: set[str] = set()
    earlier: set[frozenset[Any]] = set()  # the two surfaces of earlier pairs, in any order
    for pair in result:
        sides = []
        for which in SIDES:
            # a tag with its MeshTags, since other MeshTags may have the same tag on other facets
            given, tags = pair.given_tags(which)
            owner = getattr(given, "_cpp_object", given)
            sides.append([(owner, tag) for tag in tags] or [pair.primary])
        secondary, primary = sides
        surfaces = {frozenset((surface, facing)) for surface in secondary for facing in primary}
        if surfaces & earlier:
            raise InputError(
                f"two pairs are between the surfaces {pair.side('secondary')} and "
                f"{pair.side('primary')}: that would constrain their nodes twice. Give one pair."
            )
        needs_name = pair.name is not None or isinstance(pair.friction, Preload)
        if needs_name and str(pair) in names:
            raise InputError(f"two pairs have the name {pair}: give each a name of its own.")
        names.add(str(pair))
        earlier |= surfaces
    return result


class _OnPair:
    """Base class of goals of one pair: wrong attributes raise an InputError."""

    pair: int

    def __post_init__(self) -> None:
        """Check the attributes; a radius and an exponent become floats."""
        checked_integer("pair", self.pair, 0)
        for name, value in vars(self).items():
            if name in ("point", "direction"):
                checked_vector(name, value, 2, 3, nonzero=(name == "direction"))
            elif name in ("radius", "exponent"):
                interval = "(0, inf)" if name == "radius" else "[1, inf)"
                object.__setattr__(self, name, checked_number(name, value, interval))


@dataclass(frozen=True)
class NormalForce(_OnPair):
    """Integral of the contact pressure of a pair [force; in 2D force per length].

    Attributes:
        pair: number of the pair in the list of the problem, from 0 on.
    """

    pair: int = 0


@dataclass(frozen=True)
class ContactForce(_OnPair):
    """Component of the contact force on the secondary body [force; in 2D force per length].

    The force includes pressure and friction; see `ContactSolution.resultants`.

    Attributes:
        direction: (d,) direction of the component, a vector of any length but zero.
        pair: number of the pair in the list of the problem, from 0 on.
    """

    direction: npt.ArrayLike
    pair: int = 0


@dataclass(frozen=True)
class MeanPressure(_OnPair):
    """Mean contact pressure around a point [stress], with the weight (1 - r^2/R^2)^2.

    The weight is smooth because the pressure at a point, or its mean over a patch with a sharp
    edge, has no adjoint of finite energy, and no error estimate would converge. For the peak of a
    bounded pressure choose a small patch. At the edge of a rigid or stiffer body the pressure is
    unbounded: the mean depends on the radius, however fine the mesh.

    Attributes:
        point: (d,) centre of the patch [length], on the secondary side or near it.
        radius: radius R of the patch [length].
        pair: number of the pair in the list of the problem, from 0 on.
    """

    point: npt.ArrayLike
    radius: float
    pair: int = 0


@dataclass(frozen=True)
class MeanSlip(_OnPair):
    """Mean component of the slip along a direction, around a point [length].

    The mean has the weight of `MeanPressure`. The slip is the displacement of the secondary side
    minus the displacement of the primary side, as in `ContactSolution.slip`.

    Attributes:
        point: (d,) centre of the patch [length], on the secondary side or near it.
        radius: radius of the patch [length].
        direction: (d,) direction of the component, a vector of any length but zero.
        pair: number of the pair in the list of the problem, from 0 on.
    """

    point: npt.ArrayLike
    radius: float
    direction: npt.ArrayLike
    pair: int = 0


@dataclass(frozen=True)
class PressureNorm(_OnPair):
    """Norm of the contact pressure in L^m, (integral of p^m)^(1/m) [stress area^(1/m)].

    The norm is a smooth measure of the peak: the larger m is, the more the largest pressures count.
    For a given force the norm is smallest if the pressure is uniform.

    Attributes:
        exponent: m, finite and at least 1; the norm for m = 1 is the normal force.
        pair: number of the pair in the list of the problem, from 0 on.
    """

    exponent: float
    pair: int = 0


Goal: TypeAlias = NormalForce | ContactForce | MeanPressure | MeanSlip | PressureNorm


def checked_goal(goal: Goal, pairs: int, dim: int) -> Goal:
    """Return the user's argument `goal`, checked for the number of `pairs` and the dimension."""
    kinds = "a NormalForce, ContactForce, MeanPressure, MeanSlip or PressureNorm"
    check_type("goal", goal, Goal, kinds)
    if goal.pair >= pairs:
        raise InputError(
            f"goal belongs to pair {goal.pair}, but the problem has {pairs}, numbered from 0."
        )
    for name in ("point", "direction"):
        if hasattr(goal, name):
            checked_vector(f"{name} of the goal", getattr(goal, name), dim)
    return goal
