"""Two equal bodies with parabolic faces, pressed together and then drawn aside.

C. Cattaneo 1938, R. D. Mindlin 1949; K. L. Johnson, Contact Mechanics, sections 7.2 and 7.3. Equal
bodies do not slip while they are pressed, and shear does not change the pressure: so the pressure
is that of Hertz, and the bodies may be pressed and drawn aside at once or one after the other. In
3D tractions are exactly parallel only for a Poisson's ratio of zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed, no_load
from scenes.scene import Scene

YOUNG, COEFFICIENT = 1000.0, 0.4  # MPa, -
POISSON = {2: 0.3, 3: 0.0}  # by dimension
RADIUS = 1000.0  # mm, of each face: slopes are small enough for the theory of half-spaces
WIDTH = 1.0  # mm, half of each body; and its height

#: Grading by dimension: widths of cells are proportional to cosh(grading x), x from -1 to 1.
GRADING = {2: 5.5, 3: 3.5}

#: Shift of one of the bodies in 3D by a unit force, less the shift of a half-space [mm/N]: sides of
#: the body are free, its end is held. With it the shift of both bodies converges to theory.
FAR = 0.106 / (YOUNG * WIDTH)

UPPER, LOWER, TOP, BOTTOM, FRONT = 1, 2, 3, 4, 5


def cell_size(dim: int, n: int, r: float) -> float:
    """Return the width of cells along x [mm] at a distance r [mm] from the middle."""
    end = float(np.sinh(GRADING[dim]))
    return 2.0 / n * GRADING[dim] * WIDTH / end * float(np.hypot(1.0, r / WIDTH * end))


def cattaneo(comm: MPI.Comm, dim: int, n: int, degree: int = 1, *, approach: float) -> Scene:
    """Return the scene of the two bodies. Collective.

    Args:
        comm: communicator of the mesh.
        dim: 2: plane strain; 3: the half of the bodies with y > 0.
        n: cells along x; each body has half as many along its height.
        degree: degree of the displacement.
        approach: how much the ends of the bodies approach each other [mm].

    Returns:
        The scene; `data.end` is the displacement [mm] of the upper end.
    """

    def moved(side: float) -> Any:
        def move(x: np.ndarray) -> np.ndarray:
            y = WIDTH * np.sinh(GRADING[dim] * x) / np.sinh(GRADING[dim])
            face = (y[:, :-1] ** 2).sum(axis=1) / (2.0 * RADIUS)
            y[:, -1] += side * face * (1.0 - np.abs(x[:, -1]))
            return y

        return move

    across = [(-1.0, 1.0), (0.0, 1.0)][: dim - 1]
    bodies = [
        Body((n, n // 2), [*across, ends], move=moved(side))
        for ends, side in (((0.0, 1.0), 1.0), ((-1.0, 0.0), -1.0))
    ]
    made = boxes(comm, "quadrilateral" if dim == 2 else "hexahedron", bodies, degree)

    def at(axis: int, place: float) -> Any:
        return lambda x: np.abs(x[:, axis] - place) < 1e-9

    marks: list[Any] = [
        (UPPER, [0], at(-1, 0.0)),
        (LOWER, [1], at(-1, 0.0)),
        (TOP, [0], at(-1, 1.0)),
        (BOTTOM, [1], at(-1, -1.0)),
    ]
    if dim == 3:
        marks.append((FRONT, [0, 1], at(1, 0.0)))
    tags, V = made.tags(*marks), made.V
    end = fem.Constant(made.mesh, np.zeros(dim))
    end.value[-1] = -approach
    bcs = [fixed(V, tags.find(TOP), end), fixed(V, tags.find(BOTTOM))]
    if dim == 3:
        bcs.append(fixed(V, tags.find(FRONT), 0.0, 1))
    pair = ContactPair(tags, UPPER, LOWER, Coulomb(COEFFICIENT))
    data = SimpleNamespace(end=end, poisson=POISSON[dim])
    return Scene(V, elasticity(V, YOUNG, POISSON[dim]), no_load(V), bcs, [pair], tags, data=data)


@dataclass(frozen=True)
class Cattaneo:
    """The theory for given forces on the whole contact.

    Attributes:
        dim: 2 or 3.
        normal: normal force P [N], in 2D [N/mm].
        tangential: present tangential force Q, in the same unit.
        peak_tangential: largest tangential force, if it was then reduced to Q; None: Q.
    """

    dim: int
    normal: float
    tangential: float
    peak_tangential: float | None = None

    @property
    def radius(self) -> float:
        """Radius a of the contact, in 2D its half width [mm]."""
        modulus = 0.5 * YOUNG / (1.0 - POISSON[self.dim] ** 2)
        if self.dim == 2:
            return float(np.sqrt(4.0 * self.normal * 0.5 * RADIUS / (np.pi * modulus)))
        return float((0.75 * self.normal * 0.5 * RADIUS / modulus) ** (1 / 3))

    @property
    def peak(self) -> float:
        """Largest pressure [MPa]."""
        if self.dim == 2:
            return 2.0 * self.normal / (np.pi * self.radius)
        return 1.5 * self.normal / (np.pi * self.radius**2)

    def stick_radius(self, tangential: float) -> float:
        """Return the radius (in 2D half width) [mm] of the stick zone for a tangential force."""
        part = 1.0 - abs(tangential) / (COEFFICIENT * self.normal)
        return float(self.radius * max(part, 0.0) ** (1.0 / self.dim))

    def pressure(self, r: np.ndarray) -> np.ndarray:
        """Return the pressure [MPa] at distances r [mm] from the middle."""
        return self.peak * _dome(r, self.radius)

    def traction(self, r: np.ndarray) -> np.ndarray:
        """Return the traction [MPa] along the tangential force."""
        first = self.tangential if self.peak_tangential is None else self.peak_tangential
        result = self._sheared(r, first)
        if self.peak_tangential is not None:  # Mindlin and Deresiewicz 1953: back by twice as much
            result = result - 2.0 * self._sheared(r, 0.5 * (first - self.tangential))
        return result

    def _sheared(self, r: np.ndarray, tangential: float) -> np.ndarray:
        c = self.stick_radius(tangential)
        inner = c / self.radius * _dome(r, c) if c > 0.0 else 0.0
        return COEFFICIENT * self.peak * (_dome(r, self.radius) - inner)

    def shift(self, *, finite: bool = False) -> float:
        """Return the displacement of the bodies relative to each other [mm], in 3D only.

        If `finite`, the bodies are those of the scene in place of half-spaces: far from the contact
        they deform as if the whole force acted at one point.
        """
        nu = POISSON[3]
        shear = YOUNG / (2.0 * (1.0 + nu))
        part = 1.0 - (1.0 - self.tangential / (COEFFICIENT * self.normal)) ** (2 / 3)
        each = 3.0 * COEFFICIENT * self.normal * (2.0 - nu) / (16.0 * self.radius * shear) * part
        return 2.0 * (each + FAR * self.tangential * finite)


def _dome(r: np.ndarray, radius: float) -> np.ndarray:
    result: np.ndarray = np.sqrt(np.maximum(1.0 - (r / radius) ** 2, 0.0))
    return result
