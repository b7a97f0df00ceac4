"""A guaranteed bound of the error of the displacement: iteration, mesh and contact together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.compat import geometry_degree, geometry_dofmap
from dolfinx_tresca._base.functions import zero_like
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError
from dolfinx_tresca.guaranteed.cell_copies import CellCopies
from dolfinx_tresca.guaranteed.contact_facets import (
    PENETRATION,
    coefficients,
    contact_facets,
    defects,
    jumps,
    lifted,
)
from dolfinx_tresca.guaranteed.forms import displacement_gradients, elasticity, loads
from dolfinx_tresca.guaranteed.simplices import Simplices, mean_products
from dolfinx_tresca.guaranteed.stars import CellData, Stars
from dolfinx_tresca.guaranteed.stress_element import CellStresses, stress_element
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.stiffness.system import LinearSystem

#: Force that a star lacks, relative to the forces on its cells, above which the displacement is not
#: in equilibrium: a force at a point, or a failed solve.
IMBALANCE = 1e-7

#: Steps of the conjugate gradient method by which the stress comes nearer to the stress of the
#: displacement. With the double of it the bound is 2 % (triangles) or 5 % (tetrahedra) smaller.
STEPS = 5


@dataclass(frozen=True)
class GuaranteedError:
    """A proven bound of |u - u*|, where u* is the exact solution on the domain of the mesh.

    The norm is the energy norm, |v|^2 = a(v, v). The bound is proven up to rounding
    (docs/theory/guaranteed.md). u* is the solution of Tresca's problem whose gaps and slip bounds
    are linear between contact nodes; if bounds depend on the pressure, they are those of the
    solution.

    Attributes:
        error: bound of |u - u*| [energy^(1/2)].
        relative_error: `error` divided by |u|.
        cell_errors: for each cell, root of its part of the square [energy^(1/2)], for `refine`. The
            root of the sum of their squares is at most some percent larger than `error`.
        stress: |s - s(u)|, the distance of the stress in equilibrium from the stress of the
            displacement [energy^(1/2)].
        oscillation: root of the sum of squares of the terms of loads that are not balanced exactly
            [energy^(1/2)]; zero for loads that are constant in cells and tractions that are linear
            on facets.
        complementarity: integral of pressure times gap [energy].
        friction: integral of what the work of friction lacks of its bound [energy].
        lift: |u - v|, the distance of u from a displacement v that does not penetrate
            [energy^(1/2)].
    """

    error: float
    relative_error: float
    cell_errors: fem.Function
    stress: float
    oscillation: float
    complementarity: float
    friction: float
    lift: float

    def __repr__(self) -> str:
        return (
            f"<GuaranteedError: at most {self.error:.3e}, {self.relative_error:.1%} of the "
            "displacement's energy norm>"
        )


def guaranteed_error(
    linear: LinearSystem,
    pairs: list[ContactPair],
    dual: DualProgram,
    multipliers: Array,
    u: fem.Function,
    steps: int = STEPS,
) -> GuaranteedError:
    """Return a guaranteed bound of the error of a solution, with one solve with K. Collective.

    Args:
        linear: the system K u = f.
        pairs: the contact pairs.
        dual: the dual problem that was solved.
        multipliers: (size,) multipliers of the solution.
        u: the displacement of the solution.
        steps: number of steps that make the bound sharper.

    Raises:
        InputError: the bound does not cover the problem.
        ContactError: the displacement is not in equilibrium.
    """
    V, mesh = linear.V, linear.V.mesh
    comm, dim = mesh.comm, mesh.geometry.dim
    a, L = _checked_forms(linear, dual)
    degree = V.element.basix_element.degree
    topology = mesh.topology
    for pair in ((dim, 0), (dim, dim - 1), (dim - 1, dim)):
        topology.create_connectivity(*pair)
    count = topology.index_map(dim).size_local
    cells = Simplices(mesh.geometry.x[geometry_dofmap(mesh)[:count], :dim])
    nodes = V.dofmap.list[:count]
    edges = np.array(basix.topology(mesh.basix_cell())[1])
    stiffness = elasticity(a, cells, mesh, linear.entity_maps)
    given = loads(L, cells, mesh, linear.entity_maps)
    prescribed = _on_nodes(V, linear.prescribed)
    held = _held(mesh, prescribed[nodes], edges, degree)
    at_solution = dual.bounds(multipliers, dual.response.gradient_of(u.x.petsc_vec))
    areas = np.concatenate([on.weights for on in dual.jump.pairs])
    bounds = at_solution.radius[: len(areas)] / np.sqrt(areas)
    contacts = [
        contact_facets(V, dual, pair, rows, multipliers, bounds, prescribed)
        for pair, rows in zip(pairs, dual.jump.by_pair, strict=True)
    ]
    for side in (side for contact in contacts for side in contact.sides):
        products = np.einsum("kla,mad->mkld", mean_products(dim, 3), side.tractions)
        products *= cells.areas[side.cell, side.facet, None, None, None]
        cell, facet = side.cell[:, None, None], side.facet[:, None, None]
        corners = side.corners[:, :, None], side.corners[:, None]
        np.add.at(given.traction, (cell, facet, *corners), products)
    balanced = _in_equilibrium(linear, dual, u, given.load, given.traction, nodes, edges)
    v = lifted(V, contacts, u, prescribed)
    lacks = []
    for contact in contacts:
        jump = coefficients(contact, jumps(V, contact, v), nodes)
        side = contact.sides[0]
        lacks.append(defects(contact, jump, cells.areas[side.cell, side.facet]))
        size = np.abs(v.x.array).max(initial=0.0) + np.abs(jump).max(initial=0.0)
        deepest = lacks[-1][2].max(initial=0.0)
        with errors_on_all_ranks(comm):
            if held[side.cell, side.facet].any():
                raise InputError(
                    "a guaranteed bound needs contact surfaces without prescribed displacements, "
                    f"and some facets of contact pair {contact.pair} have them."
                )
            if deepest > PENETRATION * size:
                raise InputError(
                    f"prescribed displacements penetrate at contact pair {contact.pair}, by "
                    f"{deepest:.2e}: there is no exact solution."
                )

    def stresses(w: fem.Function) -> Array:
        values = w.x.array.reshape(-1, dim)[nodes]
        slopes = displacement_gradients(values, cells, edges)
        basis = stress_element(dim).basis
        strains = np.tensordot(slopes, basis, axes=([2, 3], [1, 2]))
        values = np.einsum("nab,nkb,aij->nkij", stiffness, strains, basis, optimize=True)
        return np.asarray(values)

    of_u, of_v = stresses(u), stresses(v)
    copies = CellCopies(mesh)
    own = CellStresses(cells, np.asarray(np.linalg.inv(stiffness)))
    stars = Stars(
        CellStresses(Simplices(copies.spread(cells.points)), copies.spread(own.compliance)),
        copies.vertices,
        copies.owned,
        CellData(*map(copies.spread, (stresses(balanced), given.load, given.traction, held))),
        degree > 1,
    )
    with errors_on_all_ranks(comm):
        tractions = stars.equilibrated()
    imbalance, size = reduce_array(comm, [stars.imbalance, stars.size], MPI.MAX)
    if imbalance > IMBALANCE * size:
        raise ContactError(
            f"the displacement is not in equilibrium: around a node, forces of {imbalance:.1e} are "
            f"missing, where nodal forces are up to {size:.1e}. A displacement that is prescribed "
            "at a point, and not on facets, cannot hold a force."
        )
    tractions = copies.summed(tractions)
    inverse = np.linalg.inv(mean_products(dim + 1, 2))
    projection = inverse @ given.load.sum(axis=2) / cells.volumes[:, None, None]
    difference = own.of_tractions(tractions, -projection) - own.of_linear(of_v)
    descent = -own.gradient(difference)
    direction, previous = np.zeros_like(tractions), 0.0
    for _ in range(steps):
        near = copies.summed(stars.preconditioned(copies.spread(descent)))
        slope = float(reduce_array(comm, (near * descent).sum()))
        if not slope > 0.0:
            break
        direction = near + (slope / previous * direction if previous else 0.0)
        previous = slope
        change = own.of_tractions(direction)
        curvature = float(reduce_array(comm, own.energies(change).sum()))
        length = slope / curvature
        difference = difference + length * change
        descent = descent - length * own.gradient(change)
    energies = own.energies(difference)
    softness = np.sqrt(np.linalg.eigvalsh(own.compliance)[:, -1])
    fluctuation = cells.poincare_factors * given.load_rest
    fluctuation += (cells.trace_factors * given.traction_rest * ~held.all(axis=2)).sum(axis=1)
    fluctuation *= softness
    terms = np.sqrt(energies) + fluctuation
    squares = terms**2
    complementarity = friction = 0.0
    for contact, (pressed, slipping, _) in zip(contacts, lacks, strict=True):
        complementarity += pressed.sum()
        friction += slipping.sum()
        np.add.at(squares, contact.sides[0].cell, 2.0 * np.maximum(pressed + slipping, 0.0))
    moved = own.energies(own.of_linear(of_u - of_v)).sum()
    whole = own.energies(own.of_linear(of_u)).sum()
    totals = reduce_array(
        comm,
        np.array(
            [
                *((terms**2).sum(), energies.sum(), (fluctuation**2).sum()),
                *(complementarity, friction, moved, whole),
            ]
        ),
    )
    eta, lift, norm = np.sqrt(totals[[0, 5, 6]])
    lack = max(float(totals[3] + totals[4]), 0.0)
    error = float(0.5 * eta + np.sqrt(0.25 * eta**2 + lack) + lift)
    result = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="guaranteed_cell_errors")
    result.x.array[result.function_space.dofmap.list[:count, 0]] = np.sqrt(squares)
    result.x.scatter_forward()
    return GuaranteedError(
        error=error,
        relative_error=error / float(norm) if norm > 0.0 else float("inf"),
        cell_errors=result,
        stress=float(np.sqrt(totals[1])),
        oscillation=float(np.sqrt(totals[2])),
        complementarity=float(totals[3]),
        friction=float(totals[4]),
        lift=float(lift),
    )


def _checked_forms(linear: LinearSystem, dual: DualProgram) -> tuple[Any, Any]:
    mesh = linear.V.mesh
    if linear.component is not None or linear.axisymmetric:
        raise InputError(
            "a guaranteed bound is for displacements of plane or three-dimensional bodies, not for "
            "mixed spaces or bodies of revolution."
        )
    if mesh.topology.cell_name() not in ("triangle", "tetrahedron"):
        raise InputError(
            f"a guaranteed bound needs triangles or tetrahedra, found {mesh.topology.cell_name()} "
            "cells. Divide them into simplices."
        )
    if geometry_degree(mesh) != 1:
        raise InputError("a guaranteed bound needs cells with straight edges.")
    if dual.equilibrium is not None:
        raise InputError(
            "a guaranteed bound needs Dirichlet conditions that hold each body; here contact alone "
            "holds a body against some motion."
        )
    return linear.ufl_forms


def _on_nodes(V: Any, flags: Any) -> Any:
    """Return flags (owned degrees of freedom,) at this rank's nodes (nodes, d). Collective."""
    dofmap = V.dofmap
    spread = dolfinx.la.vector(dofmap.index_map, dofmap.index_map_bs)
    spread.array[: len(flags)] = flags
    spread.scatter_forward()
    return spread.array.reshape(-1, dofmap.index_map_bs) > 0.0


