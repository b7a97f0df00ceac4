# %% [markdown]
# # A ball pressed into metal, and lifted off
#
# A rigid ball of 10 mm radius is pressed into a block of steel, as in a hardness test, and lifted
# off. First the steel is elastic; then it yields beneath the surface; at last the plastic zone
# reaches the surface round the contact, and the mean pressure hardly grows any more: it is the
# hardness. When the ball is lifted an imprint is left.
#
#                axis
#                 |   ,   ball, radius R
#                 |  /
#     ____________|_/_____________________  y = 0
#                 |
#        steel    |        x = r
#                 |
#                 |____________________
#
# **Material.** Small strains, von Mises' yield condition with the yield stress $Y$, perfectly
# plastic but for a hardening of 0.1 % of Young's modulus. With the plastic strain
# $\varepsilon^p_n$ of the last accepted step, the trial stress
# $\sigma^* = C : (\varepsilon(u) - \varepsilon^p_n)$ and its von Mises stress $q^*$, the stress is
#
# $$\sigma = \sigma^* - 2 \mu\, \gamma\, n, \qquad
# n = \tfrac{3}{2} \operatorname{dev} \sigma^* / q^*, \qquad
# \gamma = \frac{\langle q^* - Y - H \alpha_n \rangle}{3 \mu + H}.$$
#
# This is an expression of UFL, so `ufl.derivative` gives the consistent tangent. The plastic strain
# and its amount $\alpha$ are Functions at the points of quadrature, and `accept()` moves them on.
#
# **Axisymmetry.** The mesh is the meridian; forms carry $2 \pi r$ and the hoop strain, and
# `axisymmetric=True` makes the contact's integrals those of rings.
#
# With 31,000 unknowns it takes 40 seconds; a number after the name of this script is another number
# of load steps, and the size of the cells goes with it.

# %%
import itertools
import sys

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    Coulomb,
    NonlinearContactProblem,
    RigidSphere,
    SolutionWriter,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm and stresses in MPa, so forces come in N.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 24  # load steps on the way down
young, poisson, yield_stress = 200_000.0, 0.3, 400.0  # MPa
hardening = 1e-3 * young
radius, friction_coefficient = 10.0, 0.3  # mm
shallowest, deepest = 5e-5, 0.022  # mm, depth of the first and of the last step
depths = np.geomspace(shallowest, deepest, N)
mu, lam = young / 2 / (1 + poisson), young * poisson / (1 + poisson) / (1 - 2 * poisson)
reduced = young / (1 - poisson**2)  # E* of Hertz: the ball is rigid

# %% [markdown]
# ## Mesh, material and forms

# %%
half_space = read_gmsh(MESHES / "half_space.geo", comm, Size=8, Top=1, h=0.12 / N, Growth=1.2 / N)
mesh, facets, tags = half_space.mesh, half_space.facet_tags, half_space.tags
V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
u, v = fem.Function(V), ufl.TestFunction(V)
r = ufl.SpatialCoordinate(mesh)[0]
dx = ufl.Measure("dx", metadata={"quadrature_degree": 2})


def strain(u):
    e = ufl.sym(ufl.grad(u))
    return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[0, 1], e[1, 1], 0], [0, 0, u[0] / r]])


def at_points(*shape):
    """Return a Function at the points of quadrature."""
    element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=shape, degree=2)
    return fem.Function(fem.functionspace(mesh, element))


plastic_strain, amount = at_points(3, 3), at_points()
elastic = strain(u) - plastic_strain
trial = 2 * mu * elastic + lam * ufl.tr(elastic) * ufl.Identity(3)
mises = ufl.sqrt(1.5 * ufl.inner(ufl.dev(trial), ufl.dev(trial)) + 1e-12)
excess = mises - yield_stress - hardening * amount
flow = ufl.conditional(ufl.gt(excess, 0), excess / (3 * mu + hardening), 0)
direction = 1.5 / mises * ufl.dev(trial)
stress = trial - 2 * mu * flow * direction
residual = ufl.inner(stress, strain(v)) * 2 * np.pi * r * dx

points, _ = basix.make_quadrature(basix.CellType.triangle, 2)
history = {
    plastic_strain: fem.Expression(plastic_strain + flow * direction, points),
    amount: fem.Expression(amount + flow, points),
}


def advance():
    """Make the present state of the material its history."""
    found = [fem.Function(old.function_space) for old in history]
    for new, expression in zip(found, history.values(), strict=True):
        new.interpolate(expression)
    for old, new in zip(history, found, strict=True):
        old.x.array[:] = new.x.array


def held(name, component):
    W = V.sub(component)
    dofs = fem.locate_dofs_topological(W, 1, facets.find(tags[name]))
    return fem.dirichletbc(default_scalar_type(0), dofs, W)


bcs = [held("axis", 0), held("bottom", 1)]

# %% [markdown]
# ## Contact
# The ball moves: `move_to` says where it is, from where it was created.

# %%
ball = RigidSphere(center=(0.0, radius), radius=radius)
pair = ContactPair(facets, tags["contact"], ball, Coulomb(friction_coefficient))
problem = NonlinearContactProblem(
    residual,
    u,
    [pair],
    bcs,
    on_accept=advance,
    axisymmetric=True,
    units=Units("mm", "MPa", force="N"),
)
if comm.rank == 0:
    print(problem)

