# %% [markdown]
# # A stem in bone
#
# After the replacement of a hip a titanium stem sits in the thigh bone without cement: it is driven
# into a hole that is a little too narrow. The joint presses on its neck, downwards and sideways.
# How much of it slips? The upper part of the stem has a rough coating, the tip is smooth. Bone
# grows into the coating only where it moves by less than some 0.04 mm.
#
#                         head: moved by the joint
#                            ____
#                           /   /
#       +------------------+   +-----------------+     z = 0
#       |               \  rough /               |
#       |  cortical      \      /     cortical   |
#       |     |  cancellous\smooth/     |        |
#       |     |             |___|      |        |     z = -50 mm
#       |                                       |
#       +---------------------------------------+     z = -65 mm
#       /////////////////////////////////////////     fixed
#     x = -25 mm                              x = 25
#
# y = 0 is a plane of symmetry; half of it is modelled. With N = 20 it takes 4,660 nodes,
# 13 seconds and 560 MB.
#
# **Strong form.** In each body -div sigma(u) = 0. In the contact, with the outward normal n of the
# hole and [u] = u_bone - u_stem: p >= 0, [u].n <= d, p ([u].n - d) = 0. The gap d is negative, a
# press fit: -0.04 mm at the top of the hole, less and less below, and none at the tip. The
# tangential traction t obeys |t| <= g(x); where |t| < g nothing slides, where |t| = g the slip
# [u]_t points along t.
#
# **What holds the stem?** Contact alone could (`demo_floating_block.py`), with the joint force as a
# load. Here the head of the joint is rigid and its motion prescribed, as in a testing machine; the
# joint force is the reaction.
#
# **The slip bound** comes from the press fit: its mean pressure, 3 MPa, times the coefficient of
# friction, 0.8 where the stem is rough and 0.1 where it is smooth. It does not follow the pressure
# of the joint force. The first solution, with the head at rest, must give that pressure back.
#
# **The mesh.** Stem and bone are cut from one another with Gmsh's OpenCASCADE kernel and share no
# nodes; hole and stem have 20 and 16 cells round the half, so their meshes do not match.

# %%
from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
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
# Lengths in mm, stresses in MPa, so forces come in N and energies in N mm. Forces are those of the
# half model: the largest is 0.82 kN; twice that, on the whole stem, is what walking takes.

# %%
HERE = Path(__file__).parent
GEOMETRY = MESHES / "implant.geo"
RESULTS = HERE.parent / "results"
UNITS = Units("mm", "MPa", force="N")

TITANIUM, CANCELLOUS, CORTICAL = 110_000.0, 1_000.0, 15_000.0  # MPa, Young's moduli
POISSON = 0.3  # of all
WIDTH, SHELL = 50.0, 5.0  # mm, of the block and of its cortical shell
INTERFERENCE = 0.04  # mm, at the top of the stem; none at its tip
MOTION = (-0.02, 0.0, -0.02)  # mm, of the head
STEPS = (0.0, 0.25, 0.5, 0.75, 1.0)  # parts of the motion
PRESS_FIT = 3.0  # MPa, mean pressure
ROUGH, SMOOTH = 0.8 * PRESS_FIT, 0.1 * PRESS_FIT  # MPa, slip bounds
COATED = -25.0  # mm, the coating ends at this height


def slip_bound(x: np.ndarray) -> np.ndarray:
    """Return g [MPa] at points x (3, n): rough above, smooth below, a change over some mm."""
    return SMOOTH + (ROUGH - SMOOTH) * 0.5 * (1 + np.tanh((x[2] - COATED) / 2.0))


def bone_modulus(x: np.ndarray) -> np.ndarray:
    """Return Young's modulus [MPa] of the bone at points x (3, n): stiff at the outer walls."""
    depth = WIDTH / 2 - np.maximum(np.abs(x[0]), np.abs(x[1]))
    return CANCELLOUS + (CORTICAL - CANCELLOUS) * 0.5 * (1 - np.tanh((depth - SHELL) / 1.5))


