"""Adapted meshes are the same on any number of ranks."""

from __future__ import annotations

from mpi4py import MPI

import pytest

from dolfinx_tresca import solve_adaptively
from scenes.two_bricks import on_bricks, two_bricks


@pytest.mark.parallel
def test_iterative_solves_mark_the_same_cells(comm):
    """What they leave is another thing on each number of ranks; also in a second load step."""

    def build(tagged):
        return on_bricks(tagged).problem(stiffness="multigrid")

    def unknowns(ranks) -> list[list[int]]:
        coarse, last, found = two_bricks(ranks, 4).tagged_mesh, None, []
        for _ in range(2):
            step = solve_adaptively(build, coarse, 0.01, max_levels=3, after=last)
            found.append([level.free_dofs for level in step.levels])
            last = step.solution
        return found

    assert unknowns(comm) == unknowns(MPI.COMM_SELF)
