"""The lift of least energy beside a pressure: what A says of it."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import Tresca
from dolfinx_tresca.dual.energy_bound import SaddleLift
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.operator import DualOperator
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.stiffness.choice import cholesky
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.blocks import LEFT, YOUNG, block
from scenes.pressures import with_pressure
from scenes.scene import EPS


@pytest.mark.parallel
@pytest.mark.parametrize("repeated", [False, True])
def test_the_energy_is_the_least(comm, repeated):
    """That of the displacement under forces on the contact alone; infinite if no w has the jump."""
    plain = block(comm, (3, 2), degree=2, held=(LEFT,), friction=Tresca(1.0))
    scene = with_pressure(plain, YOUNG, 0.5)
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        pair = pair_surfaces(system.V, system.prescribed_displacements, scene.pair)
        pairs = [pair, pair] if repeated else [pair]
        with JumpOperator(system, pairs) as jump:
            lifted = SaddleLift(jump)
            z = np.random.default_rng(comm.rank).uniform(-1.0, 1.0, len(jump.stress_scale))
            if repeated:
                assert lifted.energy_norm(z) == np.inf
                return
            solver = cholesky(system.K, {}, None, system.saddle_size)
            with solver, DualOperator(jump, solver) as operator:
                product = operator.apply(z)
            energy = np.sqrt(float(jump.reductions.inner(z, product)))
            assert lifted.energy_norm(product) == pytest.approx(energy, rel=1e6 * EPS)
            assert lifted.energy_norm(np.zeros_like(z)) == 0.0
