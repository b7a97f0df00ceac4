"""One declaration for all bodies that may touch, and for a body that touches itself."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    Coulomb,
    Frictionless,
    InputError,
    NonlinearContactProblem,
    PairingError,
    SolverOptions,
)
from dolfinx_tresca.pairing.group import PairGroup, Undeformed
from dolfinx_tresca.pairing.pair_surfaces import pair_displaced_surfaces
from scenes.boxes import Body, boxes
from scenes.elasticity import fixed
from scenes.rubber_block import neo_hookean
from scenes.slot import slot
from scenes.wall import FRICTION, HEIGHT, tower, wall

RTOL = 1e-9


def itself(comm, tags, friction, **options):
    """Return a pair of all tagged surfaces with themselves."""
    every = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
    return ContactPair(tags, every, every, friction, **options)


def solved(scene, pairs):
    with scene.problem(pairs=pairs) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
    return solution


@pytest.mark.parallel
def test_a_tower(comm):
    """The lower of two equal blocks is the first one, and so secondary."""
    scene = tower(comm, 3, 0.25)
    scene.data.push.value = 0.1 * scene.data.weights[-1] / HEIGHT
    floor, *joints = scene.pairs
    by_hand = [replace(one, secondary=one.primary, primary=one.secondary) for one in joints]
    expected = solved(scene, [floor, *by_hand])
    found = solved(scene, [floor, itself(comm, scene.facet_tags, Coulomb(FRICTION))])
    assert found.counts == expected.counts
    assert found.primal_energy == pytest.approx(expected.primal_energy, rel=100 * RTOL)


@pytest.mark.parallel
def test_a_wall(comm):
    """Sides are exchanged in a part of the joints, which changes the energy by the mesh error."""
    scene = wall(comm, 2, 3)
    push = 0.2 * scene.data.weights.sum() / 3
    scene.data.push.value = push / HEIGHT
    expected = solved(scene, scene.pairs)
    found = solved(scene, [scene.pairs[0], itself(comm, scene.facet_tags, Coulomb(FRICTION))])
    assert found.primal_energy == pytest.approx(expected.primal_energy, rel=1e-2)
    for one, other in zip(found.body_resultants, expected.body_resultants, strict=True):
        assert one.force == pytest.approx(other.force, abs=1e-7 * push)
    assert found.pair_resultants[0].force == pytest.approx(
        [push, scene.data.weights.sum()], rel=1e-6
    )


@pytest.mark.parallel
def test_forces_between_bodies(comm):
    """Those on a block balance its weight, and each is opposed to the other's."""
    scene = tower(comm, 3, 0.25)
    push = 0.1 * scene.data.weights[-1]
    scene.data.push.value = push / HEIGHT
    solution = solved(scene, [scene.pairs[0], itself(comm, scene.facet_tags, Coulomb(FRICTION))])
    assert sorted(solution.between_bodies) == [(0, 1), (1, 2)]
    weight = scene.data.weights[-1]
    for lower in (0, 1):
        above = np.array([-push, -(2 - lower) * weight])
        on_lower = solution.resultants_between(lower, lower + 1)
        assert on_lower.force == pytest.approx(above, rel=1e-6)
        on_upper = solution.resultants_between(lower + 1, lower, point=(0.1, 0.2))
        assert on_upper.force == pytest.approx(-above, rel=1e-6)
        assert on_upper.moment == pytest.approx(-on_lower.about((0.1, 0.2)).moment)
    # of the uppermost block: the push at mid height, the weight at mid width
    arm = on_upper.about((0.125, 2.5 * HEIGHT)).moment
    assert arm == pytest.approx([0.0], abs=1e-6 * weight)
    assert not solution.resultants_between(0, 2).force.any()
    for wrong in ((0, 3), (1, 1), (-1, 0), (0, "1")):
        with pytest.raises(InputError, match=r"body is given by its index from 0 to 2|1 twice"):
            solution.resultants_between(*wrong)
    assert solution.body_names == ("body 1", "body 2", "body 3")
    assert (solution.resultants_between("body 2", "body 3").force == -on_upper.force).all()
    assert "2 pairs of bodies push each other" in str(solution)


