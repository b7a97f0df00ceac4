# %% [markdown]
# # How thin may an arch be?
#
# A semicircular arch of 25 stones (voussoirs), without mortar, stands under its own weight. Contact
# and friction alone hold the stones. How thin may the arch be? This is Couplet's problem of 1730.
# Milankovitch found in 1907 that the thickness must be at least 0.1075 times the radius $R$ of the
# centre line, if stones are rigid and do not slide, and if there is a radial joint at each angle
# ([Makris and Alexakis 2013](https://doi.org/10.1007/s00419-013-0763-4)). An arch of this thickness
# has hinges at its outer side at the crown and the springings, and at its inner side 54.5 degrees
# from the crown.
#
#                   __--- o ---__                  o  hinge at the outer side
#                .-'             '-.               x  hinge at the inner side
#               x                   x
#             /           |           \
#            |            | R          |
#         ---o------------+------------o---  rigid floor
#
# **One declaration.** `ContactPair` with the same tag on both sides says that all surfaces with
# this tag may touch each other. The package finds the 24 joints.
#
# **Nothing else is assumed.** The stones are elastic. Each node of a joint presses, slips or is
# open, and forces between stones are results. Below the least thickness no forces balance the
# weights, and `solve` says so.
#
# A number after the name of this script sets the number of cells across the arch. With 4 cells it
# takes about 10 seconds.

# %%
import sys
import textwrap

from mpi4py import MPI

import numpy as np
from scipy.optimize import brentq

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    Coulomb,
    MechanismError,
    RigidPlane,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in m, stresses in MPa; forces are in MN for a width of the arch of 1 m. A coefficient of
# friction of 0.7 excludes sliding: at the springings, where most friction is needed, the resultant
# has the slope 0.395 against the normal of the joint.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 4  # cells across the arch
stones, R = 25, 1.0
youngs_modulus, poisson_ratio, weight, friction = 1e4, 0.2, 0.025, 0.7
joints = np.linspace(-np.pi / 2, np.pi / 2, stones + 1)  # angles from the crown

# %% [markdown]
# ## Statics of rigid stones
# Let $w \varphi$ be the weight of the arch between the crown and a joint at the angle $\varphi$,
# and $m (1 - \cos \varphi)$ its moment about the axis of symmetry. The horizontal thrust $H$ is the
# same in all joints, and passes at the height $h$ through the axis of symmetry. The resultant in
# the joint passes through the joint at the radius
#
# $$\rho(\varphi) = \frac{H h + m (1 - \cos \varphi)}{H \cos \varphi + w \varphi \sin \varphi}.$$
#
# $H$ and $h$ follow from hinges at the outer side of the springings and of the joints next to the
# crown. The thickness is the least possible one if the line of thrust touches the inner side
# somewhere between these hinges. Many stones give 0.1075. With 25 stones there is no joint at the
# crown, and none at exactly 54.5 degrees, so they need a little less.


# %%
def inner_clearance(thickness, angles):
    """Return the least distance of the line of thrust from the inner side, relative to R."""
    inner, outer = 1 - thickness / 2, 1 + thickness / 2
    w, m = (outer**2 - inner**2) / 2, (outer**3 - inner**3) / 3
    first = angles[0]
    thrust_times_height = outer * w * np.pi / 2 - m
    moment = thrust_times_height + m * (1 - np.cos(first))
    thrust = (moment - outer * w * first * np.sin(first)) / (outer * np.cos(first))
    numerator = thrust_times_height + m * (1 - np.cos(angles))
    return (numerator / (thrust * np.cos(angles) + w * angles * np.sin(angles)) - inner).min()


