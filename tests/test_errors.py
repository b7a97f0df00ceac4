"""Bad input: a clear error on all ranks, none hangs; the message names what was found."""

from __future__ import annotations

import logging
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from patches import KINDS, patch
from scenes import YOUNG, clamp, elastic_form, pair_of, reassembled, two_bricks

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactError,
    ContactPair,
    ContactProblem,
    ContactStatus,
    InputError,
    PairingError,
    SolverOptions,
    Tresca,
    _compat,
)

pytestmark = pytest.mark.parallel


@pytest.fixture
def scene(comm):
    return two_bricks(comm, 3)


def pair_with(scene, **changes) -> ContactPair:
    arguments = {
        "facet_tags": scene.bricks.facet_tags,
        "secondary": scene.bricks.tags["upper_contact"],
        "primary": scene.bricks.tags["lower_contact"],
        "friction": Tresca(0.1),
        **changes,
    }
    return ContactPair(**arguments)


def refused(scene, message: str, kind: type[Exception] = InputError, **changes) -> None:
    """Check the error of the constructor, on every rank, and that the ranks still agree."""
    with pytest.raises(kind, match=message):
        reassembled(scene, **changes)
    assert isinstance(kind("x"), ContactError)
    comm = scene.V.mesh.comm
    assert comm.allreduce(1) == comm.size


# Pairs


@pytest.mark.parametrize("side", ["secondary", "primary"])
def test_a_wrong_tag(scene, side):
    refused(scene, f"tag 99 .*{side}.*22", pairs=[pair_with(scene, **{side: 99})])


def test_a_tag_of_cells_is_no_tag_of_facets(scene):
    refused(scene, "tag 1 ", pairs=[pair_with(scene, primary=scene.bricks.tags["lower"])])


def test_an_empty_side(scene):
    """Tags that mark no facet at all."""
    none = np.zeros(0, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(scene.bricks.mesh, 2, none, none)
    refused(scene, r"no facet has the tag 22", pairs=[pair_with(scene, facet_tags=tags)])


def test_the_same_tag_twice(scene):
    with pytest.raises(InputError, match="same tag 22"):
        pair_with(scene, primary=22)


def test_friction_that_is_no_law(scene):
    with pytest.raises(InputError, match=r"Tresca\(0\.1\), Frictionless.*found 0\.3"):
        pair_with(scene, friction=0.3)


def test_no_pairs(scene):
    refused(scene, "at least one ContactPair", pairs=[])


def test_cell_tags_in_place_of_facet_tags(scene):
    refused(
        scene,
        "dimension 3.*facets have 2",
        pairs=[pair_with(scene, facet_tags=scene.bricks.cell_tags, secondary=2, primary=1)],
    )


def test_tags_of_another_mesh(comm, scene):
    other = two_bricks(comm, 3)
    refused(scene, "another mesh", pairs=[pair_with(scene, facet_tags=other.bricks.facet_tags)])


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
    ],
)
def test_pairs_with_wrong_arguments(scene, changes, message):
    with pytest.raises(InputError, match=message):
        pair_with(scene, **changes)


def test_surfaces_that_do_not_face_each_other(scene):
    """The message names both tags and what to check, whatever the pairing."""
    top, lower = scene.bricks.tags["upper_top"], scene.bricks.tags["lower_contact"]
    for pairing in ("auto", "nodes", "mortar"):
        pair = pair_with(scene, secondary=top, primary=lower, pairing=pairing)
        message = rf"do not face each other.*tag {top}.*tag {lower}.*Check the tags\."
        refused(scene, message, PairingError, pairs=[pair])


def test_nothing_within_the_search_distance(comm):
    scene = two_bricks(comm, 3, Offset=0.2)
    for pairing in ("auto", "nodes", "mortar"):
        pair = pair_with(scene, pairing=pairing, search_distance=0.1)
        message = r"do not face each other.*within 0\.1\. Check the tags and the search distance"
        refused(scene, message, PairingError, pairs=[pair])
        pair = pair_with(scene, pairing=pairing, search_distance=0.3)
        with reassembled(scene, pairs=[pair]) as problem:
            assert problem.contact_nodes == 9


# Meshes


