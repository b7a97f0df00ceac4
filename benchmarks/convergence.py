"""How fast displacement, pressure and slip converge: errors and rates on refined meshes.

    tools/fenicsx python3 benchmarks/convergence.py --json FILE --picture FILE

Two blocks of different materials, meshed 2 : 3, are pressed together and slide on each other. Loads
are made such that the exact solution is known and smooth: chosen are pressure, slip and the
displacements of the surfaces, the rest follows from the equations (a manufactured solution), so
there is no reference mesh. Errors are relative: of the displacement in the energy norm, of pressure
and slip in L2 of the contact surface.

What to expect: the multipliers are discontinuous of degree 1 and only constants are exact in them,
so the energy norm converges with h for degree 1 and with h^1.5 at least for degree 2.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table, add_ranks
from harness.figure import new_figure, plain_ticks, save

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, ContactSolution, Tresca
from dolfinx_tresca._base.compat import interpolation_points

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
ERRORS = ("energy", "pressure", "slip")

#: cells along the upper and the lower block, times the size k of a mesh
RATIO = (2, 3)

#: sizes k of the meshes
SIZES = {2: (2, 4, 8, 16, 32), 3: (1, 2, 4)}

# lengths in m, stresses in MPa; upper block, lower block
YOUNG = (1000.0, 3000.0)
POISSON = (0.3, 0.2)

#: tags of facets
UPPER_CONTACT, LOWER_CONTACT, HELD, SIDES = 1, 2, 3, 4

#: degree of quadrature for the smooth functions that are no polynomials
SMOOTH = 6

# each corner of a cube, and six tetrahedra around the diagonal that fill it
CORNERS = [(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)]
TETRAHEDRA = (
    (0, 1, 3, 7), (0, 1, 7, 5), (0, 5, 7, 4), (0, 3, 2, 7), (0, 6, 4, 7), (0, 2, 6, 7),
)  # fmt: skip
TRIANGLES = ((0, 1, 3), (0, 3, 2))


def block(cell: str, cells: Sequence[int], bottom: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points and cells of a block of height 1/2 with unit base and a number of cells."""
    dim = len(cells)
    axes = [np.linspace(0.0, 1.0, n + 1) for n in cells]
    axes[-1] = bottom + 0.5 * axes[-1]
    points = np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], axis=1)
    number = np.arange(len(points)).reshape([n + 1 for n in cells])
    corners = np.stack(
        [
            number[tuple(slice(o, o + n) for o, n in zip(corner, cells, strict=False))].ravel()
            for corner in CORNERS[: 2**dim]
        ],
        axis=1,
    )
    simplices = {"triangle": TRIANGLES, "tetrahedron": TETRAHEDRA}.get(cell)
    if simplices is not None:
        corners = np.concatenate([corners[:, simplex] for simplex in simplices])
    return points, corners


def two_blocks(comm: MPI.Comm, cell: str, divisions: tuple[int, int]) -> Any:
    """Return the mesh with so many cells along the upper and the lower block. Collective.

    The blocks touch at height 0 in their last coordinate.
    """
    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    (x, upper), (y, lower) = (
        block(cell, [n] * (dim - 1) + [math.ceil(n / 2)], bottom)
        for n, bottom in zip(divisions, (0.0, -0.5), strict=True)
    )
    points, cells = np.concatenate([x, y]), np.concatenate([upper, lower + len(x)])
    if comm.rank > 0:
        points, cells = points[:0], cells[:0]
    element = basix.ufl.element("Lagrange", cell, 1, shape=(dim,))
    return dolfinx.mesh.create_mesh(
        comm=comm, cells=cells.astype(np.int64), x=points, e=ufl.Mesh(element)
    )


