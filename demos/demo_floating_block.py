# %% [markdown]
# # A crane that nobody bolted down
#
# A small crane of concrete stands on stiff clay. Nothing fixes it: no Dirichlet condition, no
# spring. Its weight presses it on the ground, friction keeps it where it is, and that is all.
# Elsewhere such a body has to be tied with soft springs; here the script says nothing about it. The
# package finds that the crane can move as a rigid body, and asks the contact to balance its loads.
#
#                             | load, somewhere on the arm
#             +----+----------v-------+              z = 2.5 m
#             |        arm            |
#             |    +------------------+              z = 2
#             |post|       | weight
#             |    |       v
#        +----+    +----+                            z = 0.5
#        |     foot     | (x) pull, along y
#   +----+--------------+----+                       z = 0
#   |          clay          |
#   +------------------------+                       z = -1.2
#   //////////////////////////
#      x = -1    0    1    2
#
# How much of the foot slips while a tractor pulls at it? How far out may the load hang? And what
# does the package say where no equilibrium exists? With N = 16 it takes 10,509 nodes, 10 seconds
# and 600 MB.
#
# **Strong form.** In each body -div sigma(u) = f. In the contact, with the outward normal n of the
# foot and [u] = u_foot - u_clay: p >= 0, [u].n <= 0, p [u].n = 0. The tangential traction t obeys
# |t| <= g; where |t| < g nothing slides, where |t| = g the slip [u]_t points along t.
#
# **The slip bound.** Clay that has no time to drain is Tresca's material: it gives way at a shear
# stress that does not depend on the pressure. So the foot slides when the pull is g times its area,
# whatever the weight. (The model drags the foot by up to g also where it has lifted off.)
#
# **Statics.** The clay answers the vertical loads Q with a pressure whose resultant passes through
# the centre of pressure. The moments about it vanish, so with the weight W at x_W, the load P at
# x_P, and the pull H at the height z_H:
#
#     x = (W x_W + P x_P) / Q        y = z_H H / Q        Q = W + P
#
# A pressure that is nowhere negative has its centre below the foot. If x or y is outside the crane
# falls over, and no mesh can change that. The mesh only says which part of the foot presses.
#
# **Discrete form.** The crane's part of the stiffness matrix K is singular: six rigid motions. The
# multipliers, which are pressures and tractions, balance the loads for each of them exactly, at
# whatever accuracy the problem is solved, and the motions are found with them. The foot has 16
# cells along its side of 2 m, the clay 36 along 4 m: the meshes do not match. The multipliers live
# on the foot, which is 300 times stiffer. So the clay's cells are the smaller ones: on a stiff
# surface with more nodes than the soft one below it many pressures would do the same to the clay,
# and the iteration would be slow to choose among them.

# %%
from __future__ import annotations

import logging
import textwrap
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
    InputError,
    TaggedMesh,
    Tresca,
    Units,
    read_gmsh,
)

# %% [markdown]
# ## Data
# Lengths in m, forces in kN, stresses in kPa.

# %%
HERE = Path(__file__).parent
GEOMETRY = MESHES / "floating_block.geo"
RESULTS = HERE.parent / "results"
UNITS = Units("m", "kPa", force="kN")

SIDE, FOOT = 2.0, 0.5  # m, width and height of the foot
THICK, POST, ARM = 0.5, 1.5, 2.25  # m, of post and arm; height of the post, length of the arm
TROLLEY = 0.25  # m, length of the part of the arm on which the load hangs

YOUNG = {"clay": 100e3, "crane": 30e6}  # kPa
POISSON = {"clay": 0.4, "crane": 0.2}
UNIT_WEIGHT = 24.0  # kN/m^3, concrete
ADHESION = 25.0  # kPa, the slip bound
LIMIT = ADHESION * SIDE**2  # kN, the pull at which the crane slides


@dataclass(frozen=True)
class Loads:
    """What acts on the crane beside its weight."""

    load: float = 50.0  # kN, downwards
    x: float = 1.0  # m, where on the arm
    pull: float = 30.0  # kN, along y, at half the height of the foot


