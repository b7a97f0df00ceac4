"""What problems of bodies of revolution have in common with others, each against an analysis."""

from __future__ import annotations

import dataclasses
import math

from mpi4py import MPI

import numpy as np
import pytest
from test_axisymmetric import EXACT, POISSON, YOUNG, discs, rings

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    AdaptiveStatus,
    ContactForce,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    MeanPressure,
    NormalForce,
    RigidPlane,
    RigidSphere,
    read_gmsh,
    solve_adaptively,
)
from scenes.elasticity import fixed
from scenes.hertz_theory import HertzSphere
from scenes.revolution import FIRST, ring_elasticity
from scenes.scene import EPS, Scene

#: Where the mean of the pressure is taken.
PATCH = MeanPressure((0.0, 0.0), 0.5)

#: E* of a half-space under a rigid body [MPa].
MODULUS = YOUNG / (1 - POISSON**2)


def half_space(comm, obstacle, *, radius, h, growth, degree=2, size=20.0):
    """Return a half-space whose top may touch an obstacle up to a radius. Collective."""
    body = read_gmsh(
        MESHES / "half_space.geo", comm, Size=size * radius, Top=radius, h=h, Growth=growth
    )
    V = fem.functionspace(body.mesh, ("Lagrange", degree, (2,)))
    facets, tags = body.facet_tags, body.tags
    bcs = [fixed(V, facets.find(tags["axis"]), 0.0, 0)]
    bcs += [fixed(V, facets.find(tags["bottom"]), 0.0, 1)]
    pair = ContactPair(facets, tags["contact"], obstacle, Frictionless())
    return Scene(V, ring_elasticity(V, YOUNG, POISSON), None, bcs, [pair], facets, tags=tags)


def test_a_flat_punch():
    """F = 2 a E* d (Johnson 1985, Contact mechanics, 3.8); the edge and the size take 2 % each."""
    depth, radius = 1e-3, 1.0
    punch = RigidPlane((0.0, -depth), (0.0, -1.0))
    scene = half_space(MPI.COMM_SELF, punch, radius=radius, h=0.1, growth=0.1)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve()
    assert solution.counts.contact == solution.counts.nodes
    assert solution.normal_force == pytest.approx(2 * radius * MODULUS * depth, rel=0.04)


def test_a_sphere_on_the_axis():
    """F = 4/3 E* R^(1/2) d^(3/2) (Hertz), with some ten pressed nodes."""
    depth, radius = 1e-3, 10.0
    ball = RigidSphere((0.0, radius - depth), radius)
    edge = math.sqrt(radius * depth)
    scene = half_space(MPI.COMM_SELF, ball, radius=2 * edge, h=edge / 12, growth=0.1)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve()
    wanted = 4 / 3 * MODULUS * math.sqrt(radius * depth**3)
    assert solution.normal_force == pytest.approx(wanted, rel=0.02)


@pytest.mark.parallel
def test_mortar_elements_on_matching_meshes_are_node_pairs(comm):
    """Dual mortar elements on equal traces have the jumps of node pairs: 0 if u is continuous."""
    scene = discs(comm, lower=3, pairing="nodes")
    with scene.problem(axisymmetric=True) as problem:
        (operators,) = problem.operators
        u = fem.Function(scene.V)
        u.interpolate(lambda x: np.stack([x[0] * x[1], x[0] ** 2 * np.cos(5 * x[1])]))
        jump = operators.N.createVecLeft()
        operators.N.mult(u.x.petsc_vec, jump)
        assert comm.allreduce(jump.getSize()) > 0
        assert np.abs(jump.array).max(initial=0.0) <= 1e3 * EPS * 30
        jump.destroy()


def test_pushing_on_dissipates_force_times_way():
    """Load steps under Coulomb's law: after the first one the shaft slides, and nothing strains."""
    ends = [
        (0, lambda x: np.isin(x[:, 1], (0.0, 1.0)) & (x[:, 0] > 12.0), 1, 0.0),
        (1, lambda x: np.isin(x[:, 1], (0.0, 1.0)) & (x[:, 0] < 8.0), 1, 0.0),
    ]
    scene = rings(MPI.COMM_SELF, 4, Coulomb(0.2), ends)
    push = fem.Constant(scene.mesh, 0.0)
    scene.bcs[1] = fixed(scene.V, scene.facet_tags.find(FIRST + 1), push, 1)
    with scene.problem(axisymmetric=True) as problem:
        works = []
        for way in (0.02, 0.03, 0.05):
            push.value = way
            solution = problem.solve(rtol=1e-9)
            solution.raise_if_failed()
            problem.accept()
            works.append(solution.dissipation)
    force = 0.2 * solution.normal_force
    assert abs(solution.pair_resultants[0].force[1]) == pytest.approx(force, rel=1e-6)
    assert works[1:] == pytest.approx([force * 0.01, force * 0.02], rel=1e-5)
    assert solution.total_dissipation == pytest.approx(sum(works), rel=1e-9)


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_pairing_anew_keeps_a_uniform_pressure(comm, sliding):
    """The displacement is that of the first pairing; the force that of rings, in equilibrium."""
    scene = discs(comm).but(sliding=sliding)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve(rtol=1e-10)
        if sliding == "small":
            problem.update_geometry(solution.u)
            solution = problem.solve(rtol=1e-10)
    solution.raise_if_failed()
    force = 0.01 * YOUNG * 9.0 * math.pi
    assert abs(solution.pair_resultants[0].force[1]) == pytest.approx(force, rel=EXACT)
    assert solution.normal_force == pytest.approx(force, rel=EXACT)


