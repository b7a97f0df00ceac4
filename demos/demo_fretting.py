# %% [markdown]
# # Fretting: a ball pressed and rubbed on a plate
#
# A steel ball is pressed on a steel plate and then moved to and fro by less than a micrometre. It
# does not slide, but it is not at rest either: the middle of the contact sticks, and round it there
# is an annulus that slips with each stroke. In such an annulus bearings, blade roots and wires of
# ropes wear and crack. How wide is it, and how much energy goes into it?
#
#                 motion, to and fro
#                     <------>
#             +--------------------+  z = R
#              \                  /                          slips
#               \      ball      /                         .-------.
#                 `.          .'                          / .-----. \
#       +------------`-.__.-'-----------+  z = 0         | | sticks| |
#       |                               |                 \ `-----' /
#       |            plate              |                  `-------'
#       +-------------------------------+  z = -R          |<- 2c ->|
#       /////////////////////////////////                |<--- 2a --->|
#
# y = 0 is a plane of symmetry, and half of the bodies is modelled. (x = 0 is not one: pressing is
# symmetric about it, rubbing antisymmetric.) With 12 cells along the radius of the contact it takes
# 11,946 nodes, 50 seconds and 500 MB; a number after the name of this script sets another mesh
# size.
#
# **Strong form.** In each body $-\operatorname{div} \sigma(u) = 0$. In the contact, with the
# outward normal $n$ of the plate, $[u] = u_{plate} - u_{ball}$, and the gap $d$,
#
# $$p \ge 0, \qquad [u] \cdot n \le d, \qquad p\,([u] \cdot n - d) = 0.$$
#
# The tangential traction $t$ obeys Coulomb's law, $|t| \le F p$: where $|t| < F p$ nothing slides.
#
# **Load steps.** Friction dissipates, so the traction depends on the path that led to the present
# load, not on the load alone. In a single `solve` the slip counts from the undeformed state: this
# is right for one load that grows. After `problem.accept()` the slip of the next solve counts from
# the accepted step: where $|t| = F p$ it is the slip *increment* that points along $t$.
#
# **Theory.** Hertz gives the pressure under the normal force $P$, $p = p_0 \sqrt{1 - r^2/a^2}$. If
# a tangential force $Q$ grows after that, a disc of radius $c$ sticks; with the shift
# $\delta$ of the ball (C. Cattaneo 1938, R. D. Mindlin 1949)
#
# $$c = a \left( 1 - \frac{Q}{F P} \right)^{1/3}, \qquad
# t = F p_0 \left( \sqrt{1 - \frac{r^2}{a^2}} - \frac{c}{a} \sqrt{1 - \frac{r^2}{c^2}} \right),$$
#
# $$\delta = 2\, \frac{3 F P (2 - \nu)}{16\, a G}
# \left( 1 - \left( 1 - \frac{Q}{F P} \right)^{2/3} \right).$$
#
# When the force turns at $Q^*$, everything sticks at once, and a new annulus grows from the edge as
# if the contact were fresh and $F$ twice as large: traction and shift go back by twice the values
# for the force $(Q^* - Q)/2$ (R. D. Mindlin and H. Deresiewicz 1953; Masing's rule). After a whole
# cycle the loop closes; its area is the dissipated energy (K. L. Johnson, Contact Mechanics,
# section 7.4):
#
# $$W = \frac{9 F^2 P^2 (2 - \nu)}{5\, a G}
# \left( 1 - s^5 - \frac{5 Q^*}{6 F P} (1 + s^2) \right), \qquad
# s = \left( 1 - \frac{Q^*}{F P} \right)^{1/3}.$$
#
# **Why two equal bodies?** The theory assumes that shear does not change the pressure. This holds
# if both bodies are of the same material, since shear lifts the surface of one body where it lowers
# the other; on a rigid plane it holds only for a Poisson's ratio of 0.5. The theory also takes the
# bodies for half-spaces, an error of order a/R, and all slip as parallel to Q, which is nearly
# true.

# %%
import math
import sys

from mpi4py import MPI

import matplotlib
import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ContactState,
    Coulomb,
    SolutionWriter,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N and energies in N mm, which are mJ. The ball
# is that of a usual test rig; the peak pressure comes to 1.5 GPa.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 12  # cells along the radius of the contact
radius = 5.0  # mm, of the ball
young, poisson = 210_000.0, 0.3  # MPa, -
friction_coefficient = 0.5
about_a = 0.1  # mm, the radius of the contact, about
cell = 1 / N  # size of the cells at the contact, divided by that radius
RTOL = 1e-7

shear_modulus = young / (2 * (1 + poisson))

# %% [markdown]
# ## Mesh and forms
# Small cells where the bodies touch, and sizes that grow with distance.

