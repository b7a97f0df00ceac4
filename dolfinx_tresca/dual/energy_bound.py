"""A bound of the iteration's error in the displacement, without a further solve with K."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.jump import JumpOperator, nodal_compliance
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.stiffness.solver import StiffnessSolver, cholesky


class Lift:
    """The displacement w of least D^-1 norm with B w = jump: w = D B' (B D B')^-1 jump.

    Here D is diag(K)^-1. `EnergyBound` closes gaps with w. The matrix B D B' is sparse, with a row
    for each row of B. It is factored by all ranks together; the analysis of MUMPS stores the
    pattern of all rows on one rank, 1 to 2 kB a row.
    """

    _solver: StiffnessSolver | None

    def __init__(self, jump: JumpOperator) -> None:
        """Factor B D B'. Collective.

        Args:
            jump: B, and the system with K.
        """
        self._prepare(jump.system.K, jump.matrix)
        self._compliance = nodal_compliance(jump.system)
        weighted = self._B.copy()
        weighted.diagonalScale(R=self._compliance)
        transposed = self._B.copy().transpose()
        local = weighted.matMult(transposed)
        self._solver = _factored_unless_singular(local)

    def _prepare(self, K: PETSc.Mat, B: PETSc.Mat) -> None:
        """Keep K and B, and make vectors. Collective."""
        self._K, self._B = K, B
        (self._w, self._jump), (self._Kw, self._multipliers) = B.createVecs(), B.createVecs()

    def energy_norm(self, jump: Array) -> float:
        """Return |w|_K [energy^(1/2)]; infinite if no w has this jump. Collective.

        Args:
            jump: (size,) this rank's rows of B w.
        """
        if self._solver is None:
            return np.inf
        self._jump.array = jump
        w = self._lift(self._solver)
        self._B.mult(w, self._multipliers)
        self._multipliers.axpy(-1.0, self._jump)
        # the ratio is of the order of 1 for a jump outside the range of B, which has dependent rows
        # then, and otherwise of the order of rounding
        if not self._multipliers.norm() <= 1e-6 * self._jump.norm():  # or NaN
            return np.inf
        self._K.mult(w, self._Kw)
        return float(np.sqrt(max(w.dot(self._Kw), 0.0)))

    def _lift(self, solver: StiffnessSolver) -> PETSc.Vec:
        """Return w for the jump in `_jump`. Collective."""
        solver.solve(self._jump, self._multipliers)
        self._B.multTranspose(self._multipliers, self._w)
        self._w.pointwiseMult(self._compliance, self._w)
        return self._w


def _factored_unless_singular(
    matrix: PETSc.Mat, constraints: int | None = 0
) -> StiffnessSolver | None:
    """Return the factors of a symmetric matrix; None if rows are dependent. Collective.

    The arguments are those of `cholesky`.
    """
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    try:
        return cholesky(matrix, {}, None, constraints)
    except StiffnessError:
        return None


class SaddleLift(Lift):
    """The displacement of least energy with a given jump, and its pressure.

    Both are in w, which satisfies K w + B'y = 0 and B w = jump with multipliers y.

    `Lift` moves contact nodes only. In a body that cannot change its volume, moving contact nodes
    alone costs infinite, or nearly infinite, energy. This lift has the least energy of all lifts,
    and needs a factorisation as large as the factorisation of K.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Factor (K, B'; B, 0). Collective.

        If the factorisation fails because rows of B are linearly dependent, `energy_norm` returns
        inf for any jump.

        Args:
            jump: B, and the system with K.

        Raises:
            StiffnessError: rows of B are linearly independent of each other, but not of the rows of
                incompressibility in K: the contact closes in a body that cannot change its volume.
        """
        system = jump.system
        K = system.K
        free, zero = jump.matrix.createVecs()
        zero.set(0.0)
        free.array = system.moves
        B = jump.matrix.copy()
        B.diagonalScale(R=free)
        transposed = B.copy().transpose()
        nothing = PETSc.Mat().createAIJ((B.getSizes()[0], B.getSizes()[0]), nnz=1, comm=K.comm)
        nothing.setDiagonal(zero)
        nothing.assemble()
        nest = PETSc.Mat().createNest([[K, transposed], [B, nothing]], comm=K.comm)
        whole = nest.copy()
        whole.convert(PETSc.Mat.Type.AIJ)
        self._prepare(K, B)
        self._right, self._solution = whole.createVecs()
        self._solver = _factored_unless_singular(whole, None)
        rough = np.cos(12.9898 * np.arange(1.0, len(jump.stress_scale) + 1.0))
        if self._solver is None and np.isfinite(Lift(jump).energy_norm(rough)):
            raise StiffnessError(
                "the contact and the conditions close in a body that cannot change its volume: its "
                "pressure is not determined where it touches everywhere, and gaps of another "
                "volume cannot be closed. Let it change its volume a little (Poisson's ratio "
                "0.4999, say), or leave a part of its boundary free."
            )

    def _lift(self, solver: StiffnessSolver) -> PETSc.Vec:
        """Return w for the jump in `_jump`. Collective."""
        size = len(self._w.array)
        self._right.set(0.0)
        self._right.array[size:] = self._jump.array
        solver.solve(self._right, self._solution)
        self._w.array = self._solution.array[:size]
        return self._w


class EnergyBound:
    """Bounds |u - u*|_K for u = K^-1 (f - B'lambda), lambda in Lambda (docs/theory/accuracy.md).

    Here u* is the exact solution of the discrete problem. By weak duality, the primal energy J, the
    dual energy D, and any displacement v without penetration satisfy

        1/2 |u - u*|_K^2 + 1/2 |v - u*|_K^2 <= J(v) - D(lambda)
            = lambda_nu'(d - N v) + sum of (g |T v| - lambda_tau.T v) + 1/2 |v - u|_K^2.

    No term of this sum is negative, so nothing cancels. In load steps, T v stands for T v - s, the
    slip since the last step, here and below. The displacement v is u + w. The lift w moves contact
    nodes alone (`Lift`), such that the jump at every node takes its best value for fixed
    neighbours: nodes that should close or stick do so. If K also has rows for a pressure, w moves
    all nodes (`SaddleLift`), and |u|_K is the norm of the displacement alone, with the pressure
    eliminated. If such a K is the tangent of a Newton step, there is no bound: the factorisation
    for `SaddleLift` would double the cost of the step.
    """

    def __init__(self, jump: JumpOperator, nodal_stiffness: Array) -> None:
        """Prepare the lifts w. Collective.

        Args:
            jump: B, and the system with K.
            nodal_stiffness: (size,) the stiffness of a node with fixed neighbours, the same for all
                directions of a friction disc.
        """
        self._nodal_stiffness = nodal_stiffness
        system = jump.system
        self.comm = system.comm
        self._lift: Lift | None = None
        if system.component is None:
            self._lift = Lift(jump)
        elif not system.is_tangent:
            self._lift = SaddleLift(jump)

    def energy_bound(self, feasible_set: FeasibleSet, x: Array, r: Array, error: float) -> float:
        """Return a bound of the error in the energy norm [energy^(1/2)]. Collective.

        Args:
            feasible_set: Lambda.
            x: (size,) multipliers in Lambda.
            r: (size,) the gradient at x, from the computed displacement u: d - N u and -T u.
            error: a bound of the error of u, |u - K^-1 (f - B'x)|_K.

        Returns:
            the bound of |u - u*|_K; infinite if there is no bound, or if rows of B are linearly
            dependent.
        """
        if self._lift is None:
            return np.inf
        # each node gets the jump for which the duality gap is smallest if its neighbours are fixed
        moved = x - self._nodal_stiffness * r
        projected = feasible_set.project(moved)
        opening = (projected - moved) / self._nodal_stiffness
        n, t = feasible_set.normal, feasible_set.tangential
        friction = feasible_set.dissipation(opening) + float(x[t] @ opening[t])
        total = reduce_array(self.comm, float(x[n] @ opening[n]) + max(friction, 0.0))
        # r - opening, but exactly zero at open nodes: rounding may be no jump of a displacement
        lift = self._lift.energy_norm((x - projected) / self._nodal_stiffness)
        return float(np.sqrt(2.0 * float(total) + (lift + error) ** 2)) + error
