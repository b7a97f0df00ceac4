"""The criterion of convergence: whether an iterate has the requested accuracy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca.optimise.problem import DualProblem, Point
from dolfinx_tresca.optimise.record.energy import energy_error, energy_norm
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.options import SolverOptions

#: `LEAST_ACCURACY` is the least relative energy error that is requested if the mesh's error
#: determines the request. With `rtol`, the mesh's error is not estimated if the relative energy
#: error is below `BELOW_ANY_MESH`, since every mesh has a larger error.
LEAST_ACCURACY, BELOW_ANY_MESH = 1e-8, 1e-4

#: Largest accepted residual of the equality constraints, relative to their terms: forces are in
#: equilibrium.
BALANCED = 1e-10

#: Requested residual if there is no bound of the energy error and the user set no `rtol`.
UNPROVEN = 1e-6


class Stopping:
    """The requested accuracy, which the discretisation error may determine.

    With `accuracy=`, only the bound of the energy error is checked. By default, the requested
    energy error is a part of the discretisation error, and the traction of every node must be near
    its local minimiser (`DualProblem.local_error`), since energies say little about peaks and
    states. With `rtol=`, the residual is checked in addition: for slender bodies, for example, the
    energy error may be large although the residual is small.

    Attributes:
        accuracy: relative error in the energy norm that is requested at present; inf if it is not
            yet known.
    """

    def __init__(
        self, problem: DualProblem, options: SolverOptions, residual: NaturalResidual
    ) -> None:
        """Begin a solve."""
        self._problem, self._residual = problem, residual
        self._rtol, self._step_factor = options.rtol, options.step_factor
        self._local, self._mesh_part = options.local_accuracy, options.mesh_part
        self._requested = (
            None if isinstance(options.accuracy, str) or options.rtol else options.accuracy
        )
        self.accuracy = np.inf if self._requested is None else float(self._requested)
        self._mesh_unknown = self._requested is None

    def reached(self, point: Point, error: float) -> tuple[float, float, bool]:
        """Return the reached and the requested accuracy, and whether the iterate is good enough.

        The two numbers belong to the first criterion that is not met; if all criteria are met, they
        belong to the last criterion. Unless the user set `accuracy=`, the first call with a small
        bound sets `accuracy` from the error of the mesh. Collective.

        Args:
            point: multipliers in Lambda, with their gradient.
            error: error of the gradient in the norm sqrt(e'A^-1 e).
        """
        residual = self._residual.at(point)
        reached, wanted = np.inf, 1.0
        for reached, wanted in self.measures(point, error, self._residual.relative(residual)):
            if not reached <= wanted:
                return reached, wanted, residual == 0.0
        return reached, wanted, True

    def measures(
        self, point: Point, error: float, residual: float
    ) -> Iterator[tuple[float, float]]:
        """Yield the reached and the requested value of each criterion in turn. Collective.

        A criterion is computed only if the caller asks for it, after the earlier criteria are met.

        Args:
            point: multipliers in Lambda, with their gradient.
            error: error of the gradient in the norm sqrt(e'A^-1 e).
            residual: natural residual, divided by its scale.
        """
        problem, x, r = self._problem, point.x, point.r
        yield problem.constraints.imbalance(x, point.c), BALANCED
        if self._rtol is not None:
            yield residual, self._rtol
        bound = energy_error(problem, point, error)
        if self._requested is not None:
            yield bound, self.accuracy
            return
        if np.isfinite(bound) or np.isfinite(problem.energy_bound(x, r, error)):
            # the relative bound is infinite while errors exceed the norm of the displacement
            if self._mesh_unknown:
                yield bound, FORCING
                if self._rtol is None or bound > BELOW_ANY_MESH:
                    mesh = problem.discretisation_error(x, point.c)
                    self.accuracy = min(max(self._mesh_part * mesh, LEAST_ACCURACY), FORCING)
                    self._mesh_unknown = False
            if not self._mesh_unknown:
                yield bound, self.accuracy
        elif self._rtol is None:
            yield residual, UNPROVEN
        yield problem.local_error(x, r), self._local

    def tolerable_error(self, point: Point) -> float:
        """Return the tolerable error of the last gradient, in the norm sqrt(e'A^-1 e). Collective.

        The tolerable error is small compared with the error of the multipliers, since the local
        errors of the nodes are computed from the gradient.

        Args:
            point: multipliers in Lambda, with their gradient.
        """
        problem = self._problem
        norm = energy_norm(problem, point)
        if norm == 0.0:  # no relative error
            return 0.0
        reached = energy_error(problem, point)
        error = max(min(self.accuracy, reached), LEAST_ACCURACY) * norm
        if self._rtol is not None or not np.isfinite(error):
            error = min(error, self.residual_error)
        return FORCING * error

    @property
    def residual_error(self) -> float:
        """The largest tolerable norm sqrt(e'A^-1 e) of an error e of the gradient.

        The Euclidean norm |e| is then at most the requested residual.
        """
        rtol = UNPROVEN if self._rtol is None else self._rtol
        # the norm sqrt(e'A^-1 e) is at least |e| / sqrt(sigma_max)
        rho = self._residual.rho
        return rtol * self._residual.scale * float(np.sqrt(rho / self._step_factor))
