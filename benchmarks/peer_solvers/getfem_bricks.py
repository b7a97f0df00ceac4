"""GetFEM (Debian's python3-getfem), with its own assembly and its own Newton method."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_tresca._base.compat import geometry_dofmap
from peer_solvers.discrete import Answer
from scenes.two_bricks import POISSON, SLIP_BOUND, YOUNG

CONTACT, FIXED, LOADED = 1, 2, 3

#: c divided by E / h, as in monolithic.py
STEP = 0.1

#: Face with loads, conditions or contact -> its axis and position.
FACES = {
    "upper_fixed": (0, 2.0),
    "upper_free_end": (0, 0.0),
    "upper_contact": (2, 1.0),
    "upper_top": (2, 2.0),
    "lower_fixed": (0, 0.0),
    "lower_free_end": (0, 2.0),
    "lower_contact": (2, 1.0),
}

#: lam is the traction between the bricks; c is the augmentation parameter, E / h.
JUMP = "(u_upper-Interpolate(u_lower,facing))"
EQUILIBRIUM = "lam.Test_u_upper-lam.Interpolate(Test_u_lower,facing)"
LAW = (
    f"-(lam-pos_part(lam.Normal+c*({JUMP}.Normal))*Normal"
    f"-Ball_projection(lam-(lam.Normal)*Normal+c*({JUMP}-({JUMP}.Normal)*Normal),g)).Test_lam/c"
)


def solve(scene: Any, tolerance: float) -> Answer:
    """Solve the bricks as two meshes, with a multiplier on the contact face of the upper one.

    GetFEM's ready-made contact bricks let friction act only where there is pressure, so the law is
    written in its language of weak forms: Alart and Curnier's augmented Lagrangian with Tresca's
    circle. Integrals over the contact face have the nodes as points (Newton-Cotes), which is our
    pairing of nodes, so that both codes have the same discrete solution. Newton's method, each step
    with one factorisation by MUMPS, starts with contact everywhere; the load and all data are
    those of the scene.
    """
    import getfem

    getfem.util_trace_level(0)
    getfem.util_warning_level(0)
    model = getfem.Model("real")
    meshes = {name: _brick(getfem, scene, name) for name in POISSON}
    for name, mesh in meshes.items():
        space = getfem.MeshFem(mesh, 3)
        space.set_fem(getfem.Fem("FEM_PK(3,1)"))
        points = getfem.MeshIm(mesh, getfem.Integ("IM_TETRAHEDRON(1)"))
        u = f"u_{name}"
        model.add_fem_variable(u, space)
        poisson = POISSON[name]
        model.add_initialized_data(f"mu_{name}", YOUNG / (2 * (1 + poisson)))
        model.add_initialized_data(
            f"lame_{name}", YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson))
        )
        model.add_isotropic_linearized_elasticity_brick(points, u, f"lame_{name}", f"mu_{name}")
        model.add_Dirichlet_condition_with_simplification(u, FIXED)
        if len(mesh.region(LOADED)[0]):
            load = ",".join(f"{value:.17g}" for value in scene.data.load.value)
            model.add_linear_term(points, f"-[{load}].Test_{u}", LOADED)

    upper, lower = meshes["upper"], meshes["lower"]
    traction = getfem.MeshFem(upper, 3)
    traction.set_fem(getfem.Fem("FEM_PK(3,1)"))
    carries = np.setdiff1d(
        traction.basic_dof_on_region(CONTACT), traction.basic_dof_on_region(FIXED)
    )
    multiplier = getfem.MeshFem("partial", traction, carries)
    model.add_fem_variable("lam", multiplier)
    model.set_variable("lam", np.tile([0.0, 0.0, -1e-6], len(carries) // 3))
    model.add_initialized_data("g", SLIP_BOUND)
    model.add_initialized_data("c", STEP * YOUNG * np.sqrt(len(carries) / 3))
    model.add_interpolate_transformation_from_expression("facing", upper, lower, "X")
    nodes = getfem.MeshIm(upper, getfem.Integ("IM_NC(3,1)"))
    model.add_linear_term(nodes, EQUILIBRIUM, CONTACT)
    model.add_nonlinear_term(nodes, LAW, CONTACT)
    found = model.solve(
        "max_res", tolerance, "max_iter", 100, "lsolver", "mumps", "lsearch", "simplest"
    )
    values = model.variable("lam").reshape(-1, 3)
    places = traction.basic_dof_nodes()[:, carries[::3]].T
    return Answer(
        values,
        {"iterations": int(found[0]), "factorisations": int(found[0])},
        "converged" if found[1] else "no convergence",
        points=places,
    )


def _brick(getfem: Any, scene: Any, name: str) -> Any:
    """Return the mesh of a brick, with its regions."""
    bricks = scene.tagged_mesh
    cells = bricks.cell_tags.find(bricks.tags[name])
    corners = bricks.mesh.geometry.x[geometry_dofmap(bricks.mesh)[cells]]
    mesh = getfem.Mesh("empty", 3)
    mesh.add_convex(getfem.GeoTrans("GT_PK(3,1)"), np.asfortranarray(corners.transpose(2, 1, 0)))
    loaded = {
        tag for part in scene.L.integrals() for tag in np.atleast_1d(part.subdomain_id()).tolist()
    }
    for region in (CONTACT, FIXED, LOADED):
        mesh.set_region(region, np.zeros((2, 0), dtype=int))
    for face, (axis, value) in FACES.items():
        if not face.startswith(name):
            continue
        low, high = np.full(3, -1.0), np.full(3, 3.0)
        low[axis], high[axis] = value - 1e-9, value + 1e-9
        facets = mesh.outer_faces_in_box(low, high)
        if face.endswith("_contact"):
            mesh.set_region(CONTACT, facets)
        elif face.endswith("_fixed"):
            mesh.set_region(FIXED, facets)
        elif bricks.tags[face] in loaded:
            mesh.extend_region(LOADED, facets)
    return mesh
