"""Bad input: a clear error on all ranks, none hangs; the message names what was found."""

from __future__ import annotations

import logging
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from logged import logged

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactError,
    ContactPair,
    ContactProblem,
    ContactState,
    ContactStatus,
    InputError,
    PairingError,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    SolverOptions,
    TaggedMesh,
    Tresca,
    Units,
    read_gmsh,
)
from dolfinx_tresca._base import compat
from scenes.elasticity import elasticity
from scenes.nodal import nodal, node_function
from scenes.patches import KINDS, dim_of, patch
from scenes.two_bricks import YOUNG, two_bricks
from scenes.wall import wall

pytestmark = pytest.mark.parallel


@pytest.fixture
def scene(comm):
    return two_bricks(comm, 3)


def pair_with(scene, **changes) -> ContactPair:
    arguments = {
        "facet_tags": scene.facet_tags,
        "secondary": scene.tags["upper_contact"],
        "primary": scene.tags["lower_contact"],
        "friction": Tresca(0.1),
        **changes,
    }
    return ContactPair(**arguments)


def refused(scene, message: str, kind: type[Exception] = InputError, **changes) -> None:
    """Check the error of the constructor, on every rank, and that the ranks still agree."""
    with pytest.raises(kind, match=message):
        scene.problem(**changes)
    assert isinstance(kind("x"), ContactError)
    comm = scene.V.mesh.comm
    assert comm.allreduce(1) == comm.size


def test_messages_do_not_show_whole_arrays(scene):
    """Whatever is given, the message can be read."""
    huge = list(range(100_000))
    x = ufl.SpatialCoordinate(scene.V.mesh)
    long = sum(ufl.sin(i * x[0]) for i in range(1, 100))
    facet_tags = scene.facet_tags
    for give in (
        lambda: ContactPair(huge, 22, 12, Tresca(0.1)),
        lambda: ContactPair(facet_tags, huge, 12, Tresca(0.1)),
        lambda: ContactPair(facet_tags, 22, 12, huge),
        lambda: ContactPair(facet_tags, 22, 12, Tresca(0.1), pairing=huge),
        lambda: ContactPair(facet_tags, 22, 12, Tresca(0.1), search_distance=huge),
        lambda: Tresca(long.dx(0)),
        lambda: RigidSphere(huge, 1.0),
        lambda: RigidSphere((0, 0, 0), huge),
        lambda: RigidObstacle(huge),
        lambda: SolverOptions(rtol=huge),
        lambda: SolverOptions(method=huge),
        lambda: SolverOptions(max_iterations=huge),
        lambda: Units(huge, "MPa"),
        lambda: read_gmsh(huge, scene.V.mesh.comm),
        lambda: ContactProblem(scene.a, scene.L, [huge], bcs=scene.bcs),
        lambda: ContactProblem(scene.a, scene.L, [scene.pair], bcs=[huge]),
        lambda: ContactProblem(huge, scene.L, [scene.pair], bcs=scene.bcs),
        lambda: scene.problem(options=huge),
        lambda: scene.problem(units=huge),
        lambda: scene.problem(petsc_options=huge),
        lambda: scene.problem(petsc_options_prefix=huge),
        lambda: scene.problem(stiffness=huge),
        lambda: scene.problem(expected_solves=huge),
    ):
        with pytest.raises(InputError) as caught:
            give()
        assert len(str(caught.value)) < 500


# Pairs


@pytest.mark.parametrize("side", ["secondary", "primary"])
def test_a_wrong_tag(scene, side):
    refused(scene, f"tag 99 .*{side}.*22", pairs=[pair_with(scene, **{side: 99})])


def test_a_tag_of_cells_is_no_tag_of_facets(scene):
    refused(scene, "tag 1 ", pairs=[pair_with(scene, primary=scene.tags["lower"])])


