"""Bodies that only contact holds: K is singular, the contact problem is not."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest
from rotations import rotation
from test_energy_bound import ASKED, check

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    ContactStatus,
    ConvergenceError,
    Coulomb,
    Frictionless,
    InputError,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca._base.bodies import label_bodies
from scenes.blocks import ABOVE, BELOW, block, floor
from scenes.blocks import YOUNG as YOUNG_OF_BLOCK
from scenes.boxes import Body, boxes
from scenes.nodal import nodal
from scenes.patches import BOTTOM, KINDS, LOWER, TOP, UPPER, UPPER_BLOCK, dim_of, patch
from scenes.scene import EPS, Scene
from scenes.two_bricks import SLIP_BOUND, YOUNG, floating, two_bricks

#: Of the multigrid solver and of the residual in comparisons.
TIGHT = 1e-11

STIFFNESS = ("cholesky", "multigrid")


def pressed(comm, load=(0.0, 0.0, -1.0), N: int = 4, body: str = "upper") -> Scene:
    """One brick that nothing holds, with a traction [MPa] on top of the upper one."""
    scene = floating(comm, body, N)
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    scene.data.load.value[:] = load
    v = ufl.TestFunction(scene.V)
    L = ufl.inner(scene.data.load, v) * ds(scene.tags["upper_top"])
    return dataclasses.replace(scene, L=L)


def solved(scene: Scene, stiffness: str = "cholesky", rtol: float = TIGHT, **changes):
    with scene.problem(stiffness=stiffness, **changes) as problem:
        solution = problem.solve(rtol=rtol)
    assert solution.status is ContactStatus.CONVERGED
    return solution


def without_top(scene: Scene) -> Scene:
    """The blocks with the pressure in place of what holds the upper one."""
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    dim = scene.mesh.topology.dim
    v = ufl.TestFunction(scene.V)
    force = fem.Constant(scene.mesh, -2.5 * scene.data.axis[:dim])
    return dataclasses.replace(scene, L=scene.L + ufl.inner(force, v) * ds(TOP), bcs=scene.bcs[1:2])


@pytest.mark.parallel(kind=["triangle", "hexahedron"], degree=[1])
@pytest.mark.parametrize("stiffness", STIFFNESS)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_a_block_under_its_pressure(comm, kind, degree, stiffness):
    """Meshes that do not match, turned: the displacement is exact, rigid motion included."""
    turn = rotation(3, dim_of(kind))
    scene = without_top(patch(comm, kind, degree, turn=turn, friction=Tresca(0.3)))
    rtol, exact = (1e-10, 1e-8) if stiffness == "cholesky" else (1e-7, 1e-5)
    with scene.problem(stiffness=stiffness) as problem:
        assert "1 of them held by contact alone" in str(problem)
        solution = problem.solve(rtol=rtol)
    assert solution.status is ContactStatus.CONVERGED
    size = np.abs(scene.data.exact.x.array).max()
    assert np.abs(solution.u.x.array - scene.data.exact.x.array).max() <= exact * size
    pressure = nodal(solution.surface.pressure)[nodal(solution.surface.state) >= 0]
    assert np.abs(pressure - 2.5).max(initial=0.0) <= exact * 2.5


@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_the_limit_of_soft_springs(comm, stiffness):
    """K is positive definite with springs on the brick, and another path through the code is taken.

    The springs take a part of the load that is their part of the stiffness. Without contact the
    brick goes as much farther, and residuals are relative to those of that.
    """
    scene = pressed(comm, (0.05, 0.02, -1.0))
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    free = solved(scene, stiffness, rtol=1e-9)
    differences = []
    for part in (1e-4, 1e-5, 1e-8):
        held = scene.a + part * YOUNG * ufl.inner(u, v) * ufl.dx
        soft = solved(scene, stiffness, rtol=min(1e-9, 1e-3 * part), a=held)
        difference = np.abs(nodal(soft.surface.pressure) - nodal(free.surface.pressure))
        differences.append(comm.allreduce(difference.max(initial=0.0), op=MPI.MAX))
    assert 0.09 * differences[0] <= differences[1] <= 0.11 * differences[0]
    assert differences[2] <= 1e-3 * differences[1] + 1e-5


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_contact_balances_the_loads(comm, stiffness):
    """Force and moment on the floating brick, to rounding."""
    load = np.array([0.05, 0.02, -1.0])
    scene = pressed(comm, load)
    with scene.problem(stiffness=stiffness) as problem:
        solution = problem.solve(accuracy=1e-2)  # whatever the accuracy
        jump = problem._contact.surfaces.jump
        force = jump.contact_force(solution.multipliers / jump.stress_scale)
        total = force.array.reshape(-1, 3)
        points = scene.V.tabulate_dof_coordinates()[: len(total)]
        on_upper = np.isclose(points[:, 2], 1.0) & (np.abs(total).sum(axis=1) > 0.0)
        on_upper &= np.isin(np.arange(len(total)), jump.pairs[0].nodes)
        found = comm.allreduce(wrench(points[on_upper], total[on_upper]))
    area, centre = 2.0, np.array([1.0, 0.5, 2.0])
    expected = np.r_[area * load, np.cross(centre, area * load)]
    # B'lambda is what the brick gives to the contact
    assert np.abs(found - expected).max() <= 1e4 * EPS * np.abs(expected).max()


@pytest.mark.parametrize("stiffness", STIFFNESS)
@pytest.mark.parametrize("part", [1e-10, 1e-6, 1e-2])
def test_contact_and_springs_balance_the_loads(comm, part, stiffness):
    """Force and moment on the softly held brick: to rounding, or to what K is solved to."""
    accuracy = 1e-2
    scene = pressed(comm, (0.05, 0.02, -1.0))
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    a = scene.a + part * YOUNG * ufl.inner(u, v) * ufl.dx
    with scene.problem(a=a, stiffness=stiffness) as problem:
        assert "held softly" in str(problem)
        solution = problem.solve(accuracy=accuracy)
        system, jump = problem._contact.linear, problem._contact.surfaces.jump
        net = jump.net_force(solution.multipliers / jump.stress_scale).copy()
        elastic = net.duplicate()
        system.K.mult(solution.u.x.petsc_vec, elastic)
        rest, loads = (net - elastic).array, system.f.x.petsc_vec.array
        net.destroy()
        elastic.destroy()
    points = scene.V.tabulate_dof_coordinates()[: len(rest) // 3]
    body = label_bodies(scene.V)[: len(points)] == 1
    left = comm.allreduce(wrench(points[body], rest.reshape(-1, 3)[body]))
    all_of_it = comm.allreduce(np.abs(loads).sum())
    # what is left does no more work along a motion than the error and the motion have energy
    solved_to = 1e4 * EPS if stiffness == "cholesky" else np.sqrt(part) * 0.1 * accuracy
    assert np.abs(left).max() <= solved_to * all_of_it


def test_soft_springs_cost_no_products(comm):
    """Multigrid: no product is made more accurate than the springs allow."""
    products = []
    for part in (1e-2, 1e-6, 1e-10):
        scene = pressed(comm, (0.05, 0.02, -1.0))
        u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
        a = scene.a + part * YOUNG * ufl.inner(u, v) * ufl.dx
        with scene.problem(a=a, stiffness="multigrid") as problem:
            solution = problem.solve(accuracy=1e-6)
        assert solution.status is ContactStatus.CONVERGED
        products.append(solution.products)
    assert max(products) <= 1.5 * min(products)


@pytest.mark.parametrize("asked", [{"accuracy": 1e-4}, {"rtol": 1e-6}], ids=["accuracy", "rtol"])
def test_later_steps_of_a_floating_body_cost_what_those_of_a_held_one_do(comm, asked):
    """Multigrid: half as many again at most; loads and places that begin to slip differ."""
    products = []
    for scene in (pressed(comm, (0.05, 0.02, -1.0)), two_bricks(comm, 4)):
        first = scene.data.load.value.copy()
        with scene.problem(stiffness="multigrid") as problem:
            problem.solve(**asked)
            later = []
            for factor in (0.9, 0.99, 1.09, 0.98, 1.08):
                scene.data.load.value[...] = factor * first
                solution = problem.solve(**asked)
                assert solution.status is ContactStatus.CONVERGED
                later.append(solution.products)
        products.append(sum(later))
    assert products[0] <= 1.5 * products[1]


def wrench(points: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the resultant (6,) of forces (n, 3): force and moment about the origin."""
    return np.r_[forces.sum(axis=0), np.cross(points, forces).sum(axis=0)]


