"""Other solvers of contact problems, compared on two bricks, a ball and a press fit.

    tools/fenicsx python3 benchmarks/peers.py --sizes 8 16 --json FILE --picture FILE

All solvers ("peers") get the same discrete problem. Each starts from the mesh, the forms or the
data of the forms, and ends with displacement and multipliers; `seconds` includes its assembly,
factorisations and products with A = B K^-1 B'. All answers are judged by the same relative natural
residual, which our own code computes from the peer's multipliers after the clock has stopped. A
peer with another stopping criterion runs with several tolerances, the loosest first, until this
residual is at most 1e-6; only the last run is counted. With `--error 0.01` the runs of each peer
end instead when the error of the stresses, in L2 of the contact surface, is at most 1 %: users look
at stresses, not at residuals. `press_fit_steps`, a sequence of load steps with history, is judged
in this way only, by the largest error of its steps. Each step starts from the last one; matrices
are assembled once and, by this package, factored once.

The peers are this package, with K factored or with multigrid; the paper's algorithms as implemented
here; semismooth Newton on (u, lambda) with a sparse LU factorisation (MUMPS) in each step, penalty
method and Uzawa's method likewise; GetFEM (Debian: python3-getfem) and scikit-fem (PyPI) with their
own assembly, the latter with SciPy's SuperLU; first-order methods with K factored; and the conic
solvers Clarabel and SCS (PyPI): primal, sparse in (u, bounds of slips), or dual, with the dense A
(a product for each multiplier, many at once). `peer_solvers/` has a file for each kind.

A peer is stopped if a run takes more than --limit seconds, and is then skipped on larger meshes. A
peer that is not installed is skipped, too. GetFEM is installed by

    tools/fenicsx sh -c 'apt-get update && apt-get install -y python3-getfem'
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from harness import DASH, Benchmark, Column, Comm, Row, Table, restart_clock
from harness.figure import new_figure, plain_ticks, save
from harness.memory import peak_memory, reset_peak_memory
from harness.timing import timed
from peer_solvers import (
    cones,
    getfem_bricks,
    gradients,
    monolithic,
    package,
    regularised,
    scikit_fem_bricks,
)
from peer_solvers.discrete import Answer, judge

from dolfinx_tresca import Tresca
from scenes import hertz, press_fit, two_bricks
from scenes.scene import Scene

#: Tolerances to try for peers with stopping criteria of their own, the loosest first.
CLARABEL = (1e-6, 1e-8, 1e-10, 1e-12)
SCS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
STEPS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
FORCES = (1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)

#: Tolerances to try for methods of the package, as parts of the requested residual: the methods of
#: the paper measure the residual with a larger rho, and so find a smaller value.
PARTS = (1.0, 0.7, 0.5, 0.2, 0.1)

#: Factor by which the residual, which is computed anew, may exceed the requested residual.
ROUNDING = 1.001

Solve = Callable[[Any, float], Answer]


def bricks(comm: Comm, N: int, end: str) -> Scene:
    """Return the two bricks of the paper, with Tresca friction. Collective."""
    scene = two_bricks.two_bricks(comm, N, end=end)
    scene.data.modulus = two_bricks.YOUNG
    return scene


def ball(comm: Comm, N: int) -> Scene:
    """Return a ball on a rigid plane, without friction; the contact has N cells. Collective."""
    scene = hertz.sphere_on_plane(comm, h=1.2 / N)
    scene.data.modulus = hertz.YOUNG
    return scene


def fit(comm: Comm, N: int) -> Scene:
    """Return a pin that is pushed out of its hole, with Tresca friction. Collective."""
    scene = press_fit.press_fit(comm, N)
    scene.data.push.value = -PUSH
    scene.data.modulus = press_fit.YOUNG["plate"]
    bound = press_fit.FRICTION * press_fit.lame_pressure()
    return replace(scene, pairs=[replace(scene.pair, friction=Tresca(bound))])


def fit_in_steps(comm: Comm, N: int) -> Scene:
    """Return the same, with the pin pushed out in load steps until it slips, and back. Collective.

    Slip counts from the last step.
    """
    scene = fit(comm, N)
    scene.data.pushes = PUSHES
    return scene


#: Displacement of the pin [mm] at which a part of its surface slips, and load steps.
PUSH, PUSHES = 0.003, press_fit.PUSHES[1:9]

SCENES: dict[str, Callable[[Comm, int], Scene]] = {
    **{end: partial(bricks, end=end) for end in two_bricks.ENDS},
    "ball": ball,
    "press_fit": fit,
    "press_fit_steps": fit_in_steps,
}

#: Peers that start a load step from the last one, and those that have the mesh of the bricks alone.
STEPPING = ("cholesky", "multigrid", "monolithic", "monolithic_classical", "penalty", "augmented")
ON_BRICKS = ("getfem", "scikit_fem")


def ours(method: str, stiffness: str = "cholesky") -> Solve:
    """Return the function that solves by a method of the package."""
    return partial(package.solve, method=method, stiffness=stiffness)


def peers(rtol: float) -> dict[str, tuple[str, Solve, tuple[float, ...]]]:
    """Return name of the peer -> title, function that solves, and tolerances to try."""
    parts = tuple(part * rtol for part in PARTS)
    return {
        "cholesky": ("**ours, Cholesky**", ours("projected_newton"), parts),
        "multigrid": ("**ours, multigrid**", ours("projected_newton", "multigrid"), parts),
        "ssn": ("SSN of the paper", ours("ssn"), parts),
        "imssn": ("IMSSN of the paper", ours("imssn"), parts),
        "gimssn": ("GIMSSN of the paper", ours("gimssn"), parts),
        "monolithic": (
            "monolithic semismooth Newton, Hueeber, Stadler, Wohlmuth",
            monolithic.solve,
            STEPS,
        ),
        "monolithic_classical": (
            "monolithic semismooth Newton, Alart and Curnier",
            partial(monolithic.solve, classical=True),
            STEPS,
        ),
        "penalty": ("penalty method, Newton", regularised.penalty, STEPS),
        "augmented": ("augmented Lagrangians (Uzawa), Newton", regularised.augmented, STEPS),
        "getfem": ("GetFEM, its own assembly and Newton method", getfem_bricks.solve, FORCES),
        "scikit_fem": (
            "scikit-fem's assembly, semismooth Newton in SciPy",
            scikit_fem_bricks.solve,
            STEPS,
        ),
        "mpgp": ("MPGP (Dostal)", gradients.mpgp, (rtol,)),
        "fista": ("accelerated projected gradients (FISTA)", gradients.fista, (rtol,)),
        "clarabel_primal": (
            "Clarabel, primal cone program, sparse",
            partial(cones.primal, solver="clarabel"),
            CLARABEL,
        ),
        "clarabel_dual": (
            "Clarabel, dual cone program, dense A",
            partial(cones.dual, solver="clarabel"),
            CLARABEL,
        ),
        "scs_primal": (
            "SCS, primal cone program, sparse",
            partial(cones.primal, solver="scs"),
            SCS,
        ),
        "scs_dual": ("SCS, dual cone program, dense A", partial(cones.dual, solver="scs"), SCS),
    }


#: Name of a peer -> its name in tables and the picture.
PEERS = {name: title for name, (title, _, _) in peers(1.0).items()}

#: Tolerances to try with `--error`; each peer has its own meaning of a tolerance.
ERRORS = tuple(10.0**-k for k in range(1, 13))

#: A tolerance is skipped if it exceeds this factor times the tolerance that sufficed on a smaller
#: mesh.
LOOSER = 100.0


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield scenes, sizes and peers."""
    loops = (arguments.scenes, sorted(arguments.sizes), arguments.peers)
    for scene, N, peer in itertools.product(*loops):
        case = {"peer": peer, "scene": scene, "N": N, "rtol": arguments.rtol}
        if arguments.error:
            case["error"] = arguments.error
        steps = scene == "press_fit_steps"
        left_out = (steps and not (arguments.error and peer in STEPPING)) or (
            peer in ON_BRICKS and scene not in two_bricks.ENDS
        )
        if not left_out:
            yield case