def test_an_empty_side(scene):
    """Tags that mark no facet at all."""
    none = np.zeros(0, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(scene.mesh, 2, none, none)
    refused(scene, r"no facet has the tag 22", pairs=[pair_with(scene, facet_tags=tags)])


def test_friction_that_is_no_law(scene):
    with pytest.raises(
        InputError, match=r"Tresca\(0\.1\), Coulomb\(0\.3\), Frictionless.*found 0\.3"
    ):
        pair_with(scene, friction=0.3)


def test_no_pairs(scene):
    refused(scene, "at least one ContactPair", pairs=[])


def test_cell_tags_in_place_of_facet_tags(scene):
    refused(
        scene,
        "dimension 3.*facets have 2",
        pairs=[pair_with(scene, facet_tags=scene.cell_tags, secondary=2, primary=1)],
    )


def test_tags_of_another_mesh(comm, scene):
    other = two_bricks(comm, 3)
    refused(scene, "another mesh", pairs=[pair_with(scene, facet_tags=other.facet_tags)])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairing": "node"}, "pairing must be one of auto, nodes, mortar, found 'node'"),
        ({"pairing": None}, "pairing must be one of .*found None"),
        ({"search_distance": 0.0}, r"search_distance must be a positive number, found 0\.0"),
        ({"search_distance": -1}, "search_distance must be a positive number, found -1"),
        ({"search_distance": np.nan}, "search_distance must be a positive number, found nan"),
        ({"search_distance": "far"}, "search_distance must be a positive number, found 'far'"),
        ({"friction": None}, r"Frictionless\(\) or Bonded\(\), found None"),
        ({"friction": Bonded}, "friction must be a law"),
        ({"pairing": np.array(["auto", "nodes"])}, "pairing must be one of .*found array"),
        ({"secondary": 2**40}, "integer tag of a surface, found 1099511627776"),
        ({"primary": -(2**40)}, "integer tag of a surface or a RigidObstacle"),
    ],
)
def test_pairs_with_wrong_arguments(scene, changes, message):
    with pytest.raises(InputError, match=message):
        pair_with(scene, **changes)


def test_surfaces_that_do_not_face_each_other(scene):
    """The message names both tags and what to check, whatever the pairing."""
    top, lower = scene.tags["upper_top"], scene.tags["lower_contact"]
    for pairing in ("auto", "nodes", "mortar"):
        pair = pair_with(scene, secondary=top, primary=lower, pairing=pairing)
        message = r"do not face each other.*upper_top.*lower_contact.*Check the tags\."
        refused(scene, message, PairingError, pairs=[pair])


def test_nothing_within_the_search_distance(comm):
    scene = two_bricks(comm, 3, Offset=0.2)
    for pairing in ("auto", "nodes", "mortar"):
        pair = pair_with(scene, pairing=pairing, search_distance=0.1)
        message = r"do not face each other.*within 0\.1\. Check the tags and the search distance"
        refused(scene, message, PairingError, pairs=[pair])
        pair = pair_with(scene, pairing=pairing, search_distance=0.3)
        with scene.problem(pairs=[pair]) as problem:
            assert problem.contact_nodes == 9


# Meshes


@pytest.mark.parametrize("kind", KINDS)
def test_duplicated_nodes_are_a_warning(comm, caplog, kind):
    """The upper block is torn along the middle: nodes of its face lie at the place of others.

    In 3D one of five nodes is on a side of the block with another tag, and not counted.
    """
    for tear, number in ((None, 0), (lambda x: x[:, 0] > 0.5, 1 if dim_of(kind) == 2 else 4)):
        torn = patch(comm, kind, upper=(4, 1), distort=0.0, tear=tear)
        caplog.clear()
        with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"), torn.problem() as problem:
            assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED
        text = logged(caplog)
        if number and comm.rank == 0:
            assert f"tag 1 (secondary side) has {number} nodes at the place of another" in text
            assert "Merge duplicated nodes" in text
        else:
            assert text == ""


@pytest.mark.parametrize("one_pair", [False, True])
def test_corners_of_bricks_side_by_side_are_no_warning(comm, caplog, one_pair):
    """Nodes of two bodies with contact between them coincide where they touch the floor."""
    with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"):
        wall(comm, 2, 2, one_pair=one_pair).problem().destroy()
    assert logged(caplog) == ""


@pytest.mark.parametrize("tags", [None, 3, [22], "facet_tags", "the mesh and its tags"])
def test_facet_tags_that_are_none(scene, tags):
    whole = TaggedMesh(scene.mesh, scene.cell_tags, scene.facet_tags, scene.tags)
    with pytest.raises(InputError, match=r"facet_tags must be dolfinx\.mesh\.MeshTags .*, found"):
        pair_with(scene, facet_tags=whole if tags == "the mesh and its tags" else tags)


