"""A ball on a rigid plane, two balls, a cylinder on a plane. Lengths in mm, MPa, N."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactSolution,
    Frictionless,
    RigidPlane,
    TaggedMesh,
    read_gmsh,
)
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.hertz_theory import HertzLine, HertzSphere, far_compliance, plane_strain_modulus
from scenes.scene import Scene

YOUNG, POISSON, RADIUS = 10.0, 0.3, 10.0  # MPa, -, mm: the upper body
LOWER_YOUNG, LOWER_POISSON, LOWER_RADIUS = 20.0, 0.4, 20.0  # the lower ball

#: Surface, component of the displacement that is prescribed there, and its value [mm].
Held = tuple[str, int, float]


def sphere_on_plane(
    comm: MPI.Comm,
    h: float = 0.12,
    *,
    degree: int = 1,
    approach: float = 0.144,
    **parameters: float,
) -> Scene:
    """Return a ball on a rigid plane: octant, cells of size h [mm] at the contact. Collective.

    `parameters` are further parameters of the .geo file. `data`, here and in the scenes below, has

    young, poisson: functions of the material.
    bodies: names of the bodies.
    h: size of the largest cells at the contact [mm].
    approach: how much the middles of the bodies approach each other [mm].
    share: number of meshed parts that make the whole contact.
    theory: function from a force [N] to the solution by Hertz's theory.
    """
    zone = 1.4 * math.sqrt(RADIUS * approach)
    given = {"R": RADIUS, "h": h, "Zone": zone, **parameters}
    bodies = read_gmsh(MESHES / "sphere_octant.geo", comm, **given)
    return on_sphere(bodies, degree=degree, approach=approach, h=h)


def on_sphere(
    bodies: TaggedMesh, *, degree: int = 1, approach: float = 0.144, **data: Any
) -> Scene:
    """Return the scene on any mesh of the ball; `data` is added to its data. Collective."""
    held = [("upper_x", 0, 0.0), ("upper_y", 1, 0.0), ("upper_cut", 2, -approach)]
    plane = RigidPlane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    return _scene(
        bodies,
        degree,
        {"upper": (YOUNG, POISSON)},
        held,
        ContactPair(bodies.facet_tags, bodies.tags["upper_contact"], plane, Frictionless()),
        **data,
        approach=approach,
        share=4,
        theory=partial(
            HertzSphere,
            radius=RADIUS,
            modulus=plane_strain_modulus(YOUNG, POISSON),
            far=far_compliance(RADIUS, YOUNG, POISSON),
        ),
    )


def two_spheres(
    comm: MPI.Comm,
    h: float = 0.08,
    *,
    h_lower: float | None = None,
    degree: int = 1,
    approach: float = 0.1,
) -> Scene:
    """Return two balls, octants with cells of size h and h_lower [mm] (or 1.3 h). Collective.

    The meshes do not match, so the package takes mortar elements.
    """
    h_lower = 1.3 * h if h_lower is None else h_lower
    radius = 1 / (1 / RADIUS + 1 / LOWER_RADIUS)
    bodies = read_gmsh(
        MESHES / "sphere_octant.geo",
        comm,
        Bodies=2,
        R=RADIUS,
        R_lower=LOWER_RADIUS,
        h=h,
        h_lower=h_lower,
        Zone=1.4 * math.sqrt(radius * approach),
    )
    held = [("upper_x", 0, 0.0), ("upper_y", 1, 0.0), ("upper_cut", 2, -approach)]
    held += [("lower_x", 0, 0.0), ("lower_y", 1, 0.0), ("lower_cut", 2, 0.0)]
    tags = bodies.tags
    upper = 1 / plane_strain_modulus(YOUNG, POISSON)
    lower = 1 / plane_strain_modulus(LOWER_YOUNG, LOWER_POISSON)
    far = far_compliance(RADIUS, YOUNG, POISSON)
    far += far_compliance(LOWER_RADIUS, LOWER_YOUNG, LOWER_POISSON)
    return _scene(
        bodies,
        degree,
        {"upper": (YOUNG, POISSON), "lower": (LOWER_YOUNG, LOWER_POISSON)},
        held,
        ContactPair(
            bodies.facet_tags, tags["upper_contact"], tags["lower_contact"], Frictionless()
        ),
        h=max(h, h_lower),
        approach=approach,
        share=4,
        theory=partial(HertzSphere, radius=radius, modulus=1 / (upper + lower), far=far),
    )


def cylinder_on_plane(
    comm: MPI.Comm,
    h: float = 0.06,
    *,
    degree: int = 1,
    approach: float = 0.2165,
    quadrilaterals: bool = False,
) -> Scene:
    """Return a long cylinder on a rigid plane: a quarter of its section. Collective."""
    contact = 0.12 * RADIUS  # about
    cylinder = read_gmsh(
        MESHES / "half_disc.geo",
        comm,
        R=RADIUS,
        h=h,
        Zone=1.3 * contact,
        Arc=2.5 * contact,
        Quad=int(quadrilaterals),
    )
    return on_cylinder(cylinder, degree=degree, approach=approach, h=h)


def on_cylinder(
    cylinder: TaggedMesh, *, degree: int = 1, approach: float = 0.2165, **data: Any
) -> Scene:
    """Return the scene on any mesh of the cylinder; `data` is added to its data. Collective."""
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    return _scene(
        cylinder,
        degree,
        {"cylinder": (YOUNG, POISSON)},
        [("symmetry", 0, 0.0), ("cut", 1, -approach)],
        ContactPair(cylinder.facet_tags, cylinder.tags["contact"], plane, Frictionless()),
        approach=approach,
        share=2,
        theory=partial(HertzLine, radius=RADIUS, modulus=plane_strain_modulus(YOUNG, POISSON)),
        **data,
    )


def nearest_of_cylinder(x: np.ndarray) -> np.ndarray:
    """Return the points (3, n) of the cylinder's surface that are nearest to given points."""
    middle = np.array([[0.0], [RADIUS], [0.0]])
    return middle + RADIUS * (x - middle) / np.linalg.norm(x - middle, axis=0)


