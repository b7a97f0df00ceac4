"""Pictures of results, with pyvista and matplotlib, also without a display."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.atomic_write import atomic_write
from dolfinx_tresca._base.number import real
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.output.blocks import in_degree
from dolfinx_tresca.output.display import display_for_pictures
from dolfinx_tresca.output.grid import ROOT, Grid, gather_grid
from dolfinx_tresca.output.pictures import canvas
from dolfinx_tresca.output.pictures.bodies import draw_bodies
from dolfinx_tresca.output.pictures.canvas import STYLE, Box, render
from dolfinx_tresca.output.pictures.contact import Contact, gather_contact
from dolfinx_tresca.output.pictures.curve import chart
from dolfinx_tresca.output.pictures.surface import draw_surface
from dolfinx_tresca.output.revolved import checked_angle
from dolfinx_tresca.solution.fields import SurfaceFields
from dolfinx_tresca.units import Units

SUFFIXES = (".png", ".jpg", ".tif", ".svg", ".pdf")
WIDTH, HEIGHT, ROW = 8.8, 3.9, 3.1  #: inches: width; height for one pair; for each of several
TALLEST = 2 * ROW  #: inches: largest height of the view of the bodies
SPLIT = 0.42  #: part of the width for the bodies

#: Metadata that would differ from run to run.
_NO_DATES: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}


@collective(comm_of("u"), ignored=("path", "surfaces"))
def plot(
    path: str | Path | None,
    u: fem.Function,
    surfaces: Sequence[SurfaceFields],
    *,
    scale: float | None = None,
    units: Units | None = None,
    revolve: float | None = None,
) -> Any:
    """Draw the deformed bodies, and beside them each contact surface.

    The bodies are drawn with the magnified displacement u. Colours show the length of u, lines the
    undeformed edges. Rigid obstacles near the bodies are drawn, too: solid, or as glass where they
    would hide the bodies. The magnification that `pictures.bodies.magnification` chooses is so
    small that surfaces which have met, and the sides of an initial overlap, also touch in the
    picture.

    Contact surfaces in 3D are drawn without the facets that face nothing. They are seen along their
    mean normal; closed ones, like holes and shafts, obliquely from outside, so that their far side
    is hidden (`to_pyvista` returns the data for other views). Colours show the pressure, and arrows
    the slip
    of the secondary side against the primary side (after an accepted load step the slip of the new
    step; with finite sliding the legend then also has the longest path of the slip over all steps).
    Black discs mark pressed nodes that stick, rings open nodes that stick; open parts are grey.

    For contact curves in 2D, charts show pressure, and traction and slip along the curve, against
    its arc length. After an accepted load step with finite sliding, the length of the slip's path
    over all steps replaces the slip. On the bodies the curve is thick and red where it is pressed,
    thin and black where it is open. Its start is marked by a dot or, with several pairs, by the
    number of the pair; a closed curve runs counterclockwise. Without friction there are no arrows,
    marks, tractions and slips.

    Colours begin at zero unless all values are far from zero. If a few values are much larger than
    the others, the range of colours ends below these, and the colour bar has an arrow and the
    largest value.

    The first rank needs pyvista and matplotlib, but no display. In `.svg` and `.pdf` files the
    text, the bars and the charts are vectors, and the views of bodies and surfaces are images of
    200 dots per inch.

    Collective.

    Args:
        path: `.png`, `.jpg`, `.tif`, `.svg` or `.pdf`; the first rank's path counts. None: nothing
            is written.
        u: displacement [length].
        surfaces: the fields of each pair.
        scale: magnification of u, 0 or more; None chooses one that shows the deformation.
        units: names of the units, for titles and axes.
        revolve: angle in degrees, up to 360, by which meridians of bodies are turned about the y
            axis; with 270 both cuts are seen. None: the meridians are drawn.

    Returns:
        if `path` is None, the picture on the first rank, a `PIL.Image.Image`: notebooks show it,
        and its method `show()` opens it elsewhere; otherwise None.

    Raises:
        InputError: the suffix is unknown, scale is no number of 0 or more, the angle is wrong, or
            the file cannot be written.
        ContactError: there is no pyvista or matplotlib, or VTK would need a display.
    """
    comm = u.function_space.mesh.comm
    name = comm.bcast(None if path is None else str(path), root=ROOT)
    suffix = ".png" if name is None else Path(name).suffix
    if suffix not in SUFFIXES:
        raise InputError(f"plot writes {', '.join(SUFFIXES)}, found '{name}'.")
    factor = None if scale is None else real(scale)
    if scale is not None and (factor is None or not 0.0 <= factor < math.inf):
        raise InputError(f"scale must be a number of 0 or more, found {shown(scale)}.")
    angle = checked_angle(revolve, u.function_space.mesh.geometry.dim == 2)
    volume = gather_grid(in_degree([u], 1) if angle else [u])
    labels = [f"{i + 1}" if len(surfaces) > 1 else "" for i in range(len(surfaces))]
    contacts = list(map(gather_contact, surfaces, labels))
    with errors_on_all_ranks(comm):
        if volume is None:
            return None
        present = [contact for contact in contacts if contact is not None]
        data = _draw(volume, present, factor, units, suffix[1:], angle)
        if name is None:
            import PIL.Image

            return PIL.Image.open(io.BytesIO(data)).convert("RGB")
        with atomic_write(Path(name)) as new:
            new.write_bytes(data)


def _draw(
    volume: Grid,
    contacts: list[Contact],
    scale: float | None,
    units: Units | None,
    suffix: str,
    angle: float,
) -> bytes:
    """Draw the picture, and return it as the bytes of a file of type `suffix`. Not collective.

    Raises:
        ContactError: pyvista or matplotlib is missing.
    """
    volume.to_pyvista()  # raises an error without pyvista
    try:
        import matplotlib.style
    except ImportError as error:
        raise ContactError(
            "pictures need matplotlib: install python3-matplotlib (Debian) or matplotlib (conda, "
            "pip)."
        ) from error
    data = io.BytesIO()
    with matplotlib.style.context(["default", STYLE]), display_for_pictures():
        figure = compose(volume, contacts, scale, units, angle)
        figure.savefig(data, format=suffix, dpi=canvas.DPI, metadata=_NO_DATES.get(suffix))
    return data.getvalue()


def compose(
    volume: Grid,
    contacts: Sequence[Contact],
    scale: float | None,
    units: Units | None,
    angle: float = 0.0,
) -> Any:
    """Return the picture as a figure, in matplotlib's current style. Not collective."""
    from matplotlib.figure import Figure

    height = HEIGHT if len(contacts) < 2 else ROW * len(contacts)
    left = SPLIT * WIDTH if contacts else WIDTH
    figure = Figure(figsize=(WIDTH, height), facecolor="white")
    bodies = partial(
        draw_bodies,
        volume=volume,
        contacts=contacts,
        scale=scale,
        unit=units.length if units else "",
        angle=angle,
    )
    tall = min(height, TALLEST)
    render(figure, Box(0.0, height - tall, left, tall), bodies)
    for i, contact in enumerate(contacts):
        row = height / len(contacts)
        box = Box(left, height - (i + 1) * row, WIDTH - left, row)
        if volume.dim == 2:
            chart(figure, box, contact, units)
        else:
            render(figure, box, partial(draw_surface, contact=contact, units=units))
    return figure
