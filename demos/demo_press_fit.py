# %% [markdown]
# # A press fit: a pin that is too thick for its hole
#
# A steel pin is pressed into the hole of an aluminium plate. Its radius is 0.1 percent larger than
# that of the hole, so the plate holds it by pressure and friction alone. First question: what is
# the pressure? Second: what force pushes the pin out? Third: what remains when the push is
# removed?
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
# of the hole it takes 5,995 nodes, 10 seconds and 550 MB; a number after the name of this script
# sets another mesh size.
#
# **Strong form.** In each body $-\operatorname{div} \sigma(u) = 0$. In the contact, with the
# outward normal $n$ of the hole and $[u] = u_{plate} - u_{pin}$,
#
# $$p \ge 0, \qquad [u] \cdot n \le d, \qquad p\,([u] \cdot n - d) = 0,$$
#
# with the gap $d = -0.01$ mm: the bodies overlap before they are deformed. The tangential traction
# $t$ obeys Coulomb's law, $|t| \le F p$: where $|t| < F p$ nothing slides.
#
# **Total and incremental slip.** Where $|t| = F p$ the slip points along $t$. Which slip? In a
# single `solve` it is $[u]_t$, the total slip from the undeformed bodies: friction then is like a
# spring that gives way, and when the push is removed the pin goes back by itself, as if it had
# never slipped. This is right for a load that only grows. Real friction resists the present motion:
# the slip in the law is $[u]_t - s$, where $s$ is the slip at the end of the last load step. This
# is the effect of `problem.accept()` after a `solve`. While the pin is pushed out the two laws give
# nearly the same result, since all slip has one direction; on the way back they differ entirely.
#
# **The formula.** A handbook takes Lame's pressure of a thick ring (o) on a shaft (i) with the
# interference $\delta$,
#
# $$p = \frac{\delta}{\dfrac{R}{E_o} \left( \dfrac{R_o^2 + R^2}{R_o^2 - R^2} + \nu_o \right)
# + \dfrac{R}{E_i} (1 - \nu_i)},$$
#
# and the push-out force $F p$ times the area. The formula neglects two effects that make the
# pressure higher: the pin sticks out on both sides, and it grows thicker where it is pushed.
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
    Coulomb,
    ProgressBar,
    SolutionWriter,
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
# mm, displacement of the top of the pin: out, and back
pushes = (0.0, 0.001, 0.002, 0.003, 0.004, 0.006, 0.01, 0.008, 0.006, 0.004, 0.002, 0.0)
farthest = pushes.index(max(pushes))

ring = (rim**2 + radius**2) / (rim**2 - radius**2) + poisson_ratios["plate"]
shaft = 1 - poisson_ratios["pin"]
ring, shaft = ring / youngs_moduli["plate"], shaft / youngs_moduli["pin"]
lame_pressure = interference / (radius * (ring + shaft))  # MPa
lame_force = friction_coefficient * lame_pressure * np.pi / 2 * radius * thickness  # N, a quarter

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
# each solve starts from the previous solution.

# %%
pair = ContactPair(
    facets,
    secondary=tags["plate_contact"],
    primary=tags["pin_contact"],
    friction=Coulomb(friction_coefficient),
    geometry=fit.geometry,
)
problem = ContactProblem(
    a, L, [pair], bcs=bcs, expected_solves=len(pushes), units=Units("mm", "MPa", force="N")
)

# %% [markdown]
# ## What is measured
# The reaction at the pushed end is the work of the stress on a unit displacement of this end alone:
# it comes from the displacement, not from the multipliers, so it can be compared with the contact
# force.
#
# The package does not know the stress, which only the form contains; the von Mises stress in the
# middle of each cell goes into the file as a field of our own.

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
# Step 0 is the assembly. Each step is accepted, so the slip of the next step is measured from where
# the nodes have slipped to. In step 0 the force is not zero: the pin is squeezed and so grows
# longer, and its top is held.
#
# Each step is written as soon as it is solved: ParaView shows a film, whose time is the number of
# the step. In each step the law of contact holds at all nodes.
#
# Forces are those of the quarter model; F times the normal force is the largest force that friction
# could carry. Two pressures are printed: the mean over nodes in the middle half of the thickness,
# and the mean at its edges.

