# %% [markdown]
# # A ring shrunk on a shaft, and heat that passes through the contact
#
# An aluminium ring is shrunk on a hollow steel shaft with hot oil inside. The shaft grows with its
# temperature and presses harder; the harder it presses the more heat passes through the contact,
# which warms the ring and cools the shaft. What are temperature and pressure then?
#
#       y
#       |---.__
#       |      `-.         ring, rim at 20 degrees
#       |---._    `.
#       |     `.    \
#       '._     \    \     shaft, bore at up to 200 degrees
#          \     |    |
#           |----|----|---- x
#          10    20   40 mm
#
# A quarter of the cross-section is modelled, in plane strain: the shaft is long and held at its
# ends. With 32 cells round the quarter of the ring and 24 round the quarter of the shaft it takes
# 795 nodes and 4 seconds; a number after the name of this script sets another mesh size.
#
# **Strong form.** In each body, with the temperature $T$, conductivity $k$, expansion $\alpha$,
#
# $$-\operatorname{div} (k \nabla T) = 0, \qquad -\operatorname{div} \sigma = 0, \qquad
# \sigma = 2 \mu \varepsilon(u) + \lambda \operatorname{tr} \varepsilon(u) I
# - (3 \lambda + 2 \mu)\, \alpha\, (T - T_0) I.$$
#
# In the contact nothing penetrates, as always, and the heat flux from the ring to the shaft is
#
# $$q = h(p)\, (T_{ring} - T_{shaft}), \qquad h(p) = h_0 (p / p_0)^{0.95}:$$
#
# rough surfaces touch at some peaks only, and these grow with the pressure (Cooper, Mikic and
# Yovanovich, Int. J. Heat Mass Transfer 12, 1969).
#
# **Discrete form.** $(K + C(p))\, T = 0$ for the nodes whose temperature is free. $C$ is the
# `conductance_matrix`: the mortar projection compares the temperatures of both sides, and its
# transpose distributes the heat. The rows of $C$ sum to zero, so the heat that leaves the shaft
# enters the ring to rounding, although the meshes do not match.
#
# **Staggered.** Each round computes the temperature for the pressure of the previous round, and
# then the contact for this temperature, until neither changes. K of the elasticity is factored
# once, and each contact solve starts from the previous one: a round takes one product with A, or
# none.
#
# **Comparison.** All fields depend on the radius alone. With the heat $Q$ per radian, the
# interference $\delta$ and the radii $a < R < b$,
#
# $$T_{bore} - T_{rim} = Q \left( \frac{\ln(R/a)}{k_s} + \frac{1}{h(p) R} + \frac{\ln(b/R)}{k_r}
# \right),$$
#
# $$p = \frac{\delta + (1 + \nu_s) \alpha_s R \bar T_s - (1 + \nu_r) \alpha_r R \bar T_r}
# {c_s + c_r},$$
#
# with the mean temperatures $\bar T$ of the cross-sections above $T_0$ and Lame's compliances $c$:
# one equation in $p$.

# %%
import sys

from mpi4py import MPI
from petsc4py import PETSc

import matplotlib
import numpy as np
from scipy.optimize import brentq

import ufl
from dolfinx import fem
from dolfinx.fem.petsc import apply_lifting, assemble_matrix, assemble_vector, set_bc

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Frictionless,
    SolutionWriter,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, temperatures in degrees Celsius, heat in mW (N mm/s). So
# conductivities have the same numbers as in W/(m K), and 1 mW/(mm^2 K) is 1000 W/(m^2 K).

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 32  # cells round a quarter of the ring
bore, radius, rim = 10.0, 20.0, 40.0  # mm
interference = 0.02  # mm
materials = {  # MPa, 1, 1/K, mW/(mm K)
    "ring": {"E": 70_000.0, "nu": 0.33, "alpha": 23e-6, "k": 200.0},
    "shaft": {"E": 210_000.0, "nu": 0.3, "alpha": 12e-6, "k": 45.0},
}
h0, p0 = 5.0, 20.0  # mW/(mm^2 K) at MPa
T0 = 20.0  # temperature without thermal strain
bores = (20.0, 80.0, 140.0, 200.0)  # temperatures of the bore
tolerance = 1e-8  # change of pressure and temperature in the last round, relative


