"""Goals of the solver: scenes that users reported, and walls, piles, bricks and small load steps.

    tools/fenicsx python3 benchmarks/reports.py --json reports.json
    tools/fenicsx python3 benchmarks/reports.py --full --scenes walls piles --json reports.json
    tools/fenicsx python3 benchmarks/reports.py --scenes die hook --json reports.json

Each row is a path of load steps, each of which is solved and accepted. Seconds are processor
seconds of `solve()` and `accept()`; the problem is constructed before. The linear solve to which
they are compared is the factorisation of the same K and a single solve with it. The seconds of the
products are those of the solves with K in them. The seconds of the iteration, without its products,
are divided by them: beyond 1 the search takes longer than the linear algebra that it drives.

Strips, shaft and cube are solved to the default accuracy, pellets to a relative residual of 1e-8,
all other scenes to 1e-6. All use Cholesky factors.

Machine parts (`scenes/right_values.py`) have values that statics or a formula gives, each on two
meshes. Where a body stands up to a limit, the value is the greatest load that was solved.

Processes with finite sliding, of nonlinear bodies and of linear bodies that turn, have a table of
their own: Newton steps (for nonlinear bodies) in place of iterations, and a value with the right
one. Their steps have the default accuracy. Bodies that turn are solved as linear bodies and as
those of St. Venant-Kirchhoff's material: the values should agree to 1 %.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
from assemblies import PUSH, SIZES
from harness import DASH, Benchmark, Column, Comm, Row, Table
from harness.timing import timed

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactStatus,
    Coulomb,
    Frictionless,
    MechanismError,
    NonlinearContactProblem,
    NonlinearContactSolution,
)
from dolfinx_tresca.dual.accuracy import DiscretisationError
from dolfinx_tresca.stiffness.solver import StiffnessSolver
from scenes.arch import arch
from scenes.bent_sheet import STROKE, plastic_sheet
from scenes.blocks import ABOVE, block
from scenes.disc_spring import HEIGHT as CONE
from scenes.disc_spring import disc_spring
from scenes.machine_parts import CORD, cord
from scenes.pellets import HEATING, three_pellets
from scenes.pile import random_pile
from scenes.reported import (
    ROLLER_WIDTH,
    Process,
    billet,
    curved_beams,
    hopping_block,
    pipe,
    roller,
)
from scenes.right_values import PARTS, MachinePart, line_contact_force
from scenes.scene import Scene
from scenes.shaft import greatest_moment, shaft_in_hub
from scenes.snap_fit import WIDTH, snap_fit
from scenes.strips import LOWER, UPPER, two_strips
from scenes.turning import (
    RATIO,
    bearing,
    drum,
    gears,
    rolled,
    saint_venant_kirchhoff,
    torques,
)
from scenes.two_bricks import ENDS, two_bricks
from scenes.wall import HEIGHT, wall

#: Relative residual of scenes that are not solved to the default accuracy.
RTOL = 1e-6

#: Methods whose calls are timed, by what they do: a solution reports none of these seconds.
TIMED: list[tuple[Any, str, str]] = [
    (StiffnessSolver, "__init__", "factorisation"),
    (StiffnessSolver, "solve", "single"),
    (StiffnessSolver, "improve", "single"),
    (StiffnessSolver, "solve_several", "columns"),
    (DiscretisationError, "__init__", "estimate"),
    (DiscretisationError, "cell_errors", "estimate"),
]


class Meter:
    """Solves load steps, and keeps what they cost.

    Attributes:
        comm: communicator of the scenes.
        small: whether scenes have a few cells only.
        unknowns: number of displacement unknowns of the latest scene.
        steps: figures of the load steps.
        process: figures of the load steps of a process with finite sliding.
        values: a value of such a process, and the right one.
    """

    def __init__(self, comm: Comm, small: bool) -> None:
        """Begin without load steps. Not collective."""
        self.comm, self.small = comm, small
        self.unknowns, self.steps = 0, list[Row]()
        self.process, self.values = list[Row](), Row()
        self._calls: list[tuple[str, float, int]] = []  # of this problem: kind, seconds, solves

    def timing(self) -> ExitStack:
        """Return a context in which the methods of `TIMED` are timed. Not collective."""
        stack = ExitStack()
        for owner, name, kind in TIMED:
            method = self._timed(getattr(owner, name), kind)
            stack.enter_context(patch.object(owner, name, method))
        return stack

    def _timed(self, method: Callable[..., Any], kind: str) -> Callable[..., Any]:
        def call(owner: Any, *arguments: Any, **named: Any) -> Any:
            before, start = getattr(owner, "solves", 0), time.process_time()
            result = method(owner, *arguments, **named)
            seconds = time.process_time() - start
            # other solvers than that of K have matrices of multipliers
            if kind == "estimate" or owner.matrix.getSize()[0] == self.unknowns:
                self._calls.append((kind, seconds, getattr(owner, "solves", 0) - before))
            return result

        return call

    def problem(self, scene: Scene, **changes: Any) -> ContactProblem:
        """Return the problem of a scene; `changes` are arguments of `Scene.problem`. Collective."""
        self.unknowns, self._calls = scene.unknowns, []
        return scene.problem(stiffness="cholesky", **changes)

    def step(self, problem: ContactProblem, **asked: Any) -> ContactSolution:
        """Solve and accept a load step, and return its solution, converged or not. Collective."""

        def solve_and_accept() -> ContactSolution:
            solution = problem.solve(**asked)
            problem.accept(unconverged=True)  # the row shows failures
            return solution

        earlier = len(self._calls)
        seconds, solution = timed(self.comm, solve_and_accept)
        single = np.mean([s for kind, s, _ in self._calls if kind == "single"])
        factorisation = next(s for kind, s, _ in self._calls if kind == "factorisation")
        calls = self._calls[earlier:]
        solves = sum(number for *_, number in calls)
        with_K = sum(s for kind, s, _ in calls if kind in ("single", "columns"))
        phases = [solution.timings[name] for name in ("load", "iteration", "fields")]
        products = with_K - (solves - solution.products) * single
        self.steps.append(
            {
                "status": solution.status.name,
                "iterations": solution.iterations,
                "products": solution.products,
                "solves": solves,
                "seconds": seconds,
                "linear": factorisation + single,
                "with_K": with_K,
                "estimate": sum(s for kind, s, _ in calls if kind == "estimate"),
                "in_products": products,
                # wall-clock seconds of phases, of which the ratio alone counts
                "iteration": seconds * phases[1] / sum(phases) - products,
            }
        )
        return solution

    def process_step(self, problem: ContactProblem | NonlinearContactProblem) -> Any:
        """Solve and accept a load step with finite sliding; return its solution. Collective."""

        def solve_and_accept() -> ContactSolution:
            solution = problem.solve()
            problem.accept()
            return solution

        seconds, solution = timed(self.comm, solve_and_accept)
        steps = []
        if isinstance(solution, NonlinearContactSolution):
            steps = [len(solution.newton.steps)]
        self.process.append(
            {"status": solution.status.name, "seconds": seconds, "newton_steps": steps}
        )
        return solution

    def process_row(self) -> Row:
        """Return the figures of all load steps of a process. Not collective."""
        newton = [number for step in self.process for number in step["newton_steps"]]
        return {
            "steps": len(self.process),
            "converged": len(self.process),
            "seconds": sum(step["seconds"] for step in self.process),
            "status": ContactStatus.CONVERGED.name,
            **({"newton_steps": newton} if newton else {}),
        }

    def row(self) -> Row:
        """Return the figures of all load steps. Not collective."""
        if not self.steps:
            return (self.process_row() if self.process else {}) | self.values
        steps, names = self.steps, ("seconds", "linear", "with_K", "estimate", "solves")
        seconds, linear, with_K, estimate, solves = (sum(s[name] for s in steps) for name in names)
        products = sum(step["in_products"] for step in steps)
        computed = any(step["products"] for step in steps)  # else these seconds are noise
        failed = [s["status"] for s in steps if s["status"] != ContactStatus.CONVERGED.name]
        return {
            "unknowns": self.unknowns,
            "steps": len(steps),
            "converged": len(steps) - len(failed),
            "iterations": [step["iterations"] for step in steps],
            "products": [step["products"] for step in steps],
            "solves": solves / len(steps),
            "seconds": seconds,
            "seconds_of_step": seconds / len(steps),
            "ratio": seconds / linear,
            "largest_ratio": max(step["seconds"] / step["linear"] for step in steps),
            "iteration": sum(s["iteration"] for s in steps) / products if computed else None,
            "percent": [round(100.0 * s / seconds) for s in (with_K, estimate)],
            "status": (failed or [ContactStatus.CONVERGED.name])[0],
            **self.values,
        }


def strips(
    meter: Meter, *, n: int, degree: int, forces: list[float], restart: bool = False
) -> None:
    """Bend two strips by forces [N/mm]; with `restart` each step is solved by a new problem."""
    scene = two_strips(meter.comm, 12 if meter.small else n, degree)
    scene = scene.but(secondary=LOWER, primary=UPPER)  # takes more iterations than the other way
    problem = meter.problem(scene)
    with TemporaryDirectory() as folder:
        state = Path(folder) / "state.npz"
        for number, force in enumerate(forces):
            if restart and number:
                problem.save_state(state)
                problem.destroy()
                problem = meter.problem(scene)
                problem.load_state(state)
            scene.data.shear.value = force
            meter.step(problem)
    problem.destroy()


def pellets(meter: Meter, *, n: int, friction: float) -> None:
    """Heat three pellets in a tube, and cool them."""
    scene = three_pellets(meter.comm, 10 if meter.small else n, friction)
    with meter.problem(scene, axisymmetric=True) as problem:
        for values in HEATING[:2] if meter.small else HEATING:
            for rise, value in zip(scene.data.rises, values, strict=True):
                rise.value = value
            meter.step(problem, rtol=1e-8)


def shaft(meter: Meter, *, parts: list[float]) -> None:
    """Press a shaft into its hub, and turn it by parts of the moment that friction bears."""
    scene = shaft_in_hub(meter.comm, 24 if meter.small else 192)
    with meter.problem(scene) as problem:
        scene.data.weight.value = 1000.0
        solution = meter.step(problem)
        for part in parts:
            scene.data.moment.value = part * greatest_moment(solution)
            solution = meter.step(problem)


def bricks(meter: Meter, *, end: str) -> None:
    """Press two bricks."""
    with meter.problem(two_bricks(meter.comm, 4 if meter.small else 16, end=end)) as problem:
        meter.step(problem, rtol=RTOL)


def walls(meter: Meter, *, size: tuple[int, int]) -> None:
    """Load a wall by its weight, then push it."""
    size = SIZES[2] if meter.small else size
    scene = wall(meter.comm, *size, one_pair=True)
    with meter.problem(scene) as problem:
        for push in (0.0, PUSH):
            scene.data.push.value = push * scene.data.weights.sum() / size[1] / HEIGHT
            meter.step(problem, rtol=RTOL)


def arches(meter: Meter, *, thickness: float) -> None:
    """Load an arch by its weight."""
    scene = arch(meter.comm, thickness, voussoirs=5 if meter.small else 25)
    with meter.problem(scene) as problem:
        meter.step(problem, rtol=RTOL)


def piles(meter: Meter, *, number: int) -> None:
    """Load random piles by their weights; those that do not stand count no step."""
    for seed in range(18, 20) if meter.small else range(number):
        try:
            with meter.problem(random_pile(seed).scene()) as problem:
                meter.step(problem, rtol=RTOL)
        except MechanismError:
            continue


def cube(meter: Meter, *, n: int) -> None:
    """Press the upper face of a cube on a plane, and drag it in small steps until all slips.

    The step that presses does not count.
    """
    law = Coulomb(0.3)
    n, steps = (2, 2) if meter.small else (n, 20)
    scene = block(meter.comm, (n, n, n), friction=law, held=[ABOVE], boxes=True)
    with meter.problem(scene) as problem:
        for number, shift in enumerate(np.linspace(0.0, 1e-3, steps + 1)):
            motion = np.array([shift, 0.0, -1e-3])[:, None]
            scene.data.held.interpolate(lambda x, motion=motion: motion + 0.0 * x)
            meter.step(problem)
            if number == 0:
                meter.steps.clear()


def die(meter: Meter, *, cells: tuple[int, int]) -> None:
    """Bend a sheet of metal into a die, and release it: the value is the angle after springback."""
    sheet = plastic_sheet(meter.comm, (30, 2) if meter.small else cells)
    strokes = STROKE / 100.0 * np.arange(1, 3 if meter.small else 101)
    released = STROKE - 12.0 * (np.arange(1, 31) / 30.0) ** 2
    with sheet.problem as problem:
        for stroke in [*strokes, *released] if not meter.small else strokes:
            sheet.punch.move_to((0.0, -stroke))
            meter.process_step(problem)
    meter.values = {"value": sheet.angle(), "right": "43 to 55"}


def hook(meter: Meter, *, friction: float, right: str, refined: int) -> None:
    """Push a block over a snap-fit hook; the value is the force across on the hook's flat end.

    Args:
        meter: keeps the figures.
        friction: coefficient of friction.
        right: the right value [N], as text.
        refined: factor on the numbers of cells.
    """
    law = Coulomb(friction) if friction else Frictionless()
    scene = snap_fit(meter.comm, law, 1 if meter.small else refined)
    number = 24 if meter.small else 120
    with scene.problem as problem:
        for distance in 9.0 * np.arange(1, number + 1) / number:
            scene.push(distance)
            solution = meter.process_step(problem)
            if np.isclose(distance, 5.625):
                force = -WIDTH * float(solution.pair_resultants[0].force[1])
    meter.values = {"value": force, "right": right}


def reported(
    meter: Meter,
    scene: Callable[[Comm], Process],
    places: np.ndarray,
    value: Callable[[np.ndarray], float],
    right: str,
) -> None:
    """Move a scene of `scenes.reported` to places one after another.

    Args:
        meter: keeps the figures.
        scene: function that makes the scene.
        places: the places.
        value: function from forces (places, 2) on the secondary side to the value of the row.
        right: the right value, as text.
    """
    process, forces = scene(meter.comm), []
    meter.values["right"] = right
    with process.problem:
        try:
            for place in places[: 2 if meter.small else None]:
                process.move(float(place))
                solution = meter.process_step(process.problem)
                forces.append(solution.pair_resultants[0].force)
        finally:
            if len(forces) > 1:
                meter.values["value"] = value(np.array(forces))


def spring(meter: Meter, *, height: float, right: str, cells: tuple[int, int]) -> None:
    """Press a disc spring flat, and let it return; the value is the force when it is flat [N]."""
    cells = (10, 2) if meter.small else cells
    problem, plate = disc_spring(meter.comm, Frictionless(), "finite", cells, height=height)
    down = np.append(0.05 * np.arange(1, round(height / 0.05)), height)
    forces = {}
    with problem:
        for deflection in [0.2, height] if meter.small else [*down, *down[-2::-1], 0.0]:
            plate.move_to((0.0, -deflection))
            forces[deflection] = meter.process_step(problem).pair_resultants[0].force[1]
    meter.values = {"value": float(forces[height]), "right": right}


def turning(meter: Meter, scene: Scene, angles: np.ndarray, nonlinear: bool) -> Iterator[Any]:
    """Turn the bodies of a scene, and yield the solution at each angle [degrees]. Collective."""
    problem = saint_venant_kirchhoff(scene) if nonlinear else scene.problem()
    with problem:
        for angle in np.radians(angles):
            scene.data.turn(angle)
            yield meter.process_step(problem)


def gear_pair(meter: Meter, *, coarse: int, nonlinear: bool) -> None:
    """Turn two gears through a tooth and a half: the value is the ratio that is farthest off."""
    scene = gears(meter.comm, 0.8 if meter.small else 0.4 * coarse)
    angles = np.arange(2.0 if meter.small else 28.0)
    moments = [torques(solution) for solution in turning(meter, scene, angles, nonlinear)]
    ratios = np.array([-gear / pinion for pinion, gear in moments])
    meter.values = {"value": ratios[np.abs(ratios - 1.5).argmax()], "right": "1.5 to 1 %"}


def rollers(meter: Meter, *, turn: int, coarse: int, nonlinear: bool) -> None:
    """Turn the shaft of a bearing [degrees]: the value is the angle by which rollers roll on."""
    scene = bearing(meter.comm, *((6, 8) if meter.small else (16, 16 // coarse)))
    angles = np.arange(2.0 if meter.small else turn + 1.0)
    *_, solution = turning(meter, scene, angles, nonlinear)
    meter.values = {
        "value": float(rolled(scene, solution)),
        "right": f"{RATIO * angles[-1]:.2f}",
    }


def shoe(meter: Meter, *, coarse: int, nonlinear: bool) -> None:
    """Turn a drum by 0.2 rad under its shoe; the value is the normal force [N/mm]."""
    angles = np.degrees([0.0, 0.01, 0.02, 0.04, 0.08, 0.12, 0.16, 0.2])
    scene = drum(meter.comm, 4 if meter.small else 16 // coarse)
    *_, solution = turning(meter, scene, angles[: 2 if meter.small else None], nonlinear)
    meter.values = {"value": float(solution.normal_force), "right": "that at rest"}


def machine_part(meter: Meter, *, part: MachinePart) -> None:
    """Move a machine part through its loads, as far as it stands."""
    meter.values["right"] = part.right if isinstance(part.right, str) else f"{part.right:.4g}"
    part = replace(part, loads=part.loads[:1]) if meter.small else part
    solve = meter.process_step if part.nonlinear else meter.step
    meter.values["value"] = part.follow(meter.comm, solve, meter.problem)


#: Name of a path of the strips -> forces [N/mm]; beyond 0.4 some nodes slip.
BENDING: dict[str, list[float]] = {
    "pressed": [0.0],
    "near the limit": [0.0, 0.2, 0.39],
    "beyond and back": [0.0, 0.2, 0.39, 0.8, 0.4],
}

#: Cells along a strip, and degree.
STRIPS = [(100, 2), (400, 1), (200, 2)]

#: Name of a material, and whether it is nonlinear.
MATERIALS = (("linear", False), ("St. Venant-Kirchhoff", True))

#: What is behind the name of a process on a coarse mesh -> how much larger its cells are.
COARSE = {"": 1, ", coarse mesh": 2}

#: Scene -> case -> function that solves its load steps.
SCENES: dict[str, dict[str, Callable[[Meter], None]]] = {
    "strips": {
        f"{n} cells of degree {degree}, {name}{', restarts' * restart}": partial(
            strips, n=n, degree=degree, forces=forces, restart=restart
        )
        for n, degree in STRIPS
        for name, forces in BENDING.items()
        for restart in (False, True)[: len(forces)]
    },
    "pellets": {
        f"{n} cells along, F = {F:g}": partial(pellets, n=n, friction=F)
        for n, F in ((40, 0.0), (40, 0.3), (50, 0.3))
    },
    "shaft": {
        f"moments to {parts[-1]:g}": partial(shaft, parts=parts)
        for parts in ([0.5, 0.9, 0.97], [0.5, 0.9, 0.97, 0.99, 0.995])
    },
    "bricks": {end: partial(bricks, end=end) for end in ENDS},
    "walls": {
        f"{number:,} bricks": partial(walls, size=size)
        for number, size in ((52, SIZES[52]), (1104, (34, 32)), (5005, SIZES[5005]))
    },
    "arch": {f"thickness {t:g} m": partial(arches, thickness=t) for t in (0.15, 0.11)},
    "piles": {f"{number} seeds": partial(piles, number=number) for number in (40, 300)},
    "die": {
        f"sheet of aluminium, with springback{name}": partial(die, cells=(120 // c, 4 // c))
        for name, c in COARSE.items()
    },
    "hook": {
        f"snap-fit, F = {F:g}{name}": partial(hook, friction=F, right=right, refined=refined)
        for F, right in ((0.0, "29.1"), (0.6, "32.8"))
        for name, refined in (("", 1), (", fine mesh", 2))
    },
    "disc spring": {
        f"height 0.4, flat and back{name}": partial(
            spring, height=CONE, right="5,245 (small sliding)", cells=(40 // c, 4 // c)
        )
        for name, c in COARSE.items()
    },
    "curved beams": {
        f"F = 0: largest force [N/mm]{name}": partial(
            reported,
            scene=partial(curved_beams, friction=Frictionless(), cells=(40 // c, 2 // c)),
            places=0.5 * np.arange(1, 64),
            value=lambda forces: float(np.hypot(*forces.T).max()),
            right="35.7",
        )
        for name, c in COARSE.items()
    },
    "pipe": {
        f"crushed by 35 mm: force [N/mm]{name}": partial(
            reported,
            scene=partial(pipe, cells=(32 // c, 4 // c)),
            places=0.35 * np.arange(1, 51),
            value=lambda forces: 2.0 * abs(float(forces[-1, 1])),
            right="478",
        )
        for name, c in COARSE.items()
    },
    "roller": {
        f"hub moved by 9.503 mm: force [N]{name}": partial(
            reported,
            scene=partial(roller, cells=(40 // c, 8 // c)),
            places=np.append(0.5 * np.arange(1, 20), 9.503),
            value=lambda forces: 2.0 * ROLLER_WIDTH * float(forces[-1, 1]),
            right="380",
        )
        for name, c in COARSE.items()
    },
    "billet": {
        f"F = {F:g}: force [MN]{name}": partial(
            reported,
            scene=partial(billet, friction=Coulomb(F) if F else Frictionless(), cells=cells),
            places=0.1 * np.arange(1, 91),
            value=lambda forces: 1e-6 * abs(float(forces[-1, 1])),
            right=right,
        )
        for F, right in ((0.0, "0.7645"), (0.5, "0.83"))
        for name, cells in (("", (12, 14)), (", fine mesh", (18, 21)))
    },
    "hopping block": {
        "F = 0.1: largest T / N": partial(
            reported,
            scene=hopping_block,
            places=np.pi / 26.0 * np.arange(1, 112),
            value=lambda forces: float(
                np.abs(np.divide(*forces[forces[:, 0] > 0.0].T[::-1])).max(initial=0.0)
            ),
            right="0.1",
        )
    },
    "cord": {
        f"F = {F:g} to {end}, cells of {size} mm: force at 0.05": partial(
            reported,
            scene=partial(cord, size=size, friction=F),
            places=np.append(0.025, np.arange(0.05, end + 0.01, 0.05)),
            value=lambda forces: 2.0 * abs(float(forces[1, 1])),
            right=f"{line_contact_force(0.05 * CORD):.3f} (Hertz)",
        )
        for F, end in ((0.0, 0.2), (0.3, 0.4), (0.0, 0.4))
        for size in (0.5, 0.35)
    },
    **{
        scene: {case: partial(machine_part, part=part) for case, part in parts.items()}
        for scene, parts in PARTS.items()
    },
    "gears": {
        material + name: partial(gear_pair, coarse=c, nonlinear=nonlinear)
        for material, nonlinear in MATERIALS
        for name, c in COARSE.items()
    },
    "bearing": {
        f"16 rollers, {turn} degrees, {material}{name}": partial(
            rollers, turn=turn, coarse=c, nonlinear=nonlinear
        )
        for turn, (material, nonlinear) in ((90, MATERIALS[0]), *((10, m) for m in MATERIALS))
        for name, c in COARSE.items()
    },
    "drum": {
        material + name: partial(shoe, coarse=c, nonlinear=nonlinear)
        for material, nonlinear in MATERIALS
        for name, c in COARSE.items()
    },
    "cube": {f"{3 * (n + 1) ** 3:,} unknowns": partial(cube, n=n) for n in (4, 8, 16)},
}

#: Cases that take long.
FULL = {"5,005 bricks", "300 seeds", "16 rollers, 10 degrees, St. Venant-Kirchhoff"}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the paths of the scenes."""
    for scene in arguments.scenes:
        chosen = [case for case in SCENES[scene] if arguments.full or case not in FULL]
        if arguments.small:  # machine parts have their coarse meshes first
            chosen = chosen[:1] if scene in PARTS else chosen[-1:]
        for case in chosen:
            yield {"scene": scene, "case": case, "small": arguments.small}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the figures of a case. Collective."""
    meter, error = Meter(comm, case["small"]), {}
    with meter.timing():
        try:
            SCENES[case["scene"]][case["case"]](meter)
        except ContactError as reason:
            error = {"status": type(reason).__name__}
    yield (meter.row() if meter.steps or meter.process else {}) | error


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument(
        "--full",
        action="store_true",
        help="also the largest wall, 300 piles, and a nonlinear bearing",
    )
    parser.add_argument("--small", action="store_true", help="a case of a few cells for each scene")


def most(name: str) -> Callable[[list[Row]], str]:
    """Return a function that writes the most in a load step, and the sum over all steps."""
    return lambda rows: f"{max(rows[-1][name])} / {sum(rows[-1][name])}"


def most_newton_steps(rows: list[Row]) -> str:
    """Return the most Newton steps in a load step and their sum; a dash for linear bodies."""
    return most("newton_steps")(rows) if "newton_steps" in rows[-1] else DASH


COLUMNS = [
    Column("scene", "{scene}", width=7),
    Column("case", "{case}", width=49),
    Column("unknowns", "{unknowns}"),
    Column("steps", "{steps}"),
    Column("iterations: most / all", most("iterations")),
    Column("products: most / all", most("products")),
    Column("solves with K, a step", "{solves:.1f}"),
    Column("seconds", "{seconds:.2f}"),
    Column("a step", "{seconds_of_step:.4f}"),
    Column("over linear: mean / most", "{ratio:.1f} / {largest_ratio:.1f}"),
    Column("iteration over products", "{iteration:.2f}"),
    Column("% in solves with K / in the mesh's error", "{percent[0]} / {percent[1]}"),
    Column("converged", "{converged} of {steps}"),
    Column("status", "{status}"),
]

PROCESSES = [
    Column("scene", "{scene}"),
    Column("case", "{case}"),
    Column("load steps", "{steps}"),
    Column("Newton steps: most / all", most_newton_steps),
    Column("seconds", "{seconds:.1f}"),
    Column("value", "{value:.4g}"),
    Column("right", "{right}"),
    Column("status", "{status}"),
]

VALUES = [*COLUMNS[:5], COLUMNS[5], COLUMNS[9], *PROCESSES[5:]]


def is_process(row: Row) -> bool:
    """Return whether a row has a right value, but no linear solve to be compared with."""
    return "right" in row and "ratio" not in row


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "case"),
    cases=cases,
    measure=measure,
    options=options,
    small={"small": True},
    shown=COLUMNS,
    tables=[
        Table("reports", COLUMNS, lambda row: "right" not in row, ["scene", "case"]),
        Table("processes", PROCESSES, is_process, ["scene", "case"]),
        Table(
            "machine_parts", VALUES, lambda row: {"right", "ratio"} <= set(row), ["scene", "case"]
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
