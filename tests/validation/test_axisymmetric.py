"""Bodies of revolution against theory, and what they have in common with other bodies."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq

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
    InputError,
    MeanPressure,
    NonlinearContactProblem,
    RigidPlane,
    Units,
    read_gmsh,
    solve_adaptively,
)
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity, fixed
from scenes.hertz import sphere_on_plane
from scenes.hertz_theory import HertzSphere, plane_strain_modulus
from scenes.nodal import nodal, surface_nodes_of
from scenes.revolution import (
    APPROACH,
    FIRST,
    ball_on_plane,
    contact_radius,
    ring_elasticity,
    two_rings,
)
from scenes.scene import EPS

YOUNG, POISSON = 1000.0, 0.3  # MPa

#: Tolerance of the requested residual, 1e-10, after the factors of a few cells.
EXACT = 1e-7


def discs(comm, *, upper=3, lower=4, **options):
    """Return two discs of radius 3 and height 1, one on the other, compressed by 1 %."""
    bodies = (Body((upper, 2), [(0, 3), (1, 2)]), Body((lower, 3), [(0, 3), (0, 1)]))
    held = [(0, near(1, 2.0), 1, -0.02), (1, near(1, 0.0), 1, 0.0)]
    held += [(body, near(0, 0.0), 0, 0.0) for body in (0, 1)]
    return two_rings(comm, bodies, (near(1, 1.0), near(1, 1.0)), held, Frictionless(), **options)


@pytest.mark.parallel(swap=[False])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cells", [{}, {"lower": 3}])
def test_a_uniform_pressure_is_exact(comm, kind, degree, cells, swap):
    """Both pairings pass a uniform pressure, also at the axis, and areas are those of discs."""
    scene = discs(comm, kind=kind, degree=degree, swap=swap, **cells)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve(rtol=1e-10)
        solution.raise_if_failed()
        _, fields = surface_nodes_of(solution)
        assert np.abs(fields["pressure"] - 0.01 * YOUNG).max(initial=0.0) <= EXACT * YOUNG
        area = comm.allreduce(fields["weights"].sum())
        assert area == pytest.approx(9.0 * math.pi, rel=100 * EPS)
        force = solution.pair_resultants[0].force[1] * (-1.0 if swap else 1.0)
        assert force == pytest.approx(0.01 * YOUNG * 9.0 * math.pi, rel=EXACT)
        x, u = scene.V.tabulate_dof_coordinates(), nodal(solution.u)
        assert np.abs(u[:, 0] - 0.01 * POISSON * x[: len(u), 0]).max() <= EXACT
        (operators,) = problem.operators
        covered = operators.area_fraction()
        on_sides = operators.areas().x.array > 0.0
        assert covered.x.array[on_sides] == pytest.approx(1.0, rel=1e4 * EPS)


BORE, RADIUS, RIM, INTERFERENCE = 5.0, 10.0, 20.0, 1e-3


def rings(comm, n, friction, held=(), **options):
    """Return a ring of n cells shrunk on a hollow shaft; both keep their length."""
    bodies = (
        Body((n, 2), [(RADIUS, RIM), (0, 1)]),
        Body((n + 1, 3), [(BORE, RADIUS + INTERFERENCE), (0, 1)]),
    )
    sides = (near(0, RADIUS), near(0, RADIUS + INTERFERENCE))
    return two_rings(comm, bodies, sides, held, friction, **options)


def long_rings(comm, n, **options):
    """Return the same in plane strain."""
    held = [(body, near(1, end), 1, 0.0) for body in (0, 1) for end in (0.0, 1.0)]
    return rings(comm, n, Frictionless(), held, **options)


def lame_pressure():
    """Return the pressure [MPa] in plane strain (Timoshenko and Goodier, section 28)."""
    nu = POISSON / (1 - POISSON)
    ring = (RIM**2 + RADIUS**2) / (RIM**2 - RADIUS**2) + nu
    shaft = (RADIUS**2 + BORE**2) / (RADIUS**2 - BORE**2) - nu
    return INTERFERENCE / RADIUS / (ring + shaft) * YOUNG / (1 - POISSON**2)


def test_shrunk_rings_converge_to_lame():
    """The pressure converges with h^2 to Lamé's, which is linear in the interference."""
    errors = []
    for n in (4, 8, 16):
        with long_rings(MPI.COMM_SELF, n).problem(axisymmetric=True) as problem:
            solution = problem.solve(rtol=1e-9)
        mean = solution.normal_force / (2 * math.pi * RADIUS)
        errors.append(abs(mean / lame_pressure() - 1.0))
    assert errors[0] / errors[1] > 3.5 and errors[1] / errors[2] > 3.5
    assert errors[2] <= 0.003


