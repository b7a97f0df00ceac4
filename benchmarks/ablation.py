"""Products, time and failures of the default method without each of its parts.

    OMP_NUM_THREADS=1 tools/fenicsx python3 benchmarks/ablation.py --here \
        --json benchmarks/data/ablation.json

For each row a fixed set of small scenes is solved with one part of `solvers/` or `dual/` switched
off, or with one constant doubled or halved. (For fractions close to 1 the distance from 1 is
doubled or halved.) A failure is a solve that does not converge; "status" counts the solves whose
status is not the same as by default. The number of products in all scenes is divided by the number
by default; "worst" is the scene in which the products change most. Time is processor seconds of all
scenes, with set-up and refinement. Many changes of constants change no number but the time. These
rows and the rows of the default, which runs first and last, do the same work: their median time is
taken as 1, and the range of their times shows how far time varies by chance. Of the constants that
say what counts as rounding, only the constants shared by several files are included. Constants for
scenes that do not occur here, such as scenes with several pairs, change nothing. A is computed at
once in the scenes "few rows" only: the others are small, but stand for larger ones. With `--here`
one process runs all rows, which saves the start of a process for each row.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from functools import cache, partial
from statistics import median
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from mpi4py import MPI

import numpy as np
from adaptive import ACCURACY, STUDIES, with_surfaces
from harness import DASH, Benchmark, Column, Comm, Row, Table
from harness.timing import timed

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactStatus,
    Coulomb,
    TaggedMesh,
    Tresca,
    solve_adaptively,
)
from dolfinx_tresca.dual import products as dual_products
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.solvers import (
    iteration,
    products,
    semismooth_newton,
)
from dolfinx_tresca.solvers.constraints import Balance, balance
from dolfinx_tresca.solvers.convergence import NaturalResidual
from dolfinx_tresca.solvers.feasible_set import Face, FeasibleSet
from dolfinx_tresca.solvers.problem import DualProblem, Point
from scenes import dense
from scenes.elasticity import elasticity
from scenes.random_blocks import RandomBlocks
from scenes.scene import Scene
from scenes.two_bricks import ENDS, SLIP_BOUND, YOUNG, two_bricks
from scenes.two_bricks import floating as two_bricks_floating

PACKAGE = "dolfinx_tresca"
DEFAULT = "default"
#: Values of `change` in the first and the last row of the default.
FIRST, LAST = "first", "last"

#: Loads of the steps of a process, divided by the first load; the long process has four cycles.
LOADS = (1.0, 1.1, 0.95)
CYCLES = 1.0 + 0.5 * np.sin(0.25 * np.arange(100))

#: Approximate limit for the unknowns of a mesh in an adaptive solve.
MAX_DOFS = 2500

#: Number of changes of K, and seed of their random waves.
CHANGES, SEED = 2, 3

#: Relative residual of all solves.
RTOL = 1e-6

#: Objects, names of their attributes, and the values that replace these attributes.
Patches = list[tuple[Any, str, Any]]


class Solves:
    """The outcome of the solves of a scene."""

    def __init__(self) -> None:
        self.products = self.krylov = 0
        self.statuses: list[str] = []

    def add(self, solve: Callable[[], Any], products_of: Callable[[Any], int]) -> None:
        """Run and count a solve; if it raises an error, the name of the error is its status."""
        try:
            found = solve()
        except (ContactError, ArithmeticError, ValueError, IndexError) as error:
            self.statuses.append(type(error).__name__)
            return
        self.products += products_of(found)
        self.krylov += getattr(found, "krylov_iterations", 0)
        self.statuses.append(found.status.name)

    @property
    def failed(self) -> dict[str, str]:
        """Number of the solve -> its status, for the solves that did not converge."""
        numbered = enumerate(self.statuses)
        return {str(i): status for i, status in numbered if status != "CONVERGED"}


def products_of(solution: ContactSolution) -> int:
    """Return the number of products of a solve."""
    return solution.products


@cache
def bricks(N: int, end: str) -> Scene:
    """Return the two bricks. Collective."""
    return two_bricks(MPI.COMM_WORLD, N, end=end)


@cache
def floating_bricks() -> Scene:
    """Return the two bricks, of which the upper one is held by contact alone. Collective."""
    return two_bricks_floating(MPI.COMM_WORLD, "upper", 4)


FRICTION = {"Tresca": Tresca(SLIP_BOUND), "Coulomb": Coulomb(0.3)}


def cold(solves: Solves, stiffness: str = "cholesky", N: int = 6) -> None:
    """Solve the two bricks, with both loads of `ENDS` and both laws (multigrid: one law each)."""
    for end, friction in zip(ENDS, FRICTION.values(), strict=True):
        for law in (friction,) if stiffness == "multigrid" else FRICTION.values():
            with bricks(N, end).but(friction=law).problem(stiffness=stiffness) as problem:
                solves.add(lambda p=problem: p.solve(rtol=RTOL), products_of)


def steps(
    solves: Solves,
    stiffness: str = "cholesky",
    N: int = 8,
    laws: Iterable[str] = FRICTION,
    loads: Iterable[float] = LOADS,
) -> None:
    """Solve a process of load steps with history; each step starts from the step before."""
    for law in laws:
        scene = bricks(N, "free_end_1").but(friction=FRICTION[law])
        load = scene.data.load
        first = load.value.copy()
        with scene.problem(stiffness=stiffness) as problem:
            for factor in loads:
                load.value[:] = factor * first
                solves.add(problem.solve, products_of)
                if solves.statuses[-1] in ContactStatus.__members__:
                    problem.accept(unconverged=True)
        load.value[:] = first


@cache
def coarse(name: str) -> TaggedMesh:
    """Return the first mesh of an adaptive solve. Collective."""
    return STUDIES[name].coarse(MPI.COMM_WORLD, STUDIES[name].size).tagged_mesh


def refined(solves: Solves) -> None:
    """Solve adaptively: Hertz's problem without friction, and the two bricks with both laws."""
    for name, law, stiffness in (
        ("hertz_line", None, "cholesky"),
        ("two_bricks", "Tresca", "multigrid"),
        ("two_bricks", "Coulomb", "cholesky"),
    ):
        solves.add(partial(adaptive_solve, name, law, stiffness), lambda found: found.products)


