"""Every demo runs, passes its own assertions, and leaves the files that it promises."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

DEMOS = sorted(path.stem for path in (Path(__file__).parents[1] / "demos").glob("demo_*.py"))


def test_all_demos_are_found():
    assert {"demo_two_bricks", "demo_hertz", "demo_rigid_obstacle"} <= set(DEMOS)


@pytest.mark.parallel(name=["demo_two_bricks", "demo_rigid_obstacle"])
@pytest.mark.parametrize("name", DEMOS)
def test_demo(comm, folder, monkeypatch, name):
    demo = importlib.import_module(name)
    monkeypatch.setattr(demo, "RESULTS", folder)
    demo.main()
    comm.barrier()
    for pattern in ("*.pvd", "*/*/volume.*vtu", "*/*/contact.*vtu", "*.png"):
        files = list(folder.glob(pattern))
        assert files, pattern
        assert all(file.stat().st_size > 300 for file in files)
