"""Bodies of revolution: two meridians in a plane, x[0] is the radius. Lengths in mm, MPa, N."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactSolution,
    Frictionless,
    RigidPlane,
    read_gmsh,
)
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.scene.pair import Pairing
from scenes.boxes import Body, Where, boxes
from scenes.elasticity import fixed, lame_constants, no_load
from scenes.hertz_theory import HertzSphere, far_compliance, plane_strain_modulus
from scenes.nodal import surface_nodes_of
from scenes.scene import Scene

BALL, APPROACH = 10.0, 0.144  # mm
BALL_YOUNG, BALL_POISSON = 10.0, 0.3  # MPa, -

#: Tags of the sides that touch; tags of further sides follow.
SECONDARY, PRIMARY, FIRST = 1, 2, 3


def ring_strain(u: Any, r: Any) -> Any:
    """Return the strain (3, 3) of an axisymmetric displacement, in the order radius, axis, hoop."""
    plane = ufl.sym(ufl.grad(u))
    return ufl.as_tensor(
        [[plane[0, 0], plane[0, 1], 0.0], [plane[0, 1], plane[1, 1], 0.0], [0.0, 0.0, u[0] / r]]
    )


def ring_energy(u: Any, v: Any, mesh: Any, young: Any, poisson: Any = 0.3) -> Any:
    """Return a(u, v) of isotropic bodies of revolution, whose meridian is the mesh."""
    mu, lame = lame_constants(young, poisson)
    r = ufl.SpatialCoordinate(mesh)[0]
    e, f = ring_strain(u, r), ring_strain(v, r)
    density = 2 * mu * ufl.inner(e, f) + lame * ufl.tr(e) * ufl.tr(f)
    return density * 2 * np.pi * r * ufl.dx(mesh)


def ring_elasticity(V: Any, young: Any, poisson: Any = 0.3) -> Any:
    """Return the bilinear form of isotropic bodies of revolution."""
    return ring_energy(ufl.TrialFunction(V), ufl.TestFunction(V), V.mesh, young, poisson)


def two_rings(
    comm: MPI.Comm,
    bodies: tuple[Body, Body],
    sides: tuple[Where, Where],
    held: Sequence[tuple[int, Where, int, float]],
    friction: Friction,
    *,
    degree: int = 1,
    kind: str = "quadrilateral",
    young: float = 1000.0,
    poisson: float = 0.3,
    pairing: Pairing = "auto",
    swap: bool = False,
) -> Scene:
    """Return two bodies of revolution in contact. Collective.

    Args:
        comm: communicator of the mesh.
        bodies: meridians of the bodies.
        sides: select the facets of the first and of the second body that touch, by midpoints
            (n, 2).
        held: for each condition the body, its side, the prescribed component, and its value.
        friction: law of friction.
        degree: degree of the displacement.
        kind: type of the cells.
        young: Young's modulus [MPa].
        poisson: Poisson's ratio.
        pairing: see `ContactPair`.
        swap: whether the second body is the secondary side, in place of the first.
    """
    made = boxes(comm, kind, bodies, degree)
    marks = [(SECONDARY, [int(swap)], sides[swap]), (PRIMARY, [1 - swap], sides[not swap])]
    marks += [(FIRST + k, [body], where) for k, (body, where, _, _) in enumerate(held)]
    tags = made.tags(*marks)
    constants = [fem.Constant(made.mesh, value) for _, _, _, value in held]
    bcs = [
        fixed(made.V, tags.find(FIRST + k), constant, component)
        for k, ((_, _, component, _), constant) in enumerate(zip(held, constants, strict=True))
    ]
    pair = ContactPair(tags, SECONDARY, PRIMARY, friction, pairing=pairing)
    a = ring_elasticity(made.V, young, poisson)
    return Scene(made.V, a, no_load(made.V), bcs, [pair], tags)


def ball_on_plane(
    comm: MPI.Comm,
    h: float,
    degree: int = 1,
    *,
    growth: float = 0.2,
    scale: float = 1.0,
    poisson: float = BALL_POISSON,
) -> Scene:
    """Return a ball on a rigid plane. Collective.

    Args:
        comm: communicator of the mesh.
        h: size of the cells at the contact [mm].
        degree: degree of the displacement.
        growth: increase of the cell size per distance from the contact.
        scale: factor of the radius of the contact; the approach is proportional to its square.
        poisson: Poisson's ratio.

    `data.theory` is a function that returns Hertz's solution for a force [N].
    """
    ball = read_gmsh(
        MESHES / "half_disc.geo", comm, R=BALL, h=h, Zone=1.8 * scale, Arc=3.0, Growth=growth
    )
    facets, tags = ball.facet_tags, ball.tags
    V = fem.functionspace(ball.mesh, ("Lagrange", degree, (2,)))
    plane = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
    pair = ContactPair(facets, tags["contact"], plane, Frictionless())
    bcs = [
        fixed(V, facets.find(tags["symmetry"]), 0.0, 0),
        fixed(V, facets.find(tags["cut"]), -APPROACH * scale**2, 1),
    ]
    theory = partial(
        HertzSphere,
        radius=BALL,
        modulus=plane_strain_modulus(BALL_YOUNG, poisson),
        far=far_compliance(BALL, BALL_YOUNG, poisson),
    )
    a = ring_elasticity(V, BALL_YOUNG, poisson)
    data = SimpleNamespace(theory=theory)
    return Scene(V, a, no_load(V), bcs, [pair], facets, tags=tags, data=data)


def contact_radius(comm: MPI.Comm, solution: ContactSolution) -> float:
    """Return the radius [mm] of a contact whose pressure is half an ellipsoid. Collective."""
    x, fields = surface_nodes_of(solution)
    forces = fields["weights"] * fields["pressure"]
    second, force = comm.allreduce(np.array([forces @ x[:, 0] ** 2, forces.sum()]))
    return math.sqrt(2.5 * second / force)  # the second moment is 2/5 a^2 times the force
