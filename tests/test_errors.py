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
    Frictionless,
    InputError,
    PairingError,
    RigidObstacle,
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
    """Messages are short, even if a wrong argument is large."""
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


def forms_on(mesh, *element) -> dict:
    """Return forms on a space without conditions, as arguments of a problem."""
    V = fem.functionspace(mesh, element)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(mesh, np.zeros(V.value_shape, dtype=mesh.geometry.x.dtype))
    stiffness = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    return {"a": stiffness, "L": ufl.inner(zero, v) * ufl.dx, "bcs": []}


def surface_of(scene):
    facets = scene.facet_tags.find(scene.tags["upper_top"])
    return dolfinx.mesh.create_submesh(scene.mesh, 2, facets)[0]


def without_facets(scene):
    none = np.zeros(0, dtype=np.int32)
    return dolfinx.mesh.meshtags(scene.mesh, 2, none, none)


def condition_on(scene, V):
    facets = scene.facet_tags.find(scene.tags["upper_fixed"])
    return fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets), V)


def complex_condition(scene):
    value = fem.Function(scene.V, dtype=np.complex128)
    return fem.dirichletbc(value, np.zeros(0, dtype=np.int32))


def vectors(mesh):
    return fem.functionspace(mesh, ("Lagrange", 1, (3,)))


SPACES_IN_3D = r'contact needs the space .*"Lagrange", 1, \(3,\).*or degree 2'
SPACES_IN_2D = r'"Lagrange", 1, \(2,\)'
CONDITIONS = r"bcs\[\d\] must be a Dirichlet condition.*found"
SEQUENCE = "bcs must be a sequence of Dirichlet conditions, found"
PRISMS = dolfinx.mesh.CellType.prism