@dataclass(frozen=True)
class Scene:
    """What a user of FEniCSx has, and the pair of surfaces."""

    hip: TaggedMesh
    V: Any
    work: Callable[[Any, Any], Any]  # of the stress of u on the strain of v
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    motion: Any  # of the head [mm]


# %% [markdown]
# ## The scene
# Bone is stiff at the outer walls of the block and soft inside: its modulus is a function of the
# place, one value in each cell.


# %%
def implant(comm: MPI.Comm, N: int = 20, *, M: int | None = None, **parameters: float) -> Scene:
    """Return the scene with N cells round the half hole and M round the stem.

    `parameters` are others of the .geo file.
    """
    M = round(0.8 * N) if M is None else M
    hip = read_gmsh(GEOMETRY, comm, N=N, M=M, Interference=INTERFERENCE, Width=WIDTH, **parameters)
    mesh, tags = hip.mesh, hip.tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

    young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    young.interpolate(bone_modulus)
    young.x.array[hip.cell_tags.find(tags["stem"])] = TITANIUM
    mu = young / (2 * (1 + POISSON))
    lame = young * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    def work(u: Any, v: Any) -> Any:
        inner = 2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)
        return inner * ufl.dx

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = work(u, v)
    L = ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx

    def facets(name: str) -> Any:
        return hip.facet_tags.find(tags[name])

    motion = fem.Constant(mesh, np.zeros(3))
    fixed = fem.locate_dofs_topological(V, 2, facets("bone_fixed"))
    head = fem.locate_dofs_topological(V, 2, facets("stem_joint"))
    bcs = [fem.dirichletbc(np.zeros(3), fixed, V), fem.dirichletbc(motion, head, V)]
    for name in ("bone_symmetry", "stem_symmetry"):
        dofs = fem.locate_dofs_topological(V.sub(1), 2, facets(name))
        bcs.append(fem.dirichletbc(default_scalar_type(0.0), dofs, V.sub(1)))
    pair = ContactPair(
        hip.facet_tags,
        secondary=tags["bone_contact"],
        primary=tags["stem_contact"],
        friction=Tresca(slip_bound),
    )
    return Scene(hip, V, work, a, L, bcs, pair, motion)


# %% [markdown]
# ## What is measured
# The force on the nodes of a surface is the work of the stress on a unit displacement of these
# nodes alone. It comes from the displacement, not from the multipliers, and so it checks them.


# %%
@dataclass(frozen=True)
class Step:
    """Figures of one solution: forces along x and z [N], and the slip."""

    joint: np.ndarray  # on the stem, at the head
    stem: np.ndarray  # on the stem, by the bone
    bone: np.ndarray  # on the bone, by the stem
    base: np.ndarray  # on the bone, at its bottom
    pressure: float  # MPa, mean
    sliding: float  # part of the contact area
    slip: float  # mm, the largest

    def __str__(self) -> str:
        columns = [f"{value:9.1f}" for value in (*self.joint, *self.stem, *self.base)]
        rest = f"{self.pressure:8.2f} {100 * self.sliding:10.1f} {1e3 * self.slip:10.2f}"
        return " ".join([*columns, rest])


HEADER = (
    "  joint x         z    bone x         z    base x         z    p mean  sliding %  slip [um]"
)


def force(scene: Scene, name: str, u: Any) -> np.ndarray:
    """Return the force [N] along x and z on the nodes of a named surface. Collective."""
    facets = scene.hip.facet_tags.find(scene.hip.tags[name])
    result = []
    for axis in (0, 2):
        unit = fem.Function(scene.V)
        unit.x.array[fem.locate_dofs_topological(scene.V.sub(axis), 2, facets)] = 1.0
        result.append(fem.assemble_scalar(fem.form(scene.work(u, unit))))
    return np.array(scene.V.mesh.comm.allreduce(np.array(result)))


