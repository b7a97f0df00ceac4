"""A block of rubber on a rigid ball, and on a rigid ring. Lengths in mm, stresses in MPa."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    Frictionless,
    RigidObstacle,
    RigidSphere,
    Tresca,
    read_gmsh,
)
from dolfinx_tresca.scene.friction import Friction
from scenes.elasticity import elasticity, fixed, no_load
from scenes.scene import Scene

YOUNG, POISSON = 10.0, 0.4  # MPa, rubber
LENGTH, HEIGHT = 24.0, 12.0  # mm, the block, as wide as long
BALL = 40.0  # mm, its radius
APPROACH, PUSH = 0.6, 0.15  # mm, the top goes down, and along x
FRICTION = 0.3  # coefficient of friction
RING, TUBE = 6.0, 6.0  # mm, radius of the ring's middle line, and of its cross-section


def distance_from_ring(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (n,) from a ring whose top is at z = 0, and its gradient (3, n)."""
    to_axis = np.hypot(x[0], x[1])
    outwards = to_axis - RING
    upwards = x[2] + TUBE
    to_middle_line = np.hypot(outwards, upwards)
    away = x[:2] / np.where(to_axis > 0.0, to_axis, 1.0)
    normal = np.vstack([away * outwards, upwards]) / to_middle_line
    # on the axis no radial direction is given: take x
    alone = to_axis == 0.0
    normal[0, alone] = outwards[alone] / to_middle_line[alone]
    return to_middle_line - TUBE, normal


def hertz_bound(x: np.ndarray) -> np.ndarray:
    """Return the coefficient of friction times Hertz's pressure on a half-space [MPa]."""
    modulus = YOUNG / (1 - POISSON**2)
    contact_radius = math.sqrt(BALL * APPROACH)
    peak = 2 * modulus * contact_radius / (math.pi * BALL)
    inside = 1 - (x[0] ** 2 + x[1] ** 2) / contact_radius**2
    bound: np.ndarray = FRICTION * peak * np.sqrt(np.maximum(inside, 0.0))
    return bound


def block_on_ball(comm: MPI.Comm, N: int = 32) -> Scene:
    """Return the block on the ball, pushed aside, with N cells along x. Collective."""
    ball = RigidSphere(center=(0.0, 0.0, -BALL), radius=BALL)
    return _block(comm, N, (PUSH, 0.0, -APPROACH), ball, Tresca(hertz_bound))


def block_on_ring(comm: MPI.Comm, N: int = 32) -> Scene:
    """Return the block on the ring, without friction. Collective."""
    ring = RigidObstacle(distance_from_ring, name="a rigid ring")
    return _block(comm, N, (0.0, 0.0, -APPROACH), ring, Frictionless())


def _block(
    comm: MPI.Comm,
    N: int,
    displacement: tuple[float, float, float],
    obstacle: RigidObstacle,
    friction: Friction,
) -> Scene:
    """Return a block whose top is displaced."""
    block = read_gmsh(
        MESHES / "block.geo", comm, N=N, Hex=1, Grading=1.2, Lx=LENGTH, Ly=LENGTH, Lz=HEIGHT
    )
    facet_tags, tags = block.facet_tags, block.tags
    V = fem.functionspace(block.mesh, ("Lagrange", 1, (3,)))
    bcs = [fixed(V, facet_tags.find(tags["top"]), displacement)]
    pair = ContactPair(facet_tags, tags["bottom"], obstacle, friction)
    a = elasticity(V, YOUNG, POISSON)
    return Scene(V, a, no_load(V), bcs, [pair], facet_tags, block.cell_tags, tags)
