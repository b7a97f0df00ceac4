"""Atomic writing: files appear when they are complete, and older files stay until then."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dolfinx_tresca import InputError
from dolfinx_tresca._base.atomic_write import atomic_write


def test_failing_block_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "r.vtu").write_text("old")
    with pytest.raises(ZeroDivisionError), atomic_write(tmp_path / "r.vtu") as new:
        new.write_text("half")
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["r.vtu"]
    assert (tmp_path / "r.vtu").read_text() == "old"


def test_disk_error_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "r.png"
    with pytest.raises(InputError, match=r"cannot write '.*r\.png': No space left"):
        with atomic_write(path):
            raise OSError(28, "No space left on device")
    assert not list(tmp_path.iterdir())


def test_new_file_has_the_usual_mode(tmp_path: Path) -> None:
    """It replaces an older one, and all may read it, unlike a temporary file."""
    for name in ("usual", "new"):
        (tmp_path / name).touch()
    with atomic_write(tmp_path / "new") as new:
        new.write_text("new")
    assert (tmp_path / "new").read_text() == "new"
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_pipe_is_not_replaced(tmp_path: Path) -> None:
    """An administrator could otherwise replace `/dev/null`."""
    pipe = tmp_path / "r.vtu"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="a device or a pipe"), atomic_write(pipe):
        raise AssertionError("nothing can be written there")
    assert pipe.is_fifo()