def adaptive_solve(name: str, law: str | None, stiffness: str) -> SimpleNamespace:
    """Return the total outcome of an adaptive solve on all meshes. Collective."""
    study = STUDIES[name]

    def build(tagged: TaggedMesh) -> ContactProblem:
        scene = study.build(tagged)
        scene = scene if law is None else scene.but(friction=FRICTION[law])
        return scene.problem(stiffness=stiffness)

    start = with_surfaces(study, coarse(name))
    result = solve_adaptively(build, start, ACCURACY, max_dofs=MAX_DOFS)
    return SimpleNamespace(
        status=result.solution.status,
        products=sum(level.products for level in result.levels),
        krylov_iterations=sum(level.solution.krylov_iterations for level in result.levels),
    )


def changes(solves: Solves) -> None:
    """Solve again after random waves of 50 % of Young's modulus, with both solvers for K."""
    for stiffness in ("cholesky", "multigrid"):
        scene = bricks(4, "free_end_1")
        x = ufl.SpatialCoordinate(scene.mesh)
        amplitude, q = fem.Constant(scene.mesh, 0.0), fem.Constant(scene.mesh, np.zeros(4))
        wave = amplitude * ufl.sin(q[0] * x[0] + q[1]) * ufl.cos(q[2] * x[2] + q[3])
        a = elasticity(scene.V, YOUNG * (1 + wave), scene.data.poisson)
        rng = np.random.default_rng(SEED)
        with scene.problem(a=a, stiffness=stiffness) as problem:
            solves.add(problem.solve, products_of)
            for _ in range(CHANGES):
                amplitude.value, q.value[:] = 0.5, rng.uniform(0.0, 8.0, 4)
                problem.update_stiffness()
                solves.add(problem.solve, products_of)


def floating(solves: Solves) -> None:
    """Solve for a body that contact alone holds, with Tresca's law and with Coulomb's."""
    for stiffness, friction in zip(("multigrid", "cholesky"), FRICTION.values(), strict=True):
        with floating_bricks().but(friction=friction).problem(stiffness=stiffness) as problem:
            solves.add(problem.solve, products_of)


