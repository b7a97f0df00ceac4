"""Contact with Tresca friction by other means: the two bricks, the same discrete problem for all.

    tools/fenicsx python3 benchmarks/peers.py --sizes 8 16 --json FILE --picture FILE

Every peer starts from mesh, forms or their data and ends with displacement and multipliers;
`seconds` has its assembly, factorisations and products with A = B K^-1 B'. All answers are judged
by the same relative natural residual, which our own code computes from the peer's multipliers
after the clock has stopped. A peer that ends by a criterion of its own is given the loosest
tolerance of a few that brings that residual to 1e-6; only that last run is counted. Each run is a
process of its own that has solved a tiny problem before.

    cholesky, multigrid     this package, projected Newton with K factored or with multigrid
    ssn, imssn, gimssn      the algorithms of the paper, in this package; K factored
    monolithic              semismooth Newton on (u, lambda), a sparse LU factorisation (MUMPS) each
                            step; derivative of Hueeber, Stadler, Wohlmuth
    monolithic_classical    the same with that of Alart and Curnier
    getfem                  GetFEM (Debian: python3-getfem), its own assembly and Newton method
    mpgp                    Dostal's modified proportioning with gradient projections; K factored
    fista                   accelerated projected gradients with restarts; K factored
    clarabel_*, scs_*       cone programs: primal, sparse in (u, bounds of slips), or dual, with
                            the dense A (a product for each multiplier, many at once); PyPI

A peer that takes more than --seconds is stopped, and skipped for larger meshes; so is one that
is not installed. `--from FILE --picture FILE` draws what was measured before.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from cost import SCENES, available_memory
from kept import Row, add_files, keep, new_figure, plain_ticks, redraw, save

PEERS = (
    "cholesky",
    "multigrid",
    "ssn",
    "imssn",
    "gimssn",
    "monolithic",
    "monolithic_classical",
    "getfem",
    "mpgp",
    "fista",
    "clarabel_primal",
    "clarabel_dual",
    "scs_primal",
    "scs_dual",
)


def run(row: Row, before: list[Row], arguments: argparse.Namespace) -> Row:
    """Run a peer in a process of its own and return what it found.

    Tolerances that were far too loose on smaller meshes, whose rows are `before`, are left out.
    """
    task = {
        **row,
        "rtol": arguments.rtol,
        "seconds": arguments.seconds,
        "repeats": arguments.repeats,
        "loosest": 100.0 * min([row["tolerance"] for row in before] or [1.0]),
        "memory": available_memory(),
    }
    environment = dict(os.environ)
    environment.setdefault("OMP_NUM_THREADS", str(len(os.sched_getaffinity(0))))
    script = str(Path(__file__).with_name("peer_runs.py"))
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        done = subprocess.run(
            [sys.executable, script, json.dumps(task), str(result)],
            env=environment,
            capture_output=True,
            text=True,
        )
        found: Row = json.loads(result.read_text()) if result.exists() else {}
    if done.returncode == -signal.SIGALRM:
        found["status"] = f"stopped after {arguments.seconds:g} s"
    elif done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if "Error" in line]
        found["status"] = (lines or [f"ended with {done.returncode}"])[-1].replace(
            "ModuleNotFoundError", "skipped"
        )
    return found


COLUMNS = (
    f"{'scene':<10} {'N':>3} {'n':>7} {'peer':<20} {'seconds':>8} {'iter':>6} {'products':>8} "
    f"{'factor':>6} {'residual':>8} {'MB':>6} status"
)


def print_row(row: Row) -> None:
    """Print a row of the table."""
    start = f"{row['scene']:<10} {row['N']:>3} {row['n']:>7} {row['peer']:<20} "
    middle = " " * 47
    if "seconds" in row:
        middle = (
            f"{row['seconds']:>8.2f} {row['iterations']:>6} {row.get('products', ''):>8} "
            f"{row.get('factorisations', ''):>6} {row['residual']:>8.1e} "
            f"{row['peak_rss_mb']:>6.0f}"
        )
    krylov = f", {row['Krylov']} Krylov iterations" if "Krylov" in row else ""
    print(f"{start}{middle} {row['status']}{krylov}", flush=True)


#: What each peer is called in the picture.
NAMES = {
    "cholesky": "dolfinx_tresca, Cholesky",
    "multigrid": "dolfinx_tresca, multigrid",
    "ssn": "SSN of the paper",
    "imssn": "IMSSN of the paper",
    "gimssn": "GIMSSN of the paper",
    "monolithic": "monolithic Newton (Hüeber, Stadler, Wohlmuth)",
    "monolithic_classical": "monolithic Newton (Alart, Curnier)",
    "getfem": "GetFEM",
    "mpgp": "MPGP (Dostál)",
    "fista": "accelerated projected gradients",
    "clarabel_primal": "Clarabel, primal cone program",
    "clarabel_dual": "Clarabel, dual cone program",
    "scs_primal": "SCS, primal cone program",
    "scs_dual": "SCS, dual cone program",
}
TITLES = {
    "free_end_1": "load on the upper brick: some nodes stick",
    "free_end_2": "load on the lower brick: all nodes slip",
}


def draw(path: Path, rows: list[Row]) -> None:
    """Save seconds as a picture: a line for each peer, a mark for each size of the model."""
    from matplotlib.lines import Line2D

    scenes = [scene for scene in SCENES if any(row["scene"] == scene for row in rows)]
    sizes = sorted({row["n"] for row in rows})
    looks = dict(zip(sizes, itertools.cycle(("#9ecae1", "#3182bd", "#08306b")), strict=False))

    def time(peer: str, n: int, scene: str) -> float | None:
        """Return the seconds; infinite if it was stopped, None if it was not run."""
        own = [r for r in rows if (r["peer"], r["n"], r["scene"]) == (peer, n, scene)]
        if not own:
            return None
        if own[0]["status"] == "reached":
            return float(own[0]["seconds"])
        return math.inf if own[0]["status"].startswith("stopped") else None

    def place(peer: str) -> list[float]:
        """Return what to sort by: the times in the first scene, of the middle size first."""
        middle = sizes[len(sizes) // 2]
        times = [time(peer, n, scenes[0]) for n in (middle, sizes[0])]
        return [math.inf if t is None else t for t in times]

    peers = sorted((peer for peer in PEERS if any(r["peer"] == peer for r in rows)), key=place)
    figure, panels = new_figure(0.9 + 0.27 * len(peers), 1, len(scenes), sharey=True, sharex=True)
    seconds = [row["seconds"] for row in rows if row["status"] == "reached"]
    beyond = 1.6 * max(seconds)
    for panel, scene in zip(panels[0], scenes, strict=True):
        for line, peer in enumerate(peers):
            times = {n: time(peer, n, scene) for n in sizes}
            known = [min(t, beyond) for t in times.values() if t is not None]
            panel.plot([*known], [line] * len(known), color="0.75", lw=1, zorder=1)
            for n, t in times.items():
                if t is not None:
                    panel.plot(
                        min(t, beyond), line, "o" if t < math.inf else ">", color=looks[n], ms=6,
                        clip_on=False,
                    )  # fmt: skip
        panel.set_xscale("log")
        panel.set_title(TITLES[scene], fontsize=10)
        panel.set_xlabel("seconds")
        panel.set_xlim(0.7 * min(seconds), beyond)
        plain_ticks(panel.xaxis)
        panel.grid(axis="x", lw=0.4, color="0.85")
        panel.spines[["top", "right"]].set_visible(False)
    first = panels[0][0]
    first.set_yticks(range(len(peers)), [NAMES[peer] for peer in peers])
    first.invert_yaxis()
    for label, peer in zip(first.get_yticklabels(), peers, strict=True):
        label.set_fontweight("bold" if peer in PEERS[:2] else "normal")
    handles = [
        Line2D([], [], ls="", marker="o", color=look, ms=6, label=f"{n:,} unknowns")
        for n, look in looks.items()
    ]
    handles.append(
        Line2D([], [], ls="", marker=">", color="0.4", ms=6, label="stopped: longer than shown")
    )
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9
    )
    save(figure, path)


def main() -> None:
    """Read the arguments, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 26], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--peers", nargs="+", default=list(PEERS), choices=PEERS)
    parser.add_argument("--rtol", type=float, default=1e-6, help="relative natural residual")
    parser.add_argument("--seconds", type=float, default=300.0, help="limit for a run")
    parser.add_argument("--repeats", type=int, default=1, help="runs of which the median is taken")
    add_files(parser)
    arguments = parser.parse_args()
    if redraw(arguments, draw):
        return

    for path in (arguments.json, arguments.picture):  # before the work, not after
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    print(COLUMNS, flush=True)
    rows: list[Row] = []
    for scene in arguments.scenes:
        for N in sorted(arguments.sizes):
            for peer in arguments.peers:
                before = [row for row in rows if (row["scene"], row["peer"]) == (scene, peer)]
                row = {"peer": peer, "scene": scene, "N": N, "n": 6 * N**3, "m": N**2}
                if any("seconds" not in other for other in before):
                    row["status"] = "skipped: no answer on a smaller mesh"
                else:
                    row.update(run(row, before, arguments))
                print_row(row)
                rows.append(row)
                keep(arguments.json, rows)
    if arguments.picture is not None:
        draw(arguments.picture, rows)


if __name__ == "__main__":
    main()