def facet_tags(mesh: Any) -> Any:
    """Return the tags of all facets on the boundary. Collective."""
    dim = mesh.topology.dim
    for first, second in ((dim - 1, dim), (dim, dim - 1)):
        mesh.topology.create_connectivity(first, second)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(dim - 1, dim)
    cells = to_cell.array[to_cell.offsets[facets]]
    height = dolfinx.mesh.compute_midpoints(mesh, dim - 1, facets)[:, dim - 1]
    above = dolfinx.mesh.compute_midpoints(mesh, dim, cells)[:, dim - 1] > 0.0
    tags = np.full(len(facets), SIDES, dtype=np.int32)
    tags[np.abs(np.abs(height) - 0.5) < 1e-9] = HELD
    touching = np.abs(height) < 1e-9
    tags[touching & above] = UPPER_CONTACT
    tags[touching & ~above] = LOWER_CONTACT
    return dolfinx.mesh.meshtags(mesh, dim - 1, facets, tags)


class Exact:
    """The exact solution in terms of coordinates x: UFL expressions."""

    def __init__(self, x: Any, dim: int) -> None:
        self._x, self._dim = x, dim
        self._along = [x[i] for i in range(dim - 1)]

    @property
    def pressure(self) -> Any:
        """Pressure [MPa], everywhere positive."""
        return 1.0 + 0.2 * sum(ufl.cos(2.0 * x + 1.0) for x in self._along)

    @property
    def bound(self) -> Any:
        """Slip bound [MPa]."""
        return 0.3 + 0.1 * ufl.sin(2.0 * self._along[0])

    @property
    def traction(self) -> list[Any]:
        """Tangential components of lambda_tau [MPa]; everywhere at the bound."""
        if self._dim == 2:
            return [self.bound]
        turn = 0.4 * self._along[0] + 0.6 * self._along[1]
        return [self.bound * ufl.cos(turn), self.bound * ufl.sin(turn)]

    @property
    def slip(self) -> list[Any]:
        """Tangential components of the slip [m]: along the traction."""
        size = 2e-3 * (1.0 + 0.5 * ufl.cos(1.5 * self._along[0] + 0.2))
        return [size * t for t in self.traction]

    def displacement(self, body: int) -> Any:
        """Displacement [m] of the upper (0) or lower (1) body: linear in the height.

        Its slope is such that both bodies have the stress vector of pressure and traction.
        """
        x, last = self._x, self._dim - 1
        mu, lame = lame_constants(YOUNG[body], POISSON[body])
        surface = [
            1e-3 * ufl.sin(1.5 * a + 0.5 * b + 0.3)
            for a, b in zip(self._along, self._along[::-1], strict=True)
        ]
        if body == 0:
            surface = [u + s for u, s in zip(surface, self.slip, strict=True)]
        height = -2e-3 + 5e-4 * sum(ufl.cos(1.8 * a - 0.4) for a in self._along)

        def along(f: Any, i: int) -> Any:
            return ufl.grad(f)[i]

        stretch = sum(along(u, i) for i, u in enumerate(surface))
        rise = -(self.pressure + lame * stretch) / (2 * mu + lame)
        shear = [t / mu - along(height, i) for i, t in enumerate(self.traction)]
        tangential = [u + x[last] * s for u, s in zip(surface, shear, strict=True)]
        return ufl.as_vector([*tangential, height + x[last] * rise])


def lame_constants(young: Any, poisson: Any) -> tuple[Any, Any]:
    """Return mu and lambda [MPa]; in 2D those of plane strain."""
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def stress(u: Any, mu: Any, lame: Any) -> Any:
    """Return the stress [MPa] of a displacement."""
    strain = ufl.sym(ufl.grad(u))
    return 2 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(u.ufl_shape[0])


@dataclass(frozen=True)
class Scene:
    """Forms, conditions and pair, and what to compare with."""

    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pair: ContactPair
    exact: Any  # displacement
    energy: Any  # of a displacement, twice


