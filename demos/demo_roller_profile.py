# %% [markdown]
# # The crown of a roller: the profile that makes the pressure even
#
# A straight roller on a raceway presses hardest with its ends, where it cracks first. Bearing
# rollers are therefore crowned: some micrometres thinner towards the ends. How much, and where?
# G. Lundberg found in 1939 that a load which is the same on each millimetre of the length needs a
# logarithmic profile. Here an optimiser finds the profile from the contact problem alone, with the
# derivatives of the peak pressure by the height at each of 13 stations: one adjoint solve gives all
# of them.
#
#         .------------------------------.          p |\              /|  straight
#        /            roller              \           | `------------' |
#       |  - - - - - - - - - - - - - - -  |           | .------------. |  crowned
#     ---`.____________________________.'---          |/              \|
#                     raceway                         +----------------+ y
#         |<------------- L ------------->|        -L/2                L/2
#
# **Model.** As in the theory of bearings both bodies are taken for one half-space with their common
# modulus $1/E^* = \sum (1 - \nu^2)/E$, and the shape of the roller is the gap between the plane
# surface of the half-space and a rigid plane: $x^2/2R + z(y)$, with the unknown profile $z$. The
# half-space is a block, a quarter of it by symmetry, which is held far away.
#
# **The optimum.** The peak is not a smooth function of the profile: its derivative jumps when the
# peak moves from one point to another. The norm of the pressure in $L^8$ is smooth, and is
# minimised instead:
#
# $$\min_z \; \Bigl( \int p^8 \Bigr)^{1/8} \quad\text{for}\quad \int p = Q.$$
#
# **Theory.** A line load $Q/L$ moves the surface of a half-space by
# $\tfrac{Q}{\pi L E^*} \ln \left( 1 - (2y/L)^2 \right)$ and a constant, so the profile
#
# $$z(y) = \frac{Q}{\pi L E^*} \ln \frac{1}{1 - (2y/L)^2}$$
#
# gives this load (G. Lundberg, Elastische Berührung zweier Halbräume, Forsch. Ing.-Wes. 10, 1939),
# and across the roller the pressure is that of Hertz, with the half width $a = \sqrt{4QR/\pi L
# E^*}$ and the peak $p_0 = 2Q/\pi L a$. *An even line load is not an even pressure*: at its ends
# the half-space beyond helps to carry, the strip of contact becomes narrower, and an even pressure
# has a smaller line load there. So the profile that is found must be a little higher than
# Lundberg's, but finite at the end.
#
# With 5 cells over the half width of the contact it takes 9,600 nodes and 40 seconds; a number
# after the name of this script sets another number of cells.

# %%
import math
import sys

from mpi4py import MPI

import matplotlib
import numpy as np
from scipy.optimize import minimize

import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.mesh import CellType, create_box, locate_entities_boundary, meshtags

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Frictionless,
    NormalForce,
    PressureNorm,
    RigidPlane,
    Units,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Steel on steel; lengths in mm, stresses in MPa, forces in N.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 5  # cells over the half width of the contact
radius, length = 5.0, 6.0  # mm, of the roller
half_width, poisson = 0.2, 0.3  # mm, of the contact by Hertz; -
common_modulus = 210_000.0 / (1 - poisson**2) / 2  # MPa, E* of two bodies of steel

line_load = math.pi * common_modulus * half_width**2 / (4 * radius)  # N/mm, Q/L
load = line_load * length  # N
hertz_peak = 2 * line_load / (math.pi * half_width)  # MPa
unit = line_load / (math.pi * common_modulus)  # mm, of Lundberg's profile

# %% [markdown]
# ## Mesh and forms
# The cells are bricks: small where the roller presses, finer towards its end, and growing beyond
# it. The stations are the planes of nodes along the roller.


# %%
def growing(places, end, growth=1.5):
    """Return coordinates, continued up to an end by further ones at growing distances."""
    places = list(places)
    while places[-1] < end:
        places.append(places[-1] + growth * (places[-1] - places[-2]))
    return np.minimum(places, end)


