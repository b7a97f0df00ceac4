"""Bolts with a preload: pulled by their force in the first load step, locked in the next ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    Frictionless,
    InputError,
    NormalForce,
    Preload,
    RigidPlane,
    Units,
    contacts,
    read_gmsh,
)
from scenes.elasticity import elasticity
from scenes.press_fit import press_fit

gmsh = pytest.importorskip("gmsh")

pytestmark = pytest.mark.parallel

#: Young's modulus; length of bolt and members; area of the bolt, and of the members; preload.
YOUNG, LENGTH, BOLT, MEMBERS, FORCE = 1000.0, 5.0, 1.0, 2.0, 12.0

ACCURACY, RTOL = 1e-8, 1e-11


def joint(comm, force=FORCE, angle=0.0):
    """Return a bolt beside two members, between a clamped base and a rigid plate, without load.

    Both halves of the bolt, and the members, are bars, as Poisson's ratio is zero.
    """
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        if comm.rank == 0:
            occ = gmsh.model.occ
            for x, width, bottom, top in (
                (0, 1, 0, 2), (0, 1, 2, 5), (2, 2, 0, 2.5), (2, 2, 2.5, 5)
            ):  # fmt: skip
                occ.addBox(x, 0, bottom, width, 1, top - bottom)
            occ.rotate(occ.getEntities(3), 0, 0, 0, 0, 1, 0, angle)
            occ.synchronize()
        parts = read_gmsh(gmsh.model, comm, size=0.8)
    finally:
        gmsh.finalize()
    V = fem.functionspace(parts.mesh, ("Lagrange", 1, (3,)))
    axis = np.array([np.sin(angle), 0.0, np.cos(angle)])
    base = fem.locate_dofs_geometrical(V, lambda x: np.abs(axis @ x) < 1e-9)
    plate = RigidPlane(LENGTH * axis, -axis)
    pairs = contacts(parts, friction=Frictionless(), distance=0.01)
    cut = next(pair for pair in pairs if pair.side("secondary").startswith(("body 1", "body 2")))
    members = next(pair for pair in pairs if pair is not cut)
    cut = replace(cut, friction=Preload(force), name="bolt")
    tops = ContactPair(
        parts.facet_tags, list(parts.facet_tags.names), plate, Bonded(), search_distance=1e-3
    )
    bcs = [fem.dirichletbc(np.zeros(3), base, V)]
    a = elasticity(V, YOUNG, 0.0)
    problem = ContactProblem(a, None, [cut, members, tops], bcs, units=Units("mm", "MPa", "N"))
    return problem, plate, axis


def pull(plate, axis, load):
    plate.held_by(force=load * axis, free=("x", "z"))


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_joint_against_its_stiffness_diagram(comm, angle):
    problem, plate, axis = joint(comm, angle=angle)
    pull(plate, axis, 0.0)
    solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    assert solution.bolts["bolt"].force == pytest.approx(FORCE, rel=ACCURACY)
    assert solution.bolts["bolt"].change == pytest.approx(0.0, abs=ACCURACY * FORCE)
    clamped = solution.pair_resultants[1].force
    assert abs(clamped @ axis) == pytest.approx(FORCE, rel=1e-7)
    assert np.linalg.norm(clamped) == pytest.approx(FORCE, rel=1e-6)
    lowered = plate.motion.translation + solution.surfaces[2].obstacle.motion.translation
    assert lowered @ axis == pytest.approx(-FORCE * LENGTH / (YOUNG * MEMBERS), rel=1e-7)
    problem.accept()
    ratio = BOLT / (BOLT + MEMBERS)
    opens = FORCE / (1.0 - ratio)
    for load in (0.5 * opens, 0.99 * opens, 1.5 * opens, 0.0):
        pull(plate, axis, load)
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        problem.accept()
        expected = FORCE + ratio * load if load < opens else load
        assert solution.bolts["bolt"].force == pytest.approx(expected, rel=1e-7)
        assert solution.bolts["bolt"].change == pytest.approx(expected - FORCE, abs=1e-6)
        closing = abs(solution.pair_resultants[1].force @ axis)
        assert closing == pytest.approx(expected - load, abs=1e-6)
    assert "bolt: 12 N, change" in str(solution)


def test_a_preload_goes_on_from_a_file(comm, tmp_path):
    path = comm.bcast(tmp_path) / "state.h5"
    problem, plate, axis = joint(comm)
    pull(plate, axis, 0.0)
    problem.solve(rtol=RTOL)
    problem.accept()
    problem.save_state(path)
    problem, plate, axis = joint(comm)
    problem.load_state(path)
    pull(plate, axis, 3.0)
    solution = problem.solve(rtol=RTOL)
    assert solution.bolts["bolt"].force == pytest.approx(FORCE + 1.0, rel=1e-7)
    assert comm.allreduce(np.abs(solution.surfaces[0].gap.x.array).max(initial=0), op=max) < 1e-9


def test_a_force_that_is_a_constant(comm):
    problem, plate, axis = joint(comm)
    force = fem.Constant(problem.mesh, 5.0)
    pairs = [replace(problem.pairs[0], friction=Preload(force)), *problem.pairs[1:]]
    form, bcs = problem._contact.linear.form, problem._contact.linear.bcs
    problem = ContactProblem(form, None, pairs, bcs)
    pull(plate, axis, 0.0)
    for value in (5.0, 8.0):
        force.value = value
        assert problem.solve(rtol=RTOL).bolts["bolt"].force == pytest.approx(value, rel=ACCURACY)


@pytest.mark.parametrize("force", [np.inf, "12", (1, 2), True])
def test_wrong_forces(force):
    with pytest.raises(InputError, match="force of a preload"):
        Preload(force)


def test_refused_where_it_is_not_known(comm):
    problem, plate, axis = joint(comm)
    pull(plate, axis, 0.0)
    problem.solve()
    with pytest.raises(InputError, match="pair bolt: the value of a goal is not known"):
        problem.goal_value(NormalForce())
    with pytest.raises(InputError, match="a slip origin is not known"):
        problem.set_slip_origin(None)
    with pytest.raises(InputError, match="a step on another mesh is not known"):
        problem.continue_from(problem.solve())
    with pytest.raises(InputError, match="two deformable sides"):
        replace(problem.pairs[2], friction=Preload(1.0))
    with pytest.raises(InputError, match="must be a flat cut"):
        press_fit(comm, 4).but(friction=Preload(1.0)).problem()
