"""A block on a rigid plane with known solutions: it lifts off, or it sticks and slips.

The displacement is a polynomial on either side of x = 1/2, where contact ends or slip begins. Loads
follow from it. Lengths in m, stresses in MPa.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Literal, TypeAlias

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Frictionless, RigidPlane, Tresca
from dolfinx_tresca._base.compat import interpolation_points
from scenes.elasticity import lame_constants, strain
from scenes.manufactured import norm
from scenes.patches import block, dim_of, mesh_of
from scenes.scene import Scene

#: What the block does where x > 1/2.
Kind: TypeAlias = Literal["lifts", "slips"]

#: Tags of facets.
CONTACT, HELD, LOADED = 1, 2, 3


def block_on_plane(
    comm: MPI.Comm,
    cell: str,
    degree: int,
    n: int,
    kind: Kind,
    *,
    poisson: float = 0.3,
    size: float = 1.0,
    distort: float = 0.0,
    seed: int = 0,
) -> Scene:
    """Return the block with the loads of the exact solution. Collective.

    `data.error(u)` is the energy norm of u minus the exact displacement `data.exact`, `data.norm`
    that of the exact displacement.

    Args:
        comm: communicator of the mesh.
        cell: "triangle" or "tetrahedron".
        degree: degree of the displacement.
        n: even number of cells along x.
        kind: what the block does where x > 1/2: it lifts off without friction, or it slips, while
            it sticks where x < 1/2.
        poisson: ratio; Young's modulus is 1.
        size: factor of the part of the displacement that varies along x.
        distort: largest shift of nodes inside the block and its faces, relative to the cells.
        seed: seed of the shifts.
    """
    dim = dim_of(cell)
    box = [*[(0.0, 1.0)] * (dim - 1), (0.0, 0.5)]
    points, cells = block(cell, (n, max(n // 2, 1)), box, 0.0, 0)
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5, points.shape) * distort / n
    shift[np.isin(points.round(9), (0.0, 0.5, 1.0))] = 0.0
    mesh = mesh_of(comm, cell, 1, points + shift, cells)

    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    middle = dolfinx.mesh.compute_midpoints(mesh, dim - 1, facets)
    tags = np.full(len(facets), LOADED, dtype=np.int32)
    tags[middle[:, 0] < 1e-9] = HELD
    tags[middle[:, dim - 1] < 1e-9] = CONTACT
    facet_tags = dolfinx.mesh.meshtags(mesh, dim - 1, facets, tags)

    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    x = ufl.SpatialCoordinate(mesh)
    z, mu, lame = x[dim - 1], *lame_constants(1.0, poisson)
    before = ufl.conditional(ufl.lt(x[0], 0.5), 0.5 - x[0], 0.0)
    after = ufl.conditional(ufl.lt(x[0], 0.5), 0.0, x[0] - 0.5)
    components = [0.0 * z] * dim
    gap: fem.Function | None = None
    friction: Tresca | Frictionless = Frictionless()
    if kind == "lifts":
        components[-1] = -0.1 * size * z * before**2
        gap = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), name="gap")
        gap.interpolate(lambda x: 0.05 * np.maximum(x[0] - 0.5, 0.0))
    else:
        bound = 0.02
        components[0] = bound * (1.0 - 4.0 * size * before**2) / mu * z + 0.1 * size * after**3
        components[-1] = -0.1 * z
        friction = Tresca(bound)
    exact = ufl.as_vector(components)

    def stress(u: Any) -> Any:
        return 2.0 * mu * strain(u) + lame * ufl.div(u) * ufl.Identity(dim)

    def energy(u: Any) -> float:
        return norm(comm, ufl.inner(stress(u), strain(u)) * ufl.dx(metadata=metadata))

    metadata = {"quadrature_degree": 6}
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u), strain(v)) * ufl.dx
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facet_tags)
    L = ufl.inner(-ufl.div(stress(exact)), v) * ufl.dx
    L += ufl.inner(stress(exact) * ufl.FacetNormal(mesh), v) * ds(LOADED)
    held = fem.Function(V)
    held.interpolate(fem.Expression(exact, interpolation_points(V.element)))
    dofs = fem.locate_dofs_topological(V, dim - 1, facet_tags.find(HELD))
    normal = np.eye(3)[dim - 1]
    floor = RigidPlane((0.0, 0.0, 0.0), normal)
    pair = ContactPair(facet_tags, CONTACT, floor, friction, gap=gap)
    data = SimpleNamespace(error=lambda u: energy(u - exact), norm=energy(exact), exact=exact)
    return Scene(V, a, L, [fem.dirichletbc(held, dofs)], [pair], facet_tags, data=data)