def blocks(solves: Solves) -> None:
    """Solve for random blocks in the plane."""
    for seed in range(5):
        with random_blocks(seed).problem() as problem:
            solves.add(problem.solve, products_of)


@cache
def random_blocks(seed: int) -> Scene:
    """Return the random blocks with a given seed. Collective."""
    return RandomBlocks.drawn(seed, 2).coarse(MPI.COMM_WORLD)


#: Seeds of random problems. The last ones of each kind need parts of the method that most problems
#: do not need, such as safeguards.
PLAIN, BALANCED, CONES = range(6), (0, 1, 2, 4, 7, 59), (0, 1, 2, 5, 20, 29, 86)


def dense_problems(solves: Solves) -> None:
    """Solve dense problems: Tresca's law, multipliers in equilibrium, and Coulomb's law."""
    problems = [
        *(dense.random_problem(seed, 4 + seed % 17, seed % 5) for seed in PLAIN),
        *(
            dense.random_balanced_problem(seed, 3 + seed % 12, 1 + seed % 3, 3.0, 0.1 * (seed % 2))
            for seed in BALANCED
        ),
        *(
            dense.random_cone_problem(seed, 2 + seed % 12, seed % 3, (1, 3, 8)[seed % 3])
            for seed in CONES
        ),
    ]
    for problem in problems:
        solves.add(lambda p=problem: dense.run(p, rtol=RTOL), lambda found, p=problem: p.products)


def large(scene: Callable[[Solves], None]) -> Callable[[Solves], None]:
    """Return a scene in which A is not computed at once, as for surfaces with more rows."""

    def solve(solves: Solves) -> None:
        with patch.object(dual_products, "ENTRIES_AT_ONCE", 0):
            scene(solves)

    return solve


def few_rows(solves: Solves) -> None:
    """Solve small problems, in which A is computed at once."""
    cold(solves)
    steps(solves, N=6, loads=CYCLES[:10])


SCENES: dict[str, Callable[[Solves], None]] = {
    "few rows": few_rows,
    "cold": large(cold),
    "steps": large(steps),
    "100 steps": large(partial(steps, N=6, laws=["Coulomb"], loads=CYCLES)),
    "cold, multigrid": lambda solves: cold(solves, "multigrid", 5),
    "steps, multigrid": lambda solves: steps(solves, "multigrid", 5),
    "changes of K": large(changes),
    "adaptive": large(refined),
    "floating": large(floating),
    "blocks": large(blocks),
    "dense": dense_problems,
}


def no_lasting_pairs(store: products.ProductStore) -> None:
    """Drop all stored products at the start of each solve except the first one."""
    if getattr(store, "has_served", False):
        store.W, store.Y, store.errors = store.W[:, :0], store.Y[:, :0], store.errors[:0]
    store.has_served = True


def no_scale(store: products.ProductStore, *arguments: Any) -> None:
    """Append a product without changing the scale of the diagonal."""
    append(store, *arguments)
    store.scale = 1.0


def without_near_field(store: products.ProductStore, *arguments: Any, **others: Any) -> None:
    """Create a store whose model begins with the diagonal."""
    make_store(store, *arguments, **{**others, "apply_near": None})


def without_near_iteration(
    problem: DualProblem, start: Point, *arguments: Any
) -> semismooth_newton.NewtonPoint:
    """Solve with the model of the near field once, without further products with it."""
    store = problem.compliance.known_products()
    near = getattr(store, "near", None)
    model = store.model() if near is None else store.model(near.model())
    return semismooth_newton.newton_solution(problem, model, start)


def unbalanced(constraints: Any, cones: Any, *start: Any) -> Balance:
    """Balance the loads, but leave the first multipliers of a solve as they are."""
    if start:
        return Balance(np.zeros(len(constraints)), constraints.values, satisfied=False)
    return balance(constraints, cones)


def from_zero(state: iteration.ModelNewton, start: np.ndarray) -> Any:
    """Begin at zero."""
    return choose_start(state, np.zeros_like(start))


def on_face_with_given_bounds(
    cones: FeasibleSet, x: np.ndarray, face: Face, *arguments: Any
) -> products.NodalMaps:
    """Return the maps of Newton steps with slip bounds that stay as they are."""
    return on_face(face.discs, x, face, *arguments)


