# %% [markdown]
# # A stem in bone
#
# After the replacement of a hip a titanium stem sits in the thigh bone without cement: it is driven
# into a hole that is a little too narrow. The joint presses on its neck, downwards and sideways.
# How much of the stem slips? Its upper part has a rough coating, the tip is smooth. Bone
# grows into the coating only where the slip is less than some 0.04 mm.
#
#                         head: moved by the joint
#                            ____
#                           /   /
#       +------------------+   +-----------------+     z = 0
#       |               \  rough /               |
#       |  cortical      \      /     cortical   |
#       |     |  cancellous\smooth/     |        |
#       |     |             |___|      |        |     z = -50 mm
#       |                                       |
#       +---------------------------------------+     z = -65 mm
#       /////////////////////////////////////////     fixed
#     x = -25 mm                              x = 25
#
# y = 0 is a plane of symmetry; half of it is modelled. With 20 cells round the half hole it takes
# 4,660 nodes, 13 seconds and 560 MB; a number after the name of this script sets another mesh size.
#
# **Strong form.** In each body $-\operatorname{div} \sigma(u) = 0$. In the contact, with the
# outward normal $n$ of the hole and $[u] = u_{bone} - u_{stem}$,
#
# $$p \ge 0, \qquad [u] \cdot n \le d, \qquad p\,([u] \cdot n - d) = 0.$$
#
# The gap $d$ is negative, a press fit: -0.04 mm at the top of the hole, rising to zero at the
# tip. The tangential traction $t$ obeys $|t| \le g(x)$; where $|t| < g$ nothing slides,
# where $|t| = g$ the slip $[u]_t$ points along $t$.
#
# **What holds the stem?** Contact alone could (`demo_floating_block.py`), with the joint force as a
# load. Here the head of the joint is rigid and its motion prescribed, as in a testing machine; the
# joint force is the reaction.
#
# **The slip bound** comes from the press fit: its mean pressure, 3 MPa, times the coefficient of
# friction, 0.8 where the stem is rough and 0.1 where it is smooth. It does not depend on the
# pressure that the joint force causes. The first solution, with the head at rest, must have this
# mean pressure.
#
# **The mesh.** Stem and bone are cut from one another with Gmsh's OpenCASCADE kernel and share no
# nodes; the half hole has 20 cells round it, the half stem 16, so their meshes do not match. The
# facets of the stem are up to 0.03 mm below its surface, nearly as much as the overlap: `geometry=`
# tells the pair where the curved surfaces are.

# %%
import sys
from itertools import pairwise

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import default_scalar_type, fem

from dolfinx_tresca import (
    MESHES,
    ContactPair,
    ContactProblem,
    ProgressBar,
    SolutionWriter,
    Tresca,
    Units,
    read_gmsh,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa, so forces come in N and energies in N mm. Forces are those of the
# half model: the largest is 0.82 kN; twice this force, on the whole stem, acts in walking.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 20  # cells round the half hole
titanium, cancellous, cortical = 110_000.0, 1_000.0, 15_000.0  # MPa, Young's moduli
poisson = 0.3  # of all
width, shell = 50.0, 5.0  # mm, of the block and of its cortical shell
interference = 0.04  # mm, at the top of the stem; none at its tip
motion = np.array([-0.02, 0.0, -0.02])  # mm, of the head
press_fit = 3.0  # MPa, mean pressure
rough, smooth = 0.8 * press_fit, 0.1 * press_fit  # MPa, slip bounds
coated = -25.0  # mm, the coating ends at this height


# %% [markdown]
# Slip bound and modulus are functions of points, arrays of shape (3, n). Bone is stiff at the outer
# walls of the block and soft inside: one value in each cell.


# %%
def slip_bound(x):
    return smooth + (rough - smooth) * 0.5 * (1 + np.tanh((x[2] - coated) / 2.0))


def bone_modulus(x):
    depth = width / 2 - np.maximum(np.abs(x[0]), np.abs(x[1]))
    return cancellous + (cortical - cancellous) * 0.5 * (1 - np.tanh((depth - shell) / 1.5))


# %% [markdown]
# ## Mesh and forms

# %%
hip = read_gmsh(
    MESHES / "implant.geo", comm, N=N, M=round(0.8 * N), Interference=interference, Width=width
)
mesh, facets, tags = hip.mesh, hip.facet_tags, hip.tags
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))

young = fem.Function(fem.functionspace(mesh, ("DG", 0)))
young.interpolate(bone_modulus)
young.x.array[hip.cell_tags.find(tags["stem"])] = titanium
mu = young / (2 * (1 + poisson))
lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx
L = ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx

