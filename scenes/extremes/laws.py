"""Errors of a solution in the laws of contact and friction, from displacement and stresses."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_tresca import ContactSolution
from dolfinx_tresca.dual.slip_bounds import NodalBounds, SlipBounds, with_tangents_along_axes
from dolfinx_tresca.pairing.operators import PairOperators, assemble_B
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.assembled import direct_solver
from scenes.scene import Scene

LAWS = ("penetration", "tension", "complementarity", "bound", "stick", "direction")

#: Divisor in place of a scale that is zero, or of a norm that is zero since squares underflow.
TINY, SQUARED = 1e-300, 1e-150

#: Ratio of jump and displacement below which rounding errors of the displacement are visible: EPS
#: times the condition number of K, divided by the accuracy with which laws are checked.
ROUNDING = 1e-6

#: Cosine below which a tangent is normal to an axis of an ellipse.
AXIS = 1e-12


def defects(
    model: Scene, solution: ContactSolution, *, held: bool = True, axisymmetric: bool = False
) -> dict[str, float]:
    """Return the largest dimensionless error in each law. Collective.

    Lengths are divided by the largest jump without contact, or if bodies float (not `held`) by the
    largest displacement; stresses by the largest stress, or the stress that such a jump causes.

    balance: |K u - f + B'lambda| / (diag(K) max|u| + max|f|), for each degree of freedom.
    penetration, tension, complementarity: N u <= d, pressure >= 0, and one of the two is zero.
    bound, stick, direction: |traction| <= g, no slip if it is less than g, otherwise slip along the
    traction; the error of an angle counts as the error of slip or traction, whichever is smaller.
    If the bound is an ellipse, slip must be along its normal, and the distance of a traction from
    it is the distance from its linearisation.
    """
    comm = model.V.mesh.comm

    def largest(values: Any) -> float:
        return float(comm.allreduce(float(np.max(values, initial=0.0)), op=MPI.MAX))

    with LinearSystem(model.a, model.L, model.bcs, axisymmetric=axisymmetric) as system:
        system.assemble_stiffness()
        system.assemble_load()
        pairs = [
            pair_surfaces(model.V, system.prescribed, pair, axisymmetric=axisymmetric)
            for pair in model.pairs
        ]
        bounds = SlipBounds(model.V)
        terms = [
            bounds.nodal_bounds(pair.friction, found.nodes)
            for pair, found in zip(model.pairs, pairs, strict=True)
        ]
        pairs = [
            with_tangents_along_axes(model.V, pair, term)
            for pair, term in zip(pairs, terms, strict=True)
        ]
        B = assemble_B(model.V, pairs)
        root = np.sqrt(np.concatenate([pair.weights[pair.row_node] for pair in pairs]))
        free, compliance = _without_contact(system, B, root) if held else (None, np.inf)
        balance = _balance(system, B, root, solution)
        jump = _product(B, solution.u.x.petsc_vec) / root
        alone = jump if free is None else _product(B, free) / root
        B.destroy()

    split = list(zip(_split(pairs, jump), _split(pairs, alone), strict=True))
    stress = _split(pairs, solution.multipliers)
    g = [
        _bounds(pair, term, p, slip)
        for pair, term, (p, _), ((_, slip), _) in zip(pairs, terms, stress, split, strict=True)
    ]
    if held:
        length = max(
            max(largest(n - pair.gap[pair.normal_node]), largest(np.abs(t)))
            for pair, (_, (n, t)) in zip(pairs, split, strict=True)
        )
    else:
        length = largest(np.abs(solution.u.x.array))
    length = max(length, ROUNDING * largest(np.abs(solution.u.x.array)), TINY)
    size = max(largest(np.abs(solution.multipliers)), length / compliance, TINY)

    found = dict.fromkeys(LAWS, 0.0)  # of this rank, which may have no node that rubs

    def note(law: str, values: Any) -> None:
        found[law] = max(found[law], float(np.max(values, initial=0.0)))

    for pair, term, bound, ((normal, tangential), _), (p, t) in zip(
        pairs, terms, g, split, stress, strict=True
    ):
        gap = (pair.gap[pair.normal_node] - normal) / length
        if pair.bonded:
            continue
        note("penetration", -gap)
        note("tension", -p / size)
        note("complementarity", np.minimum(gap, p / size))
        if len(pair.tangent_node) == 0:
            continue
        semi = _semi_diameters(pair, term)
        held_along = semi > 0.0  # along other axes slip is free, and there is no traction
        note("bound", np.abs(t[~held_along]) / size)
        semi[~held_along] = 1.0
        slip, traction = (
            _vectors(pair, np.where(held_along, values / unit, 0.0))
            for values, unit in ((tangential, length), (t, size))
        )
        norm, sliding = (np.linalg.norm(one, axis=1) for one in (traction, slip))
        # |t / semi-axes| = g, and the derivative of this norm
        of_circle = _vectors(pair, np.where(held_along, t / size / semi, 0.0))
        reached = np.linalg.norm(of_circle, axis=1)
        normals = _vectors(pair, np.where(held_along, t / size / semi**2, 0.0))
        normals /= np.maximum(reached, SQUARED)[:, None]
        slope = np.maximum(np.linalg.norm(normals, axis=1), 1.0)
        slack = (bound / size - reached) / slope
        note("bound", -slack)
        note("stick", np.minimum(sliding, slack))
        along = normals / np.maximum(np.linalg.norm(normals, axis=1), TINY)[:, None]
        sideways = np.linalg.norm(slip - sliding[:, None] * along, axis=1)
        angle = sideways / np.maximum(sliding, TINY)
        # an angle is an error of the traction over the ellipse's radius of curvature
        product = np.ones(len(pair.nodes))
        np.multiply.at(product, pair.tangent_node, semi)
        radius = np.where(product < 1.0, product**2 * slope**3 * reached, norm)
        note("direction", np.minimum(sideways, angle * np.minimum(radius, norm)))
    return {"balance": balance, **{law: largest(found[law]) for law in LAWS}}


def _bounds(
    pair: PairOperators, terms: NodalBounds, pressure: np.ndarray, slip: np.ndarray
) -> np.ndarray:
    """Return the slip bounds (n,) of a pair's nodes with pressures (n_normal,) and slips."""
    pressed = np.zeros(len(pair.nodes))
    pressed[pair.normal_node] = np.maximum(pressure, 0.0)
    coefficient = terms.coefficient
    if terms.curve is not None:
        coefficient = terms.curve.values(pressed, np.linalg.norm(_vectors(pair, slip), axis=1))
    return terms.constant + np.minimum(coefficient * pressed, terms.limit)