on_face = products.NodalMaps.on_face
append, choose_start = products.ProductStore._append, iteration.ModelNewton.choose_start
make_store = products.ProductStore.__init__
ITERATE, NEWTON, STORE = iteration.Iterate, iteration.ModelNewton, products.ProductStore

#: Name of a part -> the replacements that switch it off.
PARTS: dict[str, Patches] = {
    "near field": [(STORE, "__init__", without_near_field)],
    "iteration on the near model": [(iteration, "solve_model", without_near_iteration)],
    "scale of the diagonal": [(STORE, "_append", no_scale)],
    "A at once where it has few rows": [(dual_products, "ENTRIES_AT_ONCE", 0)],
    "A completed after misses": [(iteration, "MISSES", 10**9)],
    "A completed": [(NEWTON, "complete_products", lambda self: False)],
    "shift of A": [(products, "SHIFT", 0.0)],
    "shorter Newton steps": [(semismooth_newton, "MOST_CUTS", 0)],
    "softer constraints in steps": [(semismooth_newton, "SOFTER", 1.0)],
    "other initial guesses": [(semismooth_newton, "interior_guesses", lambda *arguments: ())],
    "curvature of circles": [
        (FeasibleSet, "circle_stiffness", lambda self, r, face: np.zeros_like(r))
    ],
    "bounds that follow pressures": [(products.NodalMaps, "on_face", on_face_with_given_bounds)],
    "higher accuracy where it stalls": [(ITERATE, "increase_accuracy", lambda self: None)],
    "refined gradients": [(ITERATE, "refine", lambda self, accuracy: None)],
    "kept products": [(STORE, "drop_inaccurate_pairs", no_lasting_pairs)],
    "inaccurate pairs dropped": [(products, "LASTING_ERROR", math.inf)],
    "start at the last multipliers": [(NEWTON, "choose_start", from_zero)],
    "balanced initial multipliers": [(iteration, "balance", unbalanced)],
    "initial motions of floating bodies": [
        (NEWTON, "find_constraint_multipliers", lambda self: None)
    ],
    "first guess of displacements": [(DualProgram, "_guessed", lambda self, x: self._guess.load)],
    "undecided zero": [(NaturalResidual, "zero_is_undecided", lambda self, error: False)],
}

#: Module -> names of its constants. Constants in NEAR_ONE are fractions close to 1, whose distance
#: from 1 is changed.
CONSTANTS = {
    "_base.tolerances": "FORCING ROUGH SLACK FULL_ACCURACY PROGRESS PATIENCE SHORT_PATIENCE "
    "MOST_STEPS",
    "_base.arrays": "ROUNDING",
    "solvers.semismooth_newton": "RHO_DIAGONAL MOST_CUTS PROXIMAL SOFTER SOLVED",
    "solvers.interior_point": "COMPLEMENTARY FIRST_SOFTNESS",
    "solvers.iteration": "MISSES",
    "solvers.products": "NEW_ENERGY NULL_ENERGY RESOLVED LASTING_ERROR PRODUCT_ROUNDING SHIFT "
    "LEAST_SOFTNESS",
    "solvers.constraints": "LOST DAMPING RELAXATION MORE_DAMPING PART_ACCURACY LARGEST_REACTION",
    "dual.products": "ENTRIES_AT_ONCE MOST_AT_ONCE LARGEST_DENSE LARGEST_DENSE_ITERATIVE LAYERS",
    "dual.program": "LOAD_ACCURACY",
}
NEAR_ONE = {
    "PROGRESS", "SLACK",
}  # fmt: skip
FACTORS = {"doubled": 2.0, "halved": 0.5}
CAPACITY = "products.ProductStore.capacity"


def changed(name: str, value: float, factor: float) -> float:
    """Return a constant times a factor; in NEAR_ONE the factor multiplies its distance from 1."""
    if name in NEAR_ONE:
        return 1.0 + factor * (value - 1.0)
    if isinstance(value, int):
        return max(1, int(factor * value))
    return factor * value


