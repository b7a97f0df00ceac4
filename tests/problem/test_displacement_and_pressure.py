"""Rubber with a pressure as an unknown of its own: Newton's method with saddle points."""

from __future__ import annotations

import itertools

from mpi4py import MPI

import numpy as np
import pytest

import basix.ufl
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactForce,
    ContactPair,
    ContactStatus,
    ConvergenceError,
    Coulomb,
    Frictionless,
    InputError,
    NewtonOptions,
    NonlinearContactProblem,
    RigidPlane,
    RigidSphere,
    SolverOptions,
    StiffnessError,
    read_gmsh,
    solve_adaptively,
)
from scenes.blocks import ABOVE, BELOW, LEFT, block
from scenes.elasticity import fixed, lame_constants
from scenes.pressures import rubber_with_pressure
from scenes.rubber_block import MU, neo_hookean, rubber_block

#: Accuracy of Newton's method, and of contact.
RTOL = 1e-9
OPTIONS = {"newton": NewtonOptions(accuracy=RTOL), "options": SolverOptions(rtol=RTOL)}


def solved(problem):
    """Return the solution of a problem that need not live on."""
    with problem:
        solution = problem.solve()
    solution.raise_if_failed()
    return solution


def uniaxial(comm, squeeze, **changes):
    """Return the problem of a block that keeps its volume, with rollers on its top."""
    rubber = rubber_block(comm, (2, 2), degree=2)
    rubber.push.value = -squeeze
    rubber = rubber_with_pressure(rubber, 0.0)
    return rubber, rubber.problem(**OPTIONS | changes)


@pytest.mark.parallel
def test_uniaxial_compression(comm):
    """Poisson's ratio 0.5 in plane strain: a stress mu (s^-3 - s) for the stretch s."""
    for squeeze in (0.05, 0.3):  # by 40 % it is unstable, and buckles
        rubber, problem = uniaxial(comm, squeeze)
        solution = solved(problem)
        stretch = 1.0 - squeeze
        wanted = MU * (stretch**-3 - stretch)
        assert solution.normal_force == pytest.approx(wanted, rel=100 * RTOL)
    assert any("contact" in step.added for step in solution.newton.steps)  # it buckles without
    mesh = rubber.scene.mesh
    volume = ufl.det(ufl.Identity(2) + ufl.grad(solution.u)) * ufl.dx(domain=mesh)
    assert comm.allreduce(fem.assemble_scalar(fem.form(volume))) == pytest.approx(1.0, rel=RTOL)


def test_wrinkles_are_named_with_their_remedy():
    """Where a block that keeps its volume gets unstable, the message says what helps."""
    _, problem = uniaxial(MPI.COMM_SELF, 0.6, newton=NewtonOptions(max_halvings=1))
    with problem:
        solution = problem.solve()
    assert solution.status is ContactStatus.NO_EQUILIBRIUM
    with pytest.raises(ConvergenceError, match="a part of the energy of the volume") as error:
        solution.raise_if_failed()
    assert str(error.value).count("wrinkle") == 1


def test_tetrahedra_on_two_meshes():
    """Taylor-Hood in 3D: mu (s^-2 - s), order 2."""
    stretch = 0.8
    for cells in (1, 2):
        rubber = rubber_block(MPI.COMM_SELF, (cells,) * 3, degree=2, boxes=False)
        rubber.push.value = stretch - 1.0
        rubber = rubber_with_pressure(rubber, 0.0)
        with rubber.problem(**OPTIONS) as problem:
            solution = problem.solve()
            with pytest.raises(InputError, match="ContactProblem, found <NonlinearContactPr"):
                solve_adaptively(lambda _, made=problem: made, rubber.scene.tagged_mesh, 0.1)
        solution.raise_if_failed()
        wanted = MU * (stretch**-2 - stretch)
        assert solution.normal_force == pytest.approx(wanted, rel=100 * RTOL)
        residuals = [step.residual for step in solution.newton.steps]
        assert all(b <= 10.0 * a**2 for a, b in itertools.pairwise(residuals[1:]) if b > 1e-12)


