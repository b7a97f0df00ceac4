"""Two blocks whose meshes do not match, one on the other: the scenes of the patch tests.

Before they are moved the lower block is the unit square or cube and the upper one stands on it.
Both are pressed along the last axis, and their sides are free: the stress is the same everywhere,
so the exact displacement is in every space. Only the outer ends are held: all components of their
displacement have the exact values. So the scene does not depend on the axes, and may be turned,
mirrored, moved and scaled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import basix
import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Frictionless
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.scene.pair import Pairing
from scenes.elasticity import elasticity, no_load
from scenes.scene import Scene

KINDS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")

#: Tags of facets: the two contact faces, the held ends, and the sides (where the first, and in 3D
#: the second coordinate is least).
UPPER, LOWER, TOP, BOTTOM, SIDES = 1, 2, 3, 4, (5, 6)

#: Tags of cells.
UPPER_BLOCK, LOWER_BLOCK = 1, 2

POISSON = 0.3

#: Points (n, dim) -> (n,) bool.
Where: TypeAlias = Callable[[np.ndarray], np.ndarray]

# order of the nodes of a cell that gives the mirrored cell
_MIRRORED = {
    "triangle": [0, 2, 1],
    "quadrilateral": [0, 2, 1, 3],
    "tetrahedron": [0, 2, 1, 3],
    "hexahedron": [0, 2, 1, 3, 4, 6, 5, 7],
}

# corners of simplices in a square or cube with corners in basix' order
_TRIANGLES = ([0, 1, 3], [0, 3, 2])
_TETRAHEDRA = (
    [0, 1, 3, 7], [0, 1, 7, 5], [0, 5, 7, 4], [0, 3, 2, 7], [0, 6, 4, 7], [0, 2, 6, 7]
)  # fmt: skip


def dim_of(kind: str) -> int:
    """Return the dimension of cells of a kind."""
    return 2 if kind in KINDS[:2] else 3


def patch(
    comm: MPI.Comm,
    kind: str,
    degree: int = 1,
    *,
    upper: tuple[int, int] = (3, 2),
    lower: tuple[int, int] = (4, 3),
    distort: float = 0.3,
    span: Sequence[tuple[float, float]] | None = None,
    gap: float = 0.0,
    turn: np.ndarray | None = None,
    shift: Sequence[float] = (0.0, 0.0, 0.0),
    scale: float = 1.0,
    warp: Callable[[np.ndarray], np.ndarray] | None = None,
    geometry: int = 1,
    young: tuple[float, float] = (1000.0, 1000.0),
    pressure: float = 2.5,
    friction: Friction | None = None,
    pairing: Pairing = "auto",
    search_distance: float | None = None,
    symmetry: bool = False,
    split: bool = False,
    reverse: bool = False,
    merge: Where | None = None,
    tear: Where | None = None,
) -> Scene:
    """Return the scene of two blocks. Collective.

    Args:
        comm: communicator of the mesh.
        kind: type of the cells, see `KINDS`.
        degree: degree of the displacement.
        upper: divisions of the upper block along each axis but the last, and along the last axis.
        lower: divisions of the lower block, in the same way.
        distort: largest shift of inner nodes across the last axis, divided by half a cell.
        span: start and end of the upper block along each axis but the last; None: 0 and 1.
        gap: distance of the blocks before they are pressed.
        turn: orthogonal matrix (dim, dim) that turns or mirrors the scene.
        shift: vector (3,) that is added to all points after the turn.
        scale: factor of the whole scene, applied before the shift.
        warp: map of points (n, 3), applied last; exact values stay those of the flat scene.
        geometry: degree of the geometry.
        young: Young's moduli of the upper and the lower block.
        pressure: pressure between the blocks.
        friction: law of friction of the pair; None: frictionless.
        pairing: see `ContactPair`.
        search_distance: see `ContactPair`.
        symmetry: whether the sides are also held along their normals; for scenes without a turn.
        split: whether each rank passes a part of cells and points to DOLFINx, or rank 0 all.
        reverse: whether every other cell has its nodes in mirrored order.
        merge: selects the points (n, dim) at the interface that both blocks share; for blocks with
            the same divisions, without a gap.
        tear: selects cells of the upper block, by their midpoints (n, dim), that share no nodes
            with the other cells.

    Returns:
        The scene, with the tags above; the upper block is the secondary side. `data` has

        exact: displacement without friction; with friction too if both moduli are the same.
        pressure: exact contact pressure; None if it is not the same everywhere.
        overlap: area that both contact faces have in common.
        move: function that maps points (n, 3) of the blocks described above to points of the mesh.
        axis: (3,) the last axis after the turn; the upper block presses against this direction.
    """
    dim = dim_of(kind)
    span = [(0.0, 1.0)] * (dim - 1) if span is None else list(span)
    R = np.eye(3)
    if turn is not None:
        R[:dim, :dim] = turn
    blocks = [
        block(kind, upper, [*span, (1.0 + gap, 2.0 + gap)], distort, 1),
        block(kind, lower, [*[(0.0, 1.0)] * (dim - 1), (0.0, 1.0)], distort, 2),
    ]
    if tear is not None:
        blocks[0] = _torn(*blocks[0], tear)
    if geometry > 1:
        blocks = [raised(kind, geometry, *one) for one in blocks]
    points, cells = _together(blocks, merge)
    if reverse:
        cells[::2] = cells[::2][:, _MIRRORED[kind]]
    mesh = mesh_of(comm, kind, geometry, points, cells, split)
    cell_tags, facet_tags = _tags(mesh, gap, [start for start, _ in span])
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    exact = _exact(V, cell_tags, gap, young, pressure)

    def move(points: np.ndarray) -> np.ndarray:
        return scale * np.asarray(points) @ R.T + np.asarray(shift)

    mesh.geometry.x[:] = move(mesh.geometry.x)
    if warp is not None:
        mesh.geometry.x[:] = warp(mesh.geometry.x.copy())
    values = exact.x.array.reshape(-1, dim)
    values[:] = scale * values @ R[:dim, :dim].T

    bcs = [_held(V, facet_tags, tag, exact) for tag in (TOP, BOTTOM)]
    if symmetry:
        assert turn is None
        bcs += [_held_across(V, facet_tags, SIDES[i], i, exact) for i in range(dim - 1)]
    E = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    E.x.array[cell_tags.find(UPPER_BLOCK)] = young[0]
    E.x.array[cell_tags.find(LOWER_BLOCK)] = young[1]
    common = [max(min(end, 1.0) - max(start, 0.0), 0.0) for start, end in span]
    uniform = warp is None and span == [(0.0, 1.0)] * (dim - 1)
    pair = ContactPair(
        facet_tags, UPPER, LOWER, friction or Frictionless(), pairing, search_distance
    )
    data = SimpleNamespace(
        exact=exact,
        pressure=pressure if uniform else None,
        overlap=float(np.prod(common)) * scale ** (dim - 1),
        move=move,
        axis=R[:, dim - 1],
    )
    a, L = elasticity(V, E, POISSON), no_load(V)
    return Scene(V, a, L, bcs, [pair], facet_tags, cell_tags, data=data)


def block(
    kind: str,
    divisions: tuple[int, int],
    box: Sequence[tuple[float, float]],
    distort: float,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, dim) and cells of a box whose inner nodes are shifted at random."""
    dim = len(box)
    numbers = [divisions[0]] * (dim - 1) + [divisions[1]]
    axes = [np.linspace(*ends, n + 1) for ends, n in zip(box, numbers, strict=True)]
    grid = list(np.meshgrid(*axes, indexing="ij"))
    # the same shift along the whole of the last axis: faces stay flat
    rng = np.random.default_rng(seed)
    for i in range(dim - 1):
        amount = np.zeros(grid[i].shape)
        inside = (slice(1, -1),) * (dim - 1)
        cell = (box[i][1] - box[i][0]) / divisions[0]
        amount[inside] = rng.uniform(-0.5, 0.5, (divisions[0] - 1,) * (dim - 1))[..., None]
        grid[i] = grid[i] + distort * cell * amount
    number = np.arange(grid[0].size).reshape(grid[0].shape)
    corners = [
        number[tuple(slice(k, k + n) for k, n in zip(corner[::-1], numbers, strict=True))].ravel()
        for corner in np.ndindex((2,) * dim)  # the first axis runs fastest
    ]
    cells = np.stack(corners, axis=1)
    parts = {"triangle": _TRIANGLES, "tetrahedron": _TETRAHEDRA}.get(kind)
    if parts is not None:
        cells = np.concatenate([cells[:, part] for part in parts])
    return np.stack([x.ravel() for x in grid], axis=1), cells


