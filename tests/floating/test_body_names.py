"""Names of bodies: those of the tags of their cells in the mesh file."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    InputError,
    RigidPlane,
    read_gmsh,
    refine,
)
from scenes.elasticity import elasticity


@pytest.fixture
def blocks(comm, folder):
    """Two blocks of the material "stone" on a block of "base", with the mesh file's names."""
    lines = []
    for k in range(3):
        lines += [
            f"Point({4 * k + i + 1}) = {{{x}, {k + y}, 0, 1}};"
            for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)])
        ]
        lines += [
            f"Line({4 * k + i + 1}) = {{{4 * k + i + 1}, {4 * k + (i + 1) % 4 + 1}}};"
            for i in range(4)
        ]
        lines += [
            f"Curve Loop({k + 1}) = {{{4 * k + 1}:{4 * k + 4}}};",
            f"Plane Surface({k + 1}) = {{{k + 1}}};",
        ]
    lines += [
        'Physical Surface("base", 1) = {1};',
        'Physical Surface("stone", 2) = {2, 3};',
        'Physical Curve("floor", 1) = {1};',
        'Physical Curve("joints", 2) = {3, 5, 7, 9};',
    ]
    path = folder / "blocks.geo"
    if comm.rank == 0:
        path.write_text("\n".join(lines))
    comm.barrier()
    return read_gmsh(path, comm)


def problem_of(blocks, lift=0.0):
    V = fem.functionspace(blocks.mesh, ("Lagrange", 1, (2,)))
    v, x = ufl.TestFunction(V), ufl.SpatialCoordinate(blocks.mesh)
    L = -(1.0 - lift * ufl.conditional(x[1] > 2.0, 1.0, 0.0)) * v[1] * ufl.dx
    law = Coulomb(0.5)
    pairs = [
        ContactPair(blocks.facet_tags, 1, RigidPlane((0, 0), (0, 1)), law),
        ContactPair(blocks.facet_tags, [2], [2], law),
    ]
    return ContactProblem(elasticity(V, 1e3), L, pairs)


@pytest.mark.parallel
def test_names_are_those_of_the_cells(blocks):
    """A name that two bodies have is given with their numbers; refined meshes keep names."""
    cells = blocks.mesh.topology.index_map(2).size_local
    for mesh in (blocks, refine(blocks, np.ones(cells), fraction=1.0)):
        with problem_of(mesh) as problem:
            solution = problem.solve(rtol=1e-8)
    assert solution.body_names == ("base", "body 2 (stone)", "body 3 (stone)")
    found = solution.resultants_between("base", "body 2 (stone)")
    assert found.force == pytest.approx([0.0, -2.0], abs=1e-6)
    assert "base by body 2 (stone): " in str(solution).replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parallel
def test_errors_name_bodies(blocks):
    with problem_of(blocks, lift=1.5) as problem:
        with pytest.raises(InputError, match=r"the loads on body 3 of 3 \(stone\), between"):
            problem.solve()
