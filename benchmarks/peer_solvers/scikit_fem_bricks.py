"""The two bricks by scikit-fem: its meshes, assembly and boundary conditions, and SciPy's LU."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import block_diag, csr_array, vstack
from scipy.spatial import cKDTree

from dolfinx_tresca._base.compat import geometry_dofmap
from peer_solvers.discrete import Answer, Primal
from peer_solvers.monolithic import newton
from scenes.two_bricks import POISSON, SLIP_BOUND, YOUNG

#: Axis and place of the faces of each brick.
FACES = {
    "upper": {"fixed": (0, 2.0), "free_end": (0, 0.0), "contact": (2, 1.0), "top": (2, 2.0)},
    "lower": {"fixed": (0, 0.0), "free_end": (0, 2.0), "contact": (2, 1.0)},
}


def solve(scene: Any, tolerance: float) -> Answer:
    """Solve the bricks as two meshes whose nodes coincide on the contact face.

    scikit-fem has no contact algorithm. Its example of contact, on two meshes, combines its forms
    of elasticity with a linear system of SciPy; here such a system is solved in each step of a
    semismooth Newton method. Multipliers are nodal, and weighted with the areas that scikit-fem
    integrates, which is our pairing of nodes, so that both have the same discrete solution.
    """
    import skfem
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    element = skfem.ElementVector(skfem.ElementTetP1())
    bases = {
        name: skfem.CellBasis(_brick(skfem, scene, name), element, intorder=1) for name in POISSON
    }
    K = block_diag(
        [
            linear_elasticity(*lame_parameters(YOUNG, POISSON[name])).assemble(basis)
            for name, basis in bases.items()
        ],
        format="csr",
    )
    value = scene.data.load.value

    @skfem.LinearForm
    def load(v: Any, _: Any) -> Any:
        return np.einsum("i,i...->...", value, v)

    @skfem.LinearForm
    def area(v: Any, _: Any) -> Any:
        return v[0]

    loads = {name: basis.zeros() for name, basis in bases.items()}
    for name, basis in bases.items():
        for face in _loaded(scene, name):
            loads[name] += load.assemble(basis.boundary(face))
    f = np.concatenate(list(loads.values()))
    upper, lower = bases.values()
    fixed = np.concatenate([upper.get_dofs("fixed").all(), upper.N + lower.get_dofs("fixed").all()])
    mesh = upper.mesh
    contact = (mesh.boundaries[name] for name in ("contact", "fixed"))
    nodes = np.setdiff1d(*(np.unique(mesh.facets[:, facets]) for facets in contact))
    facing = cKDTree(lower.mesh.p.T).query(mesh.p[:, nodes].T)[1]
    size = np.sqrt(area.assemble(upper.boundary("contact"))[upper.nodal_dofs[0, nodes]])

    def jump(axis: int) -> Any:
        """Return the displacement of the upper less that of the lower brick along an axis."""
        rows = np.arange(len(nodes))
        shape = len(nodes), upper.N + lower.N
        columns = upper.nodal_dofs[axis, nodes], upper.N + lower.nodal_dofs[axis, facing]
        above, below = (csr_array((size, (rows, column)), shape=shape) for column in columns)
        return above - below

    K, f, _, free = skfem.condense(K, f, D=fixed)
    N = -jump(2)[:, free]  # outwards of the upper brick is down
    T = vstack([jump(0), jump(1)], format="csr")[:, free]
    nothing = np.zeros(len(nodes))
    data = Primal(
        K=K,
        f=f,
        N=N,
        T=T,
        gap=nothing,
        slip=np.tile(nothing, 2),
        node=np.tile(np.arange(len(nodes)), 2),
        bound=SLIP_BOUND * size,
        size=size,
    )
    answer = newton([data], YOUNG, tolerance, skfem.solve)
    normal, first, second = answer.multipliers.reshape(3, -1) / size
    tractions = np.column_stack([first, second, -normal])
    return Answer(tractions, answer.work, answer.note, points=mesh.p[:, nodes].T)


def _brick(skfem: Any, scene: Any, name: str) -> Any:
    """Return the mesh of a brick, with names for its faces."""
    bricks = scene.tagged_mesh
    cells = geometry_dofmap(bricks.mesh)[bricks.cell_tags.find(bricks.tags[name])]
    points, corners = np.unique(cells, return_inverse=True)
    places = bricks.mesh.geometry.x[points].T, corners.reshape(cells.shape).T
    mesh = skfem.MeshTet(*map(np.ascontiguousarray, places))
    faces = {
        face: lambda x, axis=axis, value=value: np.isclose(x[axis], value)
        for face, (axis, value) in FACES[name].items()
    }
    return mesh.with_boundaries(faces)


def _loaded(scene: Any, name: str) -> list[str]:
    """Return the faces of a brick that carry the load."""
    tags = {tag for part in scene.L.integrals() for tag in np.atleast_1d(part.subdomain_id())}
    return [face for face in FACES[name] if scene.tags[f"{name}_{face}"] in tags]