def conductance(p):
    return h0 * (np.maximum(p, 0.0) / p0) ** 0.95


# %% [markdown]
# ## Mesh and forms
# Temperature and displacement are of degree 1.

# %%
fit = read_gmsh(
    MESHES / "shrink_fit.geo",
    comm,
    N=N,
    M=3 * N // 4,  # cells round the shaft
    Bore=bore,
    Radius=radius,
    Rim=rim,
    Interference=interference,
)
mesh, facets, tags = fit.mesh, fit.facet_tags, fit.tags
V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
Q = fem.functionspace(mesh, ("Lagrange", 1))

of_cells = fem.functionspace(mesh, ("DG", 0))
E, nu, alpha, k = (fem.Function(of_cells) for _ in range(4))
for body, values in materials.items():
    for function, value in zip((E, nu, alpha, k), values.values(), strict=True):
        function.x.array[fit.cell_tags.find(tags[body])] = value
mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))

T = fem.Function(Q, name="temperature")
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
L = (3 * lame + 2 * mu) * alpha * (T - T0) * ufl.div(v) * ufl.dx

bcs = []
for surface, axis in (("ring_x", 0), ("ring_y", 1), ("shaft_x", 0), ("shaft_y", 1)):
    dofs = fem.locate_dofs_topological(V.sub(axis), 1, facets.find(tags[surface]))
    bcs.append(fem.dirichletbc(fem.Constant(mesh, 0.0), dofs, V.sub(axis)))

# %% [markdown]
# ## Contact

# %%
pair = ContactPair(
    facets,
    secondary=tags["ring_contact"],
    primary=tags["shaft_contact"],
    friction=Frictionless(),
)
problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("mm", "MPa"))
(contact,) = problem.operators

# %% [markdown]
# ## Heat
# The form does not contain the contact: without C the two bodies are separate. No temperature is
# prescribed at the contact, so the conditions may be put into K and the load by DOLFINx's functions
# before C is added.

# %%
test, trial = ufl.TestFunction(Q), ufl.TrialFunction(Q)
heat = fem.form(k * ufl.inner(ufl.grad(trial), ufl.grad(test)) * ufl.dx)
of_bore = fem.Constant(mesh, T0)
at_bore, at_rim = (
    fem.locate_dofs_topological(Q, 1, facets.find(tags[name])) for name in ("bore", "rim")
)
held = [
    fem.dirichletbc(of_bore, at_bore, Q),
    fem.dirichletbc(fem.Constant(mesh, T0), at_rim, Q),
]
K = assemble_matrix(heat, bcs=held)
K.assemble()
solver = PETSc.KSP().create(comm)
solver.setType("preonly")
solver.getPC().setType("lu")
solver.getPC().setFactorSolverType("mumps")


no_source = fem.form(fem.Constant(mesh, 0.0) * test * ufl.dx)
contact_nodes = [
    fem.locate_dofs_topological(Q, 1, facets.find(tags[name]))
    for name in ("ring_contact", "shaft_contact")
]
owned = Q.dofmap.index_map.size_local


def solve_heat(h):
    """Set T for this conductance; return the heat that the contact gives to ring and shaft."""
    C = contact.conductance_matrix(h)
    b = assemble_vector(no_source)
    apply_lifting(b, [heat], [held])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    set_bc(b, held)
    solver.setOperators(K + C)
    solver.solve(b, T.x.petsc_vec)
    T.x.scatter_forward()
    flow = C * T.x.petsc_vec  # heat that leaves each node
    return [-comm.allreduce(flow.array[dofs[dofs < owned]].sum()) for dofs in contact_nodes]


# %% [markdown]
# The heat that enters through the bore, or through the rim, is the work of the flux on a
# temperature that is 1 at the nodes of this surface and 0 at all others.

