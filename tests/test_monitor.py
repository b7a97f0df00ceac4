"""The progress bar: in terminals, in notebooks, in log files, and on several ranks."""

from __future__ import annotations

import os
import sys
from io import StringIO
from types import SimpleNamespace

import pytest

from dolfinx_tresca import ContactStatus, Iteration, ProgressBar, Tresca, monitor
from scenes.rubber_block import rubber_block
from scenes.two_bricks import bricks_problem


class Terminal(StringIO):
    """What is written to it can be read as a text."""

    def isatty(self) -> bool:
        """So it says."""
        return True


@pytest.fixture
def terminal(monkeypatch):
    stream = Terminal()
    # pytest puts its own one in place of sys.stderr when the test begins
    monkeypatch.setattr(monitor, "sys", SimpleNamespace(stderr=stream, modules=sys.modules))
    return stream


def at(number: int, reached: float, wanted: float = 1e-4) -> Iteration:
    return Iteration(number, 10 + number, reached, reached, wanted, -1.0)


def test_a_terminal_shows_one_line_for_each_solve(comm, terminal, monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm", None)  # as where it is not installed
    bar = ProgressBar()
    with bricks_problem(comm, 4) as problem:
        for rtol in (1e-3, 1e-6):
            assert problem.solve(rtol=rtol, observer=bar).status is ContactStatus.CONVERGED
    lines = terminal.getvalue().splitlines(keepends=True)
    assert len([line for line in lines if line.endswith("\n")]) == 2
    assert terminal.getvalue().count("contact 100% |############|") == 2
    assert terminal.getvalue().endswith(" s\n")


def test_newtons_method_has_one_line(comm, terminal):
    """The line shows the part of the load, the Newton step, and the residual of the last step."""
    scene = rubber_block(comm, (4, 4), clamped=True, friction=Tresca(0.1))
    with scene.problem() as problem:
        scene.push.value[:] = 0.02, -0.1
        solution = problem.solve(observer=ProgressBar())
    shown = terminal.getvalue()
    assert shown.count("\n") == 1 and shown.endswith(" s\n")
    lines = shown.split("\r")
    assert "of load, Newton step 1, residual     inf" in lines[1]
    assert "contact 100% |" in lines[-1]
    last = len(solution.newton.steps)
    assert f"Newton step {last}, residual {solution.newton.residual:7.1e}" in lines[-1]


def test_the_bar_counts_digits_and_does_not_go_back(terminal):
    bar = ProgressBar()
    for number, reached in enumerate((float("inf"), 1e-1, 1e-2, 1.0, 1e-3)):
        bar(at(number, reached))
    shown = [line[8:12] for line in terminal.getvalue().split("\r")[1:]]
    assert shown == ["  0%", " 25%", " 50%", " 50%", " 75%"]


def test_a_line_is_no_longer_than_the_terminal_is_wide(terminal, monkeypatch):
    """A longer line would be broken, and each iteration would begin a new one."""
    monkeypatch.setattr("shutil.get_terminal_size", lambda: os.terminal_size((40, 20)))
    ProgressBar()(at(0, 1.0))
    assert len(terminal.getvalue()) == 1 + 39


def test_as_a_context_manager_it_ends_its_line_after_a_failure(comm, terminal):
    with bricks_problem(comm, 4) as problem, ProgressBar() as bar:
        solution = problem.solve(method="gimssn", rtol=1e-9, max_iterations=2, observer=bar)
    assert solution.status is ContactStatus.MAX_ITERATIONS
    assert terminal.getvalue().endswith(" s\n")


@pytest.mark.parallel
def test_it_is_shown_on_the_first_rank(comm, terminal):
    with bricks_problem(comm, 3) as problem:
        problem.solve(observer=ProgressBar(comm))
    assert bool(terminal.getvalue()) == (comm.rank == 0)


@pytest.mark.parallel
def test_it_writes_to_stderr_only(comm, capfd):
    with bricks_problem(comm, 4) as problem:
        problem.solve(observer=ProgressBar(disable=False))
    captured = capfd.readouterr()
    assert "products" in captured.err and captured.out == ""


@pytest.mark.parallel
def test_it_is_silent_in_log_files(comm, capfd):
    """The standard error of this test is no terminal."""
    with bricks_problem(comm, 4) as problem:
        solution = problem.solve(observer=ProgressBar(comm))
    assert solution.status is ContactStatus.CONVERGED
    captured = capfd.readouterr()
    assert captured.err == captured.out == ""


def test_a_notebook_shows_one_line_for_each_solve(terminal, monkeypatch):
    monkeypatch.setattr(terminal, "isatty", lambda: False)
    monkeypatch.setitem(sys.modules, "ipykernel", SimpleNamespace())
    bar = ProgressBar()
    for reached in (1e-2, 1e-5):
        for number, value in enumerate((1.0, reached)):
            bar(at(number, value))
    lines = terminal.getvalue().split("\r")[1:]
    assert [line[8:12] for line in lines] == ["  0%", " 50%", "  0%", "100%"]
    assert "iteration 1, 11 products" in lines[1] and lines[3].endswith("\n")


def test_a_disabled_one_shows_nothing(terminal, monkeypatch):
    monkeypatch.setitem(sys.modules, "ipykernel", SimpleNamespace())
    ProgressBar(disable=True)(at(0, 1.0))
    assert terminal.getvalue() == ""
