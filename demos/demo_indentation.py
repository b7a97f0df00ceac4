# %% [markdown]
# # A ball pressed into metal, and lifted off
#
# A rigid ball of 10 mm radius is pressed into a block of steel, as in a hardness test, and lifted
# off, without friction and with it. First the steel is elastic; then it yields beneath the surface;
# at last the plastic zone reaches the surface round the contact, and the mean pressure hardly grows
# any more: it is the hardness. When the ball is lifted an imprint is left.
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
# plastic except for a hardening modulus of 0.1 % of Young's modulus. With the plastic strain
# $\varepsilon^p_n$ of the last accepted step, the trial stress $\sigma^* = C : (\varepsilon(u) -
# \varepsilon^p_n)$ and its von Mises stress $q^*$, the stress is
#
# $$\sigma = \sigma^* - 2 \mu\, \gamma\, n, \qquad
# n = \tfrac{3}{2} \operatorname{dev} \sigma^* / q^*, \qquad
# \gamma = \frac{\langle q^* - Y - H \alpha_n \rangle}{3 \mu + H}.$$
#
# This is an expression of UFL, so `ufl.derivative` gives the consistent tangent. The plastic strain
# and its amount $\alpha$ are Functions at the points of quadrature, and `accept()` updates them.
#
# **Axisymmetry.** The mesh is the meridian; forms carry $2 \pi r$ and the hoop strain, and
# `axisymmetric=True` makes the contact's integrals those of rings.
#
# With 20,000 unknowns it takes a minute. A number after the name of this script sets the number of
# load steps. Each step is 1.45 times as deep as the one before, so fewer steps press less deep. The
# size of the cells is inversely proportional to the number of steps.

# %%
import sys
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    Coulomb,
    Frictionless,
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
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 16  # load steps on the way down
young, poisson, yield_stress = 200_000.0, 0.3, 250.0  # MPa
hardening = 1e-3 * young
radius = 10.0  # mm
depths = 4e-5 * 1.45 ** np.arange(N)  # mm
mu, lam = young / 2 / (1 + poisson), young * poisson / (1 + poisson) / (1 - 2 * poisson)
reduced = young / (1 - poisson**2)  # E* of Hertz: the ball is rigid

# %% [markdown]
# ## Mesh, material and forms

# %%
half_space = read_gmsh(MESHES / "half_space.geo", comm, Size=20, Top=1, h=0.04 / N, Growth=1.2 / N)
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
    """Store the present state of the material as its history."""
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
# ## Down and up
# The ball moves: `move_to` gives its translation from the position in which it was created. Each
# step has a force and a radius of the contact, where the gap vanishes: outside of a smooth contact
# the gap grows with the power 3/2 of the distance from the edge, so its power 2/3 is extrapolated
# to zero as a straight line.


# %%
class Step(NamedTuple):
    """A state of the process.

    Attributes:
        depth: depth of the ball [mm].
        force: force on the ball [N].
        contact_radius: radius of the contact [mm]; NaN if there is none.
        stress: the largest von Mises stress of an elastic step [MPa].
    """

    depth: float
    force: float
    contact_radius: float
    stress: float

    @property
    def mean_pressure(self):
        """Return the mean pressure, the force divided by the area of the contact [MPa]."""
        return self.force / (np.pi * self.contact_radius**2)

    @property
    def strain(self):
        """Return Johnson's measure of the strain, E* a / (Y R)."""
        return reduced * self.contact_radius / (yield_stress * radius)


def edge(solution):
    """Return the radius where the gap vanishes. Collective."""
    r = solution.pressure.function_space.tabulate_dof_coordinates()[:, 0]
    rows = np.stack([r, solution.pressure.x.array, solution.gap.x.array], axis=1)
    r, pressure, gap = np.unique(np.concatenate(comm.allgather(rows)), axis=0).T
    if not pressure.any():
        return np.nan
    first = np.flatnonzero(pressure)[-1] + 1  # the first open node, and the next one
    near, far = gap[first : first + 2] ** (2 / 3)
    return r[first] - near * (r[first + 1] - r[first]) / (far - near)


mises_at_points = fem.Function(amount.function_space)
mises_expression = fem.Expression(mises, points)