# %% [markdown]
# ## Down and up
# Each step has a force on the ball and a radius of the contact. The edge of the contact is taken
# half way between the outermost node with a positive pressure and the next node.

# %%
writer, number = SolutionWriter("results/indentation.pvd"), itertools.count(1)


def press(depth):
    """Solve for a depth; return the force [N], the contact's radius [mm] and the solution."""
    ball.move_to((0.0, -depth))
    solution = problem.solve()
    solution.raise_if_failed()
    problem.accept()
    writer.write(solution, next(number))
    nodes = solution.pressure.function_space.tabulate_dof_coordinates()[:, 0]
    pressed = solution.pressure.x.array > 0.0
    inside = comm.allreduce(nodes[pressed].max(initial=0.0), MPI.MAX)
    outside = comm.allreduce(nodes[nodes > inside].min(initial=np.inf), MPI.MIN)
    return solution.normal_force, 0.5 * (inside + outside), solution


def most_strain():
    """Return the largest plastic strain so far."""
    return comm.allreduce(amount.x.array.max(initial=0.0), MPI.MAX)


loading, first_yield = [], None
for depth in depths:
    force, contact_radius, solution = press(depth)
    loading.append((depth, force, contact_radius))
    if first_yield is None and most_strain() > 0.0:
        first_yield = len(loading) - 1
solution.plot("results/indentation_contact.png")
depth, force, contact_radius = loading[-1]

recovery = 0.75 * force / (reduced * contact_radius)  # elastic part of the depth, about
unloading = [loading[-1]]
for part in (0.05, 0.25, 0.5, 0.75, 0.9, 1.1, 1.5):
    unloading.append((depth - part * recovery, *press(depth - part * recovery)[:2]))

# %% [markdown]
# ## What theory says
# Hertz's theory holds until the steel yields, at a mean pressure of 1.07 $Y$. Then the mean
# pressure grows, and reaches some 3 $Y$ where $E^* a / (Y R)$ is about 40 (Johnson 1985, Contact
# mechanics, 6.3). When the ball begins to go up the body is elastic, with the slope of a flat punch
# of the same radius as the contact, $2 E^* a$ (Oliver and Pharr 1992).

# %%
depth, force, contact_radius = np.array(loading).T
mean_pressure = force / (np.pi * contact_radius**2)
hertz = 4 / 3 * reduced * np.sqrt(radius * depth**3)
slope = (unloading[0][1] - unloading[1][1]) / (unloading[0][0] - unloading[1][0])
relative_slope = slope / (2 * reduced * contact_radius[-1])
at_yield = mean_pressure[first_yield] / yield_stress
middle = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0))
imprint = -comm.allreduce(sum(float(u.x.array[2 * dof + 1]) for dof in middle), MPI.MIN)
if comm.rank == 0:
    print("depth [mm]   force [N]   Hertz's    mean pressure / Y   E* a / (Y R)")
    for i in range(0, N, max(1, N // 8)):
        strength = reduced * contact_radius[i] / (yield_stress * radius)
        print(
            f"{depth[i]:10.5f} {force[i]:11.3f} {hertz[i]:9.3f} "
            f"{mean_pressure[i] / yield_stress:15.2f} {strength:15.1f}"
        )
    print(f"first plastic strain at a mean pressure of {at_yield:.2f} Y")
    print(f"slope at the beginning of the way up: {relative_slope:.2f} of 2 E* a")
    print(f"imprint {1e3 * imprint:.1f} um deep, of {1e3 * depth[-1]:.1f} um")

assert np.allclose(force[:first_yield], hertz[:first_yield], rtol=1 / N)
assert 0.9 < at_yield < 1.4  # 1.07, and up to a step more
assert 2.2 < mean_pressure[-1] / yield_stress < 3.0
assert abs(relative_slope - 1) < 0.15
assert unloading[-1][1] == 0.0  # the ball has left the imprint
assert 0.5 * depth[-1] < imprint < depth[-1]

# %% [markdown]
# ## Force over depth, and the plastic zone

# %%
cells = fem.functionspace(mesh, ("DG", 0))
areas = fem.assemble_vector(fem.form(ufl.TestFunction(cells) * dx))
integrals = fem.assemble_vector(fem.form(amount * ufl.TestFunction(cells) * dx))
zone = integrals.array / areas.array  # mean plastic strain of each cell

if comm.size == 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.2), layout="constrained")
    left.plot(1e3 * depth, force, color="tab:blue", label="down")
    left.plot(1e3 * np.array(unloading)[:, 0], np.array(unloading)[:, 1], "o-", ms=3, label="up")
    left.plot(1e3 * depth, hertz, "--", color="grey", label="Hertz")
    left.set(xlabel="depth [um]", ylabel="force [N]", xlim=(0, None), ylim=(0, 1.2 * force[-1]))
    left.legend(frameon=False)
    size = 2.6 * contact_radius[-1]
    x = mesh.geometry.x
    drawn = right.tripcolor(
        x[:, 0],
        x[:, 1],
        mesh.geometry.dofmap,
        facecolors=np.maximum(zone, 1e-9),
        norm=LogNorm(1e-4, 1e-1),
        cmap="YlOrRd",
    )
    right.set(xlim=(0, size), ylim=(-size, 0.05 * size), aspect="equal")
    right.set(xlabel="r [mm]", ylabel="y [mm]")
    figure.colorbar(drawn, label="plastic strain", shrink=0.8)
    figure.savefig("results/indentation.png", dpi=150)
