"""When an iterate is as good as was asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers.problem import DualProblem

#: Relative energy error with which that of the mesh can be estimated.
ROUGH = 0.1

#: Part of the mesh's error that the iteration's is at the end: where they add up like orthogonal
#: ones, it makes the whole larger by half a percent.
BALANCED = 0.1

#: Least and largest relative energy error that is asked for on account of the mesh; and the one
#: below which, where residuals decide, no mesh makes more digits worth while.
FINEST, FINE = 1e-8, 1e-4

#: Residual that is wanted where no bound can be had and none was asked for.
UNPROVEN = 1e-6


class Stopping:
    """What was asked for, and what the mesh makes of it.

    `accuracy=` asks for a bound of the energy error alone. By default that is a part of the error
    of the mesh; and no node may be far from where it would go by itself, since energies say little
    about peaks and states. `rtol=` asks for a residual as well: what is small against the residual
    at lambda = 0 need not be small otherwise, for slender bodies say.

    Attributes:
        accuracy: relative error in the energy norm that is wanted now; inf while nothing says.
    """

    def __init__(self, problem: DualProblem, options: SolverOptions) -> None:
        """Begin a solve."""
        self._problem = problem
        self._rtol = options.rtol
        self._local = options.local_accuracy
        self._asked = (
            None if isinstance(options.accuracy, str) or options.rtol else options.accuracy
        )
        self.accuracy = np.inf if self._asked is None else float(self._asked)
        self._mesh_unknown = self._asked is None

    def measures(
        self,
        multipliers: Array,
        r: Array,
        rho: float,
        residual: float,
        energy_error: Callable[[], float],
    ) -> Iterator[tuple[float, float]]:
        """Yield what is reached and what is wanted, each where those before are met. Collective.

        Args:
            multipliers: (size,) in Lambda.
            r: (size,) the gradient there, with rigid motions.
            rho: a step length.
            residual: natural residual over its scale.
            energy_error: gives a bound of the relative error in the energy norm.
        """
        if self._rtol is not None:
            yield residual, self._rtol
        bound = energy_error()
        if self._asked is not None:
            yield bound, self.accuracy
            return
        if np.isfinite(bound):
            if self._mesh_unknown:
                yield bound, ROUGH
                if self._rtol is None or bound > FINE:
                    mesh = self._problem.discretisation_error(multipliers, rho)
                    self.accuracy = min(max(BALANCED * mesh, FINEST), ROUGH)
                    self._mesh_unknown = False
            if not self._mesh_unknown:
                yield bound, self.accuracy
        elif self._rtol is None:
            yield residual, UNPROVEN
        yield self._problem.local_error(multipliers, r), self._local