def patches(part: str, change: str) -> Patches:
    """Return the replacements for a row."""
    if part == DEFAULT:
        return []
    if change == "off":
        return PARTS[part]
    factor = FACTORS[change]
    if part == CAPACITY:
        return [(make_store, "__defaults__", (int(120 * factor), None))]
    path, _, name = part.rpartition(".")
    value = getattr(importlib.import_module(f"{PACKAGE}.{path}"), name)
    new = changed(name, value, factor)
    return [
        (module, name, new)  # in its module, and in modules that import it
        for key, module in sorted(sys.modules.items())
        if key.startswith(PACKAGE) and getattr(module, name, None) is value
    ]


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the default, then each part and constant, and the default again."""
    rows = [(DEFAULT, FIRST)]
    rows += [(part, "off") for part in PARTS]
    names = [f"{path}.{name}" for path, all_ in CONSTANTS.items() for name in all_.split()]
    rows += [(name, change) for name in [*names, CAPACITY] for change in FACTORS]
    rows += [(DEFAULT, LAST)]
    for part, change in rows:
        if arguments.parts is None or part == DEFAULT or part in arguments.parts:
            yield {"part": part, "change": change, "scenes": arguments.scenes}


@cache
def warm_up(names: tuple[str, ...]) -> None:
    """Solve all scenes once: make meshes, compile forms and load libraries. Collective."""
    for name in names:
        SCENES[name](Solves())


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the outcome of all scenes. Collective."""
    warm_up(tuple(case["scenes"]))
    found, seconds = {}, {}
    with ExitStack() as stack:
        for owner, name, value in patches(case["part"], case["change"]):
            stack.enter_context(patch.object(owner, name, value))
        for name in case["scenes"]:
            solves = found[name] = Solves()
            seconds[name], _ = timed(comm, partial(SCENES[name], solves))
    yield {
        "total": sum(solves.products for solves in found.values()),
        "products": {name: solves.products for name, solves in found.items()},
        "krylov": {name: solves.krylov for name, solves in found.items()},
        "failed": {name: solves.failed for name, solves in found.items()},
        "seconds": seconds,
    }


def failures(row: Row) -> int:
    """Return the number of solves that did not converge."""
    return sum(map(len, row["failed"].values()))


def with_ratios(rows: list[Row]) -> list[Row]:
    """Return the rows, with their figures divided by the figures of the default."""
    found = [row for row in rows if "products" in row]
    reference = next((row for row in found if row["part"] == DEFAULT), None)
    if reference is None:
        return []
    found = [{**row, **ratios(row, reference)} for row in found]
    same = [row["total_seconds"] for row in found if does_same_work(row)]
    return [
        {
            **row,
            "seconds_ratio": row["total_seconds"] / median(same),
            "beyond_chance": row["total_seconds"]
            / float(np.clip(row["total_seconds"], min(same), max(same))),
        }
        for row in found
    ]


def does_same_work(row: Row) -> bool:
    """Whether a row is the default, or changes a constant but none of the default's numbers."""
    return row["same_numbers"] and (row["part"] == DEFAULT or row["change"] in FACTORS)


def ratios(row: Row, reference: Row) -> Row:
    """Return the figures of a row divided by those of the default, except for the time."""
    ours, its = row["products"], reference["products"]
    worst = max(its, key=lambda name: abs(ours[name] - its[name]) / its[name])
    krylov = sum(reference["krylov"].values())
    return {
        "failures": failures(row),
        "products_ratio": sum(ours.values()) / sum(its.values()),
        "krylov_ratio": sum(row["krylov"].values()) / krylov if krylov else 1.0,
        "total_seconds": sum(row["seconds"].values()),
        "scene_ratios": {name: ours[name] / its[name] for name in its},
        "same_numbers": all(row[of] == reference[of] for of in ("products", "krylov", "failed")),
        "worst_ratio": ours[worst] / its[worst],
        "worst": f"{ours[worst] / its[worst]:.2f} ({worst})",
        "moved": sum(
            len(dict(row["failed"][name].items() ^ its.items()))
            for name, its in reference["failed"].items()
        ),
    }


#: Least relative change that matters: of products, of Krylov iterations, or of time beyond its
#: range by chance; and of the products in a single scene.
WORTH, WORTH_IN_A_SCENE = 0.05, 0.1