#: What is wrong -> message, and the arguments of the problem as a function of the scene.
REFUSED = {
    "secondary": ("tag 99 .*secondary.*22", lambda s: {"pairs": [pair_with(s, secondary=99)]}),
    "primary": ("tag 99 .*primary.*22", lambda s: {"pairs": [pair_with(s, primary=99)]}),
    "tag of cells": ("tag 1 ", lambda s: {"pairs": [pair_with(s, primary=s.tags["lower"])]}),
    "no facets": (
        r"no facet has the tag 22",
        lambda s: {"pairs": [pair_with(s, facet_tags=without_facets(s))]},
    ),
    "tags of cells": (
        "dimension 3.*facets have 2",
        lambda s: {"pairs": [pair_with(s, facet_tags=s.cell_tags, secondary=2, primary=1)]},
    ),
    "tags of another mesh": (
        "another mesh",
        lambda s: {"pairs": [pair_with(s, facet_tags=two_bricks(s.mesh.comm, 3).facet_tags)]},
    ),
    "no pairs": ("at least one ContactPair", lambda s: {"pairs": []}),
    "pairs None": ("pairs must be a sequence, found None.*", lambda s: {"pairs": None}),
    "a pair": (r"\[pair\]", lambda s: {"pairs": s.pair}),
    "tuple": (
        r"pairs\[1\] must be a ContactPair, found",
        lambda s: {"pairs": [s.pair, (s.facet_tags, 22)]},
    ),
    "mesh in 2D": (
        "another mesh",
        lambda s: forms_on(dolfinx.mesh.create_unit_square(s.mesh.comm, 3, 3), "Lagrange", 1, (2,)),
    ),
    "surface": (
        r"dimension 2 in space of dimension 3: gdim is 2 in 2D",
        lambda s: forms_on(surface_of(s), "Lagrange", 1, (3,)),
    ),
    "prisms": (
        "triangle, quadrilateral, tetrahedron, hexahedron.*found prism",
        lambda s: forms_on(
            dolfinx.mesh.create_unit_cube(s.mesh.comm, 2, 2, 2, PRISMS), "Lagrange", 1, (3,)
        ),
    ),
    "line": (
        "found interval cells",
        lambda s: forms_on(dolfinx.mesh.create_unit_interval(s.mesh.comm, 8), "Lagrange", 1, (1,)),
    ),
    "single precision": (
        "type float64, found float32 in the mesh",
        lambda s: forms_on(
            dolfinx.mesh.create_unit_cube(s.mesh.comm, 2, 2, 2, dtype=np.float32),
            *("Lagrange", 1, (3,)),
        ),
    ),
    **{
        f"{element[0]} {element[1]}": (
            SPACES_IN_3D,
            lambda s, element=element: forms_on(s.mesh, *element),
        )
        for element in (
            *(("Lagrange", 1), ("Lagrange", 3, (3,)), ("DG", 2, (3,))),
            *(("CR", 1, (3,)), ("N1curl", 1)),
        )
    },
    **{
        f"{shape} components of degree {degree} in 2D": (
            SPACES_IN_2D,
            lambda s, degree=degree, shape=shape: forms_on(
                dolfinx.mesh.create_unit_square(s.mesh.comm, 3, 3), "Lagrange", degree, (shape,)
            ),
        )
        for degree, shape in ((1, 3), (3, 2))
    },
    "two spaces": (
        "different function spaces",
        lambda s: {"a": elasticity(vectors(s.mesh), YOUNG)},
    ),
    "L as a": ("found 1 and 1 arguments", lambda s: {"a": s.L}),
    "a as L": ("found 2 and 2 arguments", lambda s: {"L": s.a}),
    "condition on another space": (
        r"bcs\[1\] is on another",
        lambda s: {"bcs": [s.bcs[0], condition_on(s, vectors(s.mesh))]},
    ),
    "conditions on another mesh": (
        r"bcs\[0\] is on another",
        lambda s: {"bcs": two_bricks(s.mesh.comm, 3).bcs},
    ),
    "3 as a condition": (CONDITIONS, lambda s: {"bcs": [s.bcs[0], 3]}),
    "list as a condition": (CONDITIONS, lambda s: {"bcs": [s.bcs[0], s.bcs]}),
    "Function as a condition": (CONDITIONS, lambda s: {"bcs": [fem.Function(s.V)]}),
    "None as conditions": (SEQUENCE, lambda s: {"bcs": None}),
    "condition as conditions": (SEQUENCE, lambda s: {"bcs": s.bcs[0]}),
    "complex condition": (
        r"bcs\[1\] must be a Dirichlet condition of type float64.*DirichletBC_complex128",
        lambda s: {"bcs": [s.bcs[0], complex_condition(s)]},
    ),
    "stiffness": ("auto, cholesky, multigrid, found 'lu'", lambda s: {"stiffness": "lu"}),
    "no iterations": (  # PETSc writes beyond the end of an empty array
        "ksp_max_it must be at least 1",
        lambda s: {"stiffness": "multigrid", "petsc_options": {"ksp_max_it": 0}},
    ),
    "options": (
        r"options must be SolverOptions\(...\), found {'rtol'",
        lambda s: {"options": {"rtol": 1e-3}},
    ),
    "class of options": ("options must be SolverOptions", lambda s: {"options": SolverOptions}),
    "petsc_options": (
        "petsc_options must be a mapping .*found 'ksp_rtol'",
        lambda s: {"petsc_options": "ksp_rtol"},
    ),
    "name of an option": (
        "a name in petsc_options must be a string, found 3",
        lambda s: {"petsc_options": {3: 4}},
    ),
    "prefix": (
        "petsc_options_prefix must be a string, found 3",
        lambda s: {"petsc_options_prefix": 3},
    ),
    "hyphen": ("no leading hyphen, found '-mine_'", lambda s: {"petsc_options_prefix": "-mine_"}),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_problem_refuses(scene, name):
    """The error of the constructor says what was found, on every rank."""
    message, arguments = REFUSED[name]
    refused(scene, message, **arguments(scene))


def unknown_facet_tags(scene):
    """Return what is given for tags of facets, and is none."""
    yield from (None, 3, [22], "facet_tags")
    yield TaggedMesh(scene.mesh, scene.cell_tags, scene.facet_tags, scene.tags)


def test_what_a_pair_refuses(scene):
    """The error says which argument is wrong, what was found and what is wanted."""
    floats = dolfinx.mesh.meshtags(scene.mesh, 2, np.zeros(0, dtype=np.int32), np.zeros(0))
    wrong = [
        ({"pairing": "node"}, "pairing must be one of auto, nodes, mortar, found 'node'"),
        ({"pairing": np.array(["auto", "nodes"])}, "pairing must be one of .*found array"),
        *(
            ({"search_distance": value}, f"search_distance must be a positive number, found {text}")
            for value, text in ((0.0, r"0\.0"), (-1, "-1"), (np.nan, "nan"), ("far", "'far'"))
        ),
        ({"friction": 0.3}, r"Tresca\(0\.1\), Coulomb\(0\.3\), Frictionless.*found 0\.3"),
        ({"friction": Bonded}, "friction must be a law"),
        ({"secondary": 2**40}, "integer tag of a surface, .*found 1099511627776"),
        ({"primary": -(2**40)}, "integer tag of a surface, .*or a RigidObstacle"),
        *(
            ({"secondary": tag}, r"integer tag of a surface.*read_gmsh")
            for tag in ("upper_contact", 22.0, None, True)
        ),
        *(
            ({"facet_tags": tags}, r"facet_tags must be dolfinx\.mesh\.MeshTags .*, found")
            for tags in unknown_facet_tags(scene)
        ),
        ({"facet_tags": floats}, "of type int32, .*found .*MeshTags_float64"),
    ]
    for changes, message in wrong:
        with pytest.raises(InputError, match=message):
            pair_with(scene, **changes)


def test_what_a_slip_bound_refuses(scene):
    """Bounds are real numbers at nodes."""
    mesh, vector = scene.mesh, fem.Function(scene.V)
    constant = fem.Constant(mesh, 0.1 + 0j)
    continuous = fem.functionspace(mesh, ("Lagrange", 1))
    p = fem.Function(continuous)

    def on(element) -> fem.Function:
        return fem.Function(fem.functionspace(mesh, element))

    groups = {
        r"scalar, found shape \(3,\)": (*(fem.Constant(mesh, np.zeros(3)), vector, 2.0 * vector),),
        r"slip bound must be a number, .*points, found": (
            *("0.1", None, 0.1j, float, fem.Function, np.ones(5), [0.1, 0.2]),
        ),
        r"no value at nodes, since .* is not continuous.*continuous space": (
            *(on(("DG", 0)), on(("DG", 1)), on(("CR", 1)), 2.0 * on(("DG", 0)) + 1.0),
            on(basix.ufl.quadrature_element(mesh.basix_cell(), degree=2)),
            *(p.dx(0), abs(ufl.FacetNormal(mesh)[0]), 0.1 * ufl.CellDiameter(mesh)),
        ),
        "must not depend on a trial or test function": (ufl.TrialFunction(scene.V)[2],),
        "float64, found complex128": (
            *(constant, 2.0 * constant, fem.Function(continuous, dtype=np.complex128)),
        ),
    }
    for message, bounds in groups.items():
        for bound in bounds:
            with pytest.raises(InputError, match=message):
                Tresca(bound)


@pytest.mark.parametrize("kind", ["constant", "expression", "function"])
@pytest.mark.parametrize(("value", "text"), [(-0.5, "-0.5"), (np.nan, "nan"), (-np.inf, "-inf")])
def test_values_that_are_no_slip_bounds(scene, value, text, kind):
    """A number takes no solve to tell; what may change is told by the solve, and may be mended."""
    with pytest.raises(InputError, match=f"must (not )?be .*, found {text}"):
        scene.problem(pairs=[pair_with(scene, friction=Tresca(value))])
    Q = fem.functionspace(scene.mesh, ("Lagrange", 1))
    constant, everywhere = fem.Constant(scene.mesh, value), fem.Function(Q)
    at_one_node = fem.Function(Q)  # which is on one rank
    bound, number = {
        "constant": (constant, ""),
        "expression": (1.0 * everywhere, ""),
        "function": (at_one_node, " *.*1 of the"),
    }[kind]

    def change(bound):
        constant.value = everywhere.x.array[:] = bound
        at_one_node.interpolate(
            lambda x: np.where(np.isclose(x.T, (0, 0, 1)).all(axis=1), bound, 0.1)
        )

    change(value)
    with scene.problem(pairs=[pair_with(scene, friction=Tresca(bound))]) as problem:
        with pytest.raises(InputError, match=f"slip bound .*found {text}{number}"):
            problem.solve(rtol=1e-6)
        change(0.1)
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "newton"}, "method must be one of projected_newton, .*'newton'"),
        ({"method": ["x"]}, "method"),
        ({"rtol": 0.0}, r"rtol must be a number in \(0, 1\), found 0\.0"),
        ({"rtol": np.nan}, "rtol .*nan"),
        ({"rtol": 1.0}, r"rtol .*1\.0"),
        ({"rtol": "a"}, "rtol"),
        ({"max_iterations": 0}, "max_iterations must be a positive integer, found 0"),
        ({"max_iterations": 2.5}, "max_iterations"),
        ({"rho_sigma": 2.0}, r"rho_sigma must be a number in \(0, 2\), found 2\.0"),
        ({"method": "imssn", "rho_sigma": 0.0}, "rho_sigma must be a positive number"),
        ({"method": "imssn", "rho_sigma": np.inf}, "rho_sigma"),
        ({"r_tol": 1.0}, "r_tol"),
        ({"c_fact": 0.0}, "c_fact"),
    ],
)
def test_options_out_of_range(comm, changes, message):
    """A script may catch errors as ValueError or as ContactError."""
    for kind in (InputError, ValueError, ContactError):
        with pytest.raises(kind, match=message):
            SolverOptions(**changes)
    with two_bricks(comm, 2).problem() as problem, pytest.raises(InputError, match=message):
        problem.solve(**changes)


