"""Extremes of the data: materials, slip bounds, loads, units."""

from __future__ import annotations

import math

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import Frictionless, InputError, RigidObstacle, Tresca
from scenes.blocks import ABOVE, BELOW, BOUND, LEFT, YOUNG, block, rubbing_blocks
from scenes.extremes.cases import (
    LAWS,
    RTOL,
    Cases,
    Check,
    Outcome,
    equal,
    judged,
    lawful,
    outcome,
    refused,
    solve,
)
from scenes.patches import patch
from scenes.scene import EPS, Scene

CASES = Cases()
case = CASES.case

# -- Materials ------------------------------------------------------------------------------------

RATIO = "stiffness of the upper body over that of the lower"


@case(RATIO, "1", 1.0)
@case(RATIO, "1e-9", 1e-9)
@case(RATIO, "1e9", 1e9)
def pressed_together(comm: MPI.Comm, ratio: float) -> Outcome:
    """The same stress everywhere: the exact displacement is in the space."""
    young = (YOUNG * min(ratio, 1.0), YOUNG * min(1.0 / ratio, 1.0))
    scene = patch(comm, "triangle", upper=(6, 3), lower=(4, 3), young=young)
    model = scene
    solution = solve(model)
    exact, u = scene.data.exact.x.array, solution.u.x.array
    size = comm.allreduce(np.abs(exact).max(initial=0.0), op=MPI.MAX)
    error = comm.allreduce(np.abs(u - exact).max(initial=0.0), op=MPI.MAX) / size
    return judged(model, solution).and_also(
        Check("displacement", error, LAWS),
        equal("force", solution.normal_force, scene.data.pressure * scene.data.overlap, LAWS),
    )


@case(RATIO, "1e-9, with friction", 1e-9)
@case(RATIO, "1e-6, with friction", 1e-6)
@case(RATIO, "1e6, with friction", 1e6)
@case(RATIO, "1e9, with friction", 1e9)
def rubbed(comm: MPI.Comm, ratio: float) -> Outcome:
    young = (YOUNG * min(ratio, 1.0), YOUNG * min(1.0 / ratio, 1.0))
    law = Tresca(1e-3 * min(young))
    return lawful(
        rubbing_blocks(comm, "tetrahedron", upper=(4, 3), lower=(3, 2), young=young, friction=law)
    )


@case(RATIO, "1e3, default accuracy", 1e3)
@case(RATIO, "1e6, default accuracy", 1e6)
@case(RATIO, "1e9, default accuracy", 1e9)
def roughly_right(comm: MPI.Comm, ratio: float) -> Outcome:
    """The energy of the bent stiff body must not hide the contact of the soft one."""
    law = Tresca(1e-3 * YOUNG / ratio)
    model = rubbing_blocks(
        comm, "triangle", upper=(3, 2), lower=(4, 3), young=(YOUNG, YOUNG / ratio), friction=law
    )
    rough, exact = solve(model, accuracy="balanced"), solve(model)
    # a mesh of this size has an error of ten percent or so
    return outcome(rough, equal("force", rough.normal_force, exact.normal_force, 0.5))


POISSON = "Poisson's ratio"


@case(POISSON, "0.3", 0.3)
@case(POISSON, "0", 0.0)
@case(POISSON, "0.4999", 0.4999)
@case(POISSON, "0.4999, degree 2", 0.4999, degree=2)
@case(POISSON, "0.49, degree 2, multigrid", 0.49, degree=2, stiffness="multigrid")
def any_ratio(
    comm: MPI.Comm, poisson: float, degree: int = 1, stiffness: str = "cholesky"
) -> Outcome:
    """The discrete equations are solved, even if their discretisation error is large."""
    model = block(comm, (3, 2, 2), held=(LEFT,), poisson=poisson, degree=degree)
    return lawful(model, options={"stiffness": stiffness})


