"""Small models: blocks on rigid obstacles and on each other; lengths in m, stresses in MPa."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, RigidPlane, Tresca
from dolfinx_tresca.scene.friction import Friction
from scenes.elasticity import elasticity
from scenes.patches import KINDS, patch
from scenes.scene import Scene

#: Young's modulus [MPa], Poisson's ratio, slip bound [MPa].
YOUNG, POISSON, BOUND = 1000.0, 0.3, 1.0

#: Tags of a block's faces; the last coordinate is the height.
BELOW, ABOVE, LEFT, RIGHT, FRONT, BACK = 1, 2, 3, 4, 5, 6


def floor(dim: int, height: float = 0.0) -> RigidPlane:
    """A plane that faces up, along the last axis."""
    return RigidPlane(*(np.eye(3)[dim - 1] * value for value in (height, 1.0)))


def block(
    comm: MPI.Comm,
    n: Sequence[int] = (3, 3, 2),
    *,
    size: Sequence[float] | None = None,
    degree: int = 1,
    load: Sequence[float] | np.ndarray = (0.3, 0.1, -1.0),
    held: Sequence[int] = (),
    across: Sequence[int] = (),
    moved: Callable[[np.ndarray], np.ndarray] | None = None,
    young: float | Callable[[np.ndarray], np.ndarray] = YOUNG,
    poisson: float = POISSON,
    spring: float = 0.0,
    friction: Friction | None = None,
    obstacles: Sequence[tuple[int, Any]] | None = None,
    boxes: bool = False,
    pull: float = 0.0,
) -> Scene:
    """Return a block whose lower face may touch the floor. Collective.

    Args:
        comm: communicator of the mesh.
        n: cells along each axis: two numbers for a block in 2D, three in 3D.
        size: length of the block along each axis; None: 1.
        degree: degree of the displacement.
        load: traction (3,) [MPa] on the upper face; in 2D the second component is left out.
        held: tags of faces that are clamped.
        across: tags of faces that cannot move along their normals.
        moved: function from points (3, n) to the displacements (dim, n) of clamped faces; None:
            zero.
        young: Young's modulus [MPa]; a function of points (3, n) gives one value for each cell.
        poisson: Poisson's ratio.
        spring: stiffness [MPa/m^2] of springs at all points of the body.
        friction: law of friction; None: `Tresca(BOUND)`.
        obstacles: pairs of the tag of a face and its obstacle; None: the lower face and the floor.
        boxes: whether cells are quadrilaterals or hexahedra, not triangles or tetrahedra.
        pull: traction on the right face along the first axis [MPa].
    """
    dim = len(n)
    size = [1.0] * dim if size is None else list(size)
    create = dolfinx.mesh.create_box if dim == 3 else dolfinx.mesh.create_rectangle
    cell = [getattr(dolfinx.mesh.CellType, kind) for kind in KINDS[2 * dim - 4 : 2 * dim - 2]]
    mesh = create(comm, [np.zeros(dim), np.array(size)], list(n), cell[int(boxes)])
    mesh.topology.create_connectivity(dim - 1, dim)
    planes = [
        (BELOW, dim - 1, 0.0), (ABOVE, dim - 1, size[-1]), (LEFT, 0, 0.0), (RIGHT, 0, size[0]),
        *([(FRONT, 1, 0.0), (BACK, 1, size[1])] if dim == 3 else []),
    ]  # fmt: skip
    facets, values = [], []
    for tag, axis, at in planes:
        found = dolfinx.mesh.locate_entities_boundary(
            mesh, dim - 1, lambda x, axis=axis, at=at: np.abs(x[axis] - at) < 1e-9 * size[axis]
        )
        facets.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    order = np.argsort(np.concatenate(facets))
    tags = dolfinx.mesh.meshtags(
        mesh, dim - 1, np.concatenate(facets)[order], np.concatenate(values)[order]
    )
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    E = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    if callable(young):
        E.interpolate(young)
    else:
        E.x.array[:] = young
    nu, soil = (fem.Constant(mesh, value) for value in (poisson, spring))
    traction = fem.Constant(mesh, np.array([*load[: dim - 1], load[2]], dtype=float))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = elasticity(V, E, nu) + soil * ufl.inner(u, v) * ufl.dx
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    side = fem.Constant(mesh, float(pull))
    L = ufl.inner(traction, v) * ds(ABOVE) + side * v[0] * ds(RIGHT)
    value = fem.Function(V)
    if moved is not None:
        value.interpolate(moved)
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, dim - 1, tags.find(tag)))
        for tag in held
    ]
    axes = {tag: axis for tag, axis, _ in planes}
    for tag in across:
        sub = V.sub(axes[tag])
        dofs = fem.locate_dofs_topological(sub, dim - 1, tags.find(tag))
        bcs.append(fem.dirichletbc(dolfinx.default_scalar_type(0.0), dofs, sub))
    obstacles = [(BELOW, floor(dim))] if obstacles is None else obstacles
    law = Tresca(BOUND) if friction is None else friction
    pairs = [ContactPair(tags, tag, obstacle, law) for tag, obstacle in obstacles]
    data = SimpleNamespace(load=traction, young=E, poisson=nu, spring=soil, held=value, pull=side)
    return Scene(V, a, L, bcs, pairs, tags, data=data)


def rubbing_blocks(
    comm: MPI.Comm, kind: str, *, amount: float = 1.0, scale: float = 1.0, **arguments: Any
) -> Scene:
    """Return the two blocks of `patch`, the upper one pressed, dragged and tilted. Collective.

    Args:
        comm: communicator of the mesh.
        kind: type of the cells.
        amount: factor of the motion of the upper block.
        scale: factor of the whole scene and of the motion.
        arguments: further arguments of `patch`.
    """
    arguments.setdefault("friction", Tresca(BOUND))
    scene = patch(comm, kind, scale=scale, **arguments)
    dim = scene.mesh.geometry.dim
    x = scene.V.tabulate_dof_coordinates()[:, :dim] / scale
    u = np.zeros_like(x)
    upper = x[:, -1] > 1.5
    u[:, 0] = 1e-3
    u[:, -1] = -4e-3 + 7e-3 * x[:, 0] ** 2
    scene.data.exact.x.array[:] = amount * scale * (u * upper[:, None]).ravel()
    return scene