least = {
    number: brentq(
        inner_clearance, 0.05, 0.2, args=((np.arange(number // 2 + 1) + 0.5) * np.pi / number,)
    )
    for number in (stones, 1001)
}
if comm.rank == 0:
    for number, value in least.items():
        print(f"rigid stones: {number:5}   least thickness: {value:.5f} R")
assert abs(least[1001] / 0.1075 - 1) < 1e-3

# %% [markdown]
# ## The problem
# In the mesh file each stone is a body of its own, and all sides that may touch others have one
# tag.


# %%
def arch(thickness):
    """Return the problem of an arch under its weight."""
    made = read_gmsh(MESHES / "arch.geo", comm, N=N, M=stones, R=R, T=thickness)
    V = fem.functionspace(made.mesh, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu = youngs_modulus / (2 * (1 + poisson_ratio))
    lame = youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
    L = -weight * v[1] * ufl.dx
    facets, tags, law = made.facet_tags, made.tags, Coulomb(friction)
    floor = RigidPlane(point=(0, 0), normal=(0, 1))
    pairs = [
        ContactPair(facets, tags["left_springing"], floor, law),
        ContactPair(facets, tags["right_springing"], floor, law),
        ContactPair(facets, tags["joints"], tags["joints"], law),
    ]
    return ContactProblem(a, L, pairs, units=Units("m", "MPa", force="MN"))


with arch(0.15 * R) as problem:
    if comm.rank == 0:
        print(problem)

# %% [markdown]
# ## The least thickness, from both sides
# If the arch can stand, a solution is found. If it cannot, `solve` raises a `MechanismError` before
# it iterates. The error names the body that moves most, and has the motion of all bodies as a
# Function.

# %%
stands, falls = 0.12, 0.10
if comm.rank == 0:
    print("\nthickness / R")
while stands / falls > 1.001:
    middle = (stands + falls) / 2
    try:
        with arch(middle * R) as problem:
            solution = problem.solve(rtol=1e-6)
        solution.raise_if_failed()
        stands, result = middle, "stands"
    except MechanismError as error:
        falls, result, message, motion = middle, "falls", str(error), error.motion
        assert "no contact forces balance the loads" in message
    if comm.rank == 0:
        print(f"{middle:10.5f}   {result}")
if comm.rank == 0:
    print(f"\nat {falls:.5f} R:\n{textwrap.indent(textwrap.fill(message, 96), '    ')}")
assert falls < least[stones] * (1 + 1e-3) and stands > least[stones] * (1 - 1e-3)
assert 0.98 * 0.1075 < falls < stands < 1.02 * 0.1075

# %% [markdown]
# ## Line of thrust and hinges
# `solution.resultants_between(i, j)` is the force and the moment on body i by body j; bodies are
# counted from the left to the right here. The resultant passes through a joint at the distance
# moment / normal force from the centre line. Where this distance is half of the thickness, to a
# hundredth, the joint touches at its edge only: a hinge.

# %%
thickness = 0.1072 * R
with arch(thickness) as problem:
    solution = problem.solve(rtol=1e-6)
solution.raise_if_failed()
outwards = np.column_stack([np.sin(joints), np.cos(joints)])
along = np.column_stack([np.cos(joints), -np.sin(joints)])
centres = R * outwards
on_left = [solution.resultants_between(k - 1, k, centres[k]) for k in range(1, stones)]
left, right, _ = solution.pair_resultants  # on the springings, by the floor
normal = np.array([-one.force @ n for one, n in zip(on_left, along[1:-1], strict=True)])
moment = np.array([one.moment[0] for one in on_left])
normal = np.array([left.force[1], *normal, right.force[1]])
ends = left.about(centres[0]).moment[0], right.about(centres[-1]).moment[0]
moment = np.array([-ends[0], *moment, ends[1]])
eccentricity = moment / normal
hinges = np.flatnonzero(np.abs(eccentricity) > 0.49 * thickness)
if comm.rank == 0:
    print("\nhinges at     side    normal force [kN]")
    for k in hinges:
        side = "outer" if eccentricity[k] > 0 else "inner"
        print(f"{np.degrees(joints[k]):8.1f}      {side}{1e3 * normal[k]:14.3f}")
assert np.allclose(np.degrees(joints[hinges]), [-90, -54, -3.6, 3.6, 54, 90])
assert np.array_equal(np.sign(eccentricity[hinges]), [1, -1, 1, 1, -1, 1])

# %% [markdown]
# ## Draw
# Left: the line of thrust. Middle: the displacement, magnified; at a hinge the joint opens on the
# opposite side. The keystone, in the middle of the arch, touches its neighbours at its two upper
# corners. It can turn about either corner without resistance, so one of these joints opens, or both
# do. Right: the mechanism of the arch that is too thin; the crown falls, and the haunches move
# outwards.

# %%
solution.write("results/arch.pvd")
blocks = solution.to_pyvista()
V = motion.function_space
fallen = V.tabulate_dof_coordinates()[:, :2] + 0.15 * R * motion.x.array.reshape(-1, 2)
own_cells = V.dofmap.list[: V.mesh.topology.index_map(2).size_local, [0, 1, 3, 2]]
fallen = comm.gather(fallen[own_cells])
if comm.rank == 0:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    volume = blocks["volume"]
    u = volume["displacement"]
    scale = 0.08 * R / np.linalg.norm(u, axis=1).max()
    cells = volume.cell_connectivity.reshape(-1, 4)
    line = centres + eccentricity[:, None] * outwards
    edges = centres + 0.5 * thickness * np.sign(eccentricity)[:, None] * outwards
    nearest = [np.linalg.norm(volume.points[:, :2] - edges[k], axis=1).argmin() for k in hinges]

    figure, axes = plt.subplots(1, 3, figsize=(12.0, 2.5), layout="constrained")
    titles = [
        f"thickness {thickness / R:g} R: line of thrust",
        f"thickness {thickness / R:g} R: displacement x {scale:.0f}",
        f"thickness {falls / R:.4f} R: mechanism",
    ]
    points = [(volume.points + factor * u)[:, :2] for factor in (0.0, scale)]
    stones = [points[0][cells], points[1][cells], np.concatenate(fallen)]
    for one, polygons, title in zip(axes, stones, titles, strict=True):
        one.add_collection(PolyCollection(polygons, fc="#e3d8c3", ec="#a89878", lw=0.4))
        one.axhline(0.0, color="0.4", lw=1.0, zorder=0)
        one.set(xlim=(-1.2 * R, 1.2 * R), ylim=(-0.06 * R, 1.12 * R), aspect="equal")
        one.set_title(title, fontsize=10)
        one.axis("off")
    for one, at in zip(axes, points, strict=False):
        one.plot(*at[nearest].T, "o", color="tab:red", ms=6, label="hinges")
    axes[0].plot(*line.T, color="tab:blue", lw=1.4, label="line of thrust")
    axes[0].legend(frameon=False, loc="lower center")
    figure.savefig("results/arch.png", dpi=150)
