"""Bodies that only contact holds: K is singular, the contact problem is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rotations import rotation
from test_energy_bound import ASKED, check

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
    read_gmsh,
    refine,
)
from scenes.blocks import ABOVE, BELOW, block, floor
from scenes.blocks import YOUNG as YOUNG_OF_BLOCK
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity
from scenes.nodal import nodal
from scenes.patches import BOTTOM, KINDS, LOWER, TOP, UPPER, UPPER_BLOCK, dim_of, patch
from scenes.scene import EPS, Scene
from scenes.two_bricks import SLIP_BOUND, YOUNG, floating

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
    """The displacement is exact on turned meshes that do not match, rigid motion included."""
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


@pytest.mark.parallel(stiffness=["cholesky"])
@pytest.mark.parametrize("stiffness", STIFFNESS)
@pytest.mark.parametrize("part", [0.0, 1e-10, 1e-6, 1e-2])
def test_contact_and_springs_balance_the_loads(comm, part, stiffness):
    """Forces and moments on the brick are balanced to rounding, or to what K is solved to."""
    load, accuracy, spring = np.array([0.05, 0.02, -1.0]), 1e-2, part * YOUNG
    scene = pressed(comm, load)
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    a = scene.a + spring * ufl.inner(u, v) * ufl.dx if part else scene.a
    with scene.problem(a=a, stiffness=stiffness) as problem:
        assert ("held softly" in str(problem)) == (part > 0.0)
        solution = problem.solve(accuracy=accuracy)
    contact = solution.body_resultants[1].about(np.zeros(3))
    cells = ufl.Measure("dx", scene.mesh, subdomain_data=scene.cell_tags)(scene.tags["upper"])
    moment = ufl.cross(ufl.SpatialCoordinate(scene.mesh), solution.u)
    forms = [vector[i] * cells for vector in (solution.u, moment) for i in range(3)]
    pulled = [comm.allreduce(fem.assemble_scalar(fem.form(form))) for form in forms]
    area, centre = 2.0, np.array([1.0, 0.5, 2.0])
    loads = np.r_[area * load, np.cross(centre, area * load)]
    remainder = np.r_[contact.force, contact.moment] + loads - spring * np.array(pulled)
    # what is left does no more work along a motion than the error and the motion have energy
    exact = stiffness == "cholesky" or not part
    solved_to = 1e4 * EPS if exact else np.sqrt(part) * 0.1 * accuracy
    assert np.abs(remainder).max() <= solved_to * np.abs(loads).max()


def test_soft_springs_cost_no_products(comm):
    """Bodies on soft springs need no more products than bodies on stiff ones."""
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


@pytest.mark.parallel(stiffness=["cholesky"])
@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_the_bound_holds(comm, stiffness):
    scene = pressed(comm, (0.05, 0.02, -1.0), N=5 if comm.size == 1 else 3)
    with scene.problem(stiffness=stiffness) as problem:
        check(scene.a, problem, ASKED)


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


# What contact cannot hold


@pytest.mark.parametrize("stiffness", STIFFNESS)
@pytest.mark.parametrize("gap", [0.0, 1e-3, -1e-3])
def test_a_block_without_load_stays_at_rest(comm, gap, stiffness):
    """A block without load needs no iteration; what is inside the floor is lifted out of it."""
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
    """A load just below the bound of friction is held, one just above is refused."""
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


@pytest.mark.parallel
def test_a_pull_out_of_a_clamp(comm):
    """A clamped block might be pressed harder: only the pressures show that it slides.

    They fall with the pull, by Poisson's effect; it slides where friction is used up.
    """
    ceiling = RigidPlane((0.0, 0.0, 0.99), (0.0, 0.0, -1.0))
    obstacles = [(BELOW, floor(3)), (ABOVE, ceiling)]
    clamped = block(comm, (4, 3, 3), load=(0, 0, 0), obstacles=obstacles, friction=Coulomb(0.3))
    with clamped.problem() as problem:
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
            said = r"Nothing holds body 1 of 1.*along x.*are (more than|1\.0\d* times) the fric"
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
@pytest.mark.parametrize("spring", [1e-1, 1e-8])
@pytest.mark.parametrize("stiffness", STIFFNESS)
def test_a_sprung_block_that_is_lifted_off(comm, stiffness, spring):
    """Springs alone bear the load, and contact forces are zero to rounding.

    The moment 0.15 N m of the load turns the block on springs of the stiffness k / 6; far beyond
    linear theory, if they are soft.
    """
    turns = 6.0 * 0.15 / (spring * YOUNG_OF_BLOCK)
    expected = ContactStatus.OUTSIDE_THEORY if turns > 0.05 else ContactStatus.CONVERGED
    for friction in (Coulomb(10.0, limit=1.0), Coulomb(0.3)):
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
    """Small load steps of a block on soft springs converge with multigrid."""
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


#: Sides of a slab along the axes [m], its weight [MN/m^3], and Young's modulus [MPa].
SIDES, WEIGHT_OF_SLAB, YOUNG_OF_SLAB = (1.0, 0.5, 0.25), 0.02, 1e3


@pytest.mark.parallel
@pytest.mark.parametrize("sag", [0.0, -1e-3])
def test_a_slab_in_plane_strain_beside_a_body_that_is_wholly_prescribed(comm, sag):
    """The slab moves in its plane only: it floats, and the floor carries its weight.

    A motion across the plane, and all motions of the other body, move no free degree of freedom.
    """
    box = [(0.0, side) for side in SIDES]
    beside = [(2.0, 3.0), *box[1:]]
    made = boxes(comm, "hexahedron", [Body((4, 2, 1), box), Body((1, 1, 1), beside)])
    V, tags = made.V, made.tags((1, [0], lambda x: np.isclose(x[:, 1], 0.0)))
    across = fem.locate_dofs_geometrical(
        (V.sub(2), V.sub(2).collapse()[0]), lambda x: np.isfinite(x[0])
    )[0]
    rigid, clamp = fem.locate_dofs_geometrical(V, lambda x: x[0] > 1.5), fem.Function(V)
    clamp.interpolate(lambda x: np.vstack([0.0 * x[0], sag + 0.0 * x[0], 0.0 * x[0]]))
    bcs = [fem.dirichletbc(0.0, across, V.sub(2)), fem.dirichletbc(clamp, rigid)]
    floor = ContactPair(tags, 1, RigidPlane((0, 0, 0), (0, 1, 0)), Coulomb(0.5))
    L = -WEIGHT_OF_SLAB * ufl.TestFunction(V)[1] * ufl.dx
    with ContactProblem(elasticity(V, YOUNG_OF_SLAB), L, [floor], bcs) as problem:
        assert "2, 1 of them held by contact alone" in str(problem)
        solution = problem.solve(rtol=1e-8)
    solution.raise_if_failed()
    force = solution.pair_resultants[0].force
    assert force == pytest.approx([0.0, WEIGHT_OF_SLAB * np.prod(SIDES), 0.0], abs=1e-12)


@pytest.mark.parallel
@pytest.mark.parametrize("softness", [0.0, 1e-6])
def test_a_body_of_one_cell(comm, softness):
    """The floor and soft springs carry its weight; on several ranks, some have no node of it."""
    made = boxes(comm, "quadrilateral", [Body((1, 1), [(0.0, 1.0), (0.0, 1.0)])])
    tags = made.tags((1, [0], lambda x: np.isclose(x[:, 1], 0.0)))
    u, v = ufl.TrialFunction(made.V), ufl.TestFunction(made.V)
    spring = fem.Constant(made.mesh, softness * YOUNG_OF_SLAB)
    a = elasticity(made.V, YOUNG_OF_SLAB) + spring * ufl.inner(u, v) * ufl.dx
    floor = ContactPair(tags, 1, RigidPlane((0, 0, 0), (0, 1, 0)), Coulomb(0.5))
    with ContactProblem(a, -WEIGHT_OF_SLAB * v[1] * ufl.dx, [floor]) as problem:
        solution = problem.solve(rtol=1e-9)
    solution.raise_if_failed()
    carried = comm.allreduce(fem.assemble_scalar(fem.form(spring * solution.u[1] * ufl.dx)))
    force = solution.pair_resultants[0].force
    assert force == pytest.approx([0.0, WEIGHT_OF_SLAB + carried], abs=1e-9 * WEIGHT_OF_SLAB)


@pytest.fixture
def blocks(comm, folder):
    """Two blocks of the material "stone" on a block of "base", with the mesh file's names."""
    lines = [
        'SetFactory("OpenCASCADE");',
        "For k In {0:2}",
        "  Rectangle(k + 1) = {0, k, 0, 1, 1};",
        "EndFor",
        'Physical Surface("base", 1) = {1};',
        'Physical Surface("stone", 2) = {2, 3};',
        'Physical Curve("floor", 1) = {1};',
        'Physical Curve("joints", 2) = {3, 5, 7, 9};',
        "Mesh.MeshSizeMax = 1;",
    ]
    path = folder / "blocks.geo"
    if comm.rank == 0:
        path.write_text("\n".join(lines))
    comm.barrier()
    return read_gmsh(path, comm)


def problem_of(blocks):
    V = fem.functionspace(blocks.mesh, ("Lagrange", 1, (2,)))
    L = -ufl.TestFunction(V)[1] * ufl.dx
    law = Coulomb(0.5)
    pairs = [
        ContactPair(blocks.facet_tags, 1, RigidPlane((0, 0), (0, 1)), law),
        ContactPair(blocks.facet_tags, [2], [2], law),
    ]
    return ContactProblem(elasticity(V, 1e3), L, pairs)


@pytest.mark.parallel
def test_names_are_those_of_the_cells(blocks):
    """A name that two bodies have is given with their numbers; refined meshes keep names."""
    cells = blocks.mesh.topology.index_map(2).size_local
    for mesh in (blocks, refine(blocks, np.ones(cells), fraction=1.0)):
        with problem_of(mesh) as problem:
            solution = problem.solve(rtol=1e-8)
    assert solution.body_names == ("base", "body 2 (stone)", "body 3 (stone)")
    found = solution.resultants_between("base", "body 2 (stone)")
    assert found.force == pytest.approx([0.0, -2.0], abs=1e-6)
    assert "base by body 2 (stone): " in str(solution).replace("\N{NO-BREAK SPACE}", " ")
