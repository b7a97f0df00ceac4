"""What differs between DOLFINx 0.9, 0.10 and 0.11, decided once, at import, by feature."""

from __future__ import annotations

from typing import Any, TypeAlias

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx
import dolfinx.mesh
from dolfinx.cpp.fem import DirichletBC_float64

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca.errors import ContactError

# 0.10 renamed io.gmshio to io.gmsh, and the function returns a record in place of a 3-tuple.
try:
    import dolfinx.io.gmsh as _gmsh_reader
except ImportError:
    import dolfinx.io.gmshio as _gmsh_reader

has_adios2: bool = bool(getattr(dolfinx, "has_adios2", False))


def require_real_petsc() -> None:
    """Check that PETSc was built with real scalars.

    Raises:
        ContactError: it was built with complex ones.
    """
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise ContactError(
            f"contact needs PETSc with real scalars, found {np.dtype(PETSc.ScalarType)}. "
            "Take the real build: pip install dolfinx-solver-real from PyPI, PETSC_ARCH or "
            "PETSC_DIR on Debian, 'petsc=*=real*' with conda, dolfinx-real-mode in the container."
        )


def model_to_mesh(model: Any, comm: MPI.Comm, rank: int) -> tuple[Any, Any, Any]:
    """Distribute the current Gmsh model of `rank`: mesh, cell tags, facet tags."""
    # the default is 3, also for models of the plane
    dim = comm.bcast(model.getDimension() if comm.rank == rank else None, root=rank)
    read = _gmsh_reader.model_to_mesh(model, comm, rank, gdim=dim)
    return (
        (read[0], read[1], read[2])
        if isinstance(read, tuple)
        else (read.mesh, read.cell_tags, read.facet_tags)
    )


# 0.11 wants the largest number of cells at a facet.
try:
    dolfinx.mesh.create_cell_partitioner(dolfinx.mesh.GhostMode.none)
    _CELLS_AT_FACET: tuple[int, ...] = ()
except TypeError:
    _CELLS_AT_FACET = (2,)


def create_mesh(comm: MPI.Comm, cells: Any, x: Any, domain: Any, ghosts: bool) -> Any:
    """Return a mesh, distributed anew, with cells of other ranks at facets or without."""
    mode = dolfinx.mesh.GhostMode.shared_facet if ghosts else dolfinx.mesh.GhostMode.none
    partitioner = dolfinx.mesh.create_cell_partitioner(mode, *_CELLS_AT_FACET)
    return dolfinx.mesh.create_mesh(comm, cells=cells, x=x, e=domain, partitioner=partitioner)


#: What `fem.form` takes as `entity_maps`: in 0.9 a dict, from 0.10 on a list of EntityMap.
EntityMaps: TypeAlias = "dict[Any, LocalNumbers] | list[Any]"


def create_submesh(
    mesh: Any, dim: int, entities: LocalNumbers
) -> tuple[Any, LocalNumbers, EntityMaps]:
    """Return the mesh of `entities`, for each of its geometry nodes the parent's node, and its map.

    The last is what forms of the parent need where they hold Functions on the submesh.
    """
    submesh, cells, _, nodes = dolfinx.mesh.create_submesh(mesh, dim, entities)
    if not isinstance(cells, np.ndarray):
        return submesh, nodes, [cells]
    index_map = mesh.topology.index_map(dim)
    inverse = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int32)
    inverse[cells] = np.arange(len(cells), dtype=np.int32)
    return submesh, nodes, {submesh: inverse}


def maps_mesh(entity_maps: EntityMaps, mesh: Any) -> bool:
    """Whether maps lead to the cells of a mesh."""
    if isinstance(entity_maps, dict):
        return any(known._cpp_object is mesh._cpp_object for known in entity_maps)
    topology = mesh.topology
    return any(
        _same(topology, side) for one in entity_maps for side in (one.topology, one.sub_topology)
    )


def same_topology(tags: Any, mesh: Any) -> bool:
    """Whether tags belong to a mesh. 0.10 wraps topologies in Python, but not those of all tags."""
    return _same(tags.topology, mesh.topology)


def _same(first: Any, second: Any) -> bool:
    return getattr(first, "_cpp_object", first) is getattr(second, "_cpp_object", second)


def contains(V: Any, bc: Any) -> bool:
    """Whether a Dirichlet condition is on V or on a subspace of it. 0.9 gives the space in C++."""
    space = bc.function_space
    return bool(V._cpp_object.contains(getattr(space, "_cpp_object", space)))


def is_float64(bc: Any) -> bool:
    """Whether the values of a Dirichlet condition are of type float64; all versions wrap C++."""
    return isinstance(bc._cpp_object, DirichletBC_float64)


# 0.11 deprecates `dofmap`, of which meshes of several cell types have more than one.
_HAS_DOFMAPS = isinstance(getattr(dolfinx.mesh.Geometry, "dofmaps", None), property)


def geometry_dofmap(mesh: Any) -> LocalNumbers:
    """Return the geometry nodes of each cell on this rank."""
    dofmap: LocalNumbers = mesh.geometry.dofmaps[0] if _HAS_DOFMAPS else mesh.geometry.dofmap
    return dofmap


def collapse(space: Any) -> tuple[Any, LocalNumbers]:
    """Return a sub-space by itself, and where its degrees of freedom are in the whole space.

    0.11 has a list of such arrays, one for each type of cells.
    """
    V, dofs = space.collapse()
    return V, np.asarray(dofs, dtype=np.int32).ravel()


def geometry_degree(mesh: Any) -> int:
    """Return the degree of a mesh's geometry."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if _HAS_DOFMAPS else geometry.cmap).degree)


def interpolation_points(element: Any) -> Array:
    """Return the reference points of an element's degrees of freedom. 0.10 made it a property."""
    points = element.interpolation_points
    result: Array = points() if callable(points) else points
    return result
