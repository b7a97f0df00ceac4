"""K of a contact problem: its rigid modes, the springs that fix them, and the chosen solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dolfinx_tresca._base.parallel import timed
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.fixing import fixing_springs
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes, weakly_resisted_modes
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.choice import (
    ChosenMethod,
    StiffnessMethod,
    check_choice,
    choose,
    solver_for,
)
from dolfinx_tresca.stiffness.levels import is_nested
from dolfinx_tresca.stiffness.solver import check_options
from dolfinx_tresca.stiffness.system import LinearSystem


@dataclass
class Factorisation:
    """Assembles K, adds springs that fix the bodies that K holds only weakly, and factors the sum.

    The first call of `compliance` finds the bodies, and chooses the solver for K that suits them.

    Attributes:
        linear: the system of K.
        pairs: the contact pairs, whose tags of cells have the names of bodies.
        stiffness: how to solve with K: "cholesky", "multigrid" or "auto".
        petsc_options: PETSc options of the solver for K, with precedence over the defaults.
        petsc_options_prefix: prefix of the options that the command line gives to this solver.
        expected_solves: number of solves with the same K, approximately.
        bodies: the bodies of the mesh.
        method: name of the chosen solver for K.
        reason: why this solver was chosen, as text.
    """

    linear: LinearSystem
    pairs: list[ContactPair]
    stiffness: StiffnessMethod
    petsc_options: Mapping[str, Any] | None
    petsc_options_prefix: str | None
    expected_solves: int = 1
    bodies: Bodies = field(init=False)
    method: ChosenMethod = field(init=False)
    reason: str = field(init=False)
    _modes: RigidBodyModes = field(init=False)

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
            InputError: an option of the solver is wrong.
            StiffnessError: K is not symmetric, or is indefinite.
        """
        linear = self.linear
        petsc_options = {} if self.petsc_options is None else self.petsc_options
        if not again:
            check_options(petsc_options, self.petsc_options_prefix)
            self._choose()
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
                solver = solver_for(
                    self.method, K, linear, petsc_options, self.petsc_options_prefix
                )
        finally:
            if springs:
                K.destroy()  # the solver has a reference of its own
        with timed(self.method, timings):  # for a saddle point, this factors another matrix
            return ContactCompliance(jump, solver, springs)

    def _choose(self) -> None:
        """Find the bodies, and choose the solver for K that suits them. Collective."""
        V, is_saddle = self.linear.V, self.linear.component is not None
        check_choice(self.stiffness, self.expected_solves, saddle=is_saddle)
        if self.linear.comm.rank == 0:
            warn_of_slow_blas()
        cell_tags = [pair.cell_tags for pair in self.pairs if pair.cell_tags is not None]
        self.bodies = Bodies.from_space(V, cell_tags[0] if cell_tags else None)
        dim = V.dofmap.index_map_bs
        self.method, self.reason = choose(
            self.stiffness,
            dim * self.bodies.mean_nodes,
            dim,
            V.element.basix_element.degree,
            int(self.expected_solves),
            self.linear.comm,
            saddle=is_saddle,
            refined=is_nested(V),
        )

    def check_suits(self, options: SolverOptions) -> None:
        """Check that options suit the bodies and the form. Not collective.

        Raises:
            InputError: the options need a form of UFL, or bodies without rigid motions.
        """
        linear = self.linear
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
