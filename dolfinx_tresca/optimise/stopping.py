"""When an iterate is as good as was asked for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.energy import energy_error, energy_norm
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.residual import NaturalResidual
from dolfinx_tresca.options import SolverOptions

#: Relative energy error with which that of the mesh can be estimated.
MESH_ACCURACY = 0.1

#: Least and largest relative energy error that is asked for on account of the mesh; and the one
#: below which, where residuals decide, no mesh makes more digits worth while.
LEAST_ACCURACY, BELOW_ANY_MESH = 1e-8, 1e-4

#: Error of the gradient at the end, over what is wanted.
FINAL_GRADIENT = 0.1

#: Residual that is wanted where no bound can be had and none was asked for.
UNPROVEN = 1e-6


class Stopping:
    """The requested accuracy, which the discretisation error may determine.

    `accuracy=` asks for a bound of the energy error alone. By default that is a part of the error
    of the mesh; and no node may be far from where it would go by itself, since energies say little
    about peaks and states. `rtol=` asks for a residual as well: what is small against the residual
    at lambda = 0 need not be small otherwise, for slender bodies say.

    Attributes:
        accuracy: relative error in the energy norm that is wanted now; inf while nothing says.
    """

    def __init__(
        self, problem: DualProblem, options: SolverOptions, residual: NaturalResidual
    ) -> None:
        """Begin a solve."""
        self._problem, self._residual = problem, residual
        self._rtol, self._step_factor = options.rtol, options.step_factor
        self._local, self._mesh_part = options.local_accuracy, options.mesh_part
        self._asked = (
            None if isinstance(options.accuracy, str) or options.rtol else options.accuracy
        )
        self.accuracy = np.inf if self._asked is None else float(self._asked)
        self._mesh_unknown = self._asked is None

    def reached(self, x: Array, r: Array, error: float) -> tuple[float, float, bool]:
        """Return the reached and the wanted accuracy, and whether all are reached. Collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
            error: of r, in the norm sqrt(e'A^-1 e).
        """
        residual = self._residual.at(x, r)
        reached, wanted = np.inf, 1.0
        for reached, wanted in self.measures(x, r, error, self._residual.relative(residual)):
            if not reached <= wanted:
                return reached, wanted, residual == 0.0
        return reached, wanted, True

    def measures(
        self, x: Array, r: Array, error: float, residual: float
    ) -> Iterator[tuple[float, float]]:
        """Yield what is reached and what is wanted, each where those before are met. Collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
            error: of r, in the norm sqrt(e'A^-1 e).
            residual: natural residual over its scale.
        """
        problem, c = self._problem.section(x), self._multipliers(x, r)
        if self._rtol is not None:
            yield residual, self._rtol
        bound = energy_error(problem, x, r, c, error)
        if self._asked is not None:
            yield bound, self.accuracy
            return
        if np.isfinite(bound) or np.isfinite(problem.energy_bound(x, r, error)):
            # where the norm is not resolved yet the relative bound is infinite: not reached
            if self._mesh_unknown:
                yield bound, MESH_ACCURACY
                if self._rtol is None or bound > BELOW_ANY_MESH:
                    mesh = problem.discretisation_error(x, self._residual.rho)
                    self.accuracy = min(max(self._mesh_part * mesh, LEAST_ACCURACY), MESH_ACCURACY)
                    self._mesh_unknown = False
            if not self._mesh_unknown:
                yield bound, self.accuracy
        elif self._rtol is None:
            yield residual, UNPROVEN
        yield problem.local_error(x, r - problem.constraints.columns @ c), self._local

    def tolerable_error(self, x: Array, r: Array) -> float:
        """Return the error that the last gradient may have, in the norm sqrt(e'A^-1 e). Collective.

        Small against the error of the multipliers, since what nodes want is judged by it.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        problem, c = self._problem.section(x), self._multipliers(x, r)
        norm = energy_norm(problem, x, r, c)
        if norm == 0.0:  # nothing to measure errors by
            return 0.0
        reached = energy_error(problem, x, r, c)
        error = max(min(self.accuracy, reached), LEAST_ACCURACY) * norm
        if self._rtol is not None or not np.isfinite(error):
            error = min(error, self.residual_error)
        return FINAL_GRADIENT * error

    @property
    def residual_error(self) -> float:
        """Error of a gradient, in that norm, that is the wanted residual."""
        rtol = UNPROVEN if self._rtol is None else self._rtol
        # the norm is at least |e| / sqrt(sigma_max)
        rho = self._residual.rho
        return rtol * self._residual.scale * float(np.sqrt(rho / self._step_factor))

    def _multipliers(self, x: Array, r: Array) -> Array:
        """Return the multipliers (k,) of the constraints that belong to an iterate. Collective."""
        problem, lam = self._problem, self._problem.admissible.section(x)
        return problem.constraints.multipliers(lam, x, r, self._residual.rho)
