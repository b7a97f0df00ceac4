"""What published cases have in common: their description, and parts of their solves.

    tools/fenicsx python3 benchmarks/published.py --cases plate --sizes 64

solves the case of `plate.py` with the size 64, whose meaning is the `argument` of its `CASE`.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import runpy
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal
from unittest import mock

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary, meshtags

from dolfinx_tresca import ContactPair, ContactProblem, ContactSolution, RigidPlane, read_gmsh
from scenes.elasticity import by_body, elasticity, no_load
from scenes.nodal import gathered, nodal, surface_nodes_of
from scenes.scene import Scene

CHECKOUT = Path(__file__).parents[2]
CASES, DEMOS = CHECKOUT / "yardstick" / "cases", CHECKOUT / "demos"

#: A rigid plane below bodies that rest on the height 0, in 2D.
GROUND = RigidPlane(point=(0.0, 0.0), normal=(0.0, 1.0))

#: Relative residual at which solves end, so small that only errors of the mesh remain.
RTOL = 1e-8


@dataclass(frozen=True)
class Published:
    """The published values of a quantity.

    Attributes:
        low, high: lowest and highest published value.
        text: text in the table.
        source: source of these values; "": they have the source of the case.
    """

    low: float
    high: float
    text: str
    source: str = ""


def number(value: float) -> str:
    """Return a value with five digits."""
    return f"{value:.5g}"


def exactly(value: float) -> Published:
    """Return a single value, such as the value of a formula, as published."""
    return Published(value, value, number(value))


def between(low: float, high: float) -> Published:
    """Return a published range of values."""
    return Published(low, high, f"{number(low)} to {number(high)}")


def by_group(values: Mapping[str, float], rounding: float = 0.0, source: str = "") -> Published:
    """Return the published values of several groups or programs, which were rounded.

    Args:
        values: name of the group -> value.
        rounding: half of the last digit of the values.
        source: see `Published.source`.
    """
    texts = [f"{value:g} ({name})" for name, value in values.items()]
    return Published(
        min(values.values()) - rounding, max(values.values()) + rounding, ", ".join(texts), source
    )


def bodies(
    comm: MPI.Comm,
    file: str | Path,
    young: float | dict[str, float],
    poisson: float,
    degree: int = 2,
    **parameters: Any,
) -> Scene:
    """Return elastic bodies in plane strain, without loads, conditions and pairs. Collective.

    Args:
        comm: communicator of the mesh.
        file: Gmsh's file, with its folder if it is not that of the cases.
        young: Young's modulus, or that of each named body.
        poisson: Poisson's ratio.
        degree: degree of the displacement.
        parameters: parameters of the file.
    """
    read = read_gmsh(CASES / file, comm, **parameters)
    V = fem.functionspace(read.mesh, ("Lagrange", degree, (2,)))
    modulus = by_body(read, young) if isinstance(young, dict) else young
    return Scene(
        V,
        elasticity(V, modulus, poisson),
        no_load(V),
        [],
        [],
        read.facet_tags,
        read.cell_tags,
        read.tags,
        geometry=read.geometry,
    )


def tags_of_sides(mesh: Any, sides: Mapping[int, Callable[[np.ndarray], np.ndarray]]) -> Any:
    """Return facet tags of a mesh: tag -> function that says which points (3, n) are on a side."""
    facets = {tag: locate_entities_boundary(mesh, 1, where) for tag, where in sides.items()}
    numbers = np.concatenate(list(facets.values()))
    values = np.repeat(np.array(list(facets), dtype=np.int32), [len(f) for f in facets.values()])
    order = np.argsort(numbers)
    return meshtags(mesh, 1, numbers[order], values[order])


def measure_on(scene: Scene, name: str) -> Any:
    """Return the measure of a named surface."""
    tags = scene.facet_tags
    return ufl.Measure("ds", scene.mesh, subdomain_data=tags, subdomain_id=scene.tags[name])


def pair_of(scene: Scene, secondary: str, primary: Any, friction: Any) -> ContactPair:
    """Return a pair of two named surfaces, or of a named surface and an obstacle."""
    if isinstance(primary, str):
        primary = scene.tags[primary]
    return ContactPair(scene.facet_tags, scene.tags[secondary], primary, friction)


def next_step(problem: ContactProblem) -> ContactSolution:
    """Solve and accept a load step. Collective.

    Raises:
        ConvergenceError: the solve has failed.
    """
    solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    problem.accept()
    return solution


def along_surface(comm: MPI.Comm, solution: ContactSolution, *names: str) -> list[np.ndarray]:
    """Return the first coordinate of the contact nodes, ascending, and fields there. Collective.

    Args:
        comm: communicator of the mesh.
        solution: the solution.
        names: fields, such as "pressure" or "weights"; of a vector the first component.
    """
    points, fields = surface_nodes_of(solution)
    columns = (fields[name] if fields[name].ndim == 1 else fields[name][:, 0] for name in names)
    x, *values = gathered(comm, points[:, 0], *columns)
    order = np.argsort(x)
    return [x[order], *(value[order] for value in values)]


def displacements(comm: MPI.Comm, solution: ContactSolution) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 2) and displacements (n, 2) of all nodes, in 2D. Collective."""
    u = nodal(solution.u)
    x = solution.u.function_space.tabulate_dof_coordinates()[: len(u), :2]
    places, u = gathered(comm, x, u)
    return places, u


