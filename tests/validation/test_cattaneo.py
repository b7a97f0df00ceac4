"""Bodies pressed together and drawn aside: Cattaneo and Mindlin, there, back, and in one step."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import ContactSolution, ContactStatus
from scenes.cattaneo import COEFFICIENT, Cattaneo, cattaneo, cell_size

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: Approach [mm], which makes the contact some 12 cells wide on the coarsest mesh; shift over it.
APPROACH, SHIFT, BACK = {2: 2e-4, 3: 4e-4}, 0.3, -0.06

#: Errors over h/a, with the cells at the edge of the contact: of pressure and traction in the mean
#: square, over those of the pressure and of what it can bear; of radii; and of the shift. How much
#: they fall from mesh to mesh depends on where edges lie between nodes, so these are tested instead
#: of rates.
PRESSURE, TRACTION, RADIUS, COMPLIANCE = 0.5, 0.5, 1.2, 0.2


@dataclass
class Found:
    """Nodes' distances from the middle, areas, pressures, tractions along x, and states."""

    r: np.ndarray
    areas: np.ndarray
    pressure: np.ndarray
    traction: np.ndarray
    touching: np.ndarray
    sticking: np.ndarray
    dim: int

    @classmethod
    def of(cls, solution: ContactSolution, dim: int) -> Found:
        """Read them off a solution."""
        assert solution.status is ContactStatus.CONVERGED
        surface = solution.surface
        return cls(
            np.linalg.norm(surface.points[:, : dim - 1], axis=1),
            (1 if dim == 2 else 2) * surface.weights,  # of the other half, too
            surface.pressure.x.array,
            surface.traction.x.array.reshape(-1, dim)[:, 0],
            surface.touching,
            surface.sticking & surface.touching,
            dim,
        )

    def force(self, stress: np.ndarray) -> float:
        """Return the resultant."""
        return float(self.areas @ stress)

    def difference(self, one: np.ndarray, other: np.ndarray) -> float:
        """Return the root mean square of the difference, over that of the pressure."""
        return float(np.sqrt(self.areas @ (one - other) ** 2 / (self.areas @ self.pressure**2)))

    def radius(self, nodes: np.ndarray) -> float:
        """Return that of the strip or disc which is as large as the area of nodes."""
        area = float(self.areas[nodes].sum())
        return 0.5 * area if self.dim == 2 else float(np.sqrt(area / np.pi))


def check(found: Found, theory: Cattaneo, sign: float, sheared: float, n: int) -> None:
    """Compare a solution with the theory of its forces."""
    cell = cell_size(found.dim, n, theory.radius) / theory.radius
    assert found.difference(found.pressure, theory.pressure(found.r)) <= PRESSURE * cell
    wanted = sign * theory.traction(found.r)
    assert found.difference(found.traction, wanted) <= TRACTION * COEFFICIENT * cell
    assert found.radius(found.touching) == pytest.approx(theory.radius, rel=RADIUS * cell)
    sticking = theory.stick_radius(sheared)
    assert found.radius(found.sticking) == pytest.approx(sticking, rel=RADIUS * cell)


@pytest.mark.parametrize(("dim", "n"), [(2, 24), (2, 48), (3, 12)])
def test_there_and_back(dim, n):
    """Pressed, drawn aside, and part of the way back, in load steps; and the first two at once."""
    scene = cattaneo(MPI.COMM_SELF, dim, n, approach=APPROACH[dim])
    with scene.problem(stiffness="cholesky") as problem:
        pressed = Found.of(problem.solve(rtol=1e-6), dim)
        problem.accept()
        assert np.abs(pressed.traction).max() <= 0.02 * COEFFICIENT * pressed.pressure.max()
        scene.data.end.value[0] = SHIFT * APPROACH[dim]
        drawn = Found.of(problem.solve(rtol=1e-6), dim)
        problem.accept()
        scene.data.end.value[0] = BACK * APPROACH[dim]
        back = Found.of(problem.solve(rtol=1e-6), dim)
    normal, tangential = drawn.force(drawn.pressure), drawn.force(drawn.traction)
    sign = np.sign(tangential)
    theory = Cattaneo(dim, normal, abs(tangential))
    assert 0.3 < abs(tangential) / (COEFFICIENT * normal) < 0.9
    check(drawn, theory, sign, theory.tangential, n)
    if dim == 3:
        cell = cell_size(dim, n, theory.radius) / theory.radius
        assert theory.shift() == pytest.approx(SHIFT * APPROACH[dim], rel=COMPLIANCE * cell)

    rest = sign * back.force(back.traction)
    reversed_ = Cattaneo(dim, back.force(back.pressure), rest, theory.tangential)
    check(back, reversed_, sign, 0.5 * (theory.tangential - rest), n)

    scene.data.end.value[0] = SHIFT * APPROACH[dim]
    with scene.problem(stiffness="cholesky") as problem:
        once = Found.of(problem.solve(rtol=1e-6), dim)
    # equal bodies do not slip while they are pressed: the path makes no difference
    assert once.difference(once.traction, drawn.traction) <= 1e-2 * COEFFICIENT
