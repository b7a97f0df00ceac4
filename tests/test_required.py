"""Only what the scene requires: unknowns, entries of N and T, factorisations."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_tresca import ContactPair, Frictionless, RigidPlane
from scenes.two_bricks import bricks_problem, two_bricks


class Factorisations:
    """Counts factorisations in a `with` block.

    The block is a new stage of PETSc's log, since PETSc does not count further in a stage in which
    an error has occurred.
    """

    def __enter__(self) -> Factorisations:
        PETSc.Log.begin()  # no effect if PETSc counts already
        self._stage = PETSc.Log.Stage("factorisations")
        self._events = [PETSc.Log.Event(name) for name in ("MatCholFctrNum", "MatLUFactorNum")]
        self._stage.push()
        self._before = self._all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stage.pop()

    @property
    def count(self) -> int:
        """Number of factorisations since the block began."""
        return self._all() - self._before

    def _all(self) -> int:
        return sum(int(event.getPerfInfo()["count"]) for event in self._events)


def multipliers(comm, problem) -> int:
    """How many there are on all ranks."""
    return comm.allreduce(len(problem._contact.surfaces.jump.stress_scale), op=MPI.SUM)


def entries(problem) -> int:
    """Of N and T together."""
    return int(problem._contact.surfaces.jump.matrix.getInfo(2)["nz_used"])  # 2: of all ranks


def test_a_mixed_scene_has_the_sum(comm):
    """A frictional pair, and a frictionless one far below."""
    scene = two_bricks(comm, 4)
    tags = scene.tags
    plane = ContactPair(
        scene.facet_tags,
        tags["upper_contact"],
        RigidPlane((0.0, 0.0, -10.0), (0.0, 0.0, 1.0)),
        Frictionless(),
        search_distance=100.0,
    )
    with scene.problem() as problem:
        frictional, nodes = multipliers(comm, problem), problem.contact_nodes
        before = entries(problem)
    with scene.problem(pairs=[scene.pair, plane]) as problem:
        added = problem.contact_nodes - nodes
        assert multipliers(comm, problem) == frictional + added
        assert entries(problem) == before + added  # normals along an axis: one entry in each row


def test_one_factorisation_for_any_number_of_solves(comm):
    """Of K, and of the small matrix of the energy bound."""
    with Factorisations() as factored, bricks_problem(comm, 4) as problem:
        assert factored.count == 1
        for asked in ({"rtol": 1e-6}, {"accuracy": 1e-3}, {}):
            problem.solve(**asked)
            assert factored.count == 2
        problem.update_stiffness()
        problem.solve()
        assert factored.count <= 4
