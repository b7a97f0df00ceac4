# %% [markdown]
# # A block on a rigid ball, on a milled plate, and on a rigid ring
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
# In the second part the block is rubbed on a plate whose grooves lead it aside; in the third part a
# ring takes the place of the ball, given by a function that the user writes: the distance of points
# from the ring. With 32 cells along the block, 9,801 nodes, all three parts take half a minute and
# 700 MB; a number after the name of this script sets another mesh size.
#
# **Strong form.** In the block
#
# $$-\operatorname{div} \sigma(u) = 0, \qquad
# \sigma = 2 \mu \varepsilon + \lambda \operatorname{tr}(\varepsilon) I.$$
#
# On its bottom, with the normal $n$ of the obstacle that points to the block and the distance $d$,
# the pressure $p$ obeys
#
# $$p \ge 0, \qquad d + u \cdot n \ge 0, \qquad p\,(d + u \cdot n) = 0.$$
#
# The tangential traction $t$ obeys $|t| \le g$; where $|t| < g$ nothing slides, where $|t| = g$ the
# slip points along $t$.
#
# **Friction.** Tresca's bound $g$ does not depend on the pressure, and where it is positive it
# drags open nodes as well. So it should be zero where no contact is expected. Here it is a
# coefficient of friction times the pressure that Hertz found for a ball on a half-space: a guess
# that costs nothing, good as long as the contact is small compared with the block. In this scene
# the guess is a fifth too low.

# %%
import math
import sys

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    Tresca,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 32  # cells along the block
young, poisson = 10.0, 0.4  # MPa, rubber
length, height = 24.0, 12.0  # mm, the block, as wide as long
approach, push = 0.6, 0.15  # mm, the top goes down by this, and along x on the ball
ball_radius = 40.0  # mm
friction_coefficient = 0.3
along_grooves, across_grooves = 0.1, 0.4  # coefficients of friction of the milled plate
rub = 6.0  # mm, the top goes along x on the plate
ring_radius, tube_radius = 6.0, 6.0  # mm, of the ring's middle line and of its cross-section

# %% [markdown]
# ## Mesh and forms

# %%
block = read_gmsh(
    MESHES / "block.geo", comm, N=N, Hex=1, Grading=1.2, Lx=length, Ly=length, Lz=height
)
mesh, facets = block.mesh, block.facet_tags
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
mu = young / (2 * (1 + poisson))
lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
L = ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx

motion = fem.Constant(mesh, (push, 0.0, -approach))
top = facets.find(block.tags["top"])
bcs = [fem.dirichletbc(motion, fem.locate_dofs_topological(V, 2, top), V)]

# %% [markdown]
# ## The ball
# The bottom of the block is the secondary side. The obstacle takes the place of the tag of the
# primary side. The bound is a function of points, an array of shape (3, n).

# %%
ball = RigidSphere(center=(0.0, 0.0, -ball_radius), radius=ball_radius)
contact_radius = math.sqrt(ball_radius * approach)  # Hertz, on a half-space
peak = 2 * young / (1 - poisson**2) * contact_radius / (math.pi * ball_radius)


def slip_bound(x):
    inside = 1 - (x[0] ** 2 + x[1] ** 2) / contact_radius**2
    return friction_coefficient * peak * np.sqrt(np.maximum(inside, 0.0))


on_ball = ContactPair(facets, block.tags["bottom"], ball, Tresca(slip_bound))
problem = ContactProblem(a, L, [on_ball], bcs=bcs, units=Units("mm", "MPa", force="N"))
solution = problem.solve(rtol=1e-6)  # gaps are checked node by node
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check the law of contact
# Pressure and gap at each node: no tension, no penetration, and where there is pressure there is no
# gap. The residual of 1e-6 is a mean over the nodes: the error of a single node may be some hundred
# times as large.

# %%
solution.raise_if_failed()
pressure, gap = solution.pressure.x.array, solution.gap.x.array
assert pressure.min(initial=0.0) >= 0.0
assert gap.min(initial=0.0) >= -1e-4 * approach
assert np.abs(gap[pressure > 0.0]).max(initial=0.0) <= 1e-4 * approach

bound = fem.Function(solution.pressure.function_space)
bound.interpolate(slip_bound)
traction = np.linalg.norm(solution.traction.x.array.reshape(-1, 3), axis=1)
assert (traction <= bound.x.array * (1 + 1e-9) + 1e-12).all()

# %% [markdown]
# ## Check the balance of forces
# The force of the ball on the block, by pressure and friction, and the force of the clamp at the
# top must balance. The force of the ball is an integral over the contact; `traction` acts on the
# ball, so it is subtracted. The force of the clamp is the work of the stresses on a unit
# displacement of the top.

# %%
vectors = fem.functionspace(solution.surface.mesh, ("Lagrange", 1, (3,)))
contact_stress = fem.Function(vectors)
_, normal = ball.at(vectors.tabulate_dof_coordinates())
contact_stress.x.array[:] = (pressure[:, None] * normal).ravel() - solution.traction.x.array

