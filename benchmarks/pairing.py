"""Time and memory of pairing two surfaces, by their size and the number of ranks.

    tools/fenicsx python3 benchmarks/pairing.py --facets 1000 10000 100000 --json FILE
    tools/fenicsx python3 benchmarks/pairing.py --facets 25000 --ranks 1 2 --count-bytes --json FILE

Two plates, one cell thick, lie on each other; their meshes do not match, and with --wave both
surfaces are wavy. Each row has the number of facets of the secondary side (triangles; the primary
side has about as many), the seconds and memory of the whole pairing (N, T and gap from mesh and
tags), and the seconds per facet.

With --count-bytes the plates are paired once more, and `tracemalloc` measures the peak of the bytes
that Python and numpy allocate on each rank during pairing. The formula bytes = a owned + b total is
fitted to all ranks and rows, where a rank owns `owned` of the `total` facets of both sides. If
memory scales with the number of ranks, b is zero. The bytes and messages that ranks send each other
are counted, too; the largest numbers of any rank are printed. There may be more --ranks than cores.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table, add_ranks
from harness.memory import peak_bytes, peak_memory, resident_memory, traffic

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, Frictionless, Tresca
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces

#: Corners of the six tetrahedra into which a hexahedron is cut.
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


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield sizes and numbers of ranks."""
    for size, ranks in itertools.product(arguments.facets, arguments.ranks):
        yield {
            "size": size,
            "ranks": ranks,
            "wave": arguments.wave,
            "friction": not arguments.frictionless,
            "counted": arguments.count_bytes,
        }


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Pair the surfaces once, and a second time to count bytes. Collective."""
    mesh, tags = plates(comm, case["size"], case["wave"])
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    prescribed = np.zeros(3 * V.dofmap.index_map.size_local, dtype=np.bool_)
    friction = Tresca(0.1) if case["friction"] else Frictionless()
    pair = ContactPair(tags, 1, 2, friction, pairing="mortar")
    before = resident_memory(comm)
    comm.barrier()
    start = time.process_time()
    operators = pair_surfaces(V, prescribed, pair)
    comm.barrier()
    seconds = time.process_time() - start
    megabytes = peak_memory(comm) - before
    local = mesh.topology.index_map(2).size_local
    number = comm.allreduce(int((tags.find(1) < local).sum()))
    weights = comm.allreduce(float(operators.weights.sum()))
    if not case["wave"] and abs(weights - 1.0) > 1e-9:
        raise RuntimeError(f"the overlap has the area {weights}, not 1")
    counted: Row = {}
    if case["counted"]:
        with traffic() as sent:
            peak = peak_bytes(lambda: pair_surfaces(V, prescribed, pair))
        counted["owned"] = comm.allgather(int((tags.indices < local).sum()))
        counted["bytes"] = comm.allgather(peak)
        for name in ("bytes", "messages", "rounds"):
            counted[f"{name}_sent"] = comm.allgather(getattr(sent, name))
    yield {
        "facets": number,
        **counted,
        "seconds": seconds,
        "microseconds_per_facet": 1e6 * seconds / number,
        "rss_mb": megabytes,
        "kb_per_facet": 1e3 * megabytes / number,
    }


def fitted(rows: list[Row]) -> tuple[float, float]:
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


def summary(rows: list[Row]) -> str:
    """Return the fitted formula of the bytes of a rank; empty if no bytes were counted."""
    counted = [row for row in rows if "bytes" in row]
    if not counted:
        return ""
    a, b = fitted(counted)
    return f"bytes of a rank = {a:.0f} owned + {b:.0f} total facets"


def of_ranks(head: str, name: str, reduce: Callable[[list[int]], int], unit: float) -> Column:
    """Return the column of a number counted on each rank: the sum or the maximum by `reduce`."""

    def text(rows: list[Row]) -> str:
        return f"{reduce(rows[-1][name]) / unit:.3g}" if name in rows[-1] else ""

    return Column(head, text)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--facets", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--wave", type=float, default=0.0, help="height of the waves")
    parser.add_argument("--frictionless", action="store_true", help="no tangential rows")
    parser.add_argument("--count-bytes", action="store_true", help="pair once more, and count")
    add_ranks(parser)


MEGABYTE = 1e6
COUNTED = [
    of_ranks("MB: most of a rank", "bytes", max, MEGABYTE),
    of_ranks("MB: all", "bytes", sum, MEGABYTE),
    of_ranks("MB sent, most", "bytes_sent", max, MEGABYTE),
    of_ranks("messages, most", "messages_sent", max, 1.0),
]


def is_usual(row: Row) -> bool:
    """Return whether the surfaces of a row are flat and have friction."""
    return "facets" in row and not row["wave"] and bool(row["friction"])


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("size", "ranks", "wave", "friction", "counted"),
    cases=cases,
    measure=measure,
    small={"size": 100},
    options=options,
    summary=summary,
    shown=[
        Column("facets", "{facets}", width=8),
        Column("ranks", "{ranks}"),
        Column("seconds", "{seconds:.2f}"),
        Column("us/facet", "{microseconds_per_facet:.0f}"),
        Column("MB", "{rss_mb:.0f}", width=5),
        Column("kB/facet", "{kb_per_facet:.1f}"),
        *COUNTED,
    ],
    tables=[
        Table(
            "pairing",
            [
                Column("facets of the secondary side", "{facets}"),
                Column("seconds", "{seconds:.3g}"),
                Column("memory [MB]", "{rss_mb:.0f}"),
            ],
            chosen=lambda row: is_usual(row) and not row["counted"] and row["ranks"] == 1,
        ),
        Table(
            "pairing_on_ranks",
            [
                Column("facets of the secondary side", "{facets}"),
                Column("ranks", "{ranks}"),
                *COUNTED,
            ],
            chosen=lambda row: is_usual(row) and row["counted"],
            line=["size", "ranks"],
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
