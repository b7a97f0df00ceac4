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
# does the package say where no equilibrium exists? With 16 cells along the foot it takes 10,509
# nodes, 10 seconds and 600 MB; a number after the name of this script, a multiple of 8, sets
# another mesh size.
#
# **Strong form.** In each body $-\operatorname{div} \sigma(u) = f$. In the contact, with the
# outward normal $n$ of the foot and $[u] = u_{foot} - u_{clay}$,
#
# $$p \ge 0, \qquad [u] \cdot n \le 0, \qquad p\,[u] \cdot n = 0.$$
#
# The tangential traction $t$ obeys $|t| \le g$; where $|t| < g$ nothing slides, where $|t| = g$ the
# slip $[u]_t$ points along $t$.
#
# **The slip bound.** Clay that has no time to drain is Tresca's material: it gives way at a shear
# stress that does not depend on the pressure. So the foot slides when the pull is g times its area,
# whatever the weight. (The model drags the foot by up to g also where it has lifted off.)
#
# **Statics.** The clay answers the vertical loads Q with a pressure whose resultant passes through
# the centre of pressure. The moments about it vanish, so with the weight $W$ at $x_W$, the load $P$
# at $x_P$, and the pull $H$ at the height $z_H$,
#
# $$x = \frac{W x_W + P x_P}{Q}, \qquad y = \frac{z_H H}{Q}, \qquad Q = W + P.$$
#
# A pressure that is nowhere negative has its centre below the foot. If the point (x, y) is not
# below the foot, the crane falls over, on any mesh. The mesh only decides which part of the foot
# presses.
#
# **Discrete form.** The crane's part of the stiffness matrix K is singular: six rigid motions. The
# multipliers, which are pressures and tractions, balance the loads for each of these motions
# exactly, whatever the accuracy of the solution, and the motions are found with the multipliers.
# The foot has 16 cells along its side of 2 m, the clay 36 along 4 m: the meshes do not match. The
# multipliers live on the foot, which is 300 times stiffer. So the clay has the smaller cells: if
# the stiff surface had more nodes than the soft one below it, many different pressures would have
# the same effect on the clay, and the iteration would be slow to choose among them.

# %%
import sys
import textwrap

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    InputError,
    Tresca,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in m, forces in kN, stresses in kPa.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 16  # cells along the foot
side, foot = 2.0, 0.5  # m, width and height of the foot
thick, post, arm = 0.5, 1.5, 2.25  # m, of post and arm; height of the post, length of the arm
trolley = 2 * side / N  # m, the part of the arm on which the load hangs: two cells

youngs_moduli = {"clay": 100e3, "crane": 30e6}  # kPa
poisson_ratios = {"clay": 0.4, "crane": 0.2}
unit_weight = 24.0  # kN/m^3, concrete
cohesion = 25.0  # kPa, the slip bound
limit = cohesion * side**2  # kN, the pull at which the crane slides

# %% [markdown]
# ## Mesh and forms
# Only the bottom of the clay is fixed. The two other loads, besides the weight, are a load on the
# arm and a pull at half the height of the foot. They are `fem.Constant`s, whose new values the next
# `solve()` uses.

# %%
crane = read_gmsh(
    MESHES / "floating_block.geo",
    comm,
    N=N,
    M=9 * N // 4,  # cells along the clay
    Side=side,
    Foot=foot,
    Thick=thick,
    Post=post,
    Arm=arm,
)
mesh, facets, tags = crane.mesh, crane.facet_tags, crane.tags
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
poisson = fem.Function(young.function_space)
for body in ("clay", "crane"):
    cells = crane.cell_tags.find(tags[body])
    young.x.array[cells] = youngs_moduli[body]
    poisson.x.array[cells] = poisson_ratios[body]
mu = young / (2 * (1 + poisson))
lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx

load = fem.Constant(mesh, default_scalar_type(50.0))  # kN, downwards
place = fem.Constant(mesh, default_scalar_type(1.0))  # m, where on the arm
pull = fem.Constant(mesh, default_scalar_type(30.0))  # kN, along y
on_trolley = ufl.lt(abs(ufl.SpatialCoordinate(mesh)[0] - place), trolley / 2)
dx = ufl.Measure("dx", domain=mesh, subdomain_data=crane.cell_tags)
ds = ufl.Measure("ds", domain=mesh, subdomain_data=facets)
L = -unit_weight * v[2] * dx(tags["crane"])
L += -ufl.conditional(on_trolley, load / (trolley * thick), 0.0) * v[2] * ds(tags["arm_top"])
L += pull / (side * foot) * v[1] * ds(tags["foot_pulled"])

fixed = fem.locate_dofs_topological(V, 2, facets.find(tags["clay_fixed"]))
bcs = [fem.dirichletbc(np.zeros(3), fixed, V)]

# %% [markdown]
# ## Contact
# K is factored once; each solve starts from the previous solution.

# %%
adhesion = fem.Constant(mesh, default_scalar_type(cohesion))  # kPa
pair = ContactPair(
    facets,
    secondary=tags["foot_contact"],
    primary=tags["clay_contact"],
    friction=Tresca(adhesion),
)
problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("m", "kPa", force="kN"))
if comm.rank == 0:
    print(problem)


# %% [markdown]
# ## Forces against statics
# By hand: statics gives the force on the foot and the point through which the resultant of the
# pressure passes; there is no twist about the vertical through the middle of the foot. The weight
# is that of three boxes.
#
# Computed: `solution.resultants` has sums over nodes of force and moment on the foot. (Integrals of
# the fields in ParaView take the pressure as linear between the nodes, which moves the centre by
# some centimetres here, since the pressure peaks at the edges.) The two agree to nine digits,
# whatever the mesh and the accuracy of the solution.


