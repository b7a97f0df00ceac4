"""How far the mesh lets the displacement be from that of the continuous problem."""

from __future__ import annotations

from typing import Any

import numpy as np

import dolfinx
import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import Argument, Zero
from ufl.corealg.multifunction import MultiFunction

from dolfinx_tresca._compat import interpolation_points
from dolfinx_tresca._parallel import reduce_array

#: Cells whose gradients are evaluated together.
CHUNK = 50_000

#: By degree of the displacement: the error over the difference that stands for it, about. The mean
#: at the nodes is of higher order for degree 1; for degree 2 it is not, and the factor is measured
#: (tests/validation/test_estimate.py).
FACTOR = {1: 1.0, 2: 2.0}


class DiscretisationError:
    """Estimates the error of the mesh in the energy norm by gradient recovery.

    The gradient of a finite element displacement jumps from cell to cell; the mean at the nodes,
    weighted by the volumes of the cells, is a better gradient (Zienkiewicz and Zhu, 1987), and the
    difference an estimate of the error. It needs nothing but the form `a`, where it takes the place
    of the gradient, and works for any cell and material. With degree 1 it is asymptotically exact
    where the solution is smooth; with degree 2 it is good to a factor of two. It is no bound.
    Inside a body made of several materials the true gradient jumps too, and the estimate is too
    large there.
    """

    def __init__(self, a: Any, V: Any) -> None:
        """Compile the forms. Collective."""
        mesh = V.mesh
        dim = mesh.geometry.dim
        degree = V.element.basix_element.degree
        self._u = fem.Function(V)
        self._gradient = fem.Function(fem.functionspace(mesh, ("Lagrange", degree, (dim, dim))))
        cells = fem.functionspace(mesh, ("DG", 0))
        self._expression = fem.Expression(
            ufl.grad(self._u), interpolation_points(self._gradient.function_space.element)
        )
        weight = ufl.TestFunction(cells)
        difference = self._gradient - ufl.grad(self._u)
        self._factor = FACTOR[degree]
        self._square = fem.form(_with_gradient(a, difference, weight))
        self._volume = fem.form(weight * ufl.dx)
        self._cells = cells

    def of(self, u: fem.Function) -> fem.Function:
        """Return the estimate of each cell [energy^(1/2)], a function of degree 0. Collective."""
        self._u.x.array[:] = u.x.array
        volumes = self._assembled(self._volume)
        self._recover(volumes)
        result = fem.Function(self._cells, name="discretisation_error")
        squares = self._assembled(self._square)
        result.x.array[: len(squares)] = self._factor * np.sqrt(np.maximum(squares, 0.0))
        result.x.scatter_forward()
        return result

    def _recover(self, volumes: Any) -> None:
        """Average the gradient at the nodes."""
        mesh, dofmap = self._gradient.function_space.mesh, self._gradient.function_space.dofmap
        sums, weights = self._gradient.x, dolfinx.la.vector(dofmap.index_map, 1)
        sums.array[:] = 0.0
        tensors = sums.array.reshape(-1, dofmap.index_map_bs)
        for first in range(0, len(volumes), CHUNK):
            cells = np.arange(first, min(first + CHUNK, len(volumes)), dtype=np.int32)
            nodes = dofmap.list[cells]
            values = self._expression.eval(mesh, cells).reshape(*nodes.shape, -1)
            np.add.at(tensors, nodes, volumes[cells, None, None] * values)
            np.add.at(weights.array, nodes, volumes[cells, None])
        for vector in (sums, weights):
            vector.scatter_reverse(dolfinx.la.InsertMode.add)
            vector.scatter_forward()
        tensors /= weights.array[:, None]

    def _assembled(self, form: Any) -> Any:
        """Return the values of a form on this rank's cells."""
        topology = self._cells.mesh.topology
        return fem.assemble_vector(form).array[: topology.index_map(topology.dim).size_local]


def total(cells: fem.Function) -> float:
    """Return the norm of the errors of all cells together. Collective."""
    space = cells.function_space
    squares = np.square(cells.x.array[: space.dofmap.index_map.size_local])
    return float(np.sqrt(reduce_array(space.mesh.comm, squares.sum())))


class _Substitution(MultiFunction):  # type: ignore[misc]
    """Puts a tensor in the place of gradients of arguments, and zero in that of arguments."""

    def __init__(self, gradient: Any) -> None:
        super().__init__()
        self._gradient = gradient

    expr = MultiFunction.reuse_if_untouched

    def grad(self, o: Any) -> Any:
        """Replace the gradient of an argument."""
        return self._gradient if isinstance(o.ufl_operands[0], Argument) else o

    def argument(self, o: Any) -> Any:
        """Drop what depends on values, such as springs."""
        return Zero(o.ufl_shape)


def _with_gradient(a: Any, gradient: Any, weight: Any) -> Any:
    """Return the cell integrals of a(u, u) with a tensor for grad u, times a weight."""
    a = apply_derivatives(apply_algebra_lowering(a))
    a = map_integrand_dags(_Substitution(gradient), a)
    integrals = [
        integral.reconstruct(integrand=integral.integrand() * weight)
        for integral in a.integrals()
        if integral.integral_type() == "cell"
    ]
    return ufl.Form(integrals)