def test_facet_tags_of_another_type(scene):
    facets = np.zeros(0, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(scene.mesh, 2, facets, np.zeros(0))
    with pytest.raises(InputError, match="int32, found float64"):
        pair_with(scene, facet_tags=tags)


# Slip bounds


def bad_bound(scene, bound, message: str, then=None) -> None:
    """Check the error of the solve; `then` mends the bound, and the problem goes on."""
    with scene.problem(pairs=[pair_with(scene, friction=Tresca(bound))]) as problem:
        with pytest.raises(InputError, match=message):
            problem.solve(rtol=1e-6)
        if then is not None:
            then()
            assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


VALUES = pytest.mark.parametrize(
    ("value", "text"), [(-0.5, "-0.5"), (np.nan, "nan"), (-np.inf, "-inf")]
)


@VALUES
def test_a_number_that_is_no_slip_bound(scene, value, text):
    """It takes no solve to tell."""
    with pytest.raises(InputError, match=f"must not be (negative|NaN), found {text}"):
        scene.problem(pairs=[pair_with(scene, friction=Tresca(value))])


@VALUES
def test_a_constant_that_is_no_slip_bound(scene, value, text):
    constant = fem.Constant(scene.mesh, value)

    def mend():
        constant.value = 0.1

    bad_bound(scene, constant, f"slip bound .*found {text}", mend)


@VALUES
def test_a_function_that_is_no_slip_bound_at_one_node(comm, scene, value, text):
    """One node, on one rank."""
    bound = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)))

    def values(bad):
        return lambda x: np.where(
            np.isclose(x[0], 0) & np.isclose(x[1], 0) & np.isclose(x[2], 1), bad, 0.1
        )

    bound.interpolate(values(value))
    bad_bound(
        scene,
        bound,
        f"slip bound .*found {text} *.*1 of the",
        lambda: bound.interpolate(values(0.1)),
    )


@VALUES
def test_an_expression_that_is_no_slip_bound(scene, value, text):
    p = node_function(scene.mesh, lambda x: np.full(x.shape[1], value))

    def mend():
        p.x.array[:] = 0.1

    bad_bound(scene, 1.0 * p, f"slip bound .*found {text}", mend)


def test_a_bound_that_is_bad_away_from_the_contact_does_no_harm(scene):
    def values(x):
        return np.where(x[2] > 1.4, np.nan, 0.1)

    with scene.problem(pairs=[pair_with(scene, friction=Tresca(values))]) as problem:
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


def test_slip_bounds_of_the_wrong_shape(scene):
    mesh = scene.mesh
    vector = fem.Function(scene.V)
    for bound, shape in (
        (fem.Constant(mesh, np.zeros(3)), r"\(3,\)"),
        (vector, r"\(3,\)"),
        (2.0 * vector, r"\(3,\)"),
        (np.ones(5), r"\(5,\)"),
        ([0.1, 0.2], r"\(2,\)"),
    ):
        with pytest.raises(InputError, match=f"scalar, found shape {shape}"):
            Tresca(bound)


@pytest.mark.parametrize("bound", ["0.1", None, 0.1j, float, fem.Function])
def test_slip_bounds_of_the_wrong_type(bound):
    with pytest.raises(InputError, match=r"slip bound must be a number, .*points, found"):
        Tresca(bound)


#: What a function of n points returns, and what the message says of it.
RETURNED = {
    "none": (lambda n: None, "None"),
    "text": (lambda n: "a", "a"),
    "too few": (lambda n: np.full(2, 0.1), r"shape \(2,\) of float64"),
    "too many": (lambda n: np.full(3 * n, 0.1), r"shape \(\d+,\) of float64"),
    "a column": (lambda n: np.full((n, 1), 0.1), r"shape \(\d+, 1\) of float64"),
    "two rows": (lambda n: np.full((2, n), 0.1), r"shape \(2, \d+\) of float64"),
    "three rows": (lambda n: np.full((3, n), 0.1), r"shape \(3, \d+\) of float64"),
    "complex": (lambda n: np.full(n, 0.1 + 0j), r"shape \(\d+,\) of complex128"),
}


