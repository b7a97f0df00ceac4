"""Time and memory of pairing two surfaces, over their size and the number of ranks.

    tools/fenicsx python3 benchmarks/pairing.py --facets 1000 10000 100000 --json FILE
    tools/fenicsx python3 benchmarks/pairing.py --facets 25000 100000 --ranks 1 2 4 8 --json FILE

Two plates, one cell thick, lie on each other; their meshes do not match, and with --wave both
surfaces are wavy. A row for each size: facets of the secondary side (triangles; the primary side
has about as many), seconds and memory of the whole pairing (N, T and gap from mesh and tags), and
seconds per facet. It runs under mpirun too; the first rank prints and writes.

With --ranks each size is paired on these numbers of ranks, more than cores if need be, and bytes
are counted (`tracemalloc`): the peak on each rank while it pairs, of what Python and numpy
allocate. To all of them bytes = a owned + b total is fitted, where a rank owns `owned` of the
`total` facets of both sides: where memory scales b is nothing. Rows and messages that they send
each other are counted too; the largest of a rank is printed.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from memory import peak_bytes, peak_memory, resident_memory, traffic

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Frictionless, Tresca
from dolfinx_tresca.pairing.choice import pair_surfaces

#: corners of the six tetrahedra of a hexahedron
TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 1, 7, 5], [0, 5, 7, 4],
                       [0, 3, 2, 7], [0, 6, 4, 7], [0, 2, 6, 7]])  # fmt: skip


def plate(divisions: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points and tetrahedra of the plate (0, 1)^2 x (low, high)."""
    n = divisions + 1
    line = np.linspace(0.0, 1.0, n)
    points = np.stack(np.meshgrid([low, high], line, line, indexing="ij"), axis=3)
    number = np.arange(2 * n * n).reshape(2, n, n)
    corners = np.stack(
        [number[k, j : n - 1 + j, i : n - 1 + i].ravel()
         for k in (0, 1) for j in (0, 1) for i in (0, 1)], axis=1,
    )  # fmt: skip
    return points[..., ::-1].reshape(-1, 3), corners[:, TETRAHEDRA].reshape(-1, 4)


