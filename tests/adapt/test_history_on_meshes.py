"""Load steps that go on on finer meshes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from test_solve import forms, held

from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    ConvergenceError,
    Coulomb,
    RigidPlane,
    TaggedMesh,
    Tresca,
    refine,
    solve_adaptively,
)
from scenes.boxes import Body, boxes
from scenes.elasticity import fixed

PRESSED, DRAGGED, BACK = 0.01, 0.03, 0.025  # displacements of the top

PAIRINGS = ("mortar", "node", "obstacle")
FRICTION = {"Tresca": Tresca(1.0), "Coulomb": Coulomb(0.2)}


def block(comm, pairing: str, n: int = 4) -> TaggedMesh:
    """A square block: on another one, wider unless nodes are to match; or alone."""
    under = Body((n, n), [(0.0, 1.0), (-1.0, 0.0)])
    if pairing == "mortar":
        under = Body((n + 1, n - 1), [(-0.5, 1.5), (-1.0, 0.0)])
    above = Body((n, n), [(0.0, 1.0), (0.0, 1.0)])
    made = boxes(comm, "triangle", [above] if pairing == "obstacle" else [above, under])

    def at(y):
        return lambda x: np.abs(x[:, 1] - y) < 1e-9

    marks = [(1, [0], at(1.0)), (2, [0], at(0.0)), (3, [1], at(0.0)), (4, [1], at(-1.0))]
    names = {"top": 1, "upper": 2, "lower": 3, "bottom": 4}
    return TaggedMesh(made.mesh, None, made.tags(*marks), names)


def dragged(tagged, pairing, friction):
    """The block is pressed down, and its top dragged as the Constant that is returned says."""
    V, a, L = forms(tagged, 1)
    tags, facets = tagged.tags, tagged.facet_tags
    top = fem.Constant(tagged.mesh, np.array([DRAGGED, -PRESSED]))
    bcs = [fixed(V, facets.find(tags["top"]), top)]
    primary = RigidPlane(point=(0, 0, 0), normal=(0, 1, 0))
    if pairing != "obstacle":
        bcs.append(held(tagged, V, "bottom"))
        primary = tags["lower"]
    how = {"node": "nodes", "mortar": "mortar", "obstacle": "auto"}[pairing]
    pair = ContactPair(facets, tags["upper"], primary, friction, pairing=how)
    return ContactProblem(a, L, [pair], bcs=bcs), top


def errors(comm, pairing, law, n):
    """Errors after a step on a finer mesh that follows one on a coarse one, and without that one.

    Against both steps on the finer mesh: of slip, force and dissipation; with the estimated error
    of the coarse mesh.
    """
    coarse = block(comm, pairing, n)
    cells = coarse.mesh.topology.index_map(2).size_local
    fine = refine(coarse, np.ones(cells), 1.0)
    with dragged(coarse, pairing, law)[0] as problem:
        step = problem.solve(local_accuracy=1e-5)
    problem, top = dragged(fine, pairing, law)
    with problem:
        problem.solve(rtol=1e-6)
        problem.accept()
        top.value[0] = BACK
        wanted = problem.solve(rtol=1e-6)
        problem.set_slip_origin(None)
        forgetful = problem.solve(rtol=1e-6)
        problem.continue_from(step)
        found = problem.solve(rtol=1e-6)
    found.raise_if_failed()

    def apart(one):
        slip = np.abs(one.surface.slip.x.array - wanted.surface.slip.x.array).max(initial=0.0)
        return [
            comm.allreduce(slip, op=MPI.MAX) / DRAGGED,
            abs(one.tangential_force - wanted.tangential_force) / step.tangential_force,
            abs(one.total_dissipation / wanted.total_dissipation - 1.0),
        ]

    return max(apart(found)), max(apart(forgetful)), step.discretisation_error


@pytest.mark.parallel(friction=["Coulomb"], pairing=["mortar"])
@pytest.mark.parametrize("friction", FRICTION)
@pytest.mark.parametrize("pairing", PAIRINGS)
def test_a_step_on_a_finer_mesh_knows_the_one_before(comm, pairing, friction):
    """As if all steps had been on the finer mesh, but for the error of the coarse one."""
    found, forgetful, mesh = errors(comm, pairing, FRICTION[friction], 4)
    assert found <= 1.5 * mesh
    assert forgetful > 2.0 * found


def test_finer_meshes_are_told_the_history_better(comm):
    """By h: what the coarse mesh gets wrong of its own step, about."""
    coarse, fine = (errors(comm, "obstacle", FRICTION["Tresca"], n)[0] for n in (4, 8))
    assert fine <= 0.6 * coarse


def test_load_steps_each_on_meshes_of_its_own(comm):
    """Out and back on one mesh, whose last step is refined as if both had been on the finer one."""
    start = block(comm, "mortar")

    def build(end):
        def on(tagged):
            problem, top = dragged(tagged, "mortar", Coulomb(0.2))
            top.value[0] = end
            return problem

        return on

    out = solve_adaptively(build(DRAGGED), start, 1e-3, max_levels=2)
    back = solve_adaptively(build(BACK), start, 1e-3, max_levels=3, after=out.solution)
    fine = back.tagged_mesh
    assert back.levels[1].free_dofs > back.levels[0].free_dofs
    problem, top = dragged(fine, "mortar", Coulomb(0.2))
    with problem:
        first = problem.solve()
        problem.accept()
        top.value[0] = BACK
        wanted = problem.solve()
    found = back.solution
    force = np.abs(found.tangential_force - wanted.tangential_force) / first.tangential_force
    assert force <= out.error
    assert found.total_dissipation == pytest.approx(wanted.total_dissipation, rel=out.error)
    assert wanted.tangential_force < 0.7 * first.tangential_force


def test_a_step_to_go_on_from_must_have_converged(comm):
    tagged = block(comm, "obstacle")
    problem, _ = dragged(tagged, "obstacle", Coulomb(0.2))
    with problem:
        step = problem.solve(rtol=1e-9, max_iterations=1)
        with pytest.raises(ConvergenceError, match="iteration limit"):
            problem.continue_from(step)
