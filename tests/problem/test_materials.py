"""Materials with a history: plastic bodies in contact."""

from __future__ import annotations

import itertools
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactStatus,
    Coulomb,
    InputError,
    NewtonOptions,
    NonlinearContactProblem,
    SolverOptions,
    StiffnessError,
)
from scenes.blocks import RIGHT
from scenes.plastic_block import YIELD, YOUNG, plastic_block, uniaxial_path
from scenes.rubber_block import rubber_block

#: Accuracy of Newton's method, and of contact.
RTOL = 1e-9
OPTIONS = {"newton": NewtonOptions(accuracy=RTOL), "options": SolverOptions(rtol=RTOL)}

#: Strain at first yield.
FIRST = YIELD / YOUNG

#: Compression: to yield and beyond, back until the block has left the plane, and on.
PATH = FIRST * np.array([0.8, 1.5, 3.0, 2.5, 0.5, 2.0, 4.0])


def forces(problem, push, path, accept=True):
    """Return the normal forces along a path."""
    found = []
    for e in path:
        push.value = -e
        solution = problem.solve()
        solution.raise_if_failed()
        if accept:
            problem.accept()
        found.append(solution.normal_force)
    return np.array(found)


@pytest.mark.parallel
@pytest.mark.parametrize("numeric", [False, True], ids=["UFL", "numpy"])
def test_uniaxial_compression(comm, numeric):
    """Stresses of a bar with linear hardening, with unloading until it is free; order 2."""
    metal = plastic_block(comm, numeric=numeric)
    with metal.problem(**OPTIONS) as problem:
        found = forces(problem, metal.push, PATH)
        steps = problem.solve().newton.steps
    wanted = uniaxial_path(PATH)
    assert np.abs(found - wanted).max() <= 100 * RTOL * wanted.max()
    assert found[4] == 0.0
    assert found[2] > YIELD
    # accepted: nothing is left but what the accuracies of Newton's method and of contact leave
    assert steps[0].residual <= 10 * RTOL


@pytest.mark.parallel
def test_stress_by_numpy_is_that_by_ufl(comm):
    """A block that is clamped above and rubs below: not uniform, and to and fro."""
    results = []
    for numeric in (False, True):
        metal = plastic_block(comm, (3, 2, 2), numeric=numeric, clamped=True, friction=Coulomb(0.2))
        rows = []
        with metal.problem(**OPTIONS) as problem:
            for down, along in ((1.0, 0.0), (3.0, 0.5), (3.0, -0.5), (1.0, 0.0)):
                metal.push.value[:] = (FIRST * along, 0.0, -FIRST * down)
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                residuals = [step.residual for step in solution.newton.steps]
                rows.append([*solution.pair_resultants[0].force, solution.total_dissipation])
        results.append(np.array(rows))
        # order 2: the last residual but rounding is below the square of the one before
        tail = [r for r in residuals if r > 1e-12]
        assert all(b <= 1e2 * a**2 for a, b in zip(tail[-2:-1], tail[1:][-1:], strict=True))
    force, dissipation = np.abs(results[0][:, :3]).max(), results[0][-1, 3]
    scale = np.array([force, force, force, dissipation])
    assert (np.abs(results[0] - results[1]) <= 1e3 * RTOL * scale).all()


@pytest.mark.parametrize("numeric", [False, True], ids=["UFL", "numpy"])
def test_only_accept_moves_the_history(comm, numeric):
    """Trial solves, and a load that is applied in parts, leave the history as it was."""
    metal = plastic_block(comm, (1, 1, 1), numeric=numeric)
    few = NewtonOptions(accuracy=RTOL, max_iterations=1)  # so that loads are applied in parts
    with metal.problem(**OPTIONS) as problem:
        forces(problem, metal.push, PATH[:2])
        kept = [one.x.array.copy() for one in metal.history]
        forces(problem, metal.push, 2.0 * PATH[2:4], accept=False)
        metal.push.value = -2.0 * PATH[2]
        solution = problem.solve(newton=few)
        assert solution.newton.fraction == 1.0 or solution.status is ContactStatus.NO_EQUILIBRIUM
        for one, before in zip(metal.history, kept, strict=True):
            assert np.array_equal(one.x.array, before)
        assert kept[1].max() > 0.0
        found = forces(problem, metal.push, PATH[2:])
    assert np.allclose(found, uniaxial_path(PATH)[2:], rtol=0.0, atol=100 * RTOL * found.max())


def remembers(metal):
    """Return values that tell points, and components, of the history of a material."""
    result = []
    for function in metal.history:
        points = function.function_space.tabulate_dof_coordinates()
        components = function.function_space.dofmap.index_map_bs
        result.append((points @ [1.0, 10.0, 100.0])[:, None] + np.arange(components))
    return result


