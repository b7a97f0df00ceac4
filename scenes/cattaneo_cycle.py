"""Two bodies pressed together and rubbed to and fro, compared with theory in every step.

R. D. Mindlin and H. Deresiewicz 1953. By Masing's rule a whole cycle follows from the shift s(Q)
under a force that grows: it dissipates 4 Q s(Q) - 8 times the integral of s from 0 to Q. A linear
part of s adds nothing to this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.integrate import quad

from dolfinx_tresca import ContactProblem, ContactSolution
from scenes.cattaneo import COEFFICIENT, POISSON, YOUNG, Cattaneo, cattaneo, cell_size

#: Approach [mm], which makes the contact some 12 cells wide on the coarsest mesh.
APPROACH = {2: 1.25e-6, 3: 1e-5}

#: Amplitude of the shift, divided by the approach.
AMPLITUDE = {2: 0.5, 3: 0.3}


@dataclass
class Found:
    """Nodal values of a solution on one rank.

    Attributes:
        r: (n,) distances of nodes from the middle [mm].
        areas: (n,) areas of nodes [mm^2, in 2D mm]; in 3D doubled for the half that is not meshed.
        pressure: (n,) pressures [MPa].
        traction: (n,) tractions along x [MPa].
        touching: (n,) whether nodes are pressed.
        sticking: (n,) whether nodes are pressed and stick.
        dim: 2 or 3.
    """

    r: np.ndarray
    areas: np.ndarray
    pressure: np.ndarray
    traction: np.ndarray
    touching: np.ndarray
    sticking: np.ndarray
    dim: int

    @classmethod
    def of(cls, solution: ContactSolution, dim: int) -> Found:
        """Return the values of a solution, which must have converged."""
        solution.raise_if_failed()
        surface = solution.surface
        assert surface.traction is not None
        return cls(
            np.linalg.norm(surface.points[:, : dim - 1], axis=1),
            (1 if dim == 2 else 2) * surface.weights,
            surface.pressure.x.array,
            surface.traction.x.array.reshape(-1, dim)[:, 0],
            surface.touching,
            surface.sticking & surface.touching,
            dim,
        )

    def force(self, stress: np.ndarray) -> float:
        """Return the resultant of a nodal stress."""
        return float(self.areas @ stress)

    def difference(self, one: np.ndarray, other: np.ndarray) -> float:
        """Return the L2 norm of a difference of stresses, divided by that of the pressure."""
        return float(np.sqrt(self.areas @ (one - other) ** 2 / (self.areas @ self.pressure**2)))

    def radius(self, nodes: np.ndarray) -> float:
        """Return the radius of the disc (in 2D half width) with the area of the given nodes."""
        area = float(self.areas[nodes].sum())
        return 0.5 * area if self.dim == 2 else float(np.sqrt(area / np.pi))

    def dome_radius(self, stress: np.ndarray) -> float:
        """Return the radius of the dome sqrt(1 - r^2/radius^2) that has the moment of a stress.

        Unlike `radius` it does not jump when an edge passes a node. The pressure is such a dome.
        F times the pressure minus the traction is another dome, as wide as the stick zone.
        """
        mean_square = float(self.areas @ (stress * self.r**2) / (self.areas @ stress))
        return float(np.sqrt(mean_square * (4.0 if self.dim == 2 else 2.5)))


def cycle_work(theory: Cattaneo) -> float:
    """Return the energy [N mm, in 2D N] dissipated by a cycle of amplitude `theory.tangential`."""
    bearable = COEFFICIENT * theory.normal
    end = theory.tangential / bearable
    if theory.dim == 2:
        modulus = 0.5 * YOUNG / (1.0 - POISSON[2] ** 2)
        scale = bearable / (np.pi * modulus)

        def shift(q: float) -> float:
            return float((1.0 - q) * np.log(1.0 - q) + q)
    else:
        scale = Cattaneo(3, theory.normal, bearable).shift()

        def shift(q: float) -> float:
            return float(1.0 - (1.0 - q) ** (2 / 3))

    return float(scale * bearable * (4.0 * end * shift(end) - 8.0 * quad(shift, 0.0, end)[0]))


def cycle_errors(
    comm: MPI.Comm, dim: int, n: int, rtol: float, loads: Sequence[float] = (1.0,)
) -> dict[str, float]:
    """Press two bodies, rub them once to and fro, and return relative errors and the cell size.

    An error depends on where the edges of contact and stick zone lie between nodes. So the errors
    are root mean squares over several loads.

    Args:
        comm: communicator of one rank.
        dim: 2 or 3.
        n: cells, see `cattaneo`.
        rtol: requested residual.
        loads: approaches, divided by `APPROACH`.

    Returns:
        `cell` is the size of cells at the edge of the contact, and `slipping` the width of the slip
        zone at the end of the first stroke, both divided by the radius of the contact. Errors at
        this end: `pressure` and `traction` (L2 norms, divided by those of the pressure and of F
        times the pressure), `contact` and `stick` (the radii), in 3D `shift`, and `half_space`, the
        error of the shift if bodies were half-spaces. `dissipation` is the error of the energy of a
        cycle. `masing` is the deviation of tractions from Masing's rule half-way back, and `open`
        their change over a whole cycle; both are measured like `traction`.
    """
    scene = cattaneo(comm, dim, n, approach=APPROACH[dim])
    with scene.problem(stiffness="cholesky") as problem:
        found = [_cycle(problem, scene.data.end, dim, n, rtol, load) for load in loads]
    return {
        name: float(np.sqrt(np.mean([errors[name] ** 2 for errors in found]))) for name in found[0]
    }


def _cycle(
    problem: ContactProblem, end: Any, dim: int, n: int, rtol: float, load: float
) -> dict[str, float]:
    """Return the errors under one load, which is an approach divided by `APPROACH`."""
    approach = load * APPROACH[dim]
    amplitude = AMPLITUDE[dim] * approach

    def to(shift: float) -> ContactSolution:
        end.value[0], end.value[-1] = shift, -approach
        solution = problem.solve(rtol=rtol)
        problem.accept()
        return solution

    problem.set_slip_origin(None)
    to(0.0)
    half, there, middle, other, back = (to(part * amplitude) for part in (0.5, 1.0, 0.0, -1.0, 1.0))
    first, whole, returning, last = (Found.of(one, dim) for one in (half, there, middle, back))
    P, Q = whole.force(whole.pressure), whole.force(whole.traction)
    sign, theory = np.sign(Q), Cattaneo(dim, P, abs(Q))
    short = COEFFICIENT * whole.pressure - sign * whole.traction
    halves = dim - 1  # y = 0 is a plane of symmetry
    work = halves * (middle.dissipation + other.dissipation + back.dissipation)
    a, c = theory.radius, theory.stick_radius(Q)
    errors = {
        "cell": cell_size(dim, n, a) / a,
        "slipping": 1.0 - c / a,
        "pressure": whole.difference(whole.pressure, theory.pressure(whole.r)),
        "traction": whole.difference(whole.traction, sign * theory.traction(whole.r)) / COEFFICIENT,
        "contact": whole.dome_radius(whole.pressure) / a - 1.0,
        "stick": whole.dome_radius(short) / c - 1.0,
        "dissipation": work / cycle_work(theory) - 1.0,
        "masing": whole.difference(returning.traction, whole.traction - 2.0 * first.traction)
        / COEFFICIENT,
        "open": whole.difference(last.traction, whole.traction) / COEFFICIENT,
    }
    if dim == 3:
        errors["shift"] = theory.shift(finite=True) / amplitude - 1.0
        errors["half_space"] = theory.shift() / amplitude - 1.0
    return errors
