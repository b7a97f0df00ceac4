"""The quadratic program (38.4) of one solve, with energies and their errors."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.mesh_error import total
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.dual.response import ElasticResponse, InitialGuess
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.floating.equilibrium import Equilibrium, FloatingBodies, Tools
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes
from dolfinx_tresca.solvers.constraints import EqualityConstraints
from dolfinx_tresca.solvers.feasible_set import FeasibleSet

#: A node counts as about to change its contact state if a change of its traction by at most the
#: error of the tractions leads to another state. This number times the largest traction is the
#: least error that is assumed.
EDGE = 1e-9


class DualProgram:
    """The quadratic program of one solve: A, b, Lambda, constraints and energies.

    It is the input of the algorithms in `dolfinx_tresca.solvers`.

    Attributes:
        compliance: A, and all data that depend on K only.
        jump: B.
        operator: A.
        reductions: sums over all ranks, and values on which all ranks agree.
        response: the displacements caused by multipliers and the present load.
        admissible: all multipliers that the present laws of friction allow.
        equilibrium: equilibrium of tools, floating and softly held bodies; None if there are none.
        constraints: linear equations of the multipliers: this equilibrium.
        of_tools: positions of the motions of tools among the multipliers of the constraints.
        history: slip and dissipation of the accepted load steps.
        is_load_step: whether this is a load step of a process: a step was accepted before.
    """

    def __init__(
        self,
        compliance: ContactCompliance,
        guess: InitialGuess,
        slip_bounds: Sequence[NodalBounds],
        history: SlipHistory | None = None,
        tools: Tools | None = None,
    ) -> None:
        """Make the program for the system's present load, with one solve with K. Collective.

        Args:
            compliance: A for the present K.
            guess: displacements of earlier solves.
            slip_bounds: slip bounds at the nodes of each pair.
            history: slip of the accepted load steps; None if there is none.
            tools: obstacles and bolts with given forces; None if there are none.

        Raises:
            InputError: the load is too large or too small for floating-point numbers.
            MechanismError: contact cannot hold a floating body or a tool.
            StiffnessError: the solve failed.
        """
        jump = self.jump = compliance.jump
        self.compliance, self.operator = compliance, compliance.operator
        self.known_products = compliance.known_products
        self.complete_products = compliance.complete_products
        self.reductions, self.inner = jump.reductions, jump.reductions.inner
        self.history = SlipHistory.none(jump) if history is None else history
        self.is_load_step = self.history.begun
        self.admissible = jump.bounded(slip_bounds)
        self.equilibrium: Equilibrium | None = None
        self.constraints = EqualityConstraints.none(jump.row_nodes, jump.reductions)
        self.of_tools = slice(0)
        bodies, load = compliance.floating, jump.system.f.x.petsc_vec.array
        if tools is not None:
            if bodies is None:
                modes = RigidBodyModes.none(jump.system.V, tools.bodies)
                U, stiffness, jumps = (csr_array((n, 0)) for n in (len(load), 0, len(jump.gap)))
                bodies = FloatingBodies(modes, U, stiffness, jumps, jump.row_nodes)
            self.of_tools = slice(len(bodies.modes), None)
            bodies = bodies.with_tools(tools)
        if bodies is not None:
            self.equilibrium = bodies.under(load, self.admissible, jump.reductions)
            self.constraints = self.equilibrium.constraints
        self.response = ElasticResponse(compliance, guess, self.history.origin)

    @property
    def b(self) -> Array:
        """The linear term (size,)."""
        return self.response.b

    def bounds(self, x: Array, r: Array) -> FeasibleSet:
        """Return Lambda with the slip bounds at the pressures and slips of a point.

        Args:
            x: (size,) multipliers.
            r: (size,) gradient at x, with the terms of the equality constraints.
        """
        return self.admissible.at_point(x, r).section(x)

    def energy_bound(self, x: Array, r: Array, error: float) -> float:
        """Return a bound of |u - u*|_K for the displacement u at x in Lambda. Collective.

        Here u* is the exact solution of the discrete problem.

        Args:
            x: (size,) multipliers.
            r: (size,) the gradient, computed from u.
            error: error of r in the norm of `ElasticResponse.gradient`.
        """
        return self.compliance.certificate.energy_bound(self.bounds(x, r), x, r, error)

    def decoupled_minimiser(self, x: Array, r: Array) -> Array:
        """Return x - `nodal_stiffness` r, (size,): each node's minimiser with fixed neighbours.

        The projection of these multipliers onto Lambda is the state that each node would take if
        the displacements of its neighbours were fixed: pressed or open, sticking or slipping. Not
        collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) gradient at x.
        """
        return x - self.compliance.nodal_stiffness * r

    def local_error(self, x: Array, r: Array) -> float:
        """Return `local_change` divided by the largest traction; 0 for rounding. Collective.

        If springs alone carry the loads, the exact tractions are zero. The computed tractions and
        their changes are then rounding errors of the jumps, and their ratio means nothing.

        Args:
            x: (size,) in Lambda.
            r: (size,) gradient at x.
        """
        change, traction = self.local_change(x, r)
        offset = self.response.offset
        stresses = self._largest_stress(
            self.compliance.nodal_stiffness * (np.abs(offset) + np.abs(offset - r))
        )
        if change <= ROUNDING * reduce_array(self.jump.comm, stresses, MPI.MAX):
            return 0.0
        return change / traction if traction > 0.0 else float(change > 0.0)

    def local_change(self, x: Array, r: Array) -> tuple[float, float]:
        """Return the largest change of tractions from x to the nodes' own minimisers. Collective.

        The minimisers are the projection of `decoupled_minimiser` onto Lambda.

        Args:
            x: (size,) in Lambda.
            r: (size,) gradient at x.

        Returns:
            the change and the largest traction [stress].
        """
        change = x - self.bounds(x, r).project(self.decoupled_minimiser(x, r))
        sizes = [self._largest_stress(multipliers) for multipliers in (change, x)]
        largest, traction = reduce_array(self.jump.comm, sizes, MPI.MAX)
        return float(largest), float(traction)

    def _largest_stress(self, x: Array) -> float:
        """Return the largest pressure or traction of this rank's multipliers. Not collective."""
        nodes, stress = self.jump.discs, x * self.jump.stress_scale
        return max(
            float(np.abs(stress[nodes.normal]).max(initial=0.0)),
            float(nodes.norms(stress).max(initial=0.0)),
        )

    def in_equilibrium(self, x: Array, u: PETSc.Vec, c: Array) -> tuple[Array, float]:
        """Add the rigid displacements of floating bodies to u. Collective.

        Args:
            x: (size,) multipliers.
            u: the displacement K^-1 (f - B'x), to which the rigid displacements are added.
            c: (k,) multipliers of the constraints.

        Returns:
            the gradient including the term -G c of the constraints, and the energy norm of the
            rigid displacements that are still missing for equilibrium.
        """
        r = self.response.gradient_of(u)
        if self.equilibrium is None:
            return r, 0.0
        return r - self.constraints.columns @ c, self.equilibrium.move(x, u, c)

    def tool_motions(self, c: Array) -> Array:
        """Return the motions of all tools at multipliers c of the constraints."""
        return c if self.equilibrium is None else (self.equilibrium.factors * c)[self.of_tools]

    def jump_of_tools(self, c: Array) -> Array:
        """Return G c (size,) for the motions of tools alone."""
        return np.asarray(self.constraints.columns[:, self.of_tools] @ c[self.of_tools])

    def discretisation_error(self, x: Array, c: Array) -> float:
        """Return an estimate of the relative error of the mesh in the energy norm. Collective.

        A direct solver needs one solve with K, an iterative solver needs no solve, since its
        displacement is known. The estimate is zero without displacement, and infinite if the error
        cannot be estimated from the form.

        Args:
            x: (size,) multipliers.
            c: (k,) multipliers of the constraints.
        """
        if not self.jump.system.form_of_displacement:
            return np.inf
        u = fem.Function(self.jump.system.V)
        self.response.set_known_displacement(x, u.x.petsc_vec)
        self.in_equilibrium(x, u.x.petsc_vec, c)
        u.x.scatter_forward()
        norm = self.norm_of(u)
        return total(self.compliance.estimator.cell_errors(u)) / norm if norm > 0.0 else 0.0

    def norm_of(self, u: fem.Function) -> float:
        """Return |u|_K = sqrt(a(u, u)). Collective."""
        return float(np.sqrt(max(2.0 * self.jump.system.strain_energy(u.x.petsc_vec), 0.0)))

    def energies(self, x: Array, u: PETSc.Vec, c: Array, error: float = 0.0) -> tuple[float, float]:
        """Return the primal energy of u and the dual energy of x [energy]. Collective.

        J(u) = 1/2 u'K u - f'u + sum g |T u - s|, with the sum over finite g, and
        D(x) = 1/2 u'K u - f'u - x'r with the gradient r = (d; s) - B u. A bound for the error of u
        is subtracted from D. All sums are over the degrees of freedom that are not prescribed. The
        work of the forces on tools is part of f'u, and their motions are part of B u.

        Args:
            x: multipliers in Lambda.
            u: approximation of K^-1 (f - B'x).
            c: multipliers of the constraints.
            error: error of u in the energy norm.
        """
        system = self.jump.system
        force = system.K.createVecLeft()
        system.K.mult(u, force)
        inside = np.where(system.prescribed, 0.0, u.array)
        elastic = float(self.inner(inside, system.signs * force.array))
        work = float(self.inner(np.where(system.moves, u.array, 0.0), system.f.x.petsc_vec.array))
        r = self.response.gradient_of(u) - self.jump_of_tools(c)
        work += float(self.constraints.values[self.of_tools] @ c[self.of_tools])
        friction = reduce_array(self.jump.comm, self.bounds(x, r).dissipation(r))
        energy = 0.5 * elastic - work
        dual = energy - float(self.inner(x, r)) - 0.5 * error**2
        return energy + float(friction), dual