@pytest.mark.parametrize("kind", KINDS)
def test_duplicated_nodes_are_a_warning(comm, caplog, kind):
    """The upper block is torn along the middle: nodes of its face lie at the place of others."""
    for tear, number in ((None, 0), (lambda x: x[:, 0] > 0.5, 1 if kind in KINDS[:2] else 5)):
        torn = patch(comm, kind, upper=(4, 1), distort=0.0, tear=tear)
        caplog.clear()
        with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"), torn.problem() as problem:
            assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED
        text = " ".join(record.getMessage() for record in caplog.records if "torn" in record.msg)
        if number and comm.rank == 0:
            assert f"tag 1 (secondary side) has {number} nodes at the place of another" in text
            assert "Merge duplicated nodes" in text
        else:
            assert text == ""


@pytest.mark.parametrize("kind", KINDS)
def test_cells_in_mirrored_order_do_no_harm(comm, kind):
    """Normals come from the cells, not from the order of nodes in the file."""
    results = []
    for reverse in (False, True):
        with patch(comm, kind, reverse=reverse).problem() as problem:
            results.append(problem.solve(rtol=1e-8).normal_force)
    assert results[0] == pytest.approx(results[1], rel=1e-6)


# Slip bounds


def bad_bound(scene, bound, message: str, then=None) -> None:
    """Check the error of the solve; `then` mends the bound, and the problem goes on."""
    with reassembled(scene, pairs=[pair_with(scene, friction=Tresca(bound))]) as problem:
        with pytest.raises(InputError, match=message):
            problem.solve(rtol=1e-6)
        if then is not None:
            then()
            assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


VALUES = pytest.mark.parametrize(
    ("value", "text"), [(-0.5, "-0.5"), (np.nan, "nan"), (-np.inf, "-inf")]
)


@VALUES
def test_a_number_that_is_no_slip_bound(value, text):
    with pytest.raises(InputError, match=f"must not be negative, found {text}"):
        Tresca(value)


@VALUES
def test_a_constant_that_is_no_slip_bound(scene, value, text):
    constant = fem.Constant(scene.bricks.mesh, value)

    def mend():
        constant.value = 0.1

    bad_bound(scene, constant, f"slip bound .*found {text}", mend)


@VALUES
def test_a_function_that_is_no_slip_bound_at_one_node(comm, scene, value, text):
    """One node, on one rank."""
    bound = fem.Function(fem.functionspace(scene.bricks.mesh, ("Lagrange", 1)))

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
def test_a_callable_that_gives_no_slip_bound(scene, value, text):
    bad_bound(scene, lambda x: np.full(x.shape[1], value), f"slip bound .*found {text}")


def test_a_bound_that_is_bad_away_from_the_contact_does_no_harm(scene):
    def values(x):
        return np.where(x[2] > 1.4, np.nan, 0.1)

    with reassembled(scene, pairs=[pair_with(scene, friction=Tresca(values))]) as problem:
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED


def test_slip_bounds_of_the_wrong_shape(scene):
    mesh = scene.bricks.mesh
    vector = fem.Function(scene.V)
    for bound, shape in (
        (fem.Constant(mesh, np.zeros(3)), r"\(3,\)"),
        (vector, r"\(3,\)"),
        (np.ones(5), r"\(5,\)"),
        ([0.1, 0.2], r"\(2,\)"),
    ):
        with pytest.raises(InputError, match=f"scalar, found shape {shape}"):
            Tresca(bound)


@pytest.mark.parametrize("bound", ["0.1", None])
def test_slip_bounds_of_the_wrong_type(scene, bound):
    with pytest.raises(ContactError):
        reassembled(scene, pairs=[pair_with(scene, friction=Tresca(bound))]).solve(rtol=1e-6)


@pytest.mark.parametrize("rows", [2, 3])
def test_a_callable_with_the_wrong_shape(scene, rows):
    """Nothing is asked about the words: DOLFINx or the package may find it, but all ranks do."""
    bound = Tresca(lambda x: np.full((rows, x.shape[1]), 0.1))
    with (
        reassembled(scene, pairs=[pair_with(scene, friction=bound)]) as problem,
        pytest.raises((ContactError, RuntimeError, ValueError)),
    ):
        problem.solve(rtol=1e-6)


def test_a_bound_on_another_mesh(comm, scene):
    other = fem.Function(fem.functionspace(two_bricks(comm, 3).bricks.mesh, ("Lagrange", 1)))
    bad_bound(scene, other, "another mesh")


# Forms, spaces, meshes


