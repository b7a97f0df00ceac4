# %% [markdown]
# # Hertz contact: a ball on a plane, two balls, a cylinder on a plane
#
# A soft ball is pressed on a rigid plane, without friction. Heinrich Hertz found the pressure in
# 1881: half an ellipsoid over a disc whose radius a grows with the cube root of the force. This
# case is the touchstone of contact software, because the size of the contact is not known
# beforehand. The same law holds for two balls, which count as one ball of another radius and
# modulus, and a similar law for a cylinder that lies on a plane.
#
#       | | | approach                                    p
#       v v v                                       peak -|-._
#       +-------- z = R                                   |    `-.
#       |       .'                                        |       `.
#       |      /    by symmetry an octant                 |         \
#       |    .'     of the ball is enough                 |          |
#       | _-'                                             +----------+---- r
#     //////////// rigid plane                            0          a
#
# With 10 cells along the radius of the contact the ball on the plane takes up to 7,300 nodes, the
# two balls 16,000, the cylinder 1,500; all three, with linear and with quadratic elements, ten
# seconds and 800 MB. A number after the name of this script sets another mesh size.
#
# **Strong form.** In each body
#
# $$-\operatorname{div} \sigma(u) = 0, \qquad
# \sigma = 2 \mu \varepsilon + \lambda \operatorname{tr}(\varepsilon) I.$$
#
# The cut through the middle of the upper body is moved down by the approach; the cut of the lower
# body, if there is one, is held. On the contact surface, with the pressure $p$ and the gap $d_u$
# that is left,
#
# $$p \ge 0, \qquad d_u \ge 0, \qquad p\, d_u = 0.$$
#
# There is no friction, so no tangential traction.
#
# **Theory.** The bodies count as one with the radius $R$ and the modulus $E$, where $1/R =
# 1/R_{upper} + 1/R_{lower}$ (a plane has no curvature) and $1/E = \sum (1 - \nu^2)/E_{young}$ (a
# rigid body adds nothing). Under the force $F$ the pressure is $p = p_0 \sqrt{1 - r^2/a^2}$, with
# the following values for balls (left) and for cylinders (right):
#
# $$a^3 = \frac{3 F R}{4 E}, \quad p_0 = \frac{3 F}{2 \pi a^2}, \qquad\qquad
# a^2 = \frac{4 F R}{\pi E}, \quad p_0 = \frac{2 F}{\pi a}.$$
#
# ($F$ is per length for the cylinders: K. L. Johnson, Contact Mechanics, sections 4.2 and 5.6.) The
# theory takes the bodies for half-spaces with a parabola on them: its error is of order
# $(a/R)^2$.

# %%
import math
import sys
from types import SimpleNamespace

from mpi4py import MPI

import matplotlib
import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Frictionless,
    RigidPlane,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N. The bodies are of rubber foam.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 10  # cells along the radius of the contact
young, poisson, radius = 10.0, 0.3, 10.0  # MPa, -, mm: the upper body
lower_young, lower_poisson, lower_radius = 20.0, 0.4, 20.0  # the lower ball

modulus = young / (1 - poisson**2)  # MPa, E
lower_modulus = lower_young / (1 - lower_poisson**2)
two_radii = 1 / (1 / radius + 1 / lower_radius)  # mm, R of both balls

# %% [markdown]
# ## The scenes
# Each is an octant, or a quarter, of the bodies with cells of the size h at the contact; elsewhere
# they grow. `held` are the surfaces where a component of the displacement is prescribed. The meshes
# of the two balls do not match, so the package takes mortar elements; the rigid plane needs no
# mesh. `share` is the number of meshed parts that make up the whole contact.
#
# The motion of the middle of a ball does not follow from the deformation near the contact alone:
# the ball is held by an equal force from the other side, which pushes the contact back. `far` is
# this displacement divided by the force. It is small, some 5 percent of the approach here; the
# displacement of a half-space at the depth 2 R under a point load is a good estimate of it (Y.
# Tatara, J. Eng. Mater. Technol. 113, 1991).

# %%
far = ((1 + poisson) / 4 + (1 - poisson**2) / 2) / (math.pi * young * radius)
lower_far = (1 + lower_poisson) / 4 + (1 - lower_poisson**2) / 2
lower_far /= math.pi * lower_young * lower_radius