def indent(friction, writer=None):
    """Press the ball down in steps, lift it; return both lists and the solution at the bottom."""
    for function in (u, *history):
        function.x.array[:] = 0.0
    ball = RigidSphere(center=(0.0, radius), radius=radius)
    pair = ContactPair(facets, tags["contact"], ball, friction)
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

    def press(depth):
        ball.move_to((0.0, -depth))
        solution = problem.solve()
        solution.raise_if_failed()
        mises_at_points.interpolate(mises_expression)
        stress = comm.allreduce(mises_at_points.x.array.max(initial=0.0), MPI.MAX)
        problem.accept()
        if writer is not None:
            writer.write(solution, len(down) + len(up))
        return Step(depth, solution.normal_force, edge(solution), stress), solution

    down, up = [], []
    for depth in depths:
        step, deepest = press(depth)
        down.append(step)
    recovery = 0.75 * step.force / (reduced * step.contact_radius)  # elastic part of the depth
    for part in np.append(0.05, np.linspace(0.5, 1.5, 1 + N // 4)):
        up.append(press(depth - part * recovery)[0])
    problem.destroy()
    return down, up, deepest


smooth = indent(Frictionless())
rough = indent(Coulomb(0.3), SolutionWriter("results/indentation.pvd"))
solution = rough[-1]
solution.plot("results/indentation_contact.png")

# %% [markdown]
# ## Against theory
# Hertz's theory holds until the steel yields, at a mean pressure of 1.07 $Y$ and a pressure in the
# middle of 1.61 $Y$; friction lowers these values a little. Then the mean pressure grows, and
# reaches some 3 $Y$ where $E^* a / (Y R)$ is about 40 (Johnson 1985, Contact mechanics, 6.3). When
# the ball begins to rise, the body is elastic, and the force falls with the slope of a flat punch
# of the same radius as the contact, $2 E^* a$ (Oliver and Pharr 1992).
#
# The stress of an elastic step is proportional to its pressure, so the last elastic step shows at
# which pressure the largest von Mises stress equals the yield stress. (The log warns that nodes
# slide farther than a cell, out along the ball: the ball is so flat that with the slip $s$ its
# height changes by $s^2 / (2 R)$, about 0.1 % of the depth.)


# %%
def hertz(depth):
    """Return the force on a ball on an elastic half-space [N]."""
    return 4 / 3 * reduced * np.sqrt(radius * depth**3)


for name, (down, up, _) in (("smooth", smooth), ("rough", rough)):
    elastic_steps = [step for step in down if step.stress <= yield_stress]
    errors = [step.force / hertz(step.depth) - 1 for step in elastic_steps]
    last = elastic_steps[-1]
    to_yield = yield_stress / last.stress
    middle_of_hertz = (6 * last.force * reduced**2 / (np.pi**3 * radius**2)) ** (1 / 3)
    at_yield = to_yield * middle_of_hertz / yield_stress
    slope = (down[-1].force - up[0].force) / (down[-1].depth - up[0].depth)
    relative_slope = slope / (2 * reduced * down[-1].contact_radius)
    hardness = down[-1].mean_pressure / yield_stress
    if comm.rank == 0:
        print(
            f"{name} ball\ndepth [mm]   force [N]   of Hertz's   mean pressure / Y   E* a / (Y R)"
        )
        for step in down[:: max(1, N // 8)]:
            print(
                f"{step.depth:10.5f} {step.force:11.3f} {step.force / hertz(step.depth):12.3f} "
                f"{step.mean_pressure / yield_stress:19.2f} {step.strain:14.1f}"
            )
        print(f"first yield at a pressure in the middle of {at_yield:.3f} Y, by Hertz's formula,")
        print(f"  that is at a mean pressure of {2 / 3 * at_yield:.3f} Y")
        print(f"mean pressure at the end: {hardness:.2f} Y")
        print(f"slope at the beginning of the way up: {relative_slope:.3f} of 2 E* a\n")
    if name == "smooth":
        assert max(map(abs, errors)) < 0.1 / N
        assert abs(at_yield / 1.613 - 1) < 0.2 / N
    else:
        assert 0.0 < min(errors) and max(errors) < 0.04
        assert 0.9 < at_yield / 1.613 < 1.0
    assert abs(relative_slope - 1) < 1.2 / N
    assert up[-1].force == 0.0  # the ball has left the imprint
    if down[-1].strain > 30:
        assert 2.6 < hardness < 3.0

middle = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0))
imprint = -comm.allreduce(sum(float(u.x.array[2 * dof + 1]) for dof in middle), MPI.MIN)
if comm.rank == 0:
    print(f"imprint {1e3 * imprint:.2f} um deep, of {1e3 * depths[-1]:.2f} um")
assert 0 < imprint < depths[-1]

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
    for name, (down, up, _) in (("smooth", smooth), ("rough", rough)):
        depth, force = np.array([step[:2] for step in [*down, *up]]).T
        left.plot(1e3 * depth, force, "-" if name == "rough" else "--", label=name)
    left.plot(1e3 * depths, hertz(depths), ":", color="grey", label="Hertz")
    left.set(xlabel="depth [um]", ylabel="force [N]", xlim=(0, None), ylim=(0, 1.2 * force.max()))
    left.legend(frameon=False)
    size = 2.6 * down[-1].contact_radius
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