# %%
bodies = read_gmsh(
    MESHES / "ball_on_plate.geo", comm, R=radius, h=cell * about_a, Zone=1.3 * about_a
)
mesh, facets, tags = bodies.mesh, bodies.facet_tags, bodies.tags
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * shear_modulus * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
L = ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx

motion = fem.Constant(mesh, np.zeros(3))  # mm, of the cut through the middle of the ball
cut = fem.locate_dofs_topological(V, 2, facets.find(tags["ball_cut"]))
bottom = fem.locate_dofs_topological(V, 2, facets.find(tags["plate_bottom"]))
middle = fem.locate_dofs_topological(V.sub(1), 2, facets.find(tags["symmetry"]))
bcs = [
    fem.dirichletbc(motion, cut, V),
    fem.dirichletbc(np.zeros(3), bottom, V),
    fem.dirichletbc(default_scalar_type(0.0), middle, V.sub(1)),
]

# %% [markdown]
# ## Contact
# K is factored once for all steps.

# %%
pair = ContactPair(
    facets,
    secondary=tags["plate_contact"],
    primary=tags["ball_contact"],
    friction=Coulomb(friction_coefficient),
)
problem = ContactProblem(
    a, L, [pair], bcs=bcs, expected_solves=60, units=Units("mm", "MPa", force="N")
)


def move(x, z):
    """Move the ball; accept and return the solution, with both forces [N] on the whole ball."""
    motion.value[:] = x, 0.0, z
    solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    problem.accept()
    along, _, down = 2 * solution.resultants()[0].force  # on the plate
    return solution, along, -down


def gathered(solution):
    """Return x, y, pressure, traction that drags the plate along x, and state of all nodes."""
    space = solution.pressure.function_space
    owned = space.dofmap.index_map.size_local
    columns = (
        *space.tabulate_dof_coordinates()[:owned, :2].T,
        solution.pressure.x.array[:owned],
        -solution.traction.x.array.reshape(-1, 3)[:owned, 0],
        solution.state.x.array[:owned],
    )
    return [np.concatenate(comm.allgather(column)) for column in columns]


# %% [markdown]
# ## Press
# Pressing is the first step. The motion is prescribed, the force is a result, and theory is
# evaluated for the computed force. A little friction acts already, since the meshes do not match;
# bodies with equal meshes would slip nowhere.

# %%
approach = about_a**2 / radius  # mm
pressed, _, P = move(0.0, -approach)
if comm.rank == 0:
    print(problem, pressed, sep="\n\n", end="\n\n")

FP = friction_coefficient * P
contact_radius = (1.5 * P * radius * (1 - poisson**2) / young) ** (1 / 3)
peak = 1.5 * P / (math.pi * contact_radius**2)
full_shift = 2 * 3 * FP * (2 - poisson) / (16 * contact_radius * shear_modulus)  # where Q = F P


def stick_radius(Q):
    return contact_radius * (1 - abs(Q) / FP) ** (1 / 3)


def shift(Q, turned_at=None):
    if turned_at is not None:  # on the way from Q* to -Q*, or back
        return shift(turned_at) - 2 * shift((turned_at - Q) / 2)
    return math.copysign(full_shift * (1 - (1 - abs(Q) / FP) ** (2 / 3)), Q)


def traction(r, Q, turned_at=None):
    if turned_at is not None:
        return traction(r, turned_at) - 2 * traction(r, (turned_at - Q) / 2)
    outer, inner = (
        np.sqrt(np.maximum(1 - (r / s) ** 2, 0)) for s in (contact_radius, stick_radius(Q))
    )
    return math.copysign(friction_coefficient * peak, Q) * (
        outer - stick_radius(Q) / contact_radius * inner
    )


def cycle_work(Q):
    s = stick_radius(Q) / contact_radius
    scale = 9 * FP**2 * (2 - poisson) / (5 * contact_radius * shear_modulus)
    return scale * (1 - s**5 - 5 * Q / (6 * FP) * (1 + s**2))


# %% [markdown]
# ## Energy of a cycle
# Cycles of several amplitudes follow, each from the state after pressing, to which
# `set_slip_origin` returns. While slip keeps its direction, friction does the same work in one step
# as in many: after the first step to one side, two more steps make a cycle, to the other side and
# back.

# %%
if comm.rank == 0:
    print("Q*/(F P)   W [uJ]  theory   stick radius/a  theory   closes to")
