"""The patch test: blocks that are pressed together have the same pressure everywhere.

    tools/fenicsx python3 benchmarks/published_cases/patch_test.py 4

R. L. Taylor and P. Papadopoulos, On a patch test for contact problems in two dimensions, 1991. The
test has all kinds of cells, degrees 1 and 2, meshes that match ("node to node"), and meshes that do
not match ("mortar"). The argument is the number of cells along the contact.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result, exactly

from scenes.nodal import gathered, surface_nodes_of
from scenes.patches import KINDS, patch

#: Relative residual at which solves end: the error of multipliers is about this times the condition
#: number of A.
RTOL = 1e-12

PAIRINGS = (("nodes", 1), ("mortar", 1), ("mortar", 2))


def solve(comm: MPI.Comm, n: float) -> Result:
    """Solve with n cells along the contact of the upper block. Collective."""
    values = {}
    curve = {}
    for pairing, degree in PAIRINGS:
        ratios = []
        for kind in KINDS:
            across = int(n) + (pairing == "mortar")
            shape = {"upper": (int(n), 1), "lower": (across, 2)}
            scene = patch(
                comm, kind, degree, pairing=pairing, distort=0.3 * (pairing == "mortar"), **shape
            )
            with scene.problem() as problem:
                solution = problem.solve(rtol=RTOL)
                solution.raise_if_failed()
            points, fields = surface_nodes_of(solution)
            x, pressure = gathered(comm, points[:, 0], fields["pressure"])
            ratios.append(pressure / scene.data.pressure)
            curve[kind] = x, ratios[-1]
        off = max(float(np.abs(one - 1.0).max()) for one in ratios)
        values[quantity(pairing, degree)] = 1.0 + off
    x, ratio = curve["quadrilateral"]  # the picture shows the last pairing
    order = np.argsort(x)
    return Result(values, scene.V, x[order], ratio[order])


def quantity(pairing: str, degree: int) -> str:
    """Return the name of the quantity: the pressure with the largest error."""
    how = {"nodes": "node to node", "mortar": "mortar"}[pairing]
    return f"worst nodal pressure over the exact one, {how}, degree {degree}"


CASE = Case(
    name="patch_test",
    title="Patch test",
    published={quantity(*one): exactly(1.0) for one in PAIRINGS},
    source="formula",
    argument="cells along the contact",
    sizes=(2, 4),
    solve=solve,
    axes=("place along the contact", "pressure over the exact one"),
    curve=(np.array([0.0, 1.0]), np.ones(2)),
)

if __name__ == "__main__":
    CASE.main()
