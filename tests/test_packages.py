"""What is in the wheel and in the source archive."""

from __future__ import annotations

import importlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import dolfinx_tresca

CHECKOUT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def files() -> list[str]:
    """The committed files, without links to folders."""
    if shutil.which("git") is None or not (CHECKOUT / ".git").exists():
        pytest.skip("this is no git checkout")
    listing = ["git", "-c", "safe.directory=*", "ls-files"]
    done = subprocess.run(listing, cwd=CHECKOUT, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.splitlines() if (CHECKOUT / name).is_file()]


@pytest.fixture(scope="module")
def build(files: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the wheel and the source archive of the committed files."""
    pytest.importorskip("setuptools", minversion="77")
    source = tmp_path_factory.mktemp("source")
    for name in files:
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(CHECKOUT / name, source / name)
    code = "from setuptools import build_meta as b; b.build_sdist('dist'); b.build_wheel('dist')"
    subprocess.run([sys.executable, "-c", code], cwd=source, capture_output=True, check=True)
    return source / "dist"


def test_wheel(build: Path, files: list[str]) -> None:
    """The package as it is in the checkout, the meshes of the demos with it, and nothing else."""
    (wheel,) = build.glob("*.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert "dolfinx_tresca/meshes/two_bricks.geo" in names
    assert names == {name for name in files if name.startswith("dolfinx_tresca/")}


def test_source_archive(build: Path, files: list[str]) -> None:
    """All that is committed: tests, what they need, and the commands that run them."""
    (archive,) = build.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        members = {member.name.partition("/")[2]: member for member in tar if member.isfile()}
    assert set(files) - set(members) <= {".gitignore"}
    for name in set(files) & set(members):
        executable = bool((CHECKOUT / name).stat().st_mode & 0o100)
        assert bool(members[name].mode & 0o100) == executable, name


def test_version(build: Path) -> None:
    """The package's own is the version of wheel, source archive, conda recipe and citation."""
    version = dolfinx_tresca.__version__
    assert {path.name.split("-")[1].removesuffix(".tar.gz") for path in build.iterdir()} == {
        version
    }
    recipe = (CHECKOUT / "packaging" / "conda" / "recipe.yaml").read_text()
    assert re.findall(r'version: "([^"]*)"', recipe) == [version]
    citation = (CHECKOUT / "CITATION.cff").read_text()
    assert re.findall("^version: (.*)$", citation, re.MULTILINE) == [version]


@pytest.mark.long
def test_installed_from_the_wheel(build, tmp_path, monkeypatch):
    """Build as for PyPI, and install with all extras in an empty venv, outside of the checkout."""
    monkeypatch.syspath_prepend(CHECKOUT / "tools")
    venvs = importlib.import_module("venvs")
    if not any(venvs.goes_with_wheels(leaking) for leaking in (False, True)) or venvs.lacking():
        pytest.skip("DOLFINx from PyPI does not go with this Python or this machine")
    inherited = ("PYTHON", "MPI4PY", "OMPI", "PMI", "VIRTUAL_ENV")
    environment = {key: os.environ[key] for key in os.environ if not key.startswith(inherited)}

    def run(*command: str | Path) -> str:
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    # of the base: a venv of a venv would see nothing of either
    base = Path(sys.base_prefix) / "bin" / f"python3.{sys.version_info.minor}"
    run(base, "-m", "venv", tmp_path / "tools")
    tools = tmp_path / "tools" / "bin" / "python"
    run(tools, "-m", "pip", "install", "--quiet", "build", "twine")
    run(tools, "-m", "build", "--outdir", tmp_path / "dist", build.parent)
    run(tools, "-m", "twine", "check", "--strict", *(tmp_path / "dist").iterdir())

    run(base, "-m", "venv", tmp_path / "venv")
    python = tmp_path / "venv" / "bin" / "python"
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    run(python, "-m", "pip", "install", "--quiet", f"{wheel}[fenicsx,gmsh,plot]")
    assert str(tmp_path / "venv") in run(python, "-m", "dolfinx_tresca", "--check")
    assert "CONVERGED" in run(python, "-m", "dolfinx_tresca")
    for ending in ("pvd", "png"):
        assert (tmp_path / "results" / f"two_bricks.{ending}").stat().st_size > 0
    mpiexec = (python.with_name("mpiexec"), "-n", "2", python, "-m", "dolfinx_tresca")
    assert run(*mpiexec).count("CONVERGED") == 1
