"""The quadratic program (38.4) of one solve: displacements, energies and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.parallel import largest_abs, reduce_array
from dolfinx_tresca._base.tolerances import FULL_ACCURACY, ROUGH, SLACK
from dolfinx_tresca.dual.accuracy import total
from dolfinx_tresca.dual.load_steps import SlipHistory
from dolfinx_tresca.dual.products import ContactCompliance
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.equilibrium import Equilibrium, FloatingBodies, Tools
from dolfinx_tresca.solvers.constraints import EqualityConstraints
from dolfinx_tresca.solvers.feasible_set import FeasibleSet


@dataclass
class InitialGuess:
    """First guesses of u = K^-1 (f - B'x): the displacements at x = 0 and at the last multipliers.

    Iterative solvers start from them; they are arrays of this rank's unknowns, kept from solve to
    solve. (Neither PETSc's `KSPGuess`, Fischer 1998, nor lines through points save iterations.)

    Attributes:
        load: u at x = 0, the displacement without contact.
        newest: u at the last multipliers; None: not known.
    """

    load: Array
    newest: Array | None = None


#: Relative accuracy in the energy norm, for iterative solvers, of the displacement without contact.
LOAD_ACCURACY = 1e-6

#: Largest length or force that is accepted: its square, times a stiffness or area of up to 1e28, is
#: less than the largest number of double precision, 1.8e308.
LARGEST_ENTRY = 1e140


class DualProgram:
    """The quadratic program of one solve: A, b, Lambda, constraints, displacements and energies.

    The algorithms in `dolfinx_tresca.solvers` get it as their `DualProblem`. It is valid until the
    load or K changes. With a direct solver for K, displacements are exact to rounding, whatever is
    requested; with an iterative one, only as accurate as requested.

    Attributes:
        offset: (size,) (d; s), divided by the jump's `length_scale`: gaps d, and tangential jumps s
            at which the slip of this solve is zero; less the jumps of frames of turned bodies.
        b: (size,) the linear term B K^-1 f - (d; s) of (38.4), where the paper has s = 0.
        b_error: norm sqrt(e'A^-1 e) of the error e of b.
        admissible: Lambda, or friction cones if slip bounds depend on the pressure.
        equilibrium: equilibrium of tools, floating and softly held bodies; None if there are none.
        constraints: the equations G'x + S c = e of this equilibrium; none without `equilibrium`.
        of_tools: slice of the motions of tools in the multipliers c (k,) of the constraints.
        is_load_step: whether this is a load step of a process: a step was accepted before.
    """

    b: Array
    b_error: float

    def __init__(
        self,
        compliance: ContactCompliance,
        guess: InitialGuess,
        slip_bounds: Sequence[NodalBounds],
        history: SlipHistory | None = None,
        tools: Tools | None = None,
    ) -> None:
        """Make the program for the system's present load, with one solve with K. Collective.

        An iterative solver computes b to the low accuracy `LOAD_ACCURACY`: gradients at nonzero
        multipliers do not depend on this b, but energies and the scale of residuals do. Every solve
        updates the `guess`. Without `history`, slips count from the undeformed bodies.

        Raises:
            InputError: the load is too large or too small for floating-point numbers.
            MechanismError: contact cannot hold a floating body or a tool.
            StiffnessError: the solve failed.
        """
        jump = compliance.jump
        self.jump, self.compliance = jump, compliance
        self._solver, self._guess = compliance.solver, guess
        self._load, self._u = jump.system.f.x.petsc_vec, jump.work
        self.reductions, self.inner = jump.reductions, jump.reductions.inner
        self.history = SlipHistory.none(jump) if history is None else history
        self.is_load_step = self.history.begun
        self.admissible = jump.bounded(slip_bounds)

        # floating bodies and tools must be in equilibrium under the present load
        bodies = compliance.floating
        self.of_tools = slice(0)
        if tools is not None:
            if bodies is None:
                dim, unknowns = jump.system.V.mesh.geometry.dim, len(self._load.array)
                bodies = FloatingBodies.none(tools.bodies, jump.comm, dim, unknowns, len(jump.gap))
            self.of_tools = slice(len(bodies.modes), None)  # tools come after the modes of bodies
            bodies = bodies.with_tools(tools)
        self.equilibrium: Equilibrium | None = None
        self.constraints = EqualityConstraints.none(len(jump.gap), jump.reductions)
        if bodies is not None:
            self.equilibrium = bodies.under(self._load.array, self.admissible, jump.reductions)
            self.constraints = self.equilibrium.constraints

        self.offset = jump.gap + self.history.origin
        if jump.frames is not None:
            self.offset = self.offset - jump.of_displacement(jump.frames.rigid)
        self._is_refined = compliance.exact
        self._solved: tuple[Array, Array] | None = None  # multipliers and u, for a direct solver
        self._compute_b(LOAD_ACCURACY)

        # squares of lengths and forces must neither overflow nor underflow
        largest_force = self._load.norm(PETSc.NormType.INFINITY)
        (largest_length,) = largest_abs(jump.comm, self.b)
        least = 1.0 / LARGEST_ENTRY
        for name, entry in (("load", largest_force), ("displacement it causes", largest_length)):
            if entry > LARGEST_ENTRY or (largest_length < least and 0.0 < entry < least):
                raise InputError(
                    f"the {name} has entries up to {entry:.1e}: squares of such numbers cannot be "
                    "computed. Choose units in which they are nearer to 1."
                )

    def _compute_b(self, rtol: float) -> None:
        """Compute b from the displacement without contact, and update the guess. Collective."""
        u, guess = self._u, self._guess
        u.array = 0.0 if self._load.norm() == 0.0 else guess.load  # exactly zero without load
        self.b_error = self._solver.improve(self._load, u, rtol=rtol, accuracy=0.0)
        if guess.newest is not None:  # the load may have changed: add the change of K^-1 f
            guess.newest = guess.newest + u.array - guess.load
        guess.load = u.array.copy()
        self.b = self.jump.of_unknowns(u) - self.offset

    @property
    def b_terms(self) -> Array:
        """The sums (size,) of the absolute values of the terms of b, which may cancel."""
        return np.asarray(np.abs(self.b + self.offset) + np.abs(self.offset))

    def refine_b(self) -> None:
        """Compute b again, once, to the highest accuracy of the solver for K. Collective."""
        if self._is_refined:
            return
        self._is_refined = True
        self._compute_b(FULL_ACCURACY)
        self._u.array = self._guess.load
        # includes rounding, which the iteration does not see
        self.b_error = max(self.b_error, self._solver.error(self._load, self._u))

    def gradient(self, x: Array, accuracy: float) -> tuple[Array, float]:
        """Return r = A x - b, and an estimate of its error, sqrt(e'A^-1 e). Collective.

        A direct solver takes one product, unless x is zero; its error counts as 0. An iterative
        solver starts from the last displacement (`_guessed`), and solves to the requested error
        `accuracy` only; if it stops before, the returned error is larger. A solve counts as a
        product if it takes any Krylov iteration. The error includes the rounding of r: A times a
        step is a difference of gradients, which may be pure rounding if the step is small.
        """
        if self._solver.exact:
            if float(self.inner(x, x)) > 0.0:
                return self.compliance.apply(x) - self.b, 0.0
            return -self.b, 0.0
        before = self._solver.krylov_iterations
        error = self._solve_from_guess(x, self._u, FULL_ACCURACY, accuracy)
        self.compliance.products += self._solver.krylov_iterations > before
        self._guess.newest = self._u.array.copy()
        r = self.gradient_of(self._u)
        # rounding e of r, whose terms are the offset and B u = offset - r; e'A^-1 e is estimated
        # from above, since no node is stiffer than with fixed neighbours
        terms = np.abs(self.offset) + np.abs(self.offset - r)
        square = float(self.inner(terms, self.compliance.nodal_stiffness * terms))
        rounding = 0.5 * np.finfo(float).eps * np.sqrt(square)
        return r, float(np.hypot(error, rounding))

    def _solve_from_guess(self, x: Array, u: PETSc.Vec, rtol: float, accuracy: float) -> float:
        """Set u to K^-1 (f - B'x) by a solve from `_guessed`; return the error. Collective."""
        u.array = self._guessed(x)
        return self._solver.improve(self.jump.net_force(x), u, rtol=rtol, accuracy=accuracy)

    def _guessed(self, x: Array) -> Array:
        """Return the guess of K^-1 (f - B'x): `InitialGuess.load` for x = 0, else `newest`."""
        newest = self._guess.newest
        if newest is None or float(self.inner(x, x)) == 0.0:
            return self._guess.load
        return newest

    def gradient_of(self, u: PETSc.Vec) -> Array:
        """Return (d; s) - B u, (size,): the gradient at x for u = K^-1 (f - B'x). Collective."""
        return self.offset - self.jump.of_unknowns(u)

    def compute_displacement(self, x: Array, u: PETSc.Vec, accuracy: float | None = None) -> float:
        """Set u to K^-1 (f - B'x) after the iteration; return the error of u. Collective.

        The error in the energy norm may be `accuracy`; with None, the options of the solver decide.
        The next solve starts from u. A direct solver ignores `accuracy`, and solves unless u is
        known. With an iterative solver, u is the displacement of the last gradient if this is
        accurate enough: its convergence was checked, and a more accurate displacement may have a
        larger `energy_bound`, which closes gaps by moving contact nodes alone: this takes much
        energy if the difference of displacements is smooth and cells are flat.
        """
        solved = self._solved
        if solved is not None and float(self.inner(x - solved[0], x - solved[0])) == 0.0:
            u.array = solved[1]
        elif accuracy is None or self._solver.exact:
            self._solver.solve(self.jump.net_force(x), u)
        else:
            u.array = self._guessed(x)
            if self._solver.error(self.jump.net_force(x), u) > SLACK * accuracy:
                self._solve_from_guess(x, u, FULL_ACCURACY, accuracy)
        self._guess.newest = u.array.copy()
        # includes rounding, which an iteration does not see
        return self._solver.error(self.jump.net_force(x), u)

    def energy_norm(self, x: Array, r: Array, error: float = 0.0) -> float:
        """Return |u|_K = sqrt(a(u, u)) for u = K^-1 (f - B'x), from energies. Collective.

        The gradient r is A x - b, without G c, and u is without rigid displacements. The result is
        0 if the `error` of u hides |u|_K^2. The first call may need a solve (`_load_terms`).
        """
        energy, jump_of_forces = self._load_terms
        # u = K^-1 f - K^-1 B'x: |u|^2 = f'K^-1 f - 2 x'B K^-1 f + x'A x, where A x = r + b; in the
        # middle term only forces count, since K^-1 B'x is zero where displacements are prescribed
        square = energy + float(self.inner(x, r + self.b - 2.0 * jump_of_forces))
        # the square is a difference of energies; an error e of u changes it by 2 e |K^-1 f|_K
        resolved = square > 2.0 * error * float(np.sqrt(energy))
        return float(np.sqrt(square)) if resolved and square > 0.0 else 0.0

    def energy_resolution(self) -> float:
        """Return the energy norm below which a displacement K^-1 (f - B'x) is rounding. Collective.

        Such a displacement is the small difference of K^-1 f and K^-1 B'x, which both have about
        the norm of K^-1 f: contact carries all loads. The result is NaN if the solver for K missed
        the accuracy of K^-1 f, so that nothing is known. The first call may need a solve with K.
        """
        energy, _ = self._load_terms
        if self.b_error > ROUGH * np.sqrt(energy):
            return np.nan
        # rounding is relative to the energy, which is a difference of energies: hence the root
        return max(float(np.sqrt(ROUNDING * energy)), self.b_error)

    @cached_property
    def _load_terms(self) -> tuple[float, Array]:
        """a(u, u) for u = K^-1 f, and the jump (size,) that forces alone cause. Collective.

        Prescribed values may take a solve. The energy includes that of the springs that fix bodies.
        """
        system, springs, u = self.jump.system, self.compliance.springs, self._u
        u.array = self._guess.load
        energy = 2.0 * system.strain_energy(u)
        if springs is not None:
            stretch = reduce_array(springs.modes.comm, springs.columns.T @ u.array)
            energy += float(stretch @ stretch)
        jump_of_forces = self.b + self.offset
        prescribed_values = system.f.x.array[: len(system.moves)][~system.moves]
        if system.comm.allreduce(bool(prescribed_values.any()), op=MPI.LOR):
            forces = system.assemble_forces()
            u.set(0.0)
            if forces.x.petsc_vec.norm() > 0.0:
                self._solver.improve(forces.x.petsc_vec, u, rtol=LOAD_ACCURACY, accuracy=0.0)
            jump_of_forces = self.jump.of_unknowns(u)
        return max(energy, 0.0), jump_of_forces  # the energy of a rigid motion is rounding

    def section_at(self, x: Array, r: Array) -> FeasibleSet:
        """Return Lambda with the slip bounds at the pressures of x and the slips of r."""
        return self.admissible.at_point(x, r).section(x)

    def energy_bound(self, x: Array, r: Array, error: float) -> float:
        """Return a bound of |u - u*|_K; u is at x, with an `error`, u* the solution. Collective."""
        return self.compliance.error_bound.energy_bound(self.section_at(x, r), x, r, error)

    def local_minimiser(self, x: Array, r: Array) -> Array:
        """Return x - `nodal_stiffness` r (size,), the minimiser of q node by node. Not collective.

        The projection of these multipliers onto Lambda is the state that each node would take if
        the displacements of its neighbours were fixed: pressed or open, sticking or slipping.
        """
        return x - self.compliance.nodal_stiffness * r

    def local_error(self, x: Array, r: Array) -> float:
        """Return `local_change` relative to the largest traction; 0 for rounding. Collective."""
        change, largest_traction, rounding = self.local_change(x, r)
        return relative_change(change, largest_traction, rounding)

    def local_change(self, x: Array, r: Array) -> tuple[float, float, float]:
        """Return the largest change of a node's traction to its local minimum of q. Collective.

        The change is that from x to the projection of `local_minimiser` onto Lambda. The result is
        the change, the largest traction, and the largest rounding error of tractions [stress]. (If
        springs alone carry the loads, tractions and changes are rounding errors of the jumps.)
        """
        change = x - self.section_at(x, r).project(self.local_minimiser(x, r))
        # the terms of r are the offset and B u = offset - r: their rounding changes tractions
        terms = self.compliance.nodal_stiffness * (np.abs(self.offset) + np.abs(self.offset - r))
        stresses = np.stack([change, x, terms]) * self.jump.stress_scale  # (3, size)
        discs = self.jump.discs
        pressures = np.abs(stresses[:, discs.normal])
        tractions = np.array([discs.norms(values) for values in stresses])  # (3, discs)
        maxima = np.column_stack([pressures, tractions]).max(axis=1, initial=0.0)
        largest_change, largest, term = reduce_array(self.jump.comm, maxima, MPI.MAX)
        return float(largest_change), float(largest), ROUNDING * float(term)

    def in_equilibrium(self, x: Array, u: PETSc.Vec, c: Array) -> tuple[Array, float]:
        """Add the rigid displacements of floating bodies to u. Collective.

        Before the call, u is K^-1 (f - B'x). The result is the gradient A x - b - G c, and the
        energy norm of the rigid displacements that equilibrium with soft springs still lacks.
        """
        r = self.gradient_of(u)
        if self.equilibrium is None:
            return r, 0.0
        r = r - self.constraints.columns @ c
        return r, self.equilibrium.add_rigid_displacements(x, u, c)

    def jump_of_tools(self, c: Array) -> Array:
        """Return G c (size,) for the motions of tools alone, which are not part of u."""
        return np.asarray(self.constraints.columns[:, self.of_tools] @ c[self.of_tools])

    def discretisation_error(self, x: Array, c: Array) -> float:
        """Return an estimate of the relative error of the mesh in the energy norm. Collective.

        A direct solver makes one solve; an iterative one improves the last displacement to `ROUGH`.
        The estimate is zero without displacement, and infinite without a form of the displacement.
        """
        if not self.jump.system.form_of_displacement:
            return np.inf
        u = fem.Function(self.jump.system.V)
        vector = u.x.petsc_vec
        self._solve_from_guess(x, vector, ROUGH, 0.0)
        if self.compliance.exact:
            self._solved = x.copy(), vector.array.copy()
        self.in_equilibrium(x, vector, c)
        u.x.scatter_forward()
        norm = self.norm_of(u)
        return total(self.compliance.estimator.cell_errors(u)) / norm if norm > 0.0 else 0.0

    def norm_of(self, u: fem.Function) -> float:
        """Return |u|_K = sqrt(a(u, u)). Collective."""
        square = 2.0 * self.jump.system.strain_energy(u.x.petsc_vec)
        return float(np.sqrt(max(square, 0.0)))

    def energies(self, x: Array, u: PETSc.Vec, c: Array, error: float = 0.0) -> tuple[float, float]:
        """Return the primal energy of u and the dual energy of x [energy]. Collective.

        J(u) = 1/2 u'K u - f'u + sum g |T u - s|, with the sum over finite g, and
        D(x) = 1/2 u'K u - f'u - x'r - error^2 / 2, with the gradient r = (d; s) - B u and the
        `error` of u in the energy norm. Rows of prescribed degrees of freedom are left out of u'K u
        and f'u. Forces on tools are part of f, and their motions of B u.
        """
        system = self.jump.system
        force = system.K.createVecLeft()
        system.K.mult(u, force)
        not_prescribed = np.where(system.prescribed, 0.0, u.array)
        elastic = float(self.inner(not_prescribed, system.signs * force.array))
        free = np.where(system.moves, u.array, 0.0)
        work = float(self.inner(free, system.f.x.petsc_vec.array))
        r = self.gradient_of(u) - self.jump_of_tools(c)
        work += float(self.constraints.values[self.of_tools] @ c[self.of_tools])
        friction = reduce_array(self.jump.comm, self.section_at(x, r).dissipation(r))
        energy = 0.5 * elastic - work
        primal = energy + float(friction)
        dual = energy - float(self.inner(x, r)) - 0.5 * error**2
        return primal, dual


def relative_change(change: float, value: float, rounding: float = 0.0) -> float:
    """Return change / value; 0 if the change is rounding, and 1 if only the value is zero."""
    if change <= rounding:
        return 0.0
    return change / value if value > 0.0 else 1.0
