"""Pairing of surfaces where a displacement has brought them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dolfinx import fem

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.compat import geometry_degree, geometry_dofmap
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.offsets import surface_offsets


def as_geometry(u: fem.Function) -> fem.Function:
    """Return a displacement as far as the mesh can follow: of the degree of its geometry."""
    mesh = u.function_space.mesh
    dim = mesh.geometry.dim
    space = fem.functionspace(mesh, ("Lagrange", geometry_degree(mesh), (dim,)))
    moves = fem.Function(space)
    moves.interpolate(u)
    return moves


@contextmanager
def moved_mesh(moves: fem.Function) -> Iterator[None]:
    """Move the nodes of a mesh by a displacement of its geometry's degree; then put them back."""
    mesh = moves.function_space.mesh
    dim, x = mesh.geometry.dim, mesh.geometry.x
    before = x.copy()
    values = moves.x.array.reshape(-1, dim)
    x[geometry_dofmap(mesh), :dim] += values[moves.function_space.dofmap.list]
    try:
        yield
    finally:
        x[:] = before


def pair_moved_surfaces(u: fem.Function, prescribed: Mask, pair: ContactPair) -> PairOperators:
    """Return N, T and the gap of a pair after a displacement: that about which gaps are small.

    The gap is that of the moved surfaces: N u is still to be added to it. Collective.

    Args:
        u: displacement [length], with ghosts.
        prescribed: (owned dofs,) those with a Dirichlet condition.
        pair: the surfaces.

    Raises:
        PairingError: the moved surfaces cannot be paired.
    """
    offsets = surface_offsets(u.function_space, prescribed, pair)
    with moved_mesh(as_geometry(u)):
        return pair_surfaces(u.function_space, prescribed, pair, offsets)
