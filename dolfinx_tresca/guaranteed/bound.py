"""A guaranteed bound of the error of the displacement: iteration, mesh and contact together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.compat import geometry_degree
from dolfinx_tresca._base.functions import zero_like
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, summed_at_nodes
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.errors import ContactError, InputError
from dolfinx_tresca.guaranteed.cells import (
    StressEnergies,
    mean_products,
    opposite,
    rigid_motions,
    stress_data,
    stress_element,
)
from dolfinx_tresca.guaranteed.contact import ContactSurface
from dolfinx_tresca.guaranteed.forms import Loads, elasticity, loads
from dolfinx_tresca.guaranteed.mesh_cells import Copies, OwnedCells, spread
from dolfinx_tresca.guaranteed.stars import CellData, Stars
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.stiffness.system import LinearSystem

#: Force that a cell lacks, relative to the largest force on a cell, above which the displacement is
#: not in equilibrium: a force at a point, or a failed solve.
IMBALANCE = 1e-7

#: Penetration relative to the largest displacement that counts as rounding.
PENETRATION = 1e-10

#: Steps of the conjugate gradient method by which the stress comes nearer to the stress of the
#: displacement. With the double of it the bound is 2 % (triangles) or 10 % (tetrahedra) smaller.
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
            root of the sum of their squares is at most some percent larger than `error` if `lift`
            is small.
        stress: |s - s(u)|, the distance of the stress in equilibrium from the stress of the
            displacement [energy^(1/2)].
        oscillation: root of the sum of squares of the terms of loads that are not balanced exactly
            [energy^(1/2)]; zero for loads that are linear in cells, and tractions on facets.
        complementarity: integral of pressure times gap [energy].
        friction: integral of what the work of friction lacks of its bound [energy].
        lift: |u - v|, the distance of u from a displacement v that does not penetrate, and has no
            gap where it is pressed [energy^(1/2)].
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
    a, L = _checked_forms(linear, dual)
    owned = OwnedCells.from_space(linear.V)
    cells, comm, d = owned.cells, linear.V.mesh.comm, owned.cells.d
    stiffness = elasticity(a, owned, linear.entity_maps)
    given = loads(L, owned, linear.entity_maps)
    prescribed = spread(linear.V, linear.prescribed.reshape(-1, d)) > 0.0
    exterior = dolfinx.mesh.exterior_facet_indices(linear.V.mesh.topology)
    held = prescribed[owned.nodes[:, owned.on_facets]].all(axis=2)
    held &= np.isin(owned.facets, exterior)[:, :, None]
    at_solution = dual.bounds(multipliers, dual.response.gradient_of(u.x.petsc_vec))
    areas = np.concatenate([on.weights for on in dual.jump.pairs])
    bounds = at_solution.radius[: len(areas)] / np.sqrt(areas)
    surfaces = [
        ContactSurface(owned, dual, pair, rows, multipliers, bounds, prescribed)
        for pair, rows in zip(pairs, dual.jump.by_pair, strict=True)
    ]
    for surface in surfaces:
        for cell, facet, tractions in surface.sides:
            given.traction[cell, facet] += tractions
    v, moduli = u.copy(), np.asarray(np.linalg.eigvalsh(stiffness))
    for surface in surfaces:
        surface.lift(v, moduli[:, -1])
    defects = _defects(owned, surfaces, held, v)
    energies = StressEnergies(cells, np.asarray(np.linalg.inv(stiffness)))
    balanced = _in_equilibrium(linear, dual, u, owned, given)
    of_balanced, of_u, of_v = (_stresses(owned, stiffness, w) for w in (balanced, u, v))
    of_u, of_v = stress_data(cells, of_u), stress_data(cells, of_v)
    difference = _nearest_stress(owned, energies, of_balanced, given, held, of_v, steps)

    distances = np.sqrt(energies.squared_norms(difference))
    oscillation = cells.poincare_factors * given.load_distance
    oscillation += (cells.trace_factors * given.traction_distance * ~held.all(axis=2)).sum(axis=1)
    oscillation /= np.sqrt(moduli[:, 0])
    moved, lack = energies.squared_norms(of_u - of_v), defects.sum(axis=0)
    # the mean of both stresses is the centre of a ball that contains the exact stress
    from_centre = energies.squared_norms(of_u - of_v - 0.5 * difference)
    whole = energies.squared_norms(of_u)
    terms = [(distances + oscillation) ** 2, distances**2, oscillation**2, *defects]
    totals = reduce_array(comm, [term.sum() for term in (*terms, moved, from_centre, whole)])
    eta, stress, oscillations = np.sqrt(totals[:3])
    lift, offset, norm = np.sqrt(totals[5:])
    gap = max(float(totals[3] + totals[4]), 0.0)
    error_of_v = 0.5 * eta + np.sqrt(0.25 * eta**2 + gap)
    radius = np.sqrt(0.25 * stress**2 + gap + oscillations * error_of_v)
    error = float(min(error_of_v + lift, offset + radius))
    result = fem.Function(fem.functionspace(owned.V.mesh, ("DG", 0)), name="guaranteed_cell_errors")
    squares = terms[0] + 2.0 * np.maximum(lack, 0.0) + moved
    result.x.array[result.function_space.dofmap.list[: len(squares), 0]] = np.sqrt(squares)
    result.x.scatter_forward()
    return GuaranteedError(
        error=error,
        relative_error=error / float(norm) if norm > 0.0 else float("inf"),
        cell_errors=result,
        stress=float(stress),
        oscillation=float(oscillations),
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


def _stresses(owned: OwnedCells, stiffness: Array, w: fem.Function) -> Array:
    """Return the stresses (n, d + 1, d, d) of a displacement at the vertices of owned cells."""
    values = w.x.array.reshape(-1, owned.cells.d)[owned.nodes]
    slopes = 2.0 * np.einsum("kab,nki->naib", owned.basis, values)
    tensors = stress_element(owned.cells.d).basis
    strains = np.tensordot(slopes @ owned.cells.gradients[:, None], tensors, ([2, 3], [1, 2]))
    return np.asarray(np.tensordot(strains @ stiffness, tensors, axes=1))


def _in_equilibrium(
    linear: LinearSystem, dual: DualProgram, u: fem.Function, owned: OwnedCells, given: Loads
) -> fem.Function:
    """Return the displacement, near u, that balances loads and tractions. Collective."""
    cells, basis = owned.cells, owned.basis
    weights = np.einsum("kab,abc->kc", basis, mean_products(cells.d + 1, 3))
    forces = cells.volumes[:, None, None] * (weights @ given.load)
    for j, ends in enumerate(opposite(cells.d)):
        on_facet = basis[:, ends][:, :, ends]
        weights = np.einsum("kab,abc->kc", on_facet, mean_products(cells.d, 3))
        forces += cells.areas[:, j, None, None] * (weights @ given.traction[:, j])
    right, change, result = zero_like(u, "force"), zero_like(u, "change"), u.copy()
    right.x.array[:] = summed_at_nodes(owned.V.dofmap.index_map, owned.nodes, forces).ravel()
    residual = linear.residual_of(right.x.petsc_vec, u.x.petsc_vec)
    dual.operator.solver.improve(residual, change.x.petsc_vec, rtol=1e-12, accuracy=0.0)
    residual.destroy()
    change.x.scatter_forward()
    result.x.array[:] += change.x.array
    return result


def _defects(
    owned: OwnedCells, surfaces: list[ContactSurface], held: Mask, v: fem.Function
) -> Array:
    """Return by how much tractions and jumps miss the law of contact (2, n), by cell. Collective.

    The rows are the integrals of complementarity and of friction.

    Raises:
        InputError: displacements are prescribed on contact surfaces, or penetrate.
    """
    result = np.zeros((2, len(held)))
    comm = owned.V.mesh.comm
    largest = float(reduce_array(comm, np.abs(v.x.array).max(initial=0.0), MPI.MAX))
    for surface in surfaces:
        pressed, slipping, deepest = surface.defects(v)
        np.add.at(result[0], surface.cell, pressed)
        np.add.at(result[1], surface.cell, slipping)
        with errors_on_all_ranks(comm):
            if held[surface.cell, surface.facet].any():
                raise InputError(
                    "a guaranteed bound needs contact surfaces without prescribed displacements, "
                    f"and some facets of contact pair {surface.pair} have them."
                )
            if deepest > PENETRATION * largest:
                raise InputError(
                    f"prescribed displacements penetrate at contact pair {surface.pair}, by "
                    f"{deepest:.2e}: there is no exact solution."
                )
    return result


def _nearest_stress(
    owned: OwnedCells,
    energies: StressEnergies,
    of_balanced: Array,
    given: Loads,
    held: Mask,
    of_v: Array,
    steps: int,
) -> Array:
    """Return a stress in equilibrium minus the stress of v, as `StressEnergies` data. Collective.

    Args:
        owned: the cells.
        energies: the energies of stresses in them.
        of_balanced: (n, d + 1, d, d) stress of a displacement that balances loads and tractions.
        given: loads and tractions.
        held: see `CellData`.
        of_v: data of the stress of v.
        steps: steps of the conjugate gradient method.

    Raises:
        ContactError: the displacement is not in equilibrium.
    """
    cells, comm, d = owned.cells, owned.V.mesh.comm, owned.cells.d
    n, count = len(held), d * (d + 1)
    copies, owner = Copies.around_vertices(owned)
    numbers = owned.V.mesh.topology.index_map(d - 1).local_to_global(owned.facets.ravel())
    spread = (
        *(cells.points, owned.vertices, numbers.reshape(owned.facets.shape), owner),
        *(energies.facet_stiffness(), of_balanced, given.load, given.traction, held),
    )
    data = CellData(*map(copies.spread, spread))
    with errors_on_all_ranks(comm):
        stars = Stars(replace(data, owned=data.owned == comm.rank))
        tractions = stars.equilibrated()
    tractions = copies.summed(tractions, n)

    forces = cells.facet_forces(tractions)
    largest = np.abs(forces).max(initial=0.0)
    forces += cells.volume_forces(given.load)
    arms = (cells.points - cells.points[:, :1]) / cells.heights.max(axis=1)[:, None, None]
    lacking = np.abs(np.einsum("nrkd,nkd->nr", rigid_motions(arms), forces)).max(initial=0.0)
    lacking, largest = reduce_array(comm, [lacking, largest], MPI.MAX)
    if lacking > IMBALANCE * largest:
        raise ContactError(
            f"the displacement is not in equilibrium: on a cell, forces of {lacking:.1e} are "
            f"missing, where forces on cells are up to {largest:.1e}. A displacement that is "
            "prescribed at a point, and not on facets, cannot hold a force."
        )
    result: Array = np.concatenate([tractions.reshape(n, count, d), -given.load], axis=1) - of_v
    descent = -energies.derivative(result)[:, :count]
    direction, previous = np.zeros_like(descent), 0.0
    for _ in range(steps):
        residual = copies.spread(descent.reshape(tractions.shape))
        near = copies.summed(stars.preconditioned(residual), n).reshape(descent.shape)
        slope = float(reduce_array(comm, (near * descent).sum()))
        if not slope > 0.0:
            break
        direction = near + (slope / previous * direction if previous else 0.0)
        previous = slope
        change = energies.derivative(direction)
        length = slope / float(reduce_array(comm, (direction * change).sum()))
        result[:, :count] += length * direction
        descent -= length * change
    return result
