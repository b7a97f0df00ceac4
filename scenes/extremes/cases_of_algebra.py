"""Extremes of the algebra: step lengths, soft springs, floating bodies, requested accuracies."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import Frictionless, MechanismError, Tresca
from scenes.blocks import BELOW, FRONT, LEFT, YOUNG, block, floor, rubbing_blocks
from scenes.dense import brute_projection, random_problem, run
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
    yes,
)
from scenes.nodal import surface_nodes_of
from scenes.scene import EPS, Scene

CASES = Cases()
case = CASES.case

# -- Step length ----------------------------------------------------------------------------------

RHO = "rho times the largest eigenvalue"


@case(RHO, "1", 1.0)
@case(RHO, "1e-6", 1e-6)
@case(RHO, "1.999", 1.999)
@case(RHO, "1e-6, multigrid", 1e-6, options={"stiffness": "multigrid"})
@case(RHO, "1.999, multigrid", 1.999, options={"stiffness": "multigrid"})
def any_rho(comm: MPI.Comm, rho: float, **asked: Any) -> Outcome:
    return lawful(block(comm, (4, 3, 3), held=(LEFT,)), rho_sigma=rho, **asked)


@case(RHO, "1e-6, gimssn", 1e-6)
@case(RHO, "1.999, gimssn", 1.999)
def gimssn(comm: MPI.Comm, rho: float) -> Outcome:
    model = rubbing_blocks(comm, "triangle", upper=(4, 3), lower=(4, 3))
    return lawful(model, method="gimssn", rho_sigma=rho)


# -- Springs --------------------------------------------------------------------------------------

SPRING = "spring that holds the body, over the body's stiffness"


def sprung(comm: MPI.Comm, spring: float) -> Scene:
    """A block on an elastic foundation, pressed on the floor and dragged."""
    return block(comm, (4, 3, 3), spring=spring * YOUNG, friction=Tresca(0.5))


@case(SPRING, "1e-2", 1e-2)
@case(SPRING, "1e-3", 1e-3)
@case(SPRING, "1e-4", 1e-4)
@case(SPRING, "1e-6", 1e-6)
@case(SPRING, "1e-3, multigrid", 1e-3, stiffness="multigrid")
@case(SPRING, "1e-4, multigrid", 1e-4, stiffness="multigrid")
@case(SPRING, "1e-6, multigrid", 1e-6, stiffness="multigrid")
def springs(comm: MPI.Comm, spring: float, stiffness: str = "cholesky") -> Outcome:
    """Jumps without contact are large, so only energy errors are checked, not the laws."""
    model = sprung(comm, spring)
    solution = solve(model, options={"stiffness": stiffness}, accuracy=1e-3, max_iterations=100)
    return outcome(
        solution,
        Check("error bound", solution.energy_error_bound, 1e-3),
        equal("force", solution.normal_force, 1.0, 0.1),
    )


@case(SPRING, "1e-10: nothing but contact holds", 1e-10)
@case(SPRING, "1e-10, multigrid", 1e-10, stiffness="multigrid")
def no_spring(comm: MPI.Comm, spring: float, stiffness: str = "cholesky") -> Outcome:
    """The floor carries the load as without a spring; the spring carries hardly any."""
    model, without = sprung(comm, spring), sprung(comm, 0.0)
    solution, wanted = (
        solve(m, options={"stiffness": stiffness}, accuracy=1e-4) for m in (model, without)
    )
    return outcome(
        solution,
        equal("force", solution.normal_force, wanted.normal_force, 1e-4),
        equal("traction", solution.tangential_force, wanted.tangential_force, 1e-2),
    )


@case(SPRING, "1e-10, pulled off the floor", 1e-10)
def pulled_off(comm: MPI.Comm, spring: float) -> Outcome:
    """The body moves as far as the spring lets it, or an error names the motion."""
    model = block(comm, (4, 3, 3), spring=spring * YOUNG, load=(0, 0, 1.0), friction=Frictionless())
    try:
        solution = solve(model)
    except MechanismError as error:
        check = yes("names the motion", "translation along z" in str(error))
        return Outcome("MechanismError", 0, 0, (check,), ("MechanismError",))
    moved = 1.0 / (spring * YOUNG)
    height = comm.allreduce(float(solution.u.x.array[2::3].max(initial=0.0)), op=MPI.MAX)
    return outcome(solution, equal("height", height, moved, 1e2 * EPS / spring))


# -- Bodies that float ----------------------------------------------------------------------------

FLOATING = "a body that only contact holds"


def standing(comm: MPI.Comm, height: float, size: float, bound: float) -> Scene:
    """A block above the floor; the load along the floor is a tenth of the load downwards."""
    load = size * np.array([0.1, 0.0, -1.0])
    return block(
        comm, load=load, friction=Tresca(size * bound), obstacles=[(BELOW, floor(3, -height))]
    )


@case(FLOATING, "touching", 0.0, 1.0, 0.2)
@case(FLOATING, "gap of 1e3 times its size", 1e3, 1.0, 0.2)
@case(FLOATING, "load 1e-12", 0.0, 1e-12, 0.2)
@case(FLOATING, "load 1e12", 0.0, 1e12, 0.2)
@case(FLOATING, "friction at 99.9 % of its limit", 0.0, 1.0, 0.1 / 0.999)
@case(FLOATING, "friction a millionth below its limit", 0.0, 1.0, 0.1 * (1.0 + 1e-6))
def floats(comm: MPI.Comm, height: float, size: float, bound: float) -> Outcome:
    """Contact carries the load."""
    model = standing(comm, height, size, bound)
    solution = solve(model)
    return judged(model, solution, held=False).and_also(
        equal("force", solution.normal_force / size, 1.0, LAWS),
        equal("traction", solution.tangential_force / size, 0.1, LAWS),
    )


@case(FLOATING, "gap of 1e3 times its size, the pressure", 1e3)
def falls(comm: MPI.Comm, height: float) -> Outcome:
    """A block falls between guides; on the floor the pressure equals the load everywhere."""
    model = block(
        comm,
        load=(0.0, 0.0, -1.0),
        across=(LEFT, FRONT),
        friction=Frictionless(),
        obstacles=[(BELOW, floor(3, -height))],
    )
    solution = solve(model)
    _, fields = surface_nodes_of(solution)
    error = comm.allreduce(np.abs(fields["pressure"] - 1.0).max(initial=0.0), op=MPI.MAX)
    return judged(model, solution, held=False).and_also(Check("pressure", error, LAWS))


@case(FLOATING, "friction above its limit", 0.1 * 0.999)
def slides_away(comm: MPI.Comm, bound: float) -> Outcome:
    model = standing(comm, 0.0, 1.0, bound)
    return refused(
        lambda: solve(model), MechanismError, ["no contact forces", "translation along x"]
    )


@case(FLOATING, "friction at its limit", 0.1)
@case(FLOATING, "friction 1e-10 below its limit", 0.1 * (1.0 + 1e-10))
def at_the_limit(comm: MPI.Comm, bound: float) -> Outcome:
    """Rounding decides whether contact forces can balance the load, so both outcomes are right."""
    model = standing(comm, 0.0, 1.0, bound)
    try:
        solution = solve(model)
    except MechanismError as error:
        check = yes("names the motion", "translation along x" in str(error))
        return Outcome("MechanismError", 0, 0, (check,), ("MechanismError",))
    return judged(model, solution, held=False).and_also(
        equal("traction", solution.tangential_force, 0.1, LAWS)
    )


# -- What is asked for ----------------------------------------------------------------------------

ASKED = "accuracy that is requested"


@case(ASKED, "residual 1e-8", rtol=RTOL)
@case(ASKED, "residual 1e-300", rtol=1e-300)
@case(ASKED, "error 1e-12", accuracy=1e-12)
@case(ASKED, "error 1e-15", accuracy=1e-15)
@case(ASKED, "error 1e-17", accuracy=1e-17)
@case(ASKED, "residual 1e-15, multigrid", rtol=1e-15, options={"stiffness": "multigrid"})
def honest(comm: MPI.Comm, **asked: Any) -> Outcome:
    """An accuracy is reached as reported, or the status says that it cannot be reached."""
    model = block(comm, (4, 3, 3), held=(LEFT,))
    solution = solve(model, **asked)
    reached = asked.get("rtol") or asked["accuracy"]
    found = solution.residuals[-1] if "rtol" in asked else solution.energy_error_bound
    result = judged(model, solution, balance=LAWS if "options" in asked else 1e3 * EPS)
    if result.status == "STAGNATED":
        # the last residual and the bound must be near rounding; the bound is the root of an energy
        return Outcome(
            result.status,
            result.iterations,
            result.products,
            (
                *result.checks,
                Check("residual", solution.residuals[-1], 1e3 * EPS),
                Check("error bound", solution.energy_error_bound, np.sqrt(EPS)),
                yes("more was asked for", reached < found),
            ),
            ("STAGNATED",),
        )
    return result.and_also(Check("reached over asked for", found / reached, 1.0))


# -- Matrices -------------------------------------------------------------------------------------

CONDITION = "condition of A"


@case(CONDITION, "1e2", 2.0)
@case(CONDITION, "1e6", 6.0)
@case(CONDITION, "1e12", 12.0)
@case(CONDITION, "1e12, 30 nodes", 12.0, 30)
@case(CONDITION, "1e12, 60 nodes", 12.0, 60)
def ill_conditioned(comm: MPI.Comm, decades: float, nodes: int = 8) -> Outcome:
    """A random matrix; the reported residual is compared with one in extended precision."""
    problem = random_problem(1, nodes, decades)
    found = run(problem, rtol=1e-6)
    A, b, x = (
        np.asarray(v, dtype=np.longdouble) for v in (problem.A, problem.b, found.multipliers)
    )
    lam, rho = problem.feasible_set, found.rho

    def residual(x: np.ndarray, r: np.ndarray) -> float:
        return float(np.linalg.norm((x - brute_projection(lam, x - rho * r)).astype(float))) / rho

    scale = residual(0 * x, -b)
    error = residual(x, A @ x - b) / scale
    # rounding of the gradient by products in double precision; the largest eigenvalue of A is 1
    rounding = 100 * EPS * (float(np.linalg.norm(x)) + float(np.linalg.norm(b))) / scale
    check = Check("residual less the reported one", abs(error - found.residuals[-1]), rounding)
    status = found.status.name
    if status == "CONVERGED":
        return Outcome(
            status,
            found.iterations,
            problem.products,
            (check, Check("residual", error, 1e-6 + rounding)),
        )
    return Outcome(
        status, found.iterations, problem.products, (check,), ("STAGNATED", "MAX_ITERATIONS")
    )