# %%
if comm.rank == 0:
    print(f"Lame's pressure {lame_pressure:.2f} MPa, push-out force {lame_force:.1f} N")
    print("push [mm]  force [N]  F times normal  sliding %  p middle    p edge  dissipated [N mm]")
writer = SolutionWriter("results/press_fit.pvd")
forces, limits, sliding, dissipated, in_middle, at_edge = [], [], [], [], [], []
for step, distance in enumerate(pushes):
    push.value = -distance
    solution = problem.solve(rtol=1e-8, observer=ProgressBar(comm))
    solution.raise_if_failed()
    problem.accept()
    pressure = solution.pressure.x.array
    assert pressure.min(initial=0.0) >= 0.0
    traction = np.linalg.norm(solution.traction.x.array.reshape(-1, 3), axis=1)
    assert (traction <= friction_coefficient * pressure + 1e-6 * lame_pressure).all()

    uh.x.array[:] = solution.u.x.array
    von_mises.interpolate(expression)
    writer.write(solution, time=step, fields=[von_mises])
    if step == 0:
        solution.plot("results/press_fit_assembly.png")
    if step == farthest:
        solution.plot("results/press_fit_push_out.png")

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
    limits.append(friction_coefficient * solution.normal_force)
    dissipated.append(solution.total_dissipation)
    if comm.rank == 0:
        print(
            f"{distance:8.3f} {forces[-1]:10.1f} {limits[-1]:15.1f} {100 * sliding[-1]:10.1f}"
            f" {in_middle[-1]:9.2f} {at_edge[-1]:9.2f} {dissipated[-1]:18.3f}"
        )
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check
# Lame's formula holds for a ring and a shaft of the same length, without friction. Here the pin is
# longer, and its ends beyond the hole hinder the squeezing: the pressure peaks at the edges of the
# hole. In the middle it is near the formula, within 1 percent at N = 16; 4 percent are allowed.
#
# The force on the pin is the integral of the tangential traction. It cannot exceed F times the
# normal force, and equals it once all nodes slip along the axis. The formula gives some percent
# less, since its pressure is lower.
#
# The work of the push is stored in the bodies or dissipated. Between steps in which all nodes
# slide, the force is constant, and so all of this work is dissipated.
#
# When the push is removed the bodies spring back first, then friction changes its direction: when
# the top of the pin is back in its old position, the pin is in tension. According to a single
# solve, with the slip from the undeformed bodies, everything is as after the assembly; the last
# lines show this, for comparison.

# %%
forces, limits = np.array(forces), np.array(limits)
assert abs(in_middle[0] / lame_pressure - 1) < 0.04
assert at_edge[0] > 1.05 * in_middle[0]
assert (np.diff(forces[:5]) > 0.0).all()
assert (np.abs(forces) <= limits * (1 + 1e-6)).all()
out = forces[farthest]
assert sliding[farthest] > 1 - 1e-9
assert abs(out / limits[farthest] - 1) < 1e-3
assert 1.0 < out / lame_force < 1.06
assert (np.diff(dissipated) >= 0.0).all()
pushed_in = out * (pushes[farthest] - pushes[farthest - 1])
assert abs((dissipated[farthest] - dissipated[farthest - 1]) / pushed_in - 1) < 1e-2
assert forces[-1] < -0.5 * out

problem.set_slip_origin(None)
total = problem.solve(rtol=1e-8)
total.raise_if_failed()
uh.x.array[:] = total.u.x.array
total_force = comm.allreduce(fem.assemble_scalar(push_force))
if comm.rank == 0:
    print(f"push-out force {out:.1f} N, by the formula {lame_force:.1f} N")
    print(f"after the push: {forces[-1]:.1f} N; if total slip counted: {total_force:.1f} N")
assert abs(total_force - forces[0]) < 1e-3 * out