def _scene(
    bodies: TaggedMesh,
    degree: int,
    materials: dict[str, tuple[float, float]],
    held: list[Held],
    pair: ContactPair,
    **data: Any,
) -> Scene:
    """Return the scene of bodies with (Young's modulus, Poisson's ratio) by name."""
    V = fem.functionspace(bodies.mesh, ("Lagrange", degree, (bodies.mesh.geometry.dim,)))
    young, poisson = (
        by_body(bodies, {name: values[i] for name, values in materials.items()}) for i in (0, 1)
    )
    bcs = [
        fixed(V, bodies.facet_tags.find(bodies.tags[name]), value, component)
        for name, component, value in held
    ]
    return Scene(
        V,
        elasticity(V, young, poisson),
        no_load(V),
        bcs,
        [pair],
        bodies.facet_tags,
        bodies.cell_tags,
        bodies.tags,
        SimpleNamespace(young=young, poisson=poisson, bodies=tuple(materials), **data),
        bodies.geometry,
    )


@dataclass(frozen=True)
class Comparison:
    """Computed contact, and Hertz's theory for its force; the same on all ranks."""

    theory: HertzSphere | HertzLine
    r: np.ndarray  # mm, distances of the contact nodes from the middle
    p: np.ndarray  # MPa, their pressures
    contact_radius: float  # mm, of a disc as large as the area of the nodes that are pressed
    peak: float  # MPa, the largest pressure
    approach: float  # mm
    difference: float  # L2 norm of p - theory, divided by that of theory


def compare(scene: Scene, solution: ContactSolution) -> Comparison:
    """Return the computed contact, and the theory for its force. Collective."""
    comm, share = scene.mesh.comm, scene.data.share
    surface = solution.surface
    space = surface.pressure.function_space
    owned = space.dofmap.index_map.size_local
    horizontal = scene.mesh.geometry.dim - 1
    nodes = np.linalg.norm(space.tabulate_dof_coordinates()[:owned, :horizontal], axis=1)
    r = np.concatenate(comm.allgather(nodes))
    p = np.concatenate(comm.allgather(surface.pressure.x.array[:owned]))
    pressed = comm.allreduce(float(surface.weights[surface.touching].sum()))
    theory = scene.data.theory(share * solution.normal_force)
    # the area of all parts together is a disc, or a strip
    if isinstance(theory, HertzSphere):
        contact_radius = math.sqrt(share * pressed / math.pi)
    else:
        contact_radius = pressed
    near = r < 2 * theory.contact_radius
    wanted = theory.pressure(r[near])
    difference = np.linalg.norm(p[near] - wanted) / np.linalg.norm(wanted)
    return Comparison(
        theory=theory,
        r=r,
        p=p,
        contact_radius=contact_radius,
        peak=float(p.max()),
        approach=scene.data.approach,
        difference=float(difference),
    )
