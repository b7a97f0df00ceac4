# %% [markdown]
# # A press fit: a pin that is too thick for its hole
#
# A steel pin is pressed into the hole of an aluminium plate. Its radius is 0.1 percent larger than
# that of the hole, so the plate holds it by pressure and friction alone. First question: what is
# the pressure? Second: what force pushes the pin out?
#
#                  push, prescribed displacement
#                        | | | |
#                     +--v-v-v-v--+                z = 22 mm
#       +-------------+           +-------------+  z = 16
#       |             |           |             |
#       |    plate    |    pin    |    plate    |
#       |             |           |             |
#       +-------------+           +-------------+  z = 0
#       ^ ^ ^ ^       +-----------+       ^ ^ ^ ^  z = -6
#       support                           support
#                     |<-- 20 --->|
#
# A quarter of it is enough; x = 0 and y = 0 are planes of symmetry. With N = 16 it takes 5,995
# nodes, 5 seconds and 550 MB.
#
# **Strong form.** In each body -div sigma(u) = 0. In the contact, with the outward normal n of the
# hole and [u] = u_plate - u_pin: p >= 0, [u].n <= d, p ([u].n - d) = 0, with the gap d = -0.01 mm:
# the bodies overlap before they are deformed. The tangential traction t obeys |t| <= g; where
# |t| < g nothing slides, where |t| = g the slip [u]_t points along t.
#
# **The slip bound.** Tresca's g does not follow the pressure. In a press fit that is a fair model:
# the pressure comes from the interference and hardly changes when the pin is pushed. Here g is the
# coefficient of friction times the pressure of Lame's formula for a thick ring on a shaft,
#
#     p = delta / (R ((Ro^2 + R^2) / (Ro^2 - R^2) + nu_o) / E_o + R (1 - nu_i) / E_i)
#
# **Discrete form.** The hole has 16 cells round the quarter, the pin 12: the meshes do not match,
# and each is a polygon. Between their nodes the polygons are up to 0.02 mm off the circles, twice
# the interference; the package takes the gap between the curved faces, from the normals of the
# nodes, and not between the flat facets.

# %%
from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ContactSolution,
    ProgressBar,
    SolutionWriter,
    TaggedMesh,
    Tresca,
    Units,
    read_gmsh,
)

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N and energies in N mm.

# %%
HERE = Path(__file__).parent
GEOMETRY = MESHES / "press_fit.geo"
RESULTS = HERE.parent / "results"
UNITS = Units("mm", "MPa", force="N")

RADIUS, RIM, THICKNESS = 10.0, 30.0, 16.0  # mm
INTERFERENCE = 0.01  # mm
YOUNG = {"plate": 70_000.0, "pin": 210_000.0}  # MPa
POISSON = {"plate": 0.33, "pin": 0.3}
FRICTION = 0.15  # coefficient of friction
PUSHES = (0.001, 0.002, 0.003, 0.004, 0.006, 0.01)  # mm, displacement of the top of the pin


def lame_pressure() -> float:
    """Return the pressure [MPa] of a ring on a shaft, both free along the axis."""
    ring = ((RIM**2 + RADIUS**2) / (RIM**2 - RADIUS**2) + POISSON["plate"]) / YOUNG["plate"]
    shaft = (1 - POISSON["pin"]) / YOUNG["pin"]
    return INTERFERENCE / (RADIUS * (ring + shaft))


SLIP_BOUND = FRICTION * lame_pressure()  # MPa


@dataclass(frozen=True)
class Scene:
    """What a user of FEniCSx has, and the pair of surfaces."""

    fit: TaggedMesh
    V: Any
    stress: Callable[[Any], Any]
    work: Callable[[Any, Any], Any]  # of the stress of u on the strain of v
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    push: Any  # displacement of the top of the pin along z
    pushed: Any  # 1 along z in the nodes of the top of the pin, 0 in the others


# %% [markdown]
# ## The scene
# The planes of symmetry hold both bodies sideways, the support and the pushed end along the axis.


