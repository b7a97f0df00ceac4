# %% [markdown]
# # Which rollers of a bearing carry the load
#
# A roller bearing with 16 rollers between two rings, without clearance. The shaft presses the inner
# ring down by a small distance $\delta$. The lower half of the rollers carries the load, and the
# upper half is loose: contact and friction alone hold all of them. How large is the force on the
# lowest roller?
#
#               .-'''''-.
#             .'  o o o  '.        o  rollers, their angle psi from the load
#            / o .-----. o \
#           | o |       | o |
#           | o |   F   | o |      F  load
#            \ o '--|--' o /
#             '.  o v o  .'
#               '-.....-'
#
# **Theory.** Rings that do not bend approach each other by $\delta \cos\psi$ at the angle $\psi$
# from the load. A roller that is squeezed by $s$ has the force $K s^n$, with $n = 1$ for a linear
# law and $n = 10/9$ for a line contact (Palmgren). Equilibrium of the inner ring gives the greatest
# force $Q$ of $Z$ rollers:
#
# $$F = Q \sum_\psi \cos^{n+1}\psi
#     \approx \frac{Z Q}{2\pi} \int_{-\pi/2}^{\pi/2} \cos^{n+1}\psi \,d\psi.$$
#
# For $n = 1$ this is $Q = 4 F / Z$, Stribeck's formula for rollers (1901), and for $n = 10/9$
# Sjövall's integral (1933), $Q = 4.08 F / Z$; both are in T. A. Harris and M. N. Kotzalas, Rolling
# Bearing Analysis, 5th edition, chapter 7.
#
# A number after the name of this script sets the number of cells in 0.4 mm of a contact. With 4
# cells it takes 15 seconds.

# %%
import sys

from mpi4py import MPI

import numpy as np
from scipy.integrate import quad

import ufl
from dolfinx import fem

from dolfinx_tresca import MESHES, ContactPair, ContactProblem, Coulomb, Units, read_gmsh

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, forces in N for each mm of the length of the rollers. Friction is
# needed only to keep the rollers where they are; the forces hardly depend on it.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 4  # cells in 0.4 mm
rollers = 16
youngs_modulus, poisson_ratio, friction = 208e3, 0.3, 0.1
delta = 0.04

# %% [markdown]
# ## The problem
# The housing is rigid, and so is the shaft. One pair contains all rollers and both raceways. A
# `search_distance` excludes pairs of distant points, since the two raceways face each other between
# the rollers.

# %%
bearing = read_gmsh(MESHES / "bearing.geo", comm, N=N, M=rollers)
facets, tags = bearing.facet_tags, bearing.tags
V = fem.functionspace(bearing.mesh, ("Lagrange", 1, (2,)))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
mu = youngs_modulus / (2 * (1 + poisson_ratio))
lame = youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
L = ufl.inner(fem.Constant(bearing.mesh, np.zeros(2)), v) * ufl.dx
bcs = [
    fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facets.find(tags[name])), V)
    for name, value in (("bore", np.array([0.0, -delta])), ("housing", np.zeros(2)))
]
pair = ContactPair(
    facets,
    tags["rollers"],
    tags["raceways"],
    Coulomb(friction),
    search_distance=0.5,
    geometry=bearing.geometry,
)
with ContactProblem(a, L, [pair], bcs, units=Units("mm", "MPa", force="N")) as problem:
    solution = problem.solve(rtol=1e-6)
solution.raise_if_failed()
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Forces of the rollers
# Bodies have the names that the mesh file gives them.

# %%
angles = 2 * np.pi / rollers * np.arange(rollers)  # from the load
on_outer = [solution.resultants_between("outer ring", f"roller {k + 1}") for k in range(rollers)]
forces = np.array([np.linalg.norm(one.force) for one in on_outer])
load = -sum(one.force[1] for one in on_outer)


def of_theory(exponent):
    """Return the forces of all rollers, divided by the load F."""
    shares = np.maximum(np.cos(angles), 0.0) ** exponent
    return shares / (shares @ np.cos(angles))


integral = quad(lambda psi: np.cos(psi) ** (19 / 9), -np.pi / 2, np.pi / 2)[0] / (2 * np.pi)
factor = forces.max() * rollers / load
if comm.rank == 0:
    print(f"\nload {load:.1f} N/mm, greatest force {forces.max():.1f} N/mm")
    print(f"greatest force Z / F: {factor:.3f}; Stribeck 4, Sjovall {1 / integral:.3f}")
    print("\nangle   force / load   n = 1   n = 10/9")
    for k in range(rollers // 2 + 1):
        print(
            f"{np.degrees(angles[k]):5.1f} {forces[k] / load:14.4f} "
            f"{of_theory(1)[k]:7.4f} {of_theory(10 / 9)[k]:10.4f}"
        )
assert 0.98 * 4 < factor < 1.02 / integral
assert np.abs(forces / load - of_theory(10 / 9)).max() < 0.015
assert forces[np.cos(angles) < -1e-6].max() < 1e-6 * load

# %% [markdown]
# Plane contact is nearly linear, with a logarithm in place of the power 10/9. So the computed force
# is between the two formulas. The rollers at 90 degrees carry a small force, since the facets of
# the mesh are not exact circles; it vanishes on finer meshes. Loose rollers have no force at all.
#
# ## Draw
# `solution.between_bodies` has the force on the body with the lower number, and the point where it
# acts, for each contact of two bodies.

# %%
solution.write("results/bearing.pvd")
blocks = solution.to_pyvista()
if comm.rank == 0:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    volume, contacts = blocks["volume"], solution.between_bodies.values()
    points, cells = volume.points[:, :2], volume.cell_connectivity.reshape(-1, 3)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
    left.add_collection(PolyCollection(points[cells], fc="#d8dde3", ec="#a8b0ba", lw=0.15))
    outer = [on for on in contacts if np.linalg.norm(on.point) > 30.0]  # of two of each roller
    where, force = (np.array([getattr(on, name) for on in outer]) for name in ("point", "force"))
    arrows = 15.0 / forces.max() * force * np.sign(np.sum(where * force, axis=1))[:, None]
    style = dict(angles="xy", scale_units="xy", scale=1.0, color="tab:red", width=0.008)
    left.quiver(*(where - arrows).T, *arrows.T, **style)
    left.set(xlim=(-41, 41), ylim=(-41, 41), aspect="equal", title="forces on the outer ring")
    left.axis("off")
    degrees = np.linspace(0.0, 90.0, 181)
    for exponent, label in ((1, "n = 1 (Stribeck)"), (10 / 9, "n = 10/9 (Sjövall)")):
        shares = of_theory(exponent).max() * np.cos(np.radians(degrees)) ** exponent
        right.plot(degrees, shares, label=label)
    half = slice(0, rollers // 2 + 1)
    right.plot(np.degrees(angles[half]), forces[half] / load, "ko", label="computed")
    right.set(xlabel="angle from the load", ylabel="force of a roller / load", xlim=(-5, 185))
    right.legend(frameon=False)
    figure.savefig("results/bearing.png", dpi=150)
