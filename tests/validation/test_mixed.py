"""Bodies with a pressure as an unknown of its own, incompressible ones among them."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import ContactStatus, Frictionless, RigidPlane, StiffnessError, Tresca
from scenes.blocks import ABOVE, BELOW, LEFT, RIGHT, YOUNG, block
from scenes.pressures import strain_energy, with_mean_pressure, with_pressure
from scenes.rubbing import rubbing

#: Residual of what is compared, and the error it leaves.
TIGHT, ACCURACY = 1e-12, 1e-8

#: The bound is no larger than this times the error.
SHARP = 5.0


def matches(found, expected, tolerance=ACCURACY) -> None:
    """Compare solutions on spaces of the same kind, whose numbering differs."""
    u = fem.Function(expected.u.function_space)
    u.interpolate(found.u)
    size = np.abs(expected.u.x.array).max()
    assert np.abs(u.x.array - expected.u.x.array).max() <= tolerance * size
    for name in ("normal_force", "tangential_force", "peak_pressure", "dissipation"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=tolerance)
    assert found.counts == expected.counts


@pytest.mark.parallel(poisson=[0.4999])
@pytest.mark.parametrize("poisson", [0.3, 0.4999])
def test_a_pressure_that_could_be_eliminated(comm, poisson):
    """Mixed elements have the answer of displacements alone, with load steps and moved surfaces."""
    scene = rubbing(comm, "triangle", 2, upper=(4, 1), lower=(3, 1), friction=Tresca(0.8))
    plain = with_mean_pressure(scene, YOUNG, poisson)
    mixed = with_pressure(scene, YOUNG, poisson, ("DG", 0))
    with plain.problem() as one, mixed.problem() as other:
        expected, found = one.solve(rtol=TIGHT), other.solve(rtol=TIGHT)
        matches(found, expected)
        assert 0 < found.counts.contact < found.counts.nodes
        assert 0 < found.counts.slip < found.counts.nodes
        for problem, solution in ((one, expected), (other, found)):
            problem.accept()
            problem.update_geometry(solution.u)
        matches(other.solve(rtol=TIGHT), one.solve(rtol=TIGHT), 10 * ACCURACY)


def integral(form) -> float:
    """Over all ranks."""
    value = fem.assemble_scalar(fem.form(form))
    return float(form.ufl_domain().ufl_cargo().comm.allreduce(value, op=MPI.SUM))


@pytest.mark.parallel(poisson=[0.5])
@pytest.mark.parametrize("poisson", [0.4999, 0.5])
def test_the_bound_of_the_error_is_one(comm, poisson):
    """The bound holds in the norm of displacements that keep their volume."""
    scene = with_pressure(rubbing(comm, "triangle", 2, upper=(4, 1), lower=(5, 1)), YOUNG, poisson)
    with scene.problem() as problem:
        exact = problem.solve(rtol=TIGHT)
        norm = np.sqrt(integral(strain_energy(exact.w, YOUNG, poisson)))
        for asked in ({"accuracy": 0.1}, {"accuracy": 1e-2}, {"accuracy": 1e-4}, {"rtol": 0.1}):
            problem.forget()
            found = problem.solve(**asked)
            assert found.status is ContactStatus.CONVERGED
            difference = fem.Function(found.w.function_space)
            difference.x.array[:] = found.w.x.array - exact.w.x.array
            error = np.sqrt(integral(strain_energy(difference, YOUNG, poisson))) / norm
            assert error <= found.energy_error_bound + ACCURACY
            assert found.energy_error_bound <= SHARP * error + ACCURACY
            assert found.energy_error_bound <= asked.get("accuracy", np.inf)


@pytest.mark.parallel(dim=[2])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_block_that_is_free_to_grow_sideways(comm, dim):
    """An incompressible block that is pressed has the exact uniform state."""
    strain, side = 1e-3, 1e-3 / (dim - 1)
    shape = np.array([side] * (dim - 1) + [-strain])

    def moved(x):
        return shape[:, None] * x[:dim]

    scene = block(
        comm, (2,) * dim, degree=2, load=(0, 0, 0), held=(ABOVE,), moved=moved, boxes=True,
        friction=Frictionless(),
    )  # fmt: skip
    mu = YOUNG / 3
    with with_pressure(scene, YOUNG, 0.5).problem() as problem:
        found = problem.solve(rtol=TIGHT)
    u, p = found.w.split()
    expected = fem.Function(found.u.function_space)
    expected.interpolate(moved)
    assert np.abs(found.u.x.array - expected.x.array).max() <= ACCURACY * strain
    assert np.abs(p.collapse().x.array + 2 * mu * side).max() <= ACCURACY * mu * strain
    assert np.abs(u.collapse().x.array - found.u.x.array).max() == 0.0
    height = 2 * mu * (side + strain)  # 4 mu strain = E / (1 - nu^2) strain; in 3D E strain
    assert found.peak_pressure == pytest.approx(height, rel=ACCURACY)
    assert found.normal_force == pytest.approx(height, rel=ACCURACY)


@pytest.mark.parallel
def test_a_body_that_is_closed_in(comm):
    """A body that cannot change its volume is refused if supports close it in."""
    wall = RigidPlane(point=(0.999, 0, 0), normal=(-1, 0, 0))
    scene = block(
        comm, (2, 2), degree=2, load=(0, 0, 0), across=(LEFT, BELOW, ABOVE),
        friction=Frictionless(), obstacles=[(RIGHT, wall)],
    )  # fmt: skip
    with pytest.raises(StiffnessError, match="close in a body that cannot change its volume"):
        with_pressure(scene, YOUNG, 0.5).problem()
    poisson = 0.4999
    with with_pressure(scene, YOUNG, poisson).problem() as problem:
        found = problem.solve(rtol=TIGHT)
    modulus = YOUNG * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    assert found.peak_pressure == pytest.approx(1e-3 * modulus, rel=ACCURACY)
    assert found.normal_force == pytest.approx(1e-3 * modulus, rel=ACCURACY)
