"""Bodies pressed together and rubbed to and fro: Cattaneo and Mindlin."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from scenes.cattaneo_cycle import cycle_errors

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")


#: Rates at least: h where stresses end like a square root, more for integrals of them.
RATES = {"pressure": 0.7, "traction": 0.7, "contact": 1.5, "stick": 1.5, "dissipation": 1.5}

#: Loads over which errors are averaged, since they depend on where edges lie between nodes.
LOADS = (1.0, 1.2, 1.45, 1.75)

#: Bodies are mirrored, but slopes of a/R at the edge of the contact mix pressures into tractions;
#: in 3D slip is parallel only about.
MASING = {2: 1e-4, 3: 5e-4}


def check_rates(dim: int, sizes: tuple[int, ...], rates: dict[str, float]) -> None:
    """Compare fitted rates with the least ones; and check Masing's rule, and that loops close."""
    found = [cycle_errors(MPI.COMM_SELF, dim, n, 1e-9, LOADS) for n in sizes]
    cells = np.log([errors["cell"] for errors in found])
    for name, least in rates.items():
        rate = np.polyfit(cells, np.log([errors[name] for errors in found]), 1)[0]
        assert rate >= least, name
    for errors in found:
        assert errors["masing"] <= MASING[dim]
        assert errors["open"] <= 0.1 * MASING[dim]


def test_rates():
    check_rates(2, (24, 96), RATES)


def test_a_cycle_in_3d():
    """Errors on a coarse mesh are small beside the cells, or their squares for integrals."""
    errors = cycle_errors(MPI.COMM_SELF, 3, 12, 1e-6)
    for name, rate in RATES.items():
        assert errors[name] <= 0.5 * errors["cell"] ** (rate > 1.0), name
    assert errors["masing"] <= MASING[3]


@pytest.mark.long
def test_rates_in_3d():
    """Errors fall with the mesh, and the shift converges to that of the finite bodies."""
    check_rates(3, (12, 16, 24), {**RATES, "shift": 1.5})
