"""A contact surface as pictures want it: gathered on one rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca.fields import ContactState, SurfaceFields
from dolfinx_tresca.grid import ROOT, Grid, gather_grid


@dataclass(frozen=True)
class Contact:
    """A contact surface and its nodes.

    Attributes:
        grid: the fields, of degree 1; slip is exactly zero where a node sticks.
        touching: (n,) pressed nodes of the grid.
        sticking: (n,) nodes of the grid with a tangential traction below the slip bound.
        number: says in titles which of several it is, else "".
    """

    grid: Grid
    touching: Mask
    sticking: Mask
    number: str

    @property
    def has_friction(self) -> bool:
        """Whether there are tractions and slip."""
        return "slip" in self.grid.values

    @property
    def pressed(self) -> Mask:
        """Nodes of the grid that are in contact; others are open or carry no multiplier."""
        mask: Mask = self.grid.values["state"] >= ContactState.STICK
        return mask

    def marks(self) -> list[tuple[bool, npt.NDArray[np.int64], str]]:
        """Return what to mark: whether pressed nodes (else open ones), which, and the legend."""
        if not self.has_friction:
            return []
        carries = self.grid.values["state"] > ContactState.OUTSIDE
        if (self.touching & self.sticking)[carries].all():
            return [(True, np.empty(0, dtype=np.int64), "all nodes stick")]
        kinds = ((True, "discs: nodes that stick"), (False, "rings: open nodes that stick"))
        marks = [
            (pressed, np.flatnonzero(self.sticking & (self.touching == pressed)), meaning)
            for pressed, meaning in kinds
        ]
        return [mark for mark in marks if len(mark[1])]


def gather_contact(surface: SurfaceFields, number: str = "") -> Contact | None:
    """Return a surface on the first rank, None on others. Collective."""
    grid = gather_grid(surface.functions)
    parts = surface.mesh.comm.gather(
        (surface.points, surface.touching, surface.sticking), root=ROOT
    )
    if grid is None:
        return None
    points, *states = (np.concatenate(column) for column in zip(*parts, strict=True))
    node = cKDTree(grid.points).query(points)[1]
    masks: list[Mask] = []
    for state in states:
        masks.append(np.zeros(len(grid.points), dtype=bool))
        masks[-1][node] = state
    contact = Contact(grid, masks[0], masks[1], number)
    if contact.has_friction:
        grid.values["slip"][contact.sticking] = 0.0  # what the iteration has left there is noise
    return contact