@pytest.mark.parallel(stiffness=["cholesky"])
@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_the_bound_holds(comm, stiffness):
    scene = pressed(comm, (0.05, 0.02, -1.0), N=5 if comm.size == 1 else 3)
    with scene.problem(stiffness=stiffness) as problem:
        check(scene.a, problem, ASKED)


@pytest.mark.parallel
def test_two_blocks_on_a_plane(comm):
    """Both float; one is pressed on the other, and that on a rigid plane."""
    scene = without_top(patch(comm, "tetrahedron", friction=Tresca(0.3)))
    facets = dolfinx.mesh.locate_entities_boundary(scene.mesh, 2, lambda x: np.isclose(x[2], 0.0))
    ground = dolfinx.mesh.meshtags(
        scene.mesh, 2, np.sort(facets), np.full(len(facets), 9, dtype=np.int32)
    )
    pairs = [
        scene.pair,
        ContactPair(ground, 9, RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), Tresca(0.3)),
    ]
    with ContactProblem(scene.a, scene.L, pairs) as problem:
        assert "2, 2 of them held by contact alone" in str(problem)
        solution = problem.solve(rtol=TIGHT)
    assert solution.status is ContactStatus.CONVERGED
    for surface in solution.surfaces:
        force = fem.assemble_scalar(fem.form(surface.pressure * ufl.dx))
        assert np.isclose(comm.allreduce(force), 2.5, rtol=1e3 * EPS)


