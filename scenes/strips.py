"""Two slender strips, clamped at an end, pressed on each other and bent; lengths in mm, MPa."""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb
from dolfinx_tresca.scene.friction import Friction
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity, fixed
from scenes.scene import Scene

LENGTH, THICKNESS = 200.0, 5.0  # mm, of a strip
YOUNG, PRESSURE, FRICTION = 70e3, 0.2, 0.3  # MPa, MPa, coefficient

#: Tags of facets.
CLAMPED, TIP, BELOW, ABOVE, UPPER, LOWER = range(1, 7)


def two_strips(comm: MPI.Comm, n: int, degree: int = 1, friction: Friction | None = None) -> Scene:
    """Return the scene with n cells along each strip. Collective.

    `data.shear` is the force at the tip [N/mm]. From 0.4 N/mm on the joint slips, as beam theory
    says: the largest shear stress, 1.5 times the mean, is then `FRICTION` times the pressure.

    Args:
        comm: communicator of the mesh.
        n: number of cells along a strip; each strip has two cells across.
        degree: degree of the displacement.
        friction: law of friction of the joint; None: `Coulomb(FRICTION)`.
    """
    spans = [(0.0, THICKNESS), (THICKNESS, 2 * THICKNESS)]
    bodies = [Body((n, 2), [(0.0, LENGTH), span]) for span in spans]
    made = boxes(comm, "quadrilateral", bodies, degree)
    tags = made.tags(
        (CLAMPED, [0, 1], near(0, 0.0)), (TIP, [0, 1], near(0, LENGTH)),
        (BELOW, [0], near(1, 0.0)), (ABOVE, [1], near(1, 2 * THICKNESS)),
        (UPPER, [1], near(1, THICKNESS)), (LOWER, [0], near(1, THICKNESS)),
    )  # fmt: skip
    V, shear = made.V, fem.Constant(made.mesh, 0.0)
    v, ds = ufl.TestFunction(V), ufl.Measure("ds", domain=made.mesh, subdomain_data=tags)
    L = PRESSURE * v[1] * ds(BELOW) - PRESSURE * v[1] * ds(ABOVE)
    L += shear / (2 * THICKNESS) * v[1] * ds(TIP)
    pairs = [ContactPair(tags, UPPER, LOWER, friction or Coulomb(FRICTION))]
    bcs, data = [fixed(V, tags.find(CLAMPED))], SimpleNamespace(shear=shear)
    return Scene(V, elasticity(V, YOUNG, 0.0), L, bcs, pairs, tags, data=data)
