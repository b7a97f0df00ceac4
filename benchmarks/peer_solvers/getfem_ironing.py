"""Shallow ironing by GetFEM, on the mesh and with the material of `scenes.large_sliding.ironing`.

    PYTHONPATH=.:benchmarks python3 benchmarks/peer_solvers/getfem_ironing.py CELLS STEPS

This command prints the time t, the horizontal and the vertical force on the block [N] and the
Newton steps of each load step. It needs Debian's python3-getfem beside DOLFINx. GetFEM solves the
same problem by another method: rays along the deformed normals of the block find the foundation,
multipliers are integrated over the block's surface (Poulios and Renard 2015), and Newton's method
solves for displacements and multipliers at once.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx.mesh import compute_midpoints

from dolfinx_tresca import MESHES, TaggedMesh, read_gmsh
from dolfinx_tresca._base.compat import geometry_dofmap
from scenes.elasticity import lame_constants
from scenes.large_sliding import (
    IRONING_DEPTH,
    IRONING_FRICTION,
    IRONING_POISSON,
    IRONING_WAY,
)

#: The secondary side comes first.
YOUNG = {"block": 6896.0, "foundation": 689.6}

#: Regions of both meshes, and the names of their faces in the .geo file.
CONTACT, CLAMPED = 1, 2
FACES = {
    "block": {CONTACT: "block_arc", CLAMPED: "block_top"},
    "foundation": {CONTACT: "foundation_top", CLAMPED: "foundation_bottom"},
}

#: First Piola-Kirchhoff stress of the material, times the gradient of the test function.
VIRTUAL_WORK = (
    "({mu}*(Id(2)+Grad_{u})+({lam}*log(Det(Id(2)+Grad_{u}))-{mu})*Inv(Id(2)+Grad_{u})')"
    ":Grad_Test_{u}"
)

#: Length of the rays divided by the cell size; augmentation parameter divided by Young's modulus.
RAY, AUGMENTATION = 6.0, 10.0

#: Limit for the Newton steps of a load step, and the residual [N] at which they end.
MOST, RESIDUAL = 100, 1e-6


def forces(cells: int, steps: int) -> Iterator[tuple[float, np.ndarray, int]]:
    """Yield the time, the force (2,) on the block [N] and the Newton steps of each load step.

    Args:
        cells: number of cells along the foundation, a multiple of 20.
        steps: number of load steps from t = 0 to t = 2, as in `scenes.large_sliding.iron`.
    """
    import getfem

    getfem.util_trace_level(0)
    getfem.util_warning_level(0)
    bodies = read_gmsh(MESHES / "ironing.geo", MPI.COMM_WORLD, N=cells)
    model = getfem.Model("real")
    model.add_initialized_data("augmentation", AUGMENTATION * YOUNG["foundation"])
    model.add_initialized_data("friction", [IRONING_FRICTION])
    model.add_initialized_data("rate", [1.0])
    model.add_initialized_data("of_block", [0.0, 0.0])
    model.add_initialized_data("of_foundation", [0.0, 0.0])
    contact = model.add_integral_large_sliding_contact_brick_raytracing(
        "augmentation", RAY * 12.0 / cells, "friction", "rate", 0
    )
    kept = []  # GetFEM deletes what Python no longer refers to
    for name, faces in FACES.items():
        mesh = _mesh(getfem, bodies, name, faces)
        space = getfem.MeshFem(mesh, 2)
        space.set_fem(getfem.Fem("FEM_QK(2,1)"))
        inside, surface = (
            getfem.MeshIm(mesh, getfem.Integ(f"IM_GAUSS_PARALLELEPIPED(2,{degree})"))
            for degree in (4, 6)
        )
        kept.append((mesh, space, inside, surface))
        u, last = f"u_{name}", f"last_{name}"
        model.add_fem_variable(u, space)
        model.add_fem_data(last, space)
        mu, lam = lame_constants(YOUNG[name], IRONING_POISSON)
        model.add_nonlinear_term(inside, VIRTUAL_WORK.format(u=u, mu=mu, lam=lam))
        model.add_Dirichlet_condition_with_simplification(u, CLAMPED, f"of_{name}")
        if name == "block":
            model.add_filtered_fem_variable("traction", space, CONTACT)
            model.add_slave_contact_boundary_to_large_sliding_contact_brick(
                contact, surface, CONTACT, u, "traction", last
            )
        else:
            model.add_master_contact_boundary_to_large_sliding_contact_brick(
                contact, surface, CONTACT, u, last
            )
    surface_of_block = kept[0][-1]
    for t in np.linspace(0.0, 2.0, steps + 1)[1:]:
        along, down = max(t - 1.0, 0.0) * IRONING_WAY, min(t, 1.0) * IRONING_DEPTH
        yield t, *load_step(getfem, model, FACES, [along, -down], surface_of_block, RESIDUAL)


def load_step(
    getfem: Any,
    model: Any,
    bodies: Iterable[str],
    displacement: list[float],
    surface: Any,
    residual: float,
) -> tuple[np.ndarray, int]:
    """Move the first body, solve, and let the slip of the next load step begin here.

    Args:
        getfem: the module.
        model: GetFEM's model, with the variables `u_`, `last_` and `of_` of each body.
        bodies: names of the bodies.
        displacement: (2,) of the clamped side of the first body [mm].
        surface: quadrature points (`MeshIm`) of the first body, over which tractions are summed.
        residual: residual [N] at which Newton's method ends.

    Returns:
        the force (2,) on the first body [N], and the number of Newton steps.
    """
    first, *others = bodies
    model.set_variable(f"of_{first}", displacement)
    newton_steps, converged = model.solve(
        "max_res", residual, "max_iter", MOST, "lsolver", "mumps",
        "lsearch", "simplest", "alpha min", 0.02,
    )  # fmt: skip
    if not converged:
        x, y = displacement
        raise RuntimeError(f"GetFEM's Newton method fails with {first} at ({x:g}, {y:g}) mm")
    for name in (first, *others):
        model.set_variable(f"last_{name}", model.variable(f"u_{name}"))
    force = getfem.asm_generic(surface, 0, "traction", CONTACT, model)
    return np.asarray(force), int(newton_steps)


def _mesh(getfem: Any, bodies: TaggedMesh, name: str, faces: dict[int, str]) -> Any:
    """Return the mesh of a body, with its regions."""
    cells = bodies.cell_tags.find(bodies.tags[name])
    corners = bodies.mesh.geometry.x[geometry_dofmap(bodies.mesh)[cells]][:, :, :2]
    mesh = getfem.Mesh("empty", 2)
    mesh.add_convex(getfem.GeoTrans("GT_QK(2,1)"), np.asfortranarray(corners.transpose(2, 1, 0)))
    points, facets = mesh.pts(), mesh.outer_faces()
    middles = np.array([points[:, mesh.pid_in_faces(facet)].mean(axis=1) for facet in facets.T])
    for region, face in faces.items():
        tagged = compute_midpoints(bodies.mesh, 1, bodies.facet_tags.find(bodies.tags[face]))
        distance = np.linalg.norm(middles[:, None] - tagged[None, :, :2], axis=2).min(axis=1)
        mesh.set_region(region, facets[:, distance < 1e-9])
    return mesh


if __name__ == "__main__":
    for t, force, newton_steps in forces(*map(int, sys.argv[1:])):
        print(f"{t:.4f} {force[0]:10.3f} {force[1]:10.3f} {newton_steps:4d}", flush=True)
