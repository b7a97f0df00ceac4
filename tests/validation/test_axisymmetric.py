"""Bodies of revolution against theory: uniform pressure, Lamé's rings, Hertz's ball, rubber."""

from __future__ import annotations

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
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    InputError,
    NonlinearContactProblem,
    RigidPlane,
    Units,
)
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed, lame_constants
from scenes.hertz import sphere_on_plane
from scenes.hertz_theory import HertzSphere, plane_strain_modulus
from scenes.nodal import nodal, surface_nodes_of
from scenes.revolution import (
    APPROACH,
    FIRST,
    PRIMARY,
    SECONDARY,
    ball_on_plane,
    contact_radius,
    ring_elasticity,
    ring_energy,
    two_rings,
)
from scenes.scene import EPS

YOUNG, POISSON = 1000.0, 0.3  # MPa

#: Tolerance of the requested residual, 1e-10, after the factors of a few cells.
EXACT = 1e-7


def at(component, value):
    """Return whether middles of facets have a coordinate."""
    return lambda x: np.isclose(x[:, component], value)


def discs(comm, *, upper=3, lower=4, **options):
    """Return two discs of radius 3 and height 1, one on the other, compressed by 1 %."""
    bodies = (Body((upper, 2), [(0, 3), (1, 2)]), Body((lower, 3), [(0, 3), (0, 1)]))
    held = [(0, at(1, 2.0), 1, -0.02), (1, at(1, 0.0), 1, 0.0)]
    held += [(body, at(0, 0.0), 0, 0.0) for body in (0, 1)]
    return two_rings(comm, bodies, (at(1, 1.0), at(1, 1.0)), held, Frictionless(), **options)


@pytest.mark.parallel(swap=[False])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cells", [{}, {"lower": 3}])
def test_a_uniform_pressure_is_exact(comm, kind, degree, cells, swap):
    """Node-to-node and mortar pairing, also at the node on the axis; areas are those of discs."""
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
    sides = (at(0, RADIUS), at(0, RADIUS + INTERFERENCE))
    return two_rings(comm, bodies, sides, held, friction, **options)


def long_rings(comm, n, **options):
    """Return the same in plane strain."""
    held = [(body, at(1, end), 1, 0.0) for body in (0, 1) for end in (0.0, 1.0)]
    return rings(comm, n, Frictionless(), held, **options)


def lame_pressure():
    """Return the pressure [MPa] in plane strain (Timoshenko and Goodier, section 28)."""
    nu = POISSON / (1 - POISSON)
    ring = (RIM**2 + RADIUS**2) / (RIM**2 - RADIUS**2) + nu
    shaft = (RADIUS**2 + BORE**2) / (RADIUS**2 - BORE**2) - nu
    return INTERFERENCE / RADIUS / (ring + shaft) * YOUNG / (1 - POISSON**2)


def test_shrunk_rings_converge_to_lame():
    """With h^2; theory is linear in the interference, which is 1e-4 of the radius."""
    errors = []
    for n in (4, 8, 16):
        with long_rings(MPI.COMM_SELF, n).problem(axisymmetric=True) as problem:
            solution = problem.solve(rtol=1e-9)
        mean = solution.normal_force / (2 * math.pi * RADIUS)
        errors.append(abs(mean / lame_pressure() - 1.0))
    assert errors[0] / errors[1] > 3.5 and errors[1] / errors[2] > 3.5
    assert errors[2] <= 0.003


@pytest.mark.parametrize("poisson", [0.3, 0.4999])
def test_a_thick_walled_seal(poisson):
    """In a rigid bore, a fluid inside adds to the pressure of the assembly: all of it at nu = 0.5.

    Lamé's solution in plane strain, u = A r + B / r, for the pressure of the fluid at the inner
    radius and the interference at the outer one.
    """
    fluid, interference = 5.0, 1e-3
    bodies = (Body((16, 2), [(BORE, RADIUS), (0, 1)]),)
    made = boxes(MPI.COMM_SELF, "quadrilateral", bodies, 2)
    ends = [(FIRST + k, [0], at(1, end)) for k, end in enumerate((0.0, 1.0))]
    tags = made.tags((SECONDARY, [0], at(0, RADIUS)), (PRIMARY, [0], at(0, BORE)), *ends)
    bore = RigidPlane((RADIUS - interference, 0.0), (-1.0, 0.0))
    r = ufl.SpatialCoordinate(made.mesh)[0]
    inside = ufl.Measure("ds", made.mesh, subdomain_data=tags)(PRIMARY)
    problem = ContactProblem(
        ring_elasticity(made.V, YOUNG, poisson),
        fluid * ufl.TestFunction(made.V)[0] * 2 * np.pi * r * inside,
        [ContactPair(tags, SECONDARY, bore, Frictionless())],
        bcs=[fixed(made.V, tags.find(FIRST + k), 0.0, 1) for k in (0, 1)],
        axisymmetric=True,
    )
    with problem:
        solution = problem.solve(rtol=1e-9)
    mu, lame = lame_constants(YOUNG, poisson)
    stress = np.array([2 * (mu + lame), -2 * mu])  # of A and of B / r^2
    rows = [stress * [1, BORE**-2], [RADIUS, 1 / RADIUS]]
    A, B = np.linalg.solve(rows, [-fluid, -interference])
    wanted = -stress @ [A, B / RADIUS**2]
    assert solution.normal_force == pytest.approx(2 * math.pi * RADIUS * wanted, rel=1e-4)
    assert solution.peak_pressure == pytest.approx(wanted, rel=1e-4)
    if poisson == 0.4999:
        assert wanted > 0.999 * fluid


