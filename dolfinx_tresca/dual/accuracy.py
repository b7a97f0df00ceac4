"""Accuracy of a displacement: a bound of the iteration's error, an estimate of the mesh's.

- `EnergyBound`: the bound, without a solve with K; a `Lift` closes the gaps.
- `DiscretisationError`: the estimate, of each cell, by gradient recovery.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csc_array

import basix
import dolfinx
import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, LocalNumbers
from dolfinx_tresca._base.compat import interpolation_points
from dolfinx_tresca._base.functions import vertex_count, zero_like
from dolfinx_tresca._base.parallel import gather_rows, reduce_array
from dolfinx_tresca.dual.jump import JumpOperator, nodal_compliance
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.stiffness.solver import StiffnessSolver, cholesky


class Lift:
    """The displacement w of least D^-1 norm with B w = jump: w = D B' (B D B')^-1 jump.

    Here D is diag(K)^-1, zero at prescribed degrees of freedom. `EnergyBound` closes gaps with w,
    which moves contact nodes alone. The matrix B D B' (size, size) is sparse. It is factored by all
    ranks together; the analysis of MUMPS stores its pattern on one rank, 1 to 2 kB a row.
    """

    _solver: StiffnessSolver | None

    def __init__(self, jump: JumpOperator) -> None:
        """Factor B D B'. Collective."""
        self._K, self._B = jump.system.K, jump.matrix
        self._w, self._jump = self._B.createVecs()
        self._Kw, self._y = self._B.createVecs()
        self._D = nodal_compliance(jump.system)
        weighted = self._B.copy()
        weighted.diagonalScale(R=self._D)
        self._solver = _factored_unless_singular(weighted.matTransposeMult(self._B))

    def energy_norm(self, jumps: Array) -> float:
        """Return |w|_K [energy^(1/2)] for `jumps` (size,); inf if no w has them. Collective."""
        if self._solver is None:
            return np.inf
        self._jump.array = jumps
        w = self._lift(self._solver)
        self._B.mult(w, self._y)
        self._y.axpy(-1.0, self._jump)
        # B w - jump is rounding, unless rows of B are dependent and the jump is outside their range
        if not self._y.norm() <= 1e-6 * self._jump.norm():  # or NaN
            return np.inf
        self._K.mult(w, self._Kw)
        return float(np.sqrt(max(w.dot(self._Kw), 0.0)))

    def _lift(self, solver: StiffnessSolver) -> PETSc.Vec:
        """Return w for the jump in `_jump`. Collective."""
        solver.solve(self._jump, self._y)
        self._B.multTranspose(self._y, self._w)
        self._w.pointwiseMult(self._D, self._w)
        return self._w


def _factored_unless_singular(
    matrix: PETSc.Mat, negative_pivots: int | None = 0
) -> StiffnessSolver | None:
    """Return `cholesky` of a symmetric matrix; None if it fails, as if singular. Collective."""
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    try:
        return cholesky(matrix, {}, None, negative_pivots)
    except StiffnessError:
        return None


class SaddleLift(Lift):
    """The displacement and pressure w of least energy with B w = jump: K w + B'y = 0.

    `Lift` moves contact nodes only. In a body that cannot change its volume, moving contact nodes
    alone costs infinite, or nearly infinite, energy. This lift has the least energy of all lifts,
    and needs a factorisation as large as the factorisation of K.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Factor the matrix (K, B'; B, 0). Collective.

        If rows of B are linearly dependent, `energy_norm` returns inf for any jump.

        Raises:
            StiffnessError: rows of B are linearly independent of each other, but not of the rows of
                incompressibility in K: the contact closes in a body that cannot change its volume.
        """
        # B, with zeros in the columns of prescribed unknowns and pressures
        system, K = jump.system, jump.system.K
        free, zero = jump.matrix.createVecs()
        zero.set(0.0)
        free.array = system.moves
        B = jump.matrix.copy()
        B.diagonalScale(R=free)
        transposed = B.copy().transpose()
        nothing = PETSc.Mat().createAIJ((B.getSizes()[0], B.getSizes()[0]), nnz=1, comm=K.comm)
        nothing.setDiagonal(zero)
        nothing.assemble()
        whole = PETSc.Mat().createNest([[K, transposed], [B, nothing]], comm=K.comm).copy()
        whole.convert(PETSc.Mat.Type.AIJ)
        self._K, self._B = K, B
        self._w, self._jump = B.createVecs()
        self._Kw, self._y = B.createVecs()
        self._right, self._solution = whole.createVecs()
        self._solver = _factored_unless_singular(whole, negative_pivots=None)
        # rows of B alone are independent if `Lift` finds a displacement for an irregular jump
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
        unknowns = len(self._w.array)
        self._right.set(0.0)
        self._right.array[unknowns:] = self._jump.array
        solver.solve(self._right, self._solution)
        self._w.array = self._solution.array[:unknowns]
        return self._w


