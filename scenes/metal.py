"""Metal at large strains: von Mises' yield condition for logarithmic strains.

In plane strain, or in bodies of revolution.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import basix
import basix.ufl
import ufl
from dolfinx import fem

from scenes.elasticity import lame_constants

#: Added to squares whose root has no derivative at zero.
TINY = 1e-10


class Metal:
    """The energy of a load step of an elastoplastic material, and its history.

    The elastic strain is e = ln(b) / 2 with b = F Cp^-1 F'. Minimised over the plastic flow of the
    step, the incremental energy is K/2 (tr e)^2 + mu |dev e|^2 - y^2 / (2 (3 mu + H)), where e is
    the strain without flow, and y the positive part of its equivalent stress minus the yield stress
    (Cuitino and Ortiz 1992, Eng. Comput. 9). The hardening H is the slope of the yield stress at
    the start of the step.

    Attributes:
        energy: the energy of a step, a form.
    """

    def __init__(
        self,
        u: fem.Function,
        young: float,
        poisson: float,
        hardening: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
        degree: int = 4,
        axisymmetric: bool = False,
    ) -> None:
        """Define the energy of undeformed metal. Collective.

        Args:
            u: displacement.
            young: Young's modulus.
            poisson: Poisson's ratio.
            hardening: function from equivalent plastic strains to yield stresses and their slopes.
            degree: degree of the quadrature.
            axisymmetric: whether the mesh is the meridian of a body of revolution.
        """
        domain, (mu, lam) = u.function_space.mesh, lame_constants(young, poisson)
        cell = domain.basix_cell()
        points, _ = basix.make_quadrature(cell, degree)

        def at_points(*shape: int) -> fem.Function:
            element = basix.ufl.quadrature_element(cell, value_shape=shape, degree=degree)
            return fem.Function(fem.functionspace(domain, element))

        self._inverse, self._across, self._strain = at_points(2, 2), at_points(), at_points()
        self._limit, self._slope, self._hardening = at_points(), at_points(), hardening
        self._inverse.x.array[:] = np.tile(np.eye(2).ravel(), len(self._across.x.array))
        self._across.x.array[:] = 1.0
        F = ufl.Identity(2) + ufl.grad(u)
        b = F * self._inverse * F.T
        mean, half = ufl.tr(b) / 2, (b[0, 0] - b[1, 1]) / 2
        difference = ufl.sqrt(half**2 + b[0, 1] ** 2 + TINY)
        # logarithmic strains: their mean in the plane, half their difference, and across the plane
        in_plane = ufl.ln(ufl.det(b)) / 4
        turned = ufl.ln((mean + difference) / (mean - difference)) / 4
        r = ufl.SpatialCoordinate(domain)[0]
        ring = 1 + u[0] / r if axisymmetric else 1
        across = ufl.ln(self._across * ring**2) / 2
        volume = 2 * in_plane + across
        deviator = in_plane - volume / 3, across - volume / 3
        square = 2 * deviator[0] ** 2 + 2 * turned**2 + deviator[1] ** 2
        stress = 2 * mu * ufl.sqrt(1.5 * square + TINY)
        beyond = stress - self._limit
        flow = ufl.conditional(ufl.gt(beyond, 0), beyond / (3 * mu + self._slope), 0)
        elastic = (lam + 2 * mu / 3) / 2 * volume**2 + mu * square
        around = 2 * np.pi * r if axisymmetric else 1
        density = (elastic - flow * beyond / 2) * around
        self.energy = density * ufl.dx(degree=degree, domain=domain)
        # the flow scales the deviator of the strain
        kept = 1 - 3 * mu * flow / stress
        direction = (b - mean * ufl.Identity(2)) / difference
        a, c = volume / 3 + kept * deviator[0], kept * turned
        parts = ufl.cosh(2 * c) * ufl.Identity(2) + ufl.sinh(2 * c) * direction
        back = ufl.inv(F)
        changes: dict[fem.Function, Any] = {
            self._inverse: back * (ufl.exp(2 * a) * parts) * back.T,
            self._across: ufl.exp(2 * (volume / 3 + kept * deviator[1])) / ring**2,
            self._strain: self._strain + flow,
        }
        self._changes = [(old, fem.Expression(new, points)) for old, new in changes.items()]
        self._update()

    @property
    def history(self) -> list[fem.Function]:
        """The Functions that state files keep: those that `accept` changes, and the hardening."""
        return [*(function for function, _ in self._changes), self._limit, self._slope]

    def _update(self) -> None:
        """Evaluate the hardening at the start of the next step. Not collective."""
        self._limit.x.array[:], self._slope.x.array[:] = self._hardening(self._strain.x.array)

    def accept(self) -> None:
        """Make the present strains the history. Collective."""
        found = [fem.Function(old.function_space) for old, _ in self._changes]
        for function, (_, expression) in zip(found, self._changes, strict=True):
            function.interpolate(expression)
        for function, (old, _) in zip(found, self._changes, strict=True):
            old.x.array[:] = function.x.array
        self._update()
