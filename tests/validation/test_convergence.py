"""Convergence to a known smooth solution: the benchmark on its coarse meshes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from convergence import measure, rates

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
    rows = [measure(comm, cell, degree, k) for k in SIZES[cell]]
    assert all(row["contact"] == row["slip_nodes"] == row["m"] for row in rows)
    for error, least in (("energy", ENERGY[degree]), ("pressure", PRESSURE), ("slip", SLIP)):
        assert min(rates(rows, error)) > least, (error, rows)
