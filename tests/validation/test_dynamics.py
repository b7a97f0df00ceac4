"""Steps of a block that tumbles, slides and comes to rest: see `demo_impact.py` for the scheme."""

from __future__ import annotations

import os
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb
from scenes.blocks import block
from scenes.elasticity import elasticity

RTOL = 1e-8

#: Length of a step [s], below the period of the block's bounces.
TAU = 2e-3

#: Products of a step, about: one for the step, one or two where nodes touch down.
FEW = 3


def memory() -> int:
    """Return what this process has of the memory [bytes]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize(
    ("steps", "theta"),
    [(80, 0.5), *(pytest.param(1000, theta, marks=pytest.mark.long) for theta in (0.5, 0.6))],
)
def test_energy_counts_and_memory_do_not_grow(steps, theta):
    """A block that is thrown on a floor gains no energy, and steps cost the same to the end."""
    scene = block(MPI.COMM_SELF, (8, 4), size=(0.2, 0.1), boxes=True, friction=Coulomb(0.3))
    V = scene.V
    u, v, down = fem.Function(V), fem.Function(V), fem.Constant(scene.mesh, (0.0, -9.81))
    u.interpolate(lambda x: np.vstack([0 * x[0], 0 * x[0] + 1e-3]))
    v.interpolate(lambda x: np.vstack([0 * x[0] + 1.0, -0.2 - 2 * x[0]]))

    def mass(a, b):
        return 1100.0 * ufl.inner(a, b) * ufl.dx

    trial, test = ufl.TrialFunction(V), ufl.TestFunction(V)
    stiffness = elasticity(V, 5e6)
    strain_energy = 0.5 * ufl.action(ufl.action(stiffness, u), u)
    energy = fem.form(0.5 * mass(v, v) + strain_energy - mass(down, u))
    inertia = 1 / (theta * TAU**2)
    a = inertia * mass(trial, test) + theta * stiffness
    L = inertia * mass(u + TAU * v, test) - (1 - theta) * ufl.action(stiffness, u)
    L += mass(down, test)
    energies, products, touching = [fem.assemble_scalar(energy)], [], []
    with scene.problem(a=a, L=L, bcs=[]) as problem:
        problem.set_slip_origin(u)
        for step in range(steps):
            solution = problem.solve(rtol=RTOL)
            problem.accept()
            new = solution.u.x.array
            v.x.array[:] += ((new - u.x.array) / TAU - v.x.array) / theta
            u.x.array[:] = new
            energies.append(fem.assemble_scalar(energy))
            products.append(solution.products)
            touching.append(solution.counts.contact)
            if step == 3 * steps // 10:
                before = memory()
    assert min(touching) == 0 < max(touching)
    assert np.diff(energies).max() <= RTOL * (energies[0] - min(energies))
    assert np.mean(products[steps // 2 :]) <= FEW
    if steps == 1000:
        assert max(products[steps // 2 :]) <= max(products[: steps // 2])
        assert memory() - before < 700 * 1024  # a kB a step
