"""A half ring pressed on a block by GetFEM: the case of `scenes.large_sliding.half_ring`.

    PYTHONPATH=.:benchmarks python3 benchmarks/peer_solvers/getfem_half_ring.py 32 20

prints for so many cells along the ring and so many load steps the depth [mm], the force on the ring
[N] and the Newton steps of each load step. It needs Debian's python3-getfem beside DOLFINx. Method
and material are those of `getfem_ironing.py`. Displacements have degree 2, multipliers degree 1.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
from finite_sliding import RING_DEPTH, RING_FRICTION

from dolfinx_tresca import Coulomb
from dolfinx_tresca._base.compat import geometry_dofmap
from peer_solvers.getfem_ironing import CLAMPED, CONTACT, VIRTUAL_WORK, load_step
from scenes.elasticity import lame_constants
from scenes.large_sliding import (
    BLOCK_HALF,
    BLOCK_HEIGHT,
    RING_GAP,
    RING_RADIUS,
    RING_THICKNESS,
    RING_YOUNG,
    half_ring,
)

POISSON = 0.3

#: Regions of the layers of the ring, besides those of both meshes.
INNER, OUTER = 3, 4

#: Height of the middle of the ring.
MIDDLE = RING_GAP + RING_RADIUS + RING_THICKNESS

#: Length of the rays over the size of the cells, and augmentation over the block's modulus divided
#: by this size.
RAY, AUGMENTATION = 6.0, 2.0

#: Residual [N] at which the Newton steps of a load step end.
RESIDUAL = 1e-5


def forces(cells: int, steps: int) -> Iterator[tuple[float, np.ndarray, int]]:
    """Yield the depth [mm], the force (2,) on the ring [N] and the Newton steps of each load step.

    Args:
        cells: along the ring.
        steps: load steps after the first one, in which the ring comes down to the block.
    """
    import getfem

    getfem.util_trace_level(0)
    getfem.util_warning_level(0)
    size = 2.0 * BLOCK_HALF / (4 * cells // 5)
    with half_ring(MPI.COMM_WORLD, cells, Coulomb(RING_FRICTION)).problem as problem:
        mesh = problem.u.function_space.mesh
        corners = mesh.geometry.x[geometry_dofmap(mesh)][:, :, :2]
    model = getfem.Model("real")
    model.add_initialized_data("augmentation", AUGMENTATION * RING_YOUNG[2] / size)
    model.add_initialized_data("friction", [RING_FRICTION])
    model.add_initialized_data("rate", [1.0])
    model.add_initialized_data("of_ring", [0.0, 0.0])
    model.add_initialized_data("of_block", [0.0, 0.0])
    contact = model.add_integral_large_sliding_contact_brick_raytracing(
        "augmentation", RAY * size, "friction", "rate", 0
    )
    below = corners[:, :, 1].max(axis=1) < 1e-6
    kept = []  # GetFEM deletes what Python no longer refers to
    for name, part in {"ring": corners[~below], "block": corners[below]}.items():
        body = _mesh(getfem, part, name)
        space = getfem.MeshFem(body, 2)
        space.set_fem(getfem.Fem("FEM_QK(2,2)"))
        points = getfem.MeshIm(body, getfem.Integ("IM_GAUSS_PARALLELEPIPED(2,6)"))
        kept.append((body, space, points))
        u, last = f"u_{name}", f"last_{name}"
        model.add_fem_variable(u, space)
        model.add_fem_data(last, space)
        layers = zip(RING_YOUNG[:2], (INNER, OUTER), strict=True)
        for young, region in layers if name == "ring" else [(RING_YOUNG[2], -1)]:
            mu, lam = lame_constants(young, POISSON)
            model.add_nonlinear_term(points, VIRTUAL_WORK.format(u=u, mu=mu, lam=lam), region)
        model.add_Dirichlet_condition_with_simplification(u, CLAMPED, f"of_{name}")
        if name == "ring":
            surface = getfem.MeshFem(body, 2)
            surface.set_fem(getfem.Fem("FEM_QK(2,1)"))
            kept.append(surface)
            model.add_filtered_fem_variable("traction", surface, CONTACT)
            model.add_slave_contact_boundary_to_large_sliding_contact_brick(
                contact, points, CONTACT, u, "traction", last
            )
        else:
            model.add_master_contact_boundary_to_large_sliding_contact_brick(
                contact, points, CONTACT, u, last
            )
    points_of_ring = kept[0][-1]
    for depth in np.linspace(0.0, RING_DEPTH, steps + 1):
        displacement = [0.0, -RING_GAP - depth]
        bodies = "ring", "block"
        yield depth, *load_step(getfem, model, bodies, displacement, points_of_ring, RESIDUAL)


def _mesh(getfem: Any, corners: np.ndarray, name: str) -> Any:
    """Return the mesh of a body with corners (cells, 4, 2), with its regions."""
    mesh = getfem.Mesh("empty", 2)
    numbers = mesh.add_convex(
        getfem.GeoTrans("GT_QK(2,1)"), np.asfortranarray(corners.transpose(2, 1, 0))
    )
    points, facets = mesh.pts(), mesh.outer_faces()
    x, y = np.array([points[:, mesh.pid_in_faces(facet)] for facet in facets.T]).transpose(1, 0, 2)
    if name == "ring":
        outer = RING_RADIUS + RING_THICKNESS
        touches = np.hypot(x, y - MIDDLE) > outer - 1e-6
        clamped = y > MIDDLE - 1e-6
        radius = np.hypot(*(corners - [0.0, MIDDLE]).transpose(2, 0, 1)).mean(axis=1)
        inner = radius < RING_RADIUS + 0.5 * RING_THICKNESS
        mesh.set_region(INNER, np.asarray(numbers)[None, inner])
        mesh.set_region(OUTER, np.asarray(numbers)[None, ~inner])
    else:
        touches, clamped = y > -1e-6, y < 1e-6 - BLOCK_HEIGHT
    mesh.set_region(CONTACT, facets[:, touches.all(axis=1)])
    mesh.set_region(CLAMPED, facets[:, clamped.all(axis=1)])
    return mesh


if __name__ == "__main__":
    for depth, force, newton_steps in forces(*map(int, sys.argv[1:])):
        print(f"{depth:.4f} {force[0]:10.3f} {force[1]:10.3f} {newton_steps:4d}", flush=True)