@pytest.mark.parallel
@pytest.mark.parametrize("swap", [False, True])
def test_a_shaft_that_is_pushed_out(comm, swap):
    """All nodes slip: the axial force is F times the radial one, and its work is dissipated."""
    ends = [
        (body, lambda x, r=r: np.isin(x[:, 1], (0.0, 1.0)) & (np.abs(x[:, 0] - r) < 4.0), 1, 0.0)
        for body, r in ((0, 16.0), (1, 4.0))
    ]
    scene = rings(comm, 8, Coulomb(0.2), ends, swap=swap)
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
            radial, axial = np.abs(solution.pair_resultants[0].force)
            force = 0.2 * solution.normal_force
            assert solution.counts.contact == solution.counts.nodes
            assert solution.counts.contact_stick == 0
            assert radial == pytest.approx(solution.normal_force, rel=1e-6)
            assert axial == pytest.approx(force, rel=1e-6)
    # the ends are not held near the contact, so the bodies are softer than in plane strain
    plane_strain = 2 * math.pi * RADIUS * lame_pressure()
    assert 0.8 * plane_strain < solution.normal_force < plane_strain
    assert works[1:] == pytest.approx([force * 0.01, force * 0.02], rel=1e-5)
    assert solution.total_dissipation == pytest.approx(sum(works), rel=1e-9)


@pytest.mark.parallel(degree=[1])
@pytest.mark.parametrize("degree", [1, 2])
def test_hertz(comm, degree):
    """Radius, peak and approach are those of Hertz to 1 %, with 16 pressed nodes."""
    scene = ball_on_plane(comm, 0.08, degree)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve()
    theory = scene.data.theory(solution.normal_force)
    assert contact_radius(comm, solution) == pytest.approx(theory.contact_radius, rel=0.005)
    assert solution.peak_pressure == pytest.approx(theory.peak, rel=0.012)
    assert theory.approach == pytest.approx(APPROACH, rel=0.005)


def test_the_script_of_the_guide(capsys):
    """The script of the page runs when it is copied, and has the figures that the page says."""
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "axisymmetry.md").read_text()
    script = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0]
    found: dict[str, Any] = {}
    exec(script, found)
    solution = found["solution"]
    assert f"{solution.normal_force:.2f} N and {solution.peak_pressure:.3f} MPa" in page
    assert f"with {solution.counts.contact} pressed nodes" in page
    theory = HertzSphere(solution.normal_force, 10.0, plane_strain_modulus(10.0, POISSON))
    assert f"theory gives {theory.peak:.3f} MPa" in page
    found["problem"].destroy()


def test_force_and_energy_have_the_units_of_three_dimensions():
    scene = ball_on_plane(MPI.COMM_SELF, 0.3)
    with scene.problem(axisymmetric=True, units=Units("mm", "MPa", force="N")) as problem:
        solution = problem.solve()
    assert "N normal" in str(solution) and "N/mm" not in str(solution)


