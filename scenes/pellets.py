"""Three hot pellets in a tube, bodies of revolution. Lengths in mm, MPa, N."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Coulomb, Frictionless, RigidPlane
from scenes.boxes import Body, boxes, near
from scenes.elasticity import fixed
from scenes.revolution import ring_elasticity, ring_strain
from scenes.scene import Scene

#: Radii [mm] of the dish at each end of a pellet, of its chamfers, of the pellet.
RADII = 3.0, 3.8, 4.1

#: Length of a pellet, depth of its dishes [mm].
LENGTH, DISH = 10.0, 0.1

#: Inner and outer radius, and length of the tube [mm].
TUBE = 4.13, 4.73, 34.0

#: Young's modulus [MPa], Poisson's ratio, thermal expansion [1/K] of pellets and tube.
YOUNG, POISSON, EXPANSION = (2e5, 75e3), (0.35, 0.3), (10e-6, 6.7e-6)

#: Stiffness [N/mm] and initial force [N] of the spring on the upper pellet.
SPRING, FORCE = 50.0, 50.0

#: Rises of temperature [K] in load steps, see `data.rises`.
HEATING = [(0, 0, 0), (300, 0, 0), (1500, 0, 0), (1500, 0, 300), (300, 1500, 300), (0, 0, 0)]

#: Tags of facets; those of the sides, the lower and the upper end of pellet k are SIDES + k, and so
#: on.
AXIS, TUBE_END, TUBE_INSIDE, SIDES, BOTTOMS, TOPS = 1, 2, 3, 10, 20, 30


def three_pellets(comm: MPI.Comm, n: int = 40, friction: float = 0.3) -> Scene:
    """Return the scene; the pellets stand on each other and on a rigid floor. Collective.

    It is for problems with `axisymmetric=True`. `data.rises` are three rises of temperature [K]: of
    the pellets' surfaces, of their axes beyond that, and of the tube.

    Args:
        comm: communicator of the mesh.
        n: cells along a pellet, a multiple of five.
        friction: coefficient of friction of all pairs; 0: frictionless.
    """
    lines = [0.0, 6.0, 10.0, 12.0]  # numbers of cells within `RADII`

    def shaped(x: np.ndarray) -> np.ndarray:
        r = np.interp(x[:, 0], lines, (0.0, *RADII))
        middle = 0.5 * (x[:, 1].min() + x[:, 1].max())
        cut = DISH * np.maximum(1 - (r / RADII[0]) ** 2, 0.0) + np.maximum(r - RADII[1], 0.0)
        return np.column_stack([r, middle + (x[:, 1] - middle) * (1 - cut / (0.5 * LENGTH))])

    spans = [(LENGTH * k, LENGTH * (k + 1)) for k in range(3)]
    pellets = [Body((12, n), [(0.0, lines[3]), span], move=shaped) for span in spans]
    tube = Body((4, 17 * n // 5), [TUBE[:2], (0.0, TUBE[2])])
    made = boxes(comm, "quadrilateral", [*pellets, tube])
    marks: list[Any] = [(AXIS, [0, 1, 2], near(0, 0.0))]
    marks += [(TUBE_END, [3], near(1, 0.0)), (TUBE_INSIDE, [3], near(0, TUBE[0]))]
    for k, span in enumerate(spans):
        marks.append((SIDES + k, [k], lambda x: x[:, 0] > lines[2]))
        for tag, z in zip((BOTTOMS + k, TOPS + k), span, strict=True):
            marks.append((tag, [k], lambda x, z=z: near(1, z)(x) & (x[:, 0] < lines[2])))
    tags, V, mesh = made.tags(*marks), made.V, made.mesh
    is_tube = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    is_tube.interpolate(lambda x: 1.0 * (x[0] > RADII[2]))

    def by_body(pellet: Any, tube: Any) -> Any:
        return pellet + is_tube * (tube - pellet)

    r, _ = ufl.SpatialCoordinate(mesh)
    rises = [fem.Constant(mesh, 0.0) for _ in range(3)]
    rise = by_body(rises[0] + rises[1] * (1 - (r / RADII[2]) ** 2), rises[2])
    young, poisson = by_body(*YOUNG), by_body(*POISSON)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    stress = young / (1 - 2 * poisson) * by_body(*EXPANSION) * rise
    on_top = 2 * r / RADII[1] ** 2  # part of a force on the upper end, for each length of the line
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(TOPS + 2)
    L = stress * ufl.tr(ring_strain(v, r)) * 2 * np.pi * r * ufl.dx - FORCE * on_top * v[1] * ds
    a = ring_elasticity(V, young, poisson) + SPRING * on_top * u[1] * v[1] * ds
    law = Coulomb(friction) if friction else Frictionless()
    pairs = [ContactPair(tags, BOTTOMS, RigidPlane((0.0, 0.0), (0.0, 1.0)), law)]
    pairs += [ContactPair(tags, TOPS + k, BOTTOMS + k + 1, law) for k in range(2)]
    pairs += [ContactPair(tags, SIDES + k, TUBE_INSIDE, law) for k in range(3)]
    bcs = [fixed(V, tags.find(AXIS), 0.0, 0), fixed(V, tags.find(TUBE_END), 0.0, 1)]
    return Scene(V, a, L, bcs, pairs, tags, data=SimpleNamespace(rises=rises))
