"""Pictures of results, with pyvista and matplotlib, also without a display."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from ctypes.util import find_library
from pathlib import Path
from typing import Any

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.arguments import checked_number
from dolfinx_tresca._base.atomic_write import atomic_write
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import ContactError, InputError
from dolfinx_tresca.output import panels
from dolfinx_tresca.output.files import ROOT, Grid, gather_grid, optional
from dolfinx_tresca.output.panels import Contact, draw_curve, gather_contact
from dolfinx_tresca.solution.fields import SurfaceFields
from dolfinx_tresca.table import Units

SUFFIXES = (".png", ".jpg", ".tif", ".svg", ".pdf")

#: The style of matplotlib in pictures; axes write powers of ten as in "10⁻⁶".
STYLE = (
    "default",
    {"font.size": 9.0, "axes.formatter.use_mathtext": True, "axes.formatter.limits": (-3, 4)},
)

#: The environment variable by which VTK 9.5 and later choose the kind of window.
WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"


@collective(comm_of("u"), ignored=("path", "surfaces"))
def plot(
    path: str | Path | None,
    u: fem.Function,
    surfaces: Sequence[SurfaceFields],
    *,
    scale: float | None = None,
    units: Units | None = None,
) -> Any:
    """Draw the deformed bodies, and beside them each contact surface.

    Collective. The bodies are drawn with the magnified displacement u. Colours show the length of
    u, lines the undeformed edges. Rigid obstacles near the bodies are drawn, too, in 3D transparent
    where they would hide the bodies. The magnification that `panels.magnification` chooses is so
    small that surfaces which have met, and the sides of an initial overlap, touch in the picture.

    Contact surfaces in 3D are drawn without the facets that face nothing, seen along their mean
    normal; closed ones, like holes and shafts, obliquely from outside. Colours show the pressure,
    and arrows the slip of the secondary side against the primary side (after an accepted load step
    the slip of the new step). Black discs mark nodes that stick; open parts are grey.

    For contact curves in 2D, charts show pressure, and traction and slip along the curve, against
    its arc length. On the bodies the curve is thick and red where it is pressed, thin and black
    where it is open. Its start is marked by a dot and, with several pairs, by the number of the
    pair; a closed curve runs counterclockwise.

    Colours begin at zero unless all values are far from zero. If a few values are much larger than
    the others, the colours end below these, and the bar has an arrow and the largest value. The
    first rank needs pyvista and matplotlib, but no display. In `.svg` and `.pdf` files views of
    bodies and surfaces are images of 200 dots per inch, all else is vectors.

    Args:
        path: `.png`, `.jpg`, `.tif`, `.svg` or `.pdf`; the first rank's path counts. None: nothing
            is written.
        u: displacement [length].
        surfaces: the fields of each pair.
        scale: magnification of u, 0 or more; None chooses one that shows the deformation.
        units: names of the units, for titles and axes.

    Returns:
        if `path` is None, the picture on the first rank, a `PIL.Image.Image`: notebooks show it,
        and its method `show()` opens it elsewhere; otherwise None.

    Raises:
        InputError: the suffix is unknown, scale is no number of 0 or more, or the file cannot be
            written.
        ContactError: there is no pyvista or matplotlib, or VTK would need a display.
    """
    comm = u.function_space.mesh.comm
    name = comm.bcast(None if path is None else str(path), root=ROOT)
    suffix = ".png" if name is None else Path(name).suffix
    if suffix not in SUFFIXES:
        raise InputError(f"plot writes {', '.join(SUFFIXES)}, found '{name}'.")
    factor = None if scale is None else checked_number("scale", scale, "[0, inf)")
    volume = gather_grid([u])
    labels = [f"{i + 1}" if len(surfaces) > 1 else "" for i in range(len(surfaces))]
    gathered = list(map(gather_contact, surfaces, labels))
    with errors_on_all_ranks(comm):
        if volume is None:
            return None
        contacts = [contact for contact in gathered if contact is not None]
        optional("pyvista")
        picture = io.BytesIO()
        with optional("matplotlib.style").context(STYLE), display_for_pictures():
            figure = compose(volume, contacts, factor, units)
            figure.savefig(picture, format=suffix[1:], dpi=panels.DPI)
        if name is None:
            import PIL.Image

            return PIL.Image.open(picture).convert("RGB")
        with atomic_write(Path(name)) as new:
            new.write_bytes(picture.getvalue())


def compose(
    volume: Grid, contacts: Sequence[Contact], scale: float | None, units: Units | None
) -> Any:
    """Return the picture of `plot` as a figure, in matplotlib's current style.

    The bodies are on the left, no taller than two rows, and each contact has a row on the right.
    """
    from matplotlib.figure import Figure

    count = len(contacts)
    figure = Figure(figsize=(8.8, 3.1 * count if count > 1 else 3.9), facecolor="white")  # inches
    halves: Any = figure.subfigures(1, 2, width_ratios=(0.42, 0.58))
    left, right = halves
    if count > 2:
        left = left.subfigures(2, 1, height_ratios=(2, count - 2), squeeze=False)[0, 0]
    length, stress = (units.length, units.stress) if units else ("", "")
    panels.draw_bodies(left, volume, contacts, scale, length)
    draw = draw_curve if volume.dim == 2 else panels.draw_surface
    rows = right.subfigures(count, 1, squeeze=False)[:, 0]
    for panel, contact in zip(rows, contacts, strict=True):
        draw(panel, contact, length, stress)
    return figure


@contextmanager
def display_for_pictures() -> Iterator[None]:
    """Let VTK render within a `with` block, also without a display.

    On Linux without a display, VTK 9.5 and later render through EGL if the system has it.
    Otherwise VTK would end in a segmentation fault: for this case Xvfb, an X server, is started.
    """
    import pyvista

    with ExitStack() as stack:
        linux = sys.platform.startswith("linux")
        if not linux or os.environ.get("DISPLAY") or WINDOW in os.environ:
            pass  # there is a display, or VTK needs none
        elif find_library("EGL") is not None and tuple(pyvista.vtk_version_info) >= (9, 5):
            os.environ[WINDOW] = "vtkEGLRenderWindow"
            stack.callback(os.environ.pop, WINDOW)
        else:
            program = shutil.which("Xvfb")
            if program is None:
                raise ContactError(
                    "there is no display for the picture, and VTK needs one: install libegl1 (apt "
                    "install libegl1) with VTK 9.5 or later, else xvfb (apt install xvfb), or run "
                    "where DISPLAY is set."
                )
            # Without -noreset the server restarts whenever its last client leaves, as after each
            # view of a picture, and meanwhile it refuses clients or disconnects them.
            options = ["-screen", "0", "1280x1024x24", "-nolisten", "tcp", "-noreset"]
            command = [program, "-displayfd", "1", *options]
            server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
            stack.enter_context(server)
            stack.callback(server.terminate)
            number = server.stdout.readline().decode().strip() if server.stdout else ""
            if not number:
                raise ContactError("Xvfb, the display for the picture, did not start.")
            os.environ["DISPLAY"] = f":{number}"
            stack.callback(os.environ.pop, "DISPLAY")
        yield
