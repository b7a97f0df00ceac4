# %% [markdown]
# # Calibrate: friction, modulus and misalignment from a hysteresis loop
#
# A fretting rig presses a pad on a hard plate and moves it to and fro, by 20 µm. It records two
# forces in 40 load steps, with noise. What were the coefficient of friction, Young's modulus of the
# pad, and the angle by which it is out of line? One loop determines all three: its slope shows the
# modulus, its width shows the friction, and its round corners, where one edge slips before the
# other, show the angle.
#
#               top: moved to and fro, and pressed            Q      .------.
#             +---------------------------------+             |     /      /
#             |               pad               |             |    /      /
#             |                                 |             |   /      /
#             +-----___                 ___-----+             |  /      /
#       /////////////////"""""""""""""////////////            | '------'
#                  plate, rigid          angle                +------------ shift
#
# **Model.** The pad is elastic, $-\operatorname{div} \sigma(u) = 0$, in plane strain; its lower
# face is slightly crowned and inclined: the gap is $d(x) = x^2/2R + \alpha x$. With the pressure
# $p$ and the tangential traction $t$
#
# $$p \ge 0, \qquad -u_y \le d, \qquad p\,(u_y + d) = 0, \qquad |t| \le F p,$$
#
# and where $|t| = F p$ the slip of a load step goes against $t$: forces depend on the path to the
# present load, through all previous steps.
#
# **Least squares.** With $m = (F, E, \alpha)$ and the standard deviation $s$ of the noise minimise
#
# $$J(m) = \frac{1}{2 n} \sum_{k=1}^{n} \left( \frac{f_k(m) - \bar f_k}{s} \right)^2.$$
#
# `problem.record()` keeps the load steps, and `tape.gradient` goes backwards through them once: one
# adjoint solve for each step gives the derivatives of the whole sum by all parameters.
#
# **Measured data** are not at hand: they are computed, on a finer mesh than the mesh of the fit,
# with noise from a fixed seed, so the true parameters are known.
#
# With quadratic elements, 16 across the pad, it takes about a minute; a number after the name of
# this script sets the number of elements, to which the number of load steps is proportional.

# %%
import sys

from mpi4py import MPI

import matplotlib
import numpy as np
from scipy.optimize import minimize

import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, locate_entities_boundary, meshtags

from dolfinx_tresca import (
    ContactForce,
    ContactPair,
    ContactProblem,
    Coulomb,
    NormalForce,
    RigidPlane,
    Units,
)

comm = MPI.COMM_WORLD

# %% [markdown]
# ## Data
# Lengths in mm, stresses in MPa; forces are in N for a thickness of 1 mm.

# %%
N = int(sys.argv[-1]) if sys.argv[-1].isdigit() else 16  # elements across the pad
width, height, crown_radius, poisson = 10.0, 5.0, 5000.0, 0.33
press, amplitude = 0.006, 0.02  # mm, of the top
names = ("coefficient of friction", "Young's modulus [MPa]", "angle [mrad]")
truth = {"friction": 0.6, "young": 70_000.0, "angle": 0.5e-3}
scales = np.array(list(truth.values()))  # controls are near 1 in these units