@pytest.mark.parallel(kind=["quadrilateral"], angle=[0.4])
@pytest.mark.parametrize(
    ("kind", "angle", "gap"),
    [
        ("quadrilateral", 0.0, 1e-3),
        ("quadrilateral", 0.4, -0.005),
        ("quadrilateral", 0.59, 1e-3),
        ("quadrilateral", 2.2, 1e-3),
        ("tetrahedron", 0.4, 1e-3),
    ],
)
def test_a_slot(comm, kind, angle, gap):
    """One face of it is secondary in all places, whatever its direction: as if tagged by hand."""
    scene = slot(comm, kind, gap, angle=angle, shift=0.06, across=12 if "quad" in kind else 8)
    found = solved(scene, scene.pairs)
    by_hand = [solved(scene, [pair]) for pair in scene.data.halves]
    energies = [one.primal_energy for one in by_hand]
    same = by_hand[int(np.argmin(np.abs(np.array(energies) - found.primal_energy)))]
    assert found.counts == same.counts and found.counts.contact >= 7
    assert found.primal_energy == pytest.approx(same.primal_energy, rel=100 * RTOL)
    assert found.normal_force == pytest.approx(same.normal_force, rel=1e4 * RTOL)


def folded(x):
    """Return where points (n, 2) of a strip are that is folded upwards at x = 0, by 180 degrees."""
    radius, inside = 0.15, np.clip(x[:, 0], -0.5 * np.pi * 0.15, 0.5 * np.pi * 0.15)
    phi, rest = inside / radius, x[:, 0] - inside
    around = radius - x[:, 1]
    place = np.column_stack([around * np.sin(phi), radius - around * np.cos(phi)])
    return place + rest[:, None] * np.column_stack([np.cos(phi), np.sin(phi)])


@pytest.mark.parallel
def test_a_folded_strip(comm):
    """Facets of a flat sheet meet that have the same normal in the undeformed mesh."""
    made = boxes(comm, "quadrilateral", [Body((41, 1), [(-1.0, 1.0), (0.0, 0.1)])])
    left, right = 1, 2
    tags = made.tags(
        (left, [0], lambda x: (x[:, 1] > 0.099) & (x[:, 0] < -0.21)),
        (right, [0], lambda x: (x[:, 1] > 0.099) & (x[:, 0] > 0.21)),
    )
    V = made.V
    u = fem.Function(V)
    u.interpolate(lambda x: (folded(x[:2].T) - x[:2].T).T)
    u.x.scatter_forward()
    free = np.zeros(V.dofmap.index_map.size_local * 2, dtype=np.bool_)
    by_hand = ContactPair(tags, left, right, Frictionless(), sliding="finite")
    one, other = (
        pair_displaced_surfaces(
            V, Undeformed.from_mesh(V, free, PairGroup.from_pairs([pair])), u.x.array.reshape(-1, 2)
        )[0]
        for pair in (by_hand, itself(comm, tags, Frictionless(), sliding="finite"))
    )
    expected, found = (
        [comm.allreduce(value) for value in (k.weights.sum(), (k.weights * k.distance).sum())]
        for k in (one, other)
    )
    assert expected[0] > 0.5
    assert found == pytest.approx(expected, rel=1e-9)


def force_after(made, tags, sides, still, pushed, path):
    """Return the size of the contact force on rubber after displacements of a surface."""
    u = fem.Function(made.V)
    F = ufl.derivative(neo_hookean(u) * ufl.dx, u, ufl.TestFunction(made.V))
    motion = fem.Constant(made.mesh, np.zeros(2))
    bcs = [fixed(made.V, tags.find(still)), fixed(made.V, tags.find(pushed), motion)]
    pair = ContactPair(tags, *sides, Coulomb(0.3), sliding="finite")
    options = SolverOptions(rtol=1e-8, geometry_accuracy=1e-5)
    with NonlinearContactProblem(F, u, [pair], bcs, options=options) as problem:
        for motion.value[:] in path:
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
    return np.abs(solution.pair_resultants[0].force)


