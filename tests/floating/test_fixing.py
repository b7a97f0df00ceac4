"""Springs that fix floating bodies: on which nodes, and how stiff."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from scipy.sparse import csr_array

from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.fixing import FIXING_NODES, FixingSprings
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes
from scenes.scene import EPS

#: Nodes of three bodies in 2D, one after the other in the numbers of the nodes, and their modes.
NODES, MODES = (100, 7, 60), (3, 1, 2)


def springs(comm: MPI.Comm) -> tuple[FixingSprings, int]:
    """Return springs for modes that are noise, and the first node of this rank."""
    total = sum(NODES)
    basis = np.zeros((total, 2, sum(MODES)))
    rng = np.random.default_rng(0)
    nodes, modes = (np.concatenate([[0], np.cumsum(ends)]) for ends in (NODES, MODES))
    for body in range(3):
        some = np.s_[nodes[body] : nodes[body + 1], :, modes[body] : modes[body + 1]]
        basis[some] = rng.standard_normal(basis[some].shape)
    low, high = comm.rank * total // comm.size, (comm.rank + 1) * total // comm.size
    floating = RigidBodyModes(
        comm=comm,
        bodies=Bodies(
            number=3,
            tag_names=("", "", ""),
            label=np.repeat(np.arange(3), NODES)[low:high],
            bounds=np.zeros((3, 6)),
            nodes=np.array(NODES),
            arm=np.zeros((high - low, 3)),
        ),
        basis=csr_array(basis[low:high].reshape(2 * (high - low), -1)),
        stiffness=np.arange(1.0, 1.0 + sum(MODES)),
        floats=np.ones(sum(MODES), dtype=bool),
        body=np.repeat(np.arange(3), MODES),
        mode_components=csr_array((9, sum(MODES))),
    )
    return FixingSprings(floating), low


@pytest.mark.parallel
def test_springs_have_the_stiffness_of_their_bodies(comm):
    fixing, _ = springs(comm)
    modes = fixing.modes
    found = comm.allreduce((modes.basis.T @ fixing.columns).toarray())
    assert np.allclose(found, np.diag(np.sqrt(modes.stiffness)), atol=1e3 * EPS)


@pytest.mark.parallel
def test_they_act_on_the_same_few_nodes_on_any_number_of_ranks(comm):
    fixed = []
    for ranks in (MPI.COMM_SELF, comm):
        fixing, low = springs(ranks)
        nodes = low + np.unique(fixing.columns.nonzero()[0] // 2)
        fixed.append(np.concatenate(ranks.allgather(nodes)))
    assert np.array_equal(*fixed)
    ends = np.cumsum(NODES)
    numbers = np.bincount(np.searchsorted(ends, fixed[0], side="right"))
    assert numbers[1] == NODES[1]  # a small body on all its nodes
    deviation = 4.0 * np.sqrt(FIXING_NODES)  # of a random number
    assert abs(numbers[0] - FIXING_NODES) <= deviation
    assert abs(numbers[2] - FIXING_NODES) <= deviation
    spread = fixed[0][fixed[0] < NODES[0]]  # all over the body
    assert len(np.unique(spread // 20)) == 5
    assert len(np.unique(np.diff(spread))) > 3
