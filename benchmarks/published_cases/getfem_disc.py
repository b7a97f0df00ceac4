"""A disc that lies on a rigid plane under its weight, with Coulomb's law: a test of GetFEM.

    tools/fenicsx python3 benchmarks/published_cases/getfem_disc.py 1

The program `demo_static_contact.py` of GetFEM (folder `interface/tests/python` of its sources) with
its meshes of a disc: radius 20, plane strain, both of Lame's constants 1, a force of 0.05 per area,
F = 0.4, and the program's version 13 of the method. GetFEM stores no values: the values below were
computed with its release 5.4.2, with cells of degree 2 and its mesh `disc_P2_h0_5.mesh`, whose
cells have the size 0.5. From the next coarser mesh to this mesh the displacements of the nodes and
the pressure at the lowest point change by at most 4e-5 of themselves. Strains are linear, although
the disc is flattened by more than a third of its height. In the vertical direction only contact
holds the disc. The argument is the cell size.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, RigidPlane, read_gmsh
from scenes.elasticity import elasticity, fixed
from scenes.nodal import gathered, nodal, surface_nodes_of

RADIUS, WEIGHT, COEFFICIENT = 20.0, 0.05, 0.4
YOUNG, POISSON = 2.5, 0.25  # both of Lame's constants are 1

#: Quantity -> node, component of its displacement, sign of this component, and GetFEM's value.
NODES = {
    "displacement of the top, down": ((0.0, 2.0 * RADIUS), 1, -1.0, 15.1621),
    "displacement of the middle, down": ((0.0, RADIUS), 1, -1.0, 11.1822),
    "displacement of the side, down": ((RADIUS, RADIUS), 1, -1.0, 11.6778),
    "displacement of the side, across": ((RADIUS, RADIUS), 0, 1.0, 2.5691),
}

#: GetFEM's pressures at nodes, by their distance from the middle. At nodes that slip GetFEM's
#: multipliers are not the tractions: the tangential multiplier exceeds F times the normal one.
PRESSURES = {
    0.0: 2.1207,
    3.3934: 2.0714,
    6.8258: 1.9156,
    8.5868: 1.7888,
    9.9875: 1.6602,
    11.3869: 1.5034,
}
PRESSURE = "pressure at the lowest point"

#: GetFEM's slip of a node, and the distance of the node from the middle.
SLIP, SLIPPING, GETFEM_SLIP = "slip at 15.2908", 15.2908, 0.42502


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h. Collective."""
    disc = read_gmsh(Path(__file__).with_name("getfem_disc.geo"), comm, R=RADIUS, h=h)
    facets, tags = disc.facet_tags, disc.tags
    V = fem.functionspace(disc.mesh, ("Lagrange", 2, (2,)))
    L = -fem.Constant(disc.mesh, WEIGHT) * ufl.TestFunction(V)[1] * ufl.dx
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    pair = ContactPair(facets, tags["contact"], plane, Coulomb(COEFFICIENT), geometry=disc.geometry)
    bcs = [fixed(V, facets.find(tags["symmetry"]), 0.0, 0)]
    with ContactProblem(elasticity(V, YOUNG, POISSON), L, [pair], bcs) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        points, fields = surface_nodes_of(solution)
        x, p, slip = gathered(comm, points[:, 0], fields["pressure"], fields["slip"][:, 0])
        u = nodal(solution.u)
        places, u = gathered(comm, V.tabulate_dof_coordinates()[: len(u), :2], u)
    order = np.argsort(x)
    x, p, slip = x[order], p[order], slip[order]
    values = {}
    for quantity, (place, component, sign, _) in NODES.items():
        node = np.argmin(np.linalg.norm(places - place, axis=1))
        values[quantity] = float(sign * u[node, component])
    inside = x < 0.25 * RADIUS
    values[PRESSURE] = float(np.polyfit(x[inside] ** 2, p[inside], 2)[-1])
    values[SLIP] = float(np.interp(SLIPPING, x, slip))
    return Result(values, V, x, p)


CASE = Case(
    name="getfem_disc",
    title="Disc under its weight, of GetFEM",
    published={
        **{quantity: by_group({"GetFEM": known}) for quantity, (*_, known) in NODES.items()},
        PRESSURE: by_group({"GetFEM": PRESSURES[0.0]}),
        SLIP: by_group({"GetFEM": GETFEM_SLIP}),
    },
    source="programs",
    argument="cells",
    sizes=(1.0, 0.5, 0.25),
    solve=solve,
    axes=("distance from the middle", "pressure"),
    marks=(list(PRESSURES), list(PRESSURES.values())),
)

if __name__ == "__main__":
    CASE.main()