@pytest.mark.parametrize("pairing", ["auto", "nodes", "mortar"])
def test_surfaces_that_do_not_face_each_other(comm, scene, pairing):
    """The message names both tags and what to check, whatever the pairing."""
    top, lower = scene.tags["upper_top"], scene.tags["lower_contact"]
    pair = pair_with(scene, secondary=top, primary=lower, pairing=pairing)
    message = r"do not face each other.*upper_top.*lower_contact.*Check the tags\."
    refused(scene, message, PairingError, pairs=[pair])
    apart = two_bricks(comm, 3, Offset=0.2)
    message = r"do not face each other.*within 0\.1\. Check the tags and the search distance"
    pair = pair_with(apart, pairing=pairing, search_distance=0.1)
    refused(apart, message, PairingError, pairs=[pair])
    pair = pair_with(apart, pairing=pairing, search_distance=0.3)
    with apart.problem(pairs=[pair]) as problem:
        assert problem.contact_nodes == 9


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


def test_a_bound_that_is_bad_away_from_the_contact_does_no_harm(scene):
    def values(x):
        return np.where(x[2] > 1.4, np.nan, 0.1)

    with scene.problem(pairs=[pair_with(scene, friction=Tresca(values))]) as problem:
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


#: What a function of n points returns, and what the message says of it.
RETURNED = {
    "none": (lambda n: None, "None"),
    "text": (lambda n: "a", "a"),
    "too few": (lambda n: np.full(2, 0.1), r"shape \(2,\) of float64"),
    "a column": (lambda n: np.full((n, 1), 0.1), r"shape \(\d+, 1\) of float64"),
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


def test_a_bound_on_another_mesh(comm, scene):
    other = node_function(two_bricks(comm, 3).mesh, lambda x: np.full(x.shape[1], 0.1))
    for bound, kind in ((other, "a Function"), (0.3 * other, "an expression")):
        message = f"is {kind} on another mesh"
        refused(scene, message, pairs=[pair_with(scene, friction=Tresca(bound))])


def test_complex_petsc(scene, monkeypatch):
    monkeypatch.setattr(compat, "PETSc", SimpleNamespace(ScalarType=np.complex128))
    refused(scene, "real scalars, found complex128", ContactError)


def test_the_same_surfaces_in_two_pairs(scene):
    swapped = pair_with(scene, secondary=scene.pair.primary, primary=scene.pair.secondary)
    both = [scene.pair.secondary, scene.pair.primary]
    listed = pair_with(scene, secondary=both, primary=both)
    for pairs in ([scene.pair, scene.pair], [scene.pair, swapped], [scene.pair, listed]):
        with pytest.raises(InputError, match="two pairs are between the surfaces"):
            ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs)


