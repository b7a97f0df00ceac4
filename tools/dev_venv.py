"""Print the path of the developer venv that belongs to this Python; make it if it is missing.

The venv shows all packages of this Python, DOLFINx among them, and adds the `dev` tools that
pyproject.toml lists. The project itself is not in it, so that several clones can share a venv:
tools/fenicsx puts the checkout on PYTHONPATH instead.

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


def dev_requirements(pyproject: str) -> "list[str]":
    """The list `dev` of pyproject.toml, and what demos and tests lack besides."""
    from importlib import util

    try:
        import tomllib
    except ImportError:  # Python 3.10
        from pip._vendor import tomli as tomllib

    with open(pyproject, "rb") as file:
        project = tomllib.load(file)["project"]
    # not in `dev`: Debian's VTK has no metadata, so pip would bring another one for its pyvista
    missing = [name for name in ("gmsh", "pyvista", "h5py") if not util.find_spec(name)]
    return list(project["optional-dependencies"]["dev"]) + missing


def build(venv: str, requirements: "list[str]") -> None:
    """Make the venv, or exit with one line that names the log."""
    import shutil
    import site
    import subprocess
    import sysconfig

    log = venv + ".log"
    print(f"fenicsx: installing the developer tools from PyPI (once), log: {log}", file=sys.stderr)
    python = os.path.join(venv, "bin", "python3")
    pip = [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
    os.environ["PIP_ROOT_USER_ACTION"] = "ignore"
    os.environ.pop("PIP_USER", None)
    with open(log, "w") as output:

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
            if requirements:
                run(*pip, *requirements)
            run(python, "-c", "import dolfinx, mpi4py, petsc4py")
        except (OSError, subprocess.CalledProcessError):
            output.flush()
            with open(log) as lines:
                errors = [line.strip() for line in lines if "error" in line.lower()]
            reason = errors[-1] if errors else "see the log"
            print(
                f"fenicsx: no developer tools for {sys.executable}: {reason} (log: {log})",
                file=sys.stderr,
            )
            sys.exit(TRY_LATER)


def main() -> int:
    """Find the venv by a hash of what it depends on."""
    if sys.version_info < (3, 10):  # noqa: UP036, the Python at hand may be any
        return NO_DOLFINX

    import hashlib

    version = dolfinx_version()
    if version is None or not is_supported(version):
        return NO_DOLFINX
    checkout = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    requirements = dev_requirements(os.path.join(checkout, "pyproject.toml"))
    key = repr((sys.prefix, sys.version, version, requirements))
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    cache = os.path.join(cache, "dolfinx_tresca")
    venv = os.path.join(cache, "venv-" + hashlib.sha256(key.encode()).hexdigest()[:12])
    complete = os.path.join(venv, "complete")  # written last: a venv cut short has none
    if not os.path.exists(complete):
        import fcntl

        os.makedirs(cache, exist_ok=True)
        with open(venv + ".lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not os.path.exists(complete):  # nobody else made it while we waited
                build(venv, requirements)
                open(complete, "w").close()
    print(venv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
