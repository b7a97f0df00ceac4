"""K of a contact problem: its rigid modes, the springs that fix them, and the chosen solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dolfinx_tresca._base.parallel import timed
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.fixing import fixing_springs
from dolfinx_tresca.floating.rigid_modes import weakly_resisted_modes
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.scene.mesh import NamedTags
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.choice import (
    ChosenMethod,
    StiffnessMethod,
    check_choice,
    choose,
    solver_for,
)
from dolfinx_tresca.stiffness.solver import check_options
from dolfinx_tresca.stiffness.system import LinearSystem


class Factorisation:
    """Assembles K, adds springs that fix the bodies that K holds only weakly, and factors the sum.

    The first call of `compliance` finds the bodies, and chooses the solver for K that suits them.

    Attributes:
        bodies: the bodies of the mesh.
        method: name of the chosen solver for K.
        reason: why this solver was chosen, as text.
    """

    def __init__(
        self,
        linear: LinearSystem,
        cell_tags: NamedTags | None,
        stiffness: StiffnessMethod,
        expected_solves: int,
        petsc_options: Mapping[str, Any],
        petsc_options_prefix: str | None,
    ) -> None:
        """Check the arguments. Not collective.

        Args:
            linear: the system of K.
            cell_tags: tags of cells with the names of bodies; None: bodies have numbers only.
            stiffness: see `ContactSystem`.
            expected_solves: see `ContactSystem`.
            petsc_options: see `ContactSystem`.
            petsc_options_prefix: see `ContactSystem`.

        Raises:
            InputError: an argument is wrong.
        """
        check_options(petsc_options, petsc_options_prefix)
        check_choice(stiffness, expected_solves, saddle=linear.component is not None)
        if linear.comm.rank == 0:
            warn_of_slow_blas()
        self._linear, self._cell_tags = linear, cell_tags
        self._requested = stiffness, int(expected_solves)
        self._options = petsc_options, petsc_options_prefix

    @property
    def bodies_found(self) -> str:
        """The number of bodies and of the rigid motions that K resists weakly, as text."""
        return f"{self.bodies.number}{self._modes.summary}"

    def compliance(
        self, jump: JumpOperator, timings: dict[str, float], again: bool = False
    ) -> ContactCompliance:
        """Assemble K, find the rigid modes it resists weakly, and return A. Collective.

        With a mixed space, the modes are found in the first call only.

        Args:
            jump: the operator B of A = B K^-1 B'.
            timings: phase -> seconds, to which the phases of this call are added.
            again: whether this is a later call, for the same bodies with another K.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
        """
        linear = self._linear
        if not again:
            self.bodies = Bodies.from_space(linear.V, self._cell_tags)
            self.method, self.reason = self._chosen()
        with timed("stiffness", timings):
            linear.assemble_stiffness()
            if not again or linear.component is None:
                # in later steps, pressures make the block of the displacements indefinite even for
                # a stable body; then the signs of pivots tell whether bodies are held
                self._modes = weakly_resisted_modes(linear, self.bodies)
        springs = fixing_springs(self._modes, linear)
        K = springs.added_to(linear.K) if springs else linear.K
        try:
            with timed(self.method, timings):
                solver = solver_for(self.method, K, linear, *self._options)
        finally:
            if springs:
                K.destroy()  # the solver has a reference of its own
        with timed(self.method, timings):  # for a saddle point, this factors another matrix
            return ContactCompliance(jump, solver, springs)

    def _chosen(self) -> tuple[ChosenMethod, str]:
        """Return the solver for K that suits these bodies, and the reason. Not collective."""
        method, expected_solves = self._requested
        V = self._linear.V
        dim = V.dofmap.index_map_bs
        return choose(
            method,
            dim * self.bodies.mean_nodes,
            dim,
            expected_solves,
            self._linear.comm,
            saddle=self._linear.component is not None,
        )

    def check_suits(self, options: SolverOptions) -> None:
        """Check that options suit the bodies and the form. Not collective.

        Raises:
            InputError: the options need a form of UFL, or bodies without rigid motions.
        """
        linear = self._linear
        if options.balanced and not linear.form_of_displacement:
            reason = "a is none" if linear.form is None else "a is on a mixed space"
            raise InputError(
                'accuracy="balanced", the default, takes the error of the mesh as a measure, which '
                f"is estimated with a form of UFL of the displacement, and {reason}. Give "
                "solve(accuracy=1e-3), or a rtol."
            )
        if options.method != "projected_newton" and self._modes:
            raise InputError(
                f"method={options.method!r} needs bodies that are held by supports, but found "
                f"{self.bodies_found}. Take method='projected_newton'."
            )