works = []
for part in (0.4, 0.55, 0.7, 0.8, 0.9):
    problem.set_slip_origin(pressed.u)
    amplitude = shift(part * FP)
    first, Q, _ = move(amplitude, -approach)
    there, _, _ = move(-amplitude, -approach)
    back, Q_after, _ = move(amplitude, -approach)
    works.append((Q, 2 * (there.dissipation + back.dissipation)))
    surface = first.surface
    sticks = comm.allreduce(surface.weights[surface.touching & surface.sticking].sum())
    found_c = math.sqrt(2 * sticks / math.pi)
    if comm.rank == 0:
        print(
            f"{Q / FP:8.3f} {1e3 * works[-1][1]:8.3f} {1e3 * cycle_work(Q):7.3f}"
            f" {found_c / contact_radius:16.3f} {stick_radius(Q) / contact_radius:7.3f}"
            f" {abs(Q_after / Q - 1):11.0e}"
        )
    # in the narrow annuli of small amplitudes there are few cells
    annulus = (contact_radius - stick_radius(Q)) / about_a
    assert abs(works[-1][1] / cycle_work(Q) - 1) < 0.3 * cell / annulus
    assert abs(found_c - stick_radius(Q)) < cell * about_a
    assert abs(Q_after / Q - 1) < 0.01 * cell

# %% [markdown]
# ## One cycle in steps
# The steps are loading, the way to the other side, and the way back. ParaView shows the series as a
# film, whose time is the number of the step. The last cell makes another film, which has the loop
# as well: an mp4 if matplotlib finds ffmpeg, else a gif.

# %%
problem.set_slip_origin(pressed.u)
writer = SolutionWriter("results/fretting.pvd")
writer.write(pressed, time=0)
up = np.linspace(0.0, shift(0.9 * FP), 7)
down = np.linspace(up[-1], -up[-1], 13)
path = np.concatenate([up, down[1:], down[-2::-1]])
turns = (len(up) - 1, len(up) + len(down) - 2)  # the last steps before it turns round

forces, normals, dissipated, snapshots = [0.0], [P], [0.0], [gathered(pressed)]
for step, place in enumerate(path[1:], start=1):
    solution, Q, normal = move(place, -approach)
    writer.write(solution, time=step)
    forces.append(Q)
    normals.append(normal)
    dissipated.append(2 * solution.total_dissipation)
    snapshots.append(gathered(solution))
forces = np.array(forces)
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check
# Checked are the law of contact at each node, in each step; the normal force, which the shear must
# not change; and the agreement with theory. A mesh smears the pressure at its steep edge over one
# ring of cells: the root mean square of this error is about h/a times the traction.
#
# Masing's rule needs no theory of half-spaces: the way back is the first loading, twice as large.
# Its error is about as large as the relative changes of pressures and of directions of slip. And
# the area of the loop is the energy that friction has dissipated, except for the corners of the
# loop, which straight lines between the steps cut off.

# %%
for _, _, p, t, _ in snapshots:
    assert p.min() >= 0.0
    assert (np.abs(t) <= friction_coefficient * p + 1e-5 * peak).all()
assert max(abs(normal / P - 1) for normal in normals) < 0.02 * cell

Q_star = forces[turns[0]]
for k, (place, Q) in enumerate(zip(path, forces, strict=True)):
    sign = -1 if k > turns[1] else 1
    turned_at = None if k <= turns[0] else Q_star
    theory = sign * shift(sign * Q, turned_at)
    assert abs(place - theory) < 0.3 * cell * abs(path).max()

back = forces[turns[0] : turns[1] + 1 : 2]  # steps of twice the length of those of `up`
masing = np.abs((Q_star - back) / 2 - forces[: len(up)]).max() / FP
closes = abs(forces[-1] / Q_star - 1)
assert masing < 0.03 * cell
assert closes < 0.01 * cell

x, y, _, t, _ = snapshots[turns[0]]
r = np.hypot(x, y)
difference = np.linalg.norm(t - traction(r, Q_star)) / np.linalg.norm(traction(r, Q_star))
assert difference < 1.2 * cell + contact_radius / radius

loop = slice(turns[0], None)
enclosed = np.trapezoid(forces[loop], path[loop])
work = dissipated[-1] - dissipated[turns[0]]
assert abs(enclosed / work - 1) < 0.02
if comm.rank == 0:
    print(f"\nforces are off Masing's rule by {masing:.1e} F P, the loop closes to {closes:.0e}")
    print(f"traction is off Mindlin's by {difference:.1%}, root mean square")
    print(f"the loop encloses {1e3 * enclosed:.3f} uJ, friction dissipates {1e3 * work:.3f} uJ")

# %% [markdown]
# ## Draw
# The pictures are the loop; the plate from above at the end of the first loading; the traction then
# and on the way back, when the middle still has the traction of the first loading while the edge is
# dragged the other way; and the energies. Lines are theory.


