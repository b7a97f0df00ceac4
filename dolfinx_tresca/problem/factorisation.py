"""K of a contact problem: its rigid modes, the springs that fix them, and the chosen solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dolfinx_tresca._base.timing import timed
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.fixing import fixing_springs
from dolfinx_tresca.floating.weak_modes import weakly_resisted_modes
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.stiffness.blas import warn_of_slow_blas
from dolfinx_tresca.stiffness.choice import StiffnessMethod, check_choice, choose, solver_for
from dolfinx_tresca.stiffness.nested import is_nested
from dolfinx_tresca.stiffness.solver import check_options
from dolfinx_tresca.stiffness.system import LinearSystem


class Factorisation:
    """Assembles K, fixes the bodies that K holds weakly by springs, and factors the sum.

    Attributes:
        method: name of the chosen solver for K.
        reason: reason of the choice.
    """

    def __init__(
        self,
        linear: LinearSystem,
        bodies: Bodies,
        stiffness: StiffnessMethod,
        expected_solves: int,
        petsc_options: Mapping[str, Any],
        petsc_options_prefix: str | None,
    ) -> None:
        """Choose the solver for K, which suits these bodies. Not collective.

        Args:
            linear: the system of K.
            bodies: bodies of the mesh.
            stiffness: see `ContactSystem`.
            expected_solves: see `ContactSystem`.
            petsc_options: see `ContactSystem`.
            petsc_options_prefix: see `ContactSystem`.

        Raises:
            InputError: an argument is wrong.
        """
        V, is_mixed = linear.V, linear.component is not None
        check_options(petsc_options, petsc_options_prefix)
        check_choice(stiffness, expected_solves, saddle=is_mixed)
        if linear.comm.rank == 0:
            warn_of_slow_blas()
        self._linear, self._bodies = linear, bodies
        self._options = petsc_options, petsc_options_prefix
        dim = V.dofmap.index_map_bs
        self.method, self.reason = choose(
            stiffness,
            dim * bodies.mean_nodes,
            dim,
            V.element.basix_element.degree,
            int(expected_solves),
            linear.comm,
            saddle=is_mixed,
            refined=is_nested(V),
        )

    @property
    def bodies_found(self) -> str:
        """The number of bodies and of the rigid motions that K resists weakly, as text."""
        return f"{self._bodies.number}{self._modes.summary}"

    def compliance(
        self, jump: JumpOperator, timings: dict[str, float], before: ContactCompliance | None = None
    ) -> ContactCompliance:
        """Assemble K, find the rigid modes it resists weakly, and return A. Collective.

        Args:
            jump: B.
            timings: phase -> seconds, to which the phases of this call are added.
            before: A with the former K, whose far field the new A keeps; None: there is none.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
        """
        linear = self._linear
        with timed("stiffness", timings):
            linear.assemble_stiffness()
            if before is None or linear.component is None:
                # in later steps pressures make the block of the displacements indefinite even for
                # a stable body; then the signs of pivots tell whether bodies are held
                self._modes = weakly_resisted_modes(linear, self._bodies)
        springs = fixing_springs(self._modes, linear)
        K = springs.added_to(linear.K) if springs else linear.K
        try:
            with timed(self.method, timings):
                solver = solver_for(self.method, K, linear, *self._options)
        finally:
            if springs:
                K.destroy()  # the solver has a reference of its own
        with timed(self.method, timings):  # for a saddle point this factors another matrix
            return ContactCompliance(jump, solver, springs, before)

    def check_suits(self, options: SolverOptions) -> None:
        """Check that options suit the bodies and the form. Not collective.

        Raises:
            InputError: the options need a form of UFL, or bodies without rigid motions.
        """
        linear = self._linear
        if options.balanced and not linear.form_of_displacement:
            found = "a is none" if linear.form is None else "a is on a mixed space"
            raise InputError(
                'accuracy="balanced", the default, takes the error of the mesh as a measure, which '
                f"is estimated with a form of UFL of the displacement, and {found}. Give "
                "solve(accuracy=1e-3), or a rtol."
            )
        if options.method != "projected_newton" and self._modes:
            raise InputError(
                f"method={options.method!r} needs bodies that are held by supports, but found "
                f"{self.bodies_found}. Take method='projected_newton'."
            )