PULLS = (0.0, 30.0, 60.0, 80.0, 90.0, 97.0, 99.0)  # kN
PLACES = (0.5, 1.0, 1.5, 1.75, 2.0)  # m
SHOWN = Loads(x=1.5, pull=80.0)  # in the picture


# %% [markdown]
# ## Statics
# What the clay must do to the foot, by hand.


# %%
@dataclass(frozen=True)
class Reaction:
    """What the clay does to the foot."""

    force: np.ndarray  # (3,) kN
    centre: np.ndarray  # (2,) m, where the resultant of the pressure passes
    twist: float  # kN m, of the friction about the middle of the foot


def statics(loads: Loads) -> Reaction:
    """Return what balances the loads and the weight."""
    boxes = (  # volume and x of the middle
        (SIDE**2 * FOOT, 0.0),
        (THICK**2 * (POST + THICK), 0.0),
        (THICK**2 * ARM, (THICK + ARM) / 2),
    )
    weight = UNIT_WEIGHT * sum(volume for volume, _ in boxes)
    moment = UNIT_WEIGHT * sum(volume * x for volume, x in boxes)
    vertical = weight + loads.load
    centre = np.array([moment + loads.load * loads.x, loads.pull * FOOT / 2]) / vertical
    return Reaction(np.array([0.0, -loads.pull, vertical]), centre, 0.0)


# %% [markdown]
# ## The scene
# Only the bottom of the clay is fixed. The loads are `fem.Constant`s: new values are seen by the
# next `solve()`.


# %%
@dataclass(frozen=True)
class Scene:
    """What a user of FEniCSx has, the pair of surfaces, and what can be changed in place."""

    crane: TaggedMesh
    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    load: Any  # kN
    x: Any  # m
    pull: Any  # kN
    adhesion: Any  # kPa

    def set(self, loads: Loads) -> None:
        """Take other loads."""
        self.load.value, self.x.value, self.pull.value = loads.load, loads.x, loads.pull


def crane_on_clay(comm: MPI.Comm, N: int = 16, *, M: int | None = None) -> Scene:
    """Return the scene with N cells along the foot, a multiple of 16, and M along the clay."""
    M = round(9 * N / 4) if M is None else M
    crane = read_gmsh(
        GEOMETRY, comm, N=N, M=M, Side=SIDE, Foot=FOOT, Thick=THICK, Post=POST, Arm=ARM
    )
    mesh, tags = crane.mesh, crane.tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

    young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    poisson = fem.Function(young.function_space)
    for body in YOUNG:
        cells = crane.cell_tags.find(tags[body])
        young.x.array[cells] = YOUNG[body]
        poisson.x.array[cells] = POISSON[body]
    mu = young / (2 * (1 + poisson))
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def strain(u: Any) -> Any:
        return ufl.sym(ufl.grad(u))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx

    load, x, pull, adhesion = (fem.Constant(mesh, default_scalar_type(0.0)) for _ in range(4))
    adhesion.value = ADHESION
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=crane.cell_tags)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=crane.facet_tags)
    trolley = ufl.lt(abs(ufl.SpatialCoordinate(mesh)[0] - x), TROLLEY / 2)
    on_arm = ufl.conditional(trolley, load / (TROLLEY * THICK), 0.0)
    L = -UNIT_WEIGHT * v[2] * dx(tags["crane"])
    L += -on_arm * v[2] * ds(tags["arm_top"])
    L += pull / (SIDE * FOOT) * v[1] * ds(tags["foot_pulled"])

    fixed = fem.locate_dofs_topological(V, 2, crane.facet_tags.find(tags["clay_fixed"]))
    bcs = [fem.dirichletbc(np.zeros(3), fixed, V)]
    pair = ContactPair(
        crane.facet_tags,
        secondary=tags["foot_contact"],
        primary=tags["clay_contact"],
        friction=Tresca(adhesion),
    )
    scene = Scene(crane, V, a, L, bcs, pair, load, x, pull, adhesion)
    scene.set(Loads())
    return scene


