"""Motion of new nodes to the curved surfaces that facets approximate."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array, Indices, Mask, integer
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array, summed_at_nodes
from dolfinx_tresca.adapt.bisection import BisectedCells
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.geometry import Projection, project_points
from dolfinx_tresca.scene.mesh import TaggedMesh

#: Name or number of a tag -> projection to the surface that its facets approximate.
Snap: TypeAlias = Mapping[str | int, Projection]


def checked_snap(tagged_mesh: TaggedMesh, snap: Snap | None) -> dict[int, tuple[str, Projection]]:
    """Check the user's argument `snap`; return tag -> (name, projection). Not collective.

    Raises:
        InputError: the argument is not a mapping, a key is neither an integer nor the name of a
            tag, or a projection is not a function.
    """
    result: dict[int, tuple[str, Projection]] = {}
    if snap is not None and not isinstance(snap, Mapping):
        raise InputError(
            'snap must be such as {"ball": function}, from a tag of facets to a function of '
            f"points (3, n), found {shown(snap)}."
        )
    for key, projection in (snap or {}).items():
        tag = tagged_mesh.tags.get(key) if isinstance(key, str) else key
        number = integer(tag)
        if number is None:
            names = ", ".join(tagged_mesh.tags)
            raise InputError(f"snap has no tag's name: {shown(key)}; the names are {names}.")
        if not callable(projection):
            raise InputError(
                f"snap[{key!r}] must be a function of points (3, n), found {shown(projection)}."
            )
        result[number] = str(key), projection
    return result


def snapped(
    cells: BisectedCells,
    facets: Indices,
    tags: npt.NDArray[np.int32],
    snap: Mapping[int, tuple[str, Projection]],
) -> Array:
    """Return the nodes (n, 3), with nodes of facets moved to their surfaces. Collective.

    The nodes of a cell that would become flat or inverted do not move. A warning is logged, and the
    next refinement tries again, with smaller cells.

    Args:
        cells: the cells.
        facets: (m, d) nodes of tagged facets.
        tags: (m,) tags of the facets.
        snap: tag -> name, projection.

    Raises:
        InputError: a projection fails, or does not return one finite point for each node; or no
            facet has the tag of a projection.
    """
    mesh = cells.mesh
    comm, dim, index_map = mesh.comm, mesh.topology.dim, mesh.geometry.index_map()
    start = surface = mesh.geometry.x.copy()
    for tag, (name, projection) in snap.items():
        nodes = np.unique(facets[tags == tag])
        if reduce_array(comm, len(nodes)) == 0:
            raise InputError(f"snap names facets that there are not: none has the tag {name}.")
        with errors_on_all_ranks(comm):
            target = project_points(surface[nodes], f"snap[{name!r}]", projection, dim)
        # another rank may know of a node, but of none of its facets
        values = np.column_stack([target, np.ones(len(nodes))])
        sums = summed_at_nodes(index_map, nodes, values)
        surface = np.where(sums[:, 3:] > 0.0, sums[:, :3] / np.maximum(sums[:, 3:], 1.0), surface)

    held: Mask = np.zeros(len(start), dtype=np.bool_)
    points, volumes = surface, cells.volumes(start)
    while True:
        flat = np.sign(volumes) * cells.volumes(points) < 0.1 * np.abs(volumes)
        more = held.copy()
        more[cells.nodes[flat]] = True
        more = cells.on_any_rank(more)
        if reduce_array(comm, (more & ~held).sum()) == 0:
            break
        held = more
        points = np.where(held[:, None], start, surface)
    back = held & (surface != start).any(axis=1)
    count = int(reduce_array(comm, back[: index_map.size_local].sum()))
    if count:
        log(
            comm,
            "%d nodes were not moved to their curved surface, where cells would have become flat "
            "or turned inside out; a finer mesh to begin with helps there",
            count,
            level=logging.WARNING,
        )
    return np.asarray(points)