@pytest.mark.parallel
def test_a_bonded_block(comm):
    """Nothing but glue holds the upper block: the answer is linear in the load."""
    scene = without_top(patch(comm, "hexahedron", friction=Bonded()))
    sign = fem.Constant(scene.mesh, 1.0)
    scene = dataclasses.replace(scene, L=sign * scene.L)
    with scene.problem() as problem:
        displacements = []
        for sign.value in (1.0, 0.0, -1.0):
            solution = problem.solve(rtol=TIGHT)
            displacements.append(solution.u.x.array.copy())
            assert solution.status is ContactStatus.CONVERGED
    pressed, slack, pulled = displacements
    size = np.abs(scene.data.exact.x.array).max()
    assert np.abs(pressed - scene.data.exact.x.array).max() <= 1e-9 * size
    assert np.abs(pressed + pulled - 2.0 * slack).max() <= 1e-9 * size


@pytest.mark.parametrize("gap", [1e-3, 1.0, 1000.0])
def test_the_distance_that_a_body_falls_makes_no_difference(comm, gap):
    """Up to rounding in the distance."""
    scene = without_top(patch(comm, "tetrahedron", gap=gap, friction=Tresca(0.3)))
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-9)
    assert solution.status is ContactStatus.CONVERGED
    pressure = nodal(solution.surface.pressure)[nodal(solution.surface.state) >= 0]
    # deformations are of the size 5e-3; rounding of distances, as a part of them
    rounding = EPS * (1.0 + gap) / 5e-3
    assert np.abs(pressure - 2.5).max(initial=0.0) <= 2.5 * (1e-7 + 1e3 * rounding)


@pytest.mark.parallel
def test_a_hinge(comm):
    """The upper brick is held along one edge: rotation about it is left to the contact."""
    scene = two_bricks(comm, 3)
    edge = fem.locate_dofs_geometrical(
        scene.V, lambda x: np.isclose(x[0], 2.0) & np.isclose(x[2], 2.0)
    )
    hinge = fem.dirichletbc(np.zeros(3), edge, scene.V)
    scene = dataclasses.replace(scene, bcs=[hinge, scene.fixed("lower_fixed")])
    one, other = solved(scene), solved(scene, "multigrid", rtol=1e-9)
    pressures = [nodal(solution.surface.pressure) for solution in (one, other)]
    size = comm.allreduce(np.abs(pressures[0]).max(initial=0.0), op=MPI.MAX)
    assert size > 0.0
    assert np.abs(pressures[0] - pressures[1]).max(initial=0.0) <= 1e-7 * size