# %% [markdown]
# ## What is measured
# The resultants come from the fields on the foot alone. A multiplier of the mortar method belongs
# to a node and its area; the vertex rule adds node by node, so it integrates them exactly, also
# when they are multiplied by x. (The usual rule takes the pressure as linear between the nodes,
# which moves the centre by some centimetres here, since the pressure peaks at the edges.)


# %%
@dataclass(frozen=True)
class State:
    """Figures of one solution."""

    loads: Loads
    found: Reaction
    pressed: float  # part of the foot's area
    sticking: float  # the same, pressed or not
    peak: float  # kPa, the largest pressure
    slip: float  # m, the largest


def measure(scene: Scene, loads: Loads, solution: ContactSolution) -> State:
    """Take the figures of a solution. Collective."""
    comm, surface = scene.V.mesh.comm, solution.surface
    x = ufl.SpatialCoordinate(surface.mesh)
    at_nodes = ufl.dx(
        domain=surface.mesh, metadata={"quadrature_rule": "vertex", "quadrature_degree": 1}
    )

    def total(values: Any) -> float:
        return float(comm.allreduce(fem.assemble_scalar(fem.form(values * at_nodes))))

    p, t = surface.pressure, surface.traction  # the foot feels p upwards, and -t
    vertical = total(p)
    found = Reaction(
        np.array([-total(t[0]), -total(t[1]), vertical]),
        np.array([total(x[0] * p), total(x[1] * p)]) / vertical,
        total(x[1] * t[0] - x[0] * t[1]),
    )
    slip = np.linalg.norm(surface.slip.x.array.reshape(-1, 3), axis=1)
    pressed = comm.allreduce(float(surface.weights[surface.touching].sum()))
    sticking = comm.allreduce(float(surface.weights[surface.sticking].sum()))
    return State(
        loads=loads,
        found=found,
        pressed=pressed / SIDE**2,
        sticking=sticking / SIDE**2,
        peak=comm.allreduce(p.x.array.max(initial=0.0), op=MPI.MAX),
        slip=comm.allreduce(slip.max(initial=0.0), op=MPI.MAX),
    )


# %% [markdown]
# ## Solve
# K is factored once; each solve starts from the one before. The first takes the default accuracy:
# the error of the iteration is a tenth of that of the mesh; even so the loads are balanced. The
# others count nodes that stick or press, and these have to be exact one by one.


# %%
def solve(
    scene: Scene, problem: ContactProblem, loads: Loads, **accuracy: float
) -> tuple[State, ContactSolution]:
    """Solve for these loads. Collective."""
    scene.set(loads)
    solution = problem.solve(**accuracy)
    solution.raise_if_failed()
    return measure(scene, loads, solution), solution


def balance(state: State) -> str:
    """Return the resultants beside those of statics."""
    by_hand, found = statics(state.loads), state.found
    rows = [
        ("force along x [kN]", found.force[0], by_hand.force[0]),
        ("force along y [kN]", found.force[1], by_hand.force[1]),
        ("force along z [kN]", found.force[2], by_hand.force[2]),
        ("centre of pressure, x [m]", found.centre[0], by_hand.centre[0]),
        ("centre of pressure, y [m]", found.centre[1], by_hand.centre[1]),
        ("twist about z [kN m]", found.twist, by_hand.twist),
    ]
    lines = [f"{'on the foot':<28}{'found':>14}{'statics':>14}"]
    lines += [f"{name:<28}{one + 0.0:14.8f}{two:14.8f}" for name, one, two in rows]
    return "\n".join(lines).replace("-0.00000000", " 0.00000000")


def pull_table(states: list[State]) -> str:
    """Return what happens while the pull grows."""
    lines = ["pull [kN]   sticking %   pressed %   slip [mm]"]
    for state in states:
        lines.append(
            f"{state.loads.pull:9.1f}{100 * state.sticking:13.1f}{100 * state.pressed:12.1f}"
            f"{1e3 * state.slip:12.2f}"
        )
    return "\n".join(lines)