def test_pairs_on_tags_that_use_the_same_numbers(scene):
    """Two MeshTags may have the same number for different surfaces, which are then two pairs."""
    tags, ends = scene.facet_tags, [scene.tags["lower_free_end"], scene.tags["upper_free_end"]]
    values = np.where(tags.values == ends[1], ends[0], 99).astype(np.int32)
    renumbered = dolfinx.mesh.meshtags(scene.mesh, tags.dim, tags.indices, values)
    around = RigidSphere(center=(1, 0.5, 1), radius=3, hollow=True)
    gaps = []
    for surfaces in ([(tags, ends[0]), (tags, ends[1])], [(tags, ends[0]), (renumbered, ends[0])]):
        pairs = [ContactPair(*surface, around, Frictionless()) for surface in surfaces]
        with ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs) as problem:
            gaps.append([fields.gap.x.array for fields in problem.solve().surfaces])
    for of_ends, of_numbers in zip(*gaps, strict=True):
        np.testing.assert_array_equal(of_ends, of_numbers)


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
        refused(scene, f"type float64, found {found}", **{name: wrong})
    # why, the first rank says, which compiles
    why = ".*complex" if scene.V.mesh.comm.rank == 0 else ""
    refused(scene, f"the form {name} cannot be compiled: {why}", **{name: (1 + 1j) * form})
    for wrong in (0, 3, "x", [form]):
        refused(scene, f"{name} must be a UFL form, .*V=, found", **{name: wrong})
    if name == "L":
        refused(scene, "L must be a UFL form, None for no load, or .* found 0", L=0)
