"""Adaptive solves of all kinds of scenes, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from test_solve import forms, held

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    RigidPlane,
    RigidSphere,
    TaggedMesh,
    Tresca,
    solve_adaptively,
)
from scenes.boxes import Body, boxes

LOAD = 10.0  # MPa on the top, downwards

LEVELS = 2


def stack(comm) -> TaggedMesh:
    """Three blocks, each on a wider one; names of their upper and lower sides end with numbers."""
    bodies = [Body((2 + k, 2), [(-0.25 * k, 1.0 + 0.25 * k), (-k, 1.0 - k)]) for k in range(3)]
    made = boxes(comm, "triangle", bodies)
    marks, names = [], {}
    for k in range(3):
        for name, y in (("top", 1.0 - k), ("bottom", -float(k))):
            names[f"{name}_{k}"] = len(names) + 1
            marks.append((names[f"{name}_{k}"], [k], lambda x, y=y: np.abs(x[:, 1] - y) < 1e-9))
    return TaggedMesh(made.mesh, None, made.tags(*marks), names)


def several_bodies(tagged):
    """The lowest one is clamped, friction and a bond hold the others."""
    V, a, L = forms(tagged, 1, load=LOAD, onto=["top_0"])
    tags, facets = tagged.tags, tagged.facet_tags
    pairs = [
        ContactPair(facets, tags["bottom_0"], tags["top_1"], Tresca(3.0)),
        ContactPair(facets, tags["bottom_1"], tags["top_2"], Bonded()),
    ]
    return ContactProblem(a, L, pairs, bcs=[held(tagged, V, "bottom_2")])


def floating_bodies(tagged):
    """Nothing but friction holds two of them sideways, and a floor all of them from below."""
    _, a, L = forms(tagged, 1, load=LOAD, onto=["top_0"])
    tags, facets = tagged.tags, tagged.facet_tags
    floor = RigidPlane(point=(0, -2, 0), normal=(0, 1, 0))
    pairs = [
        ContactPair(facets, tags["bottom_0"], tags["top_1"], Tresca(3.0)),
        ContactPair(facets, tags["bottom_1"], tags["top_2"], Coulomb(0.3)),
        ContactPair(facets, tags["bottom_2"], floor, Tresca(1.0)),
    ]
    return ContactProblem(a, L, pairs)


def obstacles(tagged):
    """A ball below the lowest one, whose sides are held; the others do not touch."""
    V, a, L = forms(tagged, 1, load=LOAD, onto=["top_2"])
    tags, facets = tagged.tags, tagged.facet_tags
    ball = RigidSphere((0.5, -4.0, 0.0), 2.0)
    pairs = [ContactPair(facets, tags["bottom_2"], ball, Frictionless())]
    bcs = [held(tagged, V, "bottom_0"), held(tagged, V, "bottom_1"), held(tagged, V, "top_2", 0)]
    return ContactProblem(a, L, pairs, bcs=bcs)


#: The normal force of all pairs together over the load, where statics say it.
SCENES = {several_bodies: None, floating_bodies: 3.0, obstacles: 2.0}


@pytest.mark.parallel(build=[several_bodies, floating_bodies])
@pytest.mark.parametrize("build", SCENES)
def test_scenes(comm, build):
    start = stack(comm)
    result = solve_adaptively(build, start, 1e-3, max_levels=LEVELS)
    assert [level.solution.status.name for level in result.levels] == LEVELS * ["CONVERGED"]
    errors = [level.error for level in result.levels]
    assert errors == sorted(errors, reverse=True)
    # what carries the load, to the accuracy of the iteration
    if SCENES[build]:
        assert result.solution.normal_force == pytest.approx(SCENES[build] * LOAD, rel=0.02)
