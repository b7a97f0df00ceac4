"""Solve the cases whose forces follow from statics, by this package.

    tools/fenicsx python3 yardstick/dolfinx_tresca_cases.py > yardstick/answers/dolfinx_tresca.json

Its answers to the other cases are in `benchmarks/data`: `benchmarks/published.py` computes them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    ContactSolution,
    Coulomb,
    RigidCylinder,
    __version__,
    read_gmsh,
)

CASES = Path(__file__).with_name("cases")

#: Relative residual at which solves end.
RTOL = 1e-10


def elasticity(V: Any, young: float, poisson: float, axisymmetric: bool = False) -> Any:
    """Return the form of elasticity in plane strain, or of a body of revolution (radius first)."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    shear, lame = young / (2 + 2 * poisson), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    radius = ufl.SpatialCoordinate(V.mesh)[0]

    def strain(w: Any) -> Any:
        gradient = ufl.sym(ufl.grad(w))
        hoop = w[0] / radius if axisymmetric else 0.0
        rows = [[gradient[0, 0], gradient[0, 1], 0], [gradient[1, 0], gradient[1, 1], 0]]
        return ufl.as_matrix([*rows, [0, 0, hoop]])

    stress = 2 * shear * strain(u) + lame * ufl.tr(strain(u)) * ufl.Identity(3)
    return ufl.inner(stress, strain(v)) * (2 * np.pi * radius if axisymmetric else 1.0) * ufl.dx


def held(V: Any, facets: np.ndarray, component: int, value: Any = 0.0) -> Any:
    """Return the condition that a component of the displacement has a value on facets."""
    dofs = fem.locate_dofs_topological(V.sub(component), 1, facets)
    return fem.dirichletbc(value, dofs, V.sub(component))


def steps(problem: ContactProblem, moved: Any, values: Any) -> Iterator[ContactSolution]:
    """Set a Constant, solve and accept, for each of the values."""
    for value in values:
        moved.value = value
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        yield solution
        problem.accept()


def dovetail(size: float, swapped: bool = False) -> dict[str, float]:
    """Solve the dovetail with cells of a size; `swapped`: the slot is secondary."""
    read = read_gmsh(CASES / "dovetail.geo", MPI.COMM_SELF, h=size)
    facets, tags = read.facet_tags, read.tags
    V = fem.functionspace(read.mesh, ("Lagrange", 1, (2,)))
    tension = fem.Constant(read.mesh, 0.0)
    ds = ufl.Measure("ds", read.mesh, subdomain_data=facets)
    fixed = [held(V, facets.find(tags["outer"]), k) for k in (0, 1)]
    sides = [tags[name] for name in (("slot", "root") if swapped else ("root", "slot"))]
    problem = ContactProblem(
        elasticity(V, 2e5, 0.3),
        tension * ufl.TestFunction(V)[1] * ds(tags["top"]),
        [ContactPair(facets, *sides, Coulomb(0.3))],
        [*fixed, held(V, facets.find(tags["axis"]), 0)],
    )
    tensions, values = (50.0, 100.0, 60.0, 20.0, 5.0), {}
    for value, solution in zip(tensions, steps(problem, tension, tensions), strict=True):
        force = np.array(solution.pair_resultants[0].force) * (-1 if swapped else 1)
        normal, friction = force @ [-1, -1] / np.sqrt(2), force @ [1, -1] / np.sqrt(2)
        values[f"{value:g} MPa: normal force over the pull"] = normal / (4 * value)
        values[f"{value:g} MPa: friction over normal force"] = friction / normal
    return {name: values[name] for name in values if name.startswith(("100 MPa", "5 MPa"))}


def taper(size: float) -> dict[str, float]:
    """Solve the taper lock with cells of a size."""
    read = read_gmsh(CASES / "taper.geo", MPI.COMM_SELF, h=size)
    facets, tags = read.facet_tags, read.tags
    V = fem.functionspace(read.mesh, ("Lagrange", 2, (2,)))
    place = fem.Constant(read.mesh, 0.0)
    pushed = held(V, facets.find(tags["hub_bottom"]), 1, place)
    problem = ContactProblem(
        elasticity(V, 2.1e5, 0.3, axisymmetric=True),
        None,
        [ContactPair(facets, tags["hub_cone"], tags["shaft_cone"], Coulomb(0.15))],
        [held(V, facets.find(tags["shaft_bottom"]), 1), pushed],
        axisymmetric=True,
    )
    places, values = (-0.1, -0.2, -0.15, -0.05), {}
    for value, solution in zip(places, steps(problem, place, places), strict=True):
        ratio = problem.reaction(pushed).force[1] / solution.normal_force
        values[f"at {value:g} mm: axial over normal force"] = ratio
    return {name: values[name] for name in list(values)[1::2]}


def belt(cells: int) -> dict[str, float]:
    """Solve the belt on the drum with a number of cells along it."""
    radius, thickness, angle = 10.0, 0.2, np.radians(120)
    corners = [(0.0, 0.0), (1.0, 1.0)]
    body = mesh.create_rectangle(MPI.COMM_SELF, corners, (cells, 2), mesh.CellType.quadrilateral)
    sides = [(1, 0.0), (0, 0.0), (0, 1.0)]  # on the drum, pulled, free
    facets = [
        mesh.locate_entities_boundary(body, 1, lambda x, k=k, at=at: np.isclose(x[k], at))
        for k, at in sides
    ]
    numbers = np.concatenate(facets)
    marks = np.repeat(np.array([1, 2, 3], dtype=np.int32), list(map(len, facets)))
    order = np.argsort(numbers)
    tags = mesh.meshtags(body, 1, numbers[order], marks[order])
    x = body.geometry.x
    turned, away = 0.5 * np.pi + angle * x[:, 0], radius + thickness * x[:, 1]
    x[:, 0], x[:, 1] = away * np.cos(turned), away * np.sin(turned)
    V = fem.functionspace(body, ("Lagrange", 2, (2,)))
    place = fem.Constant(body, 0.0)
    pulled = held(V, facets[1], 0, place)
    end = 0.5 * np.pi + angle
    along = ufl.as_vector([-np.sin(end), np.cos(end)])
    ds = ufl.Measure("ds", body, subdomain_data=tags)
    drum = RigidCylinder((0, 0, 0), (0, 0, 1), radius)
    problem = ContactProblem(
        elasticity(V, 1e3, 0.0),
        fem.Constant(body, 1.0) * ufl.dot(along, ufl.TestFunction(V)) * ds(3),
        [ContactPair(tags, 1, drum, Coulomb(0.3))],
        [pulled],
    )
    name = "force of the pulled over that of the free end"
    _, forwards, backwards = (
        problem.reaction(pulled).force[0] / thickness
        for _ in steps(problem, place, (0.0, 0.02, 0.0))
    )
    return {f"at 0.02: {name}": forwards, f"at 0 again: {name}": backwards}


def main() -> None:
    """Print the answers, on the meshes that the cases name."""
    lines = [
        json.dumps({"case": case.__name__, "size": size, "quantity": name, "value": float(value)})
        for case in (belt, dovetail, taper)
        for size in json.loads((CASES / f"{case.__name__}.json").read_text())["sizes"]
        for name, value in case(size).items()
    ]
    print(f'{{\n "program": "dolfinx_tresca {__version__}",\n "rows": [')
    print(",\n".join("  " + line for line in lines), "\n ]\n}", sep="")


if __name__ == "__main__":
    main()