there, back = np.linspace(0, 1, N // 2 + 1)[1:], np.linspace(1, -1, N + 1)[1:]
shifts = amplitude * np.concatenate([there, back, -back])
noise = 0.02  # standard deviation of each force, divided by its largest value

# %% [markdown]
# ## The rig
# The class has a problem, its controls, and the process of all load steps. The modulus is part of
# K, so `update_stiffness` comes before the process; the slip counts from the unloaded pad.

# %%
FORCES = [ContactForce(direction=(-1.0, 0.0)), NormalForce()]


class Rig:
    """The rig on a mesh of n elements across the pad."""

    def __init__(self, n):
        corners = [(-width / 2, 0.0), (width / 2, height)]
        mesh = create_rectangle(comm, corners, [n, n // 2], CellType.quadrilateral)
        bottom = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
        top = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], height))
        facets = meshtags(mesh, 1, bottom, np.full(len(bottom), 1, dtype=np.int32))
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))

        friction, young, angle = (fem.Constant(mesh, value) for value in truth.values())
        self.controls = [friction, young, angle]
        mu = young / (2 * (1 + poisson))
        lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        strain_u, strain_v = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
        a = (2 * mu * ufl.inner(strain_u, strain_v) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx

        self.motion = fem.Constant(mesh, np.zeros(2))
        bcs = [fem.dirichletbc(self.motion, fem.locate_dofs_topological(V, 1, top), V)]
        x = ufl.SpatialCoordinate(mesh)
        pair = ContactPair(
            facets,
            secondary=1,
            primary=RigidPlane(point=(0, 0), normal=(0, 1)),
            friction=Coulomb(friction),
            gap=x[0] ** 2 / (2 * crown_radius) + angle * x[0],
            name="pad",
        )
        units = Units("mm", "MPa", force="N")
        self.problem = ContactProblem(a, None, [pair], bcs, units=units)

    def run(self, values):
        """Return the forces (steps, 2) of a process with these controls, and its tape."""
        for control, scale, value in zip(self.controls, scales, values, strict=True):
            control.value = scale * value
        self.problem.update_stiffness()
        self.problem.set_slip_origin(None)
        forces = []
        with self.problem.record() as tape:
            for shift in shifts:
                self.motion.value[:] = shift, -press
                self.solution = self.problem.solve(rtol=1e-8)
                self.solution.raise_if_failed()
                forces.append([self.problem.goal_value(force) for force in FORCES])
                self.problem.accept()
        return np.array(forces), tape


exact, _ = Rig(3 * N // 2).run(np.ones(3))
spread = noise * np.abs(exact).max(axis=0)
measured = exact + spread * np.random.default_rng(1).standard_normal(exact.shape)

# %% [markdown]
# ## Misfit and gradient
# The derivative of J by the force of a step is the factor of this force in a sum of goals.

# %%
rig = Rig(N)
n = measured.size


def errors(values):
    forces, tape = rig.run(values)
    return (forces - measured) / spread, tape


def misfit(values):
    """Return J and its derivatives by the controls, from a process and its tape."""
    error, tape = errors(values)
    weights = error / spread / n
    goals = {step: list(zip(row, FORCES, strict=True)) for step, row in enumerate(weights)}
    slopes = scales * np.array(tape.gradient(goals, rig.controls))
    J = (error**2).sum() / (2 * n)
    history.append(J)
    return J, slopes


history = []
start = np.array([0.7, 0.8, 0.0])
found = minimize(
    misfit,
    start,
    jac=True,
    method="L-BFGS-B",
    bounds=[(0.3, 2), (0.3, 2), (-3, 3)],
    options={"ftol": 1e-7},
)
assert found.success, found.message

# %% [markdown]
# ## Without derivatives
# Nelder and Mead's method from the same start, with as many solves; an adjoint solve counts as a
# solve.

# %%
without = []


def misfit_alone(values):
    error, _ = errors(values)
    without.append((error**2).sum() / (2 * n))
    return without[-1]


minimize(
    misfit_alone,
    start,
    method="Nelder-Mead",
    options={
        "initial_simplex": start + 0.2 * np.vstack([np.zeros(3), np.eye(3)]),
        "maxfev": 2 * len(history),
    },
)

# %% [markdown]
# ## How sure?
# With the Jacobian $D$ of the errors, divided by their standard deviation, the covariance of the
# parameters is $(D^T D)^{-1}$, and 95 % of measurements give parameters within 1.96 standard
# deviations of the true ones. For three parameters central differences give $D$ with six runs of
# the process; the adjoint would go back through the tape once for each of the forces. The
# differences also check the tape, by the derivatives of the last tangential force.

# %%
step = 1e-3
columns = [
    (errors(found.x + step * axis)[0] - errors(found.x - step * axis)[0]).ravel() / (2 * step)
    for axis in np.eye(3)
]
D = np.array(columns).T
covariance = np.linalg.inv(D.T @ D)
deviation = np.sqrt(np.diag(covariance))

error, tape = errors(found.x)
goals = {len(shifts) - 1: FORCES[0]}
by_tape = scales * np.array(tape.gradient(goals, rig.controls)) / spread[0]
by_differences = D.reshape(len(shifts), 2, 3)[-1, 0]
if comm.rank == 0:
    per_run = len(shifts)
    both = 2 * per_run * len(history)
    print(f"L-BFGS: {both} solves, half of them adjoint, J {found.fun:.4f}")
    print(f"Nelder-Mead: {per_run * len(without)} solves, J {min(without):.4f}")
    print(f"\n{'':<24}{'true':>10}{'found':>10}   95 %")
    units = scales * [1, 1, 1e3]
    for name, unit, value, sd in zip(names, units, found.x, deviation, strict=True):
        print(f"{name:<24}{unit:10.4g}{unit * value:10.4g}   +- {1.96 * unit * sd:.2g}")
    print("\nderivatives of the last tangential force by tape, by differences:")
    print(by_tape, by_differences)

# %% [markdown]
# ## Check
# Each true parameter is within three standard deviations of the parameter that was found, as in 997
# of 1000 measurements. The misfit is as large as the noise makes it: for n errors of variance 1 the
# mean of J is 1/2, and its standard deviation 1/sqrt(2 n). And the derivatives agree with the
# central differences, except for the effect of nodes that change their state within a difference.

# %%
assert (np.abs(found.x - 1) < 3 * deviation).all()
assert abs(found.fun - 0.5) < 3 / np.sqrt(2 * n)
assert np.linalg.norm(by_tape - by_differences) < 0.02 * np.linalg.norm(by_differences)
assert min(without) > found.fun
solution = rig.solution
solution.write("results/calibration.pvd")

# %% [markdown]
# ## Draw

# %%
first, _ = rig.run(start)
fitted, _ = rig.run(found.x)
if comm.rank == 0:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.4), layout="constrained")
    left.plot(1e3 * shifts, measured[:, 0], ".", color="black", label="measured")
    left.plot(1e3 * shifts, first[:, 0], color="grey", lw=1, ls="--", label="start")
    left.plot(1e3 * shifts, fitted[:, 0], color="C0", lw=1, label="found")
    left.set(xlabel="shift [µm]", ylabel="tangential force on the plate [N]")
    left.legend(frameon=False)
    for label, values, each, color in (
        ("Nelder-Mead", without, 1, "C3"),
        ("L-BFGS", history, 2, "C0"),
    ):
        solves = each * len(shifts) * np.arange(1, len(values) + 1)
        least = np.minimum.accumulate(values)
        right.semilogy(solves, least, ".-", ms=4, lw=1, color=color, label=label)
    right.axhline(0.5, color="grey", lw=1, ls="--")
    right.annotate("noise", (0, 0.5), (2, 3), textcoords="offset points", color="grey")
    right.set(xlabel="solves, adjoint ones too", ylabel="misfit")
    right.legend(frameon=False)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig("results/calibration.png", dpi=150)
