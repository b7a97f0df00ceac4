# %% [markdown]
# # An O-ring squeezed in a groove: large strains, rubber that keeps its volume
#
# A rubber ring lies in a groove; a lid squeezes it by a quarter of its thickness. How much force
# does that take, and what happens when the ring has nowhere to go?
#
#            lid, pushed down
#        ===========================  y = 2 R (1 - e)
#        |        .-------.        |
#        |      /           \      |
#        |     |      +      |     |  groove, 2 w wide
#        |      \           /      |
#        |________`-------'________|  y = 0
#
# The cross-section is in plane strain, since the ring is long compared with its thickness. A
# quarter of it is enough: x = 0 is a plane of symmetry, and so is the middle between lid and
# groove. Here the groove rests, and the middle moves down by half as much as the lid. With 32 cells
# along the arc it takes 1,687 nodes and 15 seconds; a number after the name of this script sets
# another mesh size.
#
# **Strong form.** $-\operatorname{Div} P = 0$ in the undeformed ring, with
#
# $$P = \frac{\partial\psi}{\partial F}, \quad F = I + \nabla u, \quad J = \det F,$$
#
# $$\psi = \tfrac{\mu}{2} \bigl(J^{-2/3} \operatorname{tr}(F^\top F) - 3\bigr) +
# \tfrac{\kappa}{2} (J - 1)^2,$$
#
# the neo-Hookean law for rubber (in plane strain $\operatorname{tr}(F^\top F)$ has a 1 from the
# third direction). In the contact $p \ge 0$, $d \ge 0$, $p \, d = 0$, with the present gap $d$: the
# distance from a plane is an affine function of the displacement, however large the displacement
# is. Pressures are forces divided by undeformed areas.
#
# **Rubber hardly changes its volume**: $\kappa = 50 \mu$ here, as if Poisson's ratio were 0.49.
# Displacements of degree 1 lock: they cannot keep the volume of each cell and still bend. Here they
# have degree 2 on triangles, and the energy of the volume is taken at one point of each cell only
# (selectively reduced integration), so that it is one condition for each cell: about as good as a
# pressure that is constant on cells, which is a stable pair with degree 2. The end of this page
# solves the same scene with a pressure as a further unknown (Taylor and Hood), which is also
# possible for rubber that keeps its volume exactly.
#
# **Newton's method.** Each step is a contact problem for the whole displacement, with the tangent
# at the previous displacement; `NonlinearContactProblem` has the arguments of DOLFINx's
# `NonlinearProblem`, and the pairs. Contact is exact in every step, so convergence is quadratic.
#
# **Comparison.** A cylinder between two plates takes the force $P$ for each unit of its length,
#
# $$2 R e = \frac{2 P}{\pi E^*} \Bigl(2 \ln\frac{4 R}{a} - 1\Bigr), \quad
# a^2 = \frac{4 P R}{\pi E^*}, \quad E^* = \frac{E}{1 - \nu^2},$$
#
# where $a$ is half the width of the contact (Johnson, Contact Mechanics, 1985, 5.6). This is linear
# elasticity for small $a / R$, with an error of some $(a / R)^2$.

# %%
import sys

from mpi4py import MPI

import matplotlib
import numpy as np
from scipy.optimize import brentq

import basix.ufl
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    Frictionless,
    NonlinearContactProblem,
    RigidPlane,
    SolutionWriter,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N per mm of the ring.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 32  # cells along a quarter of the arc
radius = 2.65  # mm, of the ring's cross-section: a common size, 5.3 mm thick
mu, kappa = 1.5, 75.0  # MPa, about 60 Shore A
half_width = 1.12 * radius  # mm, of the groove
squeezes = np.linspace(0.025, 0.25, 10)  # of the thickness

# %% [markdown]
# ## Mesh, space, and the residual

# %%
ring = read_gmsh(MESHES / "o_ring.geo", comm, R=radius, N=N)
mesh, facets, tags = ring.mesh, ring.facet_tags, ring.tags
V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
u, v = fem.Function(V), ufl.TestFunction(V)


def of_shape(u):
    """Return det(I + grad u), and the part of the energy that a change of the shape takes."""
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    return J, mu / 2 * (J ** (-2 / 3) * (ufl.inner(F, F) + 1) - 3)


J, shape = of_shape(u)
volume = kappa / 2 * (J - 1) ** 2
everywhere, once = (ufl.dx(metadata={"quadrature_degree": degree}) for degree in (4, 1))
residual = ufl.derivative(shape * everywhere + volume * once, u, v)

# %% [markdown]
# The middle moves down by half as much as the lid.

# %%
down = fem.Constant(mesh, 0.0)


def conditions(V):
    """Return the Dirichlet conditions of displacements in V."""
    bcs = []
    for surface, component, value in (("axis", 0, fem.Constant(mesh, 0.0)), ("middle", 1, down)):
        sub = V.sub(component)
        dofs = fem.locate_dofs_topological(sub, 1, facets.find(tags[surface]))
        bcs.append(fem.dirichletbc(value, dofs, sub))
    return bcs


bcs = conditions(V)

# %% [markdown]
# ## Contact and load steps
# The same arc may touch the bottom of the groove and its wall. Each load step starts from the
# previous solution.

