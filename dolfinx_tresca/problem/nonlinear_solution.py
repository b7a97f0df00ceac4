"""The result of a nonlinear solve."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_tresca.output.table import Row
from dolfinx_tresca.problem.newton_record import NewtonRecord
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.status import ContactStatus

#: Rows of a linear solution's table that mean nothing for nonlinear bodies: they describe the
#: quadratic problem of the last step.
OF_LINEAR_BODIES = ("energy error", "energy")


@dataclass(frozen=True, repr=False)
class NonlinearContactSolution(ContactSolution):
    """A `ContactSolution` of nonlinear bodies: the last Newton step, and the record of all steps.

    Iterations, products and seconds are sums over all Newton steps. Energies and errors belong to
    the quadratic problem of the last step, and the norm |u|_K is that of this step's tangent K.

    Attributes:
        newton: record of Newton's method.
    """

    newton: NewtonRecord

    @property
    def failure(self) -> str:
        """Reason why the iterations failed, and what helps; empty if they converged."""
        if self.status is ContactStatus.NO_EQUILIBRIUM:
            return self.newton.message
        return super().failure

    def _rows(self) -> list[Row]:
        steps = self.newton.steps
        fractions = len({step.fraction for step in steps})
        newton = f"{len(steps)} steps, residual {self.newton.residual:.1e}"
        newton += f", load in {fractions} parts" * (fractions > 1)
        rows = [row for row in super()._rows() if row[0] not in OF_LINEAR_BODIES]
        result = [rows[0], ("Newton", newton), *rows[1:]]
        if self.newton.snaps:
            result.insert(2, ("released", f"energy {self.newton.released:.4g}: bodies snap"))
        return result
