# %% [markdown]
# # Impact: a bar hits a wall, and a block slides until friction has stopped it
#
# Dynamics needs nothing beyond static problems: each time step is one contact problem, with
# the mass in `a` and the state at its beginning in `L`. Here are two scenes whose answer is known.
#
#        wall                                       <- v0
#         |    +--------------------------------------+         y
#         |    |                 bar                  |         |
#         |    +--------------------------------------+         +-- x
#         |  x = 0                                  x = l
#
#              +----------+  -> v0
#              |  block   |
#       _______|__________|_____________________________  F, Coulomb's friction
#              |<---------- v0^2 / (2 F g) --------->|
#
# With 100 cells along the bar and 40 along the block it takes 404 and 861 nodes, 20 seconds and 250
# MB; a number after the name of this script sets the number of cells along the bar; the block has
# 2/5 of this number.
#
# **Strong form.** With the density $\rho$
#
# $$\rho \ddot u - \operatorname{div} \sigma(u) = f, \qquad
# p \ge 0, \quad [u] \cdot n \le d, \quad p\,([u] \cdot n - d) = 0, \qquad |t| \le F p,$$
#
# where $|t| < F p$ nothing slides, and elsewhere the *velocity* of the slip points along $t$.
#
# **Time steps.** With $u_\theta = \theta u_1 + (1 - \theta) u_0$ for a step from 0 to 1 of length
# $\tau$, and $v_\theta$ alike,
#
# $$u_1 - u_0 = \tau v_\theta, \qquad m(v_1 - v_0, w) / \tau + k(u_\theta, w) = f(w) +
# \text{contact},$$
#
# and contact and friction obey their laws at the *end* of the step: $[u_1] \cdot n \le d$, and the
# slip of the step, $[u_1 - u_0]$, points along $t$. With $v_1$ eliminated that is a contact problem
# for $u_1$ with
#
# $$a(u, w) = \frac{m(u, w)}{\theta \tau^2} + \theta k(u, w), \qquad
# L(w) = f(w) + \frac{m(u_0 + \tau v_0, w)}{\theta \tau^2} - (1 - \theta) k(u_0, w).$$
#
# **Energy.** Take $w = u_1 - u_0$. The sum of kinetic, strain and potential energy changes by
#
# $$E_1 - E_0 = -(\theta - \tfrac12) \left( |v_1 - v_0|_m^2 + |u_1 - u_0|_k^2 \right)
# - p \cdot [u_1 - u_0]_n - t \cdot [u_1 - u_0]_t.$$
#
# For $\theta \ge 1/2$ no term is positive: where there is pressure at the end of the step, the gap
# is closed at the end, and it was not negative at the beginning; the last term is minus the energy
# that friction dissipates. So the energy cannot grow, whatever the length of the steps. (C. Kane,
# E. A. Repetto, M. Ortiz and J. E. Marsden 1999 found this for Newmark's method, which is $\theta =
# 1/2$.) Newmark's method and the HHT method with contact forces at their usual time have no such
# bound. $\theta = 1$ is the backward Euler method, which damps waves; a little more than 1/2 damps
# the waves that the mesh cannot carry.
#
# **A surface without mass.** A node of mass $m$ that meets the wall loses $m v_0^2 / 2$ at once, an
# error of the mesh; then its force jumps from step to step, here between 0.45 and 1.55 times the
# value of theory. So the nodes of the contact get no mass (H. B. Khenous, P. Laborde and Y. Renard
# 2008); the next nodes have it instead. The contact nodes are then in static equilibrium with their
# neighbours, and the force is that of the wave.
#
# **Theory of the bar.** A wave of pressure $\rho c v_0$, $c = \sqrt{E / \rho}$, runs to the free
# end and back. The bar is in contact for $2 l / c$, and then flies off with $v_0$ and without
# stress.
#
# **Theory of the block.** Friction decelerates it by $F g$: it stops after the time $v_0 / (F g)$
# and the distance $v_0^2 / (2 F g)$, and stays at rest.

# %%
import math
import sys

from mpi4py import MPI

import matplotlib
import numpy as np

import ufl
from dolfinx import fem
from dolfinx import mesh as meshes

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    RigidPlane,
    SolutionWriter,
    Units,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# In SI units. In plane strain, and with Poisson's ratio zero for the bar, its waves are those of
