"""The lift of given jumps: its energy, and jumps that no displacement has."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from dolfinx_tresca import Tresca
from dolfinx_tresca._base.tolerances import FULL_ACCURACY
from dolfinx_tresca.dual.energy_bound import Lift
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.patches import patch
from scenes.scene import Scene


@contextmanager
def jump_of(scene: Scene, repeated: bool = False) -> Iterator[JumpOperator]:
    """B of a scene, with each row twice if asked for."""
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        pair = pair_surfaces(scene.V, system.prescribed, scene.pair)
        with JumpOperator(system, [pair, pair] if repeated else [pair]) as jump:
            yield jump


@pytest.mark.parallel
def test_the_energy_is_that_of_the_lift(comm):
    """W = D B'z with B w = jump: |w|_K is known where z is given."""
    # a finer secondary side: rows of different ranks meet in primary nodes
    scene = patch(comm, "tetrahedron", upper=(6, 1), lower=(2, 1), friction=Tresca(0.1))
    with jump_of(scene) as jump:
        lifted = Lift(jump)
        z = np.random.default_rng(comm.rank).uniform(-1.0, 1.0, len(jump.stress_scale))
        K = jump.system.K
        w, Kw = K.createVecs()
        compliance = K.getDiagonal()
        compliance.array = np.where(jump.system.prescribed, 0.0, 1.0 / compliance.array)
        w.pointwiseMult(compliance, jump.contact_force(z))
        K.mult(w, Kw)
        expected = np.sqrt(w.dot(Kw))
        # the energy is as accurate as the solve, but for the condition of the matrix, below 100
        found = lifted.energy_norm(jump.of_unknowns(w))
        assert found == pytest.approx(expected, rel=1e3 * FULL_ACCURACY)
        assert lifted.energy_norm(np.zeros_like(z)) == 0.0
        for owned in (w, Kw, compliance):
            owned.destroy()


@pytest.mark.parallel
def test_jumps_that_no_displacement_has(comm):
    """Rows that are there twice, with jumps that differ."""
    scene = patch(comm, "tetrahedron", upper=(3, 1), lower=(2, 1))
    with jump_of(scene, repeated=True) as jump:
        lifted = Lift(jump)
        first, second = (normal for normal, _ in jump.slices)
        wanted = np.zeros(len(jump.stress_scale))
        wanted[first], wanted[second] = 1.0, -1.0
        assert lifted.energy_norm(wanted) == np.inf
