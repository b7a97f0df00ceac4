"""Every demo runs, passes its own assertions, leaves the files that it promises, and is its scene.

Demos are scripts that people copy, so they write their forms themselves; tests and benchmarks have
the same scenes in scenes/. Numbers of both are compared.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

import pytest

from scenes.arch import arch
from scenes.floating_block import crane_on_clay
from scenes.hertz import cylinder_on_plane
from scenes.implant import MOTION, implant
from scenes.press_fit import PUSHES, press_fit
from scenes.rigid_obstacle import block_on_ring
from scenes.scene import Scene
from scenes.two_bricks import two_bricks

DEMOS = Path(__file__).parents[1] / "demos"

#: Residual of solutions that are compared, and what it may make of energies and forces.
RTOL, SAME = 1e-8, 1e-5

#: Size for a quick run, and the scene of the demo's last solution at this size, if one is shared.
RUNS: dict[str, tuple[int, Callable[[MPI.Comm], Scene] | None]] = {
    "two_bricks": (4, lambda comm: two_bricks(comm, 4)),
    "hertz": (5, lambda comm: cylinder_on_plane(comm, 2 * 0.6 / 5, degree=2)),
    "rigid_obstacle": (8, lambda comm: block_on_ring(comm, 8)),
    "press_fit": (8, lambda comm: press_fit(comm, 8)),
    "implant": (8, lambda comm: with_data(implant(comm, 8), motion=MOTION)),
    "arch": (2, lambda comm: arch(comm, 0.1072, divisions=(1, 2))),
    "bearing": (2, None),
    "flange": (20, None),
    "fretting": (4, None),
    "adaptive": (30, None),
    "hyperelastic_seal": (8, None),
    "impact": (20, None),
    "indentation": (6, None),
    "calibration": (8, None),
    "ironing": (30, None),
    "roller_profile": (3, None),
    "shrink_fit_thermal": (8, None),
    "floating_block": (8, lambda comm: with_data(crane_on_clay(comm, 8), x=1.5, pull=80.0)),
}

#: Demos of many solves: `make docs` runs them too.
SLOW = (
    "arch bearing flange calibration fretting press_fit implant floating_block impact indentation "
    "ironing roller_profile"
).split()

#: Normal forces on one rank of demos that have no scene and run on several ranks too.
FORCES = {"shrink_fit_thermal": 2181.4411}

#: Values of the scene's data in load steps.
STEPS: dict[str, list[dict[str, float]]] = {"press_fit": [{"push": -push} for push in PUSHES]}


def with_data(scene: Scene, **data: object) -> Scene:
    """Return the scene with these values of its data."""
    for name, value in data.items():
        getattr(scene.data, name).value = value
    return scene


def test_all_demos_are_found():
    assert {f"demo_{name}" for name in RUNS} == {path.stem for path in DEMOS.glob("*.py")}


@pytest.mark.parallel(name=["two_bricks", "rigid_obstacle", *FORCES])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name in SLOW)) for name in RUNS]
)
def test_demo(comm, folder, monkeypatch, name):
    size, scene_of = RUNS[name]
    script = str(DEMOS / f"demo_{name}.py")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [script, str(size)])
    solution = runpy.run_path(script, run_name="__main__")["solution"]
    comm.barrier()
    for pattern in ("*.pvd", "*/*/volume.*vtu", "*/*/[!v]*.*vtu", "*.png"):
        files = list((folder / "results").glob(pattern))
        assert files, pattern
        assert all(file.stat().st_size > 300 for file in files)
    if name in FORCES:
        assert solution.normal_force == pytest.approx(FORCES[name], rel=SAME)
    if scene_of is None:  # it compares steps or meshes itself
        return
    asked = {} if name == "two_bricks" else {"rtol": RTOL}
    scene = scene_of(comm)
    with scene.problem() as problem:
        for data in STEPS.get(name, [{}]):
            with_data(scene, **data)
            wanted = problem.solve(**asked)
            problem.accept()
    assert solution.normal_force == pytest.approx(wanted.normal_force, rel=SAME)
    assert solution.primal_energy == pytest.approx(wanted.primal_energy, rel=SAME)
