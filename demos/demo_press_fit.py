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
# A quarter of it is enough; x = 0 and y = 0 are planes of symmetry. With 16 cells round a quarter
# of the hole it takes 5,995 nodes, 5 seconds and 550 MB; a number after the name of this script is
# another size.
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
import sys

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ProgressBar,
    SolutionWriter,
    Tresca,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N and energies in N mm.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 16  # cells round a quarter of the hole
radius, rim, thickness = 10.0, 30.0, 16.0  # mm
interference = 0.01  # mm
youngs_moduli = {"plate": 70_000.0, "pin": 210_000.0}  # MPa
poisson_ratios = {"plate": 0.33, "pin": 0.3}
friction_coefficient = 0.15
pushes = (0.0, 0.001, 0.002, 0.003, 0.004, 0.006, 0.01)  # mm, displacement of the top of the pin

ring = (rim**2 + radius**2) / (rim**2 - radius**2) + poisson_ratios["plate"]
shaft = 1 - poisson_ratios["pin"]
ring, shaft = ring / youngs_moduli["plate"], shaft / youngs_moduli["pin"]
lame_pressure = interference / (radius * (ring + shaft))  # MPa
slip_bound = friction_coefficient * lame_pressure  # MPa

# %% [markdown]
# ## Mesh and forms

# %%
fit = read_gmsh(
    MESHES / "press_fit.geo",
    comm,
    N=N,
    M=2 * (3 * N // 8),  # cells round a quarter of the pin
    Hex=1,
    Radius=radius,
    Rim=rim,
    Thickness=thickness,
    Interference=interference,
)
mesh, facets, tags = fit.mesh, fit.facet_tags, fit.tags
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
poisson = fem.Function(young.function_space)
for body in ("plate", "pin"):
    cells = fit.cell_tags.find(tags[body])
    young.x.array[cells] = youngs_moduli[body]
    poisson.x.array[cells] = poisson_ratios[body]
mu = young / (2 * (1 + poisson))
lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
L = ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx

# %% [markdown]
# The planes of symmetry hold both bodies sideways, the support and the pushed end along the axis.

# %%
push = fem.Constant(mesh, default_scalar_type(0.0))  # mm, of the top of the pin along z
zero = fem.Constant(mesh, default_scalar_type(0.0))
bcs = []
for surface, axis, value in (
    ("plate_x", 0, zero),
    ("plate_y", 1, zero),
    ("plate_support", 2, zero),
    ("pin_x", 0, zero),
    ("pin_y", 1, zero),
    ("pin_top", 2, push),
):
    dofs = fem.locate_dofs_topological(V.sub(axis), 2, facets.find(tags[surface]))
    bcs.append(fem.dirichletbc(value, dofs, V.sub(axis)))

# %% [markdown]
# ## Contact
# One problem serves all steps: only the prescribed displacement changes, K is factored once, and
# each step starts from the one before.

# %%
pair = ContactPair(
    facets,
    secondary=tags["plate_contact"],
    primary=tags["pin_contact"],
    friction=Tresca(slip_bound),
)
problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("mm", "MPa", force="N"))

# %% [markdown]
# ## What is measured
# The reaction at the pushed end is the work of the stress on a unit displacement of that end alone:
# it comes from the displacement, not from the multipliers, so the two can be compared.
#
# The stress is not known to the package, only to the form; the von Mises stress in the middle of
# each cell goes into the file as a field of our own.

# %%
uh = fem.Function(V)  # the displacement of each step
at_top = fem.Function(V)  # 1 along z in the nodes of the top of the pin, 0 in the others
at_top.x.array[dofs] = 1.0
push_force = fem.form(-ufl.action(ufl.action(a, uh), at_top))

stress = 2 * mu * ufl.sym(ufl.grad(uh)) + lame * ufl.div(uh) * ufl.Identity(3)
von_mises = fem.Function(young.function_space, name="von_mises")
middles = von_mises.function_space.element.basix_element.points
expression = fem.Expression(ufl.sqrt(1.5 * ufl.inner(ufl.dev(stress), ufl.dev(stress))), middles)

