"""A block pressed and pushed on a rigid plane by GetFEM: `published_cases/pushed_block.py`.

    PYTHONPATH=.:benchmarks/published_cases python3 benchmarks/peer_solvers/getfem_block.py 64

This command prints the quantities of that case, and the shear stress at some nodes, with 64 cells
along the block. It needs Debian's python3-getfem beside DOLFINx. Displacements have degree 2; the
multipliers of the plane have degree 1, and their conditions are integrals (Alart and Curnier's
augmented Lagrangian). Newton's method begins with contact everywhere.
"""

from __future__ import annotations

import sys

import numpy as np
from pushed_block import (
    ABOVE,
    BESIDE,
    CASE,
    COEFFICIENT,
    HEIGHT,
    POISSON,
    WIDTH,
    YOUNG,
    graded,
    quantities,
)

from scenes.elasticity import lame_constants

BOTTOM, TOP, LEFT = 1, 2, 3

#: Outward normals of the sides with loads or contact.
NORMALS = {BOTTOM: (0.0, -1.0), TOP: (0.0, 1.0), LEFT: (-1.0, 0.0)}

#: Pressure that the law allows, and the law: pressure p and shear stress q are tractions of the
#: plane, c is the augmentation parameter, Young's modulus over the mean size of cells.
PRESSED = "pos_part(p-c*u(2))"
LAW = (
    f"(p-{PRESSED})*Test_p/c",
    f"(q-max(-F*{PRESSED},min(F*{PRESSED},q-c*u(1))))*Test_q/c",
)

#: Residual at which Newton's method ends, with forces of order 100, and limit for its steps.
RESIDUAL, MOST = 1e-9, 60


def values(n: int) -> tuple[dict[str, float], dict[float, float]]:
    """Return the quantities, and shear stresses at nodes, with n cells along the block."""
    import getfem

    getfem.util_trace_level(0)
    getfem.util_warning_level(0)
    ends = np.linspace(0.0, 1.0, n + 1)
    lines = graded(np.stack([ends, ends], axis=1))
    mesh = getfem.Mesh("cartesian", lines[:, 0], lines[::2, 1])
    faces = mesh.outer_faces()
    normals = np.array([mesh.normal_of_face(int(cell), int(face)) for cell, face in faces.T])
    for side, normal in NORMALS.items():
        mesh.set_region(side, faces[:, normals @ normal > 0.5])
    space, surface = getfem.MeshFem(mesh, 2), getfem.MeshFem(mesh, 1)
    space.set_fem(getfem.Fem("FEM_QK(2,2)"))
    surface.set_fem(getfem.Fem("FEM_QK(2,1)"))
    points = getfem.MeshIm(mesh, getfem.Integ("IM_GAUSS_PARALLELEPIPED(2,6)"))
    model = getfem.Model("real")
    model.add_fem_variable("u", space)
    mu, lame = lame_constants(YOUNG, POISSON)
    for name, value in {"mu": mu, "lame": lame, "F": COEFFICIENT, "c": YOUNG * n / WIDTH}.items():
        model.add_initialized_data(name, [value])
    model.add_isotropic_linearized_elasticity_brick(points, "u", "lame", "mu")
    for side, load in {TOP: (0.0, -ABOVE), LEFT: (BESIDE, 0.0)}.items():
        model.add_initialized_data(f"load_{side}", list(load))
        model.add_source_term_brick(points, "u", f"load_{side}", side)
    for name, start in {"p": ABOVE, "q": -BESIDE * HEIGHT / WIDTH}.items():
        model.add_filtered_fem_variable(name, surface, BOTTOM)
        model.set_variable(name, np.full(len(model.variable(name)), start))
    for term in ("-p*Test_u(2)-q*Test_u(1)", *LAW):
        model.add_nonlinear_term(points, term, BOTTOM)
    steps, _ = model.solve("max_res", RESIDUAL, "max_iter", MOST)
    if steps >= MOST:
        raise RuntimeError("GetFEM's Newton method does not converge")
    u = model.variable("u").reshape(-1, 2)
    places = space.basic_dof_nodes()[:, ::2].T
    x = surface.basic_dof_nodes()[0, np.unique(surface.basic_dof_on_region(BOTTOM))]
    order = np.argsort(x)
    x, p, q = x[order], model.variable("p")[order], -model.variable("q")[order]

    half = x <= 0.5 * WIDTH * (1.0 + 1e-9)
    on_left = (
        np.trapezoid(p[half], x[half]) / np.trapezoid(p, x),
        np.trapezoid(q[half], x[half]) / np.trapezoid(q, x),
    )
    return quantities(places, u, x, p, q, on_left), {
        place: np.interp(place, x, q) for place in CASE.marks[0]
    }


if __name__ == "__main__":
    quantities, shear = values(int(sys.argv[1]))
    for quantity, value in quantities.items():
        print(f"{quantity:45s} {value:.6g}")
    for place, stress in shear.items():
        print(f"shear stress at {place:g}: {stress:.5g}")
