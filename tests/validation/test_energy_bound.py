"""The bound of the algebraic error in the energy norm, against the true error.

The reference is solved to a residual that leaves it an error of a thousandth of what is compared.
"""

from __future__ import annotations

import logging

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import Bonded, ContactProblem, ContactStatus, Frictionless, RigidPlane, Tresca
from scenes.blocks import ABOVE, BELOW, block, floor
from scenes.patches import KINDS
from scenes.rubbing import BOUND, YOUNG, rubbing
from scenes.two_bricks import ENDS, bricks_problem, two_bricks

#: The bound is no larger than this times the error. With multigrid what solves with K may have left
#: is part of it, in proportion to what was asked for, though the error may by luck be less.
SHARP, SHARP_INEXACT = 6.0, 10.0

#: Of the reference, and what its error and rounding may take from a bound.
TIGHT, REFERENCE = 1e-11, 1e-6


def energy_norm(a, u) -> float:
    """|u|_K, assembled by DOLFINx."""
    square = fem.assemble_scalar(fem.form(ufl.action(ufl.action(a, u), u)))
    return float(np.sqrt(u.function_space.mesh.comm.allreduce(square, op=MPI.SUM)))


def relative_error(a, u, reference) -> float:
    difference = fem.Function(u.function_space)
    difference.x.array[:] = u.x.array - reference.x.array
    return energy_norm(a, difference) / energy_norm(a, u)


def check(a, problem: ContactProblem, asked: list[dict], sharp: float = SHARP) -> None:
    """Compare bounds with errors for several ways to ask."""
    reference = problem.solve(rtol=TIGHT)
    assert reference.status is ContactStatus.CONVERGED
    for options in asked:
        problem.forget()
        solution = problem.solve(**options)
        error = relative_error(a, solution.u, reference.u)
        assert error <= solution.energy_error_bound * (1.0 + REFERENCE) + 10 * TIGHT
        assert solution.energy_error_bound <= sharp * error + 10 * TIGHT
        if "accuracy" in options:
            assert solution.status is ContactStatus.CONVERGED
            assert solution.energy_error_bound <= options["accuracy"]


ASKED = [{"accuracy": accuracy} for accuracy in (0.1, 1e-2, 1e-4)] + [{"rtol": 1e-3}]


@pytest.mark.parallel(end=["free_end_1"])
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
@pytest.mark.parametrize("end", ENDS)
def test_matching_meshes(comm, end, stiffness):
    scene = two_bricks(comm, 6, end=end)
    with scene.problem(stiffness=stiffness) as problem:
        check(scene.a, problem, ASKED, SHARP if stiffness == "cholesky" else SHARP_INEXACT)


@pytest.mark.parallel(kind=["triangle", "hexahedron"], degree=[1])
@pytest.mark.parametrize("friction", [Tresca(BOUND * YOUNG), Frictionless(), Bonded()])
@pytest.mark.parametrize(("kind", "degree"), [*((kind, 1) for kind in KINDS), ("triangle", 2)])
def test_mortar(comm, kind, degree, friction):
    """The bound holds on meshes that do not match, where displacements are prescribed.

    Few multipliers are settled in so few steps that the solution may be better than one asked for;
    rounding is then what is compared.
    """
    scene = rubbing(comm, kind, degree, upper=(4, 2), lower=(6, 3), friction=friction)
    with scene.problem() as problem:
        check(scene.a, problem, [{"accuracy": 1e-2}, {"rtol": 1e-1}])


@pytest.mark.parametrize("method", ["gimssn", "imssn", "ssn", "mssn"])
def test_every_algorithm(comm, method):
    scene = two_bricks(comm, 4, end="free_end_2")
    asked = [{"accuracy": 1e-2}, {"rtol": 1e-4}]
    with scene.problem() as problem:
        check(
            scene.a, problem, [{**one, "method": method, "max_iterations": 1000} for one in asked]
        )


@pytest.mark.parallel(law=["bonded"])
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
@pytest.mark.parametrize("law", ["frictionless", "bonded"])
def test_the_contact_carries_all_loads(comm, law, stiffness, caplog):
    """A block that does not move has a bound of zero, and the log says why."""
    ceiling = RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    friction = {"frictionless": Frictionless(), "bonded": Bonded()}[law]
    scene = block(
        comm, load=(0.0, 0.0, 1.0), held=[BELOW], obstacles=[(ABOVE, ceiling)], friction=friction
    )
    for asked in ({}, {"accuracy": 1e-4}, {"rtol": 1e-6}):
        with scene.problem(stiffness=stiffness) as problem:
            with caplog.at_level(logging.INFO, "dolfinx_tresca"):
                solution = problem.solve(**asked)
        assert solution.status is ContactStatus.CONVERGED
        assert solution.energy_error_bound == 0.0
        assert "zero to rounding" in str(solution)
    assert comm.rank != 0 or "has nothing to refer to" in caplog.text


def test_the_answer_says_what_was_reached(comm):
    """The table and the error have the bound that was reached and the one that was requested."""
    with bricks_problem(comm, 4) as problem:
        solution = problem.solve(accuracy=1e-2)
        assert f"at most {solution.energy_error_bound:.1e}" in str(solution)
        assert "energy error 1e-02" in str(solution)
        stopped = problem.solve(accuracy=1e-9, method="gimssn", max_iterations=1)
    with pytest.raises(Exception, match=r"energy error at most .* requested energy error 1e-09"):
        stopped.raise_if_failed()


@pytest.mark.parallel
def test_repeated_constraints(comm):
    """With repeated constraints the bound is infinite, and the residual decides."""
    scene = block(
        comm,
        (3, 3, 3),
        held=[ABOVE],
        moved=lambda x: np.outer([0.0, 0.0, -1e-2], np.ones(x.shape[1])),
        friction=Frictionless(),
        obstacles=[(BELOW, floor(3)) for _ in range(2)],
    )
    with scene.problem(pairs=scene.pairs[:1]) as problem:
        once = problem.solve(rtol=1e-8)
    with scene.problem() as problem:
        twice = problem.solve()
    assert twice.status is ContactStatus.CONVERGED
    assert twice.energy_error_bound == np.inf
    assert twice.residuals[-1] <= 1e-6
    assert relative_error(scene.a, twice.u, once.u) <= 1e-4
