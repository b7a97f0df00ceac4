"""The rows of `print(problem)` and `print(solution)`, the report as one HTML page, and versions."""

from __future__ import annotations

import base64
import io
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_tresca._base.parallel import RECENT_WARNINGS, UNBROKEN, reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.forces import BoltForce
from dolfinx_tresca.stiffness.choice import BLAS, loaded_libraries, reference_blas
from dolfinx_tresca.stiffness.system import LinearSystem
from dolfinx_tresca.table import Quantity, Row, Units, abridged, as_html, as_text, with_unit

#: Packages of PETSc that factor or precondition K.
SOLVERS = ("mumps", "cholmod", "superlu_dist", "hypre")

#: Python packages whose versions are printed.
PACKAGES = (
    *("mpi4py", "fenics-ufl", "fenics-basix", "fenics-ffcx"),
    *("numpy", "scipy", "gmsh", "pyvista", "matplotlib"),
)

HEAD = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Contact</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: auto; padding: 1rem; }
th, td { text-align: left; vertical-align: top; padding: 0.1rem 1rem 0.1rem 0; }
div { overflow-x: auto; } img, svg { width: 100%; min-width: 36rem; } svg { max-width: 46rem; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; font-size: 0.8rem; }
text { font-size: 12px; text-anchor: middle; paint-order: stroke; stroke: white; stroke-width: 4; }
</style></head>"""


#: The graph shows forces above this fraction of the largest one. It is left out for more than this
#: number of bodies, whose names would cover each other.
SHOWN_FORCE, MOST_BODIES = 1e-3, 24


@dataclass(frozen=True)
class ProblemSummary:
    """Sizes of a problem, over all ranks, for `print(problem)`.

    Attributes:
        dofs: degrees of freedom of the displacement, and `free_dofs` those that are not prescribed.
        contact_nodes: m; a node on a sharp edge counts once for each of its paired smooth patches.
        size_rows: rows of the printed table with sizes of the whole problem.
        pairs: for each pair a text with name, kind and number of nodes; range of the gap; and law.
    """

    dofs: int
    free_dofs: int
    contact_nodes: int
    size_rows: tuple[Row, ...]
    pairs: tuple[tuple[str, str, Friction], ...]

    @classmethod
    def from_system(
        cls, system: LinearSystem, pairs: Sequence[ContactPair], jump: JumpOperator
    ) -> ProblemSummary:
        """Count cells, unknowns and contact nodes, and find the range of each gap. Collective."""
        mesh, comm, by_pair = system.V.mesh, system.comm, jump.by_pair
        cells = mesh.topology.index_map(mesh.topology.dim).size_global
        own = [int(system.moves.sum()), sum(len(pair.nodes) for pair in jump.pairs)]
        own += [len(rows.nodes) for rows in by_pair]  # pairs of a group share nodes
        free_dofs, contact_nodes, *counts = map(int, reduce_array(comm, own))
        texts = []
        for pair, rows, nodes in zip(pairs, by_pair, counts, strict=True):
            kind = "mortar" if pair.obstacle is None else "obstacle"
            distance, rounding = rows.operators.gap, 1e-12 * rows.operators.sizes
            distance = np.where(np.abs(distance) > rounding, distance, 0.0)
            extremes = distance.min(initial=np.inf), (-distance).min(initial=np.inf)
            least, negated_largest = reduce_array(comm, extremes, MPI.MIN)
            end = f" to {-negated_largest:.3g}" if least != -negated_largest else ""
            gap = f"gap {least:.3g}{end}" if nodes else ""
            counted = f"{nodes} nodes" if nodes else "no node is paired"
            texts.append((f"{pair}, {kind}: {counted}", gap, pair.friction))
        dofs = system.V.dofmap.index_map_bs * system.V.dofmap.index_map.size_global

        cell_kind = mesh.topology.cell_name() + (", axisymmetric" if system.axisymmetric else "")
        count = system.negative_pivots  # the unknowns that are no displacements, as pressures
        beside = f", beside {count} unknowns of other kinds" if count else ""
        size_rows = (
            ("mesh", f"{cells} cells ({cell_kind}), MPI ranks: {comm.size}"),
            ("displacements", f"{dofs}, {free_dofs} of them free{beside}"),
            ("contact nodes", f"{contact_nodes}"),
        )
        return cls(dofs, free_dofs, contact_nodes, size_rows, tuple(texts))

    def rows(self, units: Units | None) -> list[Row]:
        """Return the rows of the printed table: the sizes, then rows of the first pairs."""
        pair_rows = []
        for pair, gap, law in self.pairs:
            gap_text = f"{with_unit(gap, units, 'length')}, " if gap else ""
            pair_rows.append(("  pair", f"{pair}, {gap_text}{law}"))
        return [*self.size_rows, *abridged(pair_rows, "pairs")]


def figures(values: npt.ArrayLike, error: float) -> str:
    """Return the text of a number or vector with as many digits, 1 to 8, as its `error` allows."""
    digits = int(np.clip(np.ceil(-np.log10(max(error, 1e-9))), 1, 8))
    largest, decimals = float(np.abs(values).max()), 0
    if 0.0 < largest < np.inf:
        decimals = digits - 1 - int(np.floor(np.log10(largest)))
    # + 0.0: components that are rounded to zero have no sign
    rounded = [round(float(component), decimals) + 0.0 for component in np.atleast_1d(values)]
    components = f",{UNBROKEN}".join(f"{component:.{digits}g}" for component in rounded)
    return f"({components})" if np.ndim(values) else components


def error_rows(results: Evaluation) -> list[Row]:
    """Return the rows with the errors of the iteration, of slip bounds and of the mesh."""
    touching = results.counts.contact + results.counts.bonded
    kind = "at most" if results.bound_is_rigorous else "about"
    bound = f"{kind} {results.energy_error_bound:.1e} of the solution's norm"
    if results.energy_error_bound == 0.0:
        bound = "zero to rounding"
    elif touching == 0 and results.energy_error_bound >= 1.0:
        return [("energy error", "as large as the solution, which may be zero")]
    elif np.isinf(results.energy_error_bound):
        bound = "not bounded, since constraints are dependent: more than nodes have free directions"
    rows = [("energy error", bound)]
    if results.bound_error > 0.0:
        rows.append(("slip bounds", f"changing by about {results.bound_error:.1e} of the largest"))
    if results.discretisation_error is not None:
        rows.append(("mesh error", f"about {results.discretisation_error:.1e} of it"))
    return rows


def contact_rows(
    results: Evaluation, units: Units | None, bolts: Mapping[str, BoltForce]
) -> list[Row]:
    """Return the rows of the contact: counts of nodes, largest values, forces, and energies.

    Values have the digits that `results.local_error` justifies, energies enough to differ.
    """
    counts, mesh = results.counts, results.u.function_space.mesh
    dim = 3 if results.axisymmetric else mesh.geometry.dim  # 3: forces on whole rings
    # where nothing touches, and the error is as large as the solution, this may be zero: values
    # that may be rounding are shown as zero
    may_be_zero = counts.contact + counts.bonded == 0 and results.energy_error_bound >= 1.0
    scale = 0.0 if may_be_zero else 1.0
    has_friction = any(surface.traction is not None for surface in results.surfaces)
    has_history = any(surface.slip_increment is not surface.slip for surface in results.surfaces)

    def text(value: npt.ArrayLike, quantity: Quantity, error: float = results.local_error) -> str:
        return with_unit(figures(value, error), units, quantity, dim).replace(" ", UNBROKEN)

    # for each pair a text if it opens
    states, openings = results.pair_states, []
    for pair in states:
        is_open = pair.pressed < pair.nodes and scale * pair.opening > 0.0
        openings.append(f", opens by up to {text(pair.opening, 'length')}" if is_open else "")
    open_nodes = counts.nodes - counts.contact - counts.bonded
    pressed, opened = f"{counts.contact}", f"{open_nodes}"
    if has_friction and counts.contact > 0:
        stick = counts.contact_stick
        pressed += f": {stick} stick, {counts.contact - stick} slip"
    if has_friction and open_nodes > counts.idle:
        stick = counts.stick - counts.contact_stick
        opened += f": {stick} stick, {open_nodes - stick - counts.idle} slip"
    if len(states) == 1:
        opened += openings[0]
    rows = [("contact nodes", f"{counts.nodes}"), ("  pressed", pressed), ("  open", opened)]
    if counts.bonded:
        rows.append(("  bonded", f"{counts.bonded}"))
    if counts.undecided:
        why = "of these: at the limit of their state, within the error"
        rows.append(("  undecided", f"{counts.undecided} {why}"))
    rows.append(("peak pressure", text(scale * results.peak_pressure, "stress")))
    if has_friction:
        slip = text(results.greatest_slip, "length")
        if has_history:
            path = text(results.greatest_total_slip, "length")
            slip += f" in this step, {path} along its path"
        rows.append(("greatest slip", slip))
    if has_history:
        step = text(results.dissipation, "energy")
        total = text(results.total_dissipation, "energy")
        rows.append(("dissipation", f"{step} in this step, {total} so far"))
    forces = [text(scale * resultant.force, "force") for resultant in results.pair_resultants]
    normal = f"{text(scale * results.normal_force, 'force')} normal"
    if len(forces) == 1:
        rows.append(("force", f"{normal}, {forces[0]} on the secondary side"))
    else:
        rows.append(("force", f"{normal}; on the secondary side of each pair:"))
        pair_rows = []
        by_pair = zip(results.surfaces, forces, states, openings, strict=True)
        for surface, force, pair, opening in by_pair:
            state = f"{pair.pressed} of {pair.nodes} pressed{opening}"
            pair_rows.append(("", f"{surface.name}: {force}, {state}"))
        rows += abridged(pair_rows, "pairs")
    if len(results.between_bodies) > 1:
        names = results.body_names
        between = [
            ("", f"{names[i]} by {names[j]}: {text(scale * resultant.force, 'force')}")
            for (i, j), resultant in results.between_bodies.items()
        ]
        rows.append(("on bodies", f"{len(between)} pairs of bodies push each other:"))
        rows += abridged(between, "pairs of bodies")
    for name, resultant in results.reactions.items():
        moment = text(scale * resultant.moment, "energy")
        force = text(scale * resultant.force, "force")
        rows.append(("support", f"{name}: {force}, moment {moment}"))
    bolt_rows = [
        ("bolt", f"{name}: {text(bolt.force, 'force')}, change {text(bolt.change, 'force')}")
        for name, bolt in bolts.items()
    ]
    rows += abridged(bolt_rows, "bolts")
    primal, dual = results.primal_energy, results.dual_energy
    # both energies get enough digits to be distinguished
    apart = 0.1 * abs(primal - dual) / (max(abs(primal), abs(dual)) or 1.0)
    energies = [text(energy, "energy", apart) for energy in (primal, dual)]
    rows.append(("energy", f"{energies[0]} primal, {energies[1]} dual"))
    return rows


def page(solution: Any, steps: Sequence[Any], picture: Any) -> str:
    """Return the HTML page of a `ContactSolution` and of earlier load steps; on the first rank.

    The page includes a picture, a `PIL` image, and the text of the script that is running.
    """
    script = Path(getattr(sys.modules["__main__"], "__file__", ""))
    image = io.BytesIO()
    picture.save(image, format="PNG")
    encoded = base64.b64encode(image.getvalue()).decode()
    # a row for each load step, with the bolts and supports of the last step
    bolts, supports = list(solution.bolts), list(solution.reactions)
    table = [["step", "status", "normal force", "peak pressure", "dissipation", *bolts, *supports]]
    for number, step in enumerate([*steps, solution], start=1):
        values = step.normal_force, step.peak_pressure, step.total_dissipation
        row = [str(number), step.status.name, *(f"{value:.5g}" for value in values)]
        row += [f"{step.bolts[name].force:.5g}" if name in step.bolts else "" for name in bolts]
        for name in supports:
            reaction = step.reactions.get(name)
            row.append(figures(reaction.force, step.local_error) if reaction else "")
        table.append(row)
    sections = {
        "Result": as_html(solution._rows()),
        "Picture": f'<img alt="bodies and contact" src="data:image/png;base64,{encoded}">',
        "Forces between bodies": force_graph(solution),
        "Load steps": as_html(table) if steps else "",
        "Problem": as_html(solution.problem_rows),
    }
    texts = {
        "Warnings": "\n\n".join(RECENT_WARNINGS),
        "Versions": environment(),
        "Script": script.read_text(encoding="utf-8") if script.is_file() else "",
    }
    sections |= {title: f"<pre>{escape(text)}</pre>" for title, text in texts.items() if text}
    body = [f"<h2>{title}</h2>\n<div>{html}</div>" for title, html in sections.items() if html]
    title = f"<body><h1>Contact: {solution.status.value}</h1>"
    return "\n".join([HEAD, title, *body, "</body></html>\n"])


def force_graph(solution: Any) -> str:
    """Return an SVG, bodies as dots, forces as lines; "" without forces or for many bodies."""
    names = [*solution.body_names, "rigid obstacles"]
    forces = {bodies: resultant.force for bodies, resultant in solution.between_bodies.items()}
    # the force of obstacles on a body is the whole contact force minus forces of other bodies
    by_obstacles = [np.array(resultant.force) for resultant in solution.body_resultants]
    for (i, j), force in forces.items():
        by_obstacles[i] -= force
        by_obstacles[j] += force
    forces |= {(body, len(names) - 1): force for body, force in enumerate(by_obstacles)}
    lengths = {bodies: float(np.linalg.norm(force)) for bodies, force in forces.items()}
    largest = max(lengths.values())
    lengths = {ends: length for ends, length in lengths.items() if length > SHOWN_FORCE * largest}
    shown = sorted({body for bodies in lengths for body in bodies})
    if not 0 < len(shown) <= MOST_BODIES:
        return ""
    angles = 2.0 * np.pi * np.arange(len(shown)) / len(shown)
    x = dict(zip(shown, 330.0 - 210.0 * np.cos(angles), strict=True))  # in pixels
    y = dict(zip(shown, 190.0 - 150.0 * np.sin(angles), strict=True))
    dim = 3 if solution.axisymmetric else solution.u.function_space.mesh.geometry.dim
    lines, texts = [], []
    for (i, j), length in lengths.items():
        lines.append(
            f'<line x1="{x[i]:.0f}" y1="{y[i]:.0f}" x2="{x[j]:.0f}" y2="{y[j]:.0f}" '
            f'stroke="#7a93a8" stroke-width="{1.0 + 5.0 * length / largest:.1f}"/>'
        )
        label = with_unit(figures(length, solution.local_error), solution.units, "force", dim)
        texts.append((0.7 * x[i] + 0.3 * x[j], 0.7 * y[i] + 0.3 * y[j], label))
    for body in shown:
        lines.append(f'<circle cx="{x[body]:.0f}" cy="{y[body]:.0f}" r="9" fill="#c8553d"/>')
        texts.append((x[body], y[body] + 24.0, names[body]))
    labels = [f'<text x="{a:.0f}" y="{b:.0f}">{escape(text)}</text>' for a, b, text in texts]
    low, high = min(y.values()) - 30.0, max(y.values()) + 40.0
    box = f"0 {low:.0f} 660 {high - low:.0f}"
    return f'<svg viewBox="{box}" role="img">{"".join(lines + labels)}</svg>'


def environment() -> str:
    """Return a table of the versions of all software that solves and pictures use."""
    package, libraries = sys.modules["dolfinx_tresca"], loaded_libraries()
    petsc = ".".join(map(str, PETSc.Sys.getVersion()))
    scalars, indices = np.dtype(PETSc.ScalarType), np.dtype(PETSc.IntType)
    solvers = [name for name in SOLVERS if PETSc.Sys.hasExternalPackage(name)]
    blas = ", ".join(sorted({Path(path).name for path in libraries if BLAS.search(path)}))
    slow = ", the slow reference implementation" if reference_blas(libraries) else ""
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    rows: list[Row] = [
        ("package", f"dolfinx_tresca {package.__version__}, {Path(str(package.__file__)).parent}"),
        ("Python", f"{sys.version.split()[0]}, {sys.executable}"),
        ("machine", f"{platform.platform()}, {os.cpu_count()} processors"),
        ("DOLFINx", f"{dolfinx.__version__}, {Path(str(dolfinx.__file__)).parent}"),
        ("PETSc", f"{petsc}, {scalars} scalars, {indices} indices, with {', '.join(solvers)}"),
        ("MPI", MPI.Get_library_version().splitlines()[0].strip("\0 ")),
        ("BLAS", f"{blas or 'inside PETSc'}{slow}; OMP_NUM_THREADS {threads}"),
    ]
    for name in PACKAGES:
        try:
            rows.append(("", f"{name} {metadata.version(name)}"))
        except metadata.PackageNotFoundError:
            rows.append(("", f"{name}: not installed"))
    try:  # Debian installs VTK without metadata
        core = import_module("vtkmodules.vtkCommonCore")
        rows.append(("", f"VTK {core.vtkVersion.GetVTKVersion()}"))
    except ImportError as error:
        rows.append(("", f"VTK: {error}"))
    return as_text(rows)
