"""An elastic ball on a rigid plane, as a body of revolution: Hertz.

    tools/fenicsx python3 benchmarks/published_cases/ball.py 0.04

K. L. Johnson, Contact Mechanics, section 4.2; the compliance far from the contact is an estimate of
Tatara 1991. The ball is pressed by 0.144 mm; Hertz's values are those for the computed force. The
argument is the cell size at the contact [mm].
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import Case, Result

from scenes.nodal import surface_nodes_of
from scenes.revolution import APPROACH, ball_on_plane, contact_radius


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the contact. Collective."""
    scene = ball_on_plane(comm, h)
    with scene.problem(axisymmetric=True) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
    theory = scene.data.theory(solution.normal_force)
    x, fields = surface_nodes_of(solution)
    x, p = (np.concatenate(comm.allgather(one)) for one in (x[:, 0], fields["pressure"]))
    order = np.argsort(x)
    values = {
        "contact radius over Hertz's": contact_radius(comm, solution) / theory.contact_radius,
        "peak pressure over Hertz's": solution.peak_pressure / theory.peak,
        "approach of Hertz's force [mm]": theory.approach,
    }
    return Result(values, x[order] / theory.contact_radius, p[order] / theory.peak)


X = np.linspace(0.0, 1.4, 200)
CASE = Case(
    name="ball",
    title="Ball on a plane",
    published={
        "contact radius over Hertz's": (1.0, 1.0),
        "peak pressure over Hertz's": (1.0, 1.0),
        "approach of Hertz's force [mm]": (APPROACH, APPROACH),
    },
    sizes=(0.08, 0.04, 0.02),
    solve=solve,
    axes=("radius over a", "pressure over the peak"),
    curve=(X, np.sqrt(np.maximum(1.0 - X**2, 0.0))),
)

if __name__ == "__main__":
    CASE.main()