def test_following_solves(comm):
    """Loads, bounds and the stiffness change; each solution is that of a new problem."""
    scene = pressed(comm, N=3)
    young = fem.Constant(scene.mesh, 1.0)
    scene = dataclasses.replace(scene, a=young * scene.a)
    with scene.problem() as problem:
        for load, factor in (((0.0, 0.0, -1.0), 1.0), ((0.08, 0.0, -0.5), 1.0), ((0, 0, -2), 3.0)):
            scene.data.load.value[:] = load
            if young.value != factor:
                young.value = factor
                problem.update_stiffness()
            found, fresh = problem.solve(rtol=TIGHT), solved(scene)
            size = comm.allreduce(np.abs(fresh.u.x.array).max(initial=0.0), op=MPI.MAX)
            assert np.abs(found.u.x.array - fresh.u.x.array).max(initial=0.0) <= 1e-7 * size


@pytest.mark.parallel
def test_a_glued_block_that_does_not_reach_the_ceiling(comm):
    """Multigrid: glue alone holds it and nothing touches, whatever accuracy is asked for."""
    scene = without_top(patch(comm, "triangle", friction=Bonded()))
    factor = fem.Constant(scene.mesh, -1.1)
    scene = dataclasses.replace(scene, L=factor * scene.L)
    rise = solved(scene).u.x.array.reshape(-1, 2)[:, 1].max(initial=0.0)
    height = 2.0 + 1.01 * comm.allreduce(rise, op=MPI.MAX)
    ceiling = RigidPlane((0.0, height, 0.0), (0.0, -1.0, 0.0))
    friction = Tresca(0.3, only_in_contact=True)
    pairs = [scene.pair, ContactPair(scene.facet_tags, TOP, ceiling, friction)]
    with scene.problem(pairs=pairs, stiffness="multigrid") as problem:
        for asked in ({}, {"accuracy": 1e-4}, {"rtol": 1e-6}):
            problem.forget()
            for factor.value in (-1.0, -1.1):
                solution = problem.solve(**asked)
                assert solution.status is ContactStatus.CONVERGED
                assert solution.counts.contact == 0


# What contact cannot hold


@pytest.mark.parametrize("stiffness", STIFFNESS)
@pytest.mark.parametrize("gap", [0.0, 1e-3, -1e-3])
def test_a_block_without_load_stays_at_rest(comm, gap, stiffness):
    """It costs nothing, and later steps are right; what is inside the floor is lifted out of it."""
    scene = without_top(patch(comm, "hexahedron", turn=rotation(1), friction=Tresca(0.3)))
    # the patch's blocks are glued to one, which stands on a floor
    up = scene.data.axis
    floor = RigidPlane(-gap * up, up)
    pairs = [dataclasses.replace(scene.pair, friction=Bonded())]
    pairs.append(ContactPair(scene.facet_tags, BOTTOM, floor, Tresca(0.3)))
    sign = fem.Constant(scene.mesh, 0.0)
    with ContactProblem(scene.a, sign * scene.L, pairs, stiffness=stiffness) as problem:
        for sign.value in (0.0, 1.0, 0.0):
            solution = problem.solve()
            assert solution.status is ContactStatus.CONVERGED
            if sign.value == 0.0:
                assert solution.iterations == 0
                lifted = solution.u.x.array.reshape(-1, 3) @ up
                # of the size of the blocks, 3
                assert np.abs(lifted - max(-gap, 0.0)).max(initial=0.0) <= 1e3 * EPS * 3.0
            else:
                assert np.isclose(solution.normal_force, 2.0 * 2.5, rtol=1e-9)


def refused(scene: Scene, message: str, **changes) -> None:
    with scene.problem(**changes) as problem, pytest.raises(InputError, match=message):
        problem.solve()


@pytest.mark.parallel
@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_a_load_that_pulls_the_body_away(comm, stiffness):
    scene = pressed(comm, (0.0, 0.0, 1.0))
    refused(
        scene,
        r"no contact forces balance the loads on body 2 of 2 \(upper\), between \(0, 0, 1\) and "
        r"\(2, 1, 2\): translation along z",
        stiffness=stiffness,
    )


@pytest.mark.parallel
def test_a_load_that_overcomes_friction(comm):
    """The bound times the area is 0.18 MN; a little less is held, more is not."""
    scene = pressed(comm, (SLIP_BOUND * 0.98, 0.0, -1.0))
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-6)
        assert solution.status is ContactStatus.CONVERGED
        assert np.isclose(solution.tangential_force, 0.98 * 2.0 * SLIP_BOUND, rtol=1e-10)
        scene.data.load.value[0] = SLIP_BOUND * 1.02
        with pytest.raises(InputError, match=r"body 2 of 2.*: translation along x"):
            problem.solve()
        scene.data.load.value[0] = 0.0  # and the problem can be used again
        assert problem.solve().status is ContactStatus.CONVERGED


