"""What contact costs: a contact solve beside a linear elastic solve of the same mesh.

    tools/fenicsx python3 benchmarks/cost.py --sizes 16 26 --ranks 1 2 --json FILE --picture FILE

The linear solve is what a user pays anyway: assemble K and f of the two bricks without contact, set
up the solver that the contact solve uses, with the same options (MUMPS, or GAMG with conjugate
gradients to a relative residual of 1e-8), and solve once. The contact solve is everything from
`ContactProblem(...)` to the fields. Both are run in turns, in one process that has loaded
everything before, and medians are taken; the mesh is in neither. `spread` is the larger one of
(slowest - fastest) / median of the two; `ratios` has the ratio of each turn, `ratio_of_fastest`
that of the fastest runs: where a machine is shared that is the better figure.

Accuracy 1e-6 is the relative natural residual (`rtol`). Accuracy 1e-3 is the relative error of the
displacement in the energy norm (`accuracy`), which the solver bounds; `energy_error` is what it is
in truth, against a solution to 1e-8, and `energy_error_bound` the bound.

Memory is the peak (VmHWM, summed over ranks) of two further processes, one with a linear solve and
one with a contact solve alone, counted from after the mesh was made; what is resident by then,
Python and the mesh, is in it.

`over_best`, at the end, is the time of a row over that of the fastest back end with the same scene,
size, ranks and accuracy, and `ratio_best` its time over the fastest linear solve.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

SCENES = ("free_end_1", "free_end_2")
ACCURACIES = ("1e-3", "1e-6")
Row = dict[str, Any]


def run(task: Row, ranks: int, seconds: float) -> Row:
    """Do a task of cost_runs.py in new processes; raise where that fails."""
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": str(max(1, len(os.sched_getaffinity(0)) // ranks)),
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
    }
    mpirun = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    script = str(Path(__file__).with_name("cost_runs.py"))
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        command = [*mpirun, sys.executable, script, json.dumps(task), str(result)]
        try:
            done = subprocess.run(
                command, env=environment, timeout=seconds, capture_output=True, text=True
            )
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"stopped after {seconds:g} seconds") from None
        if done.returncode != 0 or not result.exists():
            lines = [line for line in done.stderr.splitlines() if "Error" in line]
            raise RuntimeError((lines or [f"ended with {done.returncode}"])[-1])
        found: Row = json.loads(result.read_text())
        return found


def measure(task: Row, ranks: int, arguments: argparse.Namespace) -> list[Row]:
    """Return the rows of one scene, size, back end and number of ranks."""
    shown = {
        **{key: task[key] for key in ("scene", "N", "backend")},
        "ranks": ranks,
        "cores": len(os.sched_getaffinity(0)),
        "load_average": os.getloadavg()[0],
    }
    try:
        times = run({**task, "task": "time"}, ranks, arguments.seconds)
        memory: list[float | None] = [None] * (1 + len(times["runs"]))
        if not arguments.no_memory:
            of_linear = {**task, "task": "linear_memory", "backend": times["chosen"]}
            of_contact = {**task, "task": "contact_memory"}
            tasks = [
                of_linear,
                *({**of_contact, "accuracy": accuracy} for accuracy in times["runs"]),
            ]
            memory = [run(one, ranks, arguments.seconds)["mb"] for one in tasks]
    except RuntimeError as error:
        return [
            {**shown, "accuracy": float(accuracy), "status": str(error)}
            for accuracy in arguments.accuracies
        ]
    rows = []
    for (accuracy, found), contact_memory in zip(times["runs"].items(), memory[1:], strict=True):
        linear, contact = found.pop("linear"), found.pop("contact")
        rows.append(
            {
                **shown,
                **{key: times[key] for key in ("n", "m", "chosen", "tight_residual")},
                "accuracy": float(accuracy),
                **found,
                "linear_seconds": median(linear),
                "contact_seconds": median(contact),
                "ratio": median(contact) / median(linear),
                "ratio_of_fastest": min(contact) / min(linear),
                "ratios": [with_it / plain for with_it, plain in zip(contact, linear, strict=True)],
                "linear_rss_mb": memory[0],
                "contact_rss_mb": contact_memory,
                "repeats": len(contact),
                "spread": max((max(t) - min(t)) / median(t) for t in (linear, contact)),
                "status": "ok",
            }
        )
    return rows


def compare(rows: list[Row]) -> None:
    """Add to each row how it compares with the fastest back end of the same scene."""
    for row in rows:
        same = [
            other
            for other in rows
            if "ratio" in other
            and all(other[key] == row[key] for key in ("scene", "N", "ranks", "accuracy"))
        ]
        if "ratio" in row:
            best = min(other["contact_seconds"] for other in same)
            least = min(other["linear_seconds"] for other in same)
            row["over_best"] = row["contact_seconds"] / best
            row["ratio_best"] = row["contact_seconds"] / least


COLUMNS = (
    f"{'scene':<10} {'N':>3} {'n/m':>12} {'backend':<17} {'ranks':>5} {'accuracy':>8} "
    f"{'bound':>7} {'energy':>7} {'linear s':>8} {'contact s':>9} {'ratio':>6} {'spread':>6} "
    f"{'iter/n_A':>8} {'Krylov':>6} {'linear MB':>9} {'contact MB':>10}"
)


def print_row(row: Row) -> None:
    """Print a row of the table."""
    backend = row["backend"]
    if "ratio" not in row:
        print(
            f"{row['scene']:<10} {row['N']:>3} {'':>12} {backend:<17} {row['ranks']:>5} "
            f"{row['accuracy']:>8.0e} {row['status']}",
            flush=True,
        )
        return
    size, work = f"{row['n']}/{row['m']}", f"{row['iterations']}/{row['products']}"
    backend += f" {row['chosen']}" if backend == "auto" else ""
    memory = (
        f"{row['linear_rss_mb']:>9.0f} {row['contact_rss_mb']:>10.0f}"
        if row["linear_rss_mb"] is not None
        else ""
    )
    print(
        f"{row['scene']:<10} {row['N']:>3} {size:>12} {backend:<17} {row['ranks']:>5} "
        f"{row['accuracy']:>8.0e} {row['energy_error_bound']:>7.1e} {row['energy_error']:>7.1e} "
        f"{row['linear_seconds']:>8.2f} {row['contact_seconds']:>9.2f} {row['ratio']:>6.2f} "
        f"{row['spread']:>6.2f} {work:>8} {row['krylov_iterations']:>6} {memory}",
        flush=True,
    )


def draw(path: Path, rows: list[Row]) -> None:
    """Save the ratio over n as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [row for row in rows if "ratio" in row]
    accuracies = sorted({row["accuracy"] for row in rows}, reverse=True)
    figure, panels = plt.subplots(
        1,
        len(accuracies),
        figsize=(4.5 * len(accuracies), 4),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    colours = {"cholesky": "C0", "multigrid": "C1", "auto": "C2"}
    lines = dict(zip(SCENES, ("-", "--"), strict=True))
    for panel, accuracy in zip(panels[0], accuracies, strict=True):
        own = [row for row in rows if row["accuracy"] == accuracy]
        families = dict.fromkeys((row["backend"], row["scene"], row["ranks"]) for row in own)
        for backend, scene, ranks in families:
            points = sorted(
                (row["n"], row["ratio"])
                for row in own
                if (row["backend"], row["scene"], row["ranks"]) == (backend, scene, ranks)
            )
            panel.loglog(
                *zip(*points, strict=True),
                lines[scene],
                marker="os^D"[(ranks - 1) % 4],
                ms=4,
                color=colours[backend],
                label=f"{backend}, {scene}, {ranks} rank{'s' if ranks > 1 else ''}",
            )
        kind = "energy error" if accuracy == 1e-3 else "natural residual"
        panel.set(title=f"{kind} {accuracy:.0e}", xlabel="degrees of freedom")
        panel.axhline(1.0, color="gray", lw=1)
        panel.grid(True, which="both", lw=0.3)
    panels[0][0].set_ylabel("contact solve / linear solve")
    panels[0][-1].legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def available_memory() -> int:
    """Return the bytes that are free now, or no limit."""
    info = Path("/proc/meminfo")
    if not info.exists():
        return -1
    lines = info.read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))