class EnergyBound:
    """Bounds |u - u*|_K for u = K^-1 (f - B'lambda), lambda in Lambda (docs/theory/accuracy.md).

    This is the error of the iteration: u* is the exact solution of the discrete problem. By weak
    duality, the primal energy J, the dual energy D, and any v without penetration satisfy

        1/2 |u - u*|_K^2 + 1/2 |v - u*|_K^2 <= J(v) - D(lambda)
            = lambda_nu'(d - N v) + sum of (g |T v| - lambda_tau.T v) + 1/2 |v - u|_K^2.

    No term of this sum is negative, so nothing cancels. In load steps, T v stands for T v - s, the
    slip since the last step, here and below. The displacement v is u + w. The lift w moves contact
    nodes alone (`Lift`), such that the jump at every node takes its best value for fixed
    neighbours: nodes that should close or stick do so. If K also has rows for a pressure, w moves
    all nodes (`SaddleLift`), and |u|_K is the norm of the displacement alone, with the pressure
    eliminated. If such a K is the tangent of a Newton step, there is no bound.
    """

    def __init__(self, jump: JumpOperator, nodal_stiffness: Array) -> None:
        """Prepare the lifts w. Collective.

        The `nodal_stiffness` (size,) is that of `ContactCompliance`, one value in a friction disc.
        """
        self._nodal_stiffness = nodal_stiffness
        self.comm = jump.comm
        self._lift: Lift | None = None
        if jump.system.component is None:
            self._lift = Lift(jump)
        elif not jump.system.is_tangent:
            self._lift = SaddleLift(jump)

    def energy_bound(self, feasible_set: FeasibleSet, x: Array, r: Array, error: float) -> float:
        """Return a bound of the error in the energy norm [energy^(1/2)]. Collective.

        The multipliers x (size,) in the set belong to a computed u with |u - K^-1 (f - B'x)|_K at
        most `error`, and with the gradient r (size,): d - N u and s - T u. The bound is infinite if
        there is no lift: for tangents of mixed spaces, or if rows of B are linearly dependent.
        """
        if self._lift is None:
            return np.inf
        # each node gets the jump for which the duality gap is smallest if its neighbours are fixed
        minimiser = x - self._nodal_stiffness * r
        projected = feasible_set.project(minimiser)
        # the gradient at the new jump: in normal rows d - N v, in tangential rows s - T v
        gradient = (projected - minimiser) / self._nodal_stiffness
        n, t = feasible_set.normal, feasible_set.tangential
        contact = float(x[n] @ gradient[n])
        friction = feasible_set.dissipation(gradient) + float(x[t] @ gradient[t])
        on_all_ranks = reduce_array(self.comm, contact + max(friction, 0.0))
        # B w = r - gradient, but exactly zero at open nodes: rounding may be no displacement's jump
        lift = self._lift.energy_norm((x - projected) / self._nodal_stiffness)
        return float(np.sqrt(2.0 * float(on_all_ranks) + (lift + error) ** 2)) + error


#: Number of cells whose gradients are evaluated together; it limits the memory.
CELLS_AT_ONCE = 50_000

#: Least ratio of stiffnesses that counts as a change of material, and largest number of materials.
#: Each material has a recovery of its own, which costs as much as that for a single material.
MATERIAL_CONTRAST, MOST_MATERIALS = 1.5, 8

#: Approximate ratio of the error to the difference between the gradient and its mean at the nodes,
#: both in the energy norm: whether cells are simplices -> ratios for degrees 1 and 2. Each is the
#: middle of the range that was measured (benchmarks/README.md, "Measured once").
RECOVERY_FACTOR = {True: (1.15, 1.8), False: (1.0, 1.5)}


