"""Every demo runs, passes its own assertions, leaves the files that it promises, and is its scene.

Demos are scripts that people copy, so they write their forms themselves; tests and benchmarks have
the same scenes in scenes/. A number of both is compared.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

from scenes.two_bricks import two_bricks

DEMOS = Path(__file__).parents[1] / "demos"

#: Sizes for a quick run, and the scene of the demo's last solution.
RUNS = {
    "two_bricks": (4, lambda comm: two_bricks(comm, 4)),
}


def test_all_demos_are_found():
    assert {f"demo_{name}" for name in RUNS} == {path.stem for path in DEMOS.glob("*.py")}


@pytest.mark.parallel(name=["two_bricks", "rigid_obstacle"])
@pytest.mark.parametrize("name", RUNS)
def test_demo(comm, folder, monkeypatch, name):
    size, scene_of = RUNS[name]
    script = str(DEMOS / f"demo_{name}.py")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [script, str(size)])
    ran = runpy.run_path(script, run_name="__main__")
    comm.barrier()
    for pattern in ("*.pvd", "*/*/volume.*vtu", "*/*/contact.*vtu", "*.png"):
        files = list((folder / "results").glob(pattern))
        assert files, pattern
        assert all(file.stat().st_size > 300 for file in files)
    with scene_of(comm).problem() as problem:
        found = problem.solve()
    assert found.normal_force == pytest.approx(ran["solution"].normal_force)