def blocks_scene(comm: MPI.Comm, cell: str, degree: int, divisions: tuple[int, int]) -> Scene:
    """Return the blocks with the loads of the exact solution. Collective."""
    mesh = two_blocks(comm, cell, divisions)
    tags, dim = facet_tags(mesh), mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    upper = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    upper.interpolate(lambda x: (x[dim - 1] > 0.0).astype(float))

    def of_body(values: Sequence[Any]) -> Any:
        return upper * values[0] + (1 - upper) * values[1]

    mu, lame = lame_constants(of_body(YOUNG), of_body(POISSON))
    found = Exact(ufl.SpatialCoordinate(mesh), dim)
    bodies = [found.displacement(body) for body in (0, 1)]
    exact = of_body(bodies)
    stresses = [
        stress(u, *lame_constants(YOUNG[body], POISSON[body])) for body, u in enumerate(bodies)
    ]

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(stress(u, mu, lame), ufl.grad(v)) * ufl.dx
    metadata = {"quadrature_degree": SMOOTH}
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags, metadata=metadata)
    load = -of_body([ufl.div(s) for s in stresses])
    on_sides = ufl.dot(of_body(stresses), ufl.FacetNormal(mesh))
    L = ufl.inner(load, v) * ufl.dx(metadata=metadata) + ufl.inner(on_sides, v) * ds(SIDES)

    held = fem.Function(V)
    held.interpolate(fem.Expression(exact, interpolation_points(V.element)))
    dofs = fem.locate_dofs_topological(V, dim - 1, tags.find(HELD))
    pair = ContactPair(
        tags,
        UPPER_CONTACT,
        LOWER_CONTACT,
        Tresca(lambda x: 0.3 + 0.1 * np.sin(2.0 * x[0])),
        pairing="mortar",
    )

    def energy(w: Any) -> Any:
        return ufl.inner(stress(w, mu, lame), ufl.grad(w)) * ufl.dx(metadata=metadata)

    return Scene(V, a, L, [fem.dirichletbc(held, dofs)], pair, exact, energy)


def norm(comm: MPI.Comm, form: Any) -> float:
    """Return the root of an integral over all ranks. Collective."""
    return math.sqrt(comm.allreduce(fem.assemble_scalar(fem.form(form))))


def errors_of(scene: Scene, solution: ContactSolution) -> dict[str, float]:
    """Return the relative errors. Collective."""
    comm, surface = scene.V.mesh.comm, solution.surface
    dim = scene.V.mesh.geometry.dim
    exact = Exact(ufl.SpatialCoordinate(surface.mesh), dim)
    slip = ufl.as_vector([*exact.slip, 0.0])
    dx = ufl.Measure("dx", domain=surface.mesh, metadata={"quadrature_degree": SMOOTH})

    def relative(found: Any, wanted: Any) -> float:
        return norm(comm, ufl.inner(found - wanted, found - wanted) * dx) / norm(
            comm, ufl.inner(wanted, wanted) * dx
        )

    energy = norm(comm, scene.energy(solution.u - scene.exact))
    return {
        "energy": energy / norm(comm, scene.energy(scene.exact)),
        "pressure": relative(surface.pressure, exact.pressure),
        "slip": relative(surface.slip, slip),
    }


def measure(comm: MPI.Comm, cell: str, degree: int, k: int) -> dict[str, Any]:
    """Solve on one mesh and return a row of the table, without rates. Collective."""
    scene = blocks_scene(comm, cell, degree, (RATIO[0] * k, RATIO[1] * k))
    start = time.perf_counter()
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        solution = problem.solve(rtol=1e-8)
        seconds = time.perf_counter() - start
        solution.raise_if_failed()
        n, m = problem.free_dofs, problem.contact_nodes
    return {
        "cell": cell,
        "degree": degree,
        "k": k,
        "n": n,
        "m": m,
        "slip_nodes": solution.counts.slip,
        "contact": solution.counts.contact,
        "iterations": solution.iterations,
        "products": solution.products,
        "seconds": seconds,
        **errors_of(scene, solution),
    }


def rates(rows: Sequence[Row], error: str) -> list[float]:
    """Return the rates of an error from each mesh of a family to the next one."""
    return [
        math.log(coarse[error] / fine[error]) / math.log(fine["k"] / coarse["k"])
        for coarse, fine in itertools.pairwise(rows)
    ]


