"""Two kinds of pairing, and the two ways round, have one solution."""

from __future__ import annotations

import dataclasses
import math

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus
from dolfinx_tresca._base.parallel import reduce_array
from scenes.nodal import nodal
from scenes.rubbing import rubbing
from scenes.two_bricks import ENDS, two_bricks


@pytest.mark.parallel(end=["free_end_1"], hexahedra=[False])
@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("end", ENDS)
def test_on_matching_meshes_mortar_is_node_to_node(comm, end, hexahedra):
    """The dual multiplier basis makes the mortar matrices diagonal: even iterates are the same.

    That is, until rounding shows: to a residual of 1e-8. Fields agree to the residual times the
    condition number of A (below 1e3).
    """
    scene = two_bricks(comm, 5, end=end, hexahedra=hexahedra)
    solutions = []
    for pairing, kind in (("nodes", "node-to-node"), ("mortar", "mortar")):
        pair = dataclasses.replace(scene.pair, pairing=pairing)
        with scene.problem(pairs=[pair]) as problem:
            assert kind in str(problem)
            solutions.append(problem.solve(rtol=1e-11))
    nodes, mortar = solutions
    assert nodes.status is mortar.status is ContactStatus.CONVERGED
    assert mortar.counts == nodes.counts
    steps = sum(residual > 1e-8 for residual in nodes.residuals)
    assert steps >= 1
    assert mortar.residuals[:steps] == pytest.approx(nodes.residuals[:steps], rel=1e-3)
    for field in ("pressure", "traction", "slip", "gap", "u"):
        wanted, found = (nodal(getattr(solution, field)) for solution in solutions)
        size = comm.allreduce(np.abs(wanted).max(initial=0.0), op=MPI.MAX)
        assert np.abs(found - wanted).max(initial=0.0) <= 1e-8 * size, field
    assert mortar.normal_force == pytest.approx(nodes.normal_force, rel=1e-8)


def swapped(scene):
    """The scene with its sides exchanged."""
    return scene.but(secondary=scene.pair.primary, primary=scene.pair.secondary)


@pytest.mark.parametrize("degree", [1, 2])
def test_the_ways_round_converge_to_each_other(comm, degree):
    """Both are mortar methods: their displacements differ by O(h) at least, as from the solution.

    With sticking, slipping and open parts; the difference is measured in the energy norm, relative.
    """
    differences = []
    sizes = (2, 4, 8)
    for k in sizes:
        scene = rubbing(
            comm, "triangle", degree, upper=(2 * k, 2 * k), lower=(3 * k, 3 * k), distort=0.0
        )
        found = []
        for one in (scene, swapped(scene)):
            with one.problem() as problem:
                found.append(problem.solve(rtol=1e-9))
            assert found[-1].status is ContactStatus.CONVERGED
        here, there = found
        difference = fem.Function(scene.V)
        difference.x.array[:] = here.u.x.array - there.u.x.array
        energies = [
            reduce_array(comm, fem.assemble_scalar(fem.form(ufl.action(ufl.action(scene.a, w), w))))
            for w in (difference, here.u)
        ]
        differences.append(math.sqrt(energies[0] / energies[1]))
    # measured on 16 as well: 1.35 and 1.56
    rate = math.log(differences[0] / differences[-1]) / math.log(sizes[-1] / sizes[0])
    assert rate >= 0.8
    assert differences[-1] < 5e-3