def measure(scene: Scene, solution: ContactSolution) -> Step:
    """Take the figures of a solution. Collective."""
    comm, surface = scene.V.mesh.comm, solution.surface
    area = comm.allreduce(surface.weights.sum())
    slip = np.linalg.norm(nodal(surface.slip), axis=1)
    return Step(
        joint=force(scene, "stem_joint", solution.u),
        stem=force(scene, "stem_contact", solution.u),
        bone=force(scene, "bone_contact", solution.u),
        base=force(scene, "bone_fixed", solution.u),
        pressure=solution.normal_force / area,
        sliding=comm.allreduce(surface.weights[~surface.sticking].sum()) / area,
        slip=comm.allreduce(slip.max(initial=0.0), op=MPI.MAX),
    )


def nodal(function: fem.Function) -> np.ndarray:
    """Return the values at the nodes of this rank, (n,) or (n, 3)."""
    dofmap = function.function_space.dofmap
    values = function.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]
    return values.reshape(-1, 3) if function.ufl_shape else values


# %% [markdown]
# ## Solve
# The head moves in steps. K is factored once, and each step starts from the one before. In step 0
# the head is at rest; since the stem is tapered, the press fit alone pushes it out of the hole, and
# it takes 226 N to keep it there.


# %%
def solve(
    scene: Scene, writer: SolutionWriter | None = None
) -> tuple[list[Step], list[ContactSolution]]:
    """Press the stem in, then move its head step by step. Collective."""
    comm = scene.V.mesh.comm
    steps, solutions = [], []
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs, units=UNITS) as problem:
        for part in STEPS:
            scene.motion.value[:] = part * np.array(MOTION)
            solution = problem.solve(rtol=1e-8, observer=ProgressBar(comm))
            check_law(comm, solution)
            if writer is not None:
                writer.write(solution, time=part)
            solutions.append(solution)
            steps.append(measure(scene, solution))
    return steps, solutions


# %% [markdown]
# ## Check
# At each node: no tension, friction within the bound at that place, slip only where the bound is
# reached, and along the traction. And the forces balance: the stem presses the bone as the bone
# presses the stem, the bone carries the whole joint force, and so does its base.


# %%
def check_law(comm: MPI.Comm, solution: ContactSolution) -> None:
    """Assert convergence and the law of contact at each node. Collective."""
    solution.raise_if_failed()
    surface = solution.surface
    pressure, traction, slip = (
        nodal(field) for field in (surface.pressure, surface.traction, surface.slip)
    )
    points = surface.pressure.function_space.tabulate_dof_coordinates()[: len(pressure)]
    bound = slip_bound(points.T)
    size, length = np.linalg.norm(traction, axis=1), np.linalg.norm(slip, axis=1)
    slides = length > 1e-3 * comm.allreduce(length.max(initial=0.0), op=MPI.MAX)
    along = np.einsum("ij,ij->i", traction, slip)
    faults = [
        (pressure < 0.0).sum(),
        (size > bound * (1 + 1e-9)).sum(),
        (slides & (size < bound * (1 - 1e-6))).sum(),
        (slides & (along < 0.999 * size * length)).sum(),
    ]
    assert not comm.allreduce(np.array(faults)).any(), faults


def check(steps: list[Step]) -> None:
    """Assert that forces balance, and what the figures must show."""
    for step in steps:
        load = np.linalg.norm(step.joint) + 1.0
        assert np.linalg.norm(step.stem + step.bone) < 1e-6 * load
        assert np.linalg.norm(step.stem + step.joint) < 1e-6 * load
        assert np.linalg.norm(step.base + step.bone) < 1e-6 * load
    first, last = steps[0], steps[-1]
    assert abs(first.pressure / PRESS_FIT - 1) < 0.1
    assert (last.joint < -100.0).all()  # to the side, and down
    assert all(after.sliding > before.sliding for before, after in pairwise(steps))
    assert last.slip < 0.04


def main() -> None:
    """Run the demo."""
    comm = MPI.COMM_WORLD
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    scene = implant(comm)
    steps, solutions = solve(scene, SolutionWriter(RESULTS / "implant.pvd"))
    if comm.rank == 0:
        print(solutions[-1])
        print("", HEADER, *steps, sep="\n")
    check(steps)
    solutions[-1].plot(RESULTS / "implant.png")


if __name__ == "__main__":
    main()
