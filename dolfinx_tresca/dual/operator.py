"""The dual operator A = B K^-1 B' on distributed vectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._owner import PetscOwner
from dolfinx_tresca._parallel import broadcast_array, reduce_array
from dolfinx_tresca.dual.feasible_set import Array, FeasibleSet
from dolfinx_tresca.dual.known_displacements import KnownDisplacements
from dolfinx_tresca.dual.local_stiffness import local_stiffness
from dolfinx_tresca.dual.loose_bodies import LooseBodies
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators, assemble_B, multiplier_slices
from dolfinx_tresca.stiffness.loose_motions import LooseMotions
from dolfinx_tresca.stiffness.solver import StiffnessSolver
from dolfinx_tresca.stiffness.system import LinearSystem

#: Relative accuracy of the displacement without contact, in the energy norm.
LOAD = 1e-6

#: Largest number whose square, times what else there is, is a number.
LARGEST = 1e140

#: Relative accuracy in the energy norm that is exact in double precision.
EXACT = 1e-13


class DualOperator(PetscOwner):
    """A, b and Lambda of (38.4), in multipliers scaled by the square root of their node's area.

    Where bodies are loose K stands for K_p, which has springs on their supports (`LooseMotions`),
    and Lambda for the multipliers that balance loads (`BalancedSet`).

    Vectors are numpy arrays with this rank's rows: for each pair its normal multipliers, then its
    tangential ones. Physical tractions are `scale` times them.

    Owns PETSc objects: call `destroy()`. The linear system and the solver stay the caller's.

    Attributes:
        B: the `PETSc.Mat` (N; T) of all pairs, rows times sqrt(area).
        b: the linear term B K^-1 f - (d; 0), after `update_load()`.
        diagonal: an estimate of diag(A); set by whoever needs it (dual/diagonal.py).
        feasible_set: Lambda, after `update_bounds()`.
        products: how often A was applied.
        local_stiffness: (size,) what resists each row of B where its nodes move alone.
        slices: the positions of each pair's normal and tangential multipliers.
        scale: (size,) 1 / sqrt(area): stress over multiplier, and length over residual.
    """

    b: Array
    diagonal: Array
    feasible_set: FeasibleSet

    def __init__(
        self,
        system: LinearSystem,
        solver: StiffnessSolver,
        pairs: Sequence[PairOperators],
        loose_motions: LooseMotions | None = None,
    ) -> None:
        """Assemble B. Collective."""
        self.system = system
        self.pairs, self.slices = list(pairs), multiplier_slices(pairs)
        self.products = 0
        self._accuracy: float | None = None
        self.B = assemble_B(system.V, pairs)
        self._multipliers, self._jump = self.B.createVecLeft(), self.B.createVecLeft()
        self._force, self._u = self.B.createVecRight(), self.B.createVecRight()
        self._known = KnownDisplacements(self.B.createVecRight(), self.inner)
        areas = [pair.weights[pair.row_node] for pair in pairs]
        self.scale = 1.0 / np.sqrt(np.concatenate(areas))
        self._gap = np.zeros(len(self.scale))
        for pair, (normal, _) in zip(self.pairs, self.slices, strict=True):
            self._gap[normal] = pair.gap[pair.normal_node] / self.scale[normal]
        self.update_stiffness(solver, loose_motions)

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self.system.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._known.destroy()
        for owned in (self._multipliers, self._jump, self._force, self._u, self.B):
            owned.destroy()

    def update_load(self) -> None:
        """Compute b for the system's present load: one solve with K. Collective.

        An iterative solver makes b as accurate as `LOAD` says: the scale of residuals and the
        reported q depend on it, gradients do not.

        Raises:
            InputError: it is too large or too small for floating-point numbers.
        """
        self.solver.check_ready()
        load = self.system.f.x.petsc_vec
        if load.norm() > 0.0:
            self._known.load.copy(self._u)
        else:
            self._u.set(0.0)  # what is not loaded is at rest, exactly
        self.solver.improve(load, self._u, rtol=LOAD, accuracy=0.0)
        self._known.set_load(self._u)
        self.b = self.jump(self._u) - self._gap
        self._check_units()
        self._accuracy = None

    def _check_units(self) -> None:
        """Check that squares of lengths and forces are numbers. Collective."""
        force = self.system.f.x.petsc_vec.norm(PETSc.NormType.INFINITY)
        largest = float(reduce_array(self.system.comm, np.abs(self.b).max(initial=0.0), MPI.MAX))
        for name, size in (("load", force), ("displacement it causes", largest)):
            if size > LARGEST or (largest < 1.0 / LARGEST and 0.0 < size < 1.0 / LARGEST):
                raise InputError(
                    f"the {name} has entries up to {size:.1e}: squares of such numbers cannot be "
                    "computed. Choose units in which they are nearer to 1."
                )

    def update_stiffness(self, solver: StiffnessSolver, loose: LooseMotions | None) -> None:
        """Go on with the system's present K. Collective.

        Args:
            solver: for K, or for `loose.supported(K)`.
            loose: rigid motions that K resists little or not at all; None: there are none.

        Raises:
            StiffnessError: a solve failed; the operator is as before.
        """
        self.local_stiffness = local_stiffness(self.system, self.B)
        response = loose.response(self.system.K, solver) if loose else None
        self._loose = None if response is None else LooseBodies(response, self._jump_of)
        self.solver = solver

    def update_bounds(self, slip_bounds: Sequence[Array]) -> None:
        """Set Lambda from the slip bounds [stress] at each pair's nodes, and the load. Collective.

        Raises:
            InputError: a body floats and contact cannot hold it.
        """
        normal, tangential, node, radius = [], [], [], []
        nodes = 0
        positions = np.arange(len(self.scale))
        for pair, bounds, (n, t) in zip(self.pairs, slip_bounds, self.slices, strict=True):
            if not pair.bonded:
                normal.append(positions[n])
                tangential.append(positions[t])
                node.append(pair.tangent_node + nodes)
            radius.append(bounds * np.sqrt(pair.weights))
            nodes += len(pair.nodes)
        feasible_set = FeasibleSet(
            size=len(self.scale),
            normal=np.concatenate([*normal, positions[:0]]),
            tangential=np.concatenate([*tangential, positions[:0]]),
            node=np.concatenate([*node, positions[:0]]).astype(np.intp),
            radius=np.concatenate(radius),
        )
        if self._loose is not None:
            load = self.system.f.x.petsc_vec.array
            feasible_set = self._loose.balanced(feasible_set, load, self.inner, self.agreed)
        self.feasible_set = feasible_set

    @property
    def exact(self) -> bool:
        """Whether products are exact to rounding, whatever accuracy is asked for."""
        return self.solver.exact

    @property
    def product_error(self) -> float:
        """Error of `apply`, in the norm of `gradient`, over sqrt(x'A x)."""
        return 0.0 if self.exact else self.solver.rtol

    def apply(self, x: Array, rtol: float | None = None) -> Array:
        """Return A x; counted in `products`. Collective.

        Args:
            x: (size,).
            rtol: what an iterative solver may leave; None: as its options say.
        """
        self.products += 1
        force = self.contact_force(x)
        if rtol is None:
            self.solver.solve(force, self._u)
        else:
            self._u.set(0.0)
            self.solver.improve(force, self._u, rtol=rtol, accuracy=0.0)
        self._u.array[self.system.prescribed] = 0.0
        return self.jump(self._u)

    def apply_to_all(self, X: Array) -> Array:
        """Return A X for the columns of X (size, k), which an exact solver takes together.

        That costs far less than one after the other. Counted in `products`, each. Collective.
        """
        count = X.shape[1]
        self.products += count
        forces, displacements = (self.solver.several(count) for _ in range(2))
        for column, x in enumerate(X.T):
            forces.getDenseArray()[:, column] = self.contact_force(x).array
        self.solver.solve_several(forces, displacements)
        product = np.empty_like(X)
        for column in range(count):
            u = displacements.getDenseArray()[:, column]
            product[:, column] = self._jump_of(np.where(self.system.prescribed, 0.0, u))
        forces.destroy()
        displacements.destroy()
        return product

    def gradient(self, x: Array, accuracy: float) -> tuple[Array, float]:
        """Return r = A x - b, and an estimate of its error. Collective.

        An iterative solver for K starts from a displacement that is known near x, and solves no
        better than is asked for: errors of that one do not stay. Counted in `products`.

        Args:
            x: (size,) multipliers.
            accuracy: what the displacement's error may be in the energy norm. What is returned is
                larger where the solver misses that.
        """
        if self.solver.exact:
            return (self.apply(x) - self.b if self.inner(x, x) > 0.0 else -self.b), 0.0
        self.products += 1
        u = self._known.near(x)
        error = self._improve(x, u, accuracy)
        self._accuracy = max(accuracy, error)
        self._known.add(x, u)
        return self._gap - self.jump(u), error

    def _improve(self, x: Array, u: PETSc.Vec, accuracy: float) -> float:
        """Solve K u = f - B'x from a guess, to an accuracy in the energy norm; return the error."""
        return self.solver.improve(self.net_force(x), u, rtol=EXACT, accuracy=accuracy)

    def agreed(self, x: Array) -> Array:
        """Return the first rank's x, which others have but for rounding. Collective."""
        return broadcast_array(self.system.comm, x)

    def least(self, value: float) -> float:
        """Return the least value of all ranks. Collective."""
        return float(self.system.comm.allreduce(value, op=MPI.MIN))

    def inner(self, x: Array, y: Array) -> Array:
        """Return x'y over all ranks; (size,) or (size, k) each. Collective."""
        return reduce_array(self.system.comm, x.T @ y)

    def jump(self, u: PETSc.Vec) -> Array:
        """Return B u as a new array, for instance of a whole displacement. Collective."""
        self.B.mult(u, self._jump)
        return np.array(self._jump.array)

    def _jump_of(self, u: Array) -> Array:
        """Return B u for the values of u on this rank. Collective."""
        self._u.array = u
        return self.jump(self._u)

    def contact_force(self, x: Array) -> PETSc.Vec:
        """Return B'x [force], zero where u is prescribed; the next call overwrites it."""
        self._multipliers.array = x
        self.B.multTranspose(self._multipliers, self._force)
        self._force.array[self.system.prescribed] = 0.0
        return self._force

    def net_force(self, x: Array) -> PETSc.Vec:
        """Return f - B'x [force]; the next call, or one of `contact_force`, overwrites it."""
        force = self.contact_force(x)
        force.aypx(-1.0, self.system.f.x.petsc_vec)
        return force

    def displacement(self, x: Array, u: PETSc.Vec, accuracy: float | None = None) -> None:
        """Solve K u = f - B'x, (38.1). Collective.

        Args:
            x: (size,) multipliers.
            u: where to put it.
            accuracy: what its error may be in the energy norm; None: a tenth of that of the last
                gradient, if there was one, else what the solver's options say.
        """
        if accuracy is None and self._accuracy is not None:
            accuracy = 0.1 * self._accuracy
        if accuracy is None or self.solver.exact:
            self.solver.solve(self.net_force(x), u)
            return
        near = self._known.near(x)
        near.copy(u)
        near.destroy()
        self._improve(x, u, accuracy)

    def add_rigid_motions(self, x: Array, u: PETSc.Vec, rigid: Array) -> tuple[Array, float]:
        """Add motions of loose bodies to u. Collective.

        Args:
            x: (size,) in Lambda.
            u: (K + Z Z')^-1 (f - B'x), with the springs Z of the supports.
            rigid: (k,) the motions.

        Returns:
            the gradient, and the energy norm of motions that u lacks for loads in balance.
        """
        r = self._gap - self.jump(u)
        if self._loose is None:
            return r, 0.0
        return self._loose.move(self.feasible_set, x, r, u, rigid)