far, number = 12.0, 13  # mm, where the block is held; stations on a half of the roller
stations = np.sin(np.linspace(0, 0.97 * np.pi / 2, number))
stations *= length / 2 / stations[-1]
size = half_width / N
near = size * np.arange(3 * N // 2 + 1)
axes = growing(near, far), growing(stations, far), -growing(near, far)
mesh = create_box(
    comm,
    [np.zeros(3), np.array([len(places) - 1.0 for places in axes])],
    [len(places) - 1 for places in axes],
    CellType.hexahedron,
)
x = mesh.geometry.x
for k, places in enumerate(axes):
    x[:, k] = places[np.rint(x[:, k]).astype(int)]

tiny = 1e-3 * size
contact = locate_entities_boundary(
    mesh, 2, lambda x: (x[2] > -tiny) & (x[0] < near[-1] + tiny) & (x[1] < length / 2 + tiny)
)
facets = meshtags(mesh, 2, contact, np.full(len(contact), 1, dtype=np.int32))

V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
young = common_modulus * (1 - poisson**2)
mu, lame = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx

held = locate_entities_boundary(mesh, 2, lambda x: np.max([x[0], x[1], -x[2]], axis=0) > far - tiny)
bcs = [fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, held), V)]
for k in (0, 1):  # planes of symmetry
    plane = locate_entities_boundary(mesh, 2, lambda x, k=k: x[k] < tiny)
    dofs = fem.locate_dofs_topological(V.sub(k), 2, plane)
    bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, V.sub(k)))

# %% [markdown]
# ## Contact
# The control is one vector: the heights of the gap at the stations, linear in between, from which
# the approach is already subtracted. UFL knows how the gap depends on this vector.

# %%
heights = fem.Constant(mesh, np.zeros(number))  # mm
X = ufl.SpatialCoordinate(mesh)


def hat(k):
    """Return the function that is 1 at station k, 0 at others, and linear in between."""
    rises = [(X[1] - stations[k - 1]) / (stations[k] - stations[k - 1])] if k else []
    falls = [(stations[k + 1] - X[1]) / (stations[k + 1] - stations[k])] if k < number - 1 else []
    sides = rises + falls
    return ufl.max_value(ufl.min_value(*sides) if len(sides) == 2 else sides[0], 0)


gap = X[0] ** 2 / (2 * radius) + sum(heights[k] * hat(k) for k in range(number))
roller = RigidPlane(point=(0, 0, 0), normal=(0, 0, -1))
pair = ContactPair(facets, 1, roller, Frictionless(), gap=gap, name="roller")
units = Units("mm", "MPa", force="N")
problem = ContactProblem(a, None, [pair], bcs=bcs, expected_solves=100, units=units)
if comm.rank == 0:
    print(problem)

force, peak = NormalForce(), PressureNorm(exponent=8)
solution, solves, gradients = None, 0, 0


def solve(values):
    """Solve with these heights [mm], unless the last solve had them."""
    global solution, solves
    if solution is None or not np.array_equal(heights.value, values):
        heights.value[:] = values
        solution = problem.solve(rtol=1e-8)
        solution.raise_if_failed()
        solves += 1


def value(goal, values):
    solve(values)
    return problem.goal_value(goal)


def slope(goal, values):
    global gradients
    solve(values)
    gradients += 1
    return problem.gradient(goal, [heights])[0]


# %% [markdown]
# ## A straight roller, and Lundberg's
# The force depends on the approach. With its derivative, the sum of the derivatives by all heights,
# Newton's method finds the approach for the load. Lundberg's profile is infinite at the end: its
# value there is taken in the middle between the last two stations.


# %%
def loaded(profile):
    """Return the heights of a profile (stations,) [mm], less the approach that gives the load."""
    values = profile - half_width**2 / (2 * radius)
    while abs(excess := 4 * value(force, values) - load) > 1e-6 * load:
        values = values - excess / (4 * slope(force, values).sum())
    return values


def along():
    """Return for each station the pressure in the middle of the contact, and the line load."""
    space = solution.pressure.function_space
    owned = space.dofmap.index_map.size_local
    places = np.round(space.tabulate_dof_coordinates()[:owned, :2] / tiny) * tiny
    rows = np.hstack([places, solution.pressure.x.array[:owned, None]])
    rows = np.vstack(comm.allgather(rows))
    rows = rows[np.lexsort(rows[:, :2].T)].reshape(number, -1, 3)  # (station, place across, ...)
    pressure = rows[..., 2]
    return pressure[:, 0], 2 * np.trapezoid(pressure, rows[..., 0], axis=1)