def test_the_estimate_of_the_mesh_error():
    """In the energy norm, beside the error itself: the hoop strain's part is of higher order."""
    scene = long_rings(MPI.COMM_SELF, 8)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve()
    p, nu = lame_pressure(), POISSON
    exact = {}  # u = A r + B / r, from the stresses at both radii
    for body, (inside, outside, pressures) in {
        "shaft": (BORE, RADIUS, (0.0, p)), "ring": (RADIUS, RIM, (p, 0.0))
    }.items():  # fmt: skip
        a, b = inside**2, outside**2
        mean = (pressures[0] * a - pressures[1] * b) / (b - a)
        exact[body] = (
            (1 + nu) * (1 - 2 * nu) / YOUNG * mean,
            (1 + nu) / YOUNG * a * b * (pressures[0] - pressures[1]) / (b - a),
        )
    domain = scene.V.mesh
    cells = fem.functionspace(domain, ("DG", 0))
    factors = []
    for k in (0, 1):
        factor = fem.Function(cells)
        factor.interpolate(
            lambda x, k=k: np.where(x[0] < RADIUS, exact["shaft"][k], exact["ring"][k])
        )
        factors.append(factor)
    r = ufl.SpatialCoordinate(domain)[0]
    error = solution.u - ufl.as_vector([factors[0] * r + factors[1] / r, 0.0])
    energy = ring_energy(error, error, domain, YOUNG, POISSON)
    found = math.sqrt(fem.assemble_scalar(fem.form(energy)))
    estimate = math.sqrt(float(np.square(solution.cell_errors.x.array).sum()))
    assert 0.7 <= estimate / found <= 1.5


@pytest.mark.parallel
@pytest.mark.parametrize("swap", [False, True])
def test_a_shaft_that_is_pushed_out(comm, swap):
    """Where all nodes slip the axial force is F times the radial one."""
    ends = [
        (0, lambda x: np.isin(x[:, 1], (0.0, 1.0)) & (x[:, 0] > 12.0), 1, 0.0),
        (1, lambda x: np.isin(x[:, 1], (0.0, 1.0)) & (x[:, 0] < 8.0), 1, 0.02),
    ]
    scene = rings(comm, 8, Coulomb(0.2), ends, swap=swap)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve(rtol=1e-8)
        solution.raise_if_failed()
    radial, axial = solution.pair_resultants[0].force
    counts = solution.counts
    assert counts.contact == counts.nodes and counts.contact_stick == 0
    assert abs(radial) == pytest.approx(solution.normal_force, rel=1e-6)
    assert abs(axial) == pytest.approx(0.2 * solution.normal_force, rel=1e-6)
    # the ends are not held near the contact, so the bodies are softer than in plane strain
    plane_strain = 2 * math.pi * RADIUS * lame_pressure()
    assert 0.8 * plane_strain < solution.normal_force < plane_strain


@pytest.mark.parallel(degree=[1])
@pytest.mark.parametrize("degree", [1, 2])
def test_hertz(comm, degree):
    """Radius, peak and approach to 1 % with 16 pressed nodes, of which theory has 0.3 %."""
    scene = ball_on_plane(comm, 0.08, degree)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve()
    theory = scene.data.theory(solution.normal_force)
    assert contact_radius(comm, solution) == pytest.approx(theory.contact_radius, rel=0.005)
    assert solution.peak_pressure == pytest.approx(theory.peak, rel=0.012)
    assert theory.approach == pytest.approx(APPROACH, rel=0.005)


def test_the_script_of_the_guide(capsys):
    """It runs when it is copied, and has the figures that the page says."""
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


def test_the_same_in_3d():
    """The force of a ball in 3D, within the error of that mesh."""
    with sphere_on_plane(MPI.COMM_SELF, 0.24).problem() as problem:
        force = 4.0 * problem.solve().normal_force
    with ball_on_plane(MPI.COMM_SELF, 0.08).problem(axisymmetric=True) as problem:
        assert problem.solve().normal_force == pytest.approx(force, rel=0.02)


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
    tags = made.tags((1, [0], at(1, 0.0)), (2, [0], at(1, 1.0)), (3, [0], at(0, 0.0)))
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