def _semi_diameters(pair: PairOperators, terms: NodalBounds) -> np.ndarray:
    """Return the bounds along the tangents of a pair, over those along the longer axes.

    Two tangents of a node are the axes of its ellipse; a single one may have any direction.
    """
    if terms.direction is None:
        return np.ones(len(pair.tangent_node))
    first = terms.direction
    first = first - (first * pair.normals).sum(axis=1)[:, None] * pair.normals
    first = first / np.linalg.norm(first, axis=1)[:, None]
    axes = np.stack([first, np.cross(pair.normals, first)], axis=1)
    shape, node = terms.shape, pair.tangent_node
    parts = np.einsum("rai,ri->ra", axes[node], pair.tangents)
    parts[np.abs(parts) < AXIS] = 0.0
    inverse = np.divide(
        parts, shape[node], out=np.where(parts, np.inf, 0.0), where=shape[node] > 0.0
    )
    turned = (parts != 0.0).all(axis=1) & (np.bincount(node)[node] == 2)
    turned &= shape[node, 0] != shape[node, 1]
    assert not turned.any()
    result: np.ndarray = 1.0 / np.linalg.norm(inverse, axis=1)
    return result


def _split(pairs: list[PairOperators], rows: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return normal and tangential rows of each pair."""
    result, first = [], 0
    for pair in pairs:
        middle = first + len(pair.normal_node)
        last = middle + len(pair.tangent_node)
        result.append((rows[first:middle], rows[middle:last]))
        first = last
    return result


def _vectors(pair: PairOperators, values: np.ndarray) -> np.ndarray:
    """Return tangential vectors (n, dim) of a pair's nodes."""
    result = np.zeros_like(pair.normals)
    np.add.at(result, pair.tangent_node, values[:, None] * pair.tangents)
    return result


def _product(B: PETSc.Mat, u: PETSc.Vec) -> np.ndarray:
    jump = B.createVecLeft()
    B.mult(u, jump)
    result = jump.array.copy()
    jump.destroy()
    return result


def _without_contact(
    system: LinearSystem, B: PETSc.Mat, root: np.ndarray
) -> tuple[PETSc.Vec, float]:
    """Solve K u = f by PETSc; return u and the largest ratio of jump and stress."""
    ksp = direct_solver(system.K)
    u = system.K.createVecRight()
    ksp.solve(system.f.x.petsc_vec, u)
    # the power method for B K^-1 B'
    x, force, moved = B.createVecLeft(), B.createVecRight(), system.K.createVecRight()
    first = B.getOwnershipRange()[0]
    x.array = root * np.cos(12.9898 * (first + np.arange(len(root))))
    compliance = 0.0
    for _ in range(3):
        x.normalize()
        B.multTranspose(x, force)
        force.array[system.prescribed] = 0.0
        ksp.solve(force, moved)
        moved.array[system.prescribed] = 0.0
        B.mult(moved, x)
        compliance = x.norm()
    for owned in (ksp, x, force, moved):
        owned.destroy()
    return u, compliance


def _balance(
    system: LinearSystem, B: PETSc.Mat, root: np.ndarray, solution: ContactSolution
) -> float:
    """Return the largest unbalanced force, divided by the scale of its rounding error."""
    x, force, Ku = B.createVecLeft(), B.createVecRight(), B.createVecRight()
    x.array = solution.multipliers * root
    B.multTranspose(x, force)
    force.array[system.prescribed] = 0.0
    u, f = solution.u.x.petsc_vec, system.f.x.petsc_vec
    system.K.mult(u, Ku)
    rest = np.abs(Ku.array - f.array + force.array)
    diagonal = system.K.getDiagonal()
    applied = np.where(system.prescribed, 0.0, np.abs(f.array))
    most = [
        system.comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX)
        for values in (np.abs(u.array), np.maximum(applied, np.abs(force.array)))
    ]
    size = np.maximum(diagonal.array * most[0] + most[1], TINY)
    worst = float((rest / size).max(initial=0.0))
    for vector in (x, force, Ku, diagonal):
        vector.destroy()
    return float(system.comm.allreduce(worst, op=MPI.MAX))