# %%
one_at = [fem.Function(Q), fem.Function(Q)]
for one, dofs in zip(one_at, (at_bore, at_rim), strict=True):
    one.x.array[dofs] = 1.0
through = [
    fem.form(k * ufl.inner(ufl.grad(T), ufl.grad(one)) * ufl.dx(domain=mesh)) for one in one_at
]

# %% [markdown]
# ## The formula

# %%
ring, shaft = materials["ring"], materials["shaft"]


def compliance(body, free):
    """Return how far R moves by a unit pressure at R [mm/MPa]; radius `free` has no pressure."""
    ratio = ((1 - 2 * body["nu"]) * radius**2 + free**2) / abs(radius**2 - free**2)
    return radius * (1 + body["nu"]) / body["E"] * ratio


def heat_per_radian(p, at_bore):
    """Return the heat Q per radian [mW/mm] at a pressure [MPa]."""
    bodies = np.log(radius / bore) / shaft["k"] + np.log(rim / radius) / ring["k"]
    return (at_bore - T0) / (bodies + 1 / (conductance(p) * radius))


def profile(r, heat, at_bore):
    """Return the temperatures at radii r in the shaft, and in the ring."""
    return at_bore - heat * np.log(r / bore) / shaft["k"], T0 + heat * np.log(rim / r) / ring["k"]


def growth(body, r, temperature):
    """Return how far R moves [mm] if a body has temperatures at r, the points of Gauss's rule."""
    mean = gauss @ (r * (temperature - T0)) / (gauss @ r)
    return (1 + body["nu"]) * body["alpha"] * radius * mean


points, gauss = np.polynomial.legendre.leggauss(12)
in_shaft = bore + (radius - bore) * (points + 1) / 2
in_ring = radius + (rim - radius) * (points + 1) / 2


def overlap_left(p, at_bore):
    """Return the overlap [mm] that a pressure leaves; it is zero for the right pressure."""
    heat = heat_per_radian(p, at_bore)
    grown = growth(shaft, in_shaft, profile(in_shaft, heat, at_bore)[0])
    grown -= growth(ring, in_ring, profile(in_ring, heat, at_bore)[1])
    return interference + grown - (compliance(shaft, bore) + compliance(ring, rim)) * p


def formula(at_bore):
    """Return the pressure [MPa] and the heat [mW/mm] of the quarter."""
    p = brentq(overlap_left, 1e-3, 1e3, args=(at_bore,))
    return p, np.pi / 2 * heat_per_radian(p, at_bore)


# %% [markdown]
# ## Both together
# A contact solve must be more accurate than the tolerance of the loop; otherwise changes from round
# to round are noise. The pressure is a Function on the mesh, for forms and conductances. The
# pressures below are means over the contact: nodal pressures differ from the mean by 0.3 percent
# here and by 4 percent for N = 8, since the facets of one polygon press on the facets of another
# one.

# %%
writer = SolutionWriter("results/shrink_fit.pvd")
pressure, h = fem.Function(Q), fem.Function(Q)
area = np.pi / 2 * radius  # mm, of the quarter per mm of length
solution = problem.solve(rtol=0.01 * tolerance)
pressures, heats, lost, profiles = [], [], [], []
if comm.rank == 0:
    print("bore  rounds  products  pressure [MPa]  by formula  heat [mW/mm]  by formula")
