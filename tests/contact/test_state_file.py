"""Nodes that are the same ones on other ranks."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca._base.functions import owned_values
from dolfinx_tresca.contact.state_file import SAME_PLACE, same_nodes, surroundings
from scenes.patches import patch


def bodies(comm: MPI.Comm, degree: int):
    """Return where nodes are, and the height of their body, which tells those that touch."""
    scene = patch(comm, "tetrahedron", degree, upper=(2, 1), lower=(2, 1))
    at = surroundings(scene.V)
    return at, at[:, -1] > 1.0, scene


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_nodes_of_two_bodies_on_any_ranks(comm, degree):
    """Each has one row, that of its own body, in whatever order they come."""
    at, upper, scene = bodies(comm, degree)
    assert len(at) == len(owned_values(scene.data.exact))
    at, upper = (np.concatenate(comm.allgather(values)) for values in (at, upper))
    assert len(np.unique(at[:, :3].round(9), axis=0)) < len(at)  # some touch
    known, above, _ = bodies(MPI.COMM_SELF, degree)
    mixed = np.random.default_rng(1).permutation(len(known))
    rows = same_nodes(known[mixed], at)
    assert np.array_equal(np.sort(rows), np.arange(len(at)))
    assert np.array_equal(above[mixed][rows], upper)
    assert np.abs(known[mixed][rows] - at).max() < 1e-9
    known[0, 0] += 1e-6
    assert same_nodes(known, at) is None
    assert same_nodes(known[1:], at) is None


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_rounding_of_places_is_relative_to_the_size_of_the_mesh(size):
    """Nodes may be off by rounding in any unit; those of another mesh are refused."""
    places = size * np.random.default_rng(0).random((20, 6))
    extent = np.ptp(places, axis=0).max()
    within, beyond = (places + factor * SAME_PLACE * extent for factor in (0.1, 2.0))
    assert np.array_equal(same_nodes(within, places), np.arange(20))
    assert same_nodes(beyond, places) is None
