"""Estimate of the discretisation error of the displacement by gradient recovery."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import csc_array

import basix
import dolfinx
import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices, LocalNumbers
from dolfinx_tresca._base.compat import interpolation_points
from dolfinx_tresca._base.functions import entities_per_cell, zero_like
from dolfinx_tresca._base.parallel import gather_rows, reduce_array

#: Number of cells whose gradients are evaluated together; it limits the memory.
CELLS_AT_ONCE = 50_000

#: Least ratio of the stiffnesses of different materials, and the largest number of materials. Each
#: material has a recovery of its own, which costs as much as the recovery for a single material.
MATERIAL_CONTRAST, MOST_MATERIALS = 1.5, 8

#: Approximate ratio of the error to the difference between the gradient and its mean at the nodes,
#: both in the energy norm, for degrees 1 and 2, by whether cells are simplices. The ratio is not 1,
#: since the mean has a higher order than the gradient only for degree 1, and since singular edges
#: lower the difference by up to a third. The factors are in the middle of the ranges that were
#: measured (benchmarks/README.md, "Measured once").
RECOVERY_FACTOR = {True: (1.15, 1.8), False: (1.0, 1.5)}


class DiscretisationError:
    """Estimates the error of the mesh in the energy norm by gradient recovery.

    The gradient of a finite element displacement jumps from cell to cell. The mean at the nodes,
    weighted by the volumes of the cells, is a better gradient (Zienkiewicz and Zhu, 1987), and the
    difference of the two gradients is an estimate of the error. The energy of this difference is
    computed with the form `a`, in which the difference replaces the gradient; this works for any
    cell and material. The gradient is evaluated at the Gauss points of order 2 (degree - 1), where
    it is most accurate (Barlow, 1976), and extrapolated to the nodes, where means are taken. If the
    gradient were evaluated at the nodes of quadrilaterals or hexahedra instead, its component along
    an edge would depend on that edge alone, and the difference would be zero on the boundary, which
    has singular edges.

    The estimate was 0.7 to 1.5 times the error on scenes with singular edges and Poisson's ratios
    of up to 0.49 (benchmarks/README.md, "Measured once"). It is not a bound. For Poisson's ratios
    closer to 0.5, cells lock: the error spreads from its origin, and is larger compared with the
    estimate. At the corners of inclusions that are 1000 times stiffer than the rest, the estimate
    is up to 1.7 times the error for degree 2. If the material inside a body changes abruptly, the
    true gradient jumps too: each material then has means of its own, for up to `MOST_MATERIALS`
    materials. If the material varies from cell to cell without gaps between the stiffnesses, the
    estimate is too large.

    For degree 2, the gradient differs from the true gradient by c h^2 P_2(x), with a factor c, the
    size h of the cell, and Legendre's polynomial P_2 of the position x in the cell. This difference
    is equal on both sides of a node if neighbouring cells are alike. Where a smooth solution varies
    along one direction of such a mesh, gradients therefore hardly jump, and the ratio of the
    estimate to the error falls with h; where the solution varies in two directions, the ratio does
    not fall (Babuska and Yu, 1987, Asymptotically exact a posteriori error estimator for
    biquadratic elements: errors of even degree are in the cells' interiors, not in jumps). Edges of
    contact areas have no such symmetry.

    In bodies of revolution, the error of the hoop strain u_r / r counts as zero: it is of higher
    order than the error of the gradient, except in the cells at the axis. A mean of u_r / r would
    be less accurate than u_r / r itself: for quadrilaterals of degree 2, this mean would make the
    estimate 1.5 times the error, in place of 1.0.

    Penetration between the few nodes of a stiff secondary surface causes no strain and is not
    estimated. It is large only if the soft side alone is refined, which `adapt/solve.py`
    prevents.
    """

    def __init__(self, a: ufl.Form, V: fem.FunctionSpace, axisymmetric: bool = False) -> None:
        """Compile the forms, and divide the cells into materials. Collective.

        Args:
            a: the bilinear form of K.
            V: the space of the displacement, of degree 1 or 2.
            axisymmetric: whether a is for bodies of revolution, with the factor 2 pi x[0].
        """
        mesh = V.mesh
        dim = mesh.geometry.dim
        degree = V.element.basix_element.degree
        self._last: tuple[Array, Array] | None = None  # the last displacement and its estimate
        self._u = fem.Function(V)
        self._gradient = fem.Function(fem.functionspace(mesh, ("Lagrange", degree, (dim, dim))))
        cells = fem.functionspace(mesh, ("DG", 0))
        cell = mesh.basix_cell()
        points, _ = basix.make_quadrature(cell, 2 * (degree - 1))
        self._expression = fem.Expression(ufl.grad(self._u), points)
        nodes = interpolation_points(self._gradient.function_space.element)
        self._at_nodes = _continuation(cell, degree - 1, points, nodes)
        weight = ufl.TestFunction(cells)
        difference = self._gradient - ufl.grad(self._u)
        simplices = entities_per_cell(V, 0) == mesh.topology.dim + 1
        self._factor = RECOVERY_FACTOR[simplices][degree - 1]
        self._square = fem.form(with_gradient(a, difference, weight))
        self._volume = fem.form(weight * ufl.dx)
        self._cells, self._errors = cells, fem.Function(cells)
        generic = ufl.as_tensor(np.eye(dim) + 1.0)
        ring = ufl.SpatialCoordinate(mesh)[0] if axisymmetric else ufl.as_ufl(1.0)
        self._materials, self._count = self._classify_materials(
            fem.form(with_gradient(a, generic, weight)), fem.form(weight * ring * ufl.dx)
        )

    def cell_errors(self, u: fem.Function) -> fem.Function:
        """Return the estimate of each cell [energy^(1/2)], a function of degree 0. Collective."""
        squares = self._squares(u.x.array)
        result = zero_like(self._errors, "cell_errors")
        result.x.array[: len(squares)] = np.sqrt(np.maximum(squares, 0.0))
        result.x.scatter_forward()
        return result

    def products(self, u: fem.Function, z: fem.Function) -> Array:
        """Return estimates (cells,) of a(e_u, e_z) [energy] in this rank's cells. Collective.

        Here e_u and e_z are the errors of the displacements u and z. The values may be negative.
        They follow from the squared estimates for u + z and u - z, with u and z scaled to unit
        size.
        """
        values = u.x.array, z.x.array
        scale = np.sqrt([reduce_array(self._cells.mesh.comm, v @ v) for v in values])
        if not scale.all():
            return np.zeros_like(self._squares(values[0]))
        scaled_u, scaled_z = values[0] / scale[0], values[1] / scale[1]
        difference = self._squares(scaled_u + scaled_z) - self._squares(scaled_u - scaled_z)
        return np.asarray(0.25 * scale[0] * scale[1] * difference)

    def _squares(self, u: Array) -> Array:
        """Return the squared estimates (cells,) of this rank's cells [energy]. Collective.

        For the same displacement as in the last call, nothing is computed.

        Args:
            u: values of the displacement on this rank, with ghosts.
        """
        same = self._last is not None and np.array_equal(u, self._last[0])
        if self._last is not None and self._cells.mesh.comm.allreduce(same, op=MPI.LAND):
            return self._last[1]
        self._u.x.array[:] = u
        volumes = self._assembled(self._volume)
        squares = np.zeros_like(volumes)
        for material in range(self._count):
            mine = np.flatnonzero(self._materials == material).astype(np.int32)
            self._recover(mine, volumes)
            squares[mine] = self._assembled(self._square)[mine]
        self._last = u.copy(), np.asarray(self._factor**2 * squares)
        return self._last[1]

    def _classify_materials(self, energy: fem.Form, volume: fem.Form) -> tuple[Indices, int]:
        """Return the material (cells,) of each of this rank's cells, and the number of materials.

        Collective.

        A material is a group of cells whose stiffnesses have no large gap between them: a stiffness
        that varies gradually makes one group.

        Args:
            energy: the form that gives each cell's energy [energy] for the same displacement
                gradient in all cells.
            volume: the form that gives each cell's volume, or for bodies of revolution the volume
                of the cell's ring up to a constant factor.
        """
        volumes = self._assembled(volume)
        stiffness = np.log(np.maximum(self._assembled(energy), LEAST_DIVISOR) / volumes)
        every = np.unique(gather_rows(self._cells.mesh.comm, np.unique(stiffness.round(2))))
        gaps = np.diff(every)
        widest = np.sort(np.argsort(gaps)[-(MOST_MATERIALS - 1) :])
        widest = widest[gaps[widest] > np.log(MATERIAL_CONTRAST)]
        return np.digitize(stiffness, every[widest] + 0.5 * gaps[widest]), len(widest) + 1

    def _recover(self, owned: LocalNumbers, volumes: Array) -> None:
        """Set the recovered gradient at nodes: the mean over adjacent cells, weighted by volume.

        Collective.

        Args:
            owned: (n,) numbers of the cells of one material, owned by this rank.
            volumes: (cells,) volumes of all cells of this rank [length^3, in 2D length^2].
        """
        mesh, dofmap = self._gradient.function_space.mesh, self._gradient.function_space.dofmap
        sums, weights = self._gradient.x, dolfinx.la.vector(dofmap.index_map, 1)
        sums.array[:] = 0.0
        tensors = sums.array.reshape(-1, dofmap.index_map_bs)
        for start in range(0, len(owned), CELLS_AT_ONCE):
            cells = owned[start : start + CELLS_AT_ONCE]
            nodes = dofmap.list[cells]
            sampled = self._expression.eval(mesh, cells)
            values = self._at_nodes @ sampled.reshape(len(cells), self._at_nodes.shape[1], -1)
            # the sum over the cells at each node; numpy's add.at takes six times as long
            volume = np.repeat(volumes[cells], nodes.shape[1])
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
        values: Array = fem.assemble_vector(form).array[:count]
        return values


def total(cells: fem.Function) -> float:
    """Return the root of the sum of squares of all cells' errors [energy^(1/2)]. Collective."""
    space = cells.function_space
    squares = np.square(cells.x.array[: space.dofmap.index_map.size_local])
    return float(np.sqrt(reduce_array(space.mesh.comm, squares.sum())))


def _continuation(cell: Any, degree: int, points: Array, nodes: Array) -> Array:
    """Return the matrix (m, n) that extrapolates from points of a cell to nodes by a polynomial.

    Args:
        cell: `basix.CellType` of the cell.
        degree: degree of the polynomial.
        points: (n, d) unisolvent points of the polynomial.
        nodes: (m, d) points at which the polynomial is evaluated.
    """
    element = basix.create_element(
        basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.equispaced, discontinuous=True
    )
    at_points, at_nodes = (element.tabulate(0, x)[0, :, :, 0] for x in (points, nodes))
    return np.asarray(at_nodes @ np.linalg.inv(at_points))


def with_gradient(a: ufl.Form, gradient: Any, weight: Any) -> ufl.Form:
    """Return the cell integrals of a(u, u), with grad u replaced by a tensor, times a weight.

    Args:
        a: the bilinear form.
        gradient: UFL expression of shape (dim, dim) that replaces both gradients.
        weight: scalar UFL expression that multiplies the integrands.
    """
    a = apply_derivatives(apply_algebra_lowering(a))
    zero = ufl.zero(gradient.ufl_shape[:1])  # drops terms that depend on values, such as springs
    for argument in a.arguments():
        a = ufl.replace(a, {ufl.grad(argument): gradient, argument: zero})
    integrals = [
        integral.reconstruct(integrand=integral.integrand() * weight)
        for integral in a.integrals()
        if integral.integral_type() == "cell"
    ]
    return ufl.Form(integrals)
