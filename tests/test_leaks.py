"""Problems on new meshes leave nothing behind when nobody holds them any more."""

from __future__ import annotations

import gc
import os
import re
from collections import Counter
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import pytest

from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ContactStatus,
    Coulomb,
    TaggedMesh,
    read_gmsh,
    solve_adaptively,
)
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca._base.petsc import free_unused
from scenes.blocks import block
from scenes.elasticity import elasticity, fixed, no_load
from scenes.patches import BOTTOM, LOWER, TOP, UPPER, patch
from scenes.rubber_block import rubber_block
from scenes.two_bricks import on_bricks, two_bricks
from scenes.wall import wall

#: Problems of each kind that are counted, and those before, which fill caches.
PROBLEMS, BEFORE = 20, 3

#: Communicators that are tried: MPICH has 2,048. Open MPI has as many as fit into memory.
COMMUNICATORS = 2100

#: Memory [MB] that may come with `PROBLEMS`, since the allocator does not give all back: held by
#: references, those of `linear` take 200. It also keeps some 12 MB after one problem that it gives
#: back after another, so that the least of the last `PROBLEMS / 2` counts.
KEPT = 8.0


def linear(comm: MPI.Comm) -> None:
    """Mesh error, load steps, other surfaces and coefficients; on one rank nobody destroys it."""
    scene = two_bricks(comm, 8)
    young = fem.Constant(scene.mesh, 1.0)
    problem = ContactProblem(young * scene.a, scene.L, [scene.pair], bcs=scene.bcs)
    solution = problem.solve()
    problem.accept()
    problem.update_geometry(solution.u)
    young.value = 2.0
    problem.update_stiffness()
    problem.solve(accuracy=1e-4)
    if comm.size > 1:
        problem.destroy()


def floating(comm: MPI.Comm) -> None:
    """A body that contact alone holds, by multigrid."""
    with block(comm, (6, 6, 4)).problem(stiffness="multigrid") as problem:
        problem.solve(rtol=1e-6)


def nonlinear(comm: MPI.Comm) -> None:
    """Newton's method."""
    scene = rubber_block(comm, (4, 4, 4), clamped=True)
    with scene.problem() as problem:
        scene.push.value[:] = 0.02, 0.0, -0.1
        problem.solve()


def adaptive(comm: MPI.Comm) -> None:
    """Several meshes, and what goes from one to the next."""
    bricks = read_gmsh(MESHES / "two_bricks.geo", comm, N=3)
    solve_adaptively(lambda tagged: on_bricks(tagged).problem(), bricks, 0.05, max_levels=3)


def refined(comm: MPI.Comm) -> None:
    """A few triangles, solved, refined, and solved again on the finer mesh."""
    scene = patch(comm, "triangle", upper=(2, 1), lower=(3, 1))
    assert scene.cell_tags is not None
    mesh = TaggedMesh(scene.mesh, scene.cell_tags, scene.facet_tags, {})

    def build(tagged: TaggedMesh) -> ContactProblem:
        V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
        bcs = [
            fixed(V, tagged.facet_tags.find(tag), (0.0, value))
            for tag, value in ((BOTTOM, 0.0), (TOP, -0.01))
        ]
        pair = ContactPair(tagged.facet_tags, UPPER, LOWER, Coulomb(0.3))
        return ContactProblem(elasticity(V, 1000.0), no_load(V), [pair], bcs=bcs)

    found = solve_adaptively(build, mesh, 1e-3, max_levels=2)
    assert len(found.levels) == 2


def petsc_objects(comm: MPI.Comm, path: Path) -> Counter[str]:
    """Return how many objects of each class live, less those from before the log. Collective."""
    viewer = PETSc.Viewer().createASCII(str(path), comm=comm)
    PETSc.Log.view(viewer)
    viewer.destroy()
    comm.barrier()
    table = path.read_text().split("Object Type", 1)[1].split("=====", 1)[0]
    rows = re.findall(r"^ *(\S.*?) +(\d+) +(\d+)$", table, re.MULTILINE)
    assert {"Matrix", "Vector"} <= {name for name, *_ in rows}
    return Counter({name: int(made) - int(freed) for name, made, freed in rows if name != "Viewer"})


def free_communicators(comm: MPI.Comm) -> int:
    """Return how many communicators there are left. Collective."""
    found = []
    try:
        while len(found) < COMMUNICATORS:
            found.append(comm.Dup())
    except MPI.Exception:
        pass
    for one in found:
        one.Free()
    return len(found)


def memory() -> float:
    """Return the memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("solve", "each"),
    [
        pytest.param(
            *(refined, 2),
            marks=pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="the long cases are enough"),
        ),
        *(
            pytest.param(solve, 1, marks=pytest.mark.long)
            for solve in (linear, floating, nonlinear, adaptive)
        ),
    ],
)
def test_nothing_stays(comm, folder, solve, each):
    """Objects, communicators and memory are as before after 20 problems, `each` in one call."""

    def state() -> tuple[Counter[str], int, float]:
        gc.collect()
        free_unused(comm)
        return petsc_objects(comm, folder / "log.txt"), free_communicators(comm), memory()

    used_after = []
    PETSc.Log.begin()
    for _ in range(BEFORE // each + 1):
        solve(comm)
    objects, communicators, used = state()
    for _ in range(PROBLEMS // each):
        solve(comm)
        gc.collect()
        used_after.append(memory())
    objects_after, communicators_after, _ = state()
    assert objects_after - objects == Counter()
    assert communicators_after == communicators
    assert min(used_after[-PROBLEMS // each // 2 :]) - used <= KEPT


@pytest.mark.parallel
def test_kept_solutions_take_no_communicators(comm: MPI.Comm) -> None:
    """A history of load steps may be kept, on several ranks too."""
    scene = two_bricks(comm, 3).but(friction=Coulomb(0.3))
    first = scene.data.load.value.copy()
    kept, communicators = [], []
    with scene.problem() as problem:
        for step in range(1, 5):
            scene.data.load.value[:] = step * first
            kept.append(problem.solve())
            problem.accept()
            communicators.append(free_communicators(MPI.COMM_SELF))
    assert communicators[1] == communicators[-1]
    forces = [solution.normal_force for solution in kept]
    sums = [
        float(reduce_array(comm, solution.surface.weights @ solution.surface.pressure.x.array))
        for solution in kept
    ]
    assert forces == pytest.approx(sums)  # each has values of its own
    assert forces == pytest.approx([step * forces[0] for step in range(1, 5)], rel=1e-3)


def taken_by_walls(comm: MPI.Comm, *sizes: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the pairs of walls of some bricks and courses, and the communicators they take."""
    result = []
    for bricks, courses in (sizes[0], *sizes):  # the first wall fills caches
        scene = wall(comm, bricks, courses, divisions=(2, 1))
        gc.collect()  # of the wall before, on all ranks
        free_unused(comm)
        before = free_communicators(MPI.COMM_SELF)
        with scene.problem() as problem:
            solution = problem.solve()
            assert solution.status is ContactStatus.CONVERGED
            result.append((len(scene.pairs), before - free_communicators(MPI.COMM_SELF)))
    return result[1:]


@pytest.mark.parallel
def test_a_pair_takes_as_many_communicators_as_the_docs_say(comm: MPI.Comm) -> None:
    """The difference between two walls is that of their pairs; fifty or more take no more."""
    (few, less), (medium, more), (many, most) = taken_by_walls(comm, (2, 2), (3, 3), (10, 10))
    each = 6 if comm.size == 1 else 10
    assert few < medium < 50 < 100 < many
    assert more - less <= each * (medium - few)
    assert most - less <= each * (50 - few)