# %%
bottom = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))
wall = RigidPlane(point=(half_width, 0.0), normal=(-1.0, 0.0))
forces = {}  # N/mm, of the lid, for each step
for name, obstacles in (("between plates", [bottom]), ("in the groove", [bottom, wall])):
    pairs = [ContactPair(facets, tags["arc"], obstacle, Frictionless()) for obstacle in obstacles]
    u.x.array[:] = 0.0
    forces[name] = []
    problem = NonlinearContactProblem(residual, u, pairs, bcs, units=Units("mm", "MPa"))
    writer = SolutionWriter(f"results/seal_{name.split()[-1]}.pvd")
    with problem:
        for squeeze in squeezes:
            down.value = -squeeze * radius
            solution = problem.solve()
            solution.raise_if_failed()
            writer.write(solution, time=squeeze)
            forces[name].append(2 * solution.pair_resultants[0].force[1])
    if comm.rank == 0:
        print(f"\n{name}\n{solution}\n{solution.newton}")

# %% [markdown]
# ## Check
# Newton's method: each residual is far below the previous one, until the end. The volume as a whole
# changes only by the pressure divided by kappa. The law of contact holds, with the present gap. The
# force agrees with theory within $(a / R)^2$ and the error of a mesh with few nodes in contact;
# after the ring has met the wall, the groove needs more force than theory.

# %%
last = [step for step in solution.newton.steps if step.fraction == 1.0]
assert last[-1].residual < 0.1 * last[-2].residual
before, after = (
    comm.allreduce(fem.assemble_scalar(fem.form(part * ufl.dx(domain=mesh)))) for part in (1, J)
)
if comm.rank == 0:
    print(f"the cross-section shrinks by {1 - after / before:.1%}")
assert abs(1 - after / before) < 2 * solution.peak_pressure / kappa
for surface, depth in zip(solution.surfaces, (radius, half_width), strict=True):
    pressure, gap = surface.pressure.x.array, surface.gap.x.array
    assert pressure.min(initial=0.0) >= 0.0
    assert gap.min(initial=0.0) >= -1e-4 * depth


young = 9 * kappa * mu / (3 * kappa + mu)
stiffness = young / (1 - (3 * kappa - 2 * mu) ** 2 / (6 * kappa + 2 * mu) ** 2)


def width(force):
    """Return half the width of the contact [mm] under a force [N/mm]."""
    return np.sqrt(4 * force * radius / (np.pi * stiffness))


def line_contact(squeeze):
    """Return the force [N/mm] of theory for a squeeze, relative to the thickness."""

    def missing(force):
        approach = force / (np.pi * stiffness) * (2 * np.log(4 * radius / width(force)) - 1)
        return approach - radius * squeeze

    return brentq(missing, 1e-9 * radius * stiffness, radius * stiffness)


between, confined = np.array(forces["between plates"]), np.array(forces["in the groove"])
theory = np.array([line_contact(squeeze) for squeeze in squeezes])
if comm.rank == 0:
    print("force over that of theory:", np.round(between / theory, 3))
    print("(a / R)^2:                ", np.round((width(theory) / radius) ** 2, 3))
cell = np.pi / 2 * radius / N
allowed = (width(theory) / radius) ** 2 + 0.2 * cell / width(theory)
assert (np.abs(between / theory - 1) < allowed).all()
touches = squeezes > 0.19
assert np.abs(confined[~touches] / between[~touches] - 1).max() < 1e-4
assert confined[-1] > 1.15 * between[-1]

# %% [markdown]
# ## A pressure as a further unknown
# With $p\, (J - 1) - p^2 / (2 \kappa)$ in the energy the pressure $p$ is $\kappa (J - 1)$, but in a
# space of its own, of degree 1. A part of $\kappa$, five shear moduli, still multiplies $(J - 1)^2
# / 2$ with the displacement's $J$, since without this part these elements wrinkle. All other lines
# are as above: conditions and contact act on the displacement. The force agrees within 1 % (on
# coarse meshes within 4 %), and each residual is about the square of the previous one.

# %%
pressures = basix.ufl.element("Lagrange", mesh.basix_cell(), 1)
mixed = fem.functionspace(mesh, basix.ufl.mixed_element([V.ufl_element(), pressures]))
w = fem.Function(mixed)
of_u, p = ufl.split(w)
J, shape = of_shape(of_u)
stays = 5 * mu  # MPa
volume = stays / 2 * (J - 1) ** 2 + p * (J - 1) - p**2 / (2 * (kappa - stays))
residual = ufl.derivative((shape + volume) * everywhere, w)
with NonlinearContactProblem(residual, w, pairs, conditions(mixed.sub(0))) as problem:
    for squeeze in squeezes[[3, 6, 9]]:
        down.value = -squeeze * radius
        taylor_hood = problem.solve()
        taylor_hood.raise_if_failed()
force = 2 * taylor_hood.pair_resultants[0].force[1]
if comm.rank == 0:
    print(f"force of the lid: {confined[-1]:.3f} N/mm with one point of integration,")
    print(f"  {force:.3f} N/mm with a pressure\n{taylor_hood.newton}")
assert abs(force / confined[-1] - 1) < 0.3 / N
residuals = [step.residual for step in taylor_hood.newton.steps if step.residual > 1e-12]
assert residuals[-1] < 10 * residuals[-2] ** 2

# %% [markdown]
# ## Draw
# The ring in the groove, deformed to scale, and the force against the squeeze.

# %%
solution.plot("results/seal.png", scale=1)
if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(5.2, 3.4), layout="constrained")
    fine = np.linspace(1e-3, squeezes[-1], 200)
    curve = [line_contact(squeeze) for squeeze in fine]
    panel.plot(100 * fine, curve, color="black", lw=1, label="linear theory")
    for (name, force), style in zip(forces.items(), ("o", "s"), strict=True):
        panel.plot(100 * squeezes, force, style, ms=4, label=name)
    panel.set(xlabel="squeeze [%]", ylabel="force [N/mm]", xlim=(0, None), ylim=(0, None))
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False)
    figure.savefig("results/seal_force.png", dpi=200)
