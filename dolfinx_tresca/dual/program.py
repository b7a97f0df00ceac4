"""The quadratic program (38.4), with energies, their errors, and what the mesh makes of them."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._parallel import reduce_array
from dolfinx_tresca.dual.certificate import EnergyBound
from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.dual.operator import LOAD, DualOperator
from dolfinx_tresca.estimate import DiscretisationError, total
from dolfinx_tresca.stiffness.loose_motions import LooseMotions
from dolfinx_tresca.stiffness.solver import StiffnessSolver


class DualProgram(DualOperator):
    """What the algorithms of `dolfinx_tresca.solvers` are given: A, b, Lambda, and energies."""

    def __init__(self, *arguments: Any) -> None:
        """Assemble B; the arguments are those of `DualOperator`. Collective."""
        self._energy_bound: EnergyBound | None = None
        self._estimator: DiscretisationError | None = None
        super().__init__(*arguments)
        self._load_terms: tuple[float, Array] | None = None

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        if self._energy_bound is not None:
            self._energy_bound.destroy()
        super().destroy()

    def update_load(self) -> None:
        """Compute b for the system's present load: one solve with K. Collective."""
        super().update_load()
        self._load_terms = None

    def update_stiffness(self, solver: StiffnessSolver, loose: LooseMotions | None) -> None:
        """Go on with the system's present K, its solver and loose motions. Collective."""
        if self._energy_bound is not None:
            self._energy_bound.destroy()
            self._energy_bound = None
        self._estimator = None
        super().update_stiffness(solver, loose)

    def error_of(self, x: Array, u: PETSc.Vec) -> float:
        """Return |u - K^-1 (f - B'x)|_K, as the solver for K estimates it. Collective."""
        return self.solver.error(self.net_force(x), u)

    def energy_bound(self, x: Array, r: Array, error: float) -> float:
        """Return a bound of |u - u*|_K for the displacement u at x in Lambda. Collective.

        Args:
            x: (size,) multipliers.
            r: (size,) the gradient, from u.
            error: of r in the norm of `gradient`.
        """
        return self._certificate.at(self.feasible_set, x, r, error)

    @property
    def _certificate(self) -> EnergyBound:
        """Bounds energy errors for the present K. Collective."""
        if self._energy_bound is None:
            self._energy_bound = EnergyBound(self.system, self.B, self.local_stiffness)
        return self._energy_bound

    def by_itself(self, x: Array, r: Array) -> Array:
        """Return multipliers (size,), not in Lambda, that nodes would have if others did not move.

        Those of a node in P_Lambda of this are what it would go to; the face it lies on says which
        nodes press, stick and slip, also before the last digits are there. Collective.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        return x - self.feasible_set.mean_over_discs(self.local_stiffness) * r

    def local_error(self, x: Array, r: Array) -> float:
        """Return how far tractions are from where their nodes would go by themselves. Collective.

        Over the largest traction of all; 0 where there is none to begin with.

        Args:
            x: (size,) in Lambda.
            r: (size,) the gradient there.
        """
        lam = self.feasible_set
        change = (x - lam.project(self.by_itself(x, r))) * self.scale
        sizes = [
            max(np.abs(v[lam.normal]).max(initial=0.0), lam.norms(v).max(initial=0.0))
            for v in (change, x * self.scale)
        ]
        largest, traction = reduce_array(self.system.comm, sizes, MPI.MAX)
        return float(largest / traction) if traction > 0.0 else float(largest > 0.0)

    def energy_norm(self, x: Array, r: Array) -> float:
        """Return |u|_K = sqrt(a(u, u)) for the displacement at x; the gradient is r. Collective.

        Without what the rigid motions of bodies on soft springs add.

        The first call for a load may need a solve with K, if forces act and displacements are
        prescribed.
        """
        if self._load_terms is None:
            self._load_terms = self._compute_load_terms()
        energy, jump = self._load_terms
        square = energy + float(self.inner(x, r + self.b - 2.0 * jump))
        return float(np.sqrt(max(square, 0.0)))

    def norm_of(self, u: fem.Function) -> float:
        """Return |u|_K = sqrt(a(u, u)). Collective."""
        return float(np.sqrt(max(2.0 * self.system.strain_energy(u.x.petsc_vec), 0.0)))

    def _compute_load_terms(self) -> tuple[float, Array]:
        """Return a(u, u) without contact, and the jump that forces alone cause there."""
        energy = 2.0 * self.system.strain_energy(self._known.load)
        if self._loose is not None:
            energy += self._loose.support_energy(self._known.load)
        if self.system.prescribes_zero:
            return energy, self.b + self._gap
        forces = self.system.assemble_forces()
        if forces.x.petsc_vec.norm() == 0.0:
            return energy, np.zeros_like(self.b)
        self._u.set(0.0)
        self.solver.improve(forces.x.petsc_vec, self._u, rtol=LOAD, accuracy=0.0)
        return energy, self.jump(self._u)

    @property
    def estimator(self) -> DiscretisationError:
        """Estimates the error of the mesh. Collective."""
        if self._estimator is None:
            self._estimator = DiscretisationError(self.system.form, self.system.V)
        return self._estimator

    def discretisation_error(self, x: Array, rho: float) -> float:
        """Return an estimate of the mesh's error in the energy norm, over |u|. Collective.

        Needs a solve with K. Zero without displacement.

        Args:
            x: (size,) multipliers.
            rho: a step length.
        """
        u = fem.Function(self.system.V)
        self.displacement(x, u.x.petsc_vec)
        r = self._gap - self.jump(u.x.petsc_vec)
        rigid = self.feasible_set.settled_motions(x, r, rho)
        self.add_rigid_motions(x, u.x.petsc_vec, rigid)
        u.x.scatter_forward()
        norm = self.norm_of(u)
        return total(self.estimator.of(u)) / norm if norm > 0.0 else 0.0

    def energies(self, x: Array, u: PETSc.Vec, error: float = 0.0) -> tuple[float, float]:
        """Return the primal energy of u and the dual energy of x [energy]. Collective.

        J(u) = 1/2 u'K u - f'u + sum g |T u|, over finite g, and D(x) = 1/2 u'K u - f'u - x'r with
        the gradient r = d - B u, less what u lacks to be a minimiser; over the degrees of freedom
        that are not prescribed.

        Args:
            x: multipliers in Lambda.
            u: K^-1 (f - B'x), about.
            error: of u in the energy norm.
        """
        prescribed = self.system.prescribed
        force = self._force
        self.system.K.mult(u, force)
        inside = np.where(prescribed, 0.0, u.array)
        elastic = float(self.inner(inside, force.array))
        work = float(self.inner(inside, self.system.f.x.petsc_vec.array))
        friction = reduce_array(self.system.comm, self.feasible_set.dissipation(self.jump(u)))
        energy = 0.5 * elastic - work
        dual = energy - float(self.inner(x, self._gap - self.jump(u))) - 0.5 * error**2
        return energy + float(friction), dual
