"""Two blocks that slide on each other, with loads such that the solution is known and smooth.

Pressure, slip and the displacements of the surfaces are chosen; loads and the displacements inside
follow from the equations (a manufactured solution). Lengths in m, stresses in MPa.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactSolution, Tresca
from dolfinx_tresca._base.compat import interpolation_points
from scenes.elasticity import lame_constants, strain
from scenes.patches import block, mesh_of
from scenes.scene import Scene

#: Young's modulus [MPa] and Poisson's ratio of the upper and of the lower block.
YOUNG = (1000.0, 3000.0)
POISSON = (0.3, 0.2)

#: Tags of facets.
UPPER_CONTACT, LOWER_CONTACT, HELD, SIDES = 1, 2, 3, 4

#: Degree of quadrature for smooth functions that are not polynomials.
SMOOTH = 6


def two_blocks(comm: MPI.Comm, cell: str, divisions: tuple[int, int]) -> Any:
    """Return the mesh with the given numbers of cells along upper and lower block. Collective.

    The blocks have the height 1/2, and touch where the last coordinate is 0.
    """
    sides = [(0.0, 1.0)] * (1 if cell in ("triangle", "quadrilateral") else 2)
    (x, upper), (y, lower) = (
        block(cell, (n, math.ceil(n / 2)), [*sides, heights], 0.0, 0)
        for n, heights in zip(divisions, ((0.0, 0.5), (-0.5, 0.0)), strict=True)
    )
    return mesh_of(comm, cell, 1, np.concatenate([x, y]), np.concatenate([upper, lower + len(x)]))


def facet_tags(mesh: Any) -> Any:
    """Return the tags of all facets on the boundary. Not collective."""
    dim = mesh.topology.dim
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(dim - 1, dim)
    cells = to_cell.array[to_cell.offsets[facets]]
    height = dolfinx.mesh.compute_midpoints(mesh, dim - 1, facets)[:, dim - 1]
    above = dolfinx.mesh.compute_midpoints(mesh, dim, cells)[:, dim - 1] > 0.0
    tags = np.full(len(facets), SIDES, dtype=np.int32)
    tags[np.abs(np.abs(height) - 0.5) < 1e-9] = HELD
    touching = np.abs(height) < 1e-9
    tags[touching & above] = UPPER_CONTACT
    tags[touching & ~above] = LOWER_CONTACT
    return dolfinx.mesh.meshtags(mesh, dim - 1, facets, tags)


class Exact:
    """The exact solution in terms of coordinates x: UFL expressions."""

    def __init__(self, x: Any, dim: int) -> None:
        self._x, self._dim = x, dim
        self._along = [x[i] for i in range(dim - 1)]

    @property
    def pressure(self) -> Any:
        """Pressure [MPa], everywhere positive."""
        return 1.0 + 0.2 * sum(ufl.cos(2.0 * x + 1.0) for x in self._along)

    @property
    def bound(self) -> Any:
        """Slip bound [MPa]."""
        return 0.3 + 0.1 * ufl.sin(2.0 * self._along[0])

    @property
    def traction(self) -> list[Any]:
        """Tangential components of lambda_tau [MPa]; everywhere at the bound."""
        if self._dim == 2:
            return [self.bound]
        turn = 0.4 * self._along[0] + 0.6 * self._along[1]
        return [self.bound * ufl.cos(turn), self.bound * ufl.sin(turn)]

    @property
    def slip(self) -> list[Any]:
        """Tangential components of the slip [m]: along the traction."""
        size = 2e-3 * (1.0 + 0.5 * ufl.cos(1.5 * self._along[0] + 0.2))
        return [size * t for t in self.traction]

    def displacement(self, body: int) -> Any:
        """Displacement [m] of the upper (0) or lower (1) body: linear in the height.

        Its slope is such that the stress vector on the contact is pressure and traction.
        """
        x, last = self._x, self._dim - 1
        mu, lame = lame_constants(YOUNG[body], POISSON[body])
        surface = [
            1e-3 * ufl.sin(1.5 * a + 0.5 * b + 0.3)
            for a, b in zip(self._along, self._along[::-1], strict=True)
        ]
        if body == 0:
            surface = [u + s for u, s in zip(surface, self.slip, strict=True)]
        height = -2e-3 + 5e-4 * sum(ufl.cos(1.8 * a - 0.4) for a in self._along)

        def along(f: Any, i: int) -> Any:
            return ufl.grad(f)[i]

        stretch = sum(along(u, i) for i, u in enumerate(surface))
        rise = -(self.pressure + lame * stretch) / (2 * mu + lame)
        shear = [t / mu - along(height, i) for i, t in enumerate(self.traction)]
        tangential = [u + x[last] * s for u, s in zip(surface, shear, strict=True)]
        return ufl.as_vector([*tangential, height + x[last] * rise])


def stress(u: Any, mu: Any, lame: Any) -> Any:
    """Return the stress [MPa] of a displacement."""
    return 2 * mu * strain(u) + lame * ufl.tr(strain(u)) * ufl.Identity(u.ufl_shape[0])


def blocks_scene(comm: MPI.Comm, cell: str, degree: int, divisions: tuple[int, int]) -> Scene:
    """Return the blocks with the loads of the exact solution. Collective.

    `data.exact` is the exact displacement; the function `data.energy` returns the form of twice the
    energy of a displacement.
    """
    mesh = two_blocks(comm, cell, divisions)
    tags, dim = facet_tags(mesh), mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    upper = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    upper.interpolate(lambda x: (x[dim - 1] > 0.0).astype(float))

    def of_body(values: Sequence[Any]) -> Any:
        return upper * values[0] + (1 - upper) * values[1]

    mu, lame = lame_constants(of_body(YOUNG), of_body(POISSON))
    found = Exact(ufl.SpatialCoordinate(mesh), dim)
    bodies = [found.displacement(body) for body in (0, 1)]
    exact = of_body(bodies)
    stresses = [
        stress(u, *lame_constants(YOUNG[body], POISSON[body])) for body, u in enumerate(bodies)
    ]

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u, mu, lame), ufl.grad(v)) * ufl.dx
    metadata = {"quadrature_degree": SMOOTH}
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags, metadata=metadata)
    load = -of_body([ufl.div(s) for s in stresses])
    on_sides = ufl.dot(of_body(stresses), ufl.FacetNormal(mesh))
    L = ufl.inner(load, v) * ufl.dx(metadata=metadata) + ufl.inner(on_sides, v) * ds(SIDES)

    held = fem.Function(V)
    held.interpolate(fem.Expression(exact, interpolation_points(V.element)))
    dofs = fem.locate_dofs_topological(V, dim - 1, tags.find(HELD))
    pair = ContactPair(
        tags,
        UPPER_CONTACT,
        LOWER_CONTACT,
        Tresca(lambda x: 0.3 + 0.1 * np.sin(2.0 * x[0])),
        pairing="mortar",
    )

    def energy(w: Any) -> Any:
        return ufl.inner(stress(w, mu, lame), ufl.grad(w)) * ufl.dx(metadata=metadata)

    data = SimpleNamespace(exact=exact, energy=energy)
    return Scene(V, a, L, [fem.dirichletbc(held, dofs)], [pair], tags, data=data)


def norm(comm: MPI.Comm, form: Any) -> float:
    """Return the root of an integral over all ranks. Collective."""
    return math.sqrt(comm.allreduce(fem.assemble_scalar(fem.form(form))))


def errors_of(scene: Scene, solution: ContactSolution) -> dict[str, float]:
    """Return the relative errors. Collective."""
    comm, surface = scene.mesh.comm, solution.surface
    dim = scene.mesh.geometry.dim
    exact = Exact(ufl.SpatialCoordinate(surface.mesh), dim)
    slip = ufl.as_vector([*exact.slip, 0.0])
    dx = ufl.Measure("dx", domain=surface.mesh, metadata={"quadrature_degree": SMOOTH})

    def relative(found: Any, wanted: Any) -> float:
        return norm(comm, ufl.inner(found - wanted, found - wanted) * dx) / norm(
            comm, ufl.inner(wanted, wanted) * dx
        )

    energy = norm(comm, scene.data.energy(solution.u - scene.data.exact))
    return {
        "energy": energy / norm(comm, scene.data.energy(scene.data.exact)),
        "pressure": relative(surface.pressure, exact.pressure),
        "slip": relative(surface.slip, slip),
    }
