"""A disc spring between two plates, which contact alone holds: flat, beyond, and back to rest."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactPair,
    Coulomb,
    Frictionless,
    NonlinearContactProblem,
    RigidPlane,
)
from scenes.rubber_block import neo_hookean

#: Radii of the hole and of the rim, thickness, and height of the cone [mm].
INNER, OUTER, THICKNESS, HEIGHT = 10.0, 20.0, 1.0, 0.4

#: Young's modulus [MPa] and Poisson's ratio of steel.
YOUNG, POISSON = 206e3, 0.3

#: Deflections at which the spring is loaded, flat, squeezed, flat, unloaded, and at rest [mm].
PATH = (0.2, HEIGHT, HEIGHT + 0.01, HEIGHT, 0.2, 0.0)


def almen_laszlo(deflection: float) -> float:
    """Return the force [N] of the theory of Almen and Laszlo (1936), for a ratio of radii of 2."""
    s, h = deflection / THICKNESS, HEIGHT / THICKNESS
    factor = 4.0 * YOUNG / (1.0 - POISSON**2) * THICKNESS**4 / (0.694 * (2.0 * OUTER) ** 2)
    return factor * s * ((h - s) * (h - s / 2.0) + 1.0)


def disc_spring(comm, friction, sliding, cells=(10, 2), unit=1.0, height=HEIGHT):
    """Return the problem of a spring on its rim under a plate, and this plate. Collective.

    Args:
        comm: communicator of the mesh.
        friction: law of friction on both plates.
        sliding: "small" or "finite".
        cells: numbers of cells along and across the section.
        unit: length of a millimetre in the units of the mesh.
        height: height of the cone [mm].
    """
    corners = [(0.0, 0.0), (1.0, 1.0)]
    domain = mesh.create_rectangle(comm, corners, cells, mesh.CellType.quadrilateral)
    along, across = domain.geometry.x[:, :2].T.copy()
    width = np.sqrt(np.hypot(OUTER - INNER, height + THICKNESS) ** 2 - THICKNESS**2)
    angle = np.arctan2(height + THICKNESS, OUTER - INNER) - np.arctan2(THICKNESS, width)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    section = np.column_stack([(along - 1.0) * width, across * THICKNESS])
    domain.geometry.x[:, :2] = unit * (section @ turn + [OUTER, 0.0])
    domain.topology.create_connectivity(1, 2)
    facets = np.sort(mesh.exterior_facet_indices(domain.topology))
    tags = mesh.meshtags(domain, 1, facets, np.ones(len(facets), np.int32))
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    u = fem.Function(V)
    radius = ufl.SpatialCoordinate(domain)[0]
    stretch = ufl.ln(1.0 + u[0] / radius)
    mu, lam = YOUNG / 2.0 / (1.0 + POISSON), YOUNG * POISSON / (1.0 + POISSON) / (1 - 2 * POISSON)
    log_J = ufl.ln(ufl.det(ufl.Identity(2) + ufl.grad(u)))
    energy = neo_hookean(u, mu, lam) + mu / 2.0 * (ufl.exp(2.0 * stretch) - 1.0 - 2.0 * stretch)
    energy += lam / 2.0 * (2.0 * log_J * stretch + stretch**2)
    F = ufl.derivative(energy * 2.0 * np.pi * radius * ufl.dx(degree=4), u, ufl.TestFunction(V))
    lower = RigidPlane((0.0, 0.0), (0.0, 1.0))
    upper = RigidPlane((0.0, unit * (height + THICKNESS)), (0.0, -1.0))
    pairs = [ContactPair(tags, 1, plate, friction, sliding=sliding) for plate in (lower, upper)]
    return NonlinearContactProblem(F, u, pairs, axisymmetric=True), upper


@pytest.mark.parallel(friction=[Coulomb(0.15)], unit=[1.0])
@pytest.mark.parametrize("friction", [Frictionless(), Coulomb(0.15)])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_flat_and_back_to_rest(comm, friction, unit):
    """Forces follow theory and balance, whole faces close at once, and nothing remains at rest."""
    problem, plate = disc_spring(comm, friction, "finite", unit=unit)
    forces, steps = [], []
    with problem:
        for deflection in PATH:
            plate.move_to((0.0, -unit * deflection))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            low, up = (one.force[1] / unit**2 for one in solution.pair_resultants)
            assert low == pytest.approx(-up, rel=1e-3, abs=1e-6)
            forces.append(low)
            steps.append(len(solution.newton.steps))
        assert np.abs(problem.u.x.array).max(initial=0.0) <= 1e-12 * unit * OUTER
    assert forces[0] == pytest.approx(almen_laszlo(PATH[0]), rel=0.1)  # of thin shells
    assert forces[-1] == pytest.approx(0.0, abs=1e-6)
    if isinstance(friction, Frictionless):
        assert forces[3:5] == pytest.approx(forces[1::-1], rel=1e-3)
    assert max(steps) <= 10


def test_a_face_that_closes_takes_few_steps(comm):
    """On planes without friction finite sliding has the forces of small sliding."""
    forces = []
    for sliding in ("small", "finite"):
        problem, plate = disc_spring(comm, Frictionless(), sliding, (24, 2))
        with problem:
            for deflection in (0.5 * HEIGHT, 0.975 * HEIGHT, HEIGHT):
                plate.move_to((0.0, -deflection))
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
        assert solution.counts.contact > 24
        assert len(solution.newton.steps) <= 12
        forces.append(solution.pair_resultants[0].force[1])
    assert forces[0] == pytest.approx(forces[1], rel=1e-3)


def test_springs_in_the_contact_leave_no_force_unbalanced(comm):
    """The tangent of a tall spring is indefinite: springs held it, and forces differed by 1 %."""
    height, added, forces = 1.8, set(), {}
    path = (0.5, 1.0, 1.4, 1.6, 1.7, 1.75, 1.79, 1.8, 1.81)
    problem, plate = disc_spring(comm, Frictionless(), "small", height=height)
    with problem:
        for deflection in (*path, *path[-2::-1]):
            plate.move_to((0.0, -deflection))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            added |= {step.added for step in solution.newton.steps}
            low, up = (resultant.force[1] for resultant in solution.pair_resultants)
            assert low == pytest.approx(-up, rel=2e-4)
            assert low == pytest.approx(forces.setdefault(deflection, low), rel=1e-3)
    assert "contact 10" in added
