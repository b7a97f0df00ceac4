"""A report of a solution as one HTML page, and the versions of all software for bug reports."""

from __future__ import annotations

import base64
import io
import os
import platform
import sys
from collections.abc import Sequence
from html import escape
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx

from dolfinx_tresca._base.parallel import RECENT_WARNINGS
from dolfinx_tresca.output.summary import significant, vector
from dolfinx_tresca.stiffness.choice import BLAS, loaded_libraries, reference_blas
from dolfinx_tresca.table import Row, as_html, as_text
from dolfinx_tresca.units import with_unit

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


#: The graph shows forces of at least this fraction of the largest one, between at most this number
#: of bodies: the names of more bodies would cover each other.
SHOWN_FORCE, MOST_BODIES = 1e-3, 24


def page(solution: Any, steps: Sequence[Any], picture: Any) -> str:
    """Return the page as text. Not collective.

    Args:
        solution: the `ContactSolution`.
        steps: the solutions of earlier load steps.
        picture: `PIL.Image.Image` of the solution.
    """
    image, script = io.BytesIO(), Path(getattr(sys.modules["__main__"], "__file__", ""))
    picture.save(image, format="PNG")
    encoded = base64.b64encode(image.getvalue()).decode()
    sections = {
        "Result": as_html(solution._rows()),
        "Picture": f'<img alt="bodies and contact" src="data:image/png;base64,{encoded}">',
        "Forces between bodies": force_graph(solution),
        "Load steps": as_html(_rows_of_steps([*steps, solution])) if steps else "",
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


def _rows_of_steps(solutions: Sequence[Any]) -> list[list[str]]:
    """Return a row for each load step, with the bolts and supports of the last one."""
    bolts, supports = list(solutions[-1].bolts), list(solutions[-1].reactions)
    rows = [["step", "status", "normal force", "peak pressure", "dissipation", *bolts, *supports]]
    for number, step in enumerate(solutions, start=1):
        values = [step.normal_force, step.peak_pressure, step.total_dissipation]
        values += [step.bolts[name].force for name in bolts]
        reactions = [step.reactions.get(name) for name in supports]
        texts = [vector(r.force, step.local_error) if r else "" for r in reactions]
        rows.append([str(number), step.status.name, *(f"{x:.5g}" for x in values), *texts])
    return rows


def force_graph(solution: Any) -> str:
    """Return an SVG: bodies as dots, forces between them as lines; "" without forces."""
    names = [*solution.body_names, "rigid obstacles"]
    forces = {bodies: resultant.force for bodies, resultant in solution.between_bodies.items()}
    by_obstacles = [np.array(resultant.force) for resultant in solution.body_resultants]
    for (i, j), force in forces.items():
        by_obstacles[i] -= force
        by_obstacles[j] += force
    forces |= {(body, len(names) - 1): force for body, force in enumerate(by_obstacles)}
    sizes = {bodies: float(np.linalg.norm(force)) for bodies, force in forces.items()}
    largest = max(sizes.values())
    sizes = {bodies: size for bodies, size in sizes.items() if size > SHOWN_FORCE * largest}
    shown = sorted({body for bodies in sizes for body in bodies})
    if not 0 < len(shown) <= MOST_BODIES:
        return ""
    angles = 2.0 * np.pi * np.arange(len(shown)) / len(shown)
    x = dict(zip(shown, 330.0 - 210.0 * np.cos(angles), strict=True))  # in pixels
    y = dict(zip(shown, 190.0 - 150.0 * np.sin(angles), strict=True))
    dim = 3 if solution.axisymmetric else solution.u.function_space.mesh.geometry.dim
    lines, texts = [], []
    for (i, j), size in sizes.items():
        lines.append(
            f'<line x1="{x[i]:.0f}" y1="{y[i]:.0f}" x2="{x[j]:.0f}" y2="{y[j]:.0f}" '
            f'stroke="#7a93a8" stroke-width="{1.0 + 5.0 * size / largest:.1f}"/>'
        )
        label = with_unit(significant(size, solution.local_error), solution.units, "force", dim)
        texts.append((0.7 * x[i] + 0.3 * x[j], 0.7 * y[i] + 0.3 * y[j], label))
    for body in shown:
        lines.append(f'<circle cx="{x[body]:.0f}" cy="{y[body]:.0f}" r="9" fill="#c8553d"/>')
        texts.append((x[body], y[body] + 24.0, names[body]))
    labels = [f'<text x="{a:.0f}" y="{b:.0f}">{escape(text)}</text>' for a, b, text in texts]
    low, high = min(y.values()) - 30.0, max(y.values()) + 40.0
    box = f"0 {low:.0f} 660 {high - low:.0f}"
    return f'<svg viewBox="{box}" role="img">{"".join(lines + labels)}</svg>'


def environment() -> str:
    """Return a table of the versions of all software that a solve uses. Not collective."""
    package, libraries = sys.modules["dolfinx_tresca"], loaded_libraries()
    petsc = ".".join(map(str, PETSc.Sys.getVersion()))
    scalars, indices = np.dtype(PETSc.ScalarType), np.dtype(PETSc.IntType)
    solvers = [name for name in SOLVERS if PETSc.Sys.hasExternalPackage(name)]
    blas = ", ".join(sorted({Path(path).name for path in filter(BLAS.search, libraries)}))
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
