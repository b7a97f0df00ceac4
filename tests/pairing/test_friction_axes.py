"""Tangents along the axes of friction, and the bounds along them."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import InputError
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.discs import FrictionDiscs
from dolfinx_tresca.pairing.friction_axes import NodalEllipses, along_axes
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.blocks import ABOVE, FRONT, block
from scenes.scene import EPS

#: Rounding of lengths and directions: of terms of up to 10 over lengths of 5, in ten operations.
ROUNDING = 64 * EPS


def floor_operators(comm, **arguments):
    """The space, and the operators of a block on the floor."""
    model = block(comm, **arguments)
    with LinearSystem(model.a, model.L, model.bcs) as system:
        return model.V, pair_surfaces(model.V, system.prescribed, model.pairs[0])


def ellipses_of(pair, direction, shape) -> NodalEllipses:
    count = len(pair.nodes)
    return NodalEllipses(
        np.tile(np.array(direction, dtype=float), (count, 1)), np.tile(shape, (count, 1))
    )


@pytest.mark.parallel
def test_tangents_are_the_axes_and_rows_turn_with_them(comm):
    V, pair = floor_operators(comm)
    turned = along_axes(V, pair, ellipses_of(pair, (3.0, 4.0, -7.0), (0.5, 1.0)))
    first = turned.tangents[::2]
    second = np.cross(pair.normals[turned.tangent_node[::2]], first)
    assert np.abs(first - [0.6, 0.8, 0.0]).max(initial=0.0) <= ROUNDING
    assert np.abs(turned.tangents[1::2] - second).max(initial=0.0) <= ROUNDING
    assert np.abs(turned.semi_axes - np.tile([0.5, 1.0], len(first))).max(initial=0.0) <= ROUNDING
    # the jump is the same vector
    u = np.random.default_rng(1).standard_normal(pair.T.shape[1])
    vectors = [one.tangential_vectors(one.T @ u) for one in (pair, turned)]
    assert np.abs(vectors[0] - vectors[1]).max(initial=0.0) <= 100 * EPS * np.abs(u).max()
    again = along_axes(V, turned, ellipses_of(pair, (0.3, 0.4, 1.0), (0.5, 1.0)))
    assert again is turned  # for nothing is new
    assert (turned is pair) == (len(first) == 0)


@pytest.mark.parametrize("shape", [(1.0, 0.25), (0.0, 1.0), (1.0, 1e-17)])
def test_one_tangent_has_the_section_of_the_ellipse(comm, shape):
    V, pair = floor_operators(comm, across=(FRONT,))
    alone = np.bincount(pair.tangent_node, minlength=len(pair.nodes))[pair.tangent_node] == 1
    for angle in (0.0, 0.4, 0.5 * np.pi):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        found = along_axes(V, pair, ellipses_of(pair, direction, shape))
        # the semi-diameter by the support of points on the ellipse
        t = np.array([np.cos(angle), np.sin(angle)])
        axes = np.array([value if value > 1e-15 else 0.0 for value in shape])
        leans = np.abs(t) > 1e-15
        expected = 0.0
        if (axes[leans] > 0.0).all():
            expected = 1.0 / np.linalg.norm(t[leans] / axes[leans])
        assert np.abs(found.semi_axes[alone] - expected).max(initial=0.0) <= ROUNDING
        assert (found.tangents[alone] == pair.tangents[alone]).all()
        discs = FrictionDiscs.of(found)
        assert (
            np.abs(discs.radius[pair.tangent_node[alone]] - expected).max(initial=0.0) <= ROUNDING
        )
        assert not discs.frictionless[alone].any()


@pytest.mark.parametrize("shape", [(1.0, 0.25), (0.2, 1.0), (1.0, 1.0), (0.0, 1.0)])
def test_discs_are_the_ellipses_stretched(comm, shape):
    V, pair = floor_operators(comm)
    turned = along_axes(V, pair, ellipses_of(pair, (1.0, 0.0, 0.0), shape))
    discs = FrictionDiscs.of(turned)
    rubs = turned.semi_axes > 0.0
    bound = (discs.stretch * discs.radius[turned.tangent_node])[rubs]
    assert np.abs(bound - turned.semi_axes[rubs]).max(initial=0.0) <= ROUNDING
    assert (discs.frictionless == ~rubs).all() and (discs.stretch[~rubs] == 1.0).all()


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ((0.0, 0.0, 2.0), "is normal to the surface: found .0, 0, 2. at "),
        ((0.0, 0.0, 0.0), "is zero: found"),
        ((np.nan, 0.0, 1.0), "is not finite: found .nan, 0, 1. at"),
    ],
)
def test_a_direction_that_is_none_in_the_surface(comm, direction, text):
    """At one node of one rank; it names the place."""
    V, pair = floor_operators(comm, held=(ABOVE,))
    ellipses = ellipses_of(pair, (1.0, 0.0, 0.0), (1.0, 0.5))
    here = V.tabulate_dof_coordinates()[pair.nodes]
    corner = np.linalg.norm(here - [1.0, 1.0, 0.0], axis=1) < 1e-9
    ellipses.direction[corner] = direction
    with pytest.raises(InputError, match=f"{text}.*1, 1, 0.*normal .0, 0, -1.*at 1 of"):
        along_axes(V, pair, ellipses)
    ellipses.shape[corner] = 1.0  # a circle has no need of it
    assert np.isfinite(along_axes(V, pair, ellipses).tangents).all()
