"""Bodies pressed together and drawn aside: Cattaneo and Mindlin, there, back, and in one step."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from scenes.assembled import linear_solution
from scenes.boxes import Body, boxes
from scenes.cattaneo import COEFFICIENT, FAR, POISSON, WIDTH, YOUNG, Cattaneo, cattaneo, cell_size
from scenes.cattaneo_cycle import APPROACH, Found, cycle_errors
from scenes.elasticity import elasticity, fixed

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: Shifts over the approach.
SHIFT, BACK = 0.3, -0.06

#: Errors over h/a, with the cells at the edge of the contact: of pressure and traction in the mean
#: square, over those of the pressure and of what it can bear; of radii; and of the shift.
PRESSURE, TRACTION, RADIUS, COMPLIANCE = 0.5, 0.5, 1.2, 0.2


def check(found: Found, theory: Cattaneo, sign: float, sheared: float, n: int) -> None:
    """Compare a solution with the theory of its forces."""
    cell = cell_size(found.dim, n, theory.radius) / theory.radius
    assert found.difference(found.pressure, theory.pressure(found.r)) <= PRESSURE * cell
    wanted = sign * theory.traction(found.r)
    assert found.difference(found.traction, wanted) <= TRACTION * COEFFICIENT * cell
    assert found.radius(found.touching) == pytest.approx(theory.radius, rel=RADIUS * cell)
    sticking = theory.stick_radius(sheared)
    assert found.radius(found.sticking) == pytest.approx(sticking, rel=RADIUS * cell)


@pytest.mark.parametrize(("dim", "n"), [(2, 24), (2, 48), (3, 12)])
def test_there_and_back(dim, n):
    """Pressure and traction are those of theory in load steps there and back, and in one step."""
    scene = cattaneo(MPI.COMM_SELF, dim, n, approach=APPROACH[dim])
    with scene.problem(stiffness="cholesky") as problem:
        pressed = Found.of(problem.solve(rtol=1e-6), dim)
        problem.accept()
        assert np.abs(pressed.traction).max() <= 0.02 * COEFFICIENT * pressed.pressure.max()
        scene.data.end.value[0] = SHIFT * APPROACH[dim]
        drawn = Found.of(problem.solve(rtol=1e-6), dim)
        problem.accept()
        scene.data.end.value[0] = BACK * APPROACH[dim]
        back = Found.of(problem.solve(rtol=1e-6), dim)
    normal, tangential = drawn.force(drawn.pressure), drawn.force(drawn.traction)
    sign = np.sign(tangential)
    theory = Cattaneo(dim, normal, abs(tangential))
    assert 0.3 < abs(tangential) / (COEFFICIENT * normal) < 0.9
    check(drawn, theory, sign, theory.tangential, n)
    if dim == 3:
        cell = cell_size(dim, n, theory.radius) / theory.radius
        assert theory.shift(finite=True) == pytest.approx(
            SHIFT * APPROACH[dim], rel=COMPLIANCE * cell
        )

    rest = sign * back.force(back.traction)
    reversed_ = Cattaneo(dim, back.force(back.pressure), rest, theory.tangential)
    check(back, reversed_, sign, 0.5 * (theory.tangential - rest), n)

    scene.data.end.value[0] = SHIFT * APPROACH[dim]
    with scene.problem(stiffness="cholesky") as problem:
        once = Found.of(problem.solve(rtol=1e-6), dim)
    # equal bodies do not slip while they are pressed: the path makes no difference
    assert once.difference(once.traction, drawn.traction) <= 1e-2 * COEFFICIENT


#: Rates at least: h where stresses end like a square root, more for integrals of them.
RATES = {"pressure": 0.7, "traction": 0.7, "contact": 1.5, "stick": 1.5, "dissipation": 1.5}

#: Loads over which errors are averaged, since they depend on where edges lie between nodes.
LOADS = (1.0, 1.2, 1.45, 1.75)

#: Bodies are mirrored, but slopes of a/R at the edge of the contact mix pressures into tractions;
#: in 3D slip is parallel only about.
MASING = {2: 1e-4, 3: 5e-4}


def check_rates(dim: int, sizes: tuple[int, ...], rates: dict[str, float]) -> None:
    """Compare fitted rates with the least ones; and check Masing's rule, and that loops close."""
    found = [cycle_errors(MPI.COMM_SELF, dim, n, 1e-9, LOADS) for n in sizes]
    cells = np.log([errors["cell"] for errors in found])
    for name, least in rates.items():
        rate = np.polyfit(cells, np.log([errors[name] for errors in found]), 1)[0]
        assert rate >= least, name
    for errors in found:
        assert errors["masing"] <= MASING[dim]
        assert errors["open"] <= 0.1 * MASING[dim]


def test_rates():
    check_rates(2, (24, 96), RATES)


@pytest.mark.long
def test_rates_in_3d():
    """Errors fall with the mesh, and the shift converges to that of the finite bodies."""
    check_rates(3, (12, 16, 24), {**RATES, "shift": 1.5})


#: How much smaller cells are at the disc than at the ends, and its radius [mm].
GRADING, DISC_RADIUS = 3.0, 0.1

LOADED, HELD, FRONT = 1, 2, 3


def shift(n: int, end: float) -> float:
    """Return the mean shift of a disc by a unit force, with the weights of its traction [mm/N].

    Args:
        n: cells along the body of the scene.
        end: where the body ends before cells are graded; 1: the body of the scene.
    """
    cells = round(n * end)
    body = Body(
        (cells, cells // 2),
        [(-end, end), (0.0, end), (-end, 0.0)],
        move=lambda x: WIDTH * np.sinh(GRADING * x) / np.sinh(GRADING),
    )
    made = boxes(MPI.COMM_SELF, "hexahedron", [body], 2)
    V = made.V
    tags = made.tags(
        (LOADED, [0], lambda x: np.abs(x[:, 2]) < 1e-9),
        (HELD, [0], lambda x: np.abs(x[:, 2] + end) < 1e-9),
        (FRONT, [0], lambda x: np.abs(x[:, 1]) < 1e-9),
    )
    x = ufl.SpatialCoordinate(made.mesh)
    inside = 1.0 - (x[0] ** 2 + x[1] ** 2) / DISC_RADIUS**2
    traction = ufl.sqrt(ufl.conditional(ufl.gt(inside, 0.0), inside, 0.0))
    ds = ufl.Measure(
        "ds", domain=made.mesh, subdomain_data=tags, metadata={"quadrature_degree": 10}
    )(LOADED)
    L = traction * ufl.TestFunction(V)[0] * ds
    bcs = [fixed(V, tags.find(HELD)), fixed(V, tags.find(FRONT), 0.0, 1)]
    u = linear_solution(elasticity(V, YOUNG, POISSON[3]), L, bcs)
    work = fem.assemble_scalar(fem.form(ufl.action(L, u)))
    half = fem.assemble_scalar(fem.form(traction * ds))
    return float(work / half**2) / 2.0  # the half with y < 0 bears the other half of the force


@pytest.mark.long
def test_far_compliance():
    """What a body adds to the shift of a half-space is the constant that scenes use.

    Cells near the disc are the same, so that their errors cancel.
    """
    n, end = 8, 1.5
    size = np.sinh(GRADING * end) / np.sinh(GRADING)
    found = (shift(n, 1.0) - shift(n, end)) / (1.0 - 1.0 / size)
    assert found == pytest.approx(FAR, rel=0.05)
