"""The stiffness matrix K of bodies that springs hold where K does not, and the solver for it."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import timed
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating import rigid_modes
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.stiffness.choice import SolverRequest
from dolfinx_tresca.stiffness.solver import StiffnessSolver, cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem


class HeldStiffness:
    """K with springs that fix bodies that K holds weakly or not, for all solves of a problem.

    Attributes:
        bodies: the bodies of the mesh.
        method, reason: the solver for K, "cholesky" or "multigrid", and why, as text.
    """

    def __init__(self, linear: LinearSystem, cell_tags: Any, request: SolverRequest) -> None:
        """Find the bodies, with names from tags of cells, and choose the solver. Collective."""
        self._linear, self._request = linear, request
        self.bodies = Bodies.from_labels(linear.V, linear.body_of_node, cell_tags)
        dim, is_saddle = linear.V.dofmap.index_map_bs, linear.component is not None
        counts = self.bodies.node_counts
        # the mean over all nodes of their body's unknowns: large bodies decide
        unknowns = dim * float(counts @ counts / counts.sum())
        self.method, self.reason = request.choose(unknowns, dim, linear.comm, saddle=is_saddle)
        self._modes: rigid_modes.RigidBodyModes | None = None

    def factored(
        self, timings: dict[str, float]
    ) -> tuple[StiffnessSolver, rigid_modes.FixingSprings | None]:
        """Assemble K, and return the solver for K with fixing springs, and the springs. Collective.

        The caller owns the solver. With a mixed space, rigid modes are looked for once: later, the
        displacements' block of K may be indefinite, and pivots tell if bodies are held.

        Raises:
            InputError: contact alone holds a body, and the space is mixed.
        """
        linear, request = self._linear, self._request
        with timed("stiffness", timings):
            linear.assemble_stiffness()
            if self._modes is None or linear.component is None:
                self._modes = rigid_modes.weakly_resisted_modes(linear, self.bodies)
        modes, springs = self._modes, None
        if modes and linear.component is None:
            springs = rigid_modes.FixingSprings(modes)
        # in a mixed space, softly held bodies get no springs: K needs no positive pivots there
        elif modes and modes.floats.any():
            body = self.bodies.describe(int(modes.body[modes.floats.argmax()]))
            raise InputError(
                "bodies that contact alone holds need the form a of the displacement alone, but it "
                f"is that of a mixed space, and nothing holds {body}. "
                "Hold it by Dirichlet conditions, or by springs in a, of 1e-6 of its stiffness."
            )
        with timed(self.method, timings):
            K = springs.added_to(linear.K) if springs else linear.K
            given = request.petsc_options or {}, request.prefix
            if self.method == "cholesky":
                return cholesky(K, *given, linear.negative_pivots), springs
            return multigrid(K, linear.V, linear.prescribed, *given), springs

    def __str__(self) -> str:
        """Return the number of bodies, and of those that contact alone or soft springs hold."""
        text, modes = f"{self.bodies.count}", self._modes
        if modes:
            floating = np.unique(modes.body[modes.floats])
            softly_held = np.setdiff1d(modes.body, floating)
            for bodies, how in ((floating, "by contact alone"), (softly_held, "softly")):
                if len(bodies):
                    text += f", {len(bodies)} of them held {how}"
        return text

    def check_suits(self, options: SolverOptions) -> None:
        """Check that options suit the bodies and the form. Not collective.

        Raises:
            InputError: the default accuracy without a form of the displacement, by which the error
                of the mesh is estimated; or a method of the paper if no support holds a body.
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
                f"{self}. Take method='projected_newton'."
            )