@pytest.mark.parallel(stiffness=["cholesky"])
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_a_pull_out_of_a_clamp(comm, stiffness):
    """What is pressed from two sides might be pressed harder: only pressures show that it slides.

    They fall with the pull, by Poisson's effect; it slides where friction is used up.
    """
    ceiling = RigidPlane((0.0, 0.0, 0.99), (0.0, 0.0, -1.0))
    obstacles = [(BELOW, floor(3)), (ABOVE, ceiling)]
    clamped = block(comm, (4, 3, 3), load=(0, 0, 0), obstacles=obstacles, friction=Coulomb(0.3))
    with clamped.problem(stiffness=stiffness) as problem:
        for pull in (5.535, 5.56):
            clamped.data.pull.value = pull
            solution = problem.solve()
            normal = solution.pair_resultants[0].force[2]
            used = pull / (2 * 0.3 * normal)
            if pull < 5.55:
                assert solution.status is ContactStatus.CONVERGED
                assert 0.995 < used < 1.0
                continue
            assert solution.status is ContactStatus.NO_FIXED_POINT
            assert solution.iterations < 10  # and not as many as it takes to lose patience
            said = r"Nothing holds body 1 of 1.*along x.*are 1\.0\d* times the friction"
            with pytest.raises(ConvergenceError, match=said):
                solution.raise_if_failed()
            assert "sliding" in str(solution)


@pytest.mark.parallel
def test_a_body_that_can_slide_and_spin(comm):
    scene = pressed(comm)
    pair = dataclasses.replace(scene.pair, friction=Frictionless())
    refused(
        scene,
        r"nothing holds body 2 of 2 \(upper\), .*: translation along x, translation along y, "
        r"rotation about z, and no contact resists that.*\n?.*Dirichlet",
        pairs=[pair],
    )
    none = dataclasses.replace(scene.pair, friction=Tresca(0.0))
    refused(scene, "nothing holds body 2 of 2", pairs=[none])


@pytest.mark.parallel
def test_a_body_that_touches_nothing(comm):
    """The lower brick floats, and the pair is between the upper one and a plane."""
    scene = pressed(comm, body="lower")
    tag = scene.tags["upper_contact"]
    plane = RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    pair = ContactPair(scene.facet_tags, tag, plane, Tresca(0.1))
    names = "translation along x, translation along y, translation along z, rotation about x"
    refused(scene, f"nothing holds body 1 of 2 .*, between .*: {names}", pairs=[pair])


