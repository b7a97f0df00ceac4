# %% [markdown]
# # A block on a rigid ball, and on a rigid ring
#
# A block of rubber is pressed on a steel ball and pushed aside a little. The ball is so much
# stiffer that it counts as rigid: it needs no mesh, only its centre and radius. Where the block
# touches the ball, friction resists sliding. The middle of the contact sticks, the rim slides.
#
#               | | | pressed down, pushed along x
#               v v v -->
#           +-----------+  z = 12
#           |   block   |
#           |           |
#           +--. ___ .--+  z = 0
#             /     \
#            |   +   |     rigid ball, its top at z = 0
#             \ ___ /
#
# In the second part the ball gives way to a ring, described by a function that the user writes: the
# distance of points from it. With 9,801 nodes both parts take ten seconds and 700 MB.
#
# **Strong form.** In the block -div sigma(u) = 0 with sigma = 2 mu strain + lambda tr(strain) I. On
# its bottom, with the normal n of the obstacle that points to the block, the pressure p and the
# gap, which is the distance less what u closes of it, obey p >= 0, gap >= 0, p gap = 0. The
# tangential traction t obeys |t| <= g; where |t| < g nothing slides, where |t| = g the slip points
# along t.
#
# **Friction.** Tresca's bound g does not depend on the pressure, and where it is positive it drags
# open nodes as well. So it should be zero where no contact is expected. Here it is a coefficient
# of friction times the pressure that Hertz found for a ball on a half-space: a guess that costs
# nothing, good as long as the contact is small against the block. Here it is a fifth too low.

# %%
from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ContactSolution,
    Frictionless,
    RigidObstacle,
    RigidSphere,
    TaggedMesh,
    Tresca,
    Units,
    read_gmsh,
)

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N.

# %%
HERE = Path(__file__).parent
GEOMETRY = MESHES / "block.geo"
RESULTS = HERE.parent / "results"
UNITS = Units("mm", "MPa", force="N")

YOUNG, POISSON = 10.0, 0.4  # MPa, rubber
LENGTH, HEIGHT = 24.0, 12.0  # mm, the block, as wide as long

BALL = 40.0  # mm, its radius
APPROACH = 0.6  # mm, the top goes down by this
PUSH = 0.15  # mm, and along x by this
FRICTION = 0.3  # coefficient of friction

RING, TUBE = 6.0, 6.0  # mm, radius of the ring's middle line, and of its cross-section


# %% [markdown]
# ## The obstacles
# A user's own obstacle is a function of points, an array of shape (3, n). It returns their distance
# from the obstacle, positive outside, and the direction in which that grows, the normal.


# %%
def distance_from_ring(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (n,) from a ring whose top is at z = 0, and its gradient (3, n)."""
    to_axis = np.hypot(x[0], x[1])
    outwards = to_axis - RING
    upwards = x[2] + TUBE
    to_middle_line = np.hypot(outwards, upwards)
    away = x[:2] / np.where(to_axis > 0.0, to_axis, 1.0)
    normal = np.vstack([away * outwards, upwards]) / to_middle_line
    # on the axis all directions are alike: take x
    alone = to_axis == 0.0
    normal[0, alone] = outwards[alone] / to_middle_line[alone]
    return to_middle_line - TUBE, normal


def hertz_bound(x: np.ndarray) -> np.ndarray:
    """Return the coefficient of friction times Hertz's pressure on a half-space [MPa]."""
    modulus = YOUNG / (1 - POISSON**2)
    contact_radius = math.sqrt(BALL * APPROACH)
    peak = 2 * modulus * contact_radius / (math.pi * BALL)
    inside = 1 - (x[0] ** 2 + x[1] ** 2) / contact_radius**2
    return FRICTION * peak * np.sqrt(np.maximum(inside, 0.0))


# %% [markdown]
# ## The scene
# The bottom of the block is the secondary side. The obstacle stands where a mesh would have the
# tag of the primary side.


# %%
@dataclass(frozen=True)
class Scene:
    """What a user of FEniCSx has, and the pair of surface and obstacle."""

    block: TaggedMesh
    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair


def block_on_ball(comm: MPI.Comm, N: int = 32, *, push: float = PUSH, **parameters: float) -> Scene:
    """Return the block on the ball, N cells along x; `parameters` are others of the .geo file."""
    return _scene(
        comm,
        N,
        (push, 0.0, -APPROACH),
        RigidSphere(center=(0.0, 0.0, -BALL), radius=BALL),
        Tresca(hertz_bound),
        parameters,
    )


def block_on_ring(comm: MPI.Comm, N: int = 32, **parameters: float) -> Scene:
    """Return the block on the ring, without friction."""
    return _scene(
        comm,
        N,
        (0.0, 0.0, -APPROACH),
        RigidObstacle(distance_from_ring, name="a rigid ring"),
        Frictionless(),
        parameters,
    )


def _scene(
    comm: MPI.Comm,
    N: int,
    displacement: tuple[float, float, float],
    obstacle: RigidObstacle,
    friction: Tresca | Frictionless,
    parameters: dict[str, float],
) -> Scene:
    """Return a block whose top is displaced."""
    given = {"Hex": 1, "Grading": 1.2, "Lx": LENGTH, "Ly": LENGTH, "Lz": HEIGHT, **parameters}
    block = read_gmsh(GEOMETRY, comm, N=N, **given)
    mesh = block.mesh
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    mu = YOUNG / (2 * (1 + POISSON))
    lame = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
    L = ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx
    top = fem.locate_dofs_topological(V, 2, block.facet_tags.find(block.tags["top"]))
    bcs = [fem.dirichletbc(np.array(displacement), top, V)]
    pair = ContactPair(
        block.facet_tags,
        secondary=block.tags["bottom"],
        primary=obstacle,
        friction=friction,
    )
    return Scene(block, V, a, L, bcs, pair)


# %% [markdown]
# ## Solve and check
# The solution must obey the law of contact. And forces must balance: what the obstacle does to the
# block by pressure and friction is what the clamp at the top must hold against.


# %%
def solve(scene: Scene) -> ContactSolution:
    """Solve."""
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs, units=UNITS) as problem:
        return problem.solve(rtol=1e-6)  # gaps are checked node by node


