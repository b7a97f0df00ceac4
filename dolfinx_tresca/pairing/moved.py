"""Pairing of surfaces in a displaced configuration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dolfinx import fem

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.compat import geometry_degree, geometry_dofmap
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.undeformed import Undeformed
from dolfinx_tresca.scene.pair import ContactPair


def interpolate_in_geometry(u: fem.Function) -> fem.Function:
    """Interpolate a displacement in the Lagrange space of the mesh's geometry, for `moved_mesh`.

    The result is u itself if u is in this space.
    """
    mesh = u.function_space.mesh
    dim = mesh.geometry.dim
    if u.function_space.element.basix_element.degree == geometry_degree(mesh):
        return u
    space = fem.functionspace(mesh, ("Lagrange", geometry_degree(mesh), (dim,)))
    result = fem.Function(space)
    result.interpolate(u)
    return result


@contextmanager
def moved_mesh(u: fem.Function) -> Iterator[None]:
    """Displace the nodes of a mesh within a `with` block; u is from `interpolate_in_geometry`."""
    mesh = u.function_space.mesh
    dim, x = mesh.geometry.dim, mesh.geometry.x
    before = x.copy()
    values = u.x.array.reshape(-1, dim)
    x[geometry_dofmap(mesh), :dim] += values[u.function_space.dofmap.list]
    try:
        yield
    finally:
        x[:] = before


def pair_moved_surfaces(
    u: fem.Function,
    prescribed: Mask,
    pair: ContactPair,
    axisymmetric: bool,
    in_geometry: fem.Function | None = None,
) -> PairOperators:
    """Compute N, T and the gap of a pair in the configuration displaced by u. Collective.

    The gap is the distance of the moved surfaces; the gap of the reference configuration for the
    same N is this gap plus N u.

    Args:
        u: displacement [length], with up-to-date ghosts.
        prescribed: (owned dofs,) whether a Dirichlet condition prescribes the degree of freedom.
        pair: the contact pair.
        axisymmetric: see `pair_surfaces`.
        in_geometry: `interpolate_in_geometry(u)`, if it is known.

    Raises:
        PairingError: the moved surfaces cannot be paired.
        InputError: see `pair_surfaces`.
    """
    V = u.function_space
    undeformed = Undeformed.of(V, prescribed, pair)
    with moved_mesh(interpolate_in_geometry(u) if in_geometry is None else in_geometry):
        return pair_surfaces(V, prescribed, pair, undeformed, axisymmetric=axisymmetric)