NAMES = {
    "triangle": "triangles",
    "quadrilateral": "quadrilaterals",
    "tetrahedron": "tetrahedra",
    "hexahedron": "hexahedra",
}
TITLES = {
    "energy": "displacement, energy norm",
    "pressure": "contact pressure, L2",
    "slip": "slip, L2",
}
SLOPES = {"energy": (1.0, 1.5), "pressure": (1.0, 1.5), "slip": (1.0, 2.0)}


def draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Save errors over the size of the cells as a picture. On one rank only."""
    from matplotlib.lines import Line2D

    figure, panels = new_figure(3.7, 1, len(ERRORS), sharex=True)
    sizes = np.array([0.5 / max(row["k"] for row in rows), 0.5 / min(row["k"] for row in rows)])
    for panel, error in zip(panels[0], ERRORS, strict=True):
        for cell, degree in dict.fromkeys((row["cell"], row["degree"]) for row in rows):
            own = [row for row in rows if (row["cell"], row["degree"]) == (cell, degree)]
            panel.loglog(
                [0.5 / row["k"] for row in own],
                [row[error] for row in own],
                "o-" if degree == 1 else "s--",
                ms=4,
                lw=1.4,
                color=f"C{CELLS.index(cell)}",
            )
        # below all curves, from the same point
        h = sizes[0] * np.array([1.0, (sizes[1] / sizes[0]) ** 0.75])
        least = 0.35 * min(row[error] for row in rows)
        for slope in SLOPES[error]:
            line = least * (h / h[0]) ** slope
            panel.loglog(h, line, ":", color="grey", lw=1.2)
            name = "$h$" if slope == 1.0 else f"$h^{{{slope:g}}}$"
            panel.annotate(
                name, (h[1], line[1]), (3, 0), textcoords="offset points", color="#404040",
                va="center",
            )  # fmt: skip
        panel.set_title(TITLES[error], fontsize=10)
        panel.set_xlabel("cell size over width of the blocks")
        plain_ticks(panel.xaxis)
    panels[0][0].set_ylabel("relative error")
    handles = [Line2D([], [], color=f"C{CELLS.index(cell)}", lw=2, label=NAMES[cell])
               for cell in CELLS if any(row["cell"] == cell for row in rows)]  # fmt: skip
    for degree, style in ((1, "o-"), (2, "s--")):
        marker, line_style = style[0], style[1:]
        handles.append(
            Line2D([], [], color="black", marker=marker, ls=line_style, ms=4,
                   label=f"degree {degree}")
        )  # fmt: skip
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9
    )
    save(figure, path)


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the families of meshes."""
    for ranks, cell in itertools.product(arguments.ranks, arguments.cells):
        sizes = arguments.sizes or SIZES[2 if cell in ("triangle", "quadrilateral") else 3]
        for degree in arguments.degrees:
            yield {"cell": cell, "degree": degree, "ranks": ranks, "sizes": sizes}


def run(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh of a family. Collective."""
    for k in case["sizes"]:
        yield measure(comm, case["cell"], case["degree"], k)


def last_rate(error: str, degree: int) -> Column:
    """Return the column of a rate between the last two meshes."""
    return Column(
        f"{error}, degree {degree}",
        lambda rows: f"{rates(rows, error)[-1]:.2f}",
        {"degree": degree},
    )


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=CELLS)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("--sizes", type=int, nargs="+", metavar="K", help="instead of the usual")
    add_ranks(parser)


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("cell", "degree", "k", "ranks"),
    cases=cases,
    measure=run,
    options=options,
    draw=draw,
    shown=[
        Column("cell", "{cell}", width=13),
        Column("degree", "{degree}"),
        Column("k", "{k}", width=3),
        Column("n/m", "{n}/{m}", width=12),
        Column("iter/n_A", "{iterations}/{products}"),
        *(Column(error, f"{{{error}:.2e}}", width=8) for error in ERRORS),
    ],
    tables=[
        Table(
            "convergence",
            [
                Column("cells", lambda rows: NAMES[rows[0]["cell"]]),
                *(last_rate(error, degree) for error in ERRORS for degree in (1, 2)),
            ],
            chosen=lambda row: row["ranks"] == 1,
            line=["cell"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