# %% [markdown]
# ## Solve
# Step 0 is the assembly. Each step is an equilibrium of its own: the slip counts from the
# undeformed bodies and not from the step before. In step 0 the force is not zero: the pin is
# squeezed and so grows longer, and its top is held.
#
# Each step is written as soon as it is there: ParaView shows a film, and its time is the push. In
# each the law of contact holds at all nodes.
#
# Forces are those of the quarter model. The nodes that slip could carry the slip bound times their
# area. The pressure is the mean over nodes in the middle half of the thickness, and at its edges.

# %%
if comm.rank == 0:
    print(f"Lame's pressure {lame_pressure:.2f} MPa, slip bound {slip_bound:.3f} MPa")
    print("push [mm]  force [N]  sliding at  sliding %  p middle    p edge")
writer = SolutionWriter("results/press_fit.pvd")
forces, sliding, in_middle, at_edge = [], [], [], []
for distance in pushes:
    push.value = -distance
    solution = problem.solve(rtol=1e-8, observer=ProgressBar(comm))
    solution.raise_if_failed()
    assert solution.pressure.x.array.min(initial=0.0) >= 0.0
    traction = np.linalg.norm(solution.traction.x.array.reshape(-1, 3), axis=1)
    assert traction.max(initial=0.0) <= slip_bound * (1 + 1e-12)

    uh.x.array[:] = solution.u.x.array
    von_mises.interpolate(expression)
    writer.write(solution, time=distance, fields=[von_mises])
    if distance == 0.0:
        solution.plot("results/press_fit_assembly.png")

    surface, space = solution.surface, solution.pressure.function_space
    nodes = slice(space.dofmap.index_map.size_local)  # of this rank
    from_middle = np.abs(space.tabulate_dof_coordinates()[nodes, 2] - thickness / 2)
    for means, some in (
        (in_middle, from_middle <= thickness / 4),
        (at_edge, from_middle >= thickness / 2 * (1 - 1e-9)),
    ):
        total = comm.allreduce(solution.pressure.x.array[nodes][some].sum())
        means.append(total / comm.allreduce(some.sum()))
    area = comm.allreduce(surface.weights.sum())
    sliding.append(comm.allreduce(surface.weights[~surface.sticking].sum()) / area)
    forces.append(comm.allreduce(fem.assemble_scalar(push_force)))
    if comm.rank == 0:
        print(
            f"{distance:8.3f} {forces[-1]:10.1f} {slip_bound * area * sliding[-1]:12.1f}"
            f" {100 * sliding[-1]:9.1f} {in_middle[-1]:10.2f} {at_edge[-1]:9.2f}"
        )
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check
# Lame's formula holds for a ring and a shaft of the same length, without friction. Here the pin is
# longer, and what sticks out hinders the squeezing: the pressure peaks at the edges of the hole. In
# the middle it is near the formula, within 1 percent at N = 16; 4 percent are allowed.
#
# The force on the pin is the integral of the tangential traction. It cannot pass g times the area
# of contact, 1455 N, and it is that force once all nodes slip along the axis (but for how they
# started).

# %%
assert abs(in_middle[0] / lame_pressure - 1) < 0.04
assert at_edge[0] > 1.05 * in_middle[0]
assert at_edge[-1] > 1.15 * in_middle[-1]
assert (np.diff(forces[:4]) > 0.0).all()
assert sliding[-1] > 1 - 1e-9
limit = slip_bound * area
assert abs(limit / (slip_bound * np.pi / 2 * radius * thickness) - 1) < 0.08 / N
assert max(forces) <= limit * (1 + 1e-6)
assert abs(forces[-1] / limit - 1) < 1e-3

solution.plot("results/press_fit_push_out.png")
