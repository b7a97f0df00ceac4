"""Pictures on machines without a display."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

from dolfinx_tresca.errors import ContactError

#: The environment variable by which VTK 9.5 and later choose the kind of window.
WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"

#: The kinds of window that need no X server, and the library of the system that each of them loads.
WINDOWS_OFF_SCREEN = (
    ("vtkEGLRenderWindow", "libEGL.so.1"),
    ("vtkOSOpenGLRenderWindow", "libOSMesa.so.8"),
)


@contextmanager
def display_for_pictures() -> Iterator[None]:
    """Let VTK render within a `with` block, also without a display. Not collective.

    Without a display VTK 9.5 and later render through EGL or OSMesa, if the system has one of these
    libraries. Older versions of VTK, and later versions without these libraries, would end in a
    segmentation fault: for these versions Xvfb, an X server, is started.

    Raises:
        ContactError: neither EGL nor OSMesa can be used, and Xvfb is not installed or fails.
    """
    if not lacks_display():
        yield
        return
    window = window_off_screen()
    if window is None:
        name, value, server = "DISPLAY", *start_xvfb()
    else:
        name, value, server = WINDOW, window, None
    os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name, None)
        if server is not None:
            server.terminate()
            server.wait()


def lacks_display() -> bool:
    """Return whether VTK, as it is set up, would use a display although there is none."""
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY") or WINDOW in os.environ:
        return False
    if vtk_version() >= (9, 5):
        return True
    import_module("vtkmodules.vtkRenderingOpenGL2")  # registers the kinds of window
    window = import_module("vtkmodules.vtkRenderingCore").vtkRenderWindow()
    return str(window.GetClassName()) == "vtkXOpenGLRenderWindow"


def vtk_version() -> tuple[int, int]:
    """Return the major and minor version of VTK."""
    version = import_module("vtkmodules.vtkCommonCore").vtkVersion
    return int(version.GetVTKMajorVersion()), int(version.GetVTKMinorVersion())


def window_off_screen() -> str | None:
    """Return a kind of window of VTK that needs no X server; None if no such kind can be used."""
    if vtk_version() < (9, 5):
        return None
    for window, library in WINDOWS_OFF_SCREEN:
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return window
    return None


def start_xvfb() -> tuple[str, subprocess.Popen[bytes]]:
    """Start the X server Xvfb; return its DISPLAY and its process.

    Raises:
        ContactError: Xvfb is not installed, or it fails.
    """
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        raise ContactError(
            "there is no display for the picture, and VTK needs one: install libegl1 (apt install "
            "libegl1) with VTK 9.5 or later, else xvfb (apt install xvfb), or run where DISPLAY "
            "is set."
        )
    reader, writer = os.pipe()
    # Without -noreset the server restarts whenever its last client leaves, as after each view of a
    # picture, and meanwhile it refuses clients or disconnects them.
    options = ["-screen", "0", "1280x1024x24", "-nolisten", "tcp", "-noreset"]
    server = subprocess.Popen(
        [xvfb, "-displayfd", str(writer), *options],
        pass_fds=[writer],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(writer)
    with os.fdopen(reader) as answer:
        number = answer.readline().strip()
    if not number:
        server.terminate()
        server.wait()
        raise ContactError("Xvfb, the display for the picture, did not start.")
    return f":{number}", server
