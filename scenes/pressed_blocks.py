"""Two blocks in 2D or 3D, pressed, dragged and tilted, on any mesh; in m and MPa.

The ends are clamped, so there are singular corners. The upper block may be narrower, or have a
stiffer square or cube inside; one block may be much stiffer; both may be nearly incompressible.
"""

from __future__ import annotations

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import basix
import dolfinx
from dolfinx import fem

from dolfinx_tresca import ContactPair, TaggedMesh, Tresca
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.patches import BOTTOM, LOWER, LOWER_BLOCK, TOP, UPPER, UPPER_BLOCK, patch
from scenes.rubbing import BOUND, YOUNG, moved_end
from scenes.scene import Scene

#: Tag of the cells of the square or cube inside, in the middle of the block, and half its side [m].
INCLUSION, HALF = 3, 0.25

#: Names of the tags.
TAGS = {
    "upper": UPPER_BLOCK,
    "lower": LOWER_BLOCK,
    "inclusion": INCLUSION,
    "upper_contact": UPPER,
    "lower_contact": LOWER,
    "top": TOP,
    "bottom": BOTTOM,
}


def pressed_blocks(
    comm: MPI.Comm,
    n: int = 8,
    *,
    cell: str = "triangle",
    degree: int = 1,
    narrow: bool = False,
    poisson: float = 0.3,
    ratio: float = 1.0,
    lower: float = 2.0,
) -> Scene:
    """Return the scene with n cells, a multiple of four, along each side. Collective.

    Args:
        comm: communicator of the mesh.
        n: cells along the sides of a block.
        cell: type of the cells.
        degree: see `on_blocks`.
        narrow: whether the upper block has half the width, and presses with sharp corners.
        poisson: see `on_blocks`.
        ratio: see `on_blocks`.
        lower: see `on_blocks`.
    """
    dim = basix.cell.geometry(basix.CellType[cell]).shape[1]
    span = [(0.25, 0.75)] * (dim - 1) if narrow else None
    upper = (n // 2 if narrow else n, n)
    plain = patch(comm, cell, 1, upper=upper, lower=(n, n), distort=0.0, span=span)
    middles = dolfinx.mesh.compute_midpoints(plain.mesh, dim, plain.cell_tags.indices)
    centre = np.append(np.full(dim - 1, 0.5), 1.5)
    inside = (np.abs(middles[:, :dim] - centre) < HALF).all(axis=1) & (not narrow)
    values = np.where(inside, np.int32(INCLUSION), plain.cell_tags.values)
    cell_tags = dolfinx.mesh.meshtags(plain.mesh, dim, plain.cell_tags.indices, values)
    blocks = TaggedMesh(plain.mesh, cell_tags, plain.facet_tags, TAGS)
    return on_blocks(blocks, degree=degree, poisson=poisson, ratio=ratio, lower=lower)


def on_blocks(
    blocks: TaggedMesh,
    *,
    degree: int = 1,
    poisson: float = 0.3,
    ratio: float = 1.0,
    lower: float = 2.0,
) -> Scene:
    """Return the scene on any mesh of the blocks, such as a refined one. Collective.

    Args:
        blocks: mesh with the names of `TAGS`.
        degree: degree of the displacement.
        poisson: Poisson's ratio of all cells.
        ratio: Young's modulus of the square or cube inside, divided by that of the upper block.
        lower: Young's modulus of the lower block, divided by that of the upper one. The slip bound
            is proportional to the modulus of the softer block.
    """
    dim = blocks.mesh.topology.dim
    V = fem.functionspace(blocks.mesh, ("Lagrange", degree, (dim,)))
    moduli = {"upper": YOUNG, "lower": lower * YOUNG, "inclusion": ratio * YOUNG}
    young = by_body(blocks, moduli)
    moved = fem.Function(V)
    moved.interpolate(lambda x: moved_end(x[:dim].T).T)
    facets = blocks.facet_tags
    bcs = [
        fem.dirichletbc(moved, fem.locate_dofs_topological(V, dim - 1, facets.find(TOP))),
        fixed(V, facets.find(BOTTOM)),
    ]
    pair = ContactPair(facets, UPPER, LOWER, Tresca(BOUND * YOUNG * min(lower, 1.0)))
    data = SimpleNamespace(young=young, poisson=poisson, bodies=tuple(moduli))
    a = elasticity(V, young, poisson)
    return Scene(V, a, no_load(V), bcs, [pair], facets, blocks.cell_tags, blocks.tags, data)