# one dimension. Forces are those of 1 m of thickness.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 100  # cells along the bar
bar = {"length": 1.0, "height": 0.03, "young": 2.1e11, "poisson": 0.0, "density": 7850.0}  # steel
block = {"length": 0.2, "height": 0.1, "young": 5e6, "poisson": 0.3, "density": 1100.0}  # rubber
impact_speed, distance = 1.0, 5e-5  # m/s and m, of the bar from the wall
sliding_speed, friction_coefficient, gravity = 1.0, 0.3, 9.81  # m/s, -, m/s^2
units = Units("m", "Pa", force="N")


# %% [markdown]
# ## Forms of a step
# The mass is lumped, by quadrature at the nodes; `density` is a function of degree 1, zero on the
# side of the contact, and 1.5 times the density of the material at the next layer of nodes.


# %%
def box(body, cells, contact_axis):
    """Return a space on a box, facets of the side x_axis = 0 with the tag 1, and the density."""
    size = (body["length"], body["height"])
    mesh = meshes.create_rectangle(
        comm, [(0.0, 0.0), size], cells, cell_type=meshes.CellType.quadrilateral
    )
    thickness = size[contact_axis] / cells[contact_axis]  # of a layer of cells
    side = meshes.locate_entities_boundary(mesh, 1, lambda x: x[contact_axis] < thickness / 4)
    tags = meshes.meshtags(mesh, 1, side, np.full(len(side), 1, dtype=np.int32))
    density = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
    layers = np.array([0.0, 1.5, 1.0]) * body["density"]
    density.interpolate(
        lambda x: layers[np.minimum(np.rint(x[contact_axis] / thickness).astype(int), 2)]
    )
    return fem.functionspace(mesh, ("Lagrange", 1, (2,))), tags, density


def products_of_forms(body, density):
    """Return mass and stiffness as functions of two displacements."""
    mu = body["young"] / (2 * (1 + body["poisson"]))
    lame = 2 * mu * body["poisson"] / (1 - 2 * body["poisson"])
    nodes = ufl.dx(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})

    def mass(u, w):
        return density * ufl.inner(u, w) * nodes

    def stiffness(u, w):
        strain, virtual = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(w))
        stress = 2 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(2)
        return ufl.inner(stress, virtual) * ufl.dx

    return mass, stiffness


def step_forms(mass, stiffness, u, v, tau, theta):
    """Return a, and L without loads, of a step that begins at displacement u, velocity v."""
    trial, test = ufl.TrialFunction(u.function_space), ufl.TestFunction(u.function_space)
    inertia = 1 / (theta * tau**2)
    a = inertia * mass(trial, test) + theta * stiffness(trial, test)
    L = inertia * mass(u + tau * v, test) - (1 - theta) * stiffness(u, test)
    return a, L


def move(u, v, new, tau, theta):
    """Advance displacement and velocity to the end of a step."""
    v.x.array[:] += ((new.x.array - u.x.array) / tau - v.x.array) / theta
    u.x.array[:] = new.x.array


def total(form):
    """Return the value of a form, summed over all ranks."""
    return comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)


# %% [markdown]
# ## The bar
# Waves run through half a cell in a step. K is factored once, when the problem is made; each step
# begins with the pressure and the known products with A of the previous step. With theta = 1/2 only
# the impact itself may take energy.

# %%
RTOL = 1e-8
theta = 0.5
wave_speed = math.sqrt(bar["young"] / bar["density"])
contact_time = 2 * bar["length"] / wave_speed
wave_pressure = bar["density"] * wave_speed * impact_speed
tau = 0.5 * bar["length"] / N / wave_speed

V, tags, density = box(bar, (N, 3), contact_axis=0)
mass, stiffness = products_of_forms(bar, density)
u, v = fem.Function(V, name="displacement"), fem.Function(V, name="velocity")
v.interpolate(lambda x: np.vstack([np.full_like(x[0], -impact_speed), np.zeros_like(x[0])]))
a, L = step_forms(mass, stiffness, u, v, tau, theta)
wall = RigidPlane(point=(-distance, 0.0), normal=(1.0, 0.0))
pair = ContactPair(tags, 1, wall, Frictionless())
steps = math.ceil((distance / impact_speed + 1.3 * contact_time) / tau)
kinetic, strain = fem.form(0.5 * mass(v, v)), fem.form(0.5 * stiffness(u, u))

times = tau * np.arange(1, steps + 1)
forces, products = np.zeros(steps), np.zeros(steps, dtype=int)
energies = np.zeros((steps + 1, 2))  # kinetic and strain energy, at the ends of steps
energies[0] = total(kinetic), total(strain)
writer = SolutionWriter("results/impact_bar.pvd")
with ContactProblem(a, L, [pair], units=units, expected_solves=steps) as problem:
    for step in range(steps):
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        move(u, v, solution.u, tau, theta)
        forces[step], products[step] = solution.normal_force, solution.products
        energies[step + 1] = total(kinetic), total(strain)
        if step % 8 == 0:
            writer.write(solution, time=times[step], fields=[v])
