"""The tools that set up an environment say in one line what is wrong, and what they are doing."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[1] / "tools"


def run(*command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        list(map(str, command)), capture_output=True, text=True, env=os.environ | environment
    )


def test_cache_folder(tmp_path: Path) -> None:
    """It is made, also where the path has characters that shells know."""
    cache = tmp_path / "a b; $(touch x)"
    done = run(TOOLS / "cache-folder", "some/name", "1", XDG_CACHE_HOME=str(cache))
    assert (done.returncode, done.stdout.rstrip(), done.stderr) == (0, f"{cache}/some/name", "")
    assert list((cache / "some" / "name").iterdir()) == []


@pytest.mark.parametrize(
    ("cache", "megabytes", "reason"),
    [
        ("/dev/null/cache", "1", "no cache in '/dev/null/cache/name': Not a directory"),
        ("relative", "1", "no absolute path .* found 'relative'"),
        ("{tmp_path}", "100000000000", "needs room for 100000000000 MB, and .* MB are free"),
    ],
)
def test_no_cache_folder(tmp_path: Path, cache: str, megabytes: str, reason: str) -> None:
    cache = cache.format(tmp_path=tmp_path)
    done = run(TOOLS / "cache-folder", "name", megabytes, XDG_CACHE_HOME=cache)
    assert (done.returncode, done.stdout) == (75, "")
    assert re.fullmatch(f"fenicsx: .*{reason}.*set XDG_CACHE_HOME.*\n", done.stderr)


def test_unwritable_cache_of_the_environment(tmp_path: Path) -> None:
    """Before a root or a venv is made, and before DOLFINx meets it with a traceback."""
    for command, environment in (
        ([TOOLS / "debian-root", "true"], {}),
        ([sys.executable, TOOLS / "venvs.py", "tools"], {}),
        ([TOOLS / "fenicsx", sys.executable, "demos/demo_two_bricks.py"], {"FENICSX_ENV": ""}),
    ):
        done = run(*command, XDG_CACHE_HOME="/dev/null/cache", **environment)
        assert (done.returncode, done.stdout) == (75, "")
        assert re.fullmatch(r"fenicsx: no cache in '/dev/null/cache/.*\n", done.stderr)


def test_demos_need_no_developer_tools(tmp_path: Path) -> None:
    """What they need is here: nothing is made and nothing is asked of PyPI."""
    pytest.importorskip("gmsh")
    pytest.importorskip("pyvista")
    done = run(sys.executable, TOOLS / "venvs.py", "tools", "--demos", XDG_CACHE_HOME=str(tmp_path))
    assert (done.returncode, done.stdout.rstrip(), done.stderr) == (0, sys.prefix, "")
    assert not list(tmp_path.iterdir())


RETRY = (
    "WARNING: Retrying (Retry(total=4)) after connection broken by 'NewConnectionError('<pip."
    "HTTPSConnection object at 0x7f>: Failed to establish a new connection: [Errno -3] Temporary "
    "failure in name resolution')': /simple/pytest/\n"
)


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        ("Collecting pytest\n", ".*: run the same command again"),
        ("ERROR: No matching distribution found for pytest\n", "ERROR: No matching distr.* pytest"),
        (
            RETRY + "ERROR: No matching distribution found for pytest\n",
            ".*: .*in name resolution; .*HTTPS_PROXY.*",
        ),
        (RETRY + "OSError: [Errno 28] No space left on device\n", "OSError: .*No space.*TMPDIR.*"),
    ],
)
def test_what_pip_failed_at(tmp_path, monkeypatch, log, reason):
    """Where it found no network it says at last that there is no such package."""
    monkeypatch.syspath_prepend(TOOLS)
    reason_in = importlib.import_module("venvs").reason_in
    (tmp_path / "log").write_text(log)
    assert re.fullmatch(reason, reason_in(str(tmp_path / "log")))


def test_python_without_venv(tmp_path, monkeypatch, capfd):
    """Debian has venv in a package of its own: nothing is made, and one line names the package."""
    monkeypatch.syspath_prepend(TOOLS)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setitem(sys.modules, "ensurepip", None)
    assert importlib.import_module("venvs").cached(["pytest"], "developer tools", 1, 1) == 75
    assert re.fullmatch(
        r"fenicsx: no developer tools for .*: .*apt install python3-venv.*\n",
        capfd.readouterr().err,
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("pip", "reason"),
    [
        ("kill -9 $$", "it was stopped.*: run the same command again"),
        ("echo 'OSError: [Errno 28] No space left on device'; exit 1", ".*No space.*make room.*"),
    ],
)
def test_half_an_installation_is_not_taken(tmp_path, monkeypatch, capfd, pip, reason):
    """It is removed, the reason is in the last line, and the next attempt begins anew."""
    monkeypatch.syspath_prepend(TOOLS)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    venvs = importlib.import_module("venvs")
    # in place of this Python: makes the folder of the venv, with a python3 that does this for pip
    program = f"""mkdir -p "$3/bin" && printf '#!/bin/sh\n%s\n' {shlex.quote(pip)} >"$3/bin/python3"
        chmod +x "$3/bin/python3" """
    fake(tmp_path / "bin", python3=program)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "bin" / "python3"))
    for _ in range(2):
        assert venvs.cached(["pytest"], "developer tools", 1, 1) == 75
        out, err = capfd.readouterr()
        assert out == ""
        line = rf"fenicsx: no developer tools for .*: {reason} \(log: .*\)"
        assert re.fullmatch(line, err.splitlines()[-1])
        assert [path for path in (tmp_path / "dolfinx_tresca").iterdir() if path.is_dir()] == []


def fake(folder: Path, **programs: str) -> str:
    """Put programs of these lines of shell into a folder, and return a PATH that begins there."""
    folder.mkdir()
    for name, lines in programs.items():
        (folder / name).write_text(f"#!/bin/sh\n{lines}\n")
        (folder / name).chmod(0o755)
    return f"{folder}:{os.environ['PATH']}"


def fenicsx(
    folder: Path, suite: str, pyenv: str = "exit 1", **pythons: str
) -> subprocess.CompletedProcess[str]:
    """Print the environment that `tools/fenicsx` chooses among these Pythons and no others."""
    tools = folder / "tools"
    tools.mkdir()
    for name in ("fenicsx", "cache-folder"):
        shutil.copy(TOOLS / name, tools)
    (tools / "venvs.py").write_text("raise SystemExit(3)")  # says every true Python
    version = folder / "pyenv" / "versions" / "3.12.9"
    version.mkdir(parents=True)
    fake(version / "bin", python3=pyenv)
    # a venv, with DOLFINx and the tools in it
    for made in (*(folder / name for name in pythons), version / "python3"):
        made.mkdir()
        fake(made / "bin", python3=f"echo {shlex.quote(str(made / 'tools'))}")
    others = dict.fromkeys(("id", "sudo"), "exit 1")  # who may not install Debian's packages
    path = fake(folder / "bin", **others, **pythons)
    (tools / "debian-root").write_text("#!/bin/sh\necho in the root\n")
    (tools / "debian-root").chmod(0o755)
    return run(
        *(tools / "fenicsx", "sh", "-c", 'echo "$FENICSX_ENV"'),
        **{"FENICSX_ENV": "", "FENICSX_SUITE": suite, "FENICSX_IN_ROOT": "", "PATH": path},
        **{"PYENV_ROOT": str(folder / "pyenv"), "ASKED": str(folder / "asked")},
        XDG_CACHE_HOME=str(folder / "cache"),
    )


#: What `tools/fenicsx` asks of a Python, here of one that makes an environment with DOLFINx.
MAKES = """case "$*" in -c*) exit ;; *" tools"*) exit 3 ;; esac
echo "${0##*/}" >>"$ASKED"
echo "${0%/bin/*}/${0##*/}" """
LEAKS = f'case "$*" in *"venvs.py wheels") exit 3 ;; esac\n{MAKES}'
CUT_OFF = 'case "$*" in -c*) exit ;; *" tools"*) exit 3 ;; esac\necho "no wheel today" >&2; exit 75'


@pytest.mark.parametrize(
    ("pythons", "taken"),
    [
        ({"python3.13": MAKES, "python3.12": MAKES}, "python3.13"),
        ({"python3.13": LEAKS, "python3.12": MAKES}, "python3.12"),
        ({"python3.13": LEAKS}, "python3.13"),
        ({"python3.13": "exit 127", "python3.12": MAKES}, "python3.12"),  # as pyenv's shims do
    ],
)
@pytest.mark.parametrize("suite", ["wheels", ""])
def test_which_python_gets_wheels(tmp_path, pythons, taken, suite):
    done = fenicsx(tmp_path, suite, **pythons)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.rstrip() == str(tmp_path / taken / "tools")
    assert (tmp_path / "asked").read_text().split() == [taken]


def test_a_python_that_pyenv_does_not_show(tmp_path: Path) -> None:
    done = fenicsx(tmp_path, "wheels", pyenv=MAKES)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.rstrip() == str(tmp_path / "pyenv/versions/3.12.9/python3/tools")


@pytest.mark.parametrize(
    ("suite", "status", "printed"), [("wheels", 75, ""), ("", 0, "in the root")]
)
def test_a_wheel_that_cannot_be_had(tmp_path: Path, suite: str, status: int, printed: str) -> None:
    """One line; Debian's DOLFINx follows where nothing was asked for."""
    done = fenicsx(tmp_path, suite, **{"python3.13": CUT_OFF, "python3.12": MAKES})
    assert (done.returncode, done.stdout.rstrip()) == (status, printed)
    assert done.stderr == "no wheel today\n"