places = 2 * stations / length
places[-1] = (places[-2] + places[-1]) / 2
lundberg = unit * np.log(1 / (1 - places**2))
pressures, line_loads = {}, {}
straight = loaded(np.zeros(number))
start = problem.goal_value(peak)
pressures["straight"], line_loads["straight"] = along()
loaded(lundberg)
pressures["Lundberg"], line_loads["Lundberg"] = along()

# %% [markdown]
# ## Optimise
# SLSQP gets the norm of the pressure, divided by the norm for the straight roller, the force as a
# constraint, and both derivatives. Heights are in Lundberg's unit, so that all numbers are about 1.

# %%
solves, gradients = 0, 0
found = minimize(
    lambda q: value(peak, unit * q) / start,
    straight / unit,
    jac=lambda q: unit * slope(peak, unit * q) / start,
    constraints={
        "type": "eq",
        "fun": lambda q: 4 * value(force, unit * q) / load - 1,
        "jac": lambda q: unit * 4 * slope(force, unit * q) / load,
    },
    method="SLSQP",
    options={"ftol": 1e-6, "maxiter": 100},
)
assert found.success, found.message
solve(unit * found.x)
profile = unit * (found.x - found.x[0])
pressures["optimal"], line_loads["optimal"] = along()
if comm.rank == 0:
    print(f"\n{found.message}: {found.nit} steps, {solves} solves, {gradients} gradients")
    print(f"{'profile':<10}{'peak [MPa]':>12}{'/ Hertz':>9}")
    for name, pressure in pressures.items():
        print(f"{name:<10}{pressure.max():12.0f}{pressure.max() / hertz_peak:9.3f}")
    print("\n2y/L    optimal [µm]  Lundberg [µm]  pressure / Hertz  line load / (Q/L)")
    rows = zip(
        2 * stations / length,
        1e3 * profile,
        1e3 * lundberg,
        pressures["optimal"] / hertz_peak,
        line_loads["optimal"] / line_load,
        strict=True,
    )
    for row in rows:
        print("{:5.3f} {:12.2f} {:14.2f} {:17.3f} {:17.3f}".format(*row))

# %% [markdown]
# ## Check
# The pressure is even, as far as $L^8$ distinguishes an even pressure from a peak: five percent
# more on a tenth of the area are half a percent of the norm. The peak is below the peak of
# Lundberg's profile, and the profile is a little above Lundberg's, except within a half width of
# the end. The straight roller has a sharp edge: its peak grows without limit as cells become
# smaller.

# %%
even = pressures["optimal"] / pressures["optimal"][:-1].mean()
assert abs(even[:-1] - 1).max() < 0.05
assert pressures["optimal"].max() < pressures["Lundberg"].max() < pressures["straight"].max() / 4
inside = stations < length / 2 - half_width
beyond = (profile - lundberg)[inside] / lundberg.max()
assert beyond.min() > -0.02
assert beyond.max() < 0.06
assert np.diff(line_loads["optimal"])[-4:].max() < 0  # it falls towards the end
assert abs(4 * problem.goal_value(force) / load - 1) < 1e-5
solution.write("results/roller_profile.pvd")
problem.destroy()

# %% [markdown]
# ## Draw

# %%
if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.4), layout="constrained")
    fine = np.linspace(0, 0.999, 1000)
    left.plot(
        fine * length / 2, 1e3 * unit * np.log(1 / (1 - fine**2)), color="grey", label="Lundberg"
    )
    left.plot(stations, 1e3 * profile, "o-", color="C0", ms=4, lw=1, label="optimal")
    left.set(xlabel="distance from the middle [mm]", ylabel="profile [µm]", ylim=(0, 10))
    left.invert_yaxis()
    left.legend(frameon=False)
    styles = {"straight": ("C3", "s-"), "Lundberg": ("grey", ".-"), "optimal": ("C0", "o-")}
    for name, (color, style) in styles.items():
        right.plot(
            stations, pressures[name] / hertz_peak, style, color=color, ms=4, lw=1, label=name
        )
    right.set(xlabel="distance from the middle [mm]", ylabel="pressure / Hertz's peak")
    right.set(ylim=(0, 2))
    right.annotate(
        f"{pressures['straight'].max() / hertz_peak:.1f}",
        (stations[-1], 2.0),
        (-6, -12),
        textcoords="offset points",
        ha="right",
        color="C3",
    )
    right.legend(frameon=False, loc="lower left")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig("results/roller_profile.png", dpi=150)