def place_table(states: list[State]) -> str:
    """Return what happens while the load moves outwards."""
    lines = ["load at [m]   centre of pressure [m]   pressed %   peak [kPa]"]
    for state in states:
        lines.append(
            f"{state.loads.x:11.2f}{state.found.centre[0]:25.3f}{100 * state.pressed:12.1f}"
            f"{state.peak:13.0f}"
        )
    return "\n".join(lines)


# %% [markdown]
# ## What is refused
# Four scenes without an equilibrium. The package says so before it iterates, as an `InputError` on
# all ranks, and names the body and how it moves; the problem can be used again afterwards. Bodies
# have numbers: 2 is the crane.

# %%
REFUSED = (  # what happens, loads, slip bound, what the message must name
    ("the hook is stuck, and lifts the crane", Loads(-90.0, 0.375, 0.0), ADHESION, "along z"),
    ("pulled by more than friction holds", Loads(pull=LIMIT + 1.0), ADHESION, "along y"),
    ("ice below the foot, and nobody pulls", Loads(pull=0.0), 0.0, "rotation about z"),
    ("the load too far out: it falls over", Loads(x=2.25, pull=0.0), ADHESION, "about y"),
)


def refusal(scene: Scene, problem: ContactProblem, loads: Loads, adhesion: float) -> str:
    """Return the message of the error; empty if there is none. Collective."""
    scene.set(loads)
    scene.adhesion.value = adhesion
    try:
        problem.solve()
    except InputError as error:
        return str(error)
    finally:
        scene.adhesion.value = ADHESION
    return ""


# %% [markdown]
# ## Check
# Resultants to rounding, whatever the mesh. Of the rest, what must be: the more the tractor pulls
# the less sticks, and where all nodes slip in one direction the limit is reached; the farther out
# the load, the smaller the part of the foot that presses.


# %%
def check_balance(state: State) -> None:
    """Assert that the clay's forces balance the loads. Not collective."""
    by_hand, found = statics(state.loads), state.found
    rounding = 1e-9 * by_hand.force[2]
    assert np.abs(found.force - by_hand.force).max() < rounding, (found, by_hand)
    assert np.abs(found.centre - by_hand.centre).max() < 1e-9, (found, by_hand)
    assert abs(found.twist - by_hand.twist) < rounding, (found, by_hand)


def check(pulls: list[State], places: list[State]) -> None:
    """Assert what the figures must show. Not collective."""
    for state in (*pulls, *places):
        check_balance(state)
    assert all(after.sticking < before.sticking for before, after in pairwise(pulls))
    assert all(after.slip > before.slip for before, after in pairwise(pulls))
    assert pulls[-1].sticking < 0.1
    assert all(after.pressed < before.pressed for before, after in pairwise(places))
    assert all(after.peak > before.peak for before, after in pairwise(places))
    _, too_far, _, _ = REFUSED[-1]
    assert statics(places[-1].loads).centre[0] < SIDE / 2 < statics(too_far).centre[0]


def main() -> None:
    """Run the demo."""
    comm = MPI.COMM_WORLD
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    scene = crane_on_clay(comm)

    def say(*text: object) -> None:
        if comm.rank == 0:
            print(*text, sep="\n", flush=True)

    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs, units=UNITS) as problem:
        say(problem, "")
        first, solution = solve(scene, problem, Loads())
        say(solution, "", balance(first))
        pulls = [solve(scene, problem, Loads(pull=pull), rtol=1e-6)[0] for pull in PULLS]
        say(f"\nThe foot slides at {LIMIT:g} kN", pull_table(pulls))
        places = [solve(scene, problem, Loads(x=x), rtol=1e-6)[0] for x in PLACES]
        say(f"\nThe foot ends at {SIDE / 2:g} m", place_table(places))
        for what, loads, adhesion, named in REFUSED:
            message = refusal(scene, problem, loads, adhesion)
            say("", what, textwrap.indent(textwrap.fill(message, 96), "    "))
            assert named in message
        shown, solution = solve(scene, problem, SHOWN, rtol=1e-6)
    check(pulls, places)
    check_balance(shown)
    solution.write(RESULTS / "floating_block.pvd")
    solution.plot(RESULTS / "floating_block.png")


if __name__ == "__main__":
    main()
