"""Two bricks in contact with Tresca friction: the complete script of README.md."""

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import MESHES, ContactPair, ContactProblem, Tresca, Units, read_gmsh

bricks = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_WORLD, N=16)  # or your own .geo, .msh, .step
facets, tags = bricks.facet_tags, bricks.tags
V = fem.functionspace(bricks.mesh, ("Lagrange", 1, (3,)))

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
young, poisson = 50_000.0, 0.3  # MPa, dimensionless
mu, lame = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
strain = ufl.sym(ufl.grad(u))
stress = 2 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(3)
a = ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx
ds = ufl.Measure("ds", domain=bricks.mesh, subdomain_data=facets)
load = fem.Constant(bricks.mesh, (0.0, 0.0, -1.0))  # MPa
L = ufl.inner(load, v) * ds((tags["upper_top"], tags["upper_free_end"]))
ends = [facets.find(tags[name]) for name in ("upper_fixed", "lower_fixed")]
bcs = [
    fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets_of_end), V)
    for facets_of_end in ends
]

friction = Tresca(0.09)  # MPa
pair = ContactPair(facets, tags["upper_contact"], tags["lower_contact"], friction=friction)
problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("m", "MPa", force="MN"))
solution = problem.solve()  # or solve(accuracy=1e-4), solve(rtol=1e-8)
solution.raise_if_failed()
if MPI.COMM_WORLD.rank == 0:
    print(solution)
solution.write("results/two_bricks.pvd")  # for ParaView
solution.plot("results/two_bricks.png")