ball_on_plane = SimpleNamespace(
    name="ball on plane",
    file="sphere_octant.geo",
    parameters={"R": radius, "Zone": 1.68},
    h=1.2 / N,
    approach=0.144,
    materials={"upper": (young, poisson)},
    held=[("upper_x", 0, 0.0), ("upper_y", 1, 0.0), ("upper_cut", 2, -0.144)],
    secondary="upper_contact",
    primary=RigidPlane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)),
    share=4,
    R=radius,
    E=modulus,
    far=far,
)
two_balls = SimpleNamespace(
    name="two balls",
    file="sphere_octant.geo",
    parameters={
        "Bodies": 2, "R": radius, "R_lower": lower_radius, "Zone": 1.4 * math.sqrt(0.1 * two_radii)
    },
    h=0.8 / N,
    approach=0.1,
    materials={"upper": (young, poisson), "lower": (lower_young, lower_poisson)},
    held=[
        ("upper_x", 0, 0.0), ("upper_y", 1, 0.0), ("upper_cut", 2, -0.1),
        ("lower_x", 0, 0.0), ("lower_y", 1, 0.0), ("lower_cut", 2, 0.0),
    ],
    secondary="upper_contact",
    primary="lower_contact",
    share=4,
    R=two_radii,
    E=1 / (1 / modulus + 1 / lower_modulus),
    far=far + lower_far,
)  # fmt: skip
cylinder_on_plane = SimpleNamespace(
    name="cylinder on plane",
    file="half_disc.geo",
    parameters={"R": radius, "Zone": 1.56, "Arc": 3.0},
    h=0.6 / N,
    approach=0.2165,
    materials={"cylinder": (young, poisson)},
    held=[("symmetry", 0, 0.0), ("cut", 1, -0.2165)],
    secondary="contact",
    primary=RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0)),
    share=2,
    R=radius,
    E=modulus,
)

# %% [markdown]
# ## Solve and compare
# The displacement is prescribed, and the force, the integral of the pressure, is a result. Radius
# and pressure are compared with Hertz's for this force. The computed radius is that of a disc (for
# the cylinder, the half width of a strip) with the area of the pressed nodes; pressures are
# compared node by node. For cylinders the approach has a formula of its own (Johnson, equation
# 5.57).
#
# What may differ, and why? Hertz neglects a/R squared. On the mesh the edge of the contact lies
# between two nodes, so the radius is uncertain by a cell. At the edge the pressure falls steeply,
# like a square root, which the mesh smears over one ring of cells: the root mean square of this
# error is about h/a times the pressure. In the middle the pressure is smooth, and a smaller error
# is allowed, a part of h/a.

