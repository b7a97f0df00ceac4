"""Print the path of a virtual environment for this Python; make it if it is missing.

    venvs.py tools [--demos]     DOLFINx is at hand: add the tools that pyproject.toml lists as
                                 `dev` and `docs`; with --demos only what demos need. Where nothing
                                 is missing the path is this Python's own prefix.
    venvs.py wheels [--leaking]  There is no DOLFINx: install it from PyPI. A Python that leaks
                                 memory (see docs/start/install.md) is taken with --leaking only.

The first kind shows all packages of this Python. The project itself is in neither, so that several
clones can share them: tools/fenicsx puts the checkout on PYTHONPATH instead.

Exit status: 0, the path is on stdout; 3, this Python does not suit; 75, the environment could not
be made, and one line on stderr says why.
"""

import os
import sys

SUPPORTED = (0, 9), (0, 11)
UNSUITED = 3
TRY_LATER = 75

TOOLS = os.path.dirname(os.path.abspath(__file__))

#: Libraries of the system that Gmsh and VTK load, and Debian's packages of them.
LIBRARIES = (
    *("libGL.so.1", "libGLU.so.1", "libEGL.so.1"),
    *("libXrender.so.1", "libXcursor.so.1", "libXft.so.2", "libXinerama.so.1"),
)
PACKAGES = "libgl1 libglu1-mesa libegl1 libxrender1 libxcursor1 libxft2 libxinerama1"


#: What goes with DOLFINx 0.11 and Python 3.12: dolfinx-adjoint, with what it needs but for the
#: package "fenics-dolfinx", since DOLFINx from PyPI is called otherwise and pip would find none.
DOLFINX_ADJOINT = (
    *("dolfinx-adjoint>=0.4,<0.5", "fenicsx-compat>=0.4", "pyadjoint-ad>=2026.9.0"),
    *("checkpoint-schedules", "sympy", "mpmath"),
)

#: For tests: the latest one goes with DOLFINx 0.11, which it requires by a name that PyPI lacks.
EXTERNAL_OPERATOR = ("dolfinx-external-operator>=0.11,<0.12",)


def dolfinx_version() -> "str | None":
    """Version of DOLFINx this Python would import, or None. Found without the slow import."""
    from importlib import metadata, util

    if not all(util.find_spec(name) for name in ("dolfinx", "petsc4py", "mpi4py")):
        return None
    for name in ("fenics-dolfinx", "dolfinx-solver-real"):
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:  # perhaps installed without its metadata
            continue
    from mpi4py import MPI  # noqa: F401

    import dolfinx

    return str(dolfinx.__version__)


def numbers_of(version: str) -> "tuple[int, ...]":
    """The first two numbers of a version: 0.11.0.post1 is (0, 11)."""
    return tuple(int(part) for part in version.split(".")[:2])


def is_supported(version: str) -> bool:
    """Whether the project runs on this DOLFINx."""
    first, last = SUPPORTED
    return first <= numbers_of(version) <= last


def missing(*names: str) -> "list[str]":
    """Which packages this Python does not have."""
    from importlib import util

    return [name for name in names if not util.find_spec(name)]


def requirements_of(*extras: str) -> "list[str]":
    """The requirements of the project, or of these extras of it."""
    try:
        import tomllib
    except ImportError:  # Python 3.10
        from pip._vendor import tomli as tomllib

    with open(os.path.join(TOOLS, "..", "pyproject.toml"), "rb") as file:
        project = tomllib.load(file)["project"]
    listed = project["optional-dependencies"]
    return [requirement for extra in extras for requirement in listed[extra]]


#: Versions of Python whose `functools.singledispatchmethod`, used by UFL, never frees its
#: arguments, so that every mesh stays in memory.
LEAKING = ((3, 13, 0), (3, 13, 1))


def goes_with_wheels(leaking: bool) -> bool:
    """Whether DOLFINx from PyPI is there for this Python and this machine."""
    import platform

    glibc, _, version = (os.confstr("CS_GNU_LIBC_VERSION") or "").partition(" ")
    return (
        glibc == "glibc"
        and tuple(map(int, version.split("."))) >= (2, 34)
        and platform.machine() == "x86_64"
        and sys.version_info >= (3, 12)
        and (sys.version_info[:3] in LEAKING) == leaking
    )


def lacking() -> "str | None":
    """What is missing on this machine, or to this Python, for DOLFINx from PyPI."""
    import ctypes
    import shutil
    import sysconfig

    compiler = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]
    if not shutil.which(compiler):
        return f"no {compiler}, which compiles DOLFINx's forms (apt install gcc)"
    if not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
        return "no headers of this Python, which DOLFINx's forms need (apt install python3-dev)"
    for library in LIBRARIES:
        try:
            ctypes.CDLL(library)
        except OSError:
            return f"no {library}, which Gmsh or VTK needs (apt install {PACKAGES})"
    return None


