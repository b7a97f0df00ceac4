"""One declaration for all bodies that may touch, and for a body that touches itself."""

from __future__ import annotations

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
def test_a_wall(comm):
    """A wall with one declaration has the forces of a wall whose joints are tagged by hand."""
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
    """Forces between bodies balance weights, and each is opposed to the other's."""
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
    """A slot that touches itself has the answer of its faces tagged by hand, in any direction."""
    scene = slot(comm, kind, gap, angle=angle, shift=0.06, across=12 if "quad" in kind else 8)
    found = solved(scene, scene.pairs)
    by_hand = [solved(scene, [pair]) for pair in scene.data.halves]
    energies = [one.primal_energy for one in by_hand]
    same = by_hand[int(np.argmin(np.abs(np.array(energies) - found.primal_energy)))]
    assert found.counts == same.counts and found.counts.contact >= 7
    assert found.primal_energy == pytest.approx(same.primal_energy, rel=100 * RTOL)
    assert found.normal_force == pytest.approx(same.normal_force, rel=1e4 * RTOL)


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
        ([], [], r"secondary must be .* a list of integer tags, found \[\]"),
        ([1, "a"], [1, "a"], "a list of integer tags"),
        ([1, 2], [2, 3], r"the tags \[2\] are on both sides, and others are not"),
        ([1, 2], 2, r"the tags \[2\] are on both sides"),
        (1, [1, 2], r"the tags \[1\] are on both sides"),
        (1, [2, "a"], "a list of integer tags"),
        (1, [2, 2**40], "a list of integer tags"),
    ],
)
def test_lists_of_tags(secondary, primary, message):
    made = boxes(MPI.COMM_SELF, "triangle", [Body((2, 2), [(0, 1), (0, 1)])])
    tags = made.tags((1, [0], None))
    with pytest.raises(InputError, match=message):
        ContactPair(tags, secondary, primary, Frictionless())