@pytest.mark.parallel
def test_the_file_of_a_restart_has_the_history(comm, folder):
    """Values at points of quadrature are found again, on one rank by each of those that wrote."""
    metal = plastic_block(comm, numeric=True)
    for function, values in zip(metal.history, remembers(metal), strict=True):
        function.x.array[:] = values.ravel()
    with metal.problem(**OPTIONS) as problem:
        problem.save_state(folder / "state.npz", step=7, material=metal.history)
    other = plastic_block(MPI.COMM_SELF, numeric=True)
    with other.problem(**OPTIONS) as problem:
        for number in (0, 1, 3):
            wrong = [other.history[min(k, 1)] for k in range(number)]
            with pytest.raises(InputError, match=rf"3 Function\(s\).* there are {number + 1}"):
                problem.load_state(folder / "state.npz", material=wrong)
        with pytest.raises(InputError, match=r"\[3, 9, 1\] component\(s\), .* of \[3, 1, 9\]"):
            problem.load_state(folder / "state.npz", material=other.history[::-1])
        with pytest.raises(InputError, match=r"\[3, 9, 1\] component\(s\), .* of \[3, 3, 1\]"):
            problem.load_state(folder / "state.npz", material=[other.u, other.history[1]])
        for wrong in (other.u, [3], metal.history):
            with pytest.raises(InputError, match="material must be a list of Functions on the m"):
                problem.load_state(folder / "state.npz", material=wrong)
        assert not other.history[1].x.array.any()
        assert problem.load_state(folder / "state.npz", material=other.history) == 7
    for function, values in zip(other.history, remembers(other), strict=True):
        assert np.allclose(function.x.array, values.ravel(), rtol=0.0, atol=1e-9)


def test_wrong_arguments(comm):
    """Each error says what to give."""
    metal = plastic_block(comm, (1, 1, 1), numeric=True)
    for changes, message in (
        ({"J": None}, "u must be the Function .* give J with the tangent"),
        ({"before_assembly": None}, "a function computes the stress from u, give it as before_ass"),
        ({"before_assembly": 3}, "before_assembly must be a function or None, found 3"),
        ({"on_accept": "advance"}, "on_accept must be a function or None"),
        ({"J": fem.form(metal.J), "symmetrize": True}, "symmetrize needs J as a UFL form"),
    ):
        with pytest.raises(InputError, match=message):
            metal.problem(**changes)


def test_a_function_that_fails(comm):
    """Its own error is raised; stresses that are NaN end a solve as those of a form do."""
    metal = plastic_block(comm, (1, 1, 1), numeric=True)

    def fails():
        raise RuntimeError("no convergence at a point")

    with pytest.raises(RuntimeError, match="no convergence at a point"):
        metal.problem(before_assembly=fails)
    broken = False

    def before_assembly():
        metal.before_assembly()
        if broken and np.abs(metal.u.x.array).max() > 0.0:
            stress = next(f for f in metal.F.coefficients())
            stress.x.array[:] = np.nan

    with metal.problem(before_assembly=before_assembly, **OPTIONS) as problem:
        broken = True
        metal.push.value = -PATH[1]
        solution = problem.solve()
        assert solution.status is ContactStatus.NO_EQUILIBRIUM
        assert "before_assembly() leaves values that are NaN" in solution.newton.message
        broken = False
        assert forces(problem, metal.push, PATH[1:2])[0] == pytest.approx(
            uniaxial_path(PATH[1:2])[0], rel=100 * RTOL
        )


def loaded_rubber(comm, pressure, follows):
    """Return arguments of a rubber block that is pressed down, with a pressure on its side."""
    rubber = rubber_block(comm, (4, 3), clamped=True)
    u, v = rubber.u, ufl.TestFunction(rubber.scene.V)
    mesh = rubber.scene.mesh
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=rubber.scene.facet_tags)
    F = ufl.Identity(2) + ufl.grad(u)
    turned = ufl.det(F) * ufl.inv(F).T if follows else ufl.Identity(2)
    load = pressure * ufl.inner(turned * ufl.FacetNormal(mesh), v) * ds(RIGHT)
    rubber.push.value[:] = (0.0, -0.1)
    return rubber.F + load, u, rubber.scene.pairs, rubber.bcs


def test_the_symmetric_part_of_a_tangent(comm):
    """A pressure that follows the side of a rubber block, whose tangent is not symmetric."""
    given = loaded_rubber(comm, 0.3, follows=True)
    with pytest.raises(StiffnessError, match=r"not symmetric .* symmetrize=True"):
        NonlinearContactProblem(*given, **OPTIONS)
    with NonlinearContactProblem(*given, symmetrize=True, **OPTIONS) as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    residuals = [step.residual for step in solution.newton.steps]
    assert residuals[-1] <= RTOL
    # linear convergence, where the unsymmetric tangent has none of these terms
    rates = [after / before for before, after in itertools.pairwise(residuals[1:])]
    assert max(rates) < 0.5
    assert len(rates) > 2