def test_complex_petsc(scene, monkeypatch):
    monkeypatch.setattr(_compat, "PETSc", SimpleNamespace(ScalarType=np.complex128))
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
    facets = scene.bricks.facet_tags.find(scene.bricks.tags["upper_top"])
    surface = dolfinx.mesh.create_submesh(scene.bricks.mesh, 2, facets)[0]
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
    _, a, L = forms_on(scene.bricks.mesh, ELEMENTS[name])
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
    V = fem.functionspace(scene.bricks.mesh, ("Lagrange", 1, (3,)))
    refused(scene, "different function spaces", a=elastic_form(V, YOUNG))


def test_forms_with_wrong_arguments(scene):
    refused(scene, "found 1 and 1 arguments", a=scene.L)
    refused(scene, "found 2 and 2 arguments", L=scene.a)


def test_a_condition_on_another_space(comm, scene):
    V = fem.functionspace(scene.bricks.mesh, ("Lagrange", 1, (3,)))
    facets = scene.bricks.facet_tags.find(scene.bricks.tags["upper_fixed"])
    other = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, facets), V)
    refused(scene, "condition 1 is on another", bcs=[scene.bcs[0], other])
    refused(scene, "condition 0 is on another", bcs=two_bricks(comm, 3).bcs)


def test_conditions_on_components_are_welcome(scene):
    bcs = [
        clamp(scene, name, component=k) for name in ("upper_fixed", "lower_fixed") for k in range(3)
    ]
    with reassembled(scene, bcs=bcs) as problem, reassembled(scene) as usual:
        q, expected = problem.solve(rtol=1e-6).q[-1], usual.solve(rtol=1e-6).q[-1]
    assert q == pytest.approx(expected, rel=1e-10)


def test_an_unknown_stiffness_method(scene):
    refused(scene, "auto, cholesky or multigrid, found 'lu'", stiffness="lu")


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
        reassembled(two_bricks(comm, 2)) as problem,
        pytest.raises(InputError, match=message),
    ):
        problem.solve(**changes)


def test_an_unknown_option(scene):
    with (
        reassembled(scene) as problem,
        pytest.raises(InputError, match="no field tolerance"),
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
        reassembled(scene, pairs=[pair_with(scene, primary=99)])
    with reassembled(
        scene, pairs=[pair_of(scene.bricks, "upper_contact", "lower_contact")]
    ) as good:
        assert good.solve(rtol=1e-6).status is ContactStatus.CONVERGED
    assert MPI.Comm.Compare(comm, scene.V.mesh.comm) in (MPI.IDENT, MPI.CONGRUENT)


def test_the_same_surfaces_in_two_pairs(scene):
    swapped = pair_with(scene, secondary=scene.pair.primary, primary=scene.pair.secondary)
    for pairs in ([scene.pair, scene.pair], [scene.pair, swapped]):
        with pytest.raises(InputError, match="two pairs are between the surfaces"):
            ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs)


def test_a_pair_that_is_no_list(scene):
    with pytest.raises(InputError, match=r"\[pair\]"):
        ContactProblem(scene.a, scene.L, scene.pair, bcs=scene.bcs)
    with pytest.raises(InputError, match="ContactPair objects, found 3"):
        ContactProblem(scene.a, scene.L, [3], bcs=scene.bcs)


@pytest.mark.parametrize("tag", ["upper_contact", 22.0, None, True])
def test_a_tag_that_is_no_integer(scene, tag):
    with pytest.raises(InputError, match=r"integer tag of a surface.*read_gmsh"):
        pair_with(scene, secondary=tag)


def test_a_discontinuous_slip_bound(scene):
    bound = fem.Function(fem.functionspace(scene.bricks.mesh, ("DG", 0)))
    bad_bound(scene, bound, "discontinuous")


def test_arguments_of_another_kind(scene):
    with pytest.raises(InputError, match="L must be a UFL form, found 0"):
        ContactProblem(scene.a, 0, [scene.pair], bcs=scene.bcs)
    with pytest.raises(InputError, match="bcs must be a sequence"):
        ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs[0])


@pytest.mark.parametrize(
    ("name", "value"), [("rtol", "a"), ("method", ["x"]), ("max_iterations", 2.5)]
)
def test_an_option_of_another_kind(name, value):
    with pytest.raises(InputError, match=name):
        SolverOptions(**{name: value})
