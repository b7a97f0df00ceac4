# %% [markdown]
# # Two bricks in contact with Tresca friction
#
# One elastic brick lies on another. The upper one is fixed at its right end, the lower one at its
# left end; a traction of 1 MPa presses the top of the upper brick and one of the free ends. Where
# the bricks touch, friction resists sliding with at most 0.09 MPa. This is the scene of the paper
# that the package implements (Kucera, Haslinger, Motyckova, Markopoulos 2017, section 38.5).
#
#             1 MPa
#       | | | | | | | | |
#       v v v v v v v v v
#       +---------------+//
#       |     upper     |//   z = 2
#       +===============+//   z = 1   contact
#     //|     lower     |
#     //+---------------+     z = 0
#     //
#       x = 0         x = 2
#
# With N = 16 it takes 8,704 nodes, a few seconds and 300 MB.
#
# **Strong form.** In each brick -div sigma(u) = 0 with sigma = 2 mu strain + lambda tr(strain) I.
# On the
# contact surface, with the outward normal n of the upper brick and [u] = u_upper - u_lower:
# the pressure p and the gap obey p >= 0, [u].n <= d, p ([u].n - d) = 0, and the tangential traction
# t obeys |t| <= g; where |t| < g nothing slides, where |t| = g the slip points along t.
#
# **Weak form.** Minimise the elastic energy less the work of the loads plus the work of friction,
# the integral of g |[u]_t|, over all displacements without penetration. The user writes the first
# two terms in UFL; the package adds the rest.
#
# **Discrete form.** Multipliers for pressure and traction in the nodes of the upper contact face;
# the dual problem in these multipliers is solved, each step with one solve of the elastic problem.

# %%
from __future__ import annotations

import logging
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
    ProgressBar,
    TaggedMesh,
    Tresca,
    Units,
    read_gmsh,
)
from dolfinx_tresca.scene.scalar_field import ScalarField

# %% [markdown]
# ## Data
# Lengths in m, stresses in MPa, so forces come in MN and energies in MN m.

# %%
HERE = Path(__file__).parent
GEOMETRY = MESHES / "two_bricks.geo"
RESULTS = HERE.parent / "results"
UNITS = Units("m", "MPa", force="MN")

YOUNG = 50_000.0  # MPa, both bricks
POISSON = {"upper": 0.277, "lower": 0.35}
SLIP_BOUND = 0.09  # MPa

# The paper's text allows two readings of where the second load acts; they differ in what sticks.
ENDS = {"free_end_1": "upper_free_end", "free_end_2": "lower_free_end"}


@dataclass(frozen=True)
class Scene:
    """What a user of FEniCSx has, and the pair of surfaces."""

    bricks: TaggedMesh
    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    load: Any


# %% [markdown]
# ## The scene
# Everything up to the last statement is an ordinary FEniCSx script.


# %%
def two_bricks(
    comm: MPI.Comm,
    N: int = 16,
    *,
    end: str = "free_end_1",
    hexahedra: bool = False,
    slip_bound: ScalarField = SLIP_BOUND,
    **parameters: float,
) -> Scene:
    """Return the scene with N cells along each brick; `parameters` are others of the .geo file."""
    bricks = read_gmsh(GEOMETRY, comm, N=N, Hex=int(hexahedra), **parameters)
    mesh, tags = bricks.mesh, bricks.tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

    poisson = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    for name, value in POISSON.items():
        poisson.x.array[bricks.cell_tags.find(tags[name])] = value
    mu = YOUNG / (2 * (1 + poisson))
    lame = YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
    load = fem.Constant(mesh, (0.0, 0.0, -1.0))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=bricks.facet_tags)
    L = ufl.inner(load, v) * ds((tags["upper_top"], tags[ENDS[end]]))
    bcs = [
        fem.dirichletbc(
            np.zeros(3),
            fem.locate_dofs_topological(V, 2, bricks.facet_tags.find(tags[name])),
            V,
        )
        for name in ("upper_fixed", "lower_fixed")
    ]
    pair = ContactPair(
        bricks.facet_tags,
        secondary=tags["upper_contact"],
        primary=tags["lower_contact"],
        friction=Tresca(slip_bound),
    )
    return Scene(bricks, V, a, L, bcs, pair, load)


# %% [markdown]
# ## Solve, print, write, draw
# The picture shows the bent bricks and, seen from above, the contact: only the half near the
# supports of the lower brick is pressed, and friction drags nodes that are open as well. That is
# what Tresca's law means: its bound does not depend on the pressure.


# %%
def solve(scene: Scene) -> ContactSolution:
    """Solve with a progress bar on the first rank."""
    comm = scene.V.mesh.comm
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs, units=UNITS) as problem:
        return problem.solve(observer=ProgressBar(comm))


def check(scene: Scene, solution: ContactSolution) -> None:
    """Assert what must hold: convergence, the contact law, and an error well below the mesh's."""
    solution.raise_if_failed()
    # P1 fields: their values are those at the nodes
    assert solution.pressure.x.array.min(initial=0.0) >= 0.0
    traction = np.linalg.norm(solution.traction.x.array.reshape(-1, 3), axis=1)
    assert traction.max(initial=0.0) <= SLIP_BOUND * (1 + 1e-12)
    assert solution.energy_error_bound < 0.15 * solution.discretisation_error


def main() -> None:
    """Run the demo."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    scene = two_bricks(MPI.COMM_WORLD)
    solution = solve(scene)
    check(scene, solution)
    if MPI.COMM_WORLD.rank == 0:
        print(solution)
    solution.write(RESULTS / "two_bricks.pvd")
    solution.plot(RESULTS / "two_bricks.png")


if __name__ == "__main__":
    main()