@pytest.mark.parallel
def test_rubber(comm):
    """A cylinder between frictionless planes keeps its shape: the stress is that of one axis."""
    stretch, mu, lam = 0.7, 1.0, 3.0

    def radial_stress(wide):
        return mu * (wide - 1 / wide) + lam * math.log(wide**2 * stretch) / wide

    wide = brentq(radial_stress, 0.5, 2.0)
    stress = mu * (stretch - 1 / stretch) + lam * math.log(wide**2 * stretch) / stretch
    made = boxes(comm, "quadrilateral", [Body((4, 3), [(0, 2), (0, 1)])])
    tags = made.tags((1, [0], near(1, 0.0)), (2, [0], near(1, 1.0)), (3, [0], near(0, 0.0)))
    u, v = fem.Function(made.V), ufl.TestFunction(made.V)
    r = ufl.SpatialCoordinate(made.mesh)[0]
    plane = ufl.Identity(2) + ufl.grad(u)
    hoop = 1 + u[0] / r
    J = ufl.det(plane) * hoop
    squares = ufl.inner(plane, plane) + hoop**2
    energy = 0.5 * mu * (squares - 3 - 2 * ufl.ln(J)) + 0.5 * lam * ufl.ln(J) ** 2
    F = ufl.derivative(energy * 2 * np.pi * r * ufl.dx, u, v)
    pair = ContactPair(tags, 1, RigidPlane((0.0, 0.0), (0.0, 1.0)), Frictionless())
    bcs = [fixed(made.V, tags.find(2), stretch - 1, 1), fixed(made.V, tags.find(3), 0.0, 0)]
    with NonlinearContactProblem(F, u, [pair], bcs, axisymmetric=True) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
    assert solution.normal_force == pytest.approx(-stress * 4.0 * math.pi, rel=1e-6)
    assert solution.newton.steps[-1].residual <= 1e-6


def test_wrong_arguments():
    scene = discs(MPI.COMM_SELF)
    with pytest.raises(InputError, match="does not resist a radial translation"):
        scene.problem(a=elasticity(scene.V, YOUNG), axisymmetric=True)
    moved = discs(MPI.COMM_SELF).moved(lambda x: x - [1.0, 0.0, 0.0])
    with pytest.raises(InputError, match="x\\[0\\] down to -1"):
        moved.problem(axisymmetric=True)
    with pytest.raises(InputError, match="found a mesh in 3D"):
        sphere_on_plane(MPI.COMM_SELF, 1.0).problem(axisymmetric=True)


#: Where the mean of the pressure is taken.
PATCH = MeanPressure((0.0, 0.0), 0.5)

#: E* of a half-space under a rigid body [MPa].
MODULUS = YOUNG / (1 - POISSON**2)


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
@pytest.mark.parametrize("swap", [False, True])
def test_a_thin_ring_remains_locked_on_a_taper(comm, swap):
    """Hoop stresses, which hold the ring softly, press it on when the load is removed or reversed.

    It takes cos(a) (F - tan(a)) of the normal force, an eighth, to bring the ring off.
    """
    slope, friction = math.radians(15.0), 0.4
    bodies = Body((2, 4), [(40, 41), (0, 4)]), Body((2, 5), [(39, 40), (0, 4)])
    held = [(0, near(1, 4.0), 1, 0.0), (1, near(1, 0.0), 1, 0.0)]
    scene = two_rings(comm, bodies, (near(0, 40.0),) * 2, held, Coulomb(friction), swap=swap)
    x, push = scene.mesh.geometry.x, fem.Constant(scene.mesh, 0.0)
    x[:, 0] -= x[:, 1] * math.tan(slope)
    top = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)(FIRST)
    load = -push * ufl.TestFunction(scene.V)[1] * top
    ring = dataclasses.replace(scene, L=load, bcs=scene.bcs[1:])
    with ring.problem(axisymmetric=True) as problem:
        for factors in ((1.0, 0.1, 0.0, -0.02), (1.0, 0.0, 1.0), (1.0, -0.02, 0.0)):
            problem.forget()
            for factor in factors:
                push.value = 0.05 * factor
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                axial = solution.pair_resultants[0].force[1] * (-1.0 if swap else 1.0)
                assert axial == pytest.approx(push.value, abs=1e-6)
                slips = 0.05 / (math.sin(slope) + friction * math.cos(slope))
                assert solution.normal_force > (0.999 if factor == 1.0 else 0.8) * slips


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
    ("goal", "accuracy"), [(None, 0.02), (ContactForce((0, 1)), 2e-3), (PATCH, 2e-3)]
)
def test_adaptive_meshes(force_of_a_ball, goal, accuracy):
    """Meshes that are refined for the energy or for a number have the number of a fine mesh."""
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
