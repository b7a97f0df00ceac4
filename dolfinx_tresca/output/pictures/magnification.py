"""The magnification of displacements at which bodies in contact touch in the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.contact import Contact

VISIBLE = 0.1  #: largest displacement in the picture, divided by the length of the model
INVISIBLE = 0.004  #: distance that is hardly visible, divided by the length of the model


@dataclass(frozen=True)
class Magnification:
    """Positions of nodes in the picture: x + shift undeformed, x + shift + scale u deformed.

    Where two surfaces touch, the jump [u].n of the displacement is their initial gap d. Drawn at
    x + scale u they would overlap by (scale - 1) d, or be apart if d is negative. So

    * an initial overlap (a press fit) is magnified as much as the displacement: the primary body is
      drawn larger. Its surface is shifted by (scale - 1) d n, and its inside by the polynomial of
      degree 2 at most that is nearest to these shifts;
    * the rest of the jump limits the scale, unless the user chooses the scale: neither a gap
      between pressed surfaces nor any overlap may be visible (`INVISIBLE`). A displacement that
      would be invisible with this limit is drawn without magnification. Rigid obstacles are not
      shifted, so only this second rule applies to them.

    Attributes:
        scale: magnification of the displacement, 1 or more unless the user wants less.
        shift: (n, 3) shifts of the nodes [length].
    """

    scale: float
    shift: Array

    @property
    def title(self) -> str:
        """Title of the picture."""
        times = "" if self.scale == 1.0 else f", magnified {self.scale:,.12g} times"
        return f"Displacement{times}"


def magnify(volume: Grid, contacts: Sequence[Contact], scale: float | None) -> Magnification:
    """Choose the scale of the displacement unless the user does, and find the shifts.

    Args:
        volume: the mesh with the displacement.
        contacts: the contact surfaces of all pairs.
        scale: magnification that the user wants; None chooses one.
    """
    length = float(np.linalg.norm(np.ptp(volume.points, axis=0)))
    largest = float(np.linalg.norm(next(iter(volume.values.values())), axis=1).max(initial=0.0))
    wanted = visible_scale(length, largest) if scale is None else float(scale)
    overlap_shifts = _OverlapShifts(volume, contacts)
    invisible = INVISIBLE * length
    allowed = 1.0 + overlap_shifts.allowed(invisible)
    if scale is None and wanted > allowed:
        wanted = _round_down(allowed)
        if wanted * largest < 2.0 * invisible:
            wanted = 1.0
    return Magnification(wanted, max(wanted - 1.0, 0.0) * overlap_shifts.shift)


def visible_scale(length: float, largest: float) -> float:
    """Return a round number, at least 1, that makes the largest displacement visible."""
    if largest <= np.finfo(float).tiny * length:  # nothing moves
        return 1.0
    return max(1.0, _round_down(VISIBLE * length / largest))


def _round_down(value: float) -> float:
    """Return 1, 2, 3 or 5 times a power of ten, not more than a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(
        digit * power for digit in (1.0, 2.0, 3.0, 5.0) if digit * power <= value * (1.0 + 1e-9)
    )


class _OverlapShifts:
    """Shifts of primary bodies that remove an initial overlap from the picture, for a scale of 2.

    Attributes:
        shift: (n, 3) shifts of the nodes of the volume [length].
    """

    def __init__(self, volume: Grid, contacts: Sequence[Contact]) -> None:
        self.shift = np.zeros_like(volume.points)
        body = _bodies(volume)
        tree = cKDTree(volume.points)
        self._fields: dict[int, _Polynomial] = {}
        self._sides: list[tuple[Contact, int, int | None]] = []
        for contact in contacts:
            points = contact.grid.points[contact.nodes]
            if not len(points):
                continue
            own = int(np.bincount(body[tree.query(points)[1]]).argmax())
            other = None if contact.obstacle is not None else _primary(volume, body, own, contact)
            self._sides.append((contact, own, other))
            pressed = contact.touching[contact.nodes]
            gap, normals = contact.initial_gap[pressed], contact.normals[pressed]
            if other is not None and other not in self._fields and gap.sum() < 0.0:
                field = _Polynomial(points[pressed], gap[:, None] * normals)
                self._fields[other] = field
                self.shift[body == other] = field.at(volume.points[body == other])

    def allowed(self, invisible: float) -> float:
        """Return the largest scale, minus 1, at which no gap in contact and no overlap is visible.

        The distance of two surfaces is drawn as gap - (scale - 1) closed, where `closed` is the
        reduction of the gap by the displacement, less the part that the shifts account for. With a
        tolerance of `invisible` [length], the drawn distance must not be negative, and must be zero
        at pressed nodes.
        """
        allowed = math.inf
        for contact, own, other in self._sides:
            points, normals = contact.grid.points[contact.nodes], contact.normals
            jump = np.zeros_like(points)
            for sign, side in ((1.0, other), (-1.0, own)):
                if side in self._fields:
                    jump += sign * self._fields[side].at(points)
            pressed = contact.touching[contact.nodes]
            gap = np.where(pressed, 0.0, contact.grid.values["gap"][contact.nodes])
            closed = contact.initial_gap - gap - np.einsum("ni,ni->n", jump, normals)
            closed[pressed] = np.abs(closed[pressed])
            limits = closed > 0.0
            room = np.maximum(gap[limits], 0.0) + invisible
            allowed = min(allowed, float((room / closed[limits]).min(initial=math.inf)))
        return allowed


def _bodies(volume: Grid) -> npt.NDArray[np.int32]:
    """Return the number of each node's body, a connected part of the mesh."""
    nodes = volume.cells[:, 1:]
    first = np.repeat(nodes[:, :1], nodes.shape[1], axis=1)
    count = len(volume.points)
    graph = coo_array((np.ones(nodes.size), (first.ravel(), nodes.ravel())), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def _primary(volume: Grid, body: npt.NDArray[np.int32], own: int, contact: Contact) -> int | None:
    """Return the number of the other body that a surface of body `own` is nearest to, or None.

    The result is None if there is no other body.
    """
    others = np.flatnonzero(body != own)
    if not len(others):
        return None
    met = contact.grid.points[contact.nodes] + contact.initial_gap[:, None] * contact.normals
    nearest = others[cKDTree(volume.points[others]).query(met)[1]]
    return int(np.bincount(body[nearest]).argmax())


class _Polynomial:
    """A vector field of degree 2 that is fitted to values at points.

    Terms of degree 2 are fitted to the residual of a linear fit, so that linear fields stay linear.
    """

    def __init__(self, points: Array, values: Array) -> None:
        self._centre, self._size = points.mean(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
        self._parts = []
        for degree in (1, 2):
            terms = self._terms(points, degree)
            part = np.linalg.lstsq(terms, values, rcond=1e-3)[0]
            values = values - terms @ part
            self._parts.append(part)

    def at(self, points: Array) -> Array:
        """Return the values (n, 3) of the polynomial at n points."""
        return np.asarray(
            sum(self._terms(points, degree) @ part for degree, part in enumerate(self._parts, 1))
        )

    def _terms(self, points: Array, degree: int) -> Array:
        x = (points - self._centre) / self._size
        terms = [np.ones(len(x)), *x.T]
        if degree == 2:
            terms += [x[:, i] * x[:, j] for i in range(3) for j in range(i, 3)]
        return np.stack(terms, axis=1)
