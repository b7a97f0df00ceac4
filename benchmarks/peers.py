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
is not installed.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from cost import SCENES, available_memory

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
Row = dict[str, Any]


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


def draw(path: Path, rows: list[Row], rtol: float) -> None:
    """Save seconds over n as a picture, of the runs that reached the residual."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [row for row in rows if row["status"] == "reached"]
    scenes = [scene for scene in SCENES if any(row["scene"] == scene for row in rows)]
    figure, panels = plt.subplots(
        1,
        max(1, len(scenes)),
        figsize=(1.5 + 4.5 * len(scenes), 4.5),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for panel, scene in zip(panels[0], scenes, strict=False):
        for i, peer in enumerate(PEERS):
            points = sorted(
                (row["n"], row["seconds"])
                for row in rows
                if (row["scene"], row["peer"]) == (scene, peer)
            )
            if points:
                is_ours = peer in PEERS[:2]
                panel.loglog(
                    *zip(*points, strict=True),
                    "-" if is_ours else "--",
                    marker="os^vD"[i % 5],
                    ms=4,
                    lw=2.5 if is_ours else 1,
                    color=plt.get_cmap("tab20")(i),
                    label=f"{'ours, ' if is_ours else ''}{peer}",
                )
        panel.set(title=f"{scene}, natural residual {rtol:.0e}", xlabel="degrees of freedom")
        panel.grid(True, which="both", lw=0.3)
    panels[0][0].set_ylabel("seconds")
    handles: dict[str, Any] = {}
    for panel in panels[0]:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(handles.values(), handles.keys(), fontsize=7, loc="outside right upper")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Read the arguments, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 26], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--peers", nargs="+", default=list(PEERS), choices=PEERS)
    parser.add_argument("--rtol", type=float, default=1e-6, help="relative natural residual")
    parser.add_argument("--seconds", type=float, default=300.0, help="limit for a run")
    parser.add_argument("--repeats", type=int, default=1, help="runs of which the median is taken")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    arguments = parser.parse_args()

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
                if arguments.json is not None:
                    arguments.json.write_text(json.dumps(rows, indent=1) + "\n")
    if arguments.picture is not None:
        draw(arguments.picture, rows, arguments.rtol)


if __name__ == "__main__":
    main()