def _torn(points: np.ndarray, cells: np.ndarray, tear: Where) -> tuple[np.ndarray, np.ndarray]:
    """Return points and cells; the cells that `tear` selects share no nodes with others."""
    apart = tear(points[cells].mean(axis=1))
    return np.concatenate([points, points]), np.where(apart[:, None], cells + len(points), cells)


def _together(
    blocks: Sequence[tuple[np.ndarray, np.ndarray]], merge: Where | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return points and cells of both blocks, with merged points and without unused points."""
    (points, cells), (lower_points, lower_cells) = blocks
    number = len(points) + np.arange(len(lower_points))
    if merge is not None:
        first, second = (
            np.flatnonzero(np.isclose(x[:, -1], 1.0) & merge(x)) for x in (points, lower_points)
        )
        first = first[np.lexsort(np.round(points[first], 9).T)]
        second = second[np.lexsort(np.round(lower_points[second], 9).T)]
        number[second] = first
    points = np.concatenate([points, lower_points])
    cells = np.concatenate([cells, number[lower_cells]])
    used, cells_of_used = np.unique(cells, return_inverse=True)
    return points[used], cells_of_used.reshape(cells.shape).astype(np.int64)


def mesh_of(
    comm: MPI.Comm,
    kind: str,
    geometry: int,
    x: np.ndarray,
    cells: np.ndarray,
    split: bool = False,
) -> Any:
    """Return the mesh of points (n, dim) and cells, the same on all ranks. Collective."""
    dim = x.shape[1]
    if split:
        x, cells = np.array_split(x, comm.size)[comm.rank], cells[comm.rank :: comm.size]
    elif comm.rank > 0:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", kind, geometry, shape=(dim,))
    mesh = dolfinx.mesh.create_mesh(
        comm=comm, cells=np.ascontiguousarray(cells), x=x, e=ufl.Mesh(element)
    )
    for first, second in ((dim - 1, dim), (dim, dim - 1)):
        mesh.topology.create_connectivity(first, second)
    return mesh


def raised(
    kind: str, degree: int, points: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return points and cells with the nodes of a higher degree."""
    cell, family = basix.CellType[kind], basix.ElementFamily.P
    high = basix.create_element(family, cell, degree, basix.LagrangeVariant.gll_warped)
    linear = basix.create_element(family, cell, 1, basix.LagrangeVariant.gll_warped)
    all_points = np.einsum("qc,nci->nqi", linear.tabulate(0, high.points)[0, ..., 0], points[cells])
    _, first, position = np.unique(
        np.round(all_points.reshape(-1, points.shape[1]), 9),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    unique = all_points.reshape(-1, points.shape[1])[first]
    return unique, position.reshape(len(cells), -1)


def _tags(mesh: Any, gap: float, start: Sequence[float]) -> tuple[Any, Any]:
    """Return tags of the cells and facets of a mesh that is not moved yet. Not collective."""
    dim = mesh.topology.dim
    index_map = mesh.topology.index_map(dim)
    cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    middle = dolfinx.mesh.compute_midpoints(mesh, dim, cells)
    block = np.where(middle[:, dim - 1] > 1.0 + 0.5 * gap, UPPER_BLOCK, LOWER_BLOCK)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(dim - 1, dim)
    upper = block[to_cell.array[to_cell.offsets[facets]]] == UPPER_BLOCK
    x = dolfinx.mesh.compute_midpoints(mesh, dim - 1, facets).reshape(-1, 3)
    value = np.zeros(len(facets), dtype=np.int32)
    for i, tag in enumerate(SIDES[: dim - 1]):
        value[np.isclose(x[:, i], np.where(upper, start[i], 0.0))] = tag
    z = x[:, dim - 1]
    value[np.isclose(z, 1.0 + gap) & upper] = UPPER
    value[np.isclose(z, 1.0) & ~upper] = LOWER
    value[np.isclose(z, 2.0 + gap) & upper] = TOP
    value[np.isclose(z, 0.0) & ~upper] = BOTTOM
    some = np.flatnonzero(value)
    some = some[np.argsort(facets[some])]
    return (
        dolfinx.mesh.meshtags(mesh, dim, cells, block.astype(np.int32)),
        dolfinx.mesh.meshtags(mesh, dim - 1, facets[some], value[some]),
    )


def _exact(
    V: Any, cell_tags: Any, gap: float, young: tuple[float, float], pressure: float
) -> fem.Function:
    """Return the exact displacement of blocks that are not moved, also at ghosts."""
    dim = V.mesh.topology.dim
    x = V.tabulate_dof_coordinates()
    upper = np.zeros(len(x), dtype=bool)
    upper[V.dofmap.list[cell_tags.find(UPPER_BLOCK)]] = True
    along, across = 1.0, POISSON
    if dim == 2:  # plane strain
        along, across = 1.0 - POISSON**2, POISSON * (1.0 + POISSON)
    strain = pressure / np.where(upper, *young)
    u = fem.Function(V, name="exact")
    values = u.x.array.reshape(-1, dim)
    values[:, : dim - 1] = (across * strain)[:, None] * x[:, : dim - 1]
    z = x[:, dim - 1]
    values[:, dim - 1] = -along * strain * z
    values[upper, dim - 1] = -gap - along * pressure * (
        1.0 / young[1] + (z[upper] - 1.0 - gap) / young[0]
    )
    return u


def _held(V: Any, facet_tags: Any, tag: int, exact: fem.Function) -> Any:
    """Return the condition u = exact on tagged facets."""
    return fem.dirichletbc(
        exact, fem.locate_dofs_topological(V, facet_tags.dim, facet_tags.find(tag))
    )


def _held_across(V: Any, facet_tags: Any, tag: int, component: int, exact: fem.Function) -> Any:
    """Return the condition that one component is the exact one on tagged facets."""
    sub = V.sub(component)
    collapsed, _ = sub.collapse()
    dofs = fem.locate_dofs_topological((sub, collapsed), facet_tags.dim, facet_tags.find(tag))
    value = exact.sub(component).collapse()
    return fem.dirichletbc(value, dofs, sub)
