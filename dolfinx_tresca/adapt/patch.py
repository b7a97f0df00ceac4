"""Refinement of a mesh whose cells are too large for the patch of a goal."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_tresca._base.arrays import Array, LocalNumbers
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.adapt.refinement import refine
from dolfinx_tresca.adapt.snapping import Snap
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.scene.goal import Goal, MeanPressure, MeanSlip
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.status import AdaptiveStatus

#: Size of facets, relative to the radius of a patch, below which the facets follow the curved
#: surface so closely that smaller cells bring no node into the patch.
FLAT = 0.1

#: Difference of distances, relative to the size of facets, that counts as rounding: facets whose
#: distances differ less are cut together, on any number of ranks.
TIE = 1e-9


def with_node_in_patch(
    problem: ContactProblem, tagged_mesh: TaggedMesh, goal: Goal, snap: Snap | None, max_dofs: float
) -> TaggedMesh:
    """Return a mesh with smaller cells if the patch of a goal has no contact node. Collective.

    Without a contact node in its patch the goal has no value. In this case the edges of the cells
    next to the middle of the patch are halved; otherwise the mesh itself is returned. The patch may
    have no node on the new mesh either: call the function again with a problem on the new mesh.

    Args:
        problem: the problem on the mesh.
        tagged_mesh: the mesh.
        goal: the goal of the refinement.
        snap: see `refine`.
        max_dofs: limit for the unknowns of a mesh.

    Raises:
        InputError: smaller cells bring no node into the patch, or there are more than `max_dofs`
            unknowns.
    """
    if not isinstance(goal, MeanPressure | MeanSlip):
        return tagged_mesh
    mesh, pair = tagged_mesh.mesh, problem.pairs[goal.pair]
    dim, comm = mesh.topology.dim, mesh.comm
    middle = np.append(np.asarray(goal.point, dtype=np.float64), np.zeros(3 - dim))
    away = np.linalg.norm(problem.operators[goal.pair].points - middle, axis=1)
    if comm.allreduce(bool((away < goal.radius).any()), op=MPI.LOR):
        return tagged_mesh

    facets = pair.facet_tags.find(pair.secondary)
    mesh.topology.create_connectivity(dim - 1, dim)
    sizes, distances = _measured(mesh, facets, middle)
    nearest = float(reduce_array(comm, distances.min(initial=np.inf), MPI.MIN))
    near = distances <= nearest + TIE * sizes
    size = float(reduce_array(comm, sizes[near].max(initial=0.0), MPI.MAX))
    if problem.free_dofs > max_dofs:
        reason = f"{AdaptiveStatus.MAX_DOFS.value} before smaller cells there have one"
    elif size < max(nearest - goal.radius, FLAT * goal.radius):
        reason = (
            f"the facets next to its point are {nearest:.3g} away and have an edge of {size:.3g}"
        )
    else:
        to_cells = mesh.topology.connectivity(dim - 1, dim)
        marked = np.zeros(mesh.topology.index_map(dim).size_local)
        cells = np.array([to_cells.links(facet)[0] for facet in facets[near]], dtype=np.int64)
        marked[cells[cells < len(marked)]] = 1.0
        return refine(tagged_mesh, marked, 1.0, snap)
    raise InputError(
        f"the patch of the goal has no contact node within {goal.radius:.3g} of its point, and "
        f"{reason}. Take a larger radius, or a point on the secondary side that faces the other."
    )


def _measured(mesh: dolfinx.mesh.Mesh, facets: LocalNumbers, point: Array) -> tuple[Array, Array]:
    """Return the longest edges (n,) of facets, and their distances from a point. Not collective."""
    if len(facets) == 0:  # DOLFINx 0.9 divides by this number
        return np.zeros(0), np.zeros(0)
    dim = mesh.topology.dim - 1
    corners = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, dim, facets)]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    points = np.tile(point, (len(facets), 1))
    squares = dolfinx.geometry.squared_distance(mesh, dim, facets, points)
    return np.asarray(edges.max(axis=1)), np.sqrt(squares)