def o_ring(comm, cells, kind, friction=None, sliding="small"):
    """Return the O-ring in its groove of the demo, and the displacement of the lid.

    There are so many cells along a quarter of the arc. The kind is "reduced" for the demo's form;
    "whole" for one without reduced integration, and "points" for the same with pressures that are
    independent at its points; "Taylor-Hood", or "incompressible" with Poisson's ratio 0.5.
    """
    radius, mu, kappa = 2.65, 1.5, 75.0
    ring = read_gmsh(MESHES / "o_ring.geo", comm, R=radius, N=cells)
    mesh, facets, tags = ring.mesh, ring.facet_tags, ring.tags
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(2,))
    if kind in ("reduced", "whole"):
        space = of_u = fem.functionspace(mesh, element)
        w = u = fem.Function(space)
    else:
        family, degree = ("DG", 2) if kind == "points" else ("Lagrange", 1)
        pressure = basix.ufl.element(family, mesh.basix_cell(), degree)
        space = fem.functionspace(mesh, basix.ufl.mixed_element([element, pressure]))
        w, of_u = fem.Function(space), space.sub(0)
        u, p = ufl.split(w)
    F = ufl.Identity(2) + ufl.grad(u)
    J = ufl.det(F)
    everywhere, once = (ufl.dx(metadata={"quadrature_degree": degree}) for degree in (4, 1))
    energy = mu / 2 * (J ** (-2 / 3) * (ufl.inner(F, F) + 1) - 3) * everywhere
    if kind in ("reduced", "whole"):
        energy += kappa / 2 * (J - 1) ** 2 * (once if kind == "reduced" else everywhere)
    elif kind == "points":
        energy += (p * (J - 1) - p**2 / (2 * kappa)) * everywhere
    else:
        of_shape = 5 * mu  # the part of kappa that stays with the displacement
        compliance = 1 / (kappa - of_shape) if kind == "Taylor-Hood" else 0.0
        energy += of_shape / 2 * (J - 1) ** 2 * everywhere
        energy += (p * (J - 1) - fem.Constant(mesh, compliance) / 2 * p**2) * everywhere
    down, bcs = fem.Constant(mesh, 0.0), []
    for surface, axis, value in (("axis", 0, fem.Constant(mesh, 0.0)), ("middle", 1, down)):
        part = of_u.sub(axis)
        dofs = fem.locate_dofs_topological(part, 1, facets.find(tags[surface]))
        bcs.append(fem.dirichletbc(value, dofs, part))
    planes = RigidPlane((0, 0), (0, 1)), RigidPlane((1.12 * radius, 0), (-1, 0))
    law = Frictionless() if friction is None else friction
    pairs = [ContactPair(facets, tags["arc"], one, law, sliding=sliding) for one in planes]
    residual = ufl.derivative(energy, w)
    return NonlinearContactProblem(residual, w, pairs, bcs, **OPTIONS), down, radius


def squeezed(ring, *squeezes):
    """Return the solution after some steps of a ring that `o_ring` has returned."""
    problem, down, radius = ring
    with problem:
        for squeeze in squeezes:
            down.value = -squeeze * radius
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
    return solution


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_pressures_at_the_points_of_integration(comm, sliding):
    """They follow from the displacement at each point: as many, and no other forces, as without.

    A ring of 4 cells may find no equilibrium with friction from a squeeze of 0.1 on, which depends
    on the rounding; rings of 6 and 8 cells do.
    """
    rubs = {"friction": Coulomb(0.3), "sliding": sliding}
    alone, found = (squeezed(o_ring(comm, 4, kind, **rubs), 0.08) for kind in ("whole", "points"))
    wanted, force = (one.pair_resultants[0].force for one in (alone, found))
    accuracy = RTOL if sliding == "small" else found.options.geometry_accuracy
    assert np.abs(force - wanted).max() <= 100 * accuracy * alone.normal_force
    assert found.tangential_force > 0.01 * found.normal_force


def test_the_o_ring_both_ways():
    """One point of integration, and Taylor-Hood: the force of the lid within 1 %; order 2."""
    kinds = ("reduced", "Taylor-Hood", "incompressible")
    found = [squeezed(o_ring(MPI.COMM_SELF, 12, kind), 0.1, 0.22) for kind in kinds]
    reduced, mixed, incompressible = (one.pair_resultants[0].force[1] for one in found)
    assert found[0].pair_resultants[1].force[0] < 0.0  # it touches the wall, too
    assert mixed == pytest.approx(reduced, rel=0.01)
    assert reduced < incompressible < 1.1 * reduced
    for solution in found[1:]:
        assert not any(step.added for step in solution.newton.steps)
        residuals = [step.residual for step in solution.newton.steps]
        large = [r for r in residuals if r > 1e-12]  # beside rounding
        assert all(after <= 10.0 * r**2 for r, after in itertools.pairwise(large[-3:]))