def plates(comm: MPI.Comm, facets: int, wave: float) -> tuple[Any, Any]:
    """Return the mesh, and tags of the facets between the plates: 1 above and 2 below."""
    divisions = max(2, round(math.sqrt(facets / 2)))
    points, cells = plate(divisions, 0.0, 1.0 / divisions)
    lower_points, lower_cells = plate(round(0.93 * divisions) + 1, -1.0 / divisions, 0.0)
    cells = np.concatenate([cells, lower_cells + len(points)])
    points = np.concatenate([points, lower_points])
    points[:, 2] += wave * np.sin(6.0 * points[:, 0]) * np.cos(5.0 * points[:, 1])
    if comm.rank > 0:
        points, cells = points[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    mesh = dolfinx.mesh.create_mesh(
        comm=comm, cells=cells.astype(np.int64), x=points, e=ufl.Mesh(element)
    )
    mesh.topology.create_connectivity(2, 3)
    boundary = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    middle = dolfinx.mesh.compute_midpoints(mesh, 2, boundary)
    height = middle[:, 2] - wave * np.sin(6.0 * middle[:, 0]) * np.cos(5.0 * middle[:, 1])
    between = np.abs(height) < 0.2 / divisions
    between &= (np.abs(middle[:, :2] - 0.5) < 0.5 - 0.1 / divisions).all(axis=1)
    mesh.topology.create_connectivity(2, 3)
    to_cell = mesh.topology.connectivity(2, 3)
    facets_between = boundary[between]
    owners = to_cell.array[to_cell.offsets[facets_between]]
    centre = dolfinx.mesh.compute_midpoints(mesh, 3, owners.astype(np.int32))
    centre[:, 2] -= wave * np.sin(6.0 * centre[:, 0]) * np.cos(5.0 * centre[:, 1])
    values = np.where(centre[:, 2] > 0.0, 1, 2).astype(np.int32)
    return mesh, dolfinx.mesh.meshtags(mesh, 2, facets_between, values)


def measure(comm: MPI.Comm, facets: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Pair once. Collective."""
    mesh, tags = plates(comm, facets, arguments.wave)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    prescribed = np.zeros(3 * V.dofmap.index_map.size_local, dtype=np.bool_)
    friction = Frictionless() if arguments.frictionless else Tresca(0.1)
    pair = ContactPair(tags, 1, 2, friction, pairing="mortar")
    before = resident_memory(comm)
    comm.barrier()
    start = time.perf_counter()
    operators = pair_surfaces(V, prescribed, pair)
    comm.barrier()
    seconds = time.perf_counter() - start
    megabytes = peak_memory(comm) - before
    local = mesh.topology.index_map(2).size_local
    number = comm.allreduce(int((tags.find(1) < local).sum()))
    weights = comm.allreduce(float(operators.weights.sum()))
    if not arguments.wave and abs(weights - 1.0) > 1e-9:
        raise RuntimeError(f"the overlap has the area {weights}, not 1")
    counted: dict[str, Any] = {}
    if arguments.count_bytes:
        with traffic() as sent:
            peak = peak_bytes(lambda: pair_surfaces(V, prescribed, pair))
        counted["owned"] = comm.allgather(int((tags.indices < local).sum()))
        counted["bytes"] = comm.allgather(peak)
        for name in ("bytes", "messages", "rounds"):
            counted[f"{name}_sent"] = comm.allgather(getattr(sent, name))
    return {
        "facets": number,
        "ranks": comm.size,
        **counted,
        "seconds": seconds,
        "microseconds_per_facet": 1e6 * seconds / number,
        "rss_mb": megabytes,
        "kb_per_facet": 1e3 * megabytes / number,
    }


def on_ranks(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Pair each size on each number of ranks, in processes of its own; print and return rows."""
    # ranks that wait give way to those that work
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    rows = []
    print("  facets  ranks  seconds  MB: most of a rank      all  sent MB  messages")
    for facets in arguments.facets:
        for ranks in arguments.ranks:
            with tempfile.TemporaryDirectory() as folder:
                result = Path(folder) / "rows.json"
                command = ["mpirun", "--oversubscribe", "-n", str(ranks), sys.executable, __file__,
                           "--facets", str(facets), "--wave", str(arguments.wave),
                           "--count-bytes", "--json", str(result)]  # fmt: skip
                command += ["--frictionless"] * arguments.frictionless
                subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
                rows += json.loads(result.read_text())
            write(rows, arguments)
            row = rows[-1]
            print(
                f"{row['facets']:8d} {ranks:6d} {row['seconds']:8.2f} "
                f"{max(row['bytes']) / 1e6:19.1f} {sum(row['bytes']) / 1e6:8.1f} "
                f"{max(row['bytes_sent']) / 1e6:8.1f} {max(row['messages_sent']):9d}",
                flush=True,
            )
    return rows


def fitted(rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Return a and b [bytes] of bytes = a owned + b total, by least squares of relative errors."""
    terms = [
        (owned, sum(row["owned"]), counted)
        for row in rows
        for owned, counted in zip(row["owned"], row["bytes"], strict=True)
    ]
    owned, total, counted = np.array(terms, dtype=np.float64).T
    matrix = np.column_stack([owned, total]) / counted[:, None]
    a, b = np.linalg.lstsq(matrix, np.ones(len(counted)), rcond=None)[0]
    return float(a), float(b)


def main() -> None:
    """Read the command line, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--facets", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--ranks", type=int, nargs="+", help="numbers of ranks to start")
    parser.add_argument("--wave", type=float, default=0.0, help="height of the waves")
    parser.add_argument("--frictionless", action="store_true", help="no tangential rows")
    parser.add_argument("--count-bytes", action="store_true", help="pair once more, and count")
    parser.add_argument("--json", type=Path, help="where to write the rows")
    arguments = parser.parse_args()
    if arguments.ranks:
        rows = on_ranks(arguments)
        a, b = fitted(rows)
        print(f"bytes of a rank = {a:.0f} owned + {b:.0f} total facets")
    else:
        write(on_this(MPI.COMM_WORLD, arguments), arguments)


def write(rows: list[dict[str, Any]], arguments: argparse.Namespace) -> None:
    """Write rows as JSON, if a file is named, from the first rank."""
    if MPI.COMM_WORLD.rank == 0 and arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


def on_this(comm: MPI.Comm, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Pair each size on the ranks that run already; print and return rows. Collective."""
    rows = []
    measure(comm, 100, arguments)  # loads what the first run would have to load
    for facets in arguments.facets:
        rows.append(measure(comm, facets, arguments))
        if comm.rank == 0:
            if len(rows) == 1:
                print("  facets  seconds  us/facet    MB  kB/facet")
            row = rows[-1]
            print(
                f"{row['facets']:8d} {row['seconds']:8.2f} {row['microseconds_per_facet']:9.0f} "
                f"{row['rss_mb']:5.0f} {row['kb_per_facet']:9.1f}",
                flush=True,
            )
    return rows


if __name__ == "__main__":
    main()