@pytest.mark.parametrize("pressure", [0.3, -0.1, -0.2, -0.3])
def test_steps_that_a_symmetric_part_takes(pressure):
    """The page has the numbers, beside those of a pressure that keeps its direction."""
    counts = []
    for follows in (False, True):
        given = loaded_rubber(MPI.COMM_SELF, pressure, follows)
        for accuracy in (1e-6, 1e-9):
            newton = NewtonOptions(accuracy=accuracy)
            given[1].x.array[:] = 0.0
            with NonlinearContactProblem(*given, symmetrize=follows, newton=newton) as problem:
                solution = problem.solve()
            solution.raise_if_failed()
            counts.append(len(solution.newton.steps))
    row = f"| {pressure} | {counts[0]} and {counts[1]} | {counts[2]} and {counts[3]} |"
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "nonlinear.md").read_text()
    assert row in page


@pytest.mark.parallel
@pytest.mark.parametrize("wrong", ["shape", "exception"])
def test_an_error_on_one_rank_is_one_on_all(comm, wrong):
    """Of the functions of the user; the problem solves again when they do not fail."""
    metal = plastic_block(comm, (2, 1, 1), numeric=True)
    fails = []

    def fail():
        if fails and comm.rank == comm.size - 1:
            if wrong == "shape":
                metal.history[0].x.array[:] = np.zeros(len(metal.history[0].x.array) + 2)
            raise FloatingPointError("no convergence at a point")

    def before_assembly():
        metal.before_assembly()
        fail()

    message = "could not broadcast" if wrong == "shape" else "no convergence at a point"
    error = ValueError if wrong == "shape" else FloatingPointError
    given = {"before_assembly": before_assembly, "on_accept": fail}
    with metal.problem(**given, **OPTIONS) as problem:
        metal.push.value = -PATH[1]
        fails.append(True)
        with pytest.raises(error, match=message):
            problem.solve()
        fails.clear()
        solution = problem.solve()
        fails.append(True)
        with pytest.raises(error, match=message):
            problem.accept()
        assert solution.normal_force == pytest.approx(uniaxial_path(PATH[:2])[1], rel=100 * RTOL)
        fails.clear()
        problem.accept()  # the failed one has accepted nothing


@pytest.mark.parallel
def test_what_a_function_may_not_do(comm):
    """Values that are not finite on some ranks, another u, a history changed after the solve."""
    metal = plastic_block(comm, (2, 1, 1), numeric=True)
    stress = next(iter(metal.F.coefficients()))
    stress.name = "stress"
    wrong = []

    def before_assembly():
        metal.before_assembly()
        if wrong and (comm.rank > 0 or comm.size == 1):  # one of them has cells
            wrong[0].x.array[:] = wrong[1]

    with metal.problem(before_assembly=before_assembly, **OPTIONS) as problem:
        metal.push.value = -PATH[1]
        wrong[:] = stress, np.nan
        with pytest.raises(StiffnessError, match=r"NaN or infinite in the Function 'stress' of sh"):
            problem.solve()
        wrong[:] = metal.u, 1.0
        with pytest.raises(InputError, match="has changed u, which it must only read"):
            problem.solve()
        wrong.clear()
        solution = problem.solve()
        metal.history[1].x.array[:] = 0.05
        with pytest.raises(ContactError, match=r"the history of the material, .* have changed"):
            problem.accept()
        metal.history[1].x.array[:] = 0.0
        problem.accept()
        assert solution.normal_force == pytest.approx(uniaxial_path(PATH[:2])[1], rel=100 * RTOL)
        metal.push.value = 0.0
        problem.solve()


def test_a_history_that_is_not_finite(comm):
    """Where the material is a UFL expression of it, the error names the Function."""
    metal = plastic_block(comm, (1, 1, 1))
    metal.history[1].name = "hardening"
    with metal.problem(**OPTIONS) as problem:
        metal.history[1].x.array[-1:] = np.nan
        with pytest.raises(InputError, match=r"NaN or infinite in the Function 'hardening'"):
            problem.solve()


@pytest.mark.parametrize("numeric", [False, True], ids=["UFL", "numpy"])
def test_a_history_that_is_changed_between_solves(comm, numeric):
    """The next solve starts from the history as it is then, also at the same u."""
    metal = plastic_block(comm, (1, 1, 1), numeric=numeric)
    with metal.problem(**OPTIONS) as problem:
        virgin = forces(problem, metal.push, PATH[:2], accept=False)[1]
        metal.history[1].x.array[:] = 0.05  # hardened, without a strain
        hardened = problem.solve().normal_force
        metal.history[1].x.array[:] = 0.0
        again = problem.solve().normal_force
    assert virgin == pytest.approx(uniaxial_path(PATH[:2])[1], rel=100 * RTOL)
    assert hardened == pytest.approx(PATH[1] * YOUNG, rel=100 * RTOL)  # elastic
    assert again == pytest.approx(virgin, rel=100 * RTOL)