def contact_force(scene: Scene, solution: ContactSolution) -> np.ndarray:
    """Return the force (3,) of the obstacle on the block [N]. Collective."""
    surface = solution.surface
    space = fem.functionspace(surface.mesh, ("Lagrange", 1, (3,)))
    force = fem.Function(space)
    _, normal = scene.pair.primary.at(space.tabulate_dof_coordinates())
    force.x.array[:] = (surface.pressure.x.array[:, None] * normal).ravel()
    if surface.traction is not None:  # what the primary side feels
        force.x.array[:] -= surface.traction.x.array
    parts = [fem.assemble_scalar(fem.form(force[i] * ufl.dx)) for i in range(3)]
    return scene.V.mesh.comm.allreduce(np.array(parts))


def clamp_force(scene: Scene, solution: ContactSolution) -> np.ndarray:
    """Return the force (3,) of the clamp on the top of the block [N]. Collective."""
    u, v = scene.a.arguments()[1], scene.a.arguments()[0]
    top = scene.block.facet_tags.find(scene.block.tags["top"])
    parts = []
    for i in range(3):
        # the work of the stresses on a unit displacement of the top is the force along it
        unit = fem.Function(scene.V)
        unit.x.array[fem.locate_dofs_topological(scene.V.sub(i), 2, top)] = 1.0
        work = ufl.replace(scene.a, {u: solution.u, v: unit})
        parts.append(fem.assemble_scalar(fem.form(work)))
    return scene.V.mesh.comm.allreduce(np.array(parts))


def check(scene: Scene, solution: ContactSolution) -> None:
    """Assert what must hold: convergence, the contact law, and the balance of forces."""
    solution.raise_if_failed()
    surface, comm = solution.surface, scene.V.mesh.comm
    pressure = surface.pressure.x.array
    assert pressure.min(initial=0.0) >= 0.0
    # the residual of 1e-6 is that of mean squares: a node may be some hundred times off
    assert surface.gap.x.array.min(initial=0.0) >= -1e-4 * APPROACH
    pressed = pressure > 0.0
    assert np.abs(surface.gap.x.array[pressed]).max(initial=0.0) <= 1e-4 * APPROACH
    assert comm.allreduce(int(pressed.sum())) > 0
    if isinstance(scene.pair.friction, Tresca):
        bound = fem.Function(surface.pressure.function_space)
        bound.interpolate(scene.pair.friction.slip_bound)
        traction = np.linalg.norm(surface.traction.x.array.reshape(-1, 3), axis=1)
        assert (traction <= bound.x.array * (1 + 1e-9) + 1e-12).all()
    contact, clamp = contact_force(scene, solution), clamp_force(scene, solution)
    assert np.linalg.norm(contact + clamp) < 1e-6 * np.linalg.norm(clamp)


# %% [markdown]
# ## Run
# The pictures show the contact from above. On the ball the dots are nodes that stick; the arrows
# are slip, also of the open nodes, which nothing holds. On the ring the pressed part is a band.


# %%
def main() -> None:
    """Run the demo."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    comm = MPI.COMM_WORLD
    for name, scene in (("ball", block_on_ball(comm)), ("ring", block_on_ring(comm))):
        solution = solve(scene)
        force = contact_force(scene, solution)
        if comm.rank == 0:
            numbers = ", ".join(f"{component:.4g}" for component in force)
            print(f"\nblock on a {name}\n{solution}\non the block   ({numbers}) N\n")
        check(scene, solution)
        solution.write(RESULTS / f"rigid_{name}.pvd")
        solution.plot(RESULTS / f"rigid_{name}.png")


if __name__ == "__main__":
    main()