if comm.rank == 0:
    print(f"{steps} steps, {products.mean():.1f} products with A a step, at most {products.max()}")

# %% [markdown]
# Check: the pressure of the wave (in the middle half of the time of contact, when ripples have
# gone), the time of contact, and the velocity and energy of the bar that flies off. Behind a front
# that the mesh cannot carry ripples of length $h^{2/3}$ remain, and the rebound lacks their energy.

# %%
energy = energies.sum(axis=1)
pressures = forces / bar["height"]
(pressed,) = np.nonzero(pressures)
middle = pressures[pressed[len(pressed) // 4 : -len(pressed) // 4]]
found_time = tau * len(pressed)
momentum = bar["density"] * bar["length"] * impact_speed
rebound = (tau * pressures.sum() / momentum - 1) * impact_speed
if comm.rank == 0:
    print(f"pressure      {middle.mean() / 1e6:8.3f} MPa, theory {wave_pressure / 1e6:8.3f}")
    print(f"contact time  {found_time * 1e6:8.1f} us,  theory {contact_time * 1e6:8.1f}")
    print(f"rebound       {rebound:8.4f} m/s, theory {impact_speed:8.4f}")
    print(f"energy        {energy[-1] / energy[0]:8.5f} of what it was")
assert np.abs(middle / wave_pressure - 1).max() < 4 / N**2
assert abs(found_time / contact_time - 1) < 0.3 * N ** (-2 / 3)
assert abs(rebound / impact_speed - 1) < 0.4 * N ** (-2 / 3)
assert np.diff(energy).max() < RTOL * energy[0]
assert energy[-1] > (1 - 0.1 / N) * energy[0]

# %% [markdown]
# ## The block
# First it lies on the floor under its weight: a static problem, in which a corner is held against
# sliding. Slip counts from this state (`set_slip_origin`). Then the block gets its velocity, and
# each step is accepted. Steps are much longer than the block's vibrations; theta = 0.6 damps these,
# and shortens the path of the block only by $(\theta - 1/2)\, \tau v_0$.

# %%
theta = 0.6
braking = friction_coefficient * gravity
stopping_time, stopping_distance = sliding_speed / braking, sliding_speed**2 / (2 * braking)
tau = stopping_time / 80
V, tags, density = box(block, (2 * N // 5, N // 5), contact_axis=1)
mass, stiffness = products_of_forms(block, density)
trial, test = ufl.TrialFunction(V), ufl.TestFunction(V)
down, along = (fem.Constant(V.mesh, direction) for direction in ((0.0, -gravity), (1.0, 0.0)))
weight = mass(down, test)
floor = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))

V.mesh.topology.create_connectivity(0, 2)
corner = meshes.locate_entities_boundary(V.mesh, 0, lambda x: x[0] + x[1] < 1e-9)
held = fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(0), 0, corner), V.sub(0))
pair = ContactPair(tags, 1, floor, Frictionless())
with ContactProblem(stiffness(trial, test), weight, [pair], [held], units=units) as at_rest:
    u = at_rest.solve(rtol=RTOL).u
v = fem.Function(V, name="velocity")
v.interpolate(lambda x: np.vstack([np.full_like(x[0], sliding_speed), np.zeros_like(x[0])]))

# %%
a, L = step_forms(mass, stiffness, u, v, tau, theta)
pair = ContactPair(tags, 1, floor, Coulomb(friction_coefficient))
steps = 120
kinetic = fem.form(0.5 * mass(v, v))
potential = fem.form(0.5 * stiffness(u, u) - mass(down, u))
body_mass = total(fem.form(mass(along, along)))
place, speed = fem.form(mass(along, u)), fem.form(mass(along, v))  # times the mass

block_times = tau * np.arange(steps + 1)
block_energies, friction_work = np.zeros((steps + 1, 2)), np.zeros(steps + 1)
motion = np.zeros((steps + 1, 2))  # place and velocity of the centre of mass
backwards, products = np.zeros(steps), np.zeros(steps, dtype=int)
block_energies[0] = total(kinetic), total(potential)
motion[0] = total(place) / body_mass, sliding_speed
writer = SolutionWriter("results/impact_block.pvd")
with ContactProblem(a, L + weight, [pair], units=units, expected_solves=steps) as problem:
    problem.set_slip_origin(u)
    for step in range(steps):
        solution = problem.solve(rtol=RTOL)
        problem.accept()
        move(u, v, solution.u, tau, theta)
        slip = solution.slip_increment.x.array[0::2]
        backwards[step] = comm.allreduce(slip.min(initial=0.0), op=MPI.MIN)
        products[step] = solution.products
        block_energies[step + 1] = total(kinetic), total(potential)
        friction_work[step + 1] = solution.total_dissipation
        motion[step + 1] = total(place) / body_mass, total(speed) / body_mass
        if step % 3 == 0:
            writer.write(solution, time=block_times[step + 1], fields=[v])
