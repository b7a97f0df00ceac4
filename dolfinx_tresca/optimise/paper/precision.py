"""Adaptive precision control of the inner iterations, (Step 3.1)."""

from __future__ import annotations

from dataclasses import dataclass, field

from dolfinx_tresca.optimise.record.history import History
from dolfinx_tresca.options import SolverOptions


@dataclass
class AdaptivePrecision:
    """The tolerance tol^{k+1} = min(r_tol err^k / err^0, c_fact tol^k), tol^0 = r_tol / c_fact.

    Here r_tol and c_fact are `SolverOptions`, and err^k is the residual of outer iteration k.

    The paper does not define the reference value of the inner residual. Here the reference is
    err^0: an inner iteration ends at the norm tol^{k+1} err^0, which is at most r_tol times the
    outer residual err^k.
    """

    history: History
    options: SolverOptions
    _tolerance: float = field(init=False)

    def __post_init__(self) -> None:
        self._tolerance = self.options.r_tol / self.options.c_fact

    def next(self) -> float:
        """Return the norm of the residual at which the next inner iteration ends."""
        relative = self.history.error / self.history.first_error
        self._tolerance = min(self.options.r_tol * relative, self.options.c_fact * self._tolerance)
        return self._tolerance * self.history.first_error