@pytest.mark.parallel
def test_the_file_of_a_restart_has_the_pressure(comm, folder):
    rubber, problem = uniaxial(comm, 0.3)
    with problem:
        problem.solve().raise_if_failed()
        problem.accept()
        problem.save_state(folder / "mixed.npz", step=3)
        pressure = rubber.u.sub(1).collapse()
        sizes = np.array([np.abs(pressure.x.array).max(initial=0.0)])
    largest = comm.allreduce(sizes.max(), op=MPI.MAX)
    other, problem = uniaxial(MPI.COMM_SELF, 0.3)
    with problem:
        assert problem.load_state(folder / "mixed.npz") == 3
        found = other.u.sub(1).collapse().x.array
        # constant: mu (1 - s^2), of what carries the stress along the axis
        assert np.ptp(found) <= 1e3 * RTOL * largest
        assert np.abs(found).max() == pytest.approx(largest, rel=1e3 * RTOL)
        assert problem.solve().newton.steps[0].residual <= 100 * RTOL
    plain = rubber_block(MPI.COMM_SELF, (2, 2), degree=2)
    with plain.problem() as problem:
        problem.save_state(folder / f"plain_{comm.rank}.npz")
    other, problem = uniaxial(MPI.COMM_SELF, 0.3)
    with problem, pytest.raises(InputError, match=r"with 1 Function.*, and here there are 2"):
        problem.load_state(folder / f"plain_{comm.rank}.npz")


@pytest.mark.parallel
def test_what_the_functions_of_a_material_get(comm):
    """All unknowns, at each assembly and at the accepted step, whatever u was set to since."""
    seen = []
    rubber, problem = uniaxial(comm, 0.1, on_accept=lambda: seen.append(rubber.u.x.array.copy()))
    with problem:
        solution = problem.solve()
        rubber.u.x.array[:] = 0.0
        problem.accept()
        assert np.array_equal(seen[0], solution.w.x.array)
        assert not rubber.u.x.array.any()


def test_what_is_refused(comm):
    rubber, problem = uniaxial(comm, 0.1)
    mesh, W = rubber.scene.mesh, rubber.u.function_space
    with problem:
        problem.solve().raise_if_failed()
        problem.accept()
        with pytest.raises(InputError, match="needs a form of the displacement alone"):
            problem.gradient(ContactForce((0.0, 1.0)), [fem.Constant(mesh, 1.0)])
        rubber.u.x.array[-1] = np.nan
        with pytest.raises(InputError, match=r"u, which the solve starts from, has values .* NaN"):
            problem.solve()
    rubber.u.x.array[:] = 0.0
    with pytest.raises(InputError, match="stiffness='multigrid' needs a positive definite K"):
        rubber.problem(stiffness="multigrid")
    with pytest.raises(InputError, match="accuracy='balanced' asks for an estimate of the mesh's"):
        rubber.problem(options=SolverOptions())
    with pytest.raises(InputError, match=r"nothing holds body 1 of 1.* springs"):
        rubber.problem(bcs=[])
    u, q = fem.Function(rubber.scene.V), ufl.TestFunctions(W)[1]
    with pytest.raises(InputError, match=r"u must be a Function on the space of F's test function"):
        rubber.problem(F=ufl.inner(u, u) * q * ufl.dx, u=u, J=ufl.derivative(rubber.F, rubber.u))
    u, p = ufl.split(rubber.u)
    log_J = ufl.ln(ufl.det(ufl.Identity(2) + ufl.grad(u)))
    with pytest.raises(StiffnessError, match="on the diagonal of an unknown that is no displacem"):
        rubber.problem(F=rubber.F + p * q * ufl.dx)
    with pytest.raises(StiffnessError, match="not symmetric"):
        rubber.problem(F=rubber.F - 2 * q * log_J * ufl.dx)
    with pytest.raises(StiffnessError, match=r"K is singular: .* stable pair"):
        rubber_with_pressure(rubber_block(comm, (2, 2), degree=2), 0.0, ("DG", 2)).problem()


@pytest.mark.parallel()
def test_unstable_elements_are_named(comm):
    """A ball pressed into a thin layer of degree 2, until Newton's method fails."""
    ball = RigidSphere((0.0, 9.0), 8.0)
    scene = block(
        comm,
        (20, 2),
        size=(10.0, 1.0),
        degree=2,
        boxes=True,
        obstacles=[(ABOVE, ball)],
        friction=Frictionless(),
    )
    V, tags = scene.V, scene.facet_tags
    u = fem.Function(V)
    energy = neo_hookean(u, *lame_constants(1.0, 0.49)) * ufl.dx(degree=4)
    F = ufl.derivative(energy, u, ufl.TestFunction(V))
    bcs = [fixed(V, tags.find(BELOW)), fixed(V, tags.find(LEFT), component=0)]
    with NonlinearContactProblem(F, u, scene.pairs, bcs) as problem:
        for depth in (0.2, 0.4, 0.6, 0.8, 0.95):
            ball.move_to((0.0, -depth))
            solution = problem.solve(newton=NewtonOptions(max_halvings=1))
            if solution.status is ContactStatus.NO_EQUILIBRIUM:
                break
            problem.accept(unconverged=True)
    assert "hardly change their volume" in solution.failure and "mixed space" in solution.failure
