"""A process that goes on in another run, on another number of ranks."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem, mesh

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    InputError,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca.scene.friction import Friction
from scenes.elasticity import elasticity
from scenes.rubbing import moved_end, rubbing
from scenes.scene import Scene

pytestmark = pytest.mark.parallel

RTOL = 1e-9

#: Of forces and dissipation, over `RTOL`, with an iteration that began elsewhere.
SAME = 1e3


def scene_of(comm: MPI.Comm, law: Friction) -> Scene:
    return rubbing(comm, "tetrahedron", friction=law, upper=(2, 1), lower=(3, 1))


def drag(scene: Scene, back: float) -> None:
    """Move the upper end to another place along x."""
    x = scene.V.tabulate_dof_coordinates()
    u = np.zeros_like(x)
    u[x[:, 2] > 1.5] = moved_end(x[x[:, 2] > 1.5]) - [back, 0.0, 0.0]
    scene.data.exact.x.array[:] = u.ravel()


def second(problem, scene):
    drag(scene, 2e-3)
    solution = problem.solve(rtol=RTOL)
    force = np.concatenate([one.force for one in solution.resultants()])
    return np.array([*force, solution.dissipation, solution.total_dissipation])


@pytest.mark.parametrize("law", [Tresca((0.3, 0.1), direction=(1.0, 0.5, 0.0)), Coulomb(0.3)])
def test_another_run_goes_on(comm, folder: Path, law: Friction) -> None:
    """The second step has the forces and the history that it would have had."""
    path = folder / "states" / "state.npz"
    scene = scene_of(comm, law)
    with scene.problem() as problem:
        problem.solve(rtol=RTOL)
        problem.accept()
        problem.save_state(path, step=7)
        expected = second(problem, scene)
    assert expected[-1] > expected[-2] > 0.0
    for ranks in (comm, MPI.COMM_SELF):
        scene = scene_of(ranks, law)
        with scene.problem() as problem:
            assert problem.load_state(path) == 7
            found = second(problem, scene)
        np.testing.assert_allclose(found, expected, atol=SAME * RTOL * np.abs(expected).max())


def test_surfaces_that_have_moved(comm, folder: Path) -> None:
    """They are paired where they were then, and not where they are."""
    at_rest, moved = folder / "at_rest.npz", folder / "moved.npz"
    scene = scene_of(comm, Coulomb(0.3))
    with scene.problem() as problem:
        u = problem.solve(rtol=RTOL).u
        u.x.array[:] *= 30.0
        problem.accept()
        problem.save_state(at_rest)
        expected = {at_rest: second(problem, scene)}
        problem.update_geometry(u)
        problem.save_state(moved)
        expected[moved] = second(problem, scene)
    assert expected[moved][2] < 0.5 * expected[at_rest][2]
    for ranks in (comm, MPI.COMM_SELF)[: comm.size]:
        scene = scene_of(ranks, Coulomb(0.3))
        with scene.problem() as problem:
            for path in (moved, at_rest):
                problem.load_state(path)
                found, right = second(problem, scene), expected[path]
                np.testing.assert_allclose(found, right, atol=SAME * RTOL * np.abs(right).max())
    with scene_of(comm, Frictionless()).problem() as problem:
        rests = problem.operators[0].gap.copy()
        with pytest.raises(InputError, match="pair 0 has friction"):
            problem.load_state(moved)
        assert np.array_equal(problem.operators[0].gap, rests)


def test_a_refined_mesh_on_other_ranks(comm, folder: Path) -> None:
    """Its numbers depend on the partition, the places of its nodes do not."""
    path = folder / "state.npz"
    with on_floor(comm) as problem:
        force = problem.solve(rtol=RTOL).normal_force
        problem.save_state(path)
    for ranks in (comm, MPI.COMM_SELF):
        with on_floor(ranks) as problem:
            problem.load_state(path)
            solution = problem.solve(rtol=1.1 * RTOL)
        assert solution.iterations == 0
        assert solution.normal_force == pytest.approx(force, rel=SAME * RTOL)


def on_floor(comm: MPI.Comm) -> ContactProblem:
    """Return a cube on a floor, its mesh refined."""
    coarse = mesh.create_unit_cube(comm, 2, 2, 2)
    coarse.topology.create_entities(1)
    cube = mesh.refine(coarse)[0]
    bottom, top = (
        np.sort(mesh.locate_entities_boundary(cube, 2, lambda x, z=z: np.isclose(x[2], z)))
        for z in (0.0, 1.0)
    )
    cube.topology.create_connectivity(2, 3)
    tags = mesh.meshtags(cube, 2, bottom, np.full(len(bottom), 7, dtype=np.int32))
    V = fem.functionspace(cube, ("Lagrange", 1, (3,)))
    a, L = elasticity(V, 1.0, 0.3), None
    pressed = fem.locate_dofs_topological(V, 2, top)
    bcs = [fem.dirichletbc(np.array([1e-3, 0.0, -1e-3]), pressed, V)]
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
    return ContactProblem(a, L, [ContactPair(tags, 7, floor, Coulomb(0.1))], bcs=bcs)


@pytest.mark.parametrize(
    ("before", "now", "message"),
    [
        (Coulomb(0.3), Frictionless(), "pair 0 has friction; here it has no friction"),
        (Frictionless(), Tresca(0.3), "pair 0 has no friction; here it has friction"),
        (Bonded(), Coulomb(0.3), "pair 0 is bonded; here it has friction"),
    ],
)
def test_laws_of_another_kind(comm, folder: Path, before, now, message: str) -> None:
    """Nothing is lost without a word."""
    path = folder / "state.npz"
    with scene_of(comm, before).problem() as problem:
        problem.save_state(path)
    with scene_of(comm, now).problem() as problem, pytest.raises(InputError, match=message):
        problem.load_state(path)


def test_files_that_do_not_fit(comm, folder: Path) -> None:
    scene = scene_of(comm, Tresca(0.3))
    path = folder / "state.npz"
    with scene.problem() as problem:
        problem.save_state(path)
        with pytest.raises(InputError, match="cannot read a state from"):
            problem.load_state(folder / "none.npz")
        if comm.rank == 0:
            (folder / "text.npz").write_text("nothing")
            whole = path.read_bytes()
            (folder / "truncated.npz").write_bytes(whole[: len(whole) // 2])
            (folder / "flipped.npz").write_bytes(whole.replace(b"\x00" * 24, b"\x01" * 24, 9))
            np.save(folder / "array.npy", np.zeros(3))
            np.savez(folder / "other.npz", u=np.zeros(3))
        comm.barrier()
        for name, why in (
            ("text.npz", "it is no state, or its end is missing"),
            ("truncated.npz", "it is no state, or its end is missing"),
            ("array.npy", "it is no state, or its end is missing"),
            ("other.npz", "it is no state"),
            ("flipped.npz", ""),
        ):
            with pytest.raises(InputError, match=f"cannot read a state from .*: {why}"):
                problem.load_state(folder / name)
        with pytest.raises(InputError, match="step must be an integer"):
            problem.save_state(path, step=0.5)  # type: ignore[arg-type]
    other = rubbing(comm, "tetrahedron", friction=Tresca(0.3), upper=(3, 1), lower=(3, 1))
    with other.problem() as problem, pytest.raises(InputError, match="is of another mesh"):
        problem.load_state(path)
    scene.mesh.geometry.x[:, 0] *= 1.1
    with scene.problem() as problem, pytest.raises(InputError, match="is of another mesh"):
        problem.load_state(path)


def test_values_that_nothing_writes(comm, folder: Path) -> None:
    """A file that was made or changed by hand: named on all ranks, and the problem stays."""
    path, changed = folder / "state.npz", folder / "changed.npz"
    with scene_of(comm, Tresca(0.3)).problem() as problem:
        u = problem.solve(rtol=RTOL).u
        problem.update_geometry(u)
        problem.save_state(path)
        gap = problem.operators[0].gap.copy()
        for name, change, why in (
            ("pair 0/values", not_finite(np.nan), "'pair 0/values' has values that are NaN"),
            ("pair 0/places", not_finite(np.inf), "'pair 0/places' has values that are NaN"),
            ("numbers", not_finite(-np.inf), "'numbers' has values that are NaN or infinite"),
            ("nodes/geometry", not_finite(np.nan), "'nodes/geometry' has values that are NaN"),
            ("format", lambda _: "dolfinx_tresca state 4", "its format is '.* state 4'"),
        ):
            if comm.rank == 0:
                with np.load(path) as file:
                    np.savez(changed, **{**file, name: change(file[name])})
            comm.barrier()
            with pytest.raises(InputError, match=f"cannot read a state from .*: {why}"):
                problem.load_state(changed)
        assert np.array_equal(problem.operators[0].gap, gap)


def not_finite(value: float):
    """Return what has an array with that as the last value."""

    def change(values: np.ndarray) -> np.ndarray:
        values.ravel()[-1] = value
        return values

    return change
