"""A flat rigid punch that sticks to a half-plane.

    tools/fenicsx python3 benchmarks/published_cases/punch.py 0.008

K. L. Johnson, Contact Mechanics, section 2.8: the stresses below the punch oscillate at its edges,
and the pressure in the middle is 2 (1 - nu) / sqrt(3 - 4 nu) times the pressure without friction, P
/ (pi a). Nodes are bonded, since with a coefficient of friction of 5 slip at the edges changes the
pressure in the middle by 0.2 %. The argument is the cell size at the edge of the punch, divided by
the half width of the punch.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, exactly

from dolfinx import fem

from dolfinx_tresca import Bonded, ContactPair, ContactProblem, RigidPlane, read_gmsh
from scenes.elasticity import elasticity, fixed, no_load
from scenes.nodal import gathered, surface_nodes_of

YOUNG, POISSON = 1.0, 0.0
DEPTH = 1e-3  # motion of the far end towards the punch, divided by the half width


def under_punch(comm: MPI.Comm, h: float, friction: Any) -> ContactProblem:
    """Return a half-plane under the punch with a law of friction. Collective.

    Args:
        comm: communicator of the mesh.
        h: size of the cells at the edge of the punch, divided by the punch's half width.
        friction: the law.
    """
    half = read_gmsh(Path(__file__).with_name("punch.geo"), comm, h=h)
    facets, tags = half.facet_tags, half.tags
    V = fem.functionspace(half.mesh, ("Lagrange", 1, (2,)))
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, -1.0))
    pair = ContactPair(facets, tags["contact"], plane, friction)
    bcs = [fixed(V, facets.find(tags["bottom"]), (0.0, DEPTH))]
    bcs.append(fixed(V, facets.find(tags["symmetry"]), 0.0, 0))
    return ContactProblem(elasticity(V, YOUNG, POISSON), no_load(V), [pair], bcs)


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the edge of the punch. Collective."""
    with under_punch(comm, h, Bonded()) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        x, fields = surface_nodes_of(solution)
        x, p, weights = gathered(comm, x[:, 0], fields["pressure"], fields["weights"])
    order = np.argsort(x)
    frictionless = 2 * float(weights @ p) / math.pi  # P / (pi a)
    x, p = x[order], p[order] / frictionless
    # fit an even function of x, since single nodes differ from their neighbours
    inside = x < 0.3
    middle = float(np.polyfit(x[inside] ** 2, p[inside], 2)[-1])
    return Result({"pressure in the middle": middle}, solution.u.function_space, x, p)


def theory(x: np.ndarray) -> np.ndarray:
    """Return pressures divided by P / (pi a), at distances x from the middle, divided by a."""
    phase = math.log(3 - 4 * POISSON) / (2 * math.pi) * np.log((1 + x) / (1 - x))
    factor = 2 * (1 - POISSON) / math.sqrt(3 - 4 * POISSON)
    pressure: np.ndarray = factor * np.cos(phase) / np.sqrt(1 - x**2)
    return pressure


X = np.linspace(0.0, 0.98, 200)
CENTRE = float(theory(np.zeros(1))[0])
CASE = Case(
    name="punch",
    title="Flat punch that sticks",
    published={"pressure in the middle": exactly(CENTRE)},
    source="formula",
    argument="cells at the edge, over a",
    sizes=(0.008, 0.004, 0.002),
    solve=solve,
    order=1.0,
    axes=("distance from the middle over a", "pressure over P / (π a)"),
    curve=(X, theory(X)),
)

if __name__ == "__main__":
    CASE.main()