def test_names_of_users_are_no_commands(tmp_path: Path) -> None:
    """What root is asked to do for a user, with a name as a directory of a company may have it."""
    path = fake(
        tmp_path / "bin",
        id="case $1 in -u) echo 1234;; *) printf %s 'A\\b; touch x';; esac",
        sudo='shift; [ "$1" = true ] || printf "<%s>" "$@" >asked',
        mmdebstrap="",
        newuidmap="",
        unshare="echo not here; exit 1",
    )
    done = subprocess.run(
        [TOOLS / "debian-root", "true"],
        env=os.environ | {"PATH": path, "XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 75 and "namespaces here: not here" in done.stderr
    asked = (tmp_path / "asked").read_text()
    ids = r"\d+-\d+"
    assert re.fullmatch(
        rf"<usermod><--add-subuids><{ids}><--add-subgids><{ids}><--><A\\b; touch x>", asked
    )
    assert not (tmp_path / "x").exists()


def test_a_temporary_folder_of_somebody_else(tmp_path: Path) -> None:
    """What others put into /tmp by the name of a user's folder is not taken for it."""
    ordinary = ["setpriv", "--reuid=1234", "--regid=1234", "--clear-groups"]
    user, become = (os.getuid(), []) if os.getuid() != 0 else (1234, ordinary)
    with tempfile.TemporaryDirectory() as shared:  # where an ordinary user gets to
        Path(shared).chmod(0o777)
        script = shutil.copy(TOOLS / "in-root", shared)
        elsewhere = Path(shared) / "elsewhere"
        elsewhere.mkdir(0o777)
        (Path(shared) / f"fenicsx-{user}").symlink_to(elsewhere)
        done = run(*become, script, tmp_path, "true", TMPDIR=shared)
    assert (done.returncode, done.stdout) == (75, "")
    assert re.fullmatch(
        r"fenicsx: cannot make the folder '.*' for you alone: set TMPDIR.*\n", done.stderr
    )