if comm.rank == 0:
    print(solution)
    print(f"{steps} steps, {products.mean():.1f} products with A a step, at most {products.max()}")

# %% [markdown]
# Check: where and when the block stops; that it stays there and sticks everywhere in the end; and
# that no node has slid back by more than a part of the block's shear $\rho F g h^2 / G$, which is
# released when the block stops. Energy does not grow, and friction has dissipated all of it, except
# for the small part that the time stepping with theta dissipated.

# %%
shear_modulus = block["young"] / (2 * (1 + block["poisson"]))
shear = block["density"] * braking * block["height"] ** 2 / shear_modulus
# times a speed: error of the distance; divided by a time: relative error of the energy
numerical = (theta - 0.5) * tau
moved = motion[:, 0] - motion[0, 0]
stopped = block_times[np.nonzero(motion[:, 1] < 0.01 * sliding_speed)[0][0]]
energy = block_energies.sum(axis=1)
if comm.rank == 0:
    print(f"stops after   {stopped:8.4f} s, theory {stopping_time:8.4f}")
    print(f"          and {moved[-1]:8.4f} m, theory {stopping_distance:8.4f}")
    print(f"slid back by  {-backwards.sum():8.1e} m, shear of the block {shear:.1e}")
    print(f"friction took {friction_work[-1] / block_energies[0, 0]:8.4f} of the kinetic energy")
after = block_times > stopping_time + 10 * tau
assert abs(stopped - stopping_time) < 2 * tau
assert abs(moved[-1] - stopping_distance) < numerical * sliding_speed + shear
assert np.ptp(moved[after]) < 0.1 * shear
assert solution.counts.stick == solution.counts.contact == problem.contact_nodes
assert -backwards.sum() < shear
assert np.diff(energy).max() < RTOL * block_energies[0, 0]
taken = friction_work[-1] / block_energies[0, 0]
assert abs(1 - taken) < 2 * numerical / stopping_time + 0.01

# %% [markdown]
# ## Draw

# %%
if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(9, 5.6), layout="constrained")
    start = distance / impact_speed
    theory = dict(color="black", lw=1, ls="--", label="theory")
    panels[0, 0].plot(1e6 * times, pressures / 1e6, lw=1.5, label="found")
    box_times = start + contact_time * np.array([0, 0, 1, 1])
    panels[0, 0].plot(1e6 * box_times, wave_pressure / 1e6 * np.array([0, 1, 1, 0]), **theory)
    panels[0, 0].set(title="bar", ylabel="contact pressure [MPa]")
    ends = np.concatenate([[0.0], times])
    for part, name in zip(energies.T, ("kinetic", "strain"), strict=True):
        panels[1, 0].plot(1e6 * ends, part, label=name)
    panels[1, 0].plot(1e6 * ends, energies.sum(axis=1), color="black", lw=1, label="sum")
    panels[1, 0].set(xlabel="time [µs]", ylabel="energy [J/m]", ylim=(0, None))

    fine = np.linspace(0, block_times[-1], 200)
    until = np.minimum(fine, stopping_time)
    panels[0, 1].plot(block_times, motion[:, 1], label="velocity [m/s]")
    panels[0, 1].plot(block_times, 5 * moved, label="way [0.2 m]")
    panels[0, 1].plot(fine, sliding_speed - braking * until, **theory)
    panels[0, 1].plot(fine, 5 * (sliding_speed * until - braking * until**2 / 2), "k--", lw=1)
    panels[0, 1].set(title="block")
    panels[1, 1].plot(block_times, block_energies[:, 0], label="kinetic")
    panels[1, 1].plot(block_times, friction_work, label="friction took")
    above_rest = energy - energy[-1]
    panels[1, 1].plot(block_times, above_rest, color="black", lw=1, label="sum, above rest")
    panels[1, 1].set(xlabel="time [s]", ylabel="energy [J/m]", ylim=(0, None))
    for panel in panels.flat:
        panel.spines[["top", "right"]].set_visible(False)
        panel.set_xlim(0, None)
        panel.legend(frameon=False)
    figure.savefig("results/impact.png", dpi=150)