def _held(mesh: Any, prescribed: Any, edges: Array, degree: int) -> Any:
    """Return on which facets of owned cells the displacement is prescribed (n, d + 1, d).

    Args:
        mesh: the mesh.
        prescribed: (n, k, d) prescribed degrees of freedom of each cell.
        edges: (e, 2) vertices of each edge of a cell.
        degree: degree of the displacement.
    """
    tdim = mesh.topology.dim
    count, corners = len(prescribed), tdim + 1
    exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    facets = mesh.topology.connectivity(tdim, tdim - 1).array.reshape(-1, corners)[:count]
    result = np.repeat(np.isin(facets, exterior)[:, :, None], prescribed.shape[2], axis=2)
    for j in range(corners):
        on_facet = [k for k in range(corners) if k != j]
        if degree > 1:
            on_facet += [corners + e for e, ends in enumerate(edges) if j not in ends]
        result[:, j] &= prescribed[:, on_facet].all(axis=1)
    return result


def _in_equilibrium(
    linear: LinearSystem,
    dual: DualProgram,
    u: fem.Function,
    load: Array,
    traction: Array,
    nodes: Indices,
    edges: Array,
) -> fem.Function:
    """Return the displacement, near u, that balances loads and tractions. Collective.

    Args:
        linear: the system K u = f.
        dual: the dual problem, with the solver for K.
        u: the displacement of the solution.
        load: see `CellData`.
        traction: see `CellData`.
        nodes: (n, k) nodes of each cell.
        edges: (e, 2) vertices of each edge of a cell.
    """
    products = load + traction.sum(axis=1)
    if nodes.shape[1] == products.shape[1]:
        forces = products.sum(axis=2)
    else:
        squares = np.einsum("nkkd->nkd", products)
        i, j = edges.T
        forces = np.concatenate(
            [2.0 * squares - products.sum(axis=2), 4.0 * products[:, i, j]], axis=1
        )
    right, result = zero_like(u, "force"), u.copy()
    np.add.at(right.x.array.reshape(-1, forces.shape[2]), nodes, forces)
    right.x.scatter_reverse(dolfinx.la.InsertMode.add)
    change = zero_like(u, "change")
    residual = linear.residual_of(right.x.petsc_vec, u.x.petsc_vec)
    dual.operator.solver.improve(residual, change.x.petsc_vec, rtol=1e-12, accuracy=0.0)
    residual.destroy()
    change.x.scatter_forward()
    result.x.array[:] += change.x.array
    return result
