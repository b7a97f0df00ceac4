"""A contact surface for pictures: gathered on one rank."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from textwrap import shorten
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.output.grid import Grid, gather_grid
from dolfinx_tresca.output.pictures.canvas import handle
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.solution.fields import STICKING, ContactState, SurfaceFields

#: Characters of the name of a pair in a title.
NAME_WIDTH = 40


@dataclass(frozen=True)
class Contact:
    """A contact surface and its nodes.

    Attributes:
        grid: the fields of the surface, in degree 1. Its "slip" is the slip of this step, and zero
            at sticking nodes. Only pairs with finite sliding have a "slip_path".
        touching: (n,) whether a node of the grid is pressed or bonded.
        sticking: (n,) whether a node of the grid sticks, pressed or open, or is bonded.
        nodes: (k,) nodes of the grid that carry multipliers.
        normals: (k, 3) outward unit normals at `nodes`.
        initial_gap: (k,) distances at `nodes` before the bodies moved [length].
        obstacle: the other side, if it is rigid; else None.
        label: number of the pair, to be written beside its curve; "" for a single pair.
        name: name of the pair for titles; "" for a single pair.
        slip_of: name of the slip in titles and labels: "slip", or "slip of step" after an accepted
            load step.
    """

    grid: Grid
    touching: Mask
    sticking: Mask
    nodes: npt.NDArray[np.int64]
    normals: Array
    initial_gap: Array
    obstacle: RigidObstacle | None
    label: str = ""
    name: str = ""
    slip_of: str = "slip"

    @property
    def has_friction(self) -> bool:
        """Whether there are tractions and slip."""
        return "slip" in self.grid.values

    @property
    def has_path(self) -> bool:
        """Whether the path of the slip over all steps is shown."""
        return "slip_path" in self.grid.values

    def title(self, what: str) -> str:
        """Return a title of a drawing of the surface, with the name of the pair."""
        name = f" {self.label}: {shorten(self.name, NAME_WIDTH, placeholder=' ...')}"
        return what + (name if self.label else "")

    @cached_property
    def pressed(self) -> Mask:
        """(n,) whether a node is drawn as touching; the other nodes are open.

        A node that carries no multiplier, such as the tip of a crack or a prescribed node, touches
        if all nodes beside it touch, provided that each of its facets has a node that carries one.
        Nodes farther beyond the primary side are open.
        """
        facets: npt.NDArray[np.int64] = self.grid.cells[:, 1:]
        count = len(self.grid.points)
        carries: Mask = np.isin(np.arange(count), self.nodes)
        beside = np.ones(count, dtype=bool)
        opens = np.any(carries[facets] & ~self.touching[facets], axis=1)
        closes = np.any(carries[facets], axis=1) & ~opens
        beside[facets[~closes]] = False
        mask: Mask = np.where(carries, self.touching, beside)
        return mask

    @property
    def marks(self) -> list[tuple[bool, npt.NDArray[np.int64]]]:
        """The sticking nodes to mark: (True, pressed nodes) and (False, open nodes)."""
        kinds = [(touches, self.sticking & (self.touching == touches)) for touches in (True, False)]
        return [(touches, np.flatnonzero(kind)) for touches, kind in kinds if kind.any()]

    def legend_of_marks(self) -> list[Any]:
        """Return handles of matplotlib for a legend."""
        if not self.has_friction:
            return []
        whole = bool((self.touching & self.sticking)[self.nodes].all())
        sticks = "all nodes stick" if whole else "sticks"
        return [
            handle(sticks, "black", "o")
            if touches
            else handle("open, sticks", "black", "o", markerfacecolor="white")
            for touches, _ in self.marks
        ]


def gather_contact(surface: SurfaceFields, label: str = "") -> Contact | None:
    """Return a whole surface on the first rank, None on other ranks. Collective."""
    grid = gather_grid((*surface.functions, surface.initial_gap))
    if grid is None:
        return None
    state, gap = grid.values["state"], grid.values.pop("initial_gap")
    nodes = np.flatnonzero(state > ContactState.OUTSIDE)
    contact = Contact(
        grid=grid,
        touching=state >= ContactState.PRESSED,
        sticking=np.isin(state, STICKING),
        label=label,
        name=surface.name if label else "",
        slip_of="slip of step" if "slip_increment" in grid.values else "slip",
        nodes=nodes,
        normals=grid.values["normal"][nodes],
        initial_gap=gap[nodes],
        obstacle=surface.obstacle,
    )
    if contact.has_friction:
        slip = grid.values.pop("slip_increment", grid.values["slip"])
        slip[contact.sticking] = 0.0  # the error of the iteration is removed
        grid.values["slip"] = slip
        if not surface.slides_far:
            grid.values.pop("slip_path", None)
    return contact
