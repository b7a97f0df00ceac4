"""Orthotropic friction: tangents along the axes, and the bounds along them."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import InputError
from dolfinx_tresca.dual.slip_bounds import (
    FrictionDiscs,
    NodalEllipses,
    with_tangents_along_axes,
)
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.blocks import ABOVE, FRONT, block
from scenes.scene import EPS

#: Rounding of lengths and directions: of terms of up to 10 over lengths of 5, in ten operations.
ROUNDING = 64 * EPS


def floor_operators(comm, **arguments):
    """Return the space and the operators of a block on the floor."""
    model = block(comm, **arguments)
    with LinearSystem(model.a, model.L, model.bcs) as system:
        return model.V, pair_surfaces(model.V, system.prescribed, model.pairs[0])


def ellipses_of(pair, direction, shape) -> NodalEllipses:
    count = len(pair.nodes)
    return NodalEllipses(
        np.tile(np.array(direction, dtype=float), (count, 1)), np.tile(shape, (count, 1))
    )


@pytest.mark.parametrize("shape", [(1.0, 0.25), (0.0, 1.0), (1.0, 1e-17)])
def test_bound_of_a_single_tangent_is_the_semi_diameter(comm, shape):
    V, pair = floor_operators(comm, across=(FRONT,))
    alone = np.bincount(pair.tangent_node, minlength=len(pair.nodes))[pair.tangent_node] == 1
    for angle in (0.0, 0.4, 0.5 * np.pi):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        found = with_tangents_along_axes(V, pair, ellipses_of(pair, direction, shape))
        # |t / axes| = 1 for a point t of the ellipse
        t = np.array([np.cos(angle), np.sin(angle)])
        axes = np.array([value if value > 1e-15 else 0.0 for value in shape])
        nonzero = np.abs(t) > 1e-15
        expected = 0.0
        if (axes[nonzero] > 0.0).all():
            expected = 1.0 / np.linalg.norm(t[nonzero] / axes[nonzero])
        assert np.abs(found.semi_axes[alone] - expected).max(initial=0.0) <= ROUNDING
        assert (found.tangents[alone] == pair.tangents[alone]).all()
        discs = FrictionDiscs.from_pair(found)
        assert (
            np.abs(discs.radius[pair.tangent_node[alone]] - expected).max(initial=0.0) <= ROUNDING
        )
        assert not discs.frictionless[alone].any()


@pytest.mark.parametrize("shape", [(1.0, 0.25), (0.2, 1.0), (1.0, 1.0), (0.0, 1.0)])
def test_discs_are_the_ellipses_stretched(comm, shape):
    V, pair = floor_operators(comm)
    turned = with_tangents_along_axes(V, pair, ellipses_of(pair, (1.0, 0.0, 0.0), shape))
    discs = FrictionDiscs.from_pair(turned)
    positive = turned.semi_axes > 0.0
    bound = (discs.stretch * discs.radius[turned.tangent_node])[positive]
    assert np.abs(bound - turned.semi_axes[positive]).max(initial=0.0) <= ROUNDING
    assert (discs.frictionless == ~positive).all() and (discs.stretch[~positive] == 1.0).all()


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ((0.0, 0.0, 2.0), "is normal to the surface: found .0, 0, 2. at "),
        ((0.0, 0.0, 0.0), "is zero: found"),
        ((np.nan, 0.0, 1.0), "is not finite: found .nan, 0, 1. at"),
    ],
)
def test_direction_without_tangential_part_is_an_error(comm, direction, text):
    """The direction is wrong at a single node, whose position the error names."""
    V, pair = floor_operators(comm, held=(ABOVE,))
    ellipses = ellipses_of(pair, (1.0, 0.0, 0.0), (1.0, 0.5))
    here = V.tabulate_dof_coordinates()[pair.nodes]
    corner = np.linalg.norm(here - [1.0, 1.0, 0.0], axis=1) < 1e-9
    ellipses.direction[corner] = direction
    with pytest.raises(InputError, match=f"{text}.*1, 1, 0.*normal .0, 0, -1.*at 1 of"):
        with_tangents_along_axes(V, pair, ellipses)
    ellipses.shape[corner] = 1.0  # a circle needs no direction
    assert np.isfinite(with_tangents_along_axes(V, pair, ellipses).tangents).all()