def matters(row: Row) -> bool:
    """Whether statuses, products, iterations or time differ from the default noticeably."""
    ratios = (row["products_ratio"], row["krylov_ratio"], row["beyond_chance"])
    return (
        row["moved"] > 0
        or any(abs(ratio - 1.0) >= WORTH for ratio in ratios)
        or abs(row["worst_ratio"] - 1.0) >= WORTH_IN_A_SCENE
    )


def switched_off(rows: list[Row]) -> list[Row]:
    """Return the rows in which a part is switched off."""
    return [row for row in with_ratios(rows) if row["change"] == "off"]


def noise(rows: list[Row]) -> list[Row]:
    """Return one row with the range of the times of all rows that do the same work."""
    found = [row for row in with_ratios(rows) if does_same_work(row)]
    if not found:
        return []
    times = sorted(row["seconds_ratio"] for row in found)
    first, last = (row["seconds_ratio"] for row in (found[0], found[-1]))
    row = {"number": len(times), "least": times[0], "most": times[-1], "first": first, "last": last}
    return [{**row, "run": found[0]["run"]}]


def constants(rows: list[Row]) -> list[Row]:
    """Return both rows of each constant for which at least one of the two changes matters."""
    found = [row for row in with_ratios(rows) if row["change"] in FACTORS]
    kept = {row["part"] for row in found if matters(row)}
    return [row for row in found if row["part"] in kept]


def idle(rows: list[Row]) -> list[str]:
    """Return the parts and constants for which no change matters."""
    found = [row for row in with_ratios(rows) if row["part"] != DEFAULT]
    kept = {row["part"] for row in found if matters(row)}
    return sorted({row["part"] for row in found} - kept)


def summary(rows: list[Row]) -> str:
    """Return a line that lists the parts and constants for which no change matters."""
    return f"No other status, less than {WORTH:.0%} of all: " + ", ".join(idle(rows))


def idle_constants(rows: list[Row]) -> list[Row]:
    """Return a row for each module, with its constants for which no change matters."""
    runs = {row["part"]: row["run"] for row in rows}
    modules: dict[tuple[str, str], list[str]] = {}
    for part in idle(rows):
        path = part.rpartition(".")[0]
        if path:
            modules.setdefault((path, runs[part]["commit"]), []).append(part)
    return [
        {
            "module": path,
            "names": ", ".join(f"`{part.rpartition('.')[2]}`" for part in parts),
            "run": runs[parts[0]],
        }
        for (path, _), parts in modules.items()
    ]


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--parts", nargs="+", metavar="PART", help="the default and these only")


RATIOS = [
    Column("products", "{products_ratio:.2f}"),
    Column("100 steps", "{scene_ratios[100 steps]:.2f}"),
    Column("adaptive", "{scene_ratios[adaptive]:.2f}"),
    Column("Krylov iterations", "{krylov_ratio:.2f}"),
    Column("time", "{seconds_ratio:.2f}"),
    Column("worst scene", "{worst}"),
    Column("not converged", "{failures}"),
    Column("other status", "{moved}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("part", "change"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        Column("part", "{part}", width=42),
        Column("change", "{change}", width=8),
        Column("products", "{total}", width=8),
        Column("seconds", lambda rows: f"{sum(rows[0].get('seconds', {}).values()):.1f}"),
        Column("failed", lambda rows: str(failures(rows[0])) if "failed" in rows[0] else DASH),
    ],
    tables=[
        Table("ablation_parts", [Column("without", "{part}"), *RATIOS], derived=switched_off),
        Table(
            "ablation_constants",
            [Column("constant", "`{part}`"), Column("change", "{change}"), *RATIOS],
            derived=constants,
        ),
        Table(
            "ablation_noise",
            [
                Column("rows with the numbers of the default", "{number}"),
                Column("shortest time", "{least:.2f}"),
                Column("longest", "{most:.2f}"),
                Column("default, first", "{first:.2f}"),
                Column("default, last", "{last:.2f}"),
            ],
            derived=noise,
        ),
        Table(
            "ablation_idle",
            [Column("module", "`{module}`"), Column("constants", "{names}")],
            derived=idle_constants,
        ),
    ],
    summary=summary,
)

if __name__ == "__main__":
    BENCHMARK.main()