@pytest.mark.parametrize("name", RETURNED)
def test_a_callable_that_returns_something_else(scene, name):
    """Seen where the problem is made, before DOLFINx reads beyond the array's end."""
    returned, found = RETURNED[name]
    bound = Tresca(lambda x: returned(x.shape[1]))
    message = rf"must return a real number, or one for each point: .*found {found}\."
    refused(scene, message, pairs=[pair_with(scene, friction=bound)])


def test_a_callable_that_returns_something_else_later(scene):
    """Once on all ranks, then on the lowest that has contact nodes."""
    fails = False

    def values(x):
        return np.full(x.shape[1] + fails, 0.1)

    comm = scene.V.mesh.comm
    with scene.problem(pairs=[pair_with(scene, friction=Tresca(values))]) as problem:
        solution = problem.solve(rtol=1e-6)
        mine = (nodal(solution.state) > ContactState.OUTSIDE).any()
        lowest = comm.allreduce(comm.rank if mine else comm.size, op=MPI.MIN)
        for ranks in (range(comm.size), [lowest]):
            fails = comm.rank in ranks
            with pytest.raises(InputError, match="must return a real number"):
                problem.solve(rtol=1e-6)
        fails = False
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


def test_an_exception_of_a_callable_is_raised_on_all_ranks(scene):
    with pytest.raises(ZeroDivisionError):
        scene.problem(pairs=[pair_with(scene, friction=Tresca(lambda x: 1 / 0))])


def test_a_bound_on_another_mesh(comm, scene):
    other = node_function(two_bricks(comm, 3).mesh, lambda x: np.full(x.shape[1], 0.1))
    for bound, kind in ((other, "a Function"), (0.3 * other, "an expression")):
        message = f"is {kind} on another mesh"
        refused(scene, message, pairs=[pair_with(scene, friction=Tresca(bound))])


def discontinuous_bounds(mesh) -> dict[str, object]:
    """Bounds that have no value at nodes."""

    def on(element) -> fem.Function:
        return fem.Function(fem.functionspace(mesh, element))

    return {
        "DG0": on(("DG", 0)),
        "DG1": on(("DG", 1)),
        "CR": on(("CR", 1)),
        "quadrature": on(basix.ufl.quadrature_element(mesh.basix_cell(), degree=2)),
        "of DG0": 2.0 * on(("DG", 0)) + 1.0,
    }


def test_discontinuous_slip_bounds(scene):
    mesh = scene.mesh
    for bound in discontinuous_bounds(mesh).values():
        with pytest.raises(InputError, match=r"no value at nodes: .*continuous space"):
            Tresca(bound)
    p = node_function(mesh, lambda x: x[0])
    for bound in (p.dx(0), abs(ufl.FacetNormal(mesh)[0]), 0.1 * ufl.CellDiameter(mesh)):
        with pytest.raises(InputError, match=r"no value at nodes, since .* jumps from cell"):
            Tresca(bound)


def test_slip_bounds_of_trial_functions(scene):
    with pytest.raises(InputError, match="must not depend on a trial or test function"):
        Tresca(ufl.TrialFunction(scene.V)[2])


def test_complex_slip_bounds(scene):
    mesh = scene.mesh
    constant = fem.Constant(mesh, 0.1 + 0j)
    function = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)), dtype=np.complex128)
    for bound in (constant, 2.0 * constant, function):
        with pytest.raises(InputError, match="float64, found complex128"):
            Tresca(bound)


# Forms, spaces, meshes


def test_complex_petsc(scene, monkeypatch):
    monkeypatch.setattr(compat, "PETSc", SimpleNamespace(ScalarType=np.complex128))
    refused(scene, "real scalars, found complex128", ContactError)


def forms_on(mesh, element) -> tuple:
    V = fem.functionspace(mesh, element)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(mesh, np.zeros(V.value_shape))
    return V, ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, ufl.inner(zero, v) * ufl.dx


def test_tags_of_a_3D_mesh_for_a_problem_in_2D(comm, scene):
    _, a, L = forms_on(dolfinx.mesh.create_unit_square(comm, 3, 3), ("Lagrange", 1, (2,)))
    refused(scene, "another mesh", a=a, L=L, bcs=[])