@case(POISSON, "0.4999: degree 1 locks, degree 2 does not")
def locking(comm: MPI.Comm) -> Outcome:
    """The stiffness of a block between plates is compared with a finer mesh of degree 2."""

    def force(n: int, degree: int) -> tuple[float, Outcome]:
        model = block(
            comm,
            (n, n),
            load=(0.0, 0.0, 0.0),
            held=(ABOVE,),
            moved=lambda x: np.stack([0.0 * x[0], -0.01 + 0.0 * x[0]]),
            degree=degree,
            poisson=0.4999,
            friction=Tresca(1e3 * YOUNG),
        )
        solution = solve(model)
        return solution.normal_force, judged(model, solution)

    (fine, _), (linear, _), (quadratic, found) = force(12, 2), force(6, 1), force(6, 2)
    # degree 2: the corners are singular, and forces of 6 and 12 cells differ by a few percent
    return found.and_also(
        Check("degree 2: force over that of a finer mesh - 1", abs(quadratic / fine - 1.0), 0.1),
        Check("degree 1: the finer mesh's force over its own", fine / linear, 0.5),
    )


# -- Slip bounds ----------------------------------------------------------------------------------

SLIP_BOUND = "slip bound"


def rubbing(comm: MPI.Comm, bound: object) -> Scene:
    """A block that is pressed and dragged."""
    law = bound if isinstance(bound, Frictionless) else Tresca(bound)
    return block(comm, (4, 3, 3), held=(LEFT,), load=(0.6, 0.2, -1.0), friction=law)


@case(SLIP_BOUND, "0.1", 0.1)
@case(SLIP_BOUND, "0 on half of the surface", lambda x: 0.1 * (x[0] > 0.6))
@case(SLIP_BOUND, "1e4 and 1e-5 in turn", lambda x: 10.0 ** (9 * (np.round(4 * x[0]) % 2) - 5))
@case(SLIP_BOUND, "1 and 1e-9 in turn", lambda x: 10.0 ** (9 * (np.round(4 * x[0]) % 2) - 9))
def some_bound(comm: MPI.Comm, bound: object) -> Outcome:
    return lawful(rubbing(comm, bound))


@case(SLIP_BOUND, "0", 0.0)
@case(SLIP_BOUND, "1e-300", 1e-300)
@case(SLIP_BOUND, "1e-12", 1e-12)
def no_friction(comm: MPI.Comm, bound: float) -> Outcome:
    """The solution is the one without friction; only tractions of the size of the bound remain."""
    model = rubbing(comm, bound)
    solution, without = solve(model), solve(rubbing(comm, Frictionless()))
    return judged(model, solution).and_also(
        equal("force", solution.normal_force, without.normal_force, LAWS),
        equal("energy", solution.primal_energy, without.primal_energy, LAWS),
        Check("traction", solution.tangential_force, bound * (1.0 + 10 * EPS)),
    )


@case(SLIP_BOUND, "1e12", 1e12)
@case(SLIP_BOUND, "1e300", 1e300)
@case(SLIP_BOUND, "inf", math.inf)
@case(SLIP_BOUND, "inf, a function", lambda x: np.full(x.shape[1], np.inf))
def no_slip(comm: MPI.Comm, bound: object) -> Outcome:
    """The solution is the same as with a finite bound that no node reaches."""
    solution, enough = solve(rubbing(comm, bound)), solve(rubbing(comm, 1e3))
    return outcome(
        solution,
        equal("sticking nodes", solution.counts.stick, solution.counts.nodes, 0.0),
        equal("force", solution.normal_force, enough.normal_force, LAWS),
        equal("traction", solution.tangential_force, enough.tangential_force, LAWS),
        equal("dual energy", solution.dual_energy, enough.dual_energy, LAWS),
        Check("error bound", solution.energy_error_bound, LAWS),
    )


# -- Loads ----------------------------------------------------------------------------------------

LOAD = "load"

#: A floor at the distance zero, without rounding, from the whole face: only the load has a size.
TOUCHING = RigidObstacle(
    lambda x: (np.zeros(x.shape[1]), np.repeat([[0.0], [0.0], [1.0]], x.shape[1], axis=1))
)


def loaded(comm: MPI.Comm, size: float) -> Scene:
    """A block whose load and slip bound are proportional to a size."""
    load = size * np.array([0.3, 0.1, -1.0])
    law = Tresca(0.1 * size)
    return block(
        comm, (4, 3, 3), held=(LEFT,), load=load, friction=law, obstacles=[(BELOW, TOUCHING)]
    )