contact, clamp = np.zeros(3), np.zeros(3)
for i in range(3):
    unit = fem.Function(V)
    unit.x.array[fem.locate_dofs_topological(V.sub(i), 2, top)] = 1.0
    work = ufl.action(ufl.action(a, solution.u), unit)
    contact[i] = comm.allreduce(fem.assemble_scalar(fem.form(contact_stress[i] * ufl.dx)))
    clamp[i] = comm.allreduce(fem.assemble_scalar(fem.form(work)))
if comm.rank == 0:
    print("on the block  ", np.round(contact, 3), "N")
assert np.linalg.norm(contact + clamp) < 1e-6 * np.linalg.norm(clamp)

# %% [markdown]
# The picture shows the contact from above: dots are nodes that stick; the arrows are slip, also of
# the open nodes, which nothing holds.

# %%
solution.write("results/rigid_ball.pvd")
solution.plot("results/rigid_ball.png")

# %% [markdown]
# ## The milled plate
# Milling leaves grooves, here at 45 degrees to the push. Along them friction is low, across them it
# is high: Coulomb's law with an ellipse in place of the circle,
#
# $$(t_1 / F_1)^2 + (t_2 / F_2)^2 \le p^2.$$
#
# The block is pushed far enough to slide nearly everywhere, and the plate pushes it aside.

# %%
plate = RigidPlane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
grooves = np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)
milled = Coulomb((along_grooves, across_grooves), direction=grooves)
on_plate = ContactPair(facets, block.tags["bottom"], plate, milled)
problem = ContactProblem(a, L, [on_plate], bcs=bcs, units=Units("mm", "MPa", force="N"))
motion.value = (rub, 0.0, -approach)
solution = problem.solve(rtol=1e-6)
if comm.rank == 0:
    print(solution)
force = solution.pair_resultants[0].force  # on the block

# %% [markdown]
# The law at each node, along and across the grooves: tractions are on the ellipse where the block
# slides, and the slip is normal to it (the associated rule). So the force is not against the push
# but nearly across the grooves.

# %%
solution.raise_if_failed()
across = np.array([-1.0, 1.0, 0.0]) / math.sqrt(2.0)
frame = np.column_stack([grooves, across])
coefficients = np.array([along_grooves, across_grooves])
pressure = solution.pressure.x.array
traction = solution.traction.x.array.reshape(-1, 3) @ frame
slip = solution.slip.x.array.reshape(-1, 3) @ frame
used = np.linalg.norm(traction / coefficients, axis=1)  # relative to the pressure
assert (used <= pressure * (1 + 1e-6) + 1e-9).all()
normal_to_ellipse = traction / coefficients**2
turned = np.cross(np.pad(slip, ((0, 0), (0, 1))), np.pad(normal_to_ellipse, ((0, 0), (0, 1))))[:, 2]
sizes = np.linalg.norm(slip, axis=1) * np.linalg.norm(normal_to_ellipse, axis=1)
slides = np.linalg.norm(slip, axis=1) > 1e-2 * rub
assert comm.allreduce(int(slides.sum())) > 0
assert np.abs(turned[slides]).max(initial=0.0) <= 1e-3 * sizes.max(initial=1.0)
if comm.rank == 0:
    sideways = math.degrees(math.atan2(force[1], -force[0]))
    print(f"the plate pushes the block {sideways:.0f} degrees aside")
assert abs(force[1]) > 0.5 * abs(force[0])

solution.write("results/milled_plate.pvd")
solution.plot("results/milled_plate.png")

# %% [markdown]
# ## The ring
# A user's own obstacle is a function of points. It returns their distance from the obstacle,
# positive outside, and the direction in which this distance grows, the normal.


# %%
def distance_from_ring(x):
    to_axis = np.hypot(x[0], x[1])
    outwards, upwards = to_axis - ring_radius, x[2] + tube_radius
    to_middle_line = np.hypot(outwards, upwards)
    # on the axis no radial direction is given: take x
    along = np.where(to_axis > 0.0, x[:2] / np.maximum(to_axis, 1e-300), [[1.0], [0.0]])
    return to_middle_line - tube_radius, np.vstack([along * outwards, upwards]) / to_middle_line


ring = RigidObstacle(distance_from_ring, name="a rigid ring")
on_ring = ContactPair(facets, block.tags["bottom"], ring, Frictionless())
problem = ContactProblem(a, L, [on_ring], bcs=bcs, units=Units("mm", "MPa", force="N"))
motion.value = (0.0, 0.0, -approach)
solution = problem.solve(rtol=1e-6)
if comm.rank == 0:
    print(solution)

# %% [markdown]
# The law of contact is checked again, and where the block touches: on a band around the top of the
# ring, narrower than the part of the block that the ring overlaps. In the picture the pressed part
# is this band.

# %%
solution.raise_if_failed()
pressure, gap = solution.pressure.x.array, solution.gap.x.array
assert pressure.min(initial=0.0) >= 0.0
assert gap.min(initial=0.0) >= -1e-4 * approach
assert np.abs(gap[pressure > 0.0]).max(initial=0.0) <= 1e-4 * approach
points = solution.pressure.function_space.tabulate_dof_coordinates()[pressure > 0.0]
off = np.abs(np.hypot(points[:, 0], points[:, 1]) - ring_radius)
assert off.max(initial=0.0) < math.sqrt(2 * tube_radius * approach)

solution.write("results/rigid_ring.pvd")
solution.plot("results/rigid_ring.png")