class DiscretisationError:
    """Estimates the error of the mesh in the energy norm by gradient recovery.

    The gradient of a finite element displacement jumps from cell to cell. The mean at the nodes,
    weighted by the volumes of the cells, is a better gradient (Zienkiewicz and Zhu, 1987), and the
    difference of the two gradients is an estimate of the error. Its energy is computed with the
    form `a`, in which the difference replaces the gradient. The gradient is evaluated at the Gauss
    points of order 2 (degree - 1), where it is most accurate (Barlow, 1976), and extrapolated to
    the nodes, where means are taken. If the material inside a body changes abruptly, the true
    gradient jumps, too: each material then has means of its own, for up to `MOST_MATERIALS`
    materials. If it varies from cell to cell without gaps between the stiffnesses, the estimate is
    too large. In bodies of revolution, the error of the hoop strain u_r / r counts as zero: it is
    of higher order than the error of the gradient, except in the cells at the axis.

    The estimate is no bound: docs/theory/accuracy.md says how far it was from the error, and where
    it is too small. Penetration between the few nodes of a stiff secondary surface causes no strain
    and is not estimated; it is large if the soft side alone is refined, which `adapt` prevents.
    """

    def __init__(self, a: ufl.Form, V: fem.FunctionSpace, axisymmetric: bool = False) -> None:
        """Compile the forms, and divide the cells into materials. Collective.

        The degree of V is 1 or 2. If `axisymmetric`, the form has the factor 2 pi x[0].
        """
        mesh = V.mesh
        dim = mesh.geometry.dim
        degree = V.element.basix_element.degree
        self._last: tuple[Array, Array] | None = None  # the last displacement and its estimate
        # the displacement, and the recovered gradient, which is a function of the same degree
        self._u = fem.Function(V)
        tensors = fem.functionspace(mesh, ("Lagrange", degree, (dim, dim)))
        self._gradient = fem.Function(tensors)
        cells = fem.functionspace(mesh, ("DG", 0))
        cell = mesh.basix_cell()
        points, _ = basix.make_quadrature(cell, 2 * (degree - 1))
        self._expression = fem.Expression(ufl.grad(self._u), points)
        nodes = interpolation_points(tensors.element)
        # the matrix that continues a polynomial from the points to the nodes of a cell
        family, variant = basix.ElementFamily.P, basix.LagrangeVariant.equispaced
        element = basix.create_element(family, cell, degree - 1, variant, discontinuous=True)
        at_points = element.tabulate(0, points)[0, :, :, 0]
        at_nodes = element.tabulate(0, nodes)[0, :, :, 0]
        self._at_nodes = at_nodes @ np.linalg.inv(at_points)
        # one value in each cell: the form of the energy of the difference, and the volume
        weight = ufl.TestFunction(cells)
        difference = self._gradient - ufl.grad(self._u)
        simplices = vertex_count(V) == mesh.topology.dim + 1
        self._factor = RECOVERY_FACTOR[simplices][degree - 1]
        self._square = fem.form(with_gradient(a, difference, weight))
        self._cells, self._errors = cells, fem.Function(cells)
        self._volumes = self._assembled(fem.form(weight * ufl.dx))
        # the material of each cell: its stiffness is its energy for the same gradient in all cells,
        # divided by its volume (up to a factor)
        generic = ufl.as_tensor(np.eye(dim) + 1.0)  # any gradient that strains all directions
        energy = fem.form(with_gradient(a, generic, weight))
        ring = ufl.SpatialCoordinate(mesh)[0] if axisymmetric else ufl.as_ufl(1.0)
        volumes = self._assembled(fem.form(weight * ring * ufl.dx))
        energies = np.maximum(self._assembled(energy), LEAST_DIVISOR)
        logarithms = np.log(energies / volumes)
        # the stiffnesses of all ranks in ascending order; materials end at the widest gaps, so that
        # a stiffness that varies gradually makes a single material
        on_rank = np.unique(logarithms.round(2))
        every = np.unique(gather_rows(mesh.comm, on_rank))
        gaps = np.diff(every)
        widest = np.sort(np.argsort(gaps)[-(MOST_MATERIALS - 1) :])
        widest = widest[gaps[widest] > np.log(MATERIAL_CONTRAST)]
        limits = every[widest] + 0.5 * gaps[widest]
        self._materials, self._count = np.digitize(logarithms, limits), len(widest) + 1

    def cell_errors(self, u: fem.Function) -> fem.Function:
        """Return the error of u in each cell [energy^(1/2)], a function of degree 0. Collective."""
        squares = self._squares(u.x.array)
        result = zero_like(self._errors, "cell_errors")
        result.x.array[: len(squares)] = np.sqrt(np.maximum(squares, 0.0))
        result.x.scatter_forward()
        return result

    def products(self, u: fem.Function, z: fem.Function) -> Array:
        """Return estimates (cells,) of a(e_u, e_z) [energy] in this rank's cells. Collective.

        Here e_u and e_z are the errors of a displacement u and of a goal's adjoint z. Values may be
        negative: a quarter of the difference of the squared estimates for scaled u + z and u - z.
        """
        squares = [reduce_array(self._cells.mesh.comm, v @ v) for v in (u.x.array, z.x.array)]
        size_u, size_z = np.sqrt(squares)
        if size_u == 0.0 or size_z == 0.0:
            return np.zeros_like(self._squares(u.x.array))
        scaled_u, scaled_z = u.x.array / size_u, z.x.array / size_z
        difference = self._squares(scaled_u + scaled_z) - self._squares(scaled_u - scaled_z)
        return np.asarray(0.25 * size_u * size_z * difference)

    def _squares(self, u: Array) -> Array:
        """Return squared estimates (cells,) [energy] for nodal values u; cached. Collective."""
        if self._last is not None:
            last_u, last_squares = self._last
            same = np.array_equal(u, last_u)
            if self._cells.mesh.comm.allreduce(same, op=MPI.LAND):
                return last_squares
        self._u.x.array[:] = u
        squares = np.zeros_like(self._volumes)
        for material in range(self._count):
            cells = np.flatnonzero(self._materials == material).astype(np.int32)
            self._recover(cells)
            squares[cells] = self._assembled(self._square)[cells]
        squares = np.asarray(self._factor**2 * squares)
        self._last = u.copy(), squares
        return squares

    def _recover(self, of_material: LocalNumbers) -> None:
        """Set `_gradient` at nodes: the mean over adjacent cells, weighted by volume. Collective.

        Only the cells `of_material` (n,) count.
        """
        mesh, dofmap = self._gradient.function_space.mesh, self._gradient.function_space.dofmap
        sums, weights = self._gradient.x, dolfinx.la.vector(dofmap.index_map, 1)
        sums.array[:] = 0.0
        tensors = sums.array.reshape(-1, dofmap.index_map_bs)  # shares the memory
        for start in range(0, len(of_material), CELLS_AT_ONCE):
            cells = of_material[start : start + CELLS_AT_ONCE]
            nodes = dofmap.list[cells]
            sampled = self._expression.eval(mesh, cells)
            at_points = sampled.reshape(len(cells), self._at_nodes.shape[1], -1)
            values = self._at_nodes @ at_points  # (cells, nodes of a cell, dim^2)
            # the sum over the cells at each node, by a matrix with a column for each node of each
            # cell; numpy's add.at takes six times as long
            volume = np.repeat(self._volumes[cells], nodes.shape[1])
            ends = np.arange(nodes.size + 1)
            sum_at_nodes = csc_array((volume, nodes.ravel(), ends), (len(tensors), nodes.size))
            tensors += sum_at_nodes @ values.reshape(nodes.size, -1)
            weights.array[:] += sum_at_nodes.sum(axis=1)
        for vector in (sums, weights):
            vector.scatter_reverse(dolfinx.la.InsertMode.add)
            vector.scatter_forward()
        tensors /= np.where(weights.array > 0.0, weights.array, 1.0)[:, None]

    def _assembled(self, form: fem.Form) -> Array:
        """Return the values (cells,) of a form on this rank's cells. Collective."""
        topology = self._cells.mesh.topology
        count = topology.index_map(topology.dim).size_local
        return np.asarray(fem.assemble_vector(form).array[:count])


def total(cells: fem.Function) -> float:
    """Return the error of the mesh [energy^(1/2)]: the root of the sum of squares. Collective."""
    space = cells.function_space
    squares = np.square(cells.x.array[: space.dofmap.index_map.size_local])
    return float(np.sqrt(reduce_array(space.mesh.comm, squares.sum())))


def with_gradient(a: ufl.Form, gradient: Any, weight: Any) -> ufl.Form:
    """Return cell integrals of a(u, u) times a weight, with a tensor in place of grad u."""
    a = apply_derivatives(apply_algebra_lowering(a))
    zero = ufl.zero(gradient.ufl_shape[:1])  # drops terms that depend on values, such as springs
    for argument in a.arguments():
        a = ufl.replace(a, {ufl.grad(argument): gradient, argument: zero})
    cells = a.integrals_by_type("cell")
    return ufl.Form([cell.reconstruct(integrand=cell.integrand() * weight) for cell in cells])
