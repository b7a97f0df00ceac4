# %% [markdown]
# # Two bricks in contact with Tresca friction
#
# One elastic brick lies on another. The upper one is fixed at its right end, the lower one at its
# left end; a traction of 1 MPa presses the top of the upper brick and one of the free ends. Where
# the bricks touch, friction resists sliding with at most 0.09 MPa. This is the scene of the paper
# that the package implements (Kucera, Haslinger, Motyckova, Markopoulos 2017, section 38.5).
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
# With 16 cells along each brick it takes 8,704 nodes, a few seconds and 600 MB; a number after the
# name of this script sets another mesh size.
#
# **Strong form.** In each brick, with the strain $\varepsilon$ of the displacement $u$,
#
# $$-\operatorname{div} \sigma(u) = 0, \qquad
# \sigma = 2 \mu \varepsilon + \lambda \operatorname{tr}(\varepsilon) I.$$
#
# On the contact surface, with the outward normal $n$ of the upper brick, the jump
# $[u] = u_{upper} - u_{lower}$ and the gap $d$, the pressure $p$ obeys
#
# $$p \ge 0, \qquad [u] \cdot n \le d, \qquad p\,([u] \cdot n - d) = 0,$$
#
# and the tangential traction $t$ obeys $|t| \le g$; where $|t| < g$ nothing slides, where $|t| = g$
# the slip $[u]_t$ points along $t$.
#
# **Weak form.** Minimise, over all displacements without penetration,
#
# $$\tfrac12 a(u, u) - L(u) + \int_{\gamma_c} g\, |[u]_t|:$$
#
# the elastic energy less the work of the loads plus the work of friction. The user writes $a$ and
# $L$ in UFL; the package adds the rest.
#
# **Discrete form.** The unknowns are multipliers, pressures and tractions at the nodes of the upper
# contact face. The package solves the dual problem in these multipliers; each step takes one solve
# of the elastic problem.

# %%
import logging
import sys

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ProgressBar,
    Tresca,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD
logging.basicConfig(level=logging.INFO, format="%(message)s")

# %% [markdown]
# ## Data
# Lengths in m, stresses in MPa, so forces come in MN and energies in MN m.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 16  # cells along each brick
young = 50_000.0  # MPa, both bricks
poisson_ratios = {"upper": 0.277, "lower": 0.35}
slip_bound = 0.09  # MPa

# %% [markdown]
# ## Mesh and forms
# An ordinary FEniCSx script: nothing here knows of contact.

# %%
bricks = read_gmsh(MESHES / "two_bricks.geo", comm, N=N)
mesh, facets, tags = bricks.mesh, bricks.facet_tags, bricks.tags
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

poisson = fem.Function(fem.functionspace(mesh, ("DG", 0)))
for brick, value in poisson_ratios.items():
    poisson.x.array[bricks.cell_tags.find(tags[brick])] = value
mu = young / (2 * (1 + poisson))
lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx

# %% [markdown]
# The paper's text allows two readings of where the second load acts: with "lower_free_end" in place
# of "upper_free_end" different nodes stick.

# %%
ds = ufl.Measure("ds", domain=mesh, subdomain_data=facets)
load = fem.Constant(mesh, (0.0, 0.0, -1.0))  # MPa
L = ufl.inner(load, v) * ds((tags["upper_top"], tags["upper_free_end"]))

bcs = []
for end in ("upper_fixed", "lower_fixed"):
    dofs = fem.locate_dofs_topological(V, 2, facets.find(tags[end]))
    bcs.append(fem.dirichletbc(np.zeros(3), dofs, V))

# %% [markdown]
# ## Contact
# A pair has two surfaces, given by their tags, and the law of friction between them.

# %%
pair = ContactPair(
    facets,
    secondary=tags["upper_contact"],
    primary=tags["lower_contact"],
    friction=Tresca(slip_bound),
)
problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("m", "MPa", force="MN"))
solution = problem.solve(observer=ProgressBar(comm))
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check
# Checked are convergence, the law of contact at each node, and that the error of the iteration is
# well below the error of the mesh. (The fields are of degree 1: their values are nodal values.)

# %%
solution.raise_if_failed()
assert solution.pressure.x.array.min(initial=0.0) >= 0.0
traction = np.linalg.norm(solution.traction.x.array.reshape(-1, 3), axis=1)
assert traction.max(initial=0.0) <= slip_bound * (1 + 1e-12)
assert solution.energy_error_bound < 0.15 * solution.discretisation_error

# %% [markdown]
# ## Write and draw
# The picture shows the bent bricks and, seen from above, the contact: only the half near the
# supports of the lower brick is pressed, and friction drags nodes that are open as well. That is
# what Tresca's law means: its bound does not depend on the pressure.

# %%
solution.write("results/two_bricks.pvd")  # for ParaView
solution.plot("results/two_bricks.png")