# %%
panels = {}  # for the picture: name of the scene, degree -> distances and pressures of the nodes
for scene in (ball_on_plane, two_balls, cylinder_on_plane):
    for degree in (1, 2):
        h = degree * scene.h
        if scene is two_balls:
            scene.parameters["h_lower"] = 1.3 * h
        bodies = read_gmsh(MESHES / scene.file, comm, h=h, **scene.parameters)
        mesh, facets, tags = bodies.mesh, bodies.facet_tags, bodies.tags
        dim = mesh.geometry.dim
        V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))

        E = fem.Function(fem.functionspace(mesh, ("DG", 0)))
        nu = fem.Function(E.function_space)
        for body, values in scene.materials.items():
            cells = bodies.cell_tags.find(tags[body])
            E.x.array[cells], nu.x.array[cells] = values
        mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
        a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
        L = ufl.inner(fem.Constant(mesh, np.zeros(dim)), v) * ufl.dx

        bcs = []
        for surface, component, value in scene.held:
            sub = V.sub(component)
            dofs = fem.locate_dofs_topological(sub, dim - 1, facets.find(tags[surface]))
            bcs.append(fem.dirichletbc(value, dofs, sub))

        primary = scene.primary if scene is not two_balls else tags[scene.primary]
        pair = ContactPair(facets, tags[scene.secondary], primary, Frictionless())
        problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("mm", "MPa", force="N"))
        solution = problem.solve(rtol=1e-6)
        solution.raise_if_failed()

        # what Hertz says
        force = scene.share * solution.normal_force
        if dim == 3:
            radius_a = (0.75 * force * scene.R / scene.E) ** (1 / 3)
            peak = 1.5 * force / (math.pi * radius_a**2)
            approach = radius_a**2 / scene.R - scene.far * force
        else:
            radius_a = math.sqrt(4 * force * scene.R / (math.pi * scene.E))
            peak = 2 * force / (math.pi * radius_a)
            approach = force / (math.pi * scene.E) * (2 * math.log(4 * scene.R / radius_a) - 1)

        # what is found
        surface, space = solution.surface, solution.pressure.function_space
        owned = space.dofmap.index_map.size_local
        r = np.linalg.norm(space.tabulate_dof_coordinates()[:owned, : dim - 1], axis=1)
        r, p = (np.concatenate(comm.allgather(x)) for x in (r, solution.pressure.x.array[:owned]))
        pressed = comm.allreduce(surface.weights[surface.touching].sum())
        found_a = math.sqrt(scene.share * pressed / math.pi) if dim == 3 else pressed
        near = r < 2 * radius_a
        hertz = peak * np.sqrt(np.maximum(1 - (r[near] / radius_a) ** 2, 0))
        difference = np.linalg.norm(p[near] - hertz) / np.linalg.norm(hertz)
        panels.setdefault(scene.name, {})[degree] = r / radius_a, p / peak

        if comm.rank == 0:
            print(f"\n{scene.name}, degree {degree}\n{solution}")
            print(f"{'force [N, N/mm]':<22}{force:<10.4g}")
            for name, found, wanted in (
                ("contact radius [mm]", found_a, radius_a),
                ("peak pressure [MPa]", p.max(), peak),
                ("approach [mm]", scene.approach, approach),
            ):
                print(f"{name:<22}{found:<10.4g}Hertz {wanted:<10.4g}{found / wanted - 1:+.1%}")
            print(f"{'pressures differ by':<22}{difference:.1%}, root mean square")

        # the law of contact; the residual of 1e-6 is a mean over the nodes
        assert p.min() >= 0.0
        assert solution.gap.x.array.min(initial=0.0) >= -1e-4 * scene.approach
        # the contact ends within the surface that was given to the package
        assert p[r > 1.3 * radius_a].max(initial=0.0) <= 1e-3 * p.max()

        coarsest = 1.3 * h if scene is two_balls else h
        cell, neglected = coarsest / radius_a, (radius_a / scene.R) ** 2
        assert abs(found_a / radius_a - 1) < cell + neglected
        assert abs(p.max() / peak - 1) < 0.4 * cell + neglected
        assert abs(scene.approach / approach - 1) < 0.3 * cell + neglected
        assert difference < cell + neglected

        if scene is ball_on_plane and degree == 1:
            solution.write("results/hertz_ball.pvd")
            solution.plot("results/hertz_ball.png", scale=1)

# %% [markdown]
# ## Draw
# The pressure of each node against its distance from the middle, and Hertz's curve. Quadratic
# displacements on cells twice as large are closer to the curve than linear ones. Linear ones show a
# row of nodes a little below the others: the nodes on a plane of symmetry, where the regular grid
# of tetrahedra meets its mirror image.


# %%
if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(panels), figsize=(8.8, 3.0), layout="constrained", sharey=True
    )
    x = np.linspace(0, 1.4, 1000)
    for panel, (name, degrees) in zip(axes, panels.items(), strict=True):
        panel.plot(x, np.sqrt(np.maximum(1 - x**2, 0)), color="black", lw=1, label="Hertz")
        for (degree, (r, p)), style in zip(degrees.items(), (".", "o"), strict=True):
            panel.plot(r[r < 1.4], p[r < 1.4], style, ms=4, label=f"nodes, degree {degree}")
        panel.set_title(name, fontsize=11)
        panel.set(xlabel="distance from the middle / Hertz's radius", ylim=(0, 1.1))
        panel.xaxis.label.set_size(9)
        panel.set_xticks([0, 0.5, 1])
        panel.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("pressure / Hertz's peak", fontsize=9)
    axes[0].legend(loc="lower left", frameon=False, fontsize=9)
    figure.savefig("results/hertz.png", dpi=200)
