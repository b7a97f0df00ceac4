"""The result of a solve on a sequence of meshes."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx import fem

from dolfinx_tresca.derivatives.goals import GoalError
from dolfinx_tresca.errors import ConvergenceError
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.status import AdaptiveStatus
from dolfinx_tresca.table import Row, Tabulated


@dataclass(frozen=True)
class Level:
    """One of the meshes, and the solution on it.

    Attributes:
        number: number of the mesh; the first is 0.
        tagged_mesh: the mesh.
        solution: the solution on the mesh.
        free_dofs: degrees of freedom that are not prescribed, as `ContactProblem.free_dofs`.
        error: estimate of the mesh's error: in the energy norm, relative to the solution's norm,
            or, with a goal, the relative error of the goal; infinite if unknown. A goal that does
            not depend on the displacement, such as the pressure on a patch that is open on this
            mesh, tells nothing about the mesh: then it is the error in the energy norm.
        cell_errors: errors of the cells, after `refinement_indicators`; None if unknown.
        products: number of applications of A in all solves on the mesh, adjoint ones included.
        seconds: time for building, solving and refining on the slowest rank.
        goal_error: the goal and its error; None without a goal.
    """

    number: int
    tagged_mesh: TaggedMesh
    solution: ContactSolution
    free_dofs: int
    error: float
    cell_errors: fem.Function | None
    products: int
    seconds: float
    goal_error: GoalError | None = None

    def __str__(self) -> str:
        return (
            f"level {self.number}: {self.free_dofs} unknowns, error about {self.error:.1e}, "
            f"{self.products} products, {self.seconds:.1f} s"
        )

    def __repr__(self) -> str:
        return f"<Level: {self}>"


@dataclass(frozen=True)
class AdaptiveSolution(Tabulated):
    """The solutions on all meshes, and the reason why no finer mesh followed.

    Attributes:
        status: the reason why no finer mesh followed.
        accuracy: the requested accuracy.
        levels: all meshes with their solutions, from coarse to fine.
    """

    status: AdaptiveStatus
    accuracy: float
    levels: tuple[Level, ...]

    @property
    def solution(self) -> ContactSolution:
        """The solution on the last mesh."""
        return self.levels[-1].solution

    @property
    def tagged_mesh(self) -> TaggedMesh:
        """The last mesh."""
        return self.levels[-1].tagged_mesh

    @property
    def goal_error(self) -> GoalError | None:
        """The goal and its error on the last mesh, if there is a goal."""
        return self.levels[-1].goal_error

    @property
    def error(self) -> float:
        """Estimate of the relative error, in energy or of the goal, on the last mesh."""
        return self.levels[-1].error

    def raise_if_failed(self) -> None:
        """Check that the accuracy was reached. Not collective.

        Raises:
            ConvergenceError: the accuracy was not reached.
        """
        self.solution.raise_if_failed()
        if self.status is not AdaptiveStatus.REACHED:
            raise ConvergenceError(
                f"{self.status.value} after {len(self.levels)} mesh(es) with up to "
                f"{self.levels[-1].free_dofs} unknowns: the error is about {self.error:.1e}, "
                f"requested {self.accuracy:.1e}. Allow more, request less, or take elements of "
                "degree 2."
            )

    def _rows(self) -> list[Row]:
        seconds = sum(level.seconds for level in self.levels)
        number = self.goal_error
        measured = "solution's norm" if number is None else f"number, {number.value:.6g}"
        return [
            ("status", f"{self.status.name}: {self.status.value}"),
            ("mesh error", f"about {self.error:.1e} of the {measured}"),
            ("requested", f"{self.accuracy:.1e}"),
            ("seconds", f"{seconds:.1f}"),
            ("level", "unknowns     error  products   seconds"),
            *(
                (
                    f"  {level.number}",
                    f"{level.free_dofs:8}  {level.error:8.1e}  {level.products:8}  "
                    f"{level.seconds:8.1f}",
                )
                for level in self.levels
            ),
        ]

    def __repr__(self) -> str:
        return (
            f"<AdaptiveSolution: {self.status.name}, {len(self.levels)} mesh(es), "
            f"{self.levels[-1].free_dofs} unknowns, mesh error {self.error:.1e}>"
        )
