"""Convergence to a known smooth solution, on coarse meshes."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from scenes.manufactured import blocks_scene, errors_of

#: Least rates of the error in the energy norm: theory has 1 and 1.5.
ENERGY = {1: 0.9, 2: 1.4}

#: Least rates of pressure and slip in L2. The multipliers are exact for constants only, so their
#: theory has 1 for the pressure; the values at nodes that are measured here do better.
PRESSURE, SLIP = 1.2, 1.3

SIZES = {
    "triangle": (2, 4, 8),
    "quadrilateral": (2, 4, 8),
    "tetrahedron": (1, 2),
    "hexahedron": (1, 2),
}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", SIZES)
def test_rates(comm, cell, degree):
    """Pressed and slipping everywhere, so that nothing but the elements limits the rate."""
    errors = []
    for k in SIZES[cell]:
        scene = blocks_scene(comm, cell, degree, (2 * k, 3 * k))
        with scene.problem() as problem:
            solution = problem.solve(rtol=1e-8)
            assert solution.counts.contact == solution.counts.slip == problem.contact_nodes
        errors.append(errors_of(scene, solution))
    least = {"energy": ENERGY[degree], "pressure": PRESSURE, "slip": SLIP}
    for (coarse, fine), (k, finer) in zip(pairwise(errors), pairwise(SIZES[cell]), strict=True):
        for name, rate in least.items():
            assert math.log(coarse[name] / fine[name]) / math.log(finer / k) > rate, (name, finer)
