"""The quadratic program (38.4) of one solve, with energies and their errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.compliance import ContactCompliance
from dolfinx_tresca.dual.estimate import total
from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.response import ElasticResponse
from dolfinx_tresca.dual.slip_bounds import NodalBounds
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.floating.equilibrium import Equilibrium
from dolfinx_tresca.optimise.constraints import EqualityConstraints
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.friction_cones import FrictionCones
from dolfinx_tresca.optimise.products import ProductStore

#: Relative error of one operation in double precision.
UNIT_ROUNDOFF = 0.5 * float(np.finfo(float).eps)

#: Change of tractions that is rounding, over the tractions that move nodes by as much as the
#: jumps that it is computed from.
TRACTION_ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class DualProgram:
    """What the algorithms of `dolfinx_tresca.optimise` are given: A, b, Lambda, and energies.

    Put together for each solve from its parts.

    Attributes:
        compliance: A, and what else belongs to K.
        response: the displacement that belongs to multipliers, under the present load.
        admissible: all multipliers that the present laws of friction allow.
        equilibrium: of floating bodies under the present load; None if there are none.
        constraints: the equations that multipliers satisfy besides Lambda: those of equilibrium.
        history: of the load steps before.
        is_first: whether no product was known before.
    """

    compliance: ContactCompliance
    response: ElasticResponse
    admissible: FeasibleSet | FrictionCones
    equilibrium: Equilibrium | None
    constraints: EqualityConstraints
    history: SlipHistory
    is_first: bool

    @classmethod
    def of(
        cls,
        compliance: ContactCompliance,
        guess: InitialGuess,
        slip_bounds: Sequence[NodalBounds],
        history: SlipHistory | None = None,
    ) -> DualProgram:
        """Return the program for the system's present load: one solve with K. Collective.

        Args:
            compliance: for K.
            guess: of displacements, from earlier solves.
            slip_bounds: at each pair's nodes.
            history: of the load steps before; None if there were none.

        Raises:
            InputError: a body floats and contact cannot hold it, or the load is no number that
                can be squared.
        """
        jump = compliance.jump
        history = SlipHistory.none(jump) if history is None else history
        admissible = jump.bounded(slip_bounds)
        equilibrium = None
        constraints = EqualityConstraints.none(admissible.size, jump.reductions)
        if compliance.floating is not None:
            load = jump.system.f.x.petsc_vec.array
            equilibrium = compliance.floating.under(load, admissible, jump.reductions)
            constraints = equilibrium.constraints
        response = ElasticResponse(compliance.operator, guess, compliance.springs, history.origin)
        first = not compliance.used
        return cls(compliance, response, admissible, equilibrium, constraints, history, first)

    @cached_property
    def feasible_set(self) -> FeasibleSet:
        """Lambda; where bounds depend on the pressure that of no pressure."""
        return self.admissible.section(np.zeros(self.admissible.size))

    def section(self, x: Array) -> DualProgram:
        """Return the program with the slip bounds that belong to the pressures of x (size,)."""
        lam = self.admissible.section(x)
        return self if lam is self.admissible else dataclasses.replace(self, admissible=lam)

    def relaxed(self, part: float, softness: float, c: Array) -> DualProgram:
        """Return the program with a part of the coefficients of friction, and softer constraints.

        Args:
            part: of the coefficients.
            softness: what is added to the diagonal of the constraints' S.
            c: (k,) multipliers of the constraints at which that changes nothing.
        """
        return dataclasses.replace(
            self,
            admissible=self.admissible.weakened(part),
            constraints=self.constraints.softened(softness, c),
        )

    @property
    def continues(self) -> bool:
        """Whether this is a step of a process, after one that was accepted."""
        return self.history.begun

    @property
    def jump(self) -> JumpOperator:
        """B."""
        return self.compliance.jump

    @property
    def b(self) -> Array:
        """The linear term (size,)."""
        return self.response.b

    @property
    def b_error(self) -> float:
        """Error of b, in the norm of `gradient`, which a gradient has at zero but nowhere else."""
        return self.response.b_error

    def sharpen_b(self) -> None:
        """Make b as accurate as the solver for K can. Collective."""
        self.response.sharpen()

    @property
    def products(self) -> int:
        """How often A was applied."""
        return self.compliance.operator.products

    @property
    def exact(self) -> bool:
        """Whether products are exact to rounding, whatever accuracy is asked for."""
        return self.compliance.operator.exact

    @property
    def product_error(self) -> float:
        """Largest error of `apply` so far, in the norm of `gradient`, over sqrt(x'A x)."""
        return self.compliance.operator.product_error

    @property
    def store(self) -> ProductStore:
        """The products known so far; the first call for a K makes some. Collective."""
        return self.compliance.store

    @property
    def near_store(self) -> ProductStore | None:
        """Known products with the near field; None where it does not pay. Collective."""
        return self.compliance.near_store(self.is_first)

    def apply(self, x: Array) -> Array:
        """Return A x. Collective."""
        return self.compliance.operator.apply(x)

    def gradient(
        self, x: Array, accuracy: float, origin: Array | None = None
    ) -> tuple[Array, float]:
        """Return r = A x - b, and an estimate of its error. Collective.

        With rounding of r, since products are differences of gradients: of steps that are small
        against gaps it may be all that there is.
        """
        r, error = self.response.gradient(x, accuracy, origin)
        if self.exact:
            return r, error
        terms = np.abs(self.response.offset) + np.abs(self.response.offset - r)
        # e'A^-1 e by nodes that move alone, whose stiffness is at least that of A^-1
        square = float(self.inner(terms, self.compliance.nodal_stiffness * terms))
        return r, float(np.hypot(error, UNIT_ROUNDOFF * np.sqrt(square)))

    def near_field(self, x: Array) -> Array:
        """Return what A x would be if all were clamped a few cells from the contact. Collective."""
        return self.compliance.near_field.apply(x)

    def inner(self, x: Array, y: Array) -> Array:
        """Return x'y over all ranks; (size,) or (size, k) each. Collective."""
        return self.jump.reductions.inner(x, y)

    def agreed(self, x: Array) -> Array:
        """Return the first rank's x, which others have but for rounding. Collective."""
        return self.jump.reductions.agreed(x)

    def least(self, value: float) -> float:
        """Return the least value of all ranks. Collective."""
        return self.jump.reductions.least(value)

    def energy_bound(self, x: Array, r: Array, error: float) -> float:
        """Return a bound of |u - u*|_K for the displacement u at x in Lambda. Collective.

        Args:
            x: (size,) multipliers.
            r: (size,) the gradient, from u.
            error: of r in the norm of `gradient`.
        """
        return self.compliance.certificate.at(self.feasible_set, x, r, error)

    def energy_norm(self, x: Array, r: Array, error: float = 0.0) -> float:
        """Return |u|_K = sqrt(a(u, u)) for the displacement at x; 0 below its error. Collective.

        Args:
            x: (size,) multipliers.
            r: (size,) the gradient, from u.
            error: of r in the norm of `gradient`.
        """
        return self.response.energy_norm(x, r, error)

    @property
    def energy_resolution(self) -> float:
        """Energy norm [energy^(1/2)] below which a displacement is rounding. Collective."""
        return self.response.energy_resolution

    def by_itself(self, x: Array, r: Array) -> Array:
        """Return multipliers (size,), not in Lambda, that nodes would have if others did not move.

        Those of a node in P_Lambda of this are what it would go to; the face it lies on says which
        nodes press, stick and slip, also before the last digits are there. Not collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        return x - self.compliance.nodal_stiffness * r

    def local_error(self, x: Array, r: Array) -> float:
        """Return `local_change` over the largest traction; 0 where it is rounding. Collective.

        Where springs alone bear the loads, tractions are rounding of the jumps, and so are their
        changes.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        change, traction = self.local_change(x, r)
        offset = self.response.offset
        stresses = self._largest_stress(
            self.compliance.nodal_stiffness * (np.abs(offset) + np.abs(offset - r))
        )
        if change <= TRACTION_ROUNDING * reduce_array(self.jump.comm, stresses, MPI.MAX):
            return 0.0
        return change / traction if traction > 0.0 else float(change > 0.0)

    def local_change(self, x: Array, r: Array) -> tuple[float, float]:
        """Return the largest change of a node's tractions if it moved by itself. Collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.

        Returns:
            the change and the largest traction [stress].
        """
        change = x - self.feasible_set.project(self.by_itself(x, r))
        sizes = [self._largest_stress(one) for one in (change, x)]
        largest, traction = reduce_array(self.jump.comm, sizes, MPI.MAX)
        return float(largest), float(traction)

    def _largest_stress(self, x: Array) -> float:
        """Return the largest pressure or traction of this rank's multipliers. Not collective."""
        nodes, stress = self.jump.unbounded, x * self.jump.stress_scale
        return max(
            float(np.abs(stress[nodes.normal]).max(initial=0.0)),
            float(nodes.norms(stress).max(initial=0.0)),
        )

    def in_equilibrium(self, x: Array, u: PETSc.Vec, c: Array) -> tuple[Array, float]:
        """Add the rigid displacements of floating bodies to u. Collective.

        Args:
            x: (size,) multipliers.
            u: the response to x.
            c: (k,) multipliers of the constraints.

        Returns:
            the gradient, with the constraints', and the energy norm of what u lacks for
            equilibrium.
        """
        r = self.response.gradient_of(u)
        if self.equilibrium is None:
            return r, 0.0
        return r - self.constraints.columns @ c, self.equilibrium.move(x, u, c)

    def discretisation_error(self, x: Array, rho: float) -> float:
        """Return an estimate of the mesh's error in the energy norm, over |u|. Collective.

        Needs a solve with K if that is direct. Zero without displacement; infinite where the form
        does not tell.

        Args:
            x: (size,) multipliers.
            rho: a step length.
        """
        if not self.jump.system.form_of_displacement:
            return np.inf
        u = fem.Function(self.jump.system.V)
        self.response.known(x, u.x.petsc_vec)
        r = self.response.gradient_of(u.x.petsc_vec)
        c = self.constraints.multipliers(self.admissible.section(x), x, r, rho)
        self.in_equilibrium(x, u.x.petsc_vec, c)
        u.x.scatter_forward()
        norm = self.norm_of(u)
        return total(self.compliance.estimator.of(u)) / norm if norm > 0.0 else 0.0

    def norm_of(self, u: fem.Function) -> float:
        """Return |u|_K = sqrt(a(u, u)). Collective."""
        return float(np.sqrt(max(2.0 * self.jump.system.strain_energy(u.x.petsc_vec), 0.0)))

    def energies(self, x: Array, u: PETSc.Vec, error: float = 0.0) -> tuple[float, float]:
        """Return the primal energy of u and the dual energy of x [energy]. Collective.

        J(u) = 1/2 u'K u - f'u + sum g |T u - s|, over finite g, and D(x) = 1/2 u'K u - f'u - x'r
        with the gradient r = (d; s) - B u, less what u lacks to be a minimiser; over the degrees
        of freedom that are not prescribed.

        Args:
            x: multipliers in Lambda.
            u: K^-1 (f - B'x), about.
            error: of u in the energy norm.
        """
        system = self.jump.system
        force = u.duplicate()
        system.K.mult(u, force)
        inside = np.where(system.prescribed, 0.0, u.array)
        elastic = float(self.inner(inside, system.signs * force.array))
        force.destroy()
        work = float(self.inner(np.where(system.moves, u.array, 0.0), system.f.x.petsc_vec.array))
        r = self.response.gradient_of(u)
        friction = reduce_array(self.jump.comm, self.feasible_set.dissipation(r))
        energy = 0.5 * elastic - work
        dual = energy - float(self.inner(x, r)) - 0.5 * error**2
        return energy + float(friction), dual
