# %% [markdown]
# # The accuracy of the answer: a mesh that refines itself
#
# One elastic brick lies on another (see demo_two_bricks.py). Stresses are singular along the edges
# where the bricks are held and where they touch, and a uniform mesh is a poor one: the error in the
# energy norm falls with the number $n$ of unknowns about as $n^{-1/5}$ only. Here the mesh begins
# coarse, and is refined where an estimate of the error is large, until the error of the
# displacement is 10 % in the energy norm, or 1 % of the energy.
#
#             1 MPa
#       | | | | | | | | |
#       v v v v v v v v v
#       +---------------+//
#       |     upper     |//   z = 2
#       +===============+//   z = 1   contact
#     //|     lower     |
#     //+---------------+     z = 0
#     //
#       x = 0         x = 2
#
# **Loop.** Solve; estimate the error of each cell from the jumps of the strain to its neighbours;
# mark the fewest cells that together have 0.7 of the squared error (Doerfler's marking); bisect
# their edges.
#
# It takes twenty seconds and 770 MB. A number after the name of this script sets another accuracy,
# in percent.

# %%
import logging
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, locate_entities_boundary, meshtags

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    RigidPlane,
    TaggedMesh,
    Tresca,
    Units,
    read_gmsh,
    refine,
    solve_adaptively,
)

comm = MPI.COMM_WORLD
logging.basicConfig(level=logging.INFO, format="%(message)s")

# %% [markdown]
# ## Data
# Lengths in m, stresses in MPa.

# %%
accuracy = (int(sys.argv[-1]) if sys.argv[-1].isdigit() else 10) / 100
young = 50_000.0  # MPa, both bricks
poisson_ratios = {"upper": 0.277, "lower": 0.35}
slip_bound = 0.09  # MPa

# %% [markdown]
# ## The problem on a mesh
# The lines that an ordinary script runs once are a function here, which is called for each mesh. It
# must find all boundaries by the names of their tags, which refined meshes have too.


# %%
def build(bricks):
    mesh, facets, tags = bricks.mesh, bricks.facet_tags, bricks.tags
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))

    poisson = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    for brick, value in poisson_ratios.items():
        poisson.x.array[bricks.cell_tags.find(tags[brick])] = value
    mu = young / (2 * (1 + poisson))
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx

    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facets)
    load = fem.Constant(mesh, (0.0, 0.0, -1.0))  # MPa
    L = ufl.inner(load, v) * ds((tags["upper_top"], tags["upper_free_end"]))

    bcs = []
    for end in ("upper_fixed", "lower_fixed"):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tags[end]))
        bcs.append(fem.dirichletbc(np.zeros(3), dofs, V))

    pair = ContactPair(
        facets,
        secondary=tags["upper_contact"],
        primary=tags["lower_contact"],
        friction=Tresca(slip_bound),
    )
    return ContactProblem(a, L, [pair], bcs=bcs, units=Units("m", "MPa", force="MN"))


# %% [markdown]
# ## Solve
# The first mesh has four cells along each brick. The log has a line for each mesh, `print(result)`
# shows a table of all meshes, and `result.solution` is an ordinary solution, on the last mesh.

# %%
coarse = read_gmsh(MESHES / "two_bricks.geo", comm, N=4)
result = solve_adaptively(build, coarse, accuracy=accuracy)
solution = result.solution
if comm.rank == 0:
    print(result)
    print()
    print(solution)

# %% [markdown]
# For comparison: with `fraction=1.0` all cells are refined, and the meshes are uniform.

# %%
uniform = solve_adaptively(
    build, coarse, accuracy=accuracy, fraction=1.0, max_dofs=result.levels[-1].free_dofs
)

# %% [markdown]
# ## Check
# The accuracy was reached, with far fewer unknowns than uniform meshes need. Refinement has not
# changed the volumes and areas of the parts that have names.

# %%
result.raise_if_failed()
assert result.error <= accuracy
assert uniform.error > result.error

for kind, tags, name, size in (
    ("dx", result.tagged_mesh.cell_tags, "upper", 2.0),
    ("ds", result.tagged_mesh.facet_tags, "upper_contact", 2.0),
    ("ds", result.tagged_mesh.facet_tags, "lower_fixed", 1.0),
):
    measure = ufl.Measure(kind, domain=result.tagged_mesh.mesh, subdomain_data=tags)
    one = fem.Constant(result.tagged_mesh.mesh, 1.0)
    found = fem.assemble_scalar(fem.form(one * measure(coarse.tags[name])))
    assert abs(comm.allreduce(found) - size) < 1e-9 * size

