"""Print the path of the developer venv that belongs to this Python; make it if it is missing.

The venv shows all packages of this Python, DOLFINx among them, and adds the `dev` tools that
pyproject.toml lists. The project itself is not in it, so that several clones can share a venv:
tools/fenicsx puts the checkout on PYTHONPATH instead. With the argument --demos it adds only what
demos need, and where nothing of that is missing it is this Python's own prefix.

Exit status: 0, the path is on stdout; 3, this Python has no supported DOLFINx; 75, no venv.
"""

import os
import sys

SUPPORTED = (0, 9), (0, 11)
NO_DOLFINX = 3
TRY_LATER = 75


def dolfinx_version() -> "str | None":
    """Version of DOLFINx this Python would import, or None. Found without the slow import."""
    from importlib import metadata, util

    if not all(util.find_spec(name) for name in ("dolfinx", "petsc4py", "mpi4py")):
        return None
    try:
        return metadata.version("fenics-dolfinx")
    except metadata.PackageNotFoundError:  # installed without its metadata
        import dolfinx

        return str(dolfinx.__version__)


def is_supported(version: str) -> bool:
    """Whether the project runs on this DOLFINx; 0.11.0.post1 counts as (0, 11)."""
    first, last = SUPPORTED
    return first <= tuple(int(part) for part in version.split(".")[:2]) <= last


def missing(*names: str) -> "list[str]":
    """Which packages this Python does not have."""
    from importlib import util

    return [name for name in names if not util.find_spec(name)]


def dev_tools(pyproject: str) -> "list[str]":
    """The lists `dev` and `docs` of pyproject.toml."""
    try:
        import tomllib
    except ImportError:  # Python 3.10
        from pip._vendor import tomli as tomllib

    with open(pyproject, "rb") as file:
        project = tomllib.load(file)["project"]
    extras = project["optional-dependencies"]
    return [*extras["dev"], *extras["docs"]]


def build(venv: str, requirements: "list[str]") -> None:
    """Make the venv.

    Raises:
        OSError, subprocess.CalledProcessError: that failed.
    """
    import shutil
    import site
    import subprocess
    import sysconfig

    log = venv + ".log"
    python = os.path.join(venv, "bin", "python3")
    pip = [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    os.environ["PIP_ROOT_USER_ACTION"] = "ignore"
    os.environ.pop("PIP_USER", None)
    progress = os.path.join(os.path.dirname(os.path.abspath(__file__)), "progress")
    with open(log, "w") as output, subprocess.Popen([progress, log, str(os.getpid())]) as watcher:

        def run(*command: str) -> None:
            subprocess.run(command, check=True, stdout=output, stderr=output)

        try:
            shutil.rmtree(venv, ignore_errors=True)
            run(sys.executable, "-m", "venv", "--system-site-packages", venv)
            if sys.prefix != sys.base_prefix:
                # A venv made from a venv sees the system's packages, but not its parent's.
                lib = sysconfig.get_path("purelib", vars={"base": venv, "platbase": venv})
                with open(os.path.join(lib, "parent.pth"), "w") as pth:
                    pth.writelines(
                        f"import site; site.addsitedir({path!r})\n"
                        for path in site.getsitepackages()
                        if path.startswith(sys.prefix)
                    )
            run(*pip, *requirements)
            run(python, "-c", "import dolfinx, mpi4py, petsc4py")
        finally:
            watcher.terminate()


def reason_in(log: str) -> str:
    """What went wrong, from pip's log."""
    with open(log) as file:
        lines = [line.strip() for line in file]
    reason = next((line for line in reversed(lines) if "error" in line.lower()), "see the log")
    broken = [line for line in lines if "connection broken by" in line]
    if broken and "No matching distribution" in reason:  # which is not what went wrong
        cause = broken[-1].rpartition("': /")[0].rpartition(": ")[2].rstrip("')")
        reason = f"no connection to the package index: {cause}"
    return reason


def say(message: str) -> None:
    """Write a line to stderr."""
    print(f"fenicsx: {message}", file=sys.stderr)


def main(arguments: "list[str]") -> int:
    """Find the venv by a hash of what it depends on."""
    if sys.version_info < (3, 10):  # noqa: UP036, the Python at hand may be any
        return NO_DOLFINX

    import hashlib
    import subprocess

    version = dolfinx_version()
    if version is None or not is_supported(version):
        return NO_DOLFINX
    tools = os.path.dirname(os.path.abspath(__file__))
    # not in `dev`: Debian's VTK has no metadata, so pip would bring another one for its pyvista
    requirements = missing("gmsh", "pyvista")
    download, disk = (250, 700) if requirements else (0, 0)  # MB
    what = "packages for demos"
    if "--demos" not in arguments:
        requirements = dev_tools(os.path.join(tools, "..", "pyproject.toml")) + requirements
        requirements += missing("h5py")
        download, disk = download + 110, disk + 420
        what = "developer tools"
    if not requirements:
        print(sys.prefix)
        return 0
    key = repr((sys.prefix, sys.version, version, requirements))
    name = "venv-" + hashlib.sha256(key.encode()).hexdigest()[:12]
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    venv = os.path.join(cache, "dolfinx_tresca", name)
    complete = os.path.join(venv, "complete")  # written last: a venv cut short has none
    if os.path.exists(complete):
        print(venv)
        return 0

    import fcntl

    folder = [os.path.join(tools, "cache-folder"), "dolfinx_tresca", str(disk + 100)]
    if subprocess.run(folder, stdout=subprocess.DEVNULL).returncode != 0:
        return TRY_LATER
    try:
        with open(venv + ".lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not os.path.exists(complete):  # nobody else made it while we waited
                say(
                    f"installing {what} from PyPI, once: {download} MB to download, {disk} MB on "
                    f"disk, a minute or two; log: {venv}.log"
                )
                build(venv, requirements)
                open(complete, "w").close()
    except (OSError, subprocess.CalledProcessError) as error:
        reason = str(error) if isinstance(error, OSError) else reason_in(venv + ".log")
        say(f"no {what} for {sys.executable}: {reason} (log: {venv}.log)")
        return TRY_LATER
    except KeyboardInterrupt:
        say("interrupted")
        return TRY_LATER
    print(venv)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