@pytest.mark.parallel
def test_a_fold_of_a_bellows_is_pressed_together(comm):
    """Two arms of rubber, joined by a bend: the inside touches itself as arms tagged by hand do."""
    made = boxes(comm, "quadrilateral", [Body((42, 3), [(-1, 1), (0, 0.1)], move=folded)])
    left, right, bend, still, pushed = 1, 2, 3, 4, 5

    def inside(x):
        return x[:, 1] > 0.1 - 1e-9

    tags = made.tags(
        (left, [0], lambda x: inside(x) & (x[:, 0] < -0.23)),
        (right, [0], lambda x: inside(x) & (x[:, 0] > 0.23)),
        (bend, [0], lambda x: inside(x) & (np.abs(x[:, 0]) < 0.25)),
        (still, [0], lambda x: (x[:, 1] < 1e-9) & (np.abs(x[:, 0] + 0.7) < 0.1)),
        (pushed, [0], lambda x: (x[:, 1] < 1e-9) & (np.abs(x[:, 0] - 0.7) < 0.1)),
    )
    every, path = [left, right, bend], [(-0.08, 0.0), (-0.16, 0.0)]
    forces = [
        force_after(made, tags, sides, still, pushed, path)
        for sides in ((left, right), (every, every))
    ]
    assert forces[0].max() > 1e-3
    assert forces[1] == pytest.approx(forces[0], abs=1e-3 * forces[0].max())


def ring(comm, N=40, opening=0.06):
    """Return a ring that is open on one side, and tags of its ends, inside and supports."""

    def bent(x):
        phi = opening + (2.0 * np.pi - 2.0 * opening) * x[:, 0]
        return ((1.0 + 0.3 * x[:, 1]) * np.array([np.cos(phi), np.sin(phi)])).T

    def outside(middle):
        return lambda x: (x[:, 1] > 1 - 1e-9) & (np.abs(x[:, 0] - middle) < 0.06)

    made = boxes(comm, "quadrilateral", [Body((N, 2), [(0, 1), (0, 1)], move=bent)])
    tags = made.tags(
        (1, [0], lambda x: x[:, 0] < 1e-9),
        (2, [0], lambda x: x[:, 0] > 1 - 1e-9),
        (3, [0], lambda x: x[:, 1] < 1e-9),
        (4, [0], outside(0.25)),
        (5, [0], outside(0.75)),
    )
    return made, tags


@pytest.mark.parallel
def test_a_ring_is_squeezed_until_it_closes(comm):
    made, tags = ring(comm)
    forces = [
        force_after(made, tags, sides, 5, 4, [(0.0, -0.2)])
        for sides in ((1, 2), ([1, 2, 3], [1, 2, 3]))
    ]
    assert forces[0].max() > 1e-3
    # which end is secondary changes normals, by the turn of the ends
    assert forces[1] == pytest.approx(forces[0], abs=1e-3 * forces[0].max())


@pytest.mark.parallel
def test_nothing_that_can_touch(comm):
    made = boxes(comm, "triangle", [Body((2, 2), [(0, 1), (0, 1)])])
    tags = made.tags((7, [0], None))
    with pytest.raises(PairingError, match=r"no part of the surface \(tag 7\) can touch"):
        made.operators(ContactPair(tags, 7, 7, Frictionless()))
    with_finite_sliding = ContactPair(tags, 7, 7, Frictionless(), sliding="finite")
    assert len(made.operators(with_finite_sliding).nodes) == 0


@pytest.mark.parametrize(
    ("secondary", "primary", "message"),
    [
        ([], [], r"a list of tags must have the integer tags .*found \[\]"),
        ([1, "a"], [1, "a"], "a list of tags must have the integer tags"),
        ([1, 2], [2, 3], r"the tags \[2\] are on both sides, and others are not"),
        ([1, 2], 2, r"the tags \[2\] are on both sides"),
        (1, [1, 2], r"the tags \[1\] are on both sides"),
        (1, [2, "a"], "a list of tags must have the integer tags"),
        (1, [2, 2**40], "a list of tags must have the integer tags"),
    ],
)
def test_lists_of_tags(secondary, primary, message):
    made = boxes(MPI.COMM_SELF, "triangle", [Body((2, 2), [(0, 1), (0, 1)])])
    tags = made.tags((1, [0], None))
    with pytest.raises(InputError, match=message):
        ContactPair(tags, secondary, primary, Frictionless())