def test_a_surface_in_space(comm, scene):
    facets = scene.facet_tags.find(scene.tags["upper_top"])
    surface = dolfinx.mesh.create_submesh(scene.mesh, 2, facets)[0]
    _, a, L = forms_on(surface, ("Lagrange", 1, (3,)))
    message = r"dimension 2 in space of dimension 3.*gdim=2"
    refused(scene, message, a=a, L=L, bcs=[])


ELEMENTS = {
    "scalar": ("Lagrange", 1),
    "P3": ("Lagrange", 3, (3,)),
    "two components": ("Lagrange", 1, (2,)),
    "DG1": ("DG", 1, (3,)),
    "DG2": ("DG", 2, (3,)),
    "Crouzeix-Raviart": ("CR", 1, (3,)),
    "Nedelec": ("N1curl", 1),
}


@pytest.mark.parametrize("name", ELEMENTS)
def test_another_element(scene, name):
    _, a, L = forms_on(scene.mesh, ELEMENTS[name])
    message = r'contact needs the space .*"Lagrange", 1, \(3,\).*or degree 2'
    refused(scene, message, a=a, L=L, bcs=[])


@pytest.mark.parametrize("degree", [1, 3])
def test_another_element_in_2D(comm, scene, degree):
    """Degree 3, and three components in the plane."""
    mesh = dolfinx.mesh.create_unit_square(comm, 3, 3)
    shape = (2,) if degree == 3 else (3,)
    _, a, L = forms_on(mesh, ("Lagrange", degree, shape))
    refused(scene, r'"Lagrange", 1, \(2,\)', a=a, L=L, bcs=[])


def test_prisms(comm, scene):
    """Their facets are of two kinds."""
    mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2, dolfinx.mesh.CellType.prism)
    _, a, L = forms_on(mesh, ("Lagrange", 1, (3,)))
    refused(
        scene, "triangle, quadrilateral, tetrahedron, hexahedron.*found prism", a=a, L=L, bcs=[]
    )


def test_a_line(comm, scene):
    mesh = dolfinx.mesh.create_unit_interval(comm, 8)
    _, a, L = forms_on(mesh, ("Lagrange", 1, (1,)))
    refused(scene, "found interval cells", a=a, L=L, bcs=[])


def test_forms_on_different_spaces(scene):
    V = fem.functionspace(scene.mesh, ("Lagrange", 1, (3,)))
    refused(scene, "different function spaces", a=elasticity(V, YOUNG))


def test_forms_with_wrong_arguments(scene):
    refused(scene, "found 1 and 1 arguments", a=scene.L)
    refused(scene, "found 2 and 2 arguments", L=scene.a)


def test_a_condition_on_another_space(comm, scene):
    V = fem.functionspace(scene.mesh, ("Lagrange", 1, (3,)))
    facets = scene.facet_tags.find(scene.tags["upper_fixed"])
    other = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets), V)
    refused(scene, "condition 1 is on another", bcs=[scene.bcs[0], other])
    refused(scene, "condition 0 is on another", bcs=two_bricks(comm, 3).bcs)


def test_conditions_on_components_are_welcome(scene):
    bcs = [
        scene.fixed(name, component=k) for name in ("upper_fixed", "lower_fixed") for k in range(3)
    ]
    with scene.problem(bcs=bcs) as problem, scene.problem() as usual:
        q, expected = problem.solve(rtol=1e-6).q[-1], usual.solve(rtol=1e-6).q[-1]
    assert q == pytest.approx(expected, rel=1e-10)


def test_an_unknown_stiffness_method(scene):
    refused(scene, "auto, cholesky, multigrid, found 'lu'", stiffness="lu")


