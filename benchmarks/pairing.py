"""Time and memory of pairing two surfaces, by their size and the number of ranks.

    tools/fenicsx python3 benchmarks/pairing.py --facets 1000 10000 100000 --json FILE
    tools/fenicsx python3 benchmarks/pairing.py --facets 25000 --ranks 1 2 --count-bytes --json FILE

Two plates, one cell thick, lie on each other; their meshes do not match, and with --wave both
surfaces are wavy. Each row has the number of facets of the secondary side (triangles; the primary
side has about as many), and the seconds and memory of the whole pairing (N, T and gap from mesh and
tags).

With --count-bytes the plates are paired once more, and `tracemalloc` measures the peak of the bytes
that Python and numpy allocate on each rank during pairing. The bytes and messages that ranks send
each other are counted, too; the largest numbers of any rank are printed. There may be more --ranks
than cores.
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

from dolfinx_tresca import ContactPair, Tresca
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from scenes.boxes import Body, boxes


def plates(comm: MPI.Comm, facets: int, wave: float) -> tuple[Any, Any]:
    """Return the displacement's space, and facet tags between the plates: 1 above and 2 below."""
    divisions = max(2, round(math.sqrt(facets / 2)))
    thickness = 1.0 / divisions

    def wavy(x: np.ndarray) -> np.ndarray:
        height = wave * np.sin(6.0 * x[:, 0]) * np.cos(5.0 * x[:, 1])
        return x + np.stack([0.0 * height, 0.0 * height, height], axis=1)

    bodies = [
        Body((n, 1), [(0.0, 1.0), (0.0, 1.0), ends], move=wavy)
        for n, ends in (
            (divisions, (0.0, thickness)),
            (round(0.93 * divisions) + 1, (-thickness, 0.0)),
        )
    ]
    made = boxes(comm, "tetrahedron", bodies)

    def between(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(x[:, 2]) < 0.2 * thickness)

    return made.V, made.tags((1, [0], between), (2, [1], between))


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield sizes and numbers of ranks."""
    for size, ranks in itertools.product(arguments.facets, arguments.ranks):
        yield {
            "size": size,
            "ranks": ranks,
            "wave": arguments.wave,
            "counted": arguments.count_bytes,
        }


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Pair the surfaces once, and a second time to count bytes. Collective."""
    V, tags = plates(comm, case["size"], case["wave"])
    prescribed = np.zeros(3 * V.dofmap.index_map.size_local, dtype=np.bool_)
    pair = ContactPair(tags, 1, 2, Tresca(0.1), pairing="mortar")
    before = resident_memory(comm)
    comm.barrier()
    start = time.process_time()
    operators = pair_surfaces(V, prescribed, pair)
    comm.barrier()
    seconds = time.process_time() - start
    megabytes = peak_memory(comm) - before
    local = V.mesh.topology.index_map(2).size_local
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
        "rss_mb": megabytes,
    }


def of_ranks(head: str, name: str, reduce: Callable[[list[int]], int], unit: float) -> Column:
    """Return the column of a number counted on each rank: the sum or the maximum by `reduce`."""

    def text(rows: list[Row]) -> str:
        return f"{reduce(rows[-1][name]) / unit:.3g}" if name in rows[-1] else ""

    return Column(head, text)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--facets", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--wave", type=float, default=0.0, help="height of the waves")
    parser.add_argument("--count-bytes", action="store_true", help="pair once more, and count")
    add_ranks(parser)


COUNTED = [
    of_ranks("MB: most of a rank", "bytes", max, 1e6),
    of_ranks("MB: all", "bytes", sum, 1e6),
    of_ranks("MB sent, most", "bytes_sent", max, 1e6),
    of_ranks("messages, most", "messages_sent", max, 1.0),
]


def is_usual(row: Row) -> bool:
    """Return whether the surfaces of a row are flat."""
    return "facets" in row and not row["wave"]


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("size", "ranks", "wave", "counted"),
    cases=cases,
    measure=measure,
    small={"size": 100},
    options=options,
    shown=[
        Column("facets", "{facets}", width=8),
        Column("ranks", "{ranks}"),
        Column("seconds", "{seconds:.2f}"),
        Column("MB", "{rss_mb:.0f}", width=5),
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
