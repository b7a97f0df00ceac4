"""Differences between DOLFINx 0.9, 0.10 and 0.11; features are detected once, at import."""

from __future__ import annotations

from typing import Any, TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.mesh

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca.errors import ContactError

# DOLFINx 0.10 renamed io.gmshio to io.gmsh, and its model_to_mesh returns a record, not a 3-tuple.
try:
    import dolfinx.io.gmsh as _gmsh_reader
except ImportError:
    import dolfinx.io.gmshio as _gmsh_reader


def require_real_petsc() -> None:
    """Check that PETSc was built with real scalars."""
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise ContactError(
            f"contact needs PETSc with real scalars, found {np.dtype(PETSc.ScalarType)}. "
            "Take the real build: pip install dolfinx-solver-real from PyPI, PETSC_ARCH or "
            "PETSC_DIR on Debian, 'petsc=*=real*' with conda, dolfinx-real-mode in the container."
        )


def model_to_mesh(model: Any, comm: MPI.Comm, rank: int) -> tuple[Any, Any, Any]:
    """Distribute the Gmsh model of one rank; return mesh, cell tags and facet tags. Collective."""
    # DOLFINx' default is gdim=3, even for plane models
    dim = comm.bcast(model.getDimension() if comm.rank == rank else None, root=rank)
    return tuple(_gmsh_reader.model_to_mesh(model, comm, rank, gdim=dim)[:3])


# The partitioner of DOLFINx 0.11 has a further argument: the largest number of cells at a facet.
try:
    dolfinx.mesh.create_cell_partitioner(dolfinx.mesh.GhostMode.none)
    _CELLS_AT_FACET: tuple[int, ...] = ()
except TypeError:
    _CELLS_AT_FACET = (2,)


def create_mesh(comm: MPI.Comm, cells: Any, x: Any, domain: Any, ghosts: bool) -> Any:
    """Distribute cells over the ranks, with or without ghosts, and return the mesh. Collective.

    This rank contributes cells (n, k) and coordinates x; `domain` has the element of coordinates.
    """
    mode = dolfinx.mesh.GhostMode.shared_facet if ghosts else dolfinx.mesh.GhostMode.none
    partitioner = dolfinx.mesh.create_cell_partitioner(mode, *_CELLS_AT_FACET)
    return dolfinx.mesh.create_mesh(comm, cells=cells, x=x, e=domain, partitioner=partitioner)


#: Type of the argument `entity_maps` of `fem.form`: a dict in 0.9, a list of EntityMap since 0.10.
EntityMaps: TypeAlias = "dict[Any, LocalNumbers] | list[Any]"


def create_submesh(
    mesh: Any, dim: int, entities: LocalNumbers
) -> tuple[Any, LocalNumbers, EntityMaps]:
    """Return a submesh, the mesh's number of each of its geometry nodes, and maps for forms."""
    submesh, cells, _, nodes = dolfinx.mesh.create_submesh(mesh, dim, entities)
    if not isinstance(cells, np.ndarray):  # an EntityMap, since DOLFINx 0.10
        return submesh, nodes, [cells]
    index_map = mesh.topology.index_map(dim)
    inverse = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int32)
    inverse[cells] = np.arange(len(cells), dtype=np.int32)
    return submesh, nodes, {submesh: inverse}


def owned_dofs(bc: Any, owned: int) -> Any:
    """Return the degrees of freedom (n,) of this rank that a condition prescribes. Not collective.

    The rank owns the first `owned` ones; its ghosts are left out, which DOLFINx 0.9 may count too.
    """
    dofs = bc.dof_indices()[0]
    return dofs[dofs < owned]


def same_topology(given: Any, mesh: Any) -> bool:
    """Return whether tags, or a mesh in another Python wrapper, have the topology of a mesh."""
    # since DOLFINx 0.10 some topologies have a wrapper
    left, right = (getattr(t, "_cpp_object", t) for t in (given.topology, mesh.topology))
    return left is right


def with_values(tags: Any, values: LocalNumbers) -> Any:
    """Return MeshTags of the same entities with the given values (n,)."""
    topology = getattr(tags.topology, "_cpp_object", tags.topology)
    return dolfinx.mesh.MeshTags(type(tags._cpp_object)(topology, tags.dim, tags.indices, values))


def contains(V: Any, bc: Any) -> bool:
    """Return whether a Dirichlet condition is on V or on a subspace of V."""
    space = bc.function_space  # a C++ object in 0.9
    return bool(V._cpp_object.contains(getattr(space, "_cpp_object", space)))


# DOLFINx 0.11 deprecates `dofmap` in favour of `dofmaps`, one for each type of cell.
_HAS_DOFMAPS = isinstance(getattr(dolfinx.mesh.Geometry, "dofmaps", None), property)


def geometry_dofmap(mesh: Any) -> LocalNumbers:
    """Return the geometry nodes (cells, k) of each cell on this rank, ghosts included."""
    return np.asarray(mesh.geometry.dofmaps[0] if _HAS_DOFMAPS else mesh.geometry.dofmap)


def collapse(space: Any) -> tuple[Any, LocalNumbers]:
    """Return the collapsed copy of a subspace, and its degrees of freedom in the parent space."""
    V, dofs = space.collapse()  # in 0.11 dofs is a list of arrays, one for each type of cell
    return V, np.asarray(dofs, dtype=np.int32).ravel()


def geometry_degree(mesh: Any) -> int:
    """Return the polynomial degree of a mesh's geometry."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if _HAS_DOFMAPS else geometry.cmap).degree)


def interpolation_points(element: Any) -> Array:
    """Return the reference points (k, dim) of an element's degrees of freedom."""
    points = element.interpolation_points  # a method in 0.9, a property since 0.10
    return np.asarray(points() if callable(points) else points)
