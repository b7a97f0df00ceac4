"""Every demo runs, passes its own assertions, and leaves the files that it promises."""

from __future__ import annotations

import importlib
import runpy
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "demos"

#: Those that are plain scripts, with the number that makes them quick.
SCRIPTS = {"demo_adaptive": 30}

DEMOS = sorted({path.stem for path in FOLDER.glob("demo_*.py")} - SCRIPTS.keys())


def test_all_demos_are_found():
    assert {"demo_two_bricks", "demo_hertz", "demo_rigid_obstacle"} <= set(DEMOS)


@pytest.mark.parallel(name=["demo_two_bricks", "demo_rigid_obstacle"])
@pytest.mark.parametrize("name", DEMOS)
def test_demo(comm, folder, monkeypatch, name):
    demo = importlib.import_module(name)
    monkeypatch.setattr(demo, "RESULTS", folder)
    demo.main()
    comm.barrier()
    check_files(folder)


@pytest.mark.parametrize("name", SCRIPTS)
def test_script(comm, folder, monkeypatch, name):
    script = str(FOLDER / f"{name}.py")
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [script, str(SCRIPTS[name])])
    runpy.run_path(script, run_name="__main__")
    comm.barrier()
    check_files(folder / "results")


def check_files(folder):
    for pattern in ("*.pvd", "*/*/volume.*vtu", "*/*/contact.*vtu", "*.png"):
        files = list(folder.glob(pattern))
        assert files, pattern
        assert all(file.stat().st_size > 300 for file in files)