# Options


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "newton"}, "method must be one of projected_newton, .*'newton'"),
        ({"rtol": 0.0}, r"rtol must be a number in \(0, 1\), found 0\.0"),
        ({"rtol": np.nan}, "rtol .*nan"),
        ({"rtol": 1.0}, r"rtol .*1\.0"),
        ({"max_iterations": 0}, "max_iterations must be a positive integer, found 0"),
        ({"rho_sigma": 2.0}, r"rho_sigma must be a number in \(0, 2\), found 2\.0"),
        ({"rho_sigma": -1.0}, r"rho_sigma .*-1\.0"),
        ({"rho_sigma": np.nan}, "rho_sigma .*nan"),
        ({"method": "imssn", "rho_sigma": 0.0}, r"rho_sigma must be a number in \(0, inf\)"),
        ({"method": "imssn", "rho_sigma": np.inf}, "rho_sigma"),
        ({"r_tol": 1.0}, "r_tol"),
        ({"c_fact": 0.0}, "c_fact"),
    ],
)
def test_options_out_of_range(comm, changes, message):
    with pytest.raises(InputError, match=message):
        SolverOptions(**changes)
    with (
        two_bricks(comm, 2).problem() as problem,
        pytest.raises(InputError, match=message),
    ):
        problem.solve(**changes)


def test_an_unknown_option(scene):
    with (
        scene.problem() as problem,
        pytest.raises(TypeError, match=r"solve\(\) got an unexpected keyword argument 'tolerance'"),
    ):
        problem.solve(tolerance=1e-3)


def test_errors_are_value_errors_and_contact_errors():
    """A script may catch either."""
    with pytest.raises(ValueError):
        SolverOptions(rtol=-1.0)
    with pytest.raises(ContactError):
        SolverOptions(rtol=-1.0)


def test_after_an_error_other_problems_work(comm, scene):
    with pytest.raises(InputError):
        scene.problem(pairs=[pair_with(scene, primary=99)])
    with scene.problem() as good:
        assert good.solve(rtol=1e-6).status is ContactStatus.CONVERGED
    assert MPI.Comm.Compare(comm, scene.V.mesh.comm) in (MPI.IDENT, MPI.CONGRUENT)


def test_the_same_surfaces_in_two_pairs(scene):
    swapped = pair_with(scene, secondary=scene.pair.primary, primary=scene.pair.secondary)
    both = [scene.pair.secondary, scene.pair.primary]
    listed = pair_with(scene, secondary=both, primary=both)
    for pairs in ([scene.pair, scene.pair], [scene.pair, swapped], [scene.pair, listed]):
        with pytest.raises(InputError, match="two pairs are between the surfaces"):
            ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs)


def test_a_pair_that_is_no_list(scene):
    with pytest.raises(InputError, match=r"\[pair\]"):
        ContactProblem(scene.a, scene.L, scene.pair, bcs=scene.bcs)
    for pairs in (None, 3):
        with pytest.raises(InputError, match=rf"pairs must be a sequence.*found {pairs}"):
            ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs)
    for wrong in (3, None, (scene.facet_tags, 22, 12, Tresca(0.1))):
        with pytest.raises(InputError, match="ContactPair objects, found"):
            ContactProblem(scene.a, scene.L, [scene.pair, wrong], bcs=scene.bcs)


@pytest.mark.parametrize("tag", ["upper_contact", 22.0, None, True])
def test_a_tag_that_is_no_integer(scene, tag):
    with pytest.raises(InputError, match=r"integer tag of a surface.*read_gmsh"):
        pair_with(scene, secondary=tag)


def test_conditions_that_are_none(scene):
    for wrong in (3, None, "a", (scene.bcs[0],), scene.bcs, fem.Function(scene.V)):
        refused(scene, "bcs must hold Dirichlet conditions.*found", bcs=[scene.bcs[0], wrong])
    for wrong in (3, None, scene.bcs[0]):
        refused(scene, "bcs must be a sequence of Dirichlet conditions, found", bcs=wrong)
    value = fem.Function(scene.V, dtype=np.complex128)
    complex_values = fem.dirichletbc(value, np.zeros(0, dtype=np.int32))
    message = "values of Dirichlet condition 1 .*float64, found DirichletBC_complex128"
    refused(scene, message, bcs=[scene.bcs[0], complex_values])


def test_a_mesh_in_single_precision(comm, scene):
    mesh = dolfinx.mesh.create_unit_cube(comm, 2, 2, 2, dtype=np.float32)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    load = fem.Constant(mesh, np.zeros(3, dtype=np.float32))
    a, L = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, ufl.inner(load, v) * ufl.dx
    refused(scene, "mesh of type float64, found float32", a=a, L=L, bcs=[])