@pytest.mark.parallel
def test_a_body_that_floats_along_the_axis(comm):
    """The load on the upper disc goes into the lower one, to rounding."""
    scene = discs(comm)
    top = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)(FIRST)
    r = ufl.SpatialCoordinate(scene.mesh)[0]
    load = ufl.inner(ufl.as_vector([0.0, -7.0 * r]), ufl.TestFunction(scene.V)) * 2 * np.pi * r
    floating = dataclasses.replace(scene, L=load * top, bcs=scene.bcs[1:])
    with floating.problem(axisymmetric=True) as problem:
        solution = problem.solve()
    wanted = 7.0 * 2 * math.pi * 3.0**3 / 3  # the integral of r over the disc
    assert solution.normal_force == pytest.approx(wanted, rel=1e-6)
    assert abs(solution.body_resultants[0].force[1]) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parallel
def test_files_have_the_pressure_of_the_point(comm, folder):
    """The file of the meridian has stresses, not stresses times the ring."""
    pyvista = pytest.importorskip("pyvista")
    with discs(comm).problem(axisymmetric=True) as problem:
        solution = problem.solve(rtol=1e-10)
        solution.write(folder / "discs.pvd")
    contact = pyvista.read(next(folder.glob("**/contact*.vtu")))
    state = contact.point_data["pressure"][contact.point_data["state"] >= 0]
    assert np.allclose(state, 0.01 * YOUNG, rtol=1e-5) and len(state) > 0


def ball(tagged):
    """Return a ball on a rigid plane, for adaptive meshes."""
    V = fem.functionspace(tagged.mesh, ("Lagrange", 2, (2,)))
    bcs = [
        fixed(V, tagged.facet_tags.find(tagged.tags["symmetry"]), 0.0, 0),
        fixed(V, tagged.facet_tags.find(tagged.tags["cut"]), -0.1, 1),
    ]
    plane = RigidPlane((0.0, 0.0), (0.0, 1.0))
    pair = ContactPair(tagged.facet_tags, tagged.tags["contact"], plane, Frictionless())
    return ContactProblem(ring_elasticity(V, YOUNG, POISSON), None, [pair], bcs, axisymmetric=True)


@pytest.fixture(scope="module")
def force_of_a_ball():
    """Return the force on a fine mesh."""
    fine = read_gmsh(MESHES / "half_disc.geo", MPI.COMM_SELF, R=10, h=0.05, Zone=2, Arc=3)
    with ball(fine) as problem:
        return problem.solve().normal_force


@pytest.mark.parametrize(
    ("goal", "accuracy"),
    [(None, 0.02), (NormalForce(), 2e-3), (ContactForce((0, 1)), 2e-3), (PATCH, 2e-3)],
)
def test_adaptive_meshes(force_of_a_ball, goal, accuracy):
    """Refined for the energy or for a number, which is that of the ring."""
    coarse = read_gmsh(MESHES / "half_disc.geo", MPI.COMM_SELF, R=10, h=0.5, Zone=2, Arc=3)
    found = solve_adaptively(ball, coarse, accuracy, goal=goal)
    assert found.status is AdaptiveStatus.REACHED
    assert len(found.levels) > 1
    if goal is PATCH:  # Hertz's pressure, with the weights of the goal and of rings
        theory = HertzSphere(force_of_a_ball, 10.0, MODULUS)
        r = (np.arange(1000) + 0.5) / 1000 * PATCH.radius
        weight = (1 - (r / PATCH.radius) ** 2) ** 2 * r
        pressure = theory.peak * np.sqrt(1 - (r / theory.contact_radius) ** 2)
        wanted = np.average(pressure, weights=weight)
        assert found.goal_error.value == pytest.approx(wanted, rel=3 * accuracy)
    else:
        force = found.solution.normal_force
        assert force == pytest.approx(force_of_a_ball, rel=accuracy)
