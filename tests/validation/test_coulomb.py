"""Coulomb friction of small bodies, against sweeps of a conic solver, statics, and itself."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dense import clarabel_minimum

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactStatus,
    Coulomb,
    Frictionless,
    InputError,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca.scene.friction import ONSET_COEFFICIENT, BoundTerms, DryFriction, Friction
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from scenes.blocks import ABOVE, BELOW, block, floor
from scenes.nodal import node_function
from scenes.rubbing import BOUND, YOUNG, rubbing
from scenes.scene import Scene

RTOL = 1e-8

#: Differences of multipliers over the largest, from residuals of RTOL and condition numbers of A.
CLOSE = 1e-5

#: Sweeps of the reference, and change of the bounds after which it ends, over the largest.
SWEEPS, SETTLED = 100, 1e-7


def reference(model: Scene) -> np.ndarray:
    """Return nodal forces (size,) by damped sweeps, on dense matrices, of a conic solver."""
    dense = fem.assemble_matrix(fem.form(model.a)).to_dense()
    f = fem.assemble_vector(fem.form(model.L)).array
    u = np.zeros_like(f)
    held = np.zeros(len(u), dtype=bool)
    for bc in model.bcs:
        bc.set(u)
        held[bc.dof_indices()[0]] = True
    free = ~held
    pairs = [model.operators(pair) for pair in model.pairs]
    blocks, gaps = [], []
    normal, tangential, node, owner = [], [], [], []
    terms: list[list[np.ndarray]] = [[], [], []]
    size = nodes = 0
    for pair, one in zip(model.pairs, pairs, strict=True):
        for rows, target in ((one.N, normal), (one.T, tangential)):
            blocks.append(rows.toarray()[:, : len(u)])
            if not one.bonded:
                target.extend(range(size, size + rows.shape[0]))
            size += rows.shape[0]
        gaps += [one.gap[one.normal_node], np.zeros(one.T.shape[0])]
        if not one.bonded:
            node.extend(nodes + one.tangent_node)
        law = pair.friction.terms if isinstance(pair.friction, DryFriction) else BoundTerms()
        weights = one.weights
        terms[0].append(law.constant * weights)
        terms[1].append(np.full(len(weights), law.coefficient))
        terms[2].append(law.limit * weights)
        position = np.full(len(weights), -1)
        position[one.normal_node] = (
            size - one.N.shape[0] - one.T.shape[0] + np.arange(one.N.shape[0])
        )
        owner.append(position)
        nodes += len(weights)
    constant, coefficient, limit = (np.concatenate(one) for one in terms)
    B, owner_of = np.vstack(blocks), np.concatenate(owner)
    inside = dense[np.ix_(free, free)]
    u[free] = np.linalg.solve(inside, f[free] - dense[np.ix_(free, held)] @ u[held])
    A = B[:, free] @ np.linalg.solve(inside, B[:, free].T)
    b = B @ u - np.concatenate(gaps)
    scale = 1.0 / np.abs(A).max()
    bound, part = constant.copy(), 1.0
    change = math.inf
    for _ in range(SWEEPS):
        lam = FeasibleSet(
            size, np.array(normal, dtype=int), np.array(tangential, dtype=int),
            np.array(node, dtype=int), bound,
        )  # fmt: skip
        x = clarabel_minimum(scale * A, scale * b, lam, tolerance=1e-12)
        pressure = np.where(owner_of >= 0, np.maximum(x[owner_of], 0.0), 0.0)
        new = constant + np.minimum(coefficient * pressure, limit)
        before, change = change, np.abs(new - bound).max()
        if change <= SETTLED * new.max():
            return x
        part = 0.5 * part if change > before else part
        bound = bound + part * (new - bound)
    raise AssertionError(f"the reference does not settle: {change}")


def forces(model: Scene, solution: Any) -> np.ndarray:
    """Return nodal forces (size,) of a solution: stresses times areas."""
    weights = []
    for pair in model.pairs:
        one = model.operators(pair)
        weights += [one.weights[one.normal_node], one.weights[one.tangent_node]]
    return solution.multipliers * np.concatenate(weights)


LAWS: dict[str, Friction] = {
    "F = 0.1": Coulomb(0.1),
    "F = 0.6": Coulomb(0.6),
    "a limit": Coulomb(0.6, limit=0.4 * BOUND * YOUNG),
    "Mohr-Coulomb": Coulomb(0.3, adhesion=0.5 * BOUND * YOUNG),
    "Tresca in contact": Tresca(BOUND * YOUNG, only_in_contact=True),
}


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="the reference is one rank's")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_blocks_agree_with_sweeps_of_a_conic_solver(kind, law):
    """Blocks that are pressed, dragged and tilted; their meshes do not match."""
    model = rubbing(MPI.COMM_SELF, kind).but(friction=LAWS[law])
    wanted = reference(model)
    with model.problem(stiffness="cholesky") as problem:
        solution = problem.solve(rtol=RTOL)
    assert solution.status is ContactStatus.CONVERGED
    found = forces(model, solution)
    assert np.abs(found - wanted).max() <= CLOSE * np.abs(wanted).max()
    assert solution.counts.slip > 0
    assert solution.bound_error <= 1e-4


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="the reference is one rank's")
def test_degree_two_agrees_with_sweeps_of_a_conic_solver():
    model = rubbing(MPI.COMM_SELF, "triangle", 2).but(friction=Coulomb(0.4))
    with model.problem(stiffness="cholesky") as problem:
        solution = problem.solve(rtol=RTOL)
    wanted = reference(model)
    found = forces(model, solution)
    assert np.abs(found - wanted).max() <= CLOSE * np.abs(wanted).max()


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="the reference is one rank's")
@pytest.mark.parametrize("dim", [2, 3])
def test_several_laws_in_one_problem(dim):
    """Coulomb below; Tresca, no friction, or a bond at another face."""
    up = np.eye(3)[dim - 1]
    for other in (Tresca(0.2), Frictionless(), Bonded()):
        model = block(
            MPI.COMM_SELF, (3, 2, 2)[:dim], load=(0.3, 0.1, 0.2), held=(3,), obstacles=[],
            moved=lambda x: np.full((dim, x.shape[1]), -1e-3),
        )  # fmt: skip
        tags = model.facet_tags
        pairs = [
            ContactPair(tags, BELOW, floor(dim), Coulomb(0.5)),
            ContactPair(tags, ABOVE, RigidPlane(up, -up), other),
        ]
        model = dataclasses.replace(model, pairs=pairs)
        with model.problem(stiffness="cholesky") as problem:
            solution = problem.solve(rtol=RTOL)
        assert solution.status is ContactStatus.CONVERGED
        wanted = reference(model)
        found = forces(model, solution)
        assert np.abs(found - wanted).max() <= CLOSE * np.abs(wanted).max(), other


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("adhesion", [0.0, 0.2])
def test_a_block_slides_when_it_should(comm, dim, adhesion):
    """On a plane, drawn aside by 0.99 and 1.01 times what friction can bear, F N + c A."""
    coefficient, area = 0.3, 2.0
    law = Coulomb(coefficient, adhesion=adhesion)
    model = block(comm, (3, 2, 2)[:dim], size=(area, 1.0, 1.0)[:dim], friction=law)
    greatest = coefficient + adhesion
    with model.problem() as problem:
        for part in (0.99, 1.01, 0.5):
            model.data.load.value[:] = 0.0
            model.data.load.value[0] = part * greatest
            model.data.load.value[-1] = -1.0
            if part > 1.0:
                with pytest.raises(InputError, match=r"no contact forces balance.*along x"):
                    problem.solve(rtol=1e-6)
                continue
            solution = problem.solve(rtol=1e-6)
            assert solution.status is ContactStatus.CONVERGED
            assert solution.tangential_force == pytest.approx(part * greatest * area, rel=1e-6)
            assert solution.normal_force == pytest.approx(area, rel=1e-6)


@pytest.mark.parallel
def test_without_friction(comm):
    """F = 0, or a limit of zero, is no friction."""
    scene = rubbing(comm, "triangle")
    found = []
    for law in (Frictionless(), Coulomb(0.0), Coulomb(0.5, limit=0.0), Coulomb(0.5)):
        with scene.but(friction=law).problem() as problem:
            found.append(problem.solve(rtol=RTOL))
    free = found[0].u.x.array
    size = comm.allreduce(np.abs(free).max(), op=MPI.MAX)
    for solution in found[1:3]:
        assert solution.status is ContactStatus.CONVERGED
        assert np.abs(solution.u.x.array - free).max() <= CLOSE * size
        assert solution.tangential_force == 0.0
    assert found[3].tangential_force > 0.0


@pytest.mark.parallel
def test_fields_of_every_kind_changed_in_place(comm):
    """Number, Constant, Function, UFL expression, function of points: the same answers."""
    model = rubbing(comm, "triangle")
    mesh = model.V.mesh
    state = {"F": 0.2}
    constant = fem.Constant(mesh, 0.2)
    function = node_function(mesh, lambda x: np.full(x.shape[1], 0.2))
    kinds: dict[str, Any] = {
        "Constant": constant,
        "Function": function,
        "UFL": 2.0 * constant * ufl.as_ufl(0.5),
        "points": lambda x: np.full(x.shape[1], state["F"]),
    }
    found: dict[str, list[float]] = {}
    limit = 10.0 * BOUND * YOUNG
    for name, field in kinds.items():
        state["F"] = constant.value = 0.2
        function.x.array[:] = 0.2
        with model.but(friction=Coulomb(field, limit=limit)).problem() as problem:
            found[name] = [problem.solve(rtol=RTOL).tangential_force]
            state["F"] = constant.value = 0.5
            function.x.array[:] = 0.5
            found[name].append(problem.solve(rtol=RTOL).tangential_force)
    numbers = []
    for value in (0.2, 0.5):
        with model.but(friction=Coulomb(value, limit=limit)).problem() as problem:
            numbers.append(problem.solve(rtol=RTOL).tangential_force)
    assert numbers[1] > 1.1 * numbers[0]
    for values in found.values():
        assert values == pytest.approx(numbers, rel=CLOSE)


@pytest.mark.parallel
def test_law_at_every_node(comm):
    """|t| <= min(F p, l), no traction where open, and slip along the traction."""
    coefficient, limit = 0.4, 0.5 * BOUND * YOUNG
    model = rubbing(comm, "tetrahedron").but(friction=Coulomb(coefficient, limit))
    with model.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    surface = solution.surface
    own = surface.pressure.function_space.dofmap.index_map.size_local
    pressure = surface.pressure.x.array[:own]
    traction, slip = (
        np.linalg.norm(field.x.array.reshape(-1, 3)[:own], axis=1)
        for field in (surface.traction, surface.slip)
    )
    bound = np.minimum(coefficient * pressure, limit)
    size = comm.allreduce(pressure.max(initial=0.0), op=MPI.MAX)
    assert (traction <= bound + 1e-12 * size).all()
    length = comm.allreduce(slip.max(initial=0.0), op=MPI.MAX)
    moving = (slip > 1e-4 * length) & (pressure > 0.0)
    assert (traction[moving] >= bound[moving] * (1 - 1e-4)).all()
    assert comm.allreduce(int(moving.sum())) > 0


def test_the_other_side_may_be_secondary(comm):
    """Where meshes match, sides have the same part."""
    found = []
    for swap in (False, True):
        scene = rubbing(comm, "triangle", upper=(4, 3), lower=(4, 3), distort=0.0)
        pair = scene.pair
        if swap:
            pair = dataclasses.replace(pair, secondary=pair.primary, primary=pair.secondary)
        model = dataclasses.replace(scene, pairs=[pair]).but(friction=Coulomb(0.4))
        with model.problem() as problem:
            found.append(problem.solve(rtol=RTOL))
    for name in ("normal_force", "tangential_force", "greatest_slip"):
        one, other = (getattr(solution, name) for solution in found)
        assert one == pytest.approx(other, rel=CLOSE), name


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_starts_do_not_matter(comm, stiffness):
    """Warm from other loads, cold, and again: the same, and the last one for hardly a product."""
    scene = rubbing(comm, "tetrahedron")
    with scene.but(friction=Coulomb(0.3)).problem(stiffness=stiffness) as problem:
        problem.solve(rtol=RTOL)
        scene.data.exact.x.array[:] *= 0.5
        warm = problem.solve(rtol=RTOL)
        again = problem.solve(rtol=2 * RTOL)
        problem.forget()
        cold = problem.solve(rtol=RTOL)
    for solution in (warm, again, cold):
        assert solution.status is ContactStatus.CONVERGED
        assert solution.normal_force == pytest.approx(cold.normal_force, rel=CLOSE)
        assert solution.tangential_force == pytest.approx(cold.tangential_force, rel=10 * CLOSE)
    assert again.products <= 2


def test_onset_of_friction_in_contact(comm):
    """min(10 p, g) is Tresca's law where p >= g / 10: the sharp law is met as well as said."""
    scene = rubbing(comm, "triangle")
    with scene.but(friction=Tresca(BOUND * YOUNG, only_in_contact=True)).problem() as problem:
        solution = problem.solve(rtol=RTOL)
    (traction, pressure) = (solution.surface.traction.x.array, solution.surface.pressure.x.array)
    norm = np.linalg.norm(traction.reshape(len(pressure), -1), axis=1)
    assert (norm[pressure == 0.0] == 0.0).all()
    assert (norm <= np.minimum(ONSET_COEFFICIENT * pressure, BOUND * YOUNG) * (1 + 1e-9)).all()
