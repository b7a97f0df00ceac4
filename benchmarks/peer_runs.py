"""One peer on one problem, for benchmarks/peers.py, in a process of its own.

python3 benchmarks/peer_runs.py '{"peer": "fista", "scene": "free_end_1", "N": 8, ...}' FILE
"""

from __future__ import annotations

import gc
import json
import resource
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from mpi4py import MPI

from memory import peak_memory, reset_peak_memory
from peer_solvers import cones, getfem_bricks, gradients, monolithic, package
from peer_solvers.discrete import Answer, natural_residual

from scenes.two_bricks import two_bricks

#: Where a peer judges by something else: its own tolerances to try, the loosest first.
CLARABEL = (1e-6, 1e-8, 1e-10, 1e-12)
SCS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
STEPS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
FORCES = (1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)

#: Parts of the wanted residual to try for methods of the package: those of the paper measure theirs
#: with a larger rho, which makes it smaller.
PARTS = (1.0, 0.7, 0.5, 0.2, 0.1)

#: Part by which the residual may be above what is wanted: it is computed anew.
ROUNDING = 1.001

Solve = Callable[[Any, float], Answer]


def ours(method: str, stiffness: str = "cholesky") -> Solve:
    """Return a method of the package."""
    return partial(package.solve, method=method, stiffness=stiffness)


def peers(rtol: float) -> dict[str, tuple[Solve, tuple[float, ...]]]:
    """Return how each peer solves, and with which tolerances."""
    parts = tuple(part * rtol for part in PARTS)
    return {
        "cholesky": (ours("projected_newton"), parts),
        "multigrid": (ours("projected_newton", "multigrid"), parts),
        "ssn": (ours("ssn"), parts),
        "imssn": (ours("imssn"), parts),
        "gimssn": (ours("gimssn"), parts),
        "monolithic": (monolithic.solve, STEPS),
        "monolithic_classical": (partial(monolithic.solve, classical=True), STEPS),
        "getfem": (getfem_bricks.solve, FORCES),
        "mpgp": (gradients.mpgp, (rtol,)),
        "fista": (gradients.fista, (rtol,)),
        "clarabel_primal": (partial(cones.primal, solver="clarabel"), CLARABEL),
        "clarabel_dual": (partial(cones.dual, solver="clarabel"), CLARABEL),
        "scs_primal": (partial(cones.primal, solver="scs"), SCS),
        "scs_dual": (partial(cones.dual, solver="scs"), SCS),
    }


def main() -> None:
    """Solve, with ever smaller tolerances until the residual is small enough; write the last."""
    task = json.loads(sys.argv[1])
    # beyond this allocations fail before the machine runs dry
    resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # time is up: the process ends
    solve, tolerances = peers(task["rtol"])[task["peer"]]
    comm = MPI.COMM_WORLD
    signal.setitimer(signal.ITIMER_REAL, task["seconds"])
    solve(two_bricks(comm, 4, end=task["scene"]), 1e-2)  # loads what the first run has to load
    signal.setitimer(signal.ITIMER_REAL, 0)
    scene = two_bricks(comm, task["N"], end=task["scene"])
    for tolerance in tolerances:
        if tolerance > task["loosest"] and len(tolerances) > 1:
            continue
        seconds = []
        for _ in range(task["repeats"]):
            gc.collect()
            reset_peak_memory()
            signal.setitimer(signal.ITIMER_REAL, task["seconds"])
            start = time.perf_counter()
            answer = solve(scene, tolerance)
            seconds.append(time.perf_counter() - start)
            signal.setitimer(signal.ITIMER_REAL, 0)
        peak = peak_memory(comm)
        residual = natural_residual(scene, answer)
        reached = residual <= ROUNDING * task["rtol"]
        row = {
            "seconds": median(seconds),
            "repeats": len(seconds),
            **answer.work,
            "tolerance": tolerance,
            "residual": residual,
            "peak_rss_mb": peak,
            "says": answer.note,
            "status": "reached" if reached else "not reached",
        }
        Path(sys.argv[2]).write_text(json.dumps(row))
        if reached:
            break


if __name__ == "__main__":
    main()
