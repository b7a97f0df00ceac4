"""A steel cylinder on an aluminium block, without friction: NAFEMS R0094, benchmark 1.

    tools/fenicsx python3 benchmarks/published_cases/roller.py 0.25

A. Konter, Advanced finite element contact benchmarks, NAFEMS R0094, 2006. Plane strain; the
published values are Hertz's values for half-planes. With 1/256 of the force the contact is 1/16 as
wide, and the theory is more accurate. Hertz neglects tangential displacements. If the bodies are of
different materials, these displacements change the gap on the inclined parts of the contact,
relatively by about pressure / modulus. Two bodies of 105 GPa have together the same compliance as
the steel and the aluminium body, but equal displacements along the contact. The displacement of the
middle of the block is compared with Code_Aster's test `ssnp154a` (manual V6.03.154, with large
strains) and with a reference value, which the manual attributes to Abaqus and Marc.

The argument is the cell size at the larger contact [mm].
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from case import RTOL, Case, Result, by_group, exactly, peak_of

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Frictionless, read_gmsh
from scenes.elasticity import by_body, elasticity, fixed
from scenes.hertz_theory import HertzLine
from scenes.nodal import gathered, nodal, surface_nodes_of

FORCE, RADIUS, LOADED = 35_000.0, 50.0, 10.0  # N per mm of thickness, mm, mm
YOUNG, POISSON = {"cylinder": 210_000.0, "block": 70_000.0}, 0.3  # MPa

#: Young's modulus [MPa] of two equal bodies with the same total compliance.
EQUAL = dict.fromkeys(YOUNG, 105_000.0)

#: Name of the contact -> its relative size, and Young's moduli; the force is proportional to the
#: square of the size.
CONTACTS = {
    "": (1.0, YOUNG),
    ", contact of 1/16": (1 / 16, YOUNG),
    ", of 1/16, equal bodies": (1 / 16, EQUAL),
}


def hertz(scale: float) -> HertzLine:
    """Return Hertz's theory for a contact of relative size `scale`."""
    compliance = sum((1 - POISSON**2) / young for young in YOUNG.values())
    return HertzLine(scale**2 * FORCE, RADIUS, 1 / compliance)


def solve(comm: MPI.Comm, h: float) -> Result:
    """Solve with cells of size h [mm] at the larger contact. Collective."""
    values, curves = {}, []
    for name, (scale, young) in CONTACTS.items():
        V, x, p, weights, down = pressed(comm, h * scale, 0.5 * h, scale, young)
        curves.append((x, p))
        # a half ellipse has the second moment a^2 / 4
        half_width = 2 * math.sqrt(float(weights @ (p * x**2)) / float(weights @ p))
        values[f"peak pressure [MPa]{name}"] = peak_of(x / hertz(scale).contact_radius, p)
        values[f"half width [mm]{name}"] = half_width
        values.setdefault(MIDDLE, down)  # for the whole force: the first contact
    return Result(values, V, *curves[0])


def pressed(
    comm: MPI.Comm, h: float, growth: float, scale: float, young: dict[str, float]
) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, float]:
    """Solve with cells of size h [mm] at the contact. Collective.

    Returns:
        The space of the displacement; distances from the middle, pressures and weights of the
        contact nodes; and the displacement of the middle.
    """
    roller = read_gmsh(
        Path(__file__).with_name("roller.geo"),
        comm,
        R=RADIUS,
        h=h,
        Zone=10.0 * scale,
        Growth=growth,
    )
    facets, tags = roller.facet_tags, roller.tags
    V = fem.functionspace(roller.mesh, ("Lagrange", 2, (2,)))
    top = ufl.Measure("ds", roller.mesh, subdomain_data=facets, subdomain_id=tags["top"])
    # length of the loaded arc of half the cylinder: the mesh has chords of this arc
    length = comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(roller.mesh, 1.0) * top)))
    load = fem.Constant(roller.mesh, (0.0, -0.5 * scale**2 * FORCE / length))
    pair = ContactPair(
        facets,
        secondary=tags["cylinder_contact"],
        primary=tags["block_contact"],
        friction=Frictionless(),
        geometry=roller.geometry,
    )
    a = elasticity(V, by_body(roller, young), POISSON)
    L = ufl.inner(load, ufl.TestFunction(V)) * top
    bcs = [fixed(V, facets.find(tags["bottom"])), fixed(V, facets.find(tags["symmetry"]), 0.0, 0)]
    with ContactProblem(a, L, [pair], bcs) as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        x, fields = surface_nodes_of(solution)
        x, p, weights = gathered(comm, x[:, 0], fields["pressure"], fields["weights"])
        u = nodal(solution.u)
        middle = np.hypot(*V.tabulate_dof_coordinates()[: len(u), :2].T) < 1e-9
        (down,) = gathered(comm, u[middle, 1])  # equal in both bodies
    order = np.argsort(x)
    return V, x[order], p[order], weights[order], -float(down.mean())


MIDDLE = "displacement of the middle [mm]"
HERTZ = hertz(1.0)
R = np.linspace(0.0, 8.0, 200)
CASE = Case(
    name="roller",
    title="Roller on a block",
    published={
        f"{quantity}{name}": exactly(getattr(hertz(scale), attribute))
        for name, (scale, _) in CONTACTS.items()
        for quantity, attribute in (
            ("peak pressure [MPa]", "peak"),
            ("half width [mm]", "contact_radius"),
        )
    }
    | {MIDDLE: by_group({"Code_Aster": 1.27303, "its reference": 1.3069}, source="programs")},
    source="formula",
    argument="cells at the contact [mm]",
    sizes=(0.5, 0.25, 0.125),
    solve=solve,
    order=1.5,
    axes=("distance from the middle [mm]", "pressure [MPa]"),
    curve=(R, HERTZ.pressure(R)),
)

if __name__ == "__main__":
    CASE.main()
