"""A pin that is too thick for its hole, and pushed out. Lengths in mm, stresses in MPa."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

from dolfinx import default_scalar_type, fem

from dolfinx_tresca import MESHES, ContactPair, Coulomb, read_gmsh
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.scene import Scene

RADIUS, RIM, THICKNESS = 10.0, 30.0, 16.0  # mm
INTERFERENCE = 0.01  # mm
YOUNG = {"plate": 70_000.0, "pin": 210_000.0}  # MPa
POISSON = {"plate": 0.33, "pin": 0.3}
FRICTION = 0.15  # coefficient of friction

#: Downward displacements of the top of the pin [mm] in the load steps: out of the hole, and back.
PUSHES = (0.0, 0.001, 0.002, 0.003, 0.004, 0.006, 0.01, 0.008, 0.006, 0.004, 0.002, 0.0)


def lame_pressure() -> float:
    """Return the pressure [MPa] of a ring on a shaft, both free along the axis."""
    ring = ((RIM**2 + RADIUS**2) / (RIM**2 - RADIUS**2) + POISSON["plate"]) / YOUNG["plate"]
    shaft = (1 - POISSON["pin"]) / YOUNG["pin"]
    return INTERFERENCE / (RADIUS * (ring + shaft))


def press_fit(comm: MPI.Comm, N: int = 16) -> Scene:
    """Return the scene with N cells round a quarter of the hole. Collective.

    `data.push` is the displacement of the top of the pin along z [mm].
    """
    fit = read_gmsh(
        MESHES / "press_fit.geo",
        comm,
        N=N,
        M=2 * (3 * N // 8),  # cells round a quarter of the pin
        Hex=1,
        Radius=RADIUS,
        Rim=RIM,
        Thickness=THICKNESS,
        Interference=INTERFERENCE,
    )
    facet_tags, tags = fit.facet_tags, fit.tags
    V = fem.functionspace(fit.mesh, ("Lagrange", 1, (3,)))
    push = fem.Constant(fit.mesh, default_scalar_type(0.0))
    held = [("plate_x", 0, None), ("plate_y", 1, None), ("plate_support", 2, None)]
    held += [("pin_x", 0, None), ("pin_y", 1, None), ("pin_top", 2, push)]
    bcs = [fixed(V, facet_tags.find(tags[name]), value, axis) for name, axis, value in held]
    pair = ContactPair(
        facet_tags,
        secondary=tags["plate_contact"],
        primary=tags["pin_contact"],
        friction=Coulomb(FRICTION),
        geometry=fit.geometry,
    )
    a = elasticity(V, by_body(fit, YOUNG), by_body(fit, POISSON))
    data = SimpleNamespace(push=push)
    return Scene(V, a, no_load(V), bcs, [pair], facet_tags, fit.cell_tags, tags, data)
