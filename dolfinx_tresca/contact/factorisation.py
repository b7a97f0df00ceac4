"""K of a contact problem: its rigid modes, the springs that fix them, and the chosen solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import timed
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.fixing import fixing_springs
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes, weakly_resisted_modes
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.scene.pair import ContactPair, check_tags
from dolfinx_tresca.stiffness.choice import StiffnessMethod, choose, warn_of_slow_blas
from dolfinx_tresca.stiffness.solver import check_options, cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem


class Factorisation:
    """Assembles K, adds springs that fix the bodies that K holds only weakly, and factors the sum.

    Attributes:
        linear: the system of K.
        pairs: the contact pairs.
        bodies: the bodies of the mesh.
        method: name of the chosen solver for K.
        reason: why this solver was chosen, as text.
    """

    def __init__(
        self,
        linear: LinearSystem,
        pairs: list[ContactPair],
        stiffness: StiffnessMethod,
        petsc_options: Mapping[str, Any] | None,
        petsc_options_prefix: str | None,
        expected_solves: int = 1,
    ) -> None:
        """Find the bodies, and choose the solver for K that suits them. Collective.

        Args:
            linear: the system of K.
            pairs: the contact pairs, whose tags of cells have the names of bodies.
            stiffness: how to solve with K: "cholesky", "multigrid" or "auto".
            petsc_options: PETSc options of the solver for K, with precedence over the defaults.
            petsc_options_prefix: prefix of the options that the command line gives to this solver.
            expected_solves: number of solves with the same K, approximately.

        Raises:
            InputError: an option of the solver is wrong.
        """
        self.linear, self.pairs = linear, pairs
        self._petsc_options, self._prefix = petsc_options or {}, petsc_options_prefix
        self._modes: RigidBodyModes | None = None
        check_options(self._petsc_options, self._prefix)
        is_saddle, dim = linear.component is not None, linear.V.dofmap.index_map_bs
        if linear.comm.rank == 0:
            warn_of_slow_blas()
        check_tags(pairs, linear.V.mesh)
        cell_tags = (pair.cell_tags for pair in pairs if pair.cell_tags is not None)
        self.bodies = Bodies.from_space(linear.V, next(cell_tags, None))
        self.method, self.reason = choose(
            stiffness,
            dim * self.bodies.mean_nodes,
            dim,
            expected_solves,
            linear.comm,
            saddle=is_saddle,
        )

    @property
    def bodies_found(self) -> str:
        """The number of bodies and of the rigid motions that K resists weakly, as text."""
        return f"{self.bodies.number}{'' if self._modes is None else self._modes.summary}"

    def compliance(self, jump: JumpOperator, timings: dict[str, float]) -> ContactCompliance:
        """Assemble K, find the rigid modes it resists weakly, and return A. Collective.

        With a mixed space, the modes are found in the first call only.

        Args:
            jump: the operator B of A = B K^-1 B'.
            timings: phase -> seconds, to which the phases of this call are added.

        Raises:
            StiffnessError: K is not symmetric, or is indefinite.
        """
        linear = self.linear
        with timed("stiffness", timings):
            linear.assemble_stiffness()
            if self._modes is None or linear.component is None:
                # in later steps, pressures make the block of the displacements indefinite even for
                # a stable body; then the signs of pivots tell whether bodies are held
                self._modes = weakly_resisted_modes(linear, self.bodies)
        springs = fixing_springs(self._modes, linear)
        with timed(self.method, timings):
            K = springs.added_to(linear.K) if springs else linear.K
            given = self._petsc_options, self._prefix
            if self.method == "cholesky":
                solver = cholesky(K, *given, linear.saddle_size)
            else:
                solver = multigrid(K, linear.V, linear.prescribed, *given)
            # for a saddle point, this factors another matrix
            return ContactCompliance(jump, solver, springs)

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
