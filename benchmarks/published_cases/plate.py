"""A plate pressed on a rigid plane from above and from the side, with friction: Code_Aster SSNV128.

    tools/fenicsx python3 benchmarks/published_cases/plate.py 64

A benchmark of the French working group GRECO (J. Méc. Théor. Appl. 7, suppl. 1, 1988). The
published displacements come from the Code_Aster manual V6.04.128. They are means of several
programs, to three digits, whose uncertainty the manual calls important; and values of Code_Aster's
test ssnv128a, with penalties in contact and friction and 32 cells along a side. The nodal force is
Code_Aster's, too; here it is the integral of the pressure times the hat function of that node in
Code_Aster's mesh. The argument is the number of cells along a side of the plate.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group, exactly

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, RigidPlane
from scenes.elasticity import elasticity, fixed
from scenes.nodal import gathered, nodal, surface_nodes_of

SIDE = 40.0  # mm
YOUNG, POISSON, COEFFICIENT = 130_000.0, 0.2, 1.0  # MPa, -, -
ABOVE, BESIDE = 50.0, 150.0  # MPa

#: Distance from the loaded corner [mm] -> displacement towards the symmetry plane [µm]: the mean of
#: several programs; and Code_Aster's value, which its test compares with the mean, to 5 %.
DISPLACEMENTS = {
    0.0: (28.6, 28.649),
    1.25: (27.2, 27.269),
    5.0: (22.8, 22.924),
    7.5: (19.8, 19.929),
    11.25: (15.0, 15.608),
}

#: Half of the last digit of the means [µm].
ROUNDING = 0.05

#: Normal force [N per mm of thickness] of a node, and the node's distance from the symmetry plane
#: [mm], which is also the cell size.
FORCE, BESIDE_SYMMETRY = 104.864, 1.25

NODE = "force of the node at 38.75 mm [N/mm]"


def quantity(place: float) -> str:
    """Return the name of the displacement at a distance [mm] from the loaded corner."""
    return f"displacement at {place:g} mm [µm]"


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n x n cells. Collective."""
    plate = mesh.create_rectangle(
        comm, [[0.0, 0.0], [SIDE, SIDE]], [int(n), int(n)], mesh.CellType.quadrilateral
    )
    places = {1: (1, 0.0), 2: (0, SIDE), 3: (1, SIDE), 4: (0, 0.0)}  # bottom, symmetry, top, side
    found = {
        tag: mesh.locate_entities_boundary(plate, 1, lambda x, i=i, c=c: np.isclose(x[i], c))
        for tag, (i, c) in places.items()
    }
    facets = np.concatenate(list(found.values()))
    values = np.repeat(np.array(list(found), dtype=np.int32), [len(one) for one in found.values()])
    order = np.argsort(facets)
    tags = mesh.meshtags(plate, 1, facets[order], values[order])
    V = fem.functionspace(plate, ("Lagrange", 1, (2,)))
    ds, v = ufl.Measure("ds", plate, subdomain_data=tags), ufl.TestFunction(V)
    L = -fem.Constant(plate, ABOVE) * v[1] * ds(3) + fem.Constant(plate, BESIDE) * v[0] * ds(4)
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    pair = ContactPair(tags, 1, plane, Coulomb(COEFFICIENT))
    bcs = [fixed(V, tags.find(2), 0.0, 0)]
    with ContactProblem(elasticity(V, YOUNG, POISSON), L, [pair], bcs) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        owned = V.dofmap.index_map.size_local
        below = np.flatnonzero(np.isclose(V.tabulate_dof_coordinates()[:owned, 1], 0.0))
        x, u = V.tabulate_dof_coordinates()[below, 0], nodal(solution.u)[below, 0]
        points, fields = surface_nodes_of(solution)
        part = 1.0 - np.abs(SIDE - points[:, 0] - BESIDE_SYMMETRY) / BESIDE_SYMMETRY
        force = comm.allreduce(
            float(fields["pressure"] @ (fields["weights"] * np.maximum(part, 0.0)))
        )
    x, u = gathered(comm, x, u)
    order = np.argsort(x)
    x, u = x[order], 1000.0 * u[order]
    values = {quantity(place): float(np.interp(place, x, u)) for place in DISPLACEMENTS}
    return Result({**values, NODE: force}, V, x, u)


MEANS = [mean for mean, _ in DISPLACEMENTS.values()]
CASE = Case(
    name="plate",
    title="Plate on a rigid plane",
    published={
        **{
            quantity(place): by_group({"mean": mean, "Code_Aster": own}, ROUNDING)
            for place, (mean, own) in DISPLACEMENTS.items()
        },
        NODE: exactly(FORCE),
    },
    source="programs",
    argument="cells along a side",
    sizes=(32, 64, 128),
    solve=solve,
    axes=("distance from the loaded corner [mm]", "displacement [µm]"),
    marks=(list(DISPLACEMENTS), MEANS),
)

if __name__ == "__main__":
    CASE.main()
