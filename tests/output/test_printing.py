"""What the prompt, notebooks and logs show: units, tables, short lines, short `repr`."""

from __future__ import annotations

import dataclasses
import logging
from html.parser import HTMLParser

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    AdaptiveSolution,
    AdaptiveStatus,
    Bonded,
    ContactPair,
    Coulomb,
    Frictionless,
    GuaranteedError,
    Level,
    NormalForce,
    RigidCylinder,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    TaggedMesh,
    Tresca,
    Units,
    contacts,
)
from dolfinx_tresca._base.parallel import UNBROKEN, fill
from dolfinx_tresca.output.report import figures
from dolfinx_tresca.table import LISTED_ROWS, as_text
from scenes.blocks import BELOW, LEFT, block, floor
from scenes.patches import SIDES, patch
from scenes.two_bricks import bricks_problem, two_bricks

UNITS = Units("mm", "MPa", force="N")


class Cells(HTMLParser):
    """Reads the rows of a table."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        """Begin a row or a cell."""
        if tag == "tr":
            self.rows.append([])
        elif tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_data(self, data):
        """Go on with a cell."""
        if data.strip("\n"):
            self.rows[-1][-1] += data.replace("\xa0", " ")


def body_under(obstacle: RigidObstacle, dim: int, comm):
    """A block that a rigid obstacle holds from below; it is pressed and dragged."""
    return block(comm, (2, 2, 2)[:dim], obstacles=[(1, obstacle)], across=(3,))


# Units


def test_units_are_put_together():
    for units, dim, force, energy in (
        (UNITS, 3, "N", "N mm"),
        (UNITS, 2, "N/mm", "N mm/mm"),
        (Units("m", "Pa"), 3, "Pa m²", "Pa m³"),
        (Units("m", "Pa"), 2, "Pa m", "Pa m²"),
    ):
        assert (units.of("length", dim), units.of("stress", dim)) == (units.length, units.stress)
        assert (units.of("force", dim), units.of("energy", dim)) == (force, energy)


@pytest.mark.parallel
@pytest.mark.parametrize("dim", [2, 3])
def test_units_are_printed_behind_numbers(comm, dim):
    model = body_under(floor(dim), dim, comm)
    with model.problem(units=UNITS) as problem, model.problem() as plain_problem:
        solution, plain = problem.solve(), plain_problem.solve()
    text = str(solution)
    per_thickness = "/mm" if dim == 2 else ""
    for part in (
        f"peak pressure  {figures(solution.peak_pressure, solution.local_error)} MPa\n",
        f"greatest slip  {figures(solution.greatest_slip, solution.local_error)} mm\n",
        f" N{per_thickness} normal, ",
        f" N{per_thickness} on the secondary side\n",
        f" N mm{per_thickness} primal, ",
        f" N mm{per_thickness} dual\n",
    ):
        assert part in text
    assert "gap 0 mm, slip bound 1\n" in str(problem)
    # without them the rest is the same, but for the seconds at the end
    for name in (f" N mm{per_thickness}", f" N{per_thickness}", " MPa", " mm"):
        text = text.replace(name, "")
    assert text.split("\nseconds")[0] == str(plain).split("\nseconds")[0]
    assert str(plain_problem) == str(problem).replace(" mm,", ",")


def test_a_bound_is_printed_as_it_is_now(comm):
    scene = two_bricks(comm, 2)
    bound = fem.Constant(scene.V.mesh, 1.0)
    pair = dataclasses.replace(scene.pair, friction=Tresca(bound))
    with scene.problem(pairs=[pair], units=UNITS) as problem:
        bound.value = 2.0
        assert "slip bound Constant, now 2 solver" in " ".join(str(problem).split())


# Tables


@pytest.mark.parallel
def test_notebooks_show_the_rows_that_print_shows(comm):
    with bricks_problem(comm, 2) as problem:
        for shown in (problem, problem.solve()):
            assert as_text(Cells(shown._repr_html_()).rows) == str(shown)


def test_names_are_escaped_in_notebooks(comm):
    plane = RigidObstacle(lambda x: (x[2], np.tile([[0.0], [0.0], [1.0]], len(x[0]))), "<b>&amp;")
    with body_under(plane, 3, comm).problem() as problem:
        assert "&lt;b&gt;&amp;amp;" in problem._repr_html_() and "<b>" not in problem._repr_html_()
        assert "on <b>&amp;, obstacle" in str(problem)


# Lines


X, Y = 1 / 7, float(np.sqrt(2))

#: Scenes with long names, reasons and numbers.
SCENES = {
    "cylinder": lambda comm: body_under(
        RigidCylinder((X, Y, -10 * Y), (1, X, 0), 9.87654321 * Y), 3, comm
    ),
    "sphere": lambda comm: body_under(RigidSphere((X, -1e6 - X), 1e6), 2, comm),
    "two obstacles": lambda comm: block(
        comm,
        (2, 2, 2),
        obstacles=[(1, floor(3)), (2, RigidPlane((X, X, 1), (0, 0, -1)))],
        held=(3,),
    ),
    "floating": lambda comm: block(comm, (2, 2, 2), load=(0.0, 0.0, -1.0)),
    "mortar": lambda comm: patch(comm, "hexahedron"),
    "bonded": lambda comm: patch(comm, "tetrahedron", friction=Bonded(), search_distance=X),
    "degree 2": lambda comm: patch(comm, "quadrilateral", 2),
}


@pytest.mark.parametrize("name", SCENES)
def test_lines_are_short(comm, caplog, name):
    scene = SCENES[name](comm)
    with (
        caplog.at_level(logging.INFO, logger="dolfinx_tresca"),
        scene.problem(units=Units("mm", "N/mm²")) as problem,
    ):
        solution = problem.solve(rtol=1e-3)
        logged = [record.getMessage() for record in caplog.records]
        for text in (*logged, str(problem), str(solution)):
            assert all(len(line) <= 100 for line in text.splitlines())
    assert len(logged) >= 3 * (comm.rank == 0)


# repr


def test_repr_is_short(comm):
    """Objects that hold solutions, long expressions and many tags have a repr of one line."""
    scene = two_bricks(comm, 4)
    x = ufl.SpatialCoordinate(scene.V.mesh)
    law = Tresca(sum(ufl.sin(i * x[0]) ** 2 for i in range(1, 100)))
    with scene.problem(units=UNITS) as problem:
        solution = problem.solve()
        bricks = TaggedMesh(scene.mesh, scene.cell_tags, scene.facet_tags, scene.tags)
        level = Level(0, bricks, solution, problem.free_dofs, 1 / 3, None, 100, 1 / 3)
        tangent = problem.tangent([scene.data.load], [(0.0, 0.0, 1.0)])
        with problem.record() as tape:
            pass
        for shown in (
            *(problem, problem.operators[0], problem.goal_error(NormalForce()), tape),
            *(solution, solution.surface, tangent, *tangent.surfaces, level),
            *(bricks, scene.pair, law, dataclasses.replace(scene.pair, friction=law)),
            AdaptiveSolution(AdaptiveStatus.REACHED, 1 / 3, (level,)),
            GuaranteedError(1 / 3, 1 / 3, solution.u, *[1 / 3] * 5),
            contacts(bricks, friction=Coulomb(0.3)),
        ):
            assert len(repr(shown)) < 250 and "\n" not in repr(shown)
    assert "12 of 16 contact nodes pressed" in repr(solution)


def test_repr_can_be_had_after_destroy(comm):
    problem = bricks_problem(comm, 2)
    problem.destroy()
    assert repr(problem).startswith("<ContactProblem: ")


def test_vectors_have_the_digits_that_hold():
    for values, error, text in (
        ([13.4567, -0.1234, 0.0001], 3e-3, "(13.5, -0.1, 0)"),
        ([-1e-9, 2.0], 1e-3, "(0, 2)"),
        ([1234.0, -987.0], 0.05, "(1.2e+03, -1e+03)"),
        ([0.0, 0.0], 0.0, "(0, 0)"),
    ):
        assert fill(figures(np.array(values), error)) == text


@pytest.mark.parallel
def test_each_pair_has_a_line_with_its_name_and_force(comm):
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(2, 1), distort=0.0)
    wall = RigidPlane(point=(-9, 0), normal=(1, 0))
    second = ContactPair(scene.facet_tags, SIDES[0], wall, Frictionless(), name="wall")
    with scene.problem(pairs=[scene.pair, second]) as problem:
        solution, table = problem.solve(), str(problem)
    assert "  pair         wall, obstacle" in table
    assert [surface.name for surface in solution.surfaces] == ["tag 1 on tag 2", "wall"]
    for surface, force in zip(solution.surfaces, solution.pair_resultants, strict=True):
        text = figures(force.force, solution.local_error).replace(UNBROKEN, " ")
        assert f"\n{' ' * 15}{surface.name}: {text}, " in str(solution)


def test_of_many_pairs_the_first_are_listed_and_the_others_counted(comm):
    for number, rows in ((LISTED_ROWS, LISTED_ROWS), (20, LISTED_ROWS - 1)):
        walls = [(LEFT, RigidPlane((-9 - i, 0), (1, 0))) for i in range(number - 1)]
        scene = block(comm, (2, 2), obstacles=[(BELOW, floor(2)), *walls])
        with scene.problem() as problem:
            of_problem, of_solution = str(problem), str(problem.solve())
        assert of_problem.count("\n  pair         tag ") == of_solution.count("tag ") == rows
        others = f"and {number - rows} other pairs\n"
        for text in (f"  pair         {others}", f"{' ' * 15}{others}"):
            assert (text in of_problem + of_solution) == (number > rows)


@pytest.mark.parallel
def test_dissipation_is_printed_of_load_steps(comm):
    model = body_under(floor(2), 2, comm)
    with model.problem(units=UNITS) as problem:
        first = problem.solve()
        assert "dissipation" not in str(first)
        problem.accept()
        model.data.load.value[0] *= -1.0
        second = problem.solve()
    error = second.local_error
    assert (
        f"dissipation    {figures(second.dissipation, error)} N mm/mm in this step, "
        f"{figures(second.total_dissipation, error)} N mm/mm so far\n"
    ) in str(second)