def run_demo(name: str, size: float) -> dict[str, Any]:
    """Run a demo of this size and return its variables. Collective."""
    script = DEMOS / f"demo_{name}.py"
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        contextlib.redirect_stdout(io.StringIO()),
        mock.patch.object(sys, "argv", [script.stem, str(int(size))]),
    ):
        return runpy.run_path(str(script))


def half_ellipse(x: np.ndarray) -> np.ndarray:
    """Return sqrt(1 - x^2) at positions (n,), and zero beyond 1."""
    return np.sqrt(np.maximum(1.0 - np.square(x), 0.0))


def peak_of(x: np.ndarray, pressure: np.ndarray) -> float:
    """Return the peak of the half ellipse that is fitted to the inner half of a contact.

    The fit is used since pressures of single nodes differ from their neighbours if meshes do not
    match.

    Args:
        x: (n,) distances from the middle, divided by the half width of the contact.
        pressure: (n,) pressures at these distances.
    """
    inside = x < 0.5
    _, square = np.polyfit(x[inside] ** 2, pressure[inside] ** 2, 1)
    return float(np.sqrt(square))


@dataclass(frozen=True)
class Result:
    """The solution of a case on one mesh.

    Attributes:
        values: quantity -> value.
        space: the space of the displacement.
        x, y: points of the curve that the picture shows, (n,) each.
    """

    values: Mapping[str, float]
    space: Any
    x: np.ndarray = field(default_factory=lambda: np.zeros(0))
    y: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, kw_only=True)
class Case:
    """A published case: a JSON file that any program can read, and our solve.

    `yardstick/README.md` describes the file, which has these fields, but for `solve`, and further
    ones. Some scripts compute a curve, a `resolution` or `marks` in place of those of the file.

    Attributes:
        title: title in tables and pictures.
        published: quantity -> published value.
        source: whether the values come from a formula, from other programs, or from tests of
            specimens.
        argument: meaning of the size of a mesh.
        sizes: mesh sizes or numbers of cells, from coarse to fine; the ratio of successive sizes is
            constant.
        solve: function from a communicator and a size to the result. Collective.
        order: the power of the cell size with which errors fall in theory.
        resolution: relative error that does not depend on the mesh, such as that of a bisection.
        axes: labels of the picture's axes; None: there is no picture.
        curve: points of the published curve, x and y; None if there is none.
        marks: published points, x and y, in place of a curve.
    """

    title: str
    published: Mapping[str, Published]
    source: Literal["formula", "programs", "experiments"]
    argument: str
    sizes: Sequence[float]
    solve: Callable[[MPI.Comm, float], Result]
    order: float = 2.0
    resolution: float = 0.0
    axes: tuple[str, str] | None = None
    curve: tuple[np.ndarray, np.ndarray] | None = None
    marks: tuple[Sequence[float], Sequence[float]] | None = None

    @classmethod
    def read(
        cls,
        script: str,
        solve: Callable[[MPI.Comm, float], Result],
        *formulas: float,
        **fields: Any,
    ) -> Case:
        """Return the case of a script.

        Args:
            script: path of the script, whose name is that of the JSON file.
            solve: see `solve`.
            formulas: values of the first quantities by the script's formulas, which are compared
                with those of the file.
            fields: further fields, in place of those of the file.

        Raises:
            ValueError: the file has another value than the formula.
        """
        data = json.loads((CASES / Path(script).name).with_suffix(".json").read_text())
        published = data.pop("published")
        for (quantity, value), computed in zip(published.items(), formulas, strict=False):
            if not math.isclose(value, computed, rel_tol=1e-6):
                raise ValueError(f"{data['title']}: {quantity}: {value}, by the formula {computed}")
        published = {quantity: from_json(value) for quantity, value in published.items()}
        used = {name: data[name] for name in data.keys() & cls.__dataclass_fields__.keys()}
        return cls(solve=solve, published=published, **{**used, **fields})

    def named(self, *values: float) -> dict[str, float]:
        """Return the values of the quantities, which are given in their order."""
        return dict(zip(self.published, map(float, values), strict=True))


def from_json(value: Any) -> Published:
    """Return a published value of a JSON file."""
    if not isinstance(value, dict):
        return exactly(value)
    return by_group(**value) if "values" in value else between(**value)