# %%
def statics():
    boxes = (  # volume and x of the middle
        (side**2 * foot, 0.0),
        (thick**2 * (post + thick), 0.0),
        (thick**2 * arm, (thick + arm) / 2),
    )
    weight = unit_weight * sum(volume for volume, _ in boxes)
    moment = unit_weight * sum(volume * x for volume, x in boxes)
    vertical = weight + load.value
    x, y = moment + load.value * place.value, pull.value * foot / 2
    return np.array([0.0, -pull.value, vertical, x / vertical, y / vertical, 0.0])


def resultants(solution):
    (foot,) = solution.resultants(point=(0.0, 0.0, 0.0))  # in the plane of contact
    (*_, vertical), (about_x, about_y, twist) = foot.force, foot.moment
    return np.array([*foot.force, -about_y / vertical, about_x / vertical, twist])


# %% [markdown]
# With the default accuracy the error of the iteration is a tenth of the error of the mesh; even so
# the loads are balanced.

# %%
solution = problem.solve()
solution.raise_if_failed()
by_hand, found = statics(), resultants(solution)
names = ["force along x", "force along y", "force along z", "centre x", "centre y", "twist"]
if comm.rank == 0:
    print(solution)
    print(f"\n{'on the foot [kN, m]':<20}{'found':>14}{'statics':>14}")
    for row in zip(names, found.round(8) + 0.0, by_hand, strict=True):
        print("{:<20}{:14.8f}{:14.8f}".format(*row))
rounding = 1e-9 * by_hand[2]
assert np.abs(found - by_hand).max() < rounding

# %% [markdown]
# ## A tractor pulls
# The more it pulls, the smaller is the part of the foot that sticks; the limit is reached when all
# nodes slip in one direction. Since nodes are counted here, each of them has to be exact.

# %%
if comm.rank == 0:
    print(f"\nThe foot slides at {limit:g} kN\npull [kN]   sticking %   pressed %   slip [mm]")
sticks, slips = [], []
for value in (0.0, 30.0, 60.0, 80.0, 90.0, 97.0, 99.0):
    pull.value = value
    solution = problem.solve(rtol=1e-6)
    solution.raise_if_failed()
    surface = solution.surface
    assert np.abs(resultants(solution) - statics()).max() < rounding
    sticks.append(comm.allreduce(surface.weights[surface.sticking].sum()) / side**2)
    slips.append(solution.greatest_slip)
    pressed = comm.allreduce(surface.weights[surface.touching].sum()) / side**2
    if comm.rank == 0:
        print(f"{value:9.1f}{100 * sticks[-1]:13.1f}{100 * pressed:12.1f}{1e3 * slips[-1]:12.2f}")
assert (np.diff(sticks) < 0.0).all() and sticks[-1] < 0.1
assert (np.diff(slips) > 0.0).all()

# %% [markdown]
# ## The load moves outwards
# The farther out the load hangs, the smaller is the part of the foot that presses.

# %%
pull.value = 30.0
if comm.rank == 0:
    print(f"\nThe foot ends at {side / 2:g} m")
    print("load at [m]   centre of pressure [m]   pressed %   peak [kPa]")
presses, peaks = [], []
for value in (0.5, 1.0, 1.5, 1.75, 2.0):
    place.value = value
    solution = problem.solve(rtol=1e-6)
    solution.raise_if_failed()
    surface, centre = solution.surface, statics()[3]
    assert np.abs(resultants(solution) - statics()).max() < rounding
    presses.append(comm.allreduce(surface.weights[surface.touching].sum()) / side**2)
    peaks.append(solution.peak_pressure)
    if comm.rank == 0:
        print(f"{value:11.2f}{centre:25.3f}{100 * presses[-1]:12.1f}{peaks[-1]:13.0f}")
assert centre < side / 2
assert (np.diff(presses) < 0.0).all()
assert (np.diff(peaks) > 0.0).all()

# %% [markdown]
# ## What is refused
# Four scenes without an equilibrium. The package says so before it iterates, as an `InputError` on
# all ranks, and names the body and how it moves; the problem can be used again afterwards. Bodies
# have numbers: 2 is the crane.

# %%
for what, values, named in (  # load, place, pull, slip bound
    ("the hook is stuck, and lifts the crane", (-90.0, 0.375, 0.0, cohesion), "along z"),
    ("pulled by more than friction holds", (50.0, 1.0, limit + 1.0, cohesion), "along y"),
    ("ice below the foot, and nobody pulls", (50.0, 1.0, 0.0, 0.0), "rotation about z"),
    ("the load too far out: it falls over", (50.0, 2.25, 0.0, cohesion), "about y"),
):
    load.value, place.value, pull.value, adhesion.value = values
    try:
        problem.solve()
        message = "not refused"
    except InputError as error:
        message = str(error)
    if comm.rank == 0:
        print(f"\n{what}\n{textwrap.indent(textwrap.fill(message, 96), '    ')}")
    assert named in message
assert statics()[3] > side / 2  # as statics says of the last scene

# %% [markdown]
# ## Draw

# %%
load.value, place.value, pull.value, adhesion.value = 50.0, 1.5, 80.0, cohesion
solution = problem.solve(rtol=1e-6)
solution.raise_if_failed()
solution.write("results/floating_block.pvd")
solution.plot("results/floating_block.png")