@case(LOAD, "1e-200", 1e-200)
@case(LOAD, "1e-160", 1e-160)
@case(LOAD, "1e-160, multigrid", 1e-160, stiffness="multigrid")
@case(LOAD, "1e200", 1e200)
def extreme_load(comm: MPI.Comm, size: float, stiffness: str = "cholesky") -> Outcome:
    """Squares of such numbers overflow or vanish, so the solve is refused."""
    model = loaded(comm, size)
    return refused(
        lambda: solve(model, options={"stiffness": stiffness}), InputError, ["squares", "units"]
    )


@case(LOAD, "1", 1.0)
@case(LOAD, "1e-120", 1e-120)
@case(LOAD, "1e-12", 1e-12)
@case(LOAD, "1e12", 1e12)
@case(LOAD, "1e120", 1e120)
@case(LOAD, "1e-12, multigrid", 1e-12, stiffness="multigrid")
@case(LOAD, "1e12, multigrid", 1e12, stiffness="multigrid")
def any_load(comm: MPI.Comm, size: float, stiffness: str = "cholesky") -> Outcome:
    """The problem is linear in the load: multipliers are those of the unit load times a factor."""
    options = {"stiffness": stiffness}
    solution = solve(loaded(comm, size), options=options)
    unit = solve(loaded(comm, 1.0), options=options)
    # with iterative solves of K a solve may end a step earlier or later: both have residual errors
    same = 1e-3 * LAWS if stiffness == "cholesky" else LAWS
    return outcome(
        solution,
        equal("force", solution.normal_force / size, unit.normal_force, same),
        equal("traction", solution.tangential_force / size, unit.tangential_force, same),
        equal("iterations", solution.iterations, unit.iterations, 0.0),
        equal("products", solution.products, unit.products, 0.0),
    )


@case(LOAD, "0")
@case(LOAD, "0, multigrid", "multigrid")
@case(LOAD, "0, default accuracy", accuracy="balanced")
def no_load(comm: MPI.Comm, stiffness: str = "cholesky", **asked: str) -> Outcome:
    solution = solve(loaded(comm, 0.0), options={"stiffness": stiffness}, **asked)
    size = max(
        np.abs(solution.u.x.array).max(initial=0.0), np.abs(solution.multipliers).max(initial=0.0)
    )
    return outcome(
        solution,
        Check("displacement and multipliers", comm.allreduce(float(size), op=MPI.MAX), 0.0),
        Check("error bound", solution.energy_error_bound, 0.0),
    )


# -- Units ----------------------------------------------------------------------------------------

UNITS = "units of length and of stress"


@case(UNITS, "1 and 1", 1.0, 1.0)
@case(UNITS, "1e-6 and 1", 1e-6, 1.0)
@case(UNITS, "1e6 and 1", 1e6, 1.0)
@case(UNITS, "1e-3 and 1e-9", 1e-3, 1e-9)
@case(UNITS, "1e6 and 1e9", 1e6, 1e9)
@case(UNITS, "1e-6 and 1e6", 1e-6, 1e6)
def any_units(comm: MPI.Comm, length: float, stress: float) -> Outcome:
    """The rescaled solution is the same, after the same number of iterations."""

    def scene(length: float, stress: float) -> Scene:
        return rubbing_blocks(
            comm,
            "tetrahedron",
            upper=(4, 3),
            lower=(3, 2),
            scale=length,
            young=(YOUNG * stress, 2.0 * YOUNG * stress),
            friction=Tresca(BOUND * stress),
        )

    model = scene(length, stress)
    solution, usual = solve(model), solve(scene(1.0, 1.0))
    return judged(model, solution).and_also(
        equal("force", solution.normal_force / (stress * length**2), usual.normal_force, RTOL),
        equal("energy", solution.primal_energy / (stress * length**3), usual.primal_energy, RTOL),
        equal("iterations", solution.iterations, usual.iterations, 0.0),
        equal("products", solution.products, usual.products, 0.0),
    )