head = fem.Constant(mesh, np.zeros(3))  # mm, its displacement
fixed = fem.locate_dofs_topological(V, 2, facets.find(tags["bone_fixed"]))
moved = fem.locate_dofs_topological(V, 2, facets.find(tags["stem_joint"]))
bcs = [fem.dirichletbc(np.zeros(3), fixed, V), fem.dirichletbc(head, moved, V)]
for surface in ("bone_symmetry", "stem_symmetry"):
    dofs = fem.locate_dofs_topological(V.sub(1), 2, facets.find(tags[surface]))
    bcs.append(fem.dirichletbc(default_scalar_type(0.0), dofs, V.sub(1)))

# %% [markdown]
# ## Contact

# %%
pair = ContactPair(
    facets,
    secondary=tags["bone_contact"],
    primary=tags["stem_contact"],
    friction=Tresca(slip_bound),
    geometry=hip.geometry,
)
problem = ContactProblem(a, L, [pair], bcs=bcs, units=Units("mm", "MPa", force="N"))

# %% [markdown]
# ## What is measured
# The force on the nodes of a surface is the work of the stress on a unit displacement of these
# nodes alone. It comes from the displacement, not from the multipliers, and so it checks the
# multipliers. There is a form for each surface and each of the axes x and z.

# %%
uh = fem.Function(V)  # the displacement of each step
force_on = {}
for surface in ("stem_joint", "stem_contact", "bone_contact", "bone_fixed"):
    force_on[surface] = []
    for axis in (0, 2):
        unit = fem.Function(V)
        nodes = fem.locate_dofs_topological(V.sub(axis), 2, facets.find(tags[surface]))
        unit.x.array[nodes] = 1.0
        force_on[surface].append(fem.form(ufl.action(ufl.action(a, uh), unit)))

# %% [markdown]
# ## Solve
# The head moves in steps. K is factored once, and each solve starts from the previous solution. In
# step 0 the head is at rest; since the stem is tapered, the press fit alone pushes it out of the
# hole, and it takes 226 N to keep it there.
#
# In each step the law of contact holds at each node: no tension, friction within the bound at this
# node, slip only where the bound is reached, and along the traction. And the forces balance: the
# stem presses the bone as the bone presses the stem, the bone carries the whole joint force, and so
# does its base.

# %%
if comm.rank == 0:
    print("joint x, z [N]      p mean [MPa]   sliding %   slip [um]")
writer = SolutionWriter("results/implant.pvd")
joints, pressures, sliding, slips = [], [], [], []
for part in (0.0, 0.25, 0.5, 0.75, 1.0):
    head.value[:] = part * motion
    solution = problem.solve(rtol=1e-8, observer=ProgressBar(comm))
    solution.raise_if_failed()
    writer.write(solution, time=part)

    surface, space = solution.surface, solution.pressure.function_space
    bound = slip_bound(space.tabulate_dof_coordinates().T)
    traction, slip = (f.x.array.reshape(-1, 3) for f in (solution.traction, solution.slip))
    size, length = np.linalg.norm(traction, axis=1), np.linalg.norm(slip, axis=1)
    slides = length > 1e-3 * solution.greatest_slip
    assert solution.pressure.x.array.min(initial=0.0) >= 0.0
    assert (size <= bound * (1 + 1e-9)).all()
    assert (size[slides] >= bound[slides] * (1 - 1e-6)).all()
    along = np.einsum("ij,ij->i", traction, slip)
    assert (along[slides] >= 0.999 * (size * length)[slides]).all()

    uh.x.array[:] = solution.u.x.array
    joint, stem, bone, base = (
        np.array([comm.allreduce(fem.assemble_scalar(form)) for form in forms])
        for forms in force_on.values()
    )
    for one, other in ((stem, bone), (stem, joint), (base, bone)):
        assert np.linalg.norm(one + other) < 1e-6 * (np.linalg.norm(joint) + 1.0)

    area = comm.allreduce(surface.weights.sum())
    joints.append(joint)
    pressures.append(solution.normal_force / area)
    sliding.append(comm.allreduce(surface.weights[~surface.sticking].sum()) / area)
    slips.append(solution.greatest_slip)
    if comm.rank == 0:
        print(
            f"{joint[0]:8.1f} {joint[1]:8.1f} {pressures[-1]:12.2f} {100 * sliding[-1]:14.1f}"
            f" {1e3 * slips[-1]:11.2f}"
        )
if comm.rank == 0:
    print(solution)

# %% [markdown]
# ## Check
# With the head at rest the mean pressure is the one that the slip bound assumes. The joint force
# points to the side and down; the larger it is, the larger is the part of the stem that slips, but
# nowhere is the slip so large that it keeps bone from growing in.

# %%
assert abs(pressures[0] / press_fit - 1) < 0.1
assert (joints[-1] < -100.0).all()
assert all(after > before for before, after in pairwise(sliding))
assert slips[-1] < 0.04

solution.plot("results/implant.png")