# %%
def draw_loop(axes, last):
    Q = np.linspace(-1, 1, 400) * Q_star
    first = np.linspace(0, 1, 200) * Q_star
    axes.plot([1e3 * shift(q) for q in first], first, color="grey", lw=1, label="theory")
    axes.plot([1e3 * shift(q, Q_star) for q in Q], Q, color="grey", lw=1)
    axes.plot([-1e3 * shift(q, Q_star) for q in Q], -Q, color="grey", lw=1)
    axes.plot(1e3 * path[: last + 1], forces[: last + 1], ".", color="C0", label="load steps")
    axes.plot(1e3 * path[last], forces[last], "o", color="C3", ms=7)
    axes.set(xlabel="shift of the ball [µm]", ylabel="tangential force [N]")
    axes.legend(loc="upper left", frameon=False)


def draw_plate(axes, step):
    x, y, _, t, state = snapshots[step]
    x, y = np.tile(x, 2), np.append(y, -y)  # the other half
    t = np.tile(t, 2) / (friction_coefficient * peak)
    sticks = np.tile(state == ContactState.STICK, 2)
    slips = np.tile(state == ContactState.SLIP, 2)
    shown = axes.tripcolor(1e3 * x, 1e3 * y, t, shading="gouraud", cmap="RdBu_r", vmin=-1, vmax=1)
    axes.plot(1e3 * x[sticks], 1e3 * y[sticks], "k.", ms=3, label="sticks")
    axes.plot(
        1e3 * x[slips], 1e3 * y[slips], "o", color="k", mfc="none", ms=3, mew=0.5, label="slips"
    )
    if step <= turns[0]:
        stick = stick_radius(forces[step])
    else:  # a fresh contact with twice the coefficient of friction
        turned_at = Q_star if step <= turns[1] else -Q_star
        stick = stick_radius((turned_at - forces[step]) / 2)
    for circle in (contact_radius, stick):
        angle = np.linspace(0, 2 * np.pi, 200)
        axes.plot(1e3 * circle * np.cos(angle), 1e3 * circle * np.sin(angle), color="grey", lw=1)
    axes.set(xlabel="x [µm]", ylabel="y [µm]", aspect="equal")
    axes.legend(loc="upper right", frameon=False, fontsize=8, handletextpad=0.1)
    return shown


if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.animation
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(8.8, 7.2), layout="constrained")
    draw_loop(panels[0, 0], len(path) - 1)
    shown = draw_plate(panels[0, 1], turns[0])
    figure.colorbar(shown, ax=panels[0, 1], label="traction along x / (F p0)")

    r_fine = np.linspace(0, 1.3 * contact_radius, 500)
    for step, turned_at, label, marker in (
        (turns[0], None, "at Q*", "."),
        (turns[0] + 6, Q_star, "half-way back", "x"),
    ):
        x, y, _, t, _ = snapshots[step]
        (line,) = panels[1, 0].plot(
            np.hypot(x, y) / contact_radius, t / peak, marker, ms=4, label=label
        )
        theory = traction(r_fine, forces[step], turned_at)
        panels[1, 0].plot(r_fine / contact_radius, theory / peak, color=line.get_color(), lw=1)
    panels[1, 0].plot(
        r_fine / contact_radius,
        friction_coefficient * np.sqrt(np.maximum(1 - (r_fine / contact_radius) ** 2, 0)),
        color="grey",
        lw=1,
        ls="--",
        label="F p",
    )
    panels[1, 0].set(xlabel="r / a", ylabel="traction along x / p0", xlim=(0, 1.3))
    panels[1, 0].legend(frameon=False)

    amplitudes = np.linspace(0.2, 0.99, 100) * FP
    panels[1, 1].loglog(amplitudes, [1e3 * cycle_work(Q) for Q in amplitudes], color="grey", lw=1)
    panels[1, 1].loglog(*np.array([(Q, 1e3 * work) for Q, work in works]).T, "o", ms=4)
    ticks = (4, 6, 8, 10, 15)
    panels[1, 1].set_xticks(ticks, [str(tick) for tick in ticks])
    panels[1, 1].minorticks_off()
    panels[1, 1].set(xlabel="amplitude of the force [N]", ylabel="energy of a cycle [µJ]")
    figure.savefig("results/fretting.png", dpi=150)

    film, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.9))
    film.subplots_adjust(left=0.08, right=0.98, bottom=0.14, top=0.97)

    def draw_frame(step):
        for axes in (left, right):
            axes.clear()
        draw_loop(left, step)
        left.set(xlim=1.1e3 * path[turns[0]] * np.array([-1, 1]))
        draw_plate(right, step)

    frames = matplotlib.animation.FuncAnimation(film, draw_frame, frames=len(path))
    ffmpeg = matplotlib.animation.writers.is_available("ffmpeg")
    frames.save(
        "results/fretting.mp4" if ffmpeg else "results/fretting.gif",
        writer="ffmpeg" if ffmpeg else "pillow",
        fps=6,
        dpi=110,
    )