@pytest.mark.parallel
@pytest.mark.parametrize("friction", [Coulomb(0.5), Tresca(0.1), Bonded()])
def test_bodies_that_hold_each_other_only(comm, friction):
    """Two bricks that nothing holds together move in all ways; on rollers, along the floor."""
    scene = pressed(comm)
    pairs = [dataclasses.replace(scene.pair, friction=friction)]
    together = r"nothing holds body 1 of 2 \(lower\), .*, together with body 2 \(upper\):"
    free = dataclasses.replace(scene, bcs=[])
    refused(free, f"{together} translation along x.*, rotation about z, and no", pairs=pairs)
    floor = fem.locate_dofs_geometrical(
        (scene.V.sub(2), scene.V.sub(2).collapse()[0]), lambda x: x[2] < EPS
    )[0]
    rollers = fem.dirichletbc(0.0, floor, scene.V.sub(2))
    motion = "translation along x, translation along y, rotation about z, and no contact"
    refused(
        dataclasses.replace(scene, bcs=[rollers]), f"{together} {motion} resists that", pairs=pairs
    )


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
def test_groups_of_bodies_that_nothing_holds(comm, dim):
    """Two bonded bodies slide as one on two others, which stand as one on a floor; a fifth is free.

    The gap below the fifth body counts as contact, which resists only where a plane has friction.
    Bodies that move by themselves are named before bodies that move together.
    """
    lowest = [(0.0, 0.0), (0.0, 1.0), (0.0, 2.0), (0.0, 3.0), (3.0, 0.5)]
    kind = {2: "quadrilateral", 3: "hexahedron"}[dim]
    bodies = [Body((2, 2), [(x, x + 1.0), (0.0, 1.0), (z, z + 1.0)][:: 4 - dim]) for x, z in lowest]
    five = boxes(comm, kind, bodies)
    marks = [
        (1 + 2 * k + side, [k], lambda x, end=z + side: abs(x[:, -1] - end) < EPS)
        for k, (_, z) in enumerate(lowest)
        for side in (0, 1)
    ]
    tags = five.tags(*marks)
    u, v = ufl.TrialFunction(five.V), ufl.TestFunction(five.V)
    a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
    plane = RigidPlane((0.0, 0.0, 0.0), np.append(np.eye(dim)[-1], np.zeros(3 - dim)))
    laws = [Bonded(), Frictionless(), Bonded()]
    pairs = [ContactPair(tags, 3 + 2 * k, 2 + 2 * k, law) for k, law in enumerate(laws)]
    pairs.append(ContactPair(tags, 1, plane, Coulomb(0.5)))
    pairs.append(ContactPair(tags, 9, plane, Frictionless()))
    slides = {2: "translation along x", 3: "translation along x, .* y, rotation about z"}[dim]
    messages = [
        f"nothing holds body 5 of 5, between [^:]*: {slides}, and no contact resists that",
        f"nothing holds body 3 of 5, between .*, together with body 4: {slides}, and no contact",
        f"nothing holds body 1 of 5, between [^:]*: {slides}; nor 4 more, and no contact",
    ]
    held = [*pairs[:-1], ContactPair(tags, 9, plane, Coulomb(0.5))]
    slippery = [dataclasses.replace(pair, friction=Frictionless()) for pair in pairs]
    for message, chosen in zip(messages, (pairs, held, slippery), strict=True):
        with ContactProblem(a, None, chosen) as problem, pytest.raises(InputError, match=message):
            problem.solve()


@pytest.mark.parallel
def test_methods_that_need_held_bodies(comm):
    with (
        pressed(comm).problem() as problem,
        pytest.raises(InputError, match=r"'gimssn'.*2, 1 of them held by contact alone"),
    ):
        problem.solve(method="gimssn")


@pytest.mark.parallel
@pytest.mark.parametrize("spring", [1e-1, 1e-3, 1e-8])
@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_a_sprung_block_that_is_lifted_off(comm, stiffness, spring):
    """Springs alone bear the load: what rounding of that is left for contact counts as zero.

    The moment 0.15 N m of the load turns the block on springs of the stiffness k / 6; far beyond
    linear theory, if they are soft.
    """
    turns = 6.0 * 0.15 / (spring * YOUNG_OF_BLOCK)
    expected = ContactStatus.OUTSIDE_THEORY if turns > 0.05 else ContactStatus.CONVERGED
    for friction in (Tresca(1.0, only_in_contact=True), Coulomb(0.3)):
        spring_stiffness = spring * YOUNG_OF_BLOCK
        scene = block(comm, (2, 2), spring=spring_stiffness, load=(0.3, 0, 1), friction=friction)
        with scene.problem(stiffness=stiffness) as problem:
            for asked in ({}, {"accuracy": 1e-4}, {"rtol": 1e-6}):
                problem.forget()
                solution = problem.solve(**asked)
                assert solution.status is expected
                assert solution.normal_force <= EPS / spring


@pytest.mark.parallel
@pytest.mark.parametrize("spring", [1e-4, 1e-5])
def test_small_steps_of_a_sprung_block(comm, spring):
    """Multigrid: the rigid displacement belongs to the gradient that it is returned with."""
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(4, 1), young=(1.0, 1e4))
    springs = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
    springs.x.array[scene.cell_tags.find(UPPER_BLOCK)] = spring
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    load = fem.Constant(scene.mesh, np.zeros(2))
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    pair = ContactPair(scene.facet_tags, LOWER, UPPER, Tresca(2.5))
    scene.data.exact.x.array[:] = 0.0
    with ContactProblem(
        scene.a + springs * ufl.inner(u, v) * ufl.dx,
        ufl.inner(load, v) * ds(TOP),
        [pair],
        bcs=scene.bcs[1:2],
        stiffness="multigrid",
    ) as problem:
        for factor in (1.0, 1.02, 1.04):
            load.value[:] = factor * np.array([-0.3, -1.0])
            assert problem.solve().status is ContactStatus.CONVERGED
