"""The two ways round have one solution."""

from __future__ import annotations

import math

import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus
from dolfinx_tresca._base.parallel import reduce_array
from scenes.rubbing import rubbing


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