# %%
def press_fit(
    comm: MPI.Comm, N: int = 16, *, M: int | None = None, hexahedra: bool = True
) -> Scene:
    """Return the scene with N cells round a quarter of the hole and M (even) round the pin."""
    M = 2 * round(3 * N / 8) if M is None else M
    fit = read_gmsh(
        GEOMETRY,
        comm,
        N=N,
        M=M,
        Hex=int(hexahedra),
        Radius=RADIUS,
        Rim=RIM,
        Thickness=THICKNESS,
        Interference=INTERFERENCE,
    )
    mesh, tags = fit.mesh, fit.tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

    young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    poisson = fem.Function(young.function_space)
    for body in YOUNG:
        cells = fit.cell_tags.find(tags[body])
        young.x.array[cells] = YOUNG[body]
        poisson.x.array[cells] = POISSON[body]
    mu = young / (2 * (1 + poisson))
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    def stress(u: Any) -> Any:
        return 2 * mu * strain(u) + lame * ufl.div(u) * ufl.Identity(3)

    def work(u: Any, v: Any) -> Any:
        return ufl.inner(stress(u), strain(v)) * ufl.dx

    a = work(ufl.TrialFunction(V), ufl.TestFunction(V))
    L = ufl.inner(fem.Constant(mesh, np.zeros(3)), ufl.TestFunction(V)) * ufl.dx

    push = fem.Constant(mesh, default_scalar_type(0.0))
    zero = fem.Constant(mesh, default_scalar_type(0.0))
    held = (
        ("plate_x", 0, zero),
        ("plate_y", 1, zero),
        ("plate_support", 2, zero),
        ("pin_x", 0, zero),
        ("pin_y", 1, zero),
        ("pin_top", 2, push),
    )
    bcs = []
    for name, axis, value in held:
        dofs = fem.locate_dofs_topological(V.sub(axis), 2, fit.facet_tags.find(tags[name]))
        bcs.append(fem.dirichletbc(value, dofs, V.sub(axis)))
    pushed = fem.Function(V)
    pushed.x.array[dofs] = 1.0
    pair = ContactPair(
        fit.facet_tags,
        secondary=tags["plate_contact"],
        primary=tags["pin_contact"],
        friction=Tresca(SLIP_BOUND),
    )
    return Scene(fit, V, stress, work, a, L, bcs, pair, push, pushed)


# %% [markdown]
# ## What is measured
# The reaction at the pushed end is the work of the stress on a unit displacement of that end alone:
# it comes from the displacement, not from the multipliers, so the two can be compared.


# %%
def push_force(scene: Scene, u: Any) -> float:
    """Return the force [N] on the top of the quarter pin, downwards. Collective."""
    local = fem.assemble_scalar(fem.form(scene.work(u, scene.pushed)))
    return -float(scene.V.mesh.comm.allreduce(local))


def von_mises(scene: Scene, u: fem.Function) -> fem.Function:
    """Return the von Mises stress [MPa] in the middle of each cell. Collective."""
    deviator = ufl.dev(scene.stress(u))
    cells = fem.functionspace(scene.V.mesh, ("DG", 0))
    result = fem.Function(cells, name="von_mises")
    middle = cells.element.basix_element.points
    result.interpolate(fem.Expression(ufl.sqrt(1.5 * ufl.inner(deviator, deviator)), middle))
    return result