# %% [markdown]
# ## A guaranteed error
# The error above is estimated: it is about right, but may be larger. For triangles and tetrahedra,
# rigid planes and meshes that match, there is also a proven bound of the whole error: of mesh,
# contact and iteration. Here is a strip that is clamped at its left end, and dragged and lifted
# over a floor. It is refined where the bound's parts are large, until the error is proven to be
# below 5 %.

# %%
strip = create_rectangle(comm, [(0.0, 0.0), (2.0, 1.0)], [16, 8], CellType.triangle)
names = {"left": 1, "floor": 2, "top": 3}
sides = [
    locate_entities_boundary(strip, 1, lambda x: np.isclose(x[0], 0.0)),
    locate_entities_boundary(strip, 1, lambda x: np.isclose(x[1], 0.0)),
    locate_entities_boundary(strip, 1, lambda x: np.isclose(x[1], 1.0)),
]
tags = np.repeat(np.array([1, 2, 3], dtype=np.int32), [len(side) for side in sides])
order = np.argsort(np.concatenate(sides))
side_tags = meshtags(strip, 1, np.concatenate(sides)[order], tags[order])
strips = TaggedMesh(strip, None, side_tags, names)


def drag(strips):
    V = fem.functionspace(strips.mesh, ("Lagrange", 1, (2,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu, lame = 0.4, 0.6  # MPa
    strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
    ds = ufl.Measure("ds", domain=strips.mesh, subdomain_data=strips.facet_tags)
    x = ufl.SpatialCoordinate(strips.mesh)
    L = ufl.inner(ufl.as_vector((0.02, 0.02 - 0.03 * x[0])), v) * ds(names["top"])
    dofs = fem.locate_dofs_topological(V, 1, strips.facet_tags.find(names["left"]))
    floor = RigidPlane(point=(0, 0), normal=(0, 1))
    pair = ContactPair(strips.facet_tags, names["floor"], floor, Tresca(0.01))
    return ContactProblem(a, L, [pair], bcs=[fem.dirichletbc(np.zeros(2), dofs, V)])


while True:
    with drag(strips) as problem:
        problem.solve()
        bound = problem.guaranteed_error()
    if comm.rank == 0:
        print(f"{problem!r}: the error is at most {bound.relative_error:.1%}")
    if bound.relative_error < 0.05:
        break
    strips = refine(strips, bound.cell_errors)

# %% [markdown]
# ## Write and draw
# Above: the bricks with the mesh, whose cells are small along the held edges and at the edges of
# the contact. Below: the error against the number of unknowns.

# %%
solution.write("results/adaptive.pvd")
picture = solution.plot()

if comm.rank == 0:
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    height = 2.8  # inches
    figure = Figure(figsize=(picture.width / 200, picture.height / 200 + height))
    part = height / figure.get_figheight()
    above = figure.add_axes((0.0, part, 1.0, 1.0 - part))
    above.imshow(picture, interpolation="none", aspect="auto")
    above.set_axis_off()
    axes = figure.add_axes((0.09, 0.18 * part, 0.86, 0.72 * part))
    for levels, label, style in (
        (uniform.levels, "uniform", "s--"),
        (result.levels, "refined where the error is", "o-"),
    ):
        unknowns = [level.free_dofs for level in levels]
        axes.loglog(unknowns, [100 * level.error for level in levels], style, label=label)
    axes.axhline(100 * accuracy, color="black", lw=0.8, ls=":")
    axes.set_xlabel("unknowns", fontsize=9)
    axes.set_ylabel("error in %", fontsize=9)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    for axis, text in ((axes.xaxis, "{x:,.0f}"), (axes.yaxis, "{x:g}")):
        axis.set_major_formatter(text)
        axis.set_minor_formatter("" if axis is axes.xaxis else text)
    axes.tick_params(which="both", labelsize=8.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8.5)
    Path("results").mkdir(exist_ok=True)
    figure.savefig("results/adaptive.png", dpi=200)