for temperature in bores:
    of_bore.value = temperature
    rounds = products = 0
    change = np.inf
    while change > tolerance and rounds < 30:
        before = T.x.array.copy(), pressure.x.array.copy()
        pressure.interpolate(solution.on_mesh("pressure"))
        h.x.array[:] = conductance(pressure.x.array)
        given = solve_heat(h)
        solution = problem.solve(rtol=0.01 * tolerance)
        solution.raise_if_failed()
        change = 0.0
        for now, last in zip((T.x.array, pressure.x.array), before, strict=True):
            largest, moved = (
                comm.allreduce(np.abs(x).max(initial=0.0), op=MPI.MAX) for x in (now, now - last)
            )
            change = max(change, moved / largest)
        rounds, products = rounds + 1, products + solution.products
    assert change <= tolerance
    fluxes = [comm.allreduce(fem.assemble_scalar(form)) for form in through]
    pressures.append(solution.normal_force / area)
    heats.append(given[0])
    lost.append([sum(given), fluxes[0] - given[0], sum(fluxes)])
    profiles.append(comm.gather(T.x.array.copy()))
    writer.write(solution, time=temperature, fields=[T])
    if comm.rank == 0:
        p, heat_flow = formula(temperature)
        print(
            f"{temperature:4.0f} {rounds:7d} {products:9d} {pressures[-1]:15.3f} {p:11.3f}"
            f" {heats[-1]:13.1f} {heat_flow:11.1f}"
        )
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check
# Heat: the contact gives to the ring the heat that it takes from the shaft; this heat enters
# through the bore, and leaves through the rim. The first balance is exact to rounding, the others
# are as exact as the solution of the linear system. Without a difference of temperature no heat
# flows.
#
# Pressure and heat: displacement and temperature are of degree 1, so both converge with h^2, where
# h is the size of the cells divided by the radius. The formula takes R as the radius of both ring
# and shaft, though they differ by the interference: it is right to about interference / R, here
# 0.001.

# %%
assert np.abs(lost).max() < 1e-10 * max(heats)
assert abs(heats[0]) < 1e-10 * max(heats)
wanted_pressures, wanted_heats = np.array([formula(one) for one in bores]).T
h_squared = (np.pi / 2 / N) ** 2
pressure_error = np.abs(np.array(pressures) / wanted_pressures - 1).max()
heat_error = np.abs(np.array(heats) - wanted_heats).max() / max(wanted_heats)
if comm.rank == 0:
    print(f"errors: pressure {pressure_error:.1e}, heat {heat_error:.1e}")
assert max(pressure_error, heat_error) < 0.5 * h_squared + interference / radius

# %% [markdown]
# ## Draw
# The hottest state; temperatures against the radius, with the jump at the contact; the pressure.

# %%
solution.plot("results/shrink_fit.png")
cells = mesh.topology.index_map(2).size_local
parts = comm.gather((Q.tabulate_dof_coordinates(), Q.dofmap.list[:cells]))
if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (field, radial, over) = plt.subplots(
        1, 3, figsize=(10, 3.2), layout="constrained", width_ratios=(1.1, 1, 1)
    )
    for (x, corners), values in zip(parts, profiles[-1], strict=True):
        triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [1, 3, 2]]])
        picture = field.tripcolor(
            *x[:, :2].T,
            triangles,
            values,
            shading="gouraud",
            cmap="inferno",
            vmin=T0,
            vmax=bores[-1],
        )
    figure.colorbar(picture, ax=field, label="temperature [\N{DEGREE SIGN}C]")
    field.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    fine = np.linspace(0, 1, 50)
    lines = bore + (radius - bore) * fine, radius + (rim - radius) * fine
    for temperature, gathered in zip(bores, profiles, strict=True):
        heat_flow = formula(temperature)[1] / (np.pi / 2)
        for side, r in enumerate(lines):
            radial.plot(r, profile(r, heat_flow, temperature)[side], color="black", lw=1)
        for (x, _), values in zip(parts, gathered, strict=True):
            radial.plot(np.hypot(x[:, 0], x[:, 1]), values, "o", ms=2, color="tab:red")
    radial.set(xlabel="radius [mm]", ylabel="temperature [\N{DEGREE SIGN}C]")
    fine = np.linspace(bores[0], bores[-1], 50)
    over.plot(fine, [formula(one)[0] for one in fine], color="black", lw=1, label="formula")
    over.plot(bores, pressures, "o", ms=4, color="tab:red", label="computed")
    over.set(xlabel="bore [\N{DEGREE SIGN}C]", ylabel="mean pressure [MPa]", ylim=(0, None))
    over.legend(frameon=False)
    for panel in (radial, over):
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig("results/shrink_fit_heat.png", dpi=200)