def build(venv: str, requirements: "list[str]", alone: "list[str]", *options: str) -> None:
    """Make the environment, with these options of venv.

    Args:
        venv: path.
        requirements: for pip.
        alone: those for pip without their dependencies.
        options: of venv.

    Raises:
        OSError, subprocess.CalledProcessError: that failed.
    """
    import shutil
    import site
    import subprocess
    import sysconfig

    log = venv + ".log"
    python = os.path.join(venv, "bin", "python3")
    options_of_pip = "--disable-pip-version-check --no-input --no-compile".split()
    pip = [python, "-m", "pip", "install", *options_of_pip]
    os.environ["PIP_ROOT_USER_ACTION"] = "ignore"
    os.environ.pop("PIP_USER", None)
    progress = os.path.join(TOOLS, "progress")
    with open(log, "w") as output, subprocess.Popen([progress, log, str(os.getpid())]) as watcher:

        def run(*command: str) -> None:
            subprocess.run(command, check=True, stdout=output, stderr=output)

        try:
            shutil.rmtree(venv, ignore_errors=True)
            run(sys.executable, "-m", "venv", *options, venv)
            if options and sys.prefix != sys.base_prefix:
                # A venv made from a venv sees the system's packages, but not its parent's.
                lib = sysconfig.get_path("purelib", vars={"base": venv, "platbase": venv})
                with open(os.path.join(lib, "parent.pth"), "w") as pth:
                    pth.writelines(
                        f"import site; site.addsitedir({path!r})\n"
                        for path in site.getsitepackages()
                        if path.startswith(sys.prefix)
                    )
                    libmpi = os.path.join(sys.prefix, "lib", "libmpi.so.12")
                    if os.path.exists(libmpi):  # from PyPI; mpi4py looks in its own venv only
                        pth.write(
                            f"import os; os.environ.setdefault('MPI4PY_LIBMPI', {libmpi!r})\n"
                        )
            run(*pip, *requirements)
            if alone:
                run(*pip, "--no-deps", *alone)
            run(python, "-c", "import mpi4py.MPI, dolfinx, petsc4py")
        except BaseException:
            shutil.rmtree(venv, ignore_errors=True)  # the disk may be full
            raise
        finally:
            watcher.terminate()


def reason_in(log: str) -> str:
    """Return what went wrong, from pip's log, and what to do about it."""
    with open(log) as file:
        lines = [line.strip() for line in file]
    stopped = "it was stopped, or ended without a message: run the same command again"
    reason = next((line for line in reversed(lines) if "error" in line.lower()), stopped)
    broken = [line for line in lines if "connection broken by" in line]
    if broken and "No matching distribution" in reason:  # which is not what went wrong
        cause = broken[-1].rpartition("': /")[0].rpartition(": ")[2].rstrip("')")
        reason = (
            f"no connection to the package index: {cause}; try again with a network, or set "
            "HTTPS_PROXY or PIP_INDEX_URL"
        )
    if "No space left" in reason:
        reason += "; make room, or set XDG_CACHE_HOME and TMPDIR to folders with more"
    return reason


def say(message: str) -> None:
    """Write a line to stderr."""
    print(f"fenicsx: {message}", file=sys.stderr)


def cached(
    requirements: "list[str]",
    what: str,
    download: int,
    disk: int,
    *options: str,
    alone: "tuple[str, ...]" = (),
) -> int:
    """Print the path of the environment with these requirements; make it if it is missing.

    Args:
        requirements: for pip.
        what: how messages call them.
        download: megabytes.
        disk: megabytes.
        options: of venv.
        alone: requirements for pip, which are installed without their dependencies.

    Returns:
        The exit status.
    """
    import fcntl
    import hashlib
    import subprocess

    # the environment depends on all of this, and so does its name
    key = repr((sys.prefix, sys.version, requirements, options, *alone))
    name = "venv-" + hashlib.sha256(key.encode()).hexdigest()[:12]
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    venv = os.path.join(cache, "dolfinx_tresca", name)
    complete = os.path.join(venv, "complete")  # written last: a venv cut short has none
    if os.path.exists(complete):
        print(venv)
        return 0

    if missing("ensurepip", "venv"):
        say(f"no {what} for {sys.executable}: this Python has no venv (apt install python3-venv)")
        return TRY_LATER
    folder = [os.path.join(TOOLS, "cache-folder"), "dolfinx_tresca", str(disk + 100)]
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
                build(venv, requirements, list(alone), *options)
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


def wheels(leaking: bool) -> int:
    """Print the path of an environment with DOLFINx from PyPI."""
    if not goes_with_wheels(leaking):
        return UNSUITED
    reason = lacking()
    if reason is not None:
        say(f"DOLFINx from PyPI cannot be used with {sys.executable}: {reason}")
        return TRY_LATER
    requirements = [*requirements_of("fenicsx", "gmsh", "plot"), "numpy", "scipy"]
    return cached(requirements, "DOLFINx", 340, 1300)


def developer_tools(for_demos: bool) -> int:
    """Print the path of an environment that adds tools to the DOLFINx at hand."""
    version = dolfinx_version()
    if version is None or not is_supported(version):
        return UNSUITED
    # not in `dev`: Debian's VTK has no metadata, so pip would bring another one for its pyvista
    requirements = missing("gmsh", "pyvista")
    download, disk = (250, 700) if requirements else (0, 0)  # MB
    what, alone = "packages for demos", ()
    if not for_demos:
        requirements = requirements_of("dev", "docs") + requirements + missing("h5py")
        download, disk = download + 110, disk + 420
        what = "developer tools"
        if numbers_of(version) >= (0, 11) and sys.version_info >= (3, 12):
            requirements, alone = [*requirements, "jax"], (*DOLFINX_ADJOINT, *EXTERNAL_OPERATOR)
            download, disk = download + 110, disk + 450
    if not requirements:
        print(sys.prefix)
        return 0
    return cached(requirements, what, download, disk, "--system-site-packages", alone=alone)


def main(arguments: "list[str]") -> int:
    """Run the command that is named first."""
    if sys.version_info < (3, 10):  # noqa: UP036, the Python at hand may be any
        return UNSUITED
    if arguments[0] == "wheels":
        return wheels("--leaking" in arguments)
    return developer_tools("--demos" in arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