def main() -> None:
    """Read the arguments, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 26, 36], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    backends = ("cholesky", "multigrid", "auto")
    parser.add_argument("--backends", nargs="+", default=list(backends), choices=backends)
    parser.add_argument("--accuracies", nargs="+", default=list(ACCURACIES), choices=ACCURACIES)
    parser.add_argument("--ranks", type=int, nargs="+", default=[1])
    parser.add_argument("--repeats", type=int, default=3, help="turns of linear and contact")
    parser.add_argument("--seconds", type=float, default=7200.0, help="limit for a process")
    parser.add_argument("--no-memory", action="store_true", help="only measure times")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    arguments = parser.parse_args()

    for path in (arguments.json, arguments.picture):  # before the work, not after
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    print(COLUMNS, flush=True)
    rows: list[Row] = []
    for N in arguments.sizes:
        for scene in arguments.scenes:
            for ranks in arguments.ranks:
                for backend in arguments.backends:
                    memory = available_memory()
                    task = {
                        "scene": scene,
                        "N": N,
                        "backend": backend,
                        "accuracies": arguments.accuracies,
                        "repeats": arguments.repeats,
                        "memory": memory // ranks if memory > 0 else -1,
                    }
                    new = measure(task, ranks, arguments)
                    for row in new:
                        print_row(row)
                    rows += new
                    compare(rows)
                    if arguments.json is not None:
                        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")
    for row in rows:
        if row["backend"] == "auto" and "ratio" in row:
            print(
                f"auto: {row['scene']} N={row['N']} ranks={row['ranks']} {row['accuracy']:.0e}: "
                f"{row['chosen']}, {row['over_best']:.2f} times the fastest back end, "
                f"{row['ratio_best']:.1f} times the fastest linear solve"
            )
    if arguments.picture is not None:
        draw(arguments.picture, rows)


if __name__ == "__main__":
    main()
