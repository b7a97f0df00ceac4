"""An elastic ball on a rigid plane, as a body of revolution: Hertz.

    tools/fenicsx python3 benchmarks/published_cases/ball.py 0.04

K. L. Johnson, Contact Mechanics, section 4.2; the compliance far from the contact is an estimate of
Tatara 1991. The ball is pressed by 0.144 mm, and by 1/256 of this distance, which makes the contact
1/16 as wide: the theory holds for small contacts. The theory neglects tangential displacements,
which change the gap on the inclined parts of the contact, relatively by about pressure / modulus;
with Poisson's ratio 0.48 tangential displacements are very small. Hertz's values are values for the
computed force. The argument is the cell size at the larger contact [mm].
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, exactly, peak_of

from scenes.nodal import gathered, surface_nodes_of
from scenes.revolution import APPROACH, BALL_POISSON, ball_on_plane, contact_radius

#: Name of the contact -> its size relative to the larger contact, and Poisson's ratio.
CONTACTS = {
    "": (1.0, BALL_POISSON),
    ", contact of 1/16": (1 / 16, BALL_POISSON),
    ", of 1/16, Poisson's ratio 0.48": (1 / 16, 0.48),
}


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the larger contact. Collective."""
    values, x, y = {}, [], []
    for name, (scale, poisson) in CONTACTS.items():
        scene = ball_on_plane(comm, h * scale, 2, growth=2.5 * h, scale=scale, poisson=poisson)
        with scene.problem(axisymmetric=True) as problem:
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
        theory = scene.data.theory(solution.normal_force)
        points, fields = surface_nodes_of(solution)
        r, p = gathered(comm, points[:, 0], fields["pressure"])
        order = np.argsort(r)
        x.append(r[order] / theory.contact_radius)
        y.append(p[order] / theory.peak)
        found = contact_radius(comm, solution) / theory.contact_radius
        values[f"contact radius over Hertz's{name}"] = found
        values[f"peak pressure over Hertz's{name}"] = peak_of(x[-1], y[-1])
        values[f"approach over Hertz's{name}"] = APPROACH * scale**2 / theory.approach
    return Result(values, scene.V, x[0], y[0])


X = np.linspace(0.0, 1.4, 200)
CASE = Case(
    name="ball",
    title="Ball on a plane",
    published={
        f"{quantity} over Hertz's{name}": exactly(1.0)
        for name in CONTACTS
        for quantity in ("contact radius", "peak pressure", "approach")
    },
    source="formula",
    argument="cells at the contact [mm]",
    sizes=(0.08, 0.04, 0.02),
    solve=solve,
    order=1.5,
    axes=("radius over a", "pressure over the peak"),
    curve=(X, np.sqrt(np.maximum(1.0 - X**2, 0.0))),
)

if __name__ == "__main__":
    CASE.main()
