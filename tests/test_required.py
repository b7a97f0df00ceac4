"""Only what the scene requires: unknowns, entries of N and T, factorisations."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from patches import patch
from scenes import bricks_problem, reassembled, two_bricks

import dolfinx_tresca.dual.compliance
from dolfinx_tresca import Bonded, ContactPair, Frictionless, RigidPlane, Tresca
from dolfinx_tresca.stiffness.solver import StiffnessSolver


def multipliers(comm, problem) -> int:
    """How many there are on all ranks."""
    return comm.allreduce(len(problem._jump.stress_scale), op=MPI.SUM)


def entries(problem) -> int:
    """Of N and T together."""
    return int(problem._jump.matrix.getInfo(2)["nz_used"])  # 2: of all ranks


@pytest.mark.parametrize(
    ("kind", "friction", "per_node"),
    [
        ("tetrahedron", Tresca(1.0), 3),
        ("tetrahedron", Frictionless(), 1),
        ("tetrahedron", Bonded(), 3),
        ("triangle", Tresca(1.0), 2),
        ("triangle", Frictionless(), 1),
    ],
)
def test_multipliers_of_a_node(comm, kind, friction, per_node):
    with patch(comm, kind, friction=friction).problem() as problem:
        assert multipliers(comm, problem) == per_node * problem.contact_nodes


def test_a_mixed_scene_has_the_sum(comm):
    """A frictional pair, and a frictionless one far below."""
    scene = two_bricks(comm, 4)
    tags = scene.bricks.tags
    plane = ContactPair(
        scene.bricks.facet_tags,
        tags["upper_contact"],
        RigidPlane((0.0, 0.0, -10.0), (0.0, 0.0, 1.0)),
        Frictionless(),
        search_distance=100.0,
    )
    with reassembled(scene) as problem:
        frictional, nodes = multipliers(comm, problem), problem.contact_nodes
    with reassembled(scene, pairs=[scene.pair, plane]) as problem:
        assert multipliers(comm, problem) == frictional + problem.contact_nodes - nodes


def test_an_obstacle_has_one_side(comm):
    """Its rows hold the node alone; where nodes meet nodes there are two, else several."""
    scene = two_bricks(comm, 4)
    plane = RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    facets, tag = scene.bricks.facet_tags, scene.bricks.tags["upper_contact"]
    with reassembled(scene) as problem:
        matching, rows = entries(problem), multipliers(comm, problem)
    with reassembled(scene, pairs=[ContactPair(facets, tag, plane, Tresca(1.0))]) as problem:
        obstacle = entries(problem)
        assert multipliers(comm, problem) == rows
    with patch(comm, "tetrahedron", friction=Tresca(1.0)).problem() as problem:
        mortar = entries(problem) / multipliers(comm, problem)
    assert 2 * obstacle <= matching
    assert mortar > matching / rows


def test_surfaces_out_of_reach_carry_no_multiplier(comm):
    scene = patch(comm, "tetrahedron", friction=Tresca(1.0), span=[(0.0, 1.5), (0.0, 1.0)])
    with scene.problem() as problem:
        near = problem.contact_nodes
    upper = comm.allreduce(
        int((np.abs(scene.V.tabulate_dof_coordinates()[:, 2] - 1.0) < 1e-9).sum()), op=MPI.SUM
    )
    assert 0 < near < upper


def test_one_factorisation_for_any_number_of_solves(comm, monkeypatch):
    """Of K, and with it one of the small matrix of the energy bound; none of anything else."""
    names = []
    original = StiffnessSolver.__init__

    def counting(self, name, K, *arguments, **options):
        names.append(K.getSize()[0])
        original(self, name, K, *arguments, **options)

    monkeypatch.setattr(StiffnessSolver, "__init__", counting)
    with bricks_problem(comm, 4) as problem:
        problem.solve(rtol=1e-6)
        problem.solve(accuracy=1e-3)
        problem.solve()
        dofs = problem._system.K.getSize()[0]
        assert names == [dofs, multipliers(comm, problem)]


def test_the_mesh_error_is_prepared_when_it_is_asked_for(comm, monkeypatch):
    made = []
    original = dolfinx_tresca.dual.compliance.DiscretisationError

    def counting(*arguments):
        made.append(1)
        return original(*arguments)

    monkeypatch.setattr(dolfinx_tresca.dual.compliance, "DiscretisationError", counting)
    with bricks_problem(comm, 3) as problem:
        problem.solve(rtol=1e-6)
        problem.solve(accuracy=1e-3)
        assert made == []
        problem.solve()
        problem.solve()
        assert made == [1]