@pytest.mark.parametrize("name", ["a", "L"])
def test_forms_of_another_type(scene, name):
    form, mesh = getattr(scene, name), scene.mesh
    factor = fem.Function(fem.functionspace(mesh, ("DG", 0)), dtype=np.complex128)
    factor.name = "factor"
    component = factor
    for argument in form.arguments():
        component = component * argument[0]
    for wrong, found in (
        (fem.Constant(mesh, 1.0 + 1.0j) * form, "complex128"),
        (fem.Constant(mesh, np.float32(1.0)) * form, "float32"),
        (form + component * ufl.dx, "complex128 in factor"),
    ):
        refused(scene, f"form {name} .* float64 only, found {found}", **{name: wrong})
    # why, the first rank says, which compiles
    why = ".*complex" if scene.V.mesh.comm.rank == 0 else ""
    refused(scene, f"the form {name} cannot be compiled: {why}", **{name: (1 + 1j) * form})
    for wrong in (0, 3, "x", [form]):
        refused(scene, f"{name} must be a UFL form, .*V=, found", **{name: wrong})
    if name == "L":
        refused(scene, "L must be a UFL form, None for no load, or .* found 0", L=0)


def test_a_form_that_is_refused_without_a_word(scene, monkeypatch):
    """As by an assertion of DOLFINx 0.9, of integrals over cells of which some have tags."""

    def assertion(form, **_):
        if form is scene.L:
            raise AssertionError
        return compiled(form)

    compiled = fem.form
    monkeypatch.setattr(fem, "form", assertion)
    refused(scene, "form L cannot be compiled: AssertionError; do all integrals", L=scene.L)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("options", {"rtol": 1e-3}, r"options must be SolverOptions\(...\), found {'rtol'"),
        ("options", SolverOptions, "options must be SolverOptions"),
        ("petsc_options", "ksp_rtol", "petsc_options must be a mapping .*found 'ksp_rtol'"),
        ("petsc_options", [("ksp_rtol", 1e-8)], "petsc_options must be a mapping"),
        ("petsc_options", {3: 4}, "petsc_options must be a mapping .*found {3: 4}"),
        ("petsc_options_prefix", 3, "petsc_options_prefix must be a string .*found 3"),
        ("petsc_options_prefix", "-mine_", "without leading hyphen, found '-mine_'"),
    ],
)
def test_arguments_of_the_problem_of_another_kind(scene, name, value, message):
    refused(scene, message, **{name: value})


def test_a_solver_that_may_not_iterate(scene):
    """PETSc writes beyond the end of an empty array."""
    message = "ksp_max_it must be at least 1"
    refused(scene, message, stiffness="multigrid", petsc_options={"ksp_max_it": 0})


def test_an_observer_that_is_no_function(scene):
    """On one rank."""
    comm = scene.V.mesh.comm
    for wrong in (3, "observer", [print]):
        with scene.problem() as problem:
            observer = wrong if comm.rank == comm.size - 1 else None
            with pytest.raises(InputError, match=r"observer must be a function .*found"):
                problem.solve(observer=observer)


@pytest.mark.parametrize("wrong", [(1j, 0, 0), ("1", "2", "3"), None, "abc", (np.nan, 0, 0)])
def test_obstacles_at_no_place(wrong):
    with pytest.raises(InputError, match="point must be 2 or 3 "):
        RigidPlane(wrong, (0, 0, 1))
    with pytest.raises(InputError, match="center must be 2 or 3 "):
        RigidSphere(wrong, 1.0)


def test_radii():
    assert "radius 3" in str(RigidSphere((0, 0, 0), np.int64(3)))
    for wrong in (0, -1, np.nan, np.inf, None, "1", 1j):
        with pytest.raises(InputError, match="radius must be a positive number, found"):
            RigidSphere((0, 0, 0), wrong)


def test_an_obstacle_with_complex_distances():
    def distance(x):
        return x[2] + 0j, np.tile([[0.0], [0.0], [1.0]], (1, x.shape[1]))

    with pytest.raises(InputError, match="expected real numbers, found complex128"):
        RigidObstacle(distance).at(np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("name", "value"), [("rtol", "a"), ("method", ["x"]), ("max_iterations", 2.5)]
)
def test_an_option_of_another_kind(name, value):
    with pytest.raises(InputError, match=name):
        SolverOptions(**{name: value})