def nodal(function: fem.Function) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) and values of the nodes of all ranks. Collective."""
    space = function.function_space
    size, bs = space.dofmap.index_map.size_local, space.dofmap.index_map_bs
    points = space.tabulate_dof_coordinates()[:size]
    values = function.x.array[: size * bs].reshape(size, bs)
    comm = space.mesh.comm
    return tuple(np.concatenate(comm.allgather(rows)) for rows in (points, values))


def total(comm: MPI.Comm, values: np.ndarray) -> float:
    """Return the sum over all ranks. Collective."""
    return float(comm.allreduce(values.sum()))


@dataclass(frozen=True)
class Step:
    """Figures of one solution, of the quarter model."""

    push: float  # mm
    force: float  # N, on the top of the pin
    friction: float  # N, integral of the slip bound over the nodes that slip
    limit: float  # N, the same over all nodes
    middle: float  # MPa, mean pressure in the middle half of the thickness
    edge: float  # MPa, mean pressure at the edges of the hole
    sliding: float  # part of the contact area

    def __str__(self) -> str:
        return (
            f"{self.push:8.3f} {self.force:10.1f} {self.friction:12.1f} {100 * self.sliding:9.1f}"
            f" {self.middle:10.2f} {self.edge:9.2f}"
        )


HEADER = "push [mm]  force [N]  sliding at  sliding %  p middle    p edge"


def measure(scene: Scene, solution: ContactSolution) -> Step:
    """Take the figures of a solution. Collective."""
    comm, surface = scene.V.mesh.comm, solution.surface
    points, pressure = nodal(surface.pressure)
    z = points[:, 2]
    middle = np.abs(z - THICKNESS / 2) <= THICKNESS / 4
    edge = np.abs(z - THICKNESS / 2) >= THICKNESS / 2 * (1 - 1e-9)
    area = total(comm, surface.weights)
    sliding = total(comm, surface.weights[~surface.sticking])
    return Step(
        push=-float(scene.push.value),
        force=push_force(scene, solution.u),
        friction=SLIP_BOUND * sliding,
        limit=SLIP_BOUND * area,
        middle=float(pressure[middle].mean()),
        edge=float(pressure[edge].mean()),
        sliding=sliding / area,
    )


# %% [markdown]
# ## Solve
# One problem serves all steps: only the prescribed displacement changes, K is factored once, and
# each step starts from the one before. Step 0 is the assembly. Each step is an equilibrium of its
# own: the slip counts from the undeformed bodies and not from the step before. In step 0 the force
# is not zero: the pin is squeezed and so grows longer, and its top is held.
#
# Each step is written as soon as it is there: ParaView shows a film, and its time is the push.
# The stress is not known to the package, only to the form; what one wants of it is handed over.


# %%
def solve(
    scene: Scene, writer: SolutionWriter | None = None
) -> tuple[list[Step], list[ContactSolution]]:
    """Assemble, then push the pin step by step. Collective."""
    comm = scene.V.mesh.comm
    steps, solutions = [], []
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs, units=UNITS) as problem:
        for push in (0.0, *PUSHES):
            scene.push.value = -push
            solution = problem.solve(rtol=1e-8, observer=ProgressBar(comm))
            check_law(solution)
            if writer is not None:
                writer.write(solution, time=push, fields=[von_mises(scene, solution.u)])
            solutions.append(solution)
            steps.append(measure(scene, solution))
    return steps, solutions


# %% [markdown]
# ## Check
# Lame's formula holds for a ring and a shaft of the same length, without friction. Here the pin is
# longer, and what sticks out hinders the squeezing: the pressure peaks at the edges of the hole. In
# the middle it is near the formula, within 1 percent at N = 16; 4 percent are allowed.
#
# The force on the pin is the integral of the tangential traction. It cannot pass g times the area
# of contact, 1455 N, and it is that force once all nodes slip along the axis.


# %%
def check_law(solution: ContactSolution) -> None:
    """Assert convergence and the law of contact. Not collective."""
    solution.raise_if_failed()
    assert solution.pressure.x.array.min(initial=0.0) >= 0.0
    traction = np.linalg.norm(solution.traction.x.array.reshape(-1, 3), axis=1)
    assert traction.max(initial=0.0) <= SLIP_BOUND * (1 + 1e-12)


def check(steps: list[Step]) -> None:
    """Assert what the figures must show."""
    assembly, last = steps[0], steps[-1]
    assert abs(assembly.middle / lame_pressure() - 1) < 0.04
    assert assembly.edge > 1.05 * assembly.middle
    assert last.edge > 1.15 * last.middle
    forces = [step.force for step in steps]
    assert (np.diff(forces[:4]) > 0.0).all()
    assert max(forces) <= last.limit * (1 + 1e-6)
    assert last.sliding > 1 - 1e-9
    assert abs(last.force / last.limit - 1) < 1e-3  # the slip is along the axis but for its start
    assert abs(last.limit / (SLIP_BOUND * np.pi / 2 * RADIUS * THICKNESS) - 1) < 5e-3


def main() -> None:
    """Run the demo."""
    comm = MPI.COMM_WORLD
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    scene = press_fit(comm)
    steps, solutions = solve(scene, SolutionWriter(RESULTS / "press_fit.pvd"))
    if comm.rank == 0:
        print(solutions[-1])
        print(f"\nLame's pressure {lame_pressure():.2f} MPa, slip bound {SLIP_BOUND:.3f} MPa")
        print(HEADER, *steps, sep="\n")
    check(steps)
    for name, solution in (("assembly", solutions[0]), ("push_out", solutions[-1])):
        solution.plot(RESULTS / f"press_fit_{name}.png")


if __name__ == "__main__":
    main()