def prepare(case: Row, rows: list[Row]) -> Row:
    """Skip a peer that failed on a smaller mesh; set the loosest tolerance that is tried."""
    before = [row for row in rows if (row["scene"], row["peer"]) == (case["scene"], case["peer"])]
    if any("seconds" not in row for row in before):
        return {**case, "status": "skipped: no answer on a smaller mesh"}
    return {**case, "loosest": LOOSER * min([row["tolerance"] for row in before] or [1.0])}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Solve with ever smaller tolerances until the residual is small enough; yield each answer."""
    _, solve, tolerances = peers(case["rtol"])[case["peer"]]
    wanted = case.get("error")
    if wanted:
        tolerances = ERRORS
    scene = SCENES[case["scene"]](comm, case["N"])
    exact = package.exact_stresses(scene)
    for tolerance in tolerances:
        if tolerance > case["loosest"] and len(tolerances) > 1:
            continue
        restart_clock()
        reset_peak_memory()
        seconds, answer = timed(comm, lambda tolerance=tolerance: solve(scene, tolerance))
        peak = peak_memory(comm)
        restart_clock()
        errors = judge(scene, answer, exact)
        if wanted:
            reached = errors["stress_error"] <= wanted
        else:
            reached = errors["residual"] <= ROUNDING * case["rtol"]
        yield {
            "seconds": seconds,
            **answer.work,
            "tolerance": tolerance,
            **errors,
            "peak_rss_mb": peak,
            "says": answer.note,
            "status": "reached" if reached else "not reached",
        }
        if reached:
            break


TITLES = {
    "free_end_1": "free_end_1: some nodes stick",
    "free_end_2": "free_end_2: all nodes slip",
}


def draw(path: Path, rows: list[Row]) -> None:
    """Save seconds as a picture: a line for each peer, a mark for each size of the model."""
    from matplotlib.lines import Line2D

    scenes = [scene for scene in two_bricks.ENDS if any(row["scene"] == scene for row in rows)]
    rows = [
        {**row, "n": 6 * row["N"] ** 3}  # also for runs without an answer
        for row in rows
        if row["scene"] in scenes and "error" not in row
    ]
    sizes = sorted({row["n"] for row in rows})
    looks = dict(zip(sizes, itertools.cycle(("#9ecae1", "#3182bd", "#08306b")), strict=False))

    def time(peer: str, n: int, scene: str) -> float | None:
        """Return the seconds of a run; infinite if it was stopped, None if there was no run."""
        own = [r for r in rows if (r["peer"], r["n"], r["scene"]) == (peer, n, scene)]
        if not own:
            return None
        if own[0]["status"] == "reached":
            return float(own[0]["seconds"])
        return math.inf if own[0]["status"].startswith("stopped") else None

    def place(peer: str) -> list[float]:
        """Return the times in the first scene, the middle size first, by which peers are sorted."""
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
    first.set_yticks(range(len(peers)), [PEERS[peer].strip("*") for peer in peers])
    first.invert_yaxis()
    for label, peer in zip(first.get_yticklabels(), peers, strict=True):
        label.set_fontweight("bold" if PEERS[peer].startswith("**") else "normal")
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


#: Scenes and sizes in the table.
SHOWN = [("free_end_1", 16), ("free_end_1", 26), ("free_end_2", 16), ("free_end_2", 26)]


def seconds(rows: list[Row]) -> str:
    """Return the seconds of a peer, or the seconds after which it was stopped."""
    row = rows[-1]
    if row["status"] == "reached":
        return f"{row['seconds']:.{0 if row['seconds'] >= 10 else 1}f} s"
    stopped = row["status"].startswith("stopped after ")
    return f"> {row['status'].removeprefix('stopped after ')}" if stopped else DASH


def seconds_of(scene: str, N: int) -> Column:
    """Return the column of a scene and a size."""
    head = f"`{scene}`, n = {6 * N**3}"
    return Column(head, seconds, {"scene": scene, "N": N}, missing=DASH)


def beside_ours(rows: list[Row]) -> list[Row]:
    """Return rows with their seconds over those of this package with Cholesky on the same mesh."""
    ours = {row["N"]: row["seconds"] for row in rows if row["peer"] == "cholesky"}
    return [
        {**row, "over_ours": row["seconds"] / ours[row["N"]]}
        if row["status"] == "reached" and row["N"] in ours
        else row
        for row in rows
    ]


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 26], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(two_bricks.ENDS), choices=SCENES)
    parser.add_argument("--peers", nargs="+", default=list(PEERS), choices=PEERS)
    parser.add_argument("--rtol", type=float, default=1e-6, help="relative natural residual")
    parser.add_argument("--error", type=float, help="of the stresses, instead of --rtol")


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("peer", "scene", "N", "rtol", "error"),
    cases=cases,
    prepare=prepare,
    measure=measure,
    small={"N": 4, "rtol": 1e-2, "loosest": 1.0},
    options=options,
    draw=draw,
    shown=[
        Column("scene", "{scene}", width=10),
        Column("N", "{N}", width=3),
        Column("n", "{n}", width=7),
        Column("peer", "{peer}", width=20),
        Column("seconds", "{seconds:.2f}"),
        Column("iter", "{iterations}", width=6),
        Column("products", "{products}"),
        Column("Krylov", "{Krylov}"),
        Column("factor", "{factorisations}"),
        Column("residual", "{residual:.1e}"),
        Column("stress error", "{stress_error:.1e}"),
        Column("MB", "{peak_rss_mb:.0f}", width=6),
        Column("status", "{status}"),
    ],
    tables=[
        Table(
            "peers",
            [
                Column("solver", lambda rows: PEERS[rows[0]["peer"]]),
                *(seconds_of(*shown) for shown in SHOWN),
            ],
            chosen=lambda row: "error" not in row and (row["scene"], row["N"]) in SHOWN,
            line=["peer"],
        ),
        Table(
            "peers_error",
            [
                Column("scene", "{scene}"),
                Column("solver", lambda rows: PEERS[rows[0]["peer"]]),
                Column("n", "{n}"),
                Column("processor seconds", seconds),
                Column("factorisations", "{factorisations}", missing=DASH),
                Column("error of stresses", "{stress_error:.1e}", missing=DASH),
                Column("of the normal force", "{normal_error:.1e}", missing=DASH),
                Column("residual", "{residual:.0e}", missing=DASH),
            ],
            chosen=lambda row: "error" in row and row["scene"] != "press_fit_steps",
            line=["scene", "N", "peer"],
        ),
        Table(
            "peers_steps",
            [
                Column("solver", lambda rows: PEERS[rows[0]["peer"]]),
                Column("n", "{n}"),
                Column("processor seconds", seconds),
                Column("over ours", "{over_ours:.1f}", missing=DASH),
                Column("products", "{products}", missing=DASH),
                Column("factorisations", "{factorisations}", missing=DASH),
                Column("largest error of stresses", "{stress_error:.1e}", missing=DASH),
                Column("of the normal force", "{normal_error:.1e}", missing=DASH),
            ],
            chosen=lambda row: row["scene"] == "press_fit_steps",
            line=["N", "peer"],
            derived=beside_ours,
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