def at_edge(dual: DualProgram, x: Array, r: Array) -> tuple[int, int]:
    """Return how many rows and discs of this rank are about to change their state. Collective.

    Within the accuracy of the solution, these rows and discs may have either state, so that
    derivatives of goals are one-sided.

    Args:
        dual: the problem.
        x: (size,) multipliers of the solution.
        r: (size,) gradient at x.

    Returns:
        numbers of normal rows between pressed and open, and of discs between stick and slip.
    """
    lam, scale = dual.bounds(x, r), dual.jump.stress_scale
    change, traction = dual.local_change(x, r)
    limit = max(change, EDGE * traction)
    target = dual.decoupled_minimiser(x, r)
    rows = int((np.abs(target * scale)[lam.normal] <= limit).sum())
    return rows, int(discs_at_edge(lam, target, scale, limit).sum())


def discs_at_edge(lam: FeasibleSet, target: Array, stress_scale: Array, error: float) -> Mask:
    """Return whether the minimiser of each disc lies on its circle, within the error.

    The result is an array (n_discs,), False for discs without friction.

    Args:
        lam: Lambda, whose radii are the slip bounds.
        target: (size,) minimisers of the nodes, see `DualProgram.decoupled_minimiser`.
        stress_scale: (size,) factors from multipliers to stresses.
        error: error of a traction [stress].
    """
    scale = np.ones(len(lam.radius))
    scale[lam.node] = stress_scale[lam.tangential]
    has_friction = np.isfinite(lam.radius) & (lam.radius > 0.0)
    distance = np.abs(lam.norms(target) - np.where(has_friction, lam.radius, 0.0)) * scale
    return np.asarray(has_friction & (distance < error))
