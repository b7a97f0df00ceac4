"""A display for pictures on machines that have none."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

from dolfinx_tresca.errors import ContactError


@contextmanager
def virtual_display() -> Iterator[None]:
    """Give VTK the X server that it wants, for the length of a block. Not collective.

    VTK before 9.5 ends the process where it finds none; later versions draw through EGL or OSMesa.

    Raises:
        ContactError: one is wanted, and there is no Xvfb.
    """
    if not needs_display():
        yield
        return
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        raise ContactError(
            "there is no display for the picture, and VTK needs one: install xvfb (apt "
            "install xvfb) or VTK 9.5 or later, or run where DISPLAY is set."
        )
    reader, writer = os.pipe()
    server = subprocess.Popen(
        [xvfb, "-displayfd", str(writer), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"],
        pass_fds=[writer],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(writer)
    try:
        with os.fdopen(reader) as answer:
            number = answer.readline().strip()
        if not number:
            raise ContactError("Xvfb, the display for the picture, did not start.")
        os.environ["DISPLAY"] = f":{number}"
        yield
    finally:
        os.environ.pop("DISPLAY", None)
        server.terminate()
        server.wait()


def needs_display() -> bool:
    """Whether VTK's window would look for an X server, and there is none."""
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY"):
        return False
    import_module("vtkmodules.vtkRenderingOpenGL2")  # fills the factory of windows
    window = import_module("vtkmodules.vtkRenderingCore").vtkRenderWindow()
    return str(window.GetClassName()) == "vtkXOpenGLRenderWindow"
