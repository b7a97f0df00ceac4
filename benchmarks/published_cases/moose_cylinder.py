"""An elastic cylinder on a rigid plane, without friction and glued: tests of MOOSE.

    tools/fenicsx python3 benchmarks/published_cases/moose_cylinder.py 0.003

The folder `modules/contact/test/tests/verification/hertz_cyl` of MOOSE (Idaho National Laboratory)
keeps the results of half a cylinder of radius 3, whose cut is moved by 0.002 towards the plane. The
values are those of its files `half_symm_q8/gold/hertz_cyl_half_1deg_*.csv`, with quadrilaterals of
degree 2, eight along the half width of the contact, and `half_symm_q4`, of degree 1:
`frictionless_kin_check2`, `frictionless_kin_check_cont_press_0035`, and `glued_pen_check2`, where
nodes that touch are glued to the plane in each of ten load steps. Here they stick by Coulomb's law
with a coefficient that no traction exceeds. The pressure in the middle is the peak of half an
ellipse that is fitted to MOOSE's values at vertices or at midpoints of cells. The argument is the
cell size at the contact.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group, peak_of

from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    RigidPlane,
    read_gmsh,
)
from scenes.elasticity import elasticity, fixed, no_load
from scenes.nodal import gathered, surface_nodes_of

RADIUS, YOUNG, POISSON, DEPTH, STEPS = 3.0, 1e6, 0.3, 0.002, 10

#: A coefficient of friction so large that all nodes in contact stick.
LARGE = 10.0

#: Distance from the middle -> pressure of MOOSE, at the vertices of its cells of degree 2.
MOOSE_PRESSURE = {
    0.0: 9198.1235,
    0.01173162: 8948.4205,
    0.0211168: 8364.9768,
    0.0286248: 7594.5774,
    0.03463107: 6683.0236,
    0.03943599: 5606.8582,
    0.04327985: 4280.0483,
    0.04635489: 2558.1891,
    0.04881488: 809.0662,
}

FORCE, PEAK, GLUED = "normal force", "pressure in the middle", "normal force, glued"


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h at the contact. Collective."""
    disc = read_gmsh(
        MESHES / "half_disc.geo", comm, R=RADIUS, h=h, Zone=0.08, Arc=0.3, Growth=40 * h
    )
    facets, tags = disc.facet_tags, disc.tags
    V = fem.functionspace(disc.mesh, ("Lagrange", 2, (2,)))
    depth = fem.Constant(disc.mesh, 0.0)
    held = fem.locate_dofs_topological(V.sub(1), 1, facets.find(tags["cut"]))
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    bcs = [
        fixed(V, facets.find(tags["cut"]), 0.0, 0),
        fem.dirichletbc(depth, held, V.sub(1)),
        fixed(V, facets.find(tags["symmetry"]), 0.0, 0),
    ]
    forces = []
    for friction, steps in ((Frictionless(), 1), (Coulomb(LARGE), STEPS)):
        pair = ContactPair(facets, tags["contact"], plane, friction, geometry=disc.geometry)
        with ContactProblem(elasticity(V, YOUNG, POISSON), no_load(V), [pair], bcs) as problem:
            for step in range(steps):
                depth.value = -DEPTH * (step + 1) / steps
                solution = problem.solve(rtol=RTOL)
                solution.raise_if_failed()
                problem.accept()
        forces.append(2.0 * solution.normal_force)
        if steps == 1:
            points, fields = surface_nodes_of(solution)
            x, p = gathered(comm, points[:, 0], fields["pressure"])
            order = np.argsort(x)
            x, p = x[order], p[order]
    values = {FORCE: forces[0], PEAK: peak_of(x / HALF_WIDTH, p), GLUED: forces[1]}
    near = x < 0.06
    return Result(values, V, x[near], p[near])


#: Half width of the contact by Hertz's theory, for MOOSE's force.
HALF_WIDTH = float(np.sqrt(4 * 716.811 * RADIUS * (1 - POISSON**2) / (np.pi * YOUNG)))
CASE = Case(
    name="moose_cylinder",
    title="Cylinder on a plane, of MOOSE",
    published={
        FORCE: by_group({"MOOSE, degree 2": 716.811, "degree 1": 721.468}),
        PEAK: by_group({"MOOSE, vertices": 9197.8, "midpoints": 9134.8}),
        GLUED: by_group({"MOOSE, degree 2": 723.524}),
    },
    source="programs",
    argument="cells at the contact",
    sizes=(0.006, 0.003, 0.0015),
    solve=solve,
    order=1.5,
    axes=("distance from the middle", "pressure"),
    marks=(list(MOOSE_PRESSURE), list(MOOSE_PRESSURE.values())),
)

if __name__ == "__main__":
    CASE.main()
